"""Persistent grid mapping with tailoring, warping and edge search; see README.md in this folder."""

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
from orogen.lod.pgm.bound import PRISM_TRIANGLES, Bound, BoundView
from orogen.lod.pgm.outline import Outline, directions, find_outline
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.values import expected_name

FOLDER = Path(__file__).parent

TAILORING = ("off", "box", "hull")
WARPING = ("off", "importance", "analytic")
TESSELLATION = ("orthogonal", "symmetric", "diamond")

BORDER_POINTS = 20
"""Room for the points of a border: a frustum (5 planes) within a volume (6 planes) has at most 18 corners."""
LEAST_CELLS = 8
"""Cells along a side of the smallest grid."""
_IMAGE_COLUMNS, _IMAGE_ROWS = 8, 256
_VERTEX_BYTES = 24
_GROUP = 8

_BLOCK = np.dtype(
    [
        ("columns", "u4"),
        ("rows", "u4"),
        ("left_count", "u4"),
        ("right_count", "u4"),
        ("along", "f4", 2),
        ("ends", "f4", 2),
        ("depths", "f4", 2),
        ("slopes", "f4", 2),
        ("stretch", "f4", 2),
        ("altitude", "f4"),
        ("cell_angle", "f4"),
        ("edge_reach", "f4"),
        ("left_data", "u4"),
        ("right_data", "u4"),
        ("padding", "f4"),
        ("borders", "f4", (BORDER_POINTS, 2, 2)),
    ]
)


@dataclass(frozen=True)
class Settings:
    """Houska 2019, chapter 3. PGM, PGM_T, PGM_TE and PGM_TWE differ in tailoring, warping and edge_search."""

    pixels_per_column: float = 3.0
    """Width of the picture over the columns of the grid, above 0."""
    rows_per_column: float = 4.4
    """Rows of the grid over its columns, above 0 (section 3.4: "up to 1 : 5"; 240 x 1050 there)."""
    columns: int | None = None
    """Columns of cells, at least 8, instead of what pixels_per_column makes of the picture."""
    rows: int | None = None
    """Rows of cells, at least 8, instead of what rows_per_column makes of the columns."""
    tessellation: str = "symmetric"
    """Triangles of the cells: "orthogonal", "symmetric" or "diamond" (section 3.2.1)."""
    tailoring: str = "hull"
    """Where the grid lies: on all that the auxiliary camera sees ("off"), on the bounding box of what can be visible on
    its view plane ("box") or on its convex hull ("hull", section 3.3)."""
    warping: str = "importance"
    """How rows are spaced: evenly on the auxiliary camera's view plane ("off"), so that cells are as long as wide
    ("importance", section 3.4), or by a closed form of that ("analytic", section 5.1)."""
    edge_search: bool = True
    """Whether vertices move to terrain edges between them and the row before (section 3.5)."""
    edge_distance: float = 2000.0
    """Level-0 texels from the eye within which edges are searched for, 0 or more."""
    max_error: float | None = None
    """Screen-space error in pixels, above 0, that is guaranteed: what may be worse is ray cast. None: no bound."""

    def __post_init__(self) -> None:
        for name in ("pixels_per_column", "rows_per_column"):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise SettingsError(f"{name}: expected a number above 0, got {value}")
        for name in ("columns", "rows"):
            value = getattr(self, name)
            if value is not None and value < LEAST_CELLS:
                raise SettingsError(f"{name}: expected at least {LEAST_CELLS} cells, got {value}")
        for name, known in (("tessellation", TESSELLATION), ("tailoring", TAILORING), ("warping", WARPING)):
            if getattr(self, name) not in known:
                raise expected_name(f"pgm {name}", getattr(self, name), known)
        if self.max_error is not None and not self.max_error > 0:
            raise SettingsError(f"max_error: expected a number of pixels above 0, got {self.max_error}")
        if not self.edge_distance >= 0:
            raise SettingsError(f"edge_distance: expected 0 texels or more, got {self.edge_distance}")

    def cells(self, size: tuple[float, float]) -> tuple[int, int]:
        """Columns and rows of cells for a picture of (width, height) pixels."""
        columns = self.columns or max(LEAST_CELLS, math.ceil(size[0] / self.pixels_per_column))
        return columns, self.rows or max(LEAST_CELLS, math.ceil(columns * self.rows_per_column))

    def vertices_per_row(self, columns: int) -> int:
        """Vertices of the triangle strip that a row of cells is."""
        return 2 * (columns + 1) + (self.tessellation == "symmetric")


