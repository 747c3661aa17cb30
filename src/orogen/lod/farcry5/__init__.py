"""The terrain renderer of Far Cry 5; see README.md in this folder."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import FrameTimer, Readback, Texture
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.farcry5.lattice import BLOCK, PATCHES, lattice
from orogen.lod.mesh import Mesh, grid_triangles
from orogen.lod.occlusion import DepthPyramid, DepthReduction
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

_log = logging.getLogger("orogen")

_GROUPS = "max-compute-workgroups-per-dimension"
_WATCHED = 8
"""Every so many frames the patch count is read back: that costs as much as an eighth of recording a frame."""

_STATE = np.dtype(
    [
        (name, "u4")
        for name in (
            "level", "parents", "children", "nodes", "patches", "visible", "hidden", "revealed", "undersides",
        )
    ]
)  # fmt: skip
# bytes before each record of `Arguments` in prepare.wgsl
_REFINE, _PATCHES, _MEASURE, _CULL, _REVEAL, _DRAW, _DRAW_REVEALED, _ARGUMENTS = 0, 12, 24, 36, 48, 60, 80, 100


@dataclass(frozen=True)
class Settings:
    """Size of patches, detail, and what is culled."""

    patch_quads: int = 16
    """Rows and columns of quads in a patch: 4, 8, 16 or 32. A node has eight times as many."""
    pixels_per_quad: float = 4.0
    """Greatest width of a quad in pixels where it is seen face on, above 0."""
    frustum: bool = True
    """Whether patches outside the frustum are culled."""
    back_face: bool = True
    """Whether patches that show the eye their undersides only are culled."""
    occlusion: bool = False
    """Whether patches behind what the frame before showed are culled, unless what is drawn now does not hide them."""
    patch_capacity: int = 1 << 14
    """Patches that there is room for at first, a multiple of 64; grows when a frame needs more."""

    def __post_init__(self) -> None:
        if self.patch_quads not in (4, 8, 16, 32):
            raise SettingsError(f"patch_quads: expected 4, 8, 16 or 32, got {self.patch_quads}")
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if self.patch_capacity < 64 or self.patch_capacity % 64:
            raise SettingsError(f"patch_capacity: expected a multiple of 64, got {self.patch_capacity}")


class View(AlgorithmView):
    """The node and patch lists of one view, and the depth that it showed last."""

    def __init__(self, algorithm: FarCry5) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        self._block = gpu.buffer("farcry5", BLOCK.itemsize, "UNIFORM|COPY_DST", "farcry5")
        self._state = gpu.buffer("farcry5 state", _STATE.itemsize, "STORAGE|COPY_SRC", "farcry5")
        self._arguments = gpu.buffer("farcry5 arguments", _ARGUMENTS, "STORAGE|INDIRECT|COPY_SRC", "farcry5")
        self._arguments_group = gpu.bind("farcry5 arguments", algorithm.arguments_layout, {0: self._arguments})
        self._counts_group = gpu.bind("farcry5 counts", algorithm.counts_layout, {0: self._block, 1: self._state})
        self._pyramid = DepthPyramid(algorithm.depths)
        self._written = b""
        self._map_shape = (-1, -1)
        self._watch: tuple[int, Readback] | None = None
        self._frames = 0
        self._fits = False
        self._tests_depth = False
        self._grow(algorithm.settings.patch_capacity)

    def _grow(self, capacity: int) -> None:
        """Room for so many patches."""
        gpu = self._algorithm.clipmap.gpu
        most = min(gpu.limits["max-storage-buffer-binding-size"] // 32, 64 * gpu.limits[_GROUPS])
        if capacity > most:
            raise BudgetError(
                f"farcry5: expected room for at most {most} patches, got {capacity}; raise pixels_per_quad"
            )
        self._capacity = capacity
        self._patches = gpu.buffer("farcry5 patches", 12 * capacity, "STORAGE", "farcry5")
        self._boxes = gpu.buffer("farcry5 boxes", 32 * capacity, "STORAGE", "farcry5")
        # visible and hidden ones together fill the first half at most, revealed ones the second
        self._lists = gpu.buffer("farcry5 lists", 8 * capacity, "STORAGE", "farcry5")
        self._bind_patches()

    def _make_room_for_nodes(self, root_level: int, map_bits: int) -> None:
        """The LOD map, and lists of as many nodes as its windows hold."""
        if (root_level, map_bits) == self._map_shape:
            return
        gpu = self._algorithm.clipmap.gpu
        self._map_shape = root_level, map_bits
        window = 1 << 2 * map_bits
        self._map = gpu.buffer("farcry5 map", 4 * (root_level + 1) * window, "STORAGE|COPY_DST", "farcry5")
        self._temporary = gpu.buffer("farcry5 temporary nodes", 16 * window, "STORAGE", "farcry5")
        self._nodes = gpu.buffer("farcry5 nodes", 12 * (root_level + 1) * window, "STORAGE", "farcry5")
        self._refine_group = gpu.bind(
            "farcry5 nodes",
            self._algorithm.storage_layout,
            {0: self._block, 1: self._state, 2: self._map, 3: self._temporary, 4: self._nodes},
        )
        self._bind_patches()

    def _bind_patches(self) -> None:
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        if self._map_shape[0] >= 0:
            self._list_group = gpu.bind(
                "farcry5 patches",
                algorithm.storage_layout,
                {0: self._block, 1: self._state, 2: self._map, 3: self._nodes, 4: self._patches},
            )
        self._measure_group = gpu.bind(
            "farcry5 boxes",
            algorithm.measure_layout,
            {0: self._block, 1: self._state, 2: self._patches, 3: self._boxes},
        )
        self._bind_culling()
        half = 4 * self._capacity
        self._draw_groups = [
            gpu.bind(
                "farcry5 drawn", algorithm.module.layout,
                {0: self._block, 1: self._patches, 2: (self._lists, start, half)},
            )
            for start in (0, half)
        ]  # fmt: skip

    def _bind_culling(self) -> None:
        self._cull_group = self._algorithm.clipmap.gpu.bind(
            "farcry5 culling",
            self._algorithm.cull_layout,
            {0: self._block, 1: self._state, 2: self._boxes, 3: self._lists, 4: self._pyramid.cells},
        )

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """List the nodes, then their patches, and draw what the frame before gives no reason to leave out."""
        algorithm = self._algorithm
        settings = algorithm.settings
        self._keep_up()
        block = lattice(frame, algorithm.clipmap, settings.patch_quads, settings.pixels_per_quad)
        self._make_room_for_nodes(int(block["root_level"]), int(block["map_bits"]))
        block["capacity"] = self._capacity
        # depths are those of the camera that looks: one that merely watches a frozen camera says nothing about it
        self._tests_depth = settings.occlusion and frame.lod == frame.camera
        if self._tests_depth and self._pyramid.fit(frame.size):
            self._bind_culling()
        projection = self._pyramid.projection(frame) if self._tests_depth else None
        if projection is not None:
            block["history"], block["to_history"] = 1, np.reshape(projection, (4, 4))
        # only a frame that ends with `drawn` tells what may be left out of the next
        self._pyramid.seen = None
        if block.tobytes() != self._written:
            self._written = block.tobytes()
            algorithm.clipmap.gpu.write(self._block, block)
        encoder.clear_buffer(self._map.raw)
        self._list_nodes(encoder, timer, view, int(block["root_level"] - block["floor_level"]))
        self._list_patches(encoder, timer, view)
        self._frames += 1
        if self._watch is None and (self._frames % _WATCHED == 1 or not self._fits):
            self._watch = self._capacity, algorithm.clipmap.gpu.read_buffer(self._state, encoder=encoder)
        return [self._draw(0, _DRAW)]

    def _draw(self, group: int, offset: int) -> Patches:
        algorithm = self._algorithm
        return Patches(
            algorithm.module, self._draw_groups[group], self._arguments, "triangle-list", algorithm.index, offset
        )

    def _list_nodes(self, encoder: Any, timer: FrameTimer, view: ClipmapView, splits: int) -> None:
        algorithm = self._algorithm
        run = timer.compute_pass(encoder, "nodes")
        run.set_bind_group(0, view.bind_group)
        # what takes its arguments from a buffer must not have it bound for writing
        run.set_bind_group(2, self._arguments_group)
        self._prepare(run, algorithm.prepare_root)
        for level in range(splits + 1):
            if level:
                self._prepare(run, algorithm.prepare_next)
            self._run(run, algorithm.refine, self._refine_group, _REFINE)
        self._prepare(run, algorithm.prepare_patches)
        run.end()

    def _list_patches(self, encoder: Any, timer: FrameTimer, view: ClipmapView) -> None:
        algorithm = self._algorithm
        run = timer.compute_pass(encoder, "patches")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(2, self._arguments_group)
        self._run(run, algorithm.list_patches, self._list_group, _PATCHES)
        self._prepare(run, algorithm.prepare_culling)
        run.end()
        run = timer.compute_pass(encoder, "cull")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(2, self._arguments_group)
        if algorithm.measures:
            self._run(run, algorithm.measure, self._measure_group, _MEASURE)
        self._run(run, algorithm.cull, self._cull_group, _CULL)
        self._prepare(run, algorithm.prepare_draw)
        run.end()

    def _prepare(self, run: Any, pipeline: Any) -> None:
        run.set_pipeline(pipeline)
        run.set_bind_group(1, self._counts_group)
        run.dispatch_workgroups(1)

    def _run(self, run: Any, pipeline: Any, group: Any, offset: int) -> None:
        run.set_pipeline(pipeline)
        run.set_bind_group(1, group)
        run.dispatch_workgroups_indirect(self._arguments.raw, offset)

    def drawn(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView, depth: Texture) -> Sequence[Draw]:
        """Draw what the frame before hid and this one does not."""
        if not self._tests_depth:
            return ()
        algorithm = self._algorithm
        self._pyramid.build(encoder, timer, frame, view, depth)
        run = timer.compute_pass(encoder, "reveal")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(2, self._arguments_group)
        self._run(run, algorithm.reveal, self._cull_group, _REVEAL)
        self._prepare(run, algorithm.prepare_second_draw)
        run.end()
        return [self._draw(1, _DRAW_REVEALED)]

    def _keep_up(self) -> None:
        """Make room where an earlier frame is known to have lacked it, without waiting for the GPU."""
        if self._watch is None or not self._watch[1].ready():
            return
        (capacity, readback), self._watch = self._watch, None
        patches = int(readback.result().view(_STATE)[0]["patches"])
        self._fits = patches <= capacity
        if not self._fits and capacity == self._capacity:
            try:
                self._grow(_room(patches))
            except BudgetError as error:
                _log.debug("drawn with gaps: %s", error)

    def _read_state(self) -> Any:
        return self._algorithm.clipmap.gpu.read_buffer(self._state).result().view(_STATE)[0]

    def statistics(self) -> Statistics:
        """Two triangles a quad."""
        state = self._read_state()
        patches = int(state["visible"]) + int(state["revealed"])
        quads = self._algorithm.settings.patch_quads**2
        return Statistics(triangles=2 * patches * quads, patches=patches, draws=1 + self._tests_depth)

    def incomplete(self) -> bool:
        """Whether patches found no room; makes room for them. Raises BudgetError where that cannot be had."""
        patches = int(self._read_state()["patches"])
        if patches <= self._capacity:
            return False
        self._grow(_room(patches))
        return True


def _room(patches: int) -> int:
    """Capacity for so many patches and a few more to come."""
    return -(-patches * 5 // 4 // 64) * 64


class FarCry5(Algorithm):
    """Nodes listed on the GPU, their patches culled and stitched there."""

    name = "farcry5"
    Settings = Settings
    detail = Detail("pixels_per_quad", finest=0.5, coarsest=256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        quads = settings.patch_quads
        uniform, storage, read = ("COMPUTE", "uniform"), ("COMPUTE", "storage"), ("COMPUTE", "read")
        self.counts_layout = gpu.layout("farcry5 counts", {0: uniform, 1: storage})
        self.arguments_layout = gpu.layout("farcry5 arguments", {0: storage})
        self.storage_layout = gpu.layout("farcry5 lists", {0: uniform, 1: storage, 2: storage, 3: storage, 4: storage})
        self.measure_layout = gpu.layout("farcry5 boxes", {0: uniform, 1: storage, 2: storage, 3: storage})
        self.cull_layout = gpu.layout("farcry5 culling", {0: uniform, 1: storage, 2: storage, 3: storage, 4: read})
        self.depths = DepthReduction(clipmap, self.name)
        stages = "VERTEX|COMPUTE"
        vertex_layout = gpu.layout("farcry5 drawn", {0: (stages, "uniform"), 1: (stages, "read"), 2: (stages, "read")})
        constants = {"QUADS": quads, "NODE_QUADS_BITS": (PATCHES * quads).bit_length() - 1}
        self.module = Module(FOLDER / "vertex.wgsl", vertex_layout, constants)
        # turned the way that the tests of back faces count on
        self.index = Mesh(gpu, [grid_triangles(quads, quads)[:, [0, 2, 1]]], "farcry5")
        self.measures = settings.frustum or settings.back_face or settings.occlusion
        """Whether patches are culled by what their triangles are, beside where they may be."""
        culls = {
            "FRUSTUM": settings.frustum, "BACK_FACE": settings.back_face, "OCCLUSION": settings.occlusion,
        }  # fmt: skip

        shaders = {
            name: gpu.shader(
                f"farcry5 {name}", FOLDER / f"{name}.wgsl", search=[FOLDER, *SEARCH],
                constants={**clipmap.constants, **constants, **culls},
            )
            for name in ("prepare", "refine", "patches", "measure", "cull")
        }  # fmt: skip

        def kernel(name: str, entry: str, *layouts: Any) -> Any:
            return gpu.compute(f"farcry5 {entry}", shaders[name], entry, [clipmap.layout, *layouts])

        between = self.counts_layout, self.arguments_layout
        self.prepare_root = kernel("prepare", "prepare_root", *between)
        self.prepare_next = kernel("prepare", "prepare_next", *between)
        self.prepare_patches = kernel("prepare", "prepare_patches", *between)
        self.prepare_culling = kernel("prepare", "prepare_culling", *between)
        self.prepare_draw = kernel("prepare", "prepare_draw", *between)
        self.prepare_second_draw = kernel("prepare", "prepare_second_draw", *between)
        self.refine = kernel("refine", "refine_nodes", self.storage_layout)
        self.list_patches = kernel("patches", "list_patches", self.storage_layout)
        self.measure = kernel("measure", "measure_patches", self.measure_layout)
        self.cull = kernel("cull", "cull_patches", self.cull_layout)
        self.reveal = kernel("cull", "reveal_patches", self.cull_layout)

    def view(self) -> View:
        """State for one more view."""
        return View(self)
