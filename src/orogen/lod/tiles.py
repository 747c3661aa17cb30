"""The tiles of a frame: a quadtree refined on the GPU, in lists that grow when a frame needs more room."""

from __future__ import annotations

import logging
import struct
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer, Gpu, Readback, Texture
from orogen.grid import Grid
from orogen.lod.occlusion import DepthPyramid, DepthReduction
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

_log = logging.getLogger("orogen")

FINEST_QUAD = 64
"""A texel is split into at most this many quads a side: below that the bilinear surface is flat to a thousandth."""

_REST = 64
"""Frames for which occlusion rests after one in which it hid too little."""
_WATCHED = 8
"""Every so many frames the tile count is read back: that costs as much as an eighth of recording a frame."""
_GROUP = 64
"""Invocations of a workgroup of refine.wgsl, but for the first levels."""
_MOST_GROUPS = 16383
"""Workgroups of a dispatch that refine.wgsl can count."""
_TOP_LEVELS = 5
"""Levels that its first dispatch refines."""
_MOST_DIVISIONS = 3
"""How often a tile that was put aside as hidden has to be divided at most: levels that a second pass may take."""
_TEMPORARY, TILE, _HIDDEN = 24, 16, 12
"""Bytes of a tile of capacity in the temporary list, of a final tile, and of one put aside."""

_DRAW = np.dtype([(name, "u4") for name in ("indices", "tiles", "first_index", "base_vertex", "first_instance")])
_COUNTS = ("parents", "progress", "backwards", "overflow", "tiles", "hidden", "spared")
_STATE = np.dtype([("draws", _DRAW, 2), *((name, "u4") for name in _COUNTS)])
_BLOCK = struct.Struct("<4I2fIf16f")
_NO_HISTORY = (0.0,) * 16

DRAWS = (0, _DRAW.itemsize)
"""Bytes before the arguments of each draw in `TileList.state`: of the final tiles, and of those of `reveal`."""


def check_tiles(settings: Any) -> None:
    """Raise SettingsError where the settings of tiles that algorithms share are out of range."""
    if settings.grid_size % 2 or not 2 <= settings.grid_size <= 64:
        raise SettingsError(f"grid_size: expected an even number from 2 to 64, got {settings.grid_size}")
    if not settings.pixels_per_quad > 0:
        raise SettingsError(f"pixels_per_quad: expected a number above 0, got {settings.pixels_per_quad}")
    if not 0 < settings.morph_range < 0.5:
        raise SettingsError(f"morph_range: expected above 0 and below 0.5, got {settings.morph_range}")
    if settings.tile_capacity < 64:
        raise SettingsError(f"tile_capacity: expected at least 64 tiles, got {settings.tile_capacity}")


def draws_in_compute(gpu: Gpu) -> bool:
    """Whether a GPU is one on which triangles take so little time that few ways of leaving some out pay."""
    return gpu.info.kind != "cpu" and "shader-int64-atomic-min-max" in gpu.features


class Refinement:
    """Kernels that make the list of tiles, shared by all views."""

    def __init__(
        self,
        clipmap: Clipmap,
        name: str,
        settings: Any,
        quad_pixels: float,
        *,
        sift: bool = False,
        occlusion: bool = False,
        worth: int = 0,
    ) -> None:
        """`name`: of the algorithm. `settings` have grid_size, morph_range and tile_capacity.

        `quad_pixels`: greatest width of a quad in pixels where it is seen face on. `sift`: whether tiles of whose
        triangles nothing is seen are found by their samples. `occlusion`: whether tiles that the frame before would
        hide are put aside; when the others are drawn, `TileList.reveal` has to look at them. `worth`: how many tiles
        that has to spare; where it spares fewer, it rests for a while.
        """
        self.clipmap = clipmap
        self.name = name
        self.settings = settings
        self.quad_pixels = quad_pixels
        self.occlusion = occlusion
        self.worth = worth
        gpu = clipmap.gpu
        storage, read, uniform = ("COMPUTE", "storage"), ("COMPUTE", "read"), ("COMPUTE", "uniform")
        lists = {0: uniform, 1: storage, 2: storage, 3: storage, 4: read, 5: storage}
        self.lists_layout = gpu.layout(f"{name} lists", lists)
        self.groups_layout = gpu.layout(f"{name} dispatch", {0: storage})
        constants = {**clipmap.constants, "MOST_DIVISIONS": _MOST_DIVISIONS, "SIFT": sift, "GROUP": _GROUP}
        shader = gpu.shader(f"{name} refine", FOLDER / "refine.wgsl", search=SEARCH, constants=constants)
        layouts = [clipmap.layout, self.lists_layout, self.groups_layout]

        def kernel(entry: str) -> Any:
            return gpu.compute(f"{name} {entry}", shader, entry, layouts)

        self.top, self.level = kernel("refine_top"), kernel("refine_tiles")
        self.depths = DepthReduction(clipmap, name)
        if occlusion:
            self.start, self.first, self.following = map(kernel, ("start_reveal", "reveal_hidden", "reveal_tiles"))


