"""Uniform Distance-Dependent Level of Detail; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import FrameTimer, Texture
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.mesh import Mesh, grid_triangles
from orogen.lod.tiles import DRAWS, Refinement, TileList, check_tiles, draws_in_compute
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

OCCLUDING = 1 << 16
"""Samples along a side of the data from which on hidden tiles are left out where nobody says whether they should be."""
CHEAP_QUAD = 2.0
"""Pixels of a quad from which on drawing hidden ones in compute takes less time than finding them."""
WORTH = {True: 1 << 14, False: 1 << 8}
"""Tiles that have to be found hidden for that to take less time than drawing them, by whether that is in compute."""


@dataclass(frozen=True)
class Settings:
    """Parameters of Kuehnert 2022, table 1."""

    grid_size: int = 16
    """Rows and columns of quads in a tile: an even number from 2 to 64."""
    pixels_per_quad: float = 4.0
    """Greatest width of a quad in pixels where it is seen face on, above 0; quads are drawn down to half of it."""
    tile_scale: float | None = None
    """Width of a tile in pixels, instead of pixels_per_quad: tile_scale = grid_size * pixels_per_quad (section 6.3)."""
    morph_range: float = 0.2
    """Share of a level's range in which its vertices move to those of the next level, above 0 and below 0.5."""
    tile_capacity: int = 1 << 14
    """Tiles that there is room for at first; grows when a frame needs more."""
    occlusion: bool | None = None
    """Whether tiles that others hide are left out; the picture is the same. None: where the data is more than 65536
    samples long, whose far tiles are many and mostly hidden, with rests while few are; where triangles are drawn in
    compute, only if quads are smaller than 2 pixels."""

    def __post_init__(self) -> None:
        check_tiles(self)
        if self.tile_scale is not None and not self.tile_scale > 0:
            raise SettingsError(f"tile_scale: expected a number of pixels above 0, got {self.tile_scale}")

    @property
    def quad_pixels(self) -> float:
        """pixels_per_quad, or what tile_scale makes of it."""
        return self.pixels_per_quad if self.tile_scale is None else self.tile_scale / self.grid_size


class View(AlgorithmView):
    """The tiles of one view."""

    def __init__(self, algorithm: Udlod) -> None:
        self._algorithm = algorithm
        self._list = TileList(algorithm.refinement)
        self._draws: list[Patches] = []
        self._bound = 0

    def _bind(self) -> None:
        """Draws of as many tiles as the list has room for."""
        if self._bound == self._list.capacity:
            return
        self._bound = self._list.capacity
        algorithm = self._algorithm
        self._draws = []
        for tiles, offset in zip((self._list.tiles, self._list.revealed), DRAWS, strict=True):
            group = algorithm.clipmap.gpu.bind("udlod tiles", algorithm.module.layout, {0: self._list.block, 1: tiles})
            draw = Patches(algorithm.module, group, self._list.state, "triangle-list", algorithm.index, offset)
            self._draws.append(draw)

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Refine the tile list, level by level from the root, and draw what the frame before does not hide."""
        self._list.keep_up()
        self._bind()
        run = timer.compute_pass(encoder, "refine")
        run.set_bind_group(0, view.bind_group)
        self._list.record(run, frame)
        run.end()
        if not self._list.occludes:
            self._list.watch(encoder)
        return self._draws[:1]

    def drawn(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView, depth: Texture) -> Sequence[Draw]:
        """Draw what the frame before would hide and this one does not."""
        if not self._list.occludes:
            return ()
        self._list.see(encoder, timer, frame, view, depth)
        run = timer.compute_pass(encoder, "reveal")
        run.set_bind_group(0, view.bind_group)
        self._list.reveal(run)
        run.end()
        self._list.watch(encoder)
        return self._draws[1:]

    def statistics(self) -> Statistics:
        """Tiles as patches; two triangles a quad."""
        tiles, draws = self._list.count(), 1 + self._list.occludes
        return Statistics(triangles=2 * tiles * self._algorithm.settings.grid_size**2, patches=tiles, draws=draws)

    def incomplete(self) -> bool:
        """Whether tiles found no room; makes room for twice as many. Raises BudgetError where that cannot be had."""
        return self._list.incomplete()


class Udlod(Algorithm):
    """Tiles of equal size on screen, refined on the GPU and morphed into one another."""

    name = "udlod"
    Settings = Settings
    detail = Detail("pixels_per_quad", 0.5, 256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        cheap, occlusion = draws_in_compute(gpu), settings.occlusion
        if occlusion is None:
            dear = settings.quad_pixels < CHEAP_QUAD or not cheap
            occlusion = dear and max(clipmap.grid.shape) > OCCLUDING
        self.refinement = Refinement(
            clipmap, self.name, settings, settings.quad_pixels, sift=not cheap, occlusion=occlusion,
            worth=WORTH[cheap] if settings.occlusion is None else 0,
        )  # fmt: skip
        stages = "VERTEX|COMPUTE"
        size = settings.grid_size
        self.module = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("udlod tiles", {0: (stages, "uniform"), 1: (stages, "read")}),
            {"COLUMNS": size + 1},
        )
        self.index = Mesh(gpu, [grid_triangles(size, size)], "udlod")

    def view(self) -> View:
        """State for one more view."""
        return View(self)
