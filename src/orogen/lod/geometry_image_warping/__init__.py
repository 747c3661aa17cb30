"""Geometry image warping; see README.md in this folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.geometry_image_warping.region import nearest, rows_run_along_x, seen_region, sketch_lattice
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

LEAST_CELLS = 8
"""Cells along a side of the smallest mesh."""
LEAST_IMPORTANCE = 1e-4
"""Of any ground over the most important at its distance: float32 sums do not lose it."""
_NAME = "geometry_image_warping"
_PIXEL_BYTES = 16
_GROUP = 8
_BLOCK = np.dtype(
    [
        ("columns", "u4"),
        ("rows", "u4"),
        ("along_x", "u4"),
        ("nearest", "f4"),
    ]
)


@dataclass(frozen=True)
class Settings:
    """Schmiade 2008, section 2.4, after Dachsbacher and Stamminger 2004."""

    pixels_per_column: float = 2.0
    """Width of the picture over the columns of the mesh, above 0."""
    rows_per_column: float = 2.0
    """Rows of the mesh over its columns, above 0."""
    columns: int | None = None
    """Columns of cells, at least 8, instead of what pixels_per_column makes of the picture."""
    rows: int | None = None
    """Rows of cells, at least 8, instead of what rows_per_column makes of the columns."""
    sketch_size: int = 96
    """Pixels along a side of the sketch map, 8 to 256."""
    warping: bool = True
    """Whether vertices move to where they matter; else the mesh is even."""
    straight_rows: bool = True
    """Whether all columns are warped alike, by the mean importance of rows; else each by its own."""
    outside: float = 0.01
    """Importance of what is far outside the picture over that of what is in it, 0.0001 to 1."""
    fall: float = 0.1
    """Sine of the angle outside the picture over which importance falls to 1/e, above 0."""
    back: float = 0.5
    """Importance of ground that faces away over that of ground that faces the eye, 0.0001 to 1."""
    detail_height: float = 0.0
    """Procedural detail: metres by which noise may raise or lower the terrain, 0 or more."""
    detail_size: float = 2.0
    """Level-0 texels from one of the widest bumps of that noise to the next, above 0."""

    def __post_init__(self) -> None:
        for name in ("pixels_per_column", "rows_per_column", "fall", "detail_size"):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise SettingsError(f"{name}: expected a number above 0, got {value}")
        for name in ("columns", "rows"):
            value = getattr(self, name)
            if value is not None and value < LEAST_CELLS:
                raise SettingsError(f"{name}: expected at least {LEAST_CELLS} cells, got {value}")
        if not 8 <= self.sketch_size <= 256:
            raise SettingsError(f"sketch_size: expected 8 to 256 pixels, got {self.sketch_size}")
        for name in ("outside", "back"):
            value = getattr(self, name)
            if not LEAST_IMPORTANCE <= value <= 1:
                raise SettingsError(f"{name}: expected {LEAST_IMPORTANCE} to 1, got {value}")
        if not (self.detail_height >= 0 and math.isfinite(self.detail_height)):
            raise SettingsError(f"detail_height: expected 0 metres or more, got {self.detail_height}")

    def cells(self, size: tuple[float, float]) -> tuple[int, int]:
        """Columns and rows of cells for a picture of (width, height) pixels."""
        columns = self.columns or max(LEAST_CELLS, math.ceil(size[0] / self.pixels_per_column))
        return columns, self.rows or max(LEAST_CELLS, math.ceil(columns * self.rows_per_column))


class View(AlgorithmView):
    """The geometry images of one view."""

    def __init__(self, algorithm: GeometryImageWarping) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        side = algorithm.settings.sketch_size
        self._block = gpu.buffer(_NAME, _BLOCK.itemsize, "UNIFORM|COPY_DST", _NAME)
        self._arguments = gpu.buffer(f"{_NAME} draw", 16, "INDIRECT|COPY_SRC|COPY_DST", _NAME)
        self._sketch = gpu.buffer(f"{_NAME} sketch", _PIXEL_BYTES * side**2, "STORAGE|COPY_SRC", _NAME)
        self._lattice = gpu.buffer(f"{_NAME} lattice", 8 * side, "STORAGE|COPY_DST", _NAME)
        self._sketch_group = gpu.bind(
            f"{_NAME} sketch", algorithm.sketch_layout, {0: self._block, 1: self._sketch, 2: self._lattice}
        )
        self._cells: tuple[int, int] | None = None
        self._statistics = Statistics()

    def _make_room(self, cells: tuple[int, int]) -> None:
        if cells == self._cells:
            return
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        side, columns, rows = algorithm.settings.sketch_size, cells[0] + 1, cells[1] + 1
        most = gpu.limits["max-storage-buffer-binding-size"] // _PIXEL_BYTES
        if columns * rows > most:
            raise BudgetError(
                f"{_NAME}: expected a mesh of at most {most} vertices, got {columns * rows}; raise pixels_per_column"
            )
        groups = gpu.limits["max-compute-workgroups-per-dimension"]
        if max(columns, rows / _GROUP) > groups:
            raise BudgetError(
                f"{_NAME}: expected at most {groups - 1} columns of cells and {groups * _GROUP - 1} rows, got {cells}; "
                "raise pixels_per_column"
            )
        half = gpu.buffer(f"{_NAME} rows", _PIXEL_BYTES * side * columns, "STORAGE", _NAME)
        mesh = gpu.buffer(f"{_NAME} mesh", _PIXEL_BYTES * columns * rows, "STORAGE|COPY_SRC", _NAME)

        def warp(source: Buffer, result: Buffer, *lines: int) -> Any:
            written = gpu.buffer(f"{_NAME} lines", np.array([*lines, 0, 0], np.uint32), "UNIFORM", _NAME)
            bound = {0: self._block, 1: source, 2: result, 3: written}
            return gpu.bind(f"{_NAME} warp", algorithm.warp_layout, bound)

        self._rows_group = warp(self._sketch, half, 1, side, 1, columns, columns, 0)
        self._agree_group = gpu.bind(f"{_NAME} rows", algorithm.image_layout, {0: self._block, 1: half})
        self._columns_group = warp(half, mesh, columns, 1, columns, 1, rows, 1)
        self._mesh_group = gpu.bind(f"{_NAME} mesh", algorithm.image_layout, {0: self._block, 1: mesh})
        self._vertex_group = gpu.bind(f"{_NAME} vertices", algorithm.module.layout, {0: self._block, 1: mesh})
        self._mesh, self._cells = mesh, cells

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Sketch what can be seen, warp it by its importance, sample it anew as a mesh."""
        algorithm = self._algorithm
        settings, gpu = algorithm.settings, algorithm.clipmap.gpu
        # before the first data has come there is nothing to draw
        region = seen_region(frame, settings.detail_height) if algorithm.clipmap.heights.present else None
        if region is None:
            self._statistics = Statistics()
            return []
        columns, rows = cells = settings.cells(frame.lod_size)
        self._make_room(cells)
        gpu.write(self._block, image_block(frame, cells))
        gpu.write(self._lattice, sketch_lattice(frame, region, settings.sketch_size, even=not settings.warping))
        gpu.write(self._arguments, np.array([2 * (columns + 1), rows, 0, 0], np.uint32))
        run = timer.compute_pass(encoder, "warp")
        run.set_bind_group(0, view.bind_group)

        def over(kernel: Any, group: Any, across: int, down: int = 1) -> None:
            run.set_pipeline(kernel)
            run.set_bind_group(1, group)
            run.dispatch_workgroups(across, down)

        tiles = -(-settings.sketch_size // _GROUP)
        over(algorithm.start, self._sketch_group, tiles, tiles)
        if settings.warping:
            over(algorithm.weigh, self._sketch_group, tiles, tiles)
        over(algorithm.warp, self._rows_group, settings.sketch_size)
        if settings.straight_rows:
            over(algorithm.agree, self._agree_group, settings.sketch_size)
        over(algorithm.warp, self._columns_group, columns + 1)
        over(algorithm.displace, self._mesh_group, columns // _GROUP + 1, rows // _GROUP + 1)
        run.end()
        self._statistics = Statistics(triangles=2 * columns * rows, patches=1, draws=1)
        return [Patches(algorithm.module, self._vertex_group, self._arguments)]

    def statistics(self) -> Statistics:
        """The mesh is one patch."""
        return self._statistics


class GeometryImageWarping(Algorithm):
    """One mesh of quads over all that can be seen, its vertices moved to where they matter in every frame."""

    name = _NAME
    Settings = Settings
    detail = Detail(setting="pixels_per_column", finest=1.0, coarsest=32.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        constants = {
            "SKETCH_SIZE": settings.sketch_size,
            "OUTSIDE": float(settings.outside),
            "BACK": float(settings.back),
            "FALL": float(settings.fall),
            "DETAIL": float(settings.detail_height),
            "DETAIL_SIZE": float(settings.detail_size),
        }
        uniform, read, storage = ("COMPUTE", "uniform"), ("COMPUTE", "read"), ("COMPUTE", "storage")
        self.image_layout = gpu.layout(f"{_NAME} image", {0: uniform, 1: storage})
        self.sketch_layout = gpu.layout(f"{_NAME} sketch", {0: uniform, 1: storage, 2: read})
        self.warp_layout = gpu.layout(f"{_NAME} warp", {0: uniform, 1: read, 2: storage, 3: uniform})
        stages = "VERTEX|COMPUTE"
        layout = gpu.layout(f"{_NAME} vertices", {0: (stages, "uniform"), 1: (stages, "read")})
        self.module = Module(FOLDER / "vertex.wgsl", layout, constants)

        def kernel(file: str, entry: str, bindings: Any) -> Any:
            shader = gpu.shader(
                f"{_NAME} {file}", FOLDER / f"{file}.wgsl", search=[FOLDER, *SEARCH],
                constants={**clipmap.constants, **constants},
            )  # fmt: skip
            return gpu.compute(f"{_NAME} {entry}", shader, entry, [clipmap.layout, bindings])

        self.start = kernel("sketch", "start", self.sketch_layout)
        self.weigh = kernel("sketch", "weigh", self.sketch_layout)
        self.warp = kernel("warp", "warp", self.warp_layout)
        self.agree = kernel("agree", "agree", self.image_layout)
        self.displace = kernel("displace", "displace", self.image_layout)

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def image_block(frame: Frame, cells: tuple[int, int]) -> NDArray[np.void]:
    """The uniform block of image.wgsl (0-dimensional)."""
    block = np.zeros((), _BLOCK)
    block["columns"], block["rows"] = cells
    block["along_x"], block["nearest"] = rows_run_along_x(frame), nearest(frame)
    return block
