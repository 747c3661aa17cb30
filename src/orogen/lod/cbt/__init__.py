"""Concurrent binary trees with longest edge bisection; see README.md in this folder."""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from orogen.camera import Camera
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame, subtexel_bits
from orogen.gpu import FrameTimer, Readback
from orogen.grid import Grid
from orogen.lod.cbt.field import DEEPEST, Shape, deepest_field, plant, shape_of, tree_bytes
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.values import expected_name

FOLDER = Path(__file__).parent

WIDEST_EDGE = 0.25
"""Part of its distance that an undivided edge may be long at most; a node's wish implies its parent's up to 0.8."""

METRICS = ("length", "error")

_GROUPS_A_ROW = 1 << 12
_LEAVES, _WORK, _REGIONS = 0, 12, 24
"""Where in the buffer the arguments of dispatches over leaves, over what is to be looked at, over regions are."""
_WATCHED = 8
"""Every so many frames the state is read back: that costs as much as an eighth of recording a frame."""

_COUNTERS = (
    "leaves", "work", "half", "updates", "settled", "unsettled",
    "refused", "divided", "joined", "added", "regions", "drawn",
)  # fmt: skip
_STATE = np.dtype([(name, "u4") for name in _COUNTERS])
_BLOCK = struct.Struct("<iIIf20ff12x")

_log = logging.getLogger("orogen")


@dataclass(frozen=True)
class Settings:
    """How fine the triangles are, how fast they follow the camera, and how much room they have."""

    metric: str = "length"
    """What divides a triangle: "length", that of its longest edge; "error", its distance from the ground."""
    pixels: float = 4.0
    """Greatest length of a triangle's longest edge where it is seen face on, or greatest error where it is seen from
    the side, in pixels, above 0. Errors of a quarter are about as good as lengths of four."""
    max_length: float = 64.0
    """With errors: greatest length of a triangle's longest edge in pixels, above 0, however small its error is."""
    updates: int = 16
    """Times, at most, that leaves are divided or joined in a frame, from 1 to 64: levels of detail that may change."""
    max_depth: int | None = None
    """Bisections from the square over the data to the smallest triangles, from 1 to 30; None: as many as the data and
    the memory call for."""
    leaf_capacity: int = 1 << 17
    """Room for nodes at first, at least 64, four times as many as there are leaves; grows when a frame needs more."""

    def __post_init__(self) -> None:
        if self.metric not in METRICS:
            raise expected_name("metric", self.metric, METRICS)
        if not self.pixels > 0:
            raise SettingsError(f"pixels: expected a number above 0, got {self.pixels}")
        if not self.max_length > 0:
            raise SettingsError(f"max_length: expected a number above 0, got {self.max_length}")
        if not 1 <= self.updates <= 64:
            raise SettingsError(f"updates: expected 1 to 64 a frame, got {self.updates}")
        if self.max_depth is not None and not 1 <= self.max_depth <= DEEPEST:
            raise SettingsError(f"max_depth: expected 1 to {DEEPEST} bisections, got {self.max_depth}")
        if self.leaf_capacity < 64:
            raise SettingsError(f"leaf_capacity: expected at least 64 leaves, got {self.leaf_capacity}")

    @property
    def length(self) -> float:
        """Pixels that the longest edge of an undivided triangle covers at most."""
        return self.max_length if self.metric == "error" else self.pixels

    @property
    def error(self) -> float | None:
        """Pixels by which an undivided triangle leaves the ground at most; None where that does not count."""
        return self.pixels if self.metric == "error" else None