class TileList:
    """The tiles of one view."""

    def __init__(self, refinement: Refinement) -> None:
        self._refinement = refinement
        self._name = name = refinement.name
        gpu = refinement.clipmap.gpu
        self.block: Buffer = gpu.buffer(name, _BLOCK.size, "UNIFORM|COPY_DST", name)
        """The uniform block of tiles.wgsl."""
        self.state: Buffer = gpu.buffer(f"{name} state", _STATE.itemsize, "STORAGE|INDIRECT|COPY_SRC", name)
        """The counts of refine.wgsl, with the arguments of indexed draws of the tiles at `DRAWS`."""
        # in turn: what a dispatch takes its arguments from must not be bound for writing
        self._dispatches = [gpu.buffer(f"{name} dispatch", 12, "STORAGE|INDIRECT", name) for _ in range(2)]
        self._dispatch_groups = [
            gpu.bind(f"{name} dispatch", refinement.groups_layout, {0: buffer}) for buffer in self._dispatches
        ]
        self._depths = DepthPyramid(refinement.depths)
        self._written = b""
        self._watch: tuple[int, bool, Readback] | None = None
        self._frames = 0
        self._fits = False
        self._rest = 0  # frames without occlusion to come
        self._judges = False  # whether the latest frame tells what occlusion is worth
        self._judged = False  # whether one has since the last rest
        self.occludes = False
        """Whether the latest frame's hidden tiles are put aside."""
        self.capacity = 0
        """Tiles that there is room for."""
        self._grow(refinement.settings.tile_capacity)

    def _grow(self, capacity: int) -> None:
        gpu, name = self._refinement.clipmap.gpu, self._name
        most = min(gpu.limits["max-storage-buffer-binding-size"] // _TEMPORARY, _GROUP * _MOST_GROUPS)
        if capacity > most:
            raise BudgetError(f"{name}: expected room for at most {most} tiles, got {capacity}; raise pixels_per_quad")
        self._temporary = gpu.buffer(f"{name} temporary tiles", _TEMPORARY * capacity, "STORAGE", name)
        self.tiles = gpu.buffer(f"{name} tiles", TILE * capacity, "STORAGE", name)
        """The final tiles of refine.wgsl."""
        room = capacity if self._refinement.occlusion else 1
        self.revealed = gpu.buffer(f"{name} revealed tiles", TILE * room, "STORAGE", name)
        """The final tiles of `reveal`."""
        self._hidden = gpu.buffer(f"{name} hidden tiles", _HIDDEN * room, "STORAGE", name)
        self.capacity = capacity
        self._bind()

    def _bind(self) -> None:
        self.group, self._reveal_group = (
            self._refinement.clipmap.gpu.bind(
                f"{self._name} lists",
                self._refinement.lists_layout,
                {0: self.block, 1: self.state, 2: self._temporary, 3: tiles, 4: self._depths.cells, 5: self._hidden},
            )
            for tiles in (self.tiles, self.revealed)
        )

    def record(self, run: Any, frame: Frame) -> None:
        """Refine, level by level from the root; `run` has the clipmap's bind group."""
        refinement = self._refinement
        settings = refinement.settings
        tiles = lattice(frame, settings, refinement.quad_pixels)
        height = above(frame)
        # depths are those of the camera that looks: one that merely watches a frozen camera says nothing about it
        self.occludes = refinement.occlusion and frame.lod == frame.camera and not self._rest
        self._rest = max(self._rest - 1, 0)
        foreground, history = 1e30, None
        if self.occludes:
            if self._depths.fit(frame.size):
                self._bind()
            # a few times the height above the ground: what hides most of the rest
            foreground = 16 * max(height, frame.grid.spacing)
            history = self._depths.projection(frame)
        self._judges = history is not None
        # only a frame that ends with `reveal` tells what may be put aside in the next
        self._depths.seen = None
        block = _BLOCK.pack(
            settings.grid_size, tiles.leaf, tiles.root_level, self.capacity, tiles.split_distance, settings.morph_range,
            history is not None, foreground, *(history or _NO_HISTORY),
        )  # fmt: skip
        if block != self._written:
            self._written = block
            refinement.clipmap.gpu.write(self.block, block)
        run.set_bind_group(1, self.group)
        run.set_bind_group(2, self._dispatch_groups[0])
        run.set_pipeline(refinement.top)
        run.dispatch_workgroups(1)
        run.set_pipeline(refinement.level)
        for level in range(passes(height, tiles) - _TOP_LEVELS):
            run.set_bind_group(2, self._dispatch_groups[1 - level % 2])
            run.dispatch_workgroups_indirect(self._dispatches[level % 2].raw, 0)

    def see(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView, depth: Texture) -> None:
        """Keep the depths of what has been drawn, for `reveal` and for the next frame."""
        self._depths.build(encoder, timer, frame, view, depth)

    def reveal(self, run: Any) -> None:
        """Refine those of the tiles put aside that are not hidden by what `see` has seen, into `revealed`."""
        refinement = self._refinement
        run.set_bind_group(1, self._reveal_group)
        run.set_bind_group(2, self._dispatch_groups[0])
        run.set_pipeline(refinement.start)
        run.dispatch_workgroups(1)
        for level in range(_MOST_DIVISIONS + 1):
            if level < 2:
                run.set_pipeline(refinement.following if level else refinement.first)
            run.set_bind_group(2, self._dispatch_groups[1 - level % 2])
            run.dispatch_workgroups_indirect(self._dispatches[level % 2].raw, 0)

    def watch(self, encoder: Any) -> None:
        """Have the state read back now and then, after the frame's passes."""
        self._frames += 1
        wanted = not self._fits or (self._judges and not self._judged)
        if self._watch is None and (wanted or self._frames % _WATCHED == 1):
            readback = self._refinement.clipmap.gpu.read_buffer(self.state, encoder=encoder)
            self._watch = self.capacity, self._judges, readback

    def keep_up(self) -> None:
        """Make room where an earlier frame is known to have lacked it, and let occlusion rest where it was of little
        use, without waiting for the GPU.
        """
        if self._watch is None or not self._watch[2].ready():
            return
        (capacity, judges, readback), self._watch = self._watch, None
        state = readback.result().view(_STATE)[0]
        self._judged = judges
        if judges and state["spared"] < self._refinement.worth:
            self._rest, self._judged = _REST, False
        self._fits = not state["overflow"]
        if not self._fits and capacity == self.capacity:
            try:
                self._grow(2 * capacity)
            except BudgetError as error:
                _log.debug("drawn coarser than asked for: %s", error)

    def count(self) -> int:
        """How many tiles the latest frame took; waits for the GPU."""
        return int(self._read_state()["draws"]["tiles"].sum())

    def incomplete(self) -> bool:
        """Whether tiles found no room; makes room for twice as many. Raises BudgetError where that cannot be had."""
        if not self._read_state()["overflow"]:
            return False
        self._grow(2 * self.capacity)
        return True

    def _read_state(self) -> Any:
        return self._refinement.clipmap.gpu.read_buffer(self.state).result().view(_STATE)[0]


class Lattice(NamedTuple):
    """What a frame says of the lattice of tiles."""

    leaf: int
    """Subtexels along a quad of level 0."""
    root_level: int
    """Level whose single tile covers the data."""
    split_distance: float
    """Metres within which a tile of level 1 is split; twice that for level 2 and so on."""


def passes(height: float, tiles: Lattice) -> int:
    """How many levels, from the root's on, can have tiles: none is nearer to the LOD eye than the ground under it.

    `height`: `above` of the frame.
    """
    # a tile of level l is split within split_distance 2^(l - 1) of the eye, give or take rounding
    count, reach = 1, 1.001 * tiles.split_distance * 2.0 ** (tiles.root_level - 1)
    while count <= tiles.root_level and height < reach:
        count, reach = count + 1, reach / 2
    return count


def above(frame: Frame) -> float:
    """Metres of the LOD eye above the ground under it, or below."""
    return abs(frame.lod_place[2] + frame.camera.z - frame.ground_height * frame.exaggeration)


@lru_cache(maxsize=16)
def _texel(grid: Grid) -> tuple[float, float]:
    """Metres along a texel's longer side, and how many of these its longer diagonal is."""
    side = float(np.linalg.norm(grid.metres, axis=0).max())
    corners = grid.metres @ np.array([[1.0, 1.0], [1.0, -1.0]])
    return side, float(np.linalg.norm(corners, axis=0).max()) / side


def lattice(frame: Frame, settings: Any, quad_pixels: float) -> Lattice:
    """The lattice of tiles and the distances at which they are split."""
    bits = frame.subtexel_bits
    leaf = max(1, (1 << bits) // FINEST_QUAD)
    longest = (max(frame.grid.shape) - 1) << bits
    # tiles of level 0 along the data; the root is as many times as wide, to the next power of two
    across = -(-longest // (settings.grid_size * leaf))
    texel_metres, diagonal = _texel(frame.grid)
    # neighbours differ by one level at most, and morphs do not overlap, only while a tile's diagonal fits between the
    # ends of two morphs: sqrt(2) * tile < (1 - 2 * morph_range) * range
    reach = max(
        frame.pixels_per_radian(frame.lod) / quad_pixels,
        1.01 * diagonal * settings.grid_size / (1 - 2 * settings.morph_range),
    )
    return Lattice(leaf, max(across - 1, 0).bit_length(), 2 * texel_metres * leaf / (1 << bits) * reach)
