"""Dynamic mesh refinement from pattern pools, kept from frame to frame; see README.md in this folder."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import FrameTimer, Readback
from orogen.grid import Grid
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.lorenz_doellner.patterns import DEPTH_BITS, pattern_pool
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

MOST_DEPTH = 6
"""Halvings of an edge at most: a pattern then has 4096 triangles."""
MOST_CELLS = 512
"""Cells of the coarse mesh along a side at most: all patterns together then have at most 2^31 triangles."""
USUAL_CELLS = 32
"""Cells along the longer side where nothing else is asked for and the data are not too large."""

_log = logging.getLogger("orogen")

_WATCHED = 8
"""Every so many frames the triangle count is read back."""
_GROUP = 256
_GROUPS = "max-compute-workgroups-per-dimension"
_NUMBER_BITS = 12
_STATE = np.dtype(
    [
        ("draw", "u4", 4),
        ("half", "u4"),
        ("count", "u4"),
        ("source", "u4"),
        ("bias", "u4"),
        ("updates", "u4"),
        ("running", "u4"),
        ("present", "u4"),
        ("lacking", "u4"),
        ("totals", "u4", 8),
    ]
)
_TRIANGLE = np.dtype([("corners", "u4", 3), ("key", "u4")])
_COARSE = np.dtype([("depths", "u4"), ("previous", "u4"), ("available", "u4"), ("base", "u4")])


@dataclass(frozen=True)
class Settings:
    """The coarse mesh, how finely it is refined, and how fast that may go."""

    pixels: float = 4.0
    """Greatest length of a triangle's edge in pixels where it is seen face on, above 0, as far as depth allows."""
    ratio: int = 16
    """Triangles that one triangle of the last mesh may become in a copy, 2 to 4096."""
    coarse: int | None = None
    """Cells of the coarse mesh along its longer side at most, 1 to 512: they are a power of two of samples wide. None:
    32, or as many more as make it possible to reach half the distance of samples."""
    depth: int = MOST_DEPTH
    """Times that an edge of the coarse mesh may be halved, 0 to 6."""
    triangle_capacity: int = 1 << 18
    """Triangles that there is room for at first, at least 64; grows when a frame needs more."""

    def __post_init__(self) -> None:
        if not 0 < self.pixels < np.inf:
            raise SettingsError(f"pixels: expected a number above 0, got {self.pixels}")
        if not 2 <= self.ratio <= 4**MOST_DEPTH:
            raise SettingsError(f"ratio: expected 2 to {4**MOST_DEPTH}, got {self.ratio}")
        if self.coarse is not None and not 1 <= self.coarse <= MOST_CELLS:
            raise SettingsError(f"coarse: expected 1 to {MOST_CELLS} cells, got {self.coarse}")
        if not 0 <= self.depth <= MOST_DEPTH:
            raise SettingsError(f"depth: expected 0 to {MOST_DEPTH} halvings, got {self.depth}")
        if self.triangle_capacity < 64:
            raise SettingsError(f"triangle_capacity: expected at least 64 triangles, got {self.triangle_capacity}")

    @property
    def copies(self) -> int:
        """Copies of the mesh that the finest pattern takes, starting from one triangle."""
        copies = 1
        while self.ratio**copies < 4**self.depth:
            copies += 1
        return copies


