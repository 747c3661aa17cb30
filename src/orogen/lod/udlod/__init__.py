"""Uniform Distance-Dependent Level of Detail; see README.md in this folder."""

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
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.mesh import Mesh, grid_triangles
from orogen.streaming.clipmap import SEARCH, Clipmap, ClipmapView

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

    def __post_init__(self) -> None:
        if self.grid_size % 2 or not 2 <= self.grid_size <= 64:
            raise SettingsError(f"grid_size: expected an even number from 2 to 64, got {self.grid_size}")
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if self.tile_scale is not None and not self.tile_scale > 0:
            raise SettingsError(f"tile_scale: expected a number of pixels above 0, got {self.tile_scale}")
        if not 0 < self.morph_range < 0.5:
            raise SettingsError(f"morph_range: expected above 0 and below 0.5, got {self.morph_range}")
        if self.tile_capacity < 64:
            raise SettingsError(f"tile_capacity: expected at least 64 tiles, got {self.tile_capacity}")

    @property
    def quad_pixels(self) -> float:
        """pixels_per_quad, or what tile_scale makes of it."""
        return self.pixels_per_quad if self.tile_scale is None else self.tile_scale / self.grid_size


class View(AlgorithmView):
    """The tile lists of one view."""

    def __init__(self, algorithm: Udlod) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        self._block = gpu.buffer("udlod", _BLOCK.itemsize, "UNIFORM|COPY_DST", "udlod")
        self._state = gpu.buffer("udlod state", _STATE.itemsize, "STORAGE|COPY_SRC", "udlod")
        # in turn: what a dispatch takes its arguments from must not be bound for writing
        self._dispatches = [gpu.buffer("udlod dispatch", 12, "STORAGE|INDIRECT", "udlod") for _ in range(2)]
        self._draw = gpu.buffer("udlod draw", 20, "STORAGE|INDIRECT|COPY_SRC", "udlod")
        self._dispatch_groups = [
            gpu.bind("udlod dispatch", algorithm.arguments_layout, {0: buffer}) for buffer in self._dispatches
        ]
        self._draw_group = gpu.bind("udlod draw", algorithm.arguments_layout, {0: self._draw})
        self._written: bytes = b""
        self._watch: tuple[int, Readback] | None = None
        self._frames = 0
        self._fits = False
        self._grow(algorithm.settings.tile_capacity)

    def _grow(self, capacity: int) -> None:
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        most = min(gpu.limits["max-storage-buffer-binding-size"] // 24, _GROUP * _MOST_GROUPS)
        if capacity > most:
            raise BudgetError(f"udlod: expected room for at most {most} tiles, got {capacity}; raise pixels_per_quad")
        temporary = gpu.buffer("udlod temporary tiles", 24 * capacity, "STORAGE", "udlod")
        tiles = gpu.buffer("udlod tiles", 16 * capacity, "STORAGE", "udlod")
        self._capacity = capacity
        self._lists_group = gpu.bind(
            "udlod lists", algorithm.lists_layout, {0: self._block, 1: self._state, 2: temporary, 3: tiles}
        )
        self._vertex_group = gpu.bind("udlod tiles", algorithm.module.layout, {0: self._block, 1: tiles})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Refine the tile list, level by level from the root."""
        algorithm = self._algorithm
        self._keep_up()
        block = lattice(frame, algorithm.settings, self._capacity)
        if block.tobytes() != self._written:
            self._written = block.tobytes()
            algorithm.clipmap.gpu.write(self._block, block)
        run = timer.compute_pass(encoder, "refine")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._lists_group)
        run.set_bind_group(2, self._dispatch_groups[0])
        run.set_pipeline(algorithm.refine_top)
        run.dispatch_workgroups(1)
        run.set_pipeline(algorithm.refine)
        for level in range(passes(frame, block) - _TOP_LEVELS):
            run.set_bind_group(2, self._dispatch_groups[1 - level % 2])
            run.dispatch_workgroups_indirect(self._dispatches[level % 2].raw, 0)
        run.set_bind_group(2, self._draw_group)
        run.set_pipeline(algorithm.prepare_draw)
        run.dispatch_workgroups(1)
        run.end()
        self._frames += 1
        if self._watch is None and (self._frames % _WATCHED == 1 or not self._fits):
            self._watch = self._capacity, algorithm.clipmap.gpu.read_buffer(self._state, encoder=encoder)
        return [Patches(algorithm.module, self._vertex_group, self._draw, "triangle-list", algorithm.index)]

    def _keep_up(self) -> None:
        """Make room where an earlier frame is known to have lacked it, without waiting for the GPU."""
        if self._watch is None or not self._watch[1].ready():
            return
        (capacity, state), self._watch = self._watch, None
        self._fits = not state.result().view(_STATE)[0]["overflow"]
        if not self._fits and capacity == self._capacity:
            try:
                self._grow(2 * capacity)
            except BudgetError as error:
                _log.debug("drawn coarser than asked for: %s", error)

    def _read_state(self) -> Any:
        return self._algorithm.clipmap.gpu.read_buffer(self._state).result().view(_STATE)[0]

    def statistics(self) -> Statistics:
        """Tiles as patches; two triangles a quad."""
        tiles = int(self._read_state()["finals"])
        return Statistics(triangles=2 * tiles * self._algorithm.settings.grid_size**2, patches=tiles, draws=1)

    def incomplete(self) -> bool:
        """Whether tiles found no room; makes room for twice as many. Raises BudgetError where that cannot be had."""
        if not self._read_state()["overflow"]:
            return False
        self._grow(2 * self._capacity)
        return True


class Udlod(Algorithm):
    """Tiles of equal size on screen, refined on the GPU and morphed into one another."""

    name = "udlod"
    Settings = Settings
    detail = Detail("pixels_per_quad", 0.5, 256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        storage = ("COMPUTE", "storage")
        uniform = ("COMPUTE", "uniform")
        self.lists_layout = gpu.layout("udlod lists", {0: uniform, 1: storage, 2: storage, 3: storage})
        self.arguments_layout = gpu.layout("udlod arguments", {0: storage})
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("udlod tiles", {0: (stages, "uniform"), 1: (stages, "read")}),
            {"UDLOD_COLUMNS": settings.grid_size + 1},
        )
        size = settings.grid_size
        self.index = Mesh(gpu, [grid_triangles(size, size)], "udlod")
        search = [FOLDER, *SEARCH]
        refine = gpu.shader("udlod refine", FOLDER / "refine.wgsl", search=search, constants=clipmap.constants)
        prepare = gpu.shader("udlod prepare", FOLDER / "prepare.wgsl", search=search, constants=clipmap.constants)
        layouts = [clipmap.layout, self.lists_layout, self.arguments_layout]
        self.refine_top = gpu.compute("udlod top", refine, "refine_top", layouts)
        self.refine = gpu.compute("udlod refine", refine, "refine_tiles", layouts)
        self.prepare_draw = gpu.compute("udlod draw", prepare, "prepare_draw", layouts)

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def passes(frame: Frame, block: np.ndarray) -> int:
    """How many levels, from the root's on, can have tiles: none is nearer to the LOD eye than the ground under it."""
    above = abs(float(frame.lod_eye()[2]) + frame.camera.z - frame.ground_height * frame.exaggeration)
    root_level = int(block["root_level"])
    # a tile of level l is split within split_distance 2^(l - 1) of the eye, give or take rounding
    split = [above < 1.001 * float(block["split_distance"]) * 2.0 ** (level - 1) for level in range(root_level, 0, -1)]
    return 1 + (split.index(False) if False in split else root_level)


def lattice(frame: Frame, settings: Settings, capacity: int) -> np.ndarray:
    """The uniform block of udlod.wgsl: lattice of tiles and the distances at which they are split."""
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
        frame.pixels_per_radian(frame.lod) / settings.quad_pixels,
        1.01 * diagonal / (1 - 2 * settings.morph_range),
    )
    block = np.zeros((), _BLOCK)
    block["grid_size"], block["leaf"], block["root_level"] = settings.grid_size, leaf, root_level
    block["tile_capacity"], block["morph_range"] = capacity, settings.morph_range
    block["split_distance"] = 2 * quad_metres * reach
    return block
