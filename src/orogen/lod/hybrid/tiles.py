"""The tiles of a frame: a quadtree refined on the GPU, in lists that grow when a frame needs more room."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import BudgetError
from orogen.frame import Frame
from orogen.gpu import Buffer, Readback
from orogen.streaming.clipmap import SEARCH, Clipmap

FOLDER = Path(__file__).parent

_log = logging.getLogger("orogen")

FINEST_QUAD = 64
"""A texel is split into at most this many quads a side: below that the bilinear surface is flat to a thousandth."""

_WATCHED = 8
"""Every so many frames the tile count is read back: that costs as much as an eighth of recording a frame."""
_GROUP = 256
"""Invocations of a workgroup of refine.wgsl."""
_MOST_GROUPS = 4095
"""Workgroups of a dispatch that refine.wgsl can count."""
_TOP_LEVELS = 5
"""Levels that its first dispatch refines."""
_TEMPORARY, TILE = 24, 16
"""Bytes of a tile of capacity in the temporary list, and of a final tile."""

_STATE = np.dtype([(name, "u4") for name in ("parents", "progress", "finals", "backwards", "overflow", "tiles")])
_BLOCK = np.dtype(
    [
        ("grid_size", "u4"),
        ("leaf", "u4"),
        ("root_level", "u4"),
        ("tile_capacity", "u4"),
        ("split_distance", "f4"),
        ("morph_range", "f4"),
        ("padding", "u4", 2),
    ]
)


class Refinement:
    """Kernels that make the list of tiles, shared by all views."""

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        self.clipmap = clipmap
        self.settings = settings
        gpu = clipmap.gpu
        storage, uniform = ("COMPUTE", "storage"), ("COMPUTE", "uniform")
        self.lists_layout = gpu.layout("hybrid lists", {0: uniform, 1: storage, 2: storage, 3: storage})
        self.groups_layout = gpu.layout("hybrid dispatch", {0: storage})
        shader = gpu.shader(
            "hybrid refine", FOLDER / "refine.wgsl", search=[FOLDER, *SEARCH], constants=clipmap.constants
        )
        layouts = [clipmap.layout, self.lists_layout, self.groups_layout]
        self.top = gpu.compute("hybrid top", shader, "refine_top", layouts)
        self.level = gpu.compute("hybrid refine", shader, "refine_tiles", layouts)


class TileList:
    """The tiles of one view."""

    def __init__(self, refinement: Refinement) -> None:
        self._refinement = refinement
        gpu = refinement.clipmap.gpu
        self.block: Buffer = gpu.buffer("hybrid", _BLOCK.itemsize, "UNIFORM|COPY_DST", "hybrid")
        """The uniform block of tiles.wgsl."""
        self._state = gpu.buffer("hybrid state", _STATE.itemsize, "STORAGE|COPY_SRC", "hybrid")
        # in turn: what a dispatch takes its arguments from must not be bound for writing
        self._dispatches = [gpu.buffer("hybrid dispatch", 12, "STORAGE|INDIRECT", "hybrid") for _ in range(2)]
        self._dispatch_groups = [
            gpu.bind("hybrid dispatch", refinement.groups_layout, {0: buffer}) for buffer in self._dispatches
        ]
        self._written = b""
        self._watch: tuple[int, Readback] | None = None
        self._frames = 0
        self._fits = False
        self.capacity = 0
        """Tiles that there is room for."""
        self._grow(refinement.settings.tile_capacity)

    def _grow(self, capacity: int) -> None:
        gpu = self._refinement.clipmap.gpu
        most = min(gpu.limits["max-storage-buffer-binding-size"] // _TEMPORARY, _GROUP * _MOST_GROUPS)
        if capacity > most:
            raise BudgetError(f"hybrid: expected room for at most {most} tiles, got {capacity}; raise pixels_per_quad")
        temporary = gpu.buffer("hybrid temporary tiles", _TEMPORARY * capacity, "STORAGE", "hybrid")
        self.tiles = gpu.buffer("hybrid tiles", TILE * capacity, "STORAGE", "hybrid")
        """The final tiles of refine.wgsl."""
        self.capacity = capacity
        self.group = gpu.bind(
            "hybrid lists",
            self._refinement.lists_layout,
            {0: self.block, 1: self._state, 2: temporary, 3: self.tiles},
        )
        """Bind group 1 of the kernels that know the state of refinement."""

    def record(self, run: Any, frame: Frame) -> None:
        """Refine, level by level from the root; `run` has the clipmap's bind group."""
        refinement = self._refinement
        block = lattice(frame, refinement.settings, self.capacity)
        if block.tobytes() != self._written:
            self._written = block.tobytes()
            refinement.clipmap.gpu.write(self.block, block)
        run.set_bind_group(1, self.group)
        run.set_bind_group(2, self._dispatch_groups[0])
        run.set_pipeline(refinement.top)
        run.dispatch_workgroups(1)
        run.set_pipeline(refinement.level)
        for level in range(passes(frame, block) - _TOP_LEVELS):
            run.set_bind_group(2, self._dispatch_groups[1 - level % 2])
            run.dispatch_workgroups_indirect(self._dispatches[level % 2].raw, 0)

    def watch(self, encoder: Any) -> None:
        """Have the state read back now and then, after the frame's passes."""
        self._frames += 1
        if self._watch is None and (self._frames % _WATCHED == 1 or not self._fits):
            readback = self._refinement.clipmap.gpu.read_buffer(self._state, encoder=encoder)
            self._watch = self.capacity, readback

    def keep_up(self) -> None:
        """Make room where an earlier frame is known to have lacked it, without waiting for the GPU."""
        if self._watch is None or not self._watch[1].ready():
            return
        (capacity, state), self._watch = self._watch, None
        self._fits = not state.result().view(_STATE)[0]["overflow"]
        if not self._fits and capacity == self.capacity:
            try:
                self._grow(2 * capacity)
            except BudgetError as error:
                _log.debug("drawn coarser than asked for: %s", error)

    def incomplete(self) -> bool:
        """Whether tiles found no room; makes room for twice as many. Raises BudgetError where that cannot be had."""
        state = self._refinement.clipmap.gpu.read_buffer(self._state).result().view(_STATE)[0]
        if not state["overflow"]:
            return False
        self._grow(2 * self.capacity)
        return True


