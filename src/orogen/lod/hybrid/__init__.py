"""Triangles or rays, whichever is cheaper for a tile; see README.md in this folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer, Readback
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Rays, Statistics
from orogen.lod.hybrid.choice import BLOCK, Costs, choice_block
from orogen.lod.mesh import Mesh, grid_triangles
from orogen.lod.tiles import TILE, Refinement, TileList, check_tiles
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

_COUNTS = np.dtype([(name, "u4") for name in ("tiles", "triangles", "rays", "steps")])
_PIXELS = np.dtype([("entry", "u4"), ("rays", "u4")])
STEP_UNIT = 64
"""Steps that a count of counts.wgsl stands for."""
_BLOCK_SIDE = 8
"""Pixels along a block of blocks.wgsl."""
_CHOOSE, _MARK, _DRAW, _ARGUMENTS = 0, 16, 32, 52
"""Bytes before the arguments of each pass in their buffer, and its length; see prepare.wgsl."""


@dataclass(frozen=True)
class Settings:
    """The tiles of Kuehnert 2022, table 1, and what they cost."""

    grid_size: int = 16
    """Rows and columns of quads in a tile: an even number from 2 to 64."""
    pixels_per_quad: float = 4.0
    """Greatest width of a quad in pixels where it is seen face on, above 0; quads are drawn down to half of it."""
    cost_triangle: float = 8.0
    """What a triangle costs, 0 or more, in the unit of cost_step; 0 makes every tile triangles."""
    cost_step: float = 1.0
    """What a step of a ray's traversal costs, 0 or more, in the unit of cost_triangle; 0 makes every tile rays."""
    calibrate: bool = False
    """Learn both costs, as nanoseconds, from the times of the frames drawn; pictures then depend on these times."""
    morph_range: float = 0.2
    """Share of a level's range in which its vertices move to those of the next level, above 0 and below 0.5."""
    tile_capacity: int = 1 << 14
    """Tiles that there is room for at first; grows when a frame needs more."""

    def __post_init__(self) -> None:
        check_tiles(self)
        for name in ("cost_triangle", "cost_step"):
            if not (getattr(self, name) >= 0 and math.isfinite(getattr(self, name))):
                raise SettingsError(f"{name}: expected a number of 0 or more, got {getattr(self, name)}")
        if not self.cost_triangle + self.cost_step > 0:
            raise SettingsError("cost_triangle, cost_step: expected one of them above 0, got 0 for both")