class View(AlgorithmView):
    """The intermediate mesh of one view."""

    def __init__(self, algorithm: LorenzDoellner) -> None:
        self._algorithm = algorithm
        rows, columns = algorithm.cells
        self._coarse_count = 2 * rows * columns
        self._edge_count = columns * (rows + 1) + (columns + 1) * rows + columns * rows
        self._edges = self._buffer("edges", 4 * self._edge_count, "STORAGE")
        self._blocks = self._buffer("blocks", 8 * -(-self._coarse_count // _GROUP), "STORAGE")
        self._dispatches = self._buffer("dispatches", 24, "STORAGE|INDIRECT")
        self._dispatch_group = algorithm.clipmap.gpu.bind(
            "lorenz_doellner dispatches", algorithm.dispatch_layout, {0: self._dispatches}
        )
        self._frames = 0
        self._fits = True
        self._watch: tuple[int, Readback] | None = None
        self._grow(max(algorithm.settings.triangle_capacity, self._coarse_count))

    def _buffer(self, label: str, size_or_data: Any, usage: str) -> Any:
        gpu = self._algorithm.clipmap.gpu
        return gpu.buffer(f"lorenz_doellner {label}", size_or_data, usage, "lorenz_doellner")

    def _grow(self, capacity: int) -> None:
        """Make a mesh with room for so many triangles, which begins anew as the coarse mesh."""
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        most = min(
            gpu.limits["max-storage-buffer-binding-size"] // (2 * _TRIANGLE.itemsize), _GROUP * gpu.limits[_GROUPS]
        )
        if capacity > most:
            raise BudgetError(
                f"lorenz_doellner: expected room for at most {most} triangles, got {capacity}; raise pixels"
            )
        mesh = self._buffer("mesh", 2 * _TRIANGLE.itemsize * capacity, "STORAGE|COPY_DST")
        self._capacity = capacity
        whole = np.zeros(self._coarse_count, _TRIANGLE)
        whole["corners"] = pattern_pool(0)[1] * np.uint32(1 << algorithm.settings.depth)
        whole["key"] = np.arange(self._coarse_count) << _NUMBER_BITS
        gpu.write(mesh, whole)
        one_each = np.zeros(self._coarse_count, _COARSE)
        one_each["available"] = 1
        coarse = self._buffer("coarse triangles", one_each, "STORAGE")
        state = np.zeros((), _STATE)
        state["count"] = self._coarse_count
        self._state = self._buffer("state", state, "STORAGE|INDIRECT|COPY_SRC")
        table, triangles = algorithm.pool
        self._select_group = gpu.bind(
            "lorenz_doellner select", algorithm.select_layout, {0: self._state, 1: self._edges, 2: coarse, 3: table}
        )
        self._update_group = gpu.bind(
            "lorenz_doellner update",
            algorithm.update_layout,
            {0: self._state, 1: coarse, 2: self._blocks, 3: table, 4: triangles, 5: mesh},
        )
        self._vertex_group = gpu.bind("lorenz_doellner mesh", algorithm.module.layout, {0: self._state, 1: mesh})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Select patterns, then copy them until they are complete; copies that are not needed do nothing."""
        algorithm = self._algorithm
        self._keep_up()
        run = timer.compute_pass(encoder, "select")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._select_group)
        run.set_pipeline(algorithm.measure_edges)
        run.dispatch_workgroups(-(-self._edge_count // _GROUP))
        run.set_pipeline(algorithm.select_patterns)
        run.dispatch_workgroups(-(-self._coarse_count // _GROUP))
        run.end()
        run = timer.compute_pass(encoder, "update")
        run.set_bind_group(0, self._update_group)
        # growing and copying do not read group 1: what they take their arguments from must not be bound for writing
        run.set_bind_group(1, self._dispatch_group)
        run.set_pipeline(algorithm.begin_update)
        run.dispatch_workgroups(1)
        for _ in range(algorithm.settings.copies):
            run.set_pipeline(algorithm.grow_patterns)
            run.dispatch_workgroups_indirect(self._dispatches.raw, 0)
            run.set_pipeline(algorithm.place_blocks)
            run.dispatch_workgroups(1)
            run.set_pipeline(algorithm.copy_patterns)
            run.dispatch_workgroups_indirect(self._dispatches.raw, 12)
        run.end()
        self._frames += 1
        if self._watch is None and (self._frames % _WATCHED == 1 or not self._fits):
            self._watch = self._capacity, algorithm.clipmap.gpu.read_buffer(self._state, encoder=encoder)
        return [Patches(algorithm.module, self._vertex_group, self._state, "triangle-list")]

    def _keep_up(self) -> None:
        """Make room where an earlier frame is known to have lacked it, without waiting for the GPU."""
        if self._watch is None or not self._watch[1].ready():
            return
        (capacity, state), self._watch = self._watch, None
        wanted = int(state.result().view(_STATE)[0]["totals"][0])
        self._fits = wanted <= capacity
        if wanted > self._capacity:
            try:
                self._grow(_room(wanted))
            except BudgetError as error:
                _log.debug("drawn coarser than asked for: %s", error)

    def read_state(self) -> Any:
        """What the latest frame left: `count` triangles after `updates` copies, and more; waits for the GPU."""
        return self._algorithm.clipmap.gpu.read_buffer(self._state).result().view(_STATE)[0]

    def statistics(self) -> Statistics:
        """Coarse triangles as patches."""
        drawn = int(self.read_state()["draw"][0]) // 3
        return Statistics(triangles=drawn, patches=self._coarse_count if drawn else 0, draws=1)

    def incomplete(self) -> bool:
        """Whether triangles found no room; makes room. Raises BudgetError where that cannot be had."""
        wanted = int(self.read_state()["totals"][0])
        if wanted <= self._capacity:
            return False
        self._grow(_room(wanted))
        return True


class LorenzDoellner(Algorithm):
    """A coarse mesh whose triangles are replaced by patterns, copied from frame to frame on the GPU."""

    name = "lorenz_doellner"
    Settings = Settings
    detail = Detail("pixels", finest=0.5, coarsest=256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        bits = cell_bits(clipmap.grid, settings.coarse, settings.depth)
        self.cells = coarse_cells(clipmap.grid, bits)
        """Rows and columns of the coarse mesh."""
        self.pool = [
            gpu.buffer(f"lorenz_doellner {label}", data, "STORAGE", "lorenz_doellner")
            for label, data in zip(("access table", "patterns"), pattern_pool(settings.depth), strict=True)
        ]
        """Access table and triangles of the pattern pool, which all views share."""
        storage, read = ("COMPUTE", "storage"), ("COMPUTE", "read")
        self.select_layout = gpu.layout("lorenz_doellner select", {0: storage, 1: storage, 2: storage, 3: read})
        self.update_layout = gpu.layout(
            "lorenz_doellner update", {0: storage, 1: storage, 2: storage, 3: read, 4: read, 5: storage}
        )
        self.dispatch_layout = gpu.layout("lorenz_doellner dispatches", {0: storage})
        rows, columns = self.cells
        constants = {
            "COLUMNS": columns, "ROWS": rows, "DEPTH": settings.depth, "RATIO": settings.ratio, "GROUP": _GROUP,
            "CELL_BITS": bits, "PIXELS": settings.pixels, "DEPTH_BITS": DEPTH_BITS, "NUMBER_BITS": _NUMBER_BITS,
        }  # fmt: skip
        shown = ("VERTEX|COMPUTE", "read")
        layout = gpu.layout("lorenz_doellner mesh", {0: shown, 1: shown})
        self.module = Module(FOLDER / "vertex.wgsl", layout, constants)
        search, constants = [FOLDER, *SEARCH], {**clipmap.constants, **constants}
        select = gpu.shader("lorenz_doellner select", FOLDER / "select.wgsl", search=search, constants=constants)
        update = gpu.shader("lorenz_doellner update", FOLDER / "update.wgsl", search=search, constants=constants)
        layouts = [clipmap.layout, self.select_layout]
        self.measure_edges = gpu.compute("lorenz_doellner edges", select, "measure_edges", layouts)
        self.select_patterns = gpu.compute("lorenz_doellner patterns", select, "select_patterns", layouts)
        both = [self.update_layout, self.dispatch_layout]
        self.begin_update = gpu.compute("lorenz_doellner begin", update, "begin_update", both)
        self.grow_patterns = gpu.compute("lorenz_doellner grow", update, "grow_patterns", both[:1])
        self.place_blocks = gpu.compute("lorenz_doellner place", update, "place_blocks", both)
        self.copy_patterns = gpu.compute("lorenz_doellner copy", update, "copy_patterns", both[:1])

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def cell_bits(grid: Grid, cells: int | None, depth: int) -> int:
    """log2 of the samples along a cell's side, so that there are `cells` at most along the grid's longer side."""
    longer = max(grid.shape) - 1
    # the finest triangles then reach half the distance of samples
    most = cells or min(max(USUAL_CELLS, -(-2 * longer >> depth)), MOST_CELLS)
    bits = 0
    while most << bits < longer:
        bits += 1
    return bits


def coarse_cells(grid: Grid, bits: int) -> tuple[int, int]:
    """Rows and columns of cells of 2**bits samples, one at least."""
    return max(1, -(-(grid.height - 1) >> bits)), max(1, -(-(grid.width - 1) >> bits))


def _room(triangles: int) -> int:
    """Capacity for so many triangles, with some more for the next frame."""
    return 1 << int(triangles + triangles // 8).bit_length()