def passes(frame: Frame, block: NDArray[np.void]) -> int:
    """How many levels, from the root's on, can have tiles: none is nearer to the LOD eye than the ground under it."""
    above = abs(float(frame.lod_eye()[2]) + frame.camera.z - frame.ground_height * frame.exaggeration)
    root_level = int(block["root_level"])
    # a tile of level l is split within split_distance 2^(l - 1) of the eye, give or take rounding
    split = [above < 1.001 * float(block["split_distance"]) * 2.0 ** (level - 1) for level in range(root_level, 0, -1)]
    return 1 + (split.index(False) if False in split else root_level)


def lattice(frame: Frame, settings: Any, capacity: int) -> NDArray[np.void]:
    """The uniform block of tiles.wgsl (0-dimensional): lattice of tiles and the distances at which they are split."""
    bits = frame.subtexel_bits
    leaf = max(1, (1 << bits) // FINEST_QUAD)
    longest = (max(frame.grid.shape) - 1) << bits
    tile = settings.grid_size * leaf
    root_level = max(0, int(np.ceil(np.log2(max(longest, 1) / tile))))
    # the longer side, where texels are not square
    texel_metres = float(np.linalg.norm(frame.grid.metres, axis=0).max())
    quad_metres = texel_metres * leaf / (1 << bits)
    # neighbours differ by one level at most, and morphs do not overlap, only while a tile's diagonal fits between the
    # ends of two morphs: sqrt(2) * tile < (1 - 2 * morph_range) * range
    corners = frame.grid.metres @ np.array([[1.0, 1.0], [1.0, -1.0]])
    diagonal = float(np.linalg.norm(corners, axis=0).max()) / texel_metres * settings.grid_size
    reach = max(
        frame.pixels_per_radian(frame.lod) / settings.pixels_per_quad,
        1.01 * diagonal / (1 - 2 * settings.morph_range),
    )
    block = np.zeros((), _BLOCK)
    block["grid_size"], block["leaf"], block["root_level"] = settings.grid_size, leaf, root_level
    block["tile_capacity"], block["morph_range"] = capacity, settings.morph_range
    block["split_distance"] = 2 * quad_metres * reach
    return block