class View(AlgorithmView):
    """The grid of one view."""

    def __init__(self, algorithm: Pgm) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        self._block = gpu.buffer("pgm", _BLOCK.itemsize, "UNIFORM|COPY_DST", "pgm")
        self._integrals = gpu.buffer("pgm integrals", 4 * _IMAGE_COLUMNS * (_IMAGE_ROWS + 1), "STORAGE", "pgm")
        self._arguments = gpu.buffer("pgm draw", 16, "INDIRECT|COPY_SRC|COPY_DST", "pgm")
        self._warp_group = gpu.bind("pgm warp", algorithm.warp_layout, {0: self._block, 1: self._integrals})
        self._vertices: Buffer | None = None
        self._bound = BoundView(algorithm.bound) if algorithm.bound else None
        self._statistics = Statistics()

    def _make_room(self, columns: int, rows: int) -> None:
        vertices = (columns + 1) * (rows + 1)
        if self._vertices is not None and self._vertices.size >= _VERTEX_BYTES * vertices:
            return
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        most = gpu.limits["max-storage-buffer-binding-size"] // _VERTEX_BYTES
        if vertices > most:
            raise BudgetError(
                f"pgm: expected a grid of at most {most} vertices, got {vertices}; raise pixels_per_column"
            )
        self._vertices = gpu.buffer("pgm vertices", _VERTEX_BYTES * vertices, "STORAGE", "pgm")
        self._place_group = gpu.bind(
            "pgm place", algorithm.place_layout, {0: self._block, 1: self._integrals, 2: self._vertices}
        )
        self._vertex_group = gpu.bind("pgm vertices", algorithm.module.layout, {0: self._block, 2: self._vertices})
        if self._bound:
            self._bound.make_room(self._block, self._vertices, vertices)

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Find what the grid has to cover, and place its vertices there."""
        algorithm = self._algorithm
        settings, gpu = algorithm.settings, algorithm.clipmap.gpu
        # before the first data has come there is nothing to draw
        columns, rows = settings.cells(frame.lod_size)
        present = algorithm.clipmap.heights.present
        outline = find_outline(frame, settings.tailoring) if present else None
        if outline is None:
            self._statistics = Statistics()
            return []
        self._make_room(columns, rows)
        gpu.write(self._block, grid_block(frame, settings, outline))
        each = settings.vertices_per_row(columns)
        gpu.write(self._arguments, np.array([each, rows, 0, 0], np.uint32))
        if algorithm.warp is not None:
            run = timer.compute_pass(encoder, "warp")
            run.set_pipeline(algorithm.warp)
            run.set_bind_group(0, view.bind_group)
            run.set_bind_group(1, self._warp_group)
            run.dispatch_workgroups(_IMAGE_COLUMNS)
            run.end()
        run = timer.compute_pass(encoder, "place")
        run.set_pipeline(algorithm.place)
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._place_group)
        run.dispatch_workgroups(columns // _GROUP + 1, rows // _GROUP + 1)
        run.end()
        self._statistics = Statistics(triangles=(each - 2) * rows, patches=1, draws=1)
        grid = Patches(algorithm.module, self._vertex_group, self._arguments)
        if not self._bound:
            return [grid]
        prisms, rays = self._bound.record(encoder, timer, frame, view, columns * rows, settings.max_error)
        # the prisms first, so that they win where they touch the grid
        return [prisms, grid, rays]

    def statistics(self) -> Statistics:
        """The grid is one patch, as is every prism around a cell that is ray cast."""
        drawn = self._statistics
        if not self._bound or not drawn.draws:
            return drawn
        prisms, rays = self._bound.counts()
        return Statistics(drawn.triangles + PRISM_TRIANGLES * prisms, 1 + prisms, 3, rays)


class Pgm(Algorithm):
    """One grid, projected onto the ground from an auxiliary camera in every frame."""

    name = "pgm"
    Settings = Settings
    detail = Detail(setting="pixels_per_column", finest=1.5, coarsest=64.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        constants = {
            "WARPING": WARPING.index(settings.warping),
            "TAILORING": TAILORING.index(settings.tailoring),
            "TESSELLATION": TESSELLATION.index(settings.tessellation),
            "EDGE_SEARCH": settings.edge_search,
            "BORDER_POINTS": BORDER_POINTS,
        }
        uniform, read, storage = ("COMPUTE", "uniform"), ("COMPUTE", "read"), ("COMPUTE", "storage")
        self.warp_layout = gpu.layout("pgm warp", {0: uniform, 1: storage})
        self.place_layout = gpu.layout("pgm place", {0: uniform, 1: read, 2: storage})
        stages = "VERTEX|COMPUTE"
        layout = gpu.layout("pgm vertices", {0: (stages, "uniform"), 2: (stages, "read")})
        self.module = Module(FOLDER / "vertex.wgsl", layout, constants)

        def kernel(name: str, entry: str, bindings: Any) -> Any:
            shader = gpu.shader(
                f"pgm {name}", FOLDER / f"{name}.wgsl", search=[FOLDER, *SEARCH],
                constants={**clipmap.constants, **constants},
            )  # fmt: skip
            return gpu.compute(f"pgm {name}", shader, entry, [clipmap.layout, bindings])

        self.warp = kernel("warp", "integrate", self.warp_layout) if settings.warping == "importance" else None
        self.place = kernel("place", "place_vertices", self.place_layout)
        self.bound = Bound(clipmap, constants, kernel) if settings.max_error is not None else None

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def grid_block(frame: Frame, settings: Settings, outline: Outline) -> NDArray[np.void]:
    """The uniform block of pgm.wgsl (0-dimensional)."""
    block = np.zeros((), _BLOCK)
    columns, rows = settings.cells(frame.lod_size)
    ground = frame.ground_height * frame.exaggeration - frame.camera.z
    # a fraction of a texel over the ground is the ground: cells are small enough there
    altitude = max(abs(float(frame.lod_eye()[2]) - ground), frame.grid.spacing / 64)
    block["columns"], block["rows"] = columns, rows
    block["left_count"], block["right_count"] = len(outline.left), len(outline.right)
    block["left_data"], block["right_data"] = outline.left_data, outline.right_data
    block["along"], block["ends"], block["depths"] = directions(frame)[0], outline.rows, outline.depths
    block["slopes"], block["stretch"] = outline.columns, [math.asinh(s / altitude) for s in outline.rows]
    block["altitude"] = altitude
    block["cell_angle"] = frame.lod_size[0] / columns / frame.pixels_per_radian(frame.lod)
    block["edge_reach"] = settings.edge_distance * frame.grid.spacing
    block["borders"][: len(outline.left), 0], block["borders"][: len(outline.right), 1] = outline.left, outline.right
    return block