class View(AlgorithmView):
    """The tree of one view, which follows its camera from frame to frame."""

    def __init__(self, algorithm: Cbt) -> None:
        """Raises BudgetError where the tree does not fit."""
        self._algorithm = algorithm
        gpu, depth = algorithm.clipmap.gpu, algorithm.shape.field_depth
        self._block = gpu.buffer("cbt", _BLOCK.size, "UNIFORM|COPY_DST", "cbt")
        self._tree = gpu.buffer("cbt tree", tree_bytes(depth), "STORAGE|COPY_DST|COPY_SRC", "cbt")
        self._state = gpu.buffer("cbt state", _STATE.itemsize, "STORAGE|COPY_SRC", "cbt")
        self._dispatches = gpu.buffer("cbt dispatches", 36, "STORAGE|INDIRECT", "cbt")
        self._draw = gpu.buffer("cbt draw", 16, "STORAGE|INDIRECT|COPY_SRC", "cbt")
        self._dispatches_group = gpu.bind(
            "cbt dispatches", algorithm.dispatches_layout, {0: self._dispatches, 1: self._draw}
        )
        plant(gpu, self._tree, depth)
        self._written = b""
        self._watch: tuple[int, Readback] | None = None
        self._frames = 0
        self._fits = True
        self._may_grow = True
        self._settled = False
        self._unsettled = self._watched_unsettled = 0
        self._grow(algorithm.settings.leaf_capacity)

    def _grow(self, capacity: int) -> None:
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        most = gpu.limits["max-storage-buffer-binding-size"] // 8
        if capacity > most:
            raise BudgetError(f"cbt: expected room for at most {most} leaves, got {capacity}; raise pixels")
        nodes = gpu.buffer("cbt nodes", 8 * capacity, "STORAGE", "cbt")
        self._capacity = capacity
        self._tree_group = gpu.bind(
            "cbt tree", algorithm.tree_layout, {0: self._block, 1: self._tree, 2: nodes, 3: self._state}
        )
        self._vertex_group = gpu.bind("cbt nodes", algorithm.module.layout, {0: self._block, 1: nodes})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Divide and join what the camera calls for, then list the leaves in sight."""
        algorithm, kernels = self._algorithm, self._algorithm.kernels
        self._keep_up()
        block = uniforms(frame, algorithm.settings, algorithm.shape, self._capacity)
        if block != self._written:
            self._written = block
            algorithm.clipmap.gpu.write(self._block, block)
        run = timer.compute_pass(encoder, "update tree")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._tree_group)
        # what takes its arguments from a buffer must not have it bound for writing: only `begin` and its like do
        run.set_bind_group(2, self._dispatches_group)

        def dispatch(name: str, arguments: int | None = None) -> None:
            run.set_pipeline(kernels[name])
            if arguments is None:
                run.dispatch_workgroups(1)
            else:
                run.dispatch_workgroups_indirect(self._dispatches.raw, arguments)

        dispatch("begin")
        dispatch("list_leaves", _LEAVES)
        for _ in range(algorithm.settings.updates):
            dispatch("split", _WORK)
            dispatch("merge", _WORK)
            dispatch("next")
        dispatch("sum_regions", _REGIONS)
        dispatch("sum_top")
        dispatch("collect", _LEAVES)
        dispatch("finish")
        run.end()
        self._frames += 1
        if self._watch is None and (self._frames % _WATCHED == 1 or not self._fits or not self._settled):
            self._watch = self._capacity, algorithm.clipmap.gpu.read_buffer(self._state, encoder=encoder)
        return [Patches(algorithm.module, self._vertex_group, self._draw, "triangle-list")]

    def _keep_up(self) -> None:
        """See what became of an earlier frame, and make room where it lacked some, without waiting for the GPU."""
        if self._watch is None or not self._watch[1].ready():
            return
        (capacity, readback), self._watch = self._watch, None
        state = readback.result().view(_STATE)[0]
        self._fits = not state["refused"]
        before, self._watched_unsettled = self._watched_unsettled, int(state["unsettled"])
        # also frames that were not watched: what was drawn then may be in the picture
        self._settled = self._watched_unsettled == before and bool(state["settled"]) and self._fits
        if not self._fits and capacity == self._capacity:
            try:
                self._grow(2 * capacity)
            except BudgetError as error:
                self._may_grow = False
                _log.debug("drawn coarser than asked for: %s", error)

    def state(self) -> dict[str, int]:
        """Of the latest frame, by name: `leaves` in the tree, `updates` made, whether it `settled`, ...

        Waits for the GPU.
        """
        row = self._algorithm.clipmap.gpu.read_buffer(self._state).result().view(_STATE)[0]
        return {name: int(row[name]) for name in row.dtype.names}

    def statistics(self) -> Statistics:
        """Leaves in sight as triangles."""
        return Statistics(triangles=self.state()["drawn"], draws=1)

    def unfinished(self) -> bool:
        """Whether the tree was still changing, or lacked room that it will have, in the latest frames known of."""
        self._keep_up()
        return not self._settled and (self._fits or self._may_grow)

    def incomplete(self) -> bool:
        """Whether the tree was still changing in a frame since this was asked, or lacked room, which it makes.

        Raises BudgetError where room cannot be had.
        """
        state = self.state()
        if state["refused"]:
            self._grow(2 * self._capacity)
        before, self._unsettled = self._unsettled, state["unsettled"]
        return self._unsettled != before


class Cbt(Algorithm):
    """A binary tree of right triangles in a bit field, divided and joined by all leaves in parallel."""

    name = "cbt"
    Settings = Settings
    detail = Detail("pixels", finest=0.5, coarsest=256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        """Raises BudgetError where `max_depth` asks for a larger bit field than the device can bind."""
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        self.shape = shape_of(clipmap.grid, settings.max_depth, deepest_field(gpu))
        """The tree that every view has."""
        most = gpu.limits["max-storage-buffer-binding-size"]
        if tree_bytes(self.shape.depth) > most:
            raise BudgetError(
                f"cbt: expected a tree of at most {most} bytes on this device, got max_depth {settings.max_depth}, "
                f"{tree_bytes(self.shape.depth)} bytes; lower max_depth"
            )
        if settings.max_depth is None and self.shape.depth < self.shape.full_depth:
            leg = self.shape.shortest_leg / (1 << subtexel_bits(clipmap.grid))
            _log.log(
                # finer than the samples is for cameras close to the ground
                logging.WARNING if leg > 1 else logging.INFO,
                "cbt: %d bisections in place of %d, for want of memory: legs of triangles are %.3g samples or longer; "
                "max_depth up to %d asks for more", self.shape.depth, self.shape.full_depth, leg, DEEPEST,
            )  # fmt: skip
        depth = self.shape.field_depth
        uniform, storage = ("COMPUTE", "uniform"), ("COMPUTE", "storage")
        self.tree_layout = gpu.layout("cbt tree", {0: uniform, 1: storage, 2: storage, 3: storage})
        self.dispatches_layout = gpu.layout("cbt dispatches", {0: storage, 1: storage})
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "vertex.wgsl", gpu.layout("cbt nodes", {0: (stages, "uniform"), 1: (stages, "read")})
        )
        constants = {**clipmap.constants, "DEPTH": depth, "GROUPS_A_ROW": _GROUPS_A_ROW}
        layouts = [clipmap.layout, self.tree_layout]
        self.kernels: dict[str, Any] = {}
        """Compute pipelines by the names of their entry points."""
        for file, names, groups in (
            ("update", ("list_leaves", "split", "merge"), layouts),
            ("collect", ("collect",), layouts),
            ("sum", ("sum_regions", "sum_top"), layouts),
            ("sum", ("begin", "next", "finish"), [*layouts, self.dispatches_layout]),
        ):
            shader = gpu.shader(f"cbt {file}", FOLDER / f"{file}.wgsl", search=[FOLDER, *SEARCH], constants=constants)
            for name in names:
                self.kernels[name] = gpu.compute(f"cbt {name}", shader, name, groups)

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def uniforms(frame: Frame, settings: Settings, shape: Shape, capacity: int) -> bytes:
    """The uniform block of cbt.wgsl, in plain numbers, since it is worked out in every frame."""
    longest = math.sqrt(2) * shape.side * _longest_step(frame.grid)
    scale = frame.pixels_per_radian(frame.lod)
    reach = longest * max(scale / settings.length, 1 / WIDEST_EDGE)
    error_reach = scale / settings.error if settings.error else 0.0
    wide = wider(frame.lod, frame.size)
    seen = replace(frame, lod_camera=wide) if frame.lod_camera else replace(frame, camera=wide, jitter=(0.0, 0.0))
    left, right, bottom, top, near = seen.plane_rows
    planes = *left, *right, *bottom, *top, *near
    return _BLOCK.pack(shape.side, shape.depth, capacity, reach, *planes, error_reach)


@lru_cache(maxsize=16)
def _longest_step(grid: Grid) -> float:
    """The most metres that a step of one subtexel can be long."""
    return float(np.linalg.norm(grid.metres, 2)) / (1 << subtexel_bits(grid))


def wider(camera: Camera, size: tuple[int, int]) -> Camera:
    """A camera that sees half a pixel more on all sides: what any sample within the pixels sees."""
    factor = 1 + 1 / min(size)
    if camera.orthographic:
        return camera.moved(orthographic=factor * camera.orthographic)
    return camera.moved(fov=math.degrees(2 * math.atan(factor * math.tan(math.radians(camera.fov) / 2))))