class View(AlgorithmView):
    """The tiles of one view, and the pixels in which rays are cast."""

    def __init__(self, algorithm: Hybrid) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        self._list = TileList(algorithm.refinement)
        self._choice = gpu.buffer("hybrid choice", BLOCK.itemsize, "UNIFORM|COPY_DST", "hybrid")
        self._counts = gpu.buffer("hybrid counts", _COUNTS.itemsize, "STORAGE|COPY_SRC", "hybrid")
        self._arguments = gpu.buffer("hybrid arguments", _ARGUMENTS, "STORAGE|INDIRECT|COPY_SRC", "hybrid")
        self._arguments_group = gpu.bind(
            "hybrid arguments", algorithm.arguments_layout, {0: self._arguments, 1: self._counts}
        )
        self.costs = Costs(algorithm.settings.cost_triangle, algorithm.settings.cost_step)
        """What the tiles of the next frame are chosen by."""
        self._counted: Readback | None = None
        self._blocks: Buffer | None = None
        self._bound: tuple[int, int] = (0, 0)

    def _bind(self, size: tuple[int, int]) -> None:
        """Buffers and groups for pictures of a size and for as many tiles as the list has room for."""
        width, height = (-(-side // _BLOCK_SIDE) for side in size)
        bound = self._list.capacity, width * height
        if bound == self._bound:
            return
        self._bound = bound
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        if self._blocks is None or self._blocks.size != _PIXELS.itemsize * width * height:
            usage = "STORAGE|COPY_DST|COPY_SRC"
            self._blocks = gpu.buffer("hybrid blocks", _PIXELS.itemsize * width * height, usage, "hybrid")
            self._cast_group = gpu.bind("hybrid rays", algorithm.rays.layout, {0: self._blocks})
        chosen = gpu.buffer("hybrid chosen tiles", TILE * self._list.capacity, "STORAGE|COPY_SRC", "hybrid")
        self._chosen = chosen
        block = self._list.block
        self._choose_group = gpu.bind(
            "hybrid choose",
            algorithm.choose_layout,
            {0: block, 1: self._choice, 2: self._list.tiles, 3: chosen, 4: self._counts},
        )
        self._mark_group = gpu.bind(
            "hybrid mark", algorithm.mark_layout, {0: block, 1: chosen, 2: self._counts, 3: self._blocks}
        )
        self._vertex_group = gpu.bind("hybrid tiles", algorithm.triangles.layout, {0: block, 1: chosen})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Refine the tiles, choose triangles or rays for each, and mark the pixels that rays may be needed in."""
        algorithm = self._algorithm
        self._list.keep_up()
        if algorithm.settings.calibrate:
            self._learn(timer)
        self._bind(frame.size)
        assert self._blocks is not None
        algorithm.clipmap.gpu.write(self._choice, choice_block(frame, self.costs))
        encoder.clear_buffer(self._blocks.raw)
        run = timer.compute_pass(encoder, "refine")
        run.set_bind_group(0, view.bind_group)
        self._list.record(run, frame)
        run.set_bind_group(2, self._arguments_group)
        run.set_pipeline(algorithm.prepare_choice)
        run.dispatch_workgroups(1)
        run.end()
        run = timer.compute_pass(encoder, "choose")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._choose_group)
        run.set_pipeline(algorithm.choose)
        run.dispatch_workgroups_indirect(self._arguments.raw, _CHOOSE)
        run.set_bind_group(1, self._list.group)
        run.set_bind_group(2, self._arguments_group)
        run.set_pipeline(algorithm.prepare_draws)
        run.dispatch_workgroups(1)
        run.set_bind_group(1, self._mark_group)
        run.set_pipeline(algorithm.mark)
        run.dispatch_workgroups_indirect(self._arguments.raw, _MARK)
        run.end()
        self._list.watch(encoder)
        if algorithm.settings.calibrate and self._counted is None:
            self._counted = algorithm.clipmap.gpu.read_buffer(self._counts, encoder=encoder)
        return [
            Patches(algorithm.triangles, self._vertex_group, self._arguments, "triangle-list", algorithm.index, _DRAW),
            Rays(algorithm.rays, self._cast_group, replace=True),
        ]

    def _learn(self, timer: FrameTimer) -> None:
        """From the latest times known, and the counts of about the same frame; does not wait for the GPU."""
        times = timer.results()
        if self._counted is None or not self._counted.ready() or not times:
            return
        counts, self._counted = self._counted.result().view(_COUNTS)[0], None
        triangles = 2 * self._algorithm.settings.grid_size**2 * int(counts["triangles"])
        self.costs.learn(times, triangles, STEP_UNIT * int(counts["steps"]))

    def statistics(self) -> Statistics:
        """Tiles of either kind as patches; two triangles a quad; rays that were cast."""
        gpu = self._algorithm.clipmap.gpu
        if self._blocks is None:
            return Statistics()
        counts = gpu.read_buffer(self._counts).result().view(_COUNTS)[0]
        rays = gpu.read_buffer(self._blocks).result().view(_PIXELS)["rays"].sum(dtype=np.int64)
        each = 2 * self._algorithm.settings.grid_size**2
        return Statistics(each * int(counts["triangles"]), int(counts["tiles"]), 2, int(rays))

    def incomplete(self) -> bool:
        """Whether tiles found no room; makes room for twice as many. Raises BudgetError where that cannot be had."""
        return self._list.incomplete()


class Hybrid(Algorithm):
    """Tiles of equal size on screen, each as triangles or by rays."""

    name = "hybrid"
    Settings = Settings
    detail = Detail("pixels_per_quad", 0.5, 256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        read, storage, uniform = ("COMPUTE", "read"), ("COMPUTE", "storage"), ("COMPUTE", "uniform")
        self.refinement = Refinement(clipmap, self.name, settings, settings.pixels_per_quad)
        self.arguments_layout = gpu.layout("hybrid arguments", {0: storage, 1: storage})
        self.choose_layout = gpu.layout("hybrid choose", {0: uniform, 1: uniform, 2: read, 3: storage, 4: storage})
        self.mark_layout = gpu.layout("hybrid mark", {0: uniform, 1: read, 2: read, 3: storage})
        size = settings.grid_size
        self.index = Mesh(gpu, [grid_triangles(size, size)], "hybrid")
        stages = "VERTEX|COMPUTE"
        self.triangles = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("hybrid tiles", {0: (stages, "uniform"), 1: (stages, "read")}),
            {"COLUMNS": size + 1},
        )
        self.rays = Module(FOLDER / "cast.wgsl", gpu.layout("hybrid rays", {0: storage}))

        def kernel(name: str, entry: str, *layouts: Any) -> Any:
            shader = gpu.shader(
                f"hybrid {name}", FOLDER / f"{name}.wgsl", search=[FOLDER, *SEARCH], constants=clipmap.constants
            )
            return gpu.compute(f"hybrid {entry}", shader, entry, [clipmap.layout, *layouts])

        lists = self.refinement.lists_layout, self.arguments_layout
        self.prepare_choice = kernel("prepare", "prepare_choice", *lists)
        self.prepare_draws = kernel("prepare", "prepare_draws", *lists)
        self.choose = kernel("choose", "choose_tiles", self.choose_layout)
        self.mark = kernel("mark", "mark_blocks", self.mark_layout)

    def view(self) -> View:
        """State for one more view."""
        return View(self)
