"""Brute-force hardware tessellation, done in compute; see README.md in this folder."""

from __future__ import annotations

import logging
import math
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
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.values import expected_name

FOLDER = Path(__file__).parent

SPACINGS = {
    "integer": {"WHOLE": True, "ODD": False, "POWERS_OF_TWO": False},
    "pow2": {"WHOLE": True, "ODD": False, "POWERS_OF_TWO": True},
    "fractional_even": {"WHOLE": False, "ODD": False, "POWERS_OF_TWO": False},
    "fractional_odd": {"WHOLE": False, "ODD": True, "POWERS_OF_TWO": False},
}
"""Constants of the shaders for each way of spacing points."""

FINEST_PATCH = 8
"""Samples along a patch's side where nothing else is asked for: 8 quads a sample at the greatest factor, which follow a
bilinear surface to a 64th of its twist."""
USUAL_PATCHES = 1 << 16
"""Patches over the data above which larger ones are chosen."""
MOST_PATCHES = 1 << 20
"""Patches over the data at most."""

_log = logging.getLogger("orogen")

_WATCHED = 8
"""Every so many frames the triangle count is read back."""
_GROUP = 64
_BLOCK = np.dtype(
    [
        ("patches", "u4", 2),
        ("side", "u4"),
        ("capacity", "u4"),
        ("pixels_per_quad", "f4"),
        ("max_factor", "f4"),
        ("padding", "u4", 2),
    ]
)
_OUTPUT = np.dtype(
    [(name, "u4") for name in ("vertices", "instances", "vertex", "instance", "seen", "points", "triangles")]
)
_EDGE_BYTES, _PATCH_BYTES, _POINT_BYTES, _TRIANGLE_BYTES = 12, 48, 32, 12


@dataclass(frozen=True)
class Settings:
    """Size of the patches, and how they are divided."""

    patch_size: int | None = None
    """Samples along a patch's side, a power of two from 1 to 4096; None: 8, or as many more as make no more than 65536
    patches over the data."""
    pixels_per_quad: float = 3.0
    """Greatest width of a quad in pixels where it is seen face on, above 0, as far as max_factor allows."""
    spacing: str = "fractional_even"
    """How points are spaced along an edge: integer (equal, factors rounded up), pow2 (factors rounded up to powers of
    two), fractional_even or fractional_odd (points slide as the factor changes)."""
    max_factor: float = 64.0
    """Greatest factor, 1 to 64: parts that an edge is divided into."""
    triangle_capacity: int = 1 << 19
    """Triangles that there is room for at first, at least 64; grows when a frame needs more."""

    def __post_init__(self) -> None:
        if self.patch_size is not None and self.patch_size not in [1 << n for n in range(13)]:
            raise SettingsError(f"patch_size: expected a power of two from 1 to 4096, got {self.patch_size}")
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if self.spacing not in SPACINGS:
            raise expected_name("spacing", self.spacing, SPACINGS)
        if not 1 <= self.max_factor <= 64:
            raise SettingsError(f"max_factor: expected 1 to 64, got {self.max_factor}")
        if self.triangle_capacity < 64:
            raise SettingsError(f"triangle_capacity: expected at least 64 triangles, got {self.triangle_capacity}")


class View(AlgorithmView):
    """Patches, points and triangles of one view."""

    def __init__(self, algorithm: Tessellation) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        rows, columns = algorithm.patches
        self._patch_count = rows * columns
        self._edge_count = columns * (rows + 1) + rows * (columns + 1)

        def buffer(label: str, size: int, usage: str) -> Any:
            return gpu.buffer(f"tessellation {label}", size, usage, "tessellation")

        self._block = buffer("block", _BLOCK.itemsize, "UNIFORM|COPY_DST")
        self._output = buffer("output", _OUTPUT.itemsize, "STORAGE|INDIRECT|COPY_SRC")
        self._edges = buffer("edges", _EDGE_BYTES * self._edge_count, "STORAGE")
        self._patches = buffer("patches", _PATCH_BYTES * self._patch_count, "STORAGE")
        self._dispatch = buffer("dispatch", 12, "STORAGE|INDIRECT")
        self._control_group = gpu.bind(
            "tessellation control",
            algorithm.control_layout,
            {0: self._block, 1: self._edges, 2: self._patches, 3: self._output, 4: self._dispatch},
        )
        self._frames = 0
        self._fits = True
        self._watch: tuple[int, Readback] | None = None
        # patches that stay whole always find room
        self._grow(max(algorithm.settings.triangle_capacity, 2 * self._patch_count))

    def _grow(self, capacity: int) -> None:
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        # a pattern has at most two points more than triangles
        points = capacity + 2 * self._patch_count
        limit = gpu.limits["max-storage-buffer-binding-size"]
        if points * _POINT_BYTES > limit or capacity * _TRIANGLE_BYTES > limit:
            most = limit // _POINT_BYTES - 2 * self._patch_count
            raise BudgetError(
                f"tessellation: expected room for at most {most} triangles, got {capacity}; raise pixels_per_quad"
            )
        held = gpu.buffer("tessellation points", points * _POINT_BYTES, "STORAGE", "tessellation")
        triangles = gpu.buffer("tessellation triangles", capacity * _TRIANGLE_BYTES, "STORAGE", "tessellation")
        self._capacity = capacity
        block = np.zeros((), _BLOCK)
        block["patches"], block["side"], block["capacity"] = algorithm.patches[::-1], algorithm.side, capacity
        block["pixels_per_quad"] = algorithm.settings.pixels_per_quad
        block["max_factor"] = algorithm.settings.max_factor
        gpu.write(self._block, block)
        self._divide_group = gpu.bind(
            "tessellation divide",
            algorithm.divide_layout,
            {0: self._block, 1: self._patches, 2: self._output, 3: held, 4: triangles},
        )
        self._vertex_group = gpu.bind("tessellation vertices", algorithm.module.layout, {1: held, 2: triangles})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose factors for edges and for the patches in the frustum, then divide these."""
        algorithm = self._algorithm
        self._keep_up()
        run = timer.compute_pass(encoder, "tessellate")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._control_group)
        run.set_pipeline(algorithm.measure_edges)
        run.dispatch_workgroups(-(-self._edge_count // _GROUP))
        run.set_pipeline(algorithm.plan_patches)
        run.dispatch_workgroups(-(-self._patch_count // _GROUP))
        run.set_pipeline(algorithm.prepare)
        run.dispatch_workgroups(1)
        run.set_bind_group(1, self._divide_group)
        run.set_pipeline(algorithm.tessellate)
        run.dispatch_workgroups_indirect(self._dispatch.raw, 0)
        run.end()
        self._frames += 1
        if self._watch is None and (self._frames % _WATCHED == 1 or not self._fits):
            self._watch = self._capacity, algorithm.clipmap.gpu.read_buffer(self._output, encoder=encoder)
        return [Patches(algorithm.module, self._vertex_group, self._output, "triangle-list")]

    def _keep_up(self) -> None:
        """Make room where an earlier frame is known to have lacked it, without waiting for the GPU."""
        if self._watch is None or not self._watch[1].ready():
            return
        (capacity, output), self._watch = self._watch, None
        triangles = int(output.result().view(_OUTPUT)[0]["triangles"])
        self._fits = triangles <= capacity
        if triangles > self._capacity:
            try:
                self._grow(_room(triangles))
            except BudgetError as error:
                _log.debug("drawn coarser than asked for: %s", error)

    def _read_output(self) -> Any:
        return self._algorithm.clipmap.gpu.read_buffer(self._output).result().view(_OUTPUT)[0]

    def statistics(self) -> Statistics:
        """Patches in the frustum, and what was made of them."""
        output = self._read_output()
        return Statistics(triangles=int(output["vertices"]) // 3, patches=int(output["seen"]), draws=1)

    def incomplete(self) -> bool:
        """Whether triangles found no room; makes room. Raises BudgetError where that cannot be had."""
        triangles = int(self._read_output()["triangles"])
        if triangles <= self._capacity:
            return False
        self._grow(_room(triangles))
        return True


class Tessellation(Algorithm):
    """Patches of equal size, divided by factors for their edges and insides as graphics hardware does it."""

    name = "tessellation"
    Settings = Settings
    detail = Detail("pixels_per_quad", finest=1.0, coarsest=64.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        """Raises SettingsError where patches are too small for the data."""
        super().__init__(clipmap, settings)
        self.side = settings.patch_size or usual_size(clipmap.grid)
        self.patches = patch_rows(clipmap.grid, self.side)
        """Rows and columns of patches."""
        count = math.prod(self.patches)
        if count > MOST_PATCHES:
            raise SettingsError(
                f"patch_size: expected one that gives at most {MOST_PATCHES} patches, got {self.side}, {count} patches"
            )
        gpu = clipmap.gpu
        uniform, storage, read = ("COMPUTE", "uniform"), ("COMPUTE", "storage"), ("COMPUTE", "read")
        self.control_layout = gpu.layout(
            "tessellation control", {0: uniform, 1: storage, 2: storage, 3: storage, 4: storage}
        )
        self.divide_layout = gpu.layout("tessellation divide", {0: uniform, 1: read, 2: read, 3: storage, 4: storage})
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("tessellation vertices", {1: (stages, "read"), 2: (stages, "read")}),
        )
        constants = {**clipmap.constants, **SPACINGS[settings.spacing]}
        search = [FOLDER, *SEARCH]
        factors = gpu.shader("tessellation factors", FOLDER / "factors.wgsl", search=search, constants=constants)
        divide = gpu.shader("tessellation divide", FOLDER / "tessellate.wgsl", search=search, constants=constants)
        control = [clipmap.layout, self.control_layout]
        self.measure_edges = gpu.compute("tessellation edges", factors, "measure_edges", control)
        self.plan_patches = gpu.compute("tessellation plan", factors, "plan_patches", control)
        self.prepare = gpu.compute("tessellation prepare", factors, "prepare", control)
        self.tessellate = gpu.compute("tessellation", divide, "tessellate", [clipmap.layout, self.divide_layout])

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def patch_rows(grid: Grid, side: int) -> tuple[int, int]:
    """Rows and columns of patches of `side` samples over a grid, one at least."""
    return max(1, -(-(grid.height - 1) // side)), max(1, -(-(grid.width - 1) // side))


def usual_size(grid: Grid) -> int:
    """Samples along a patch's side: FINEST_PATCH, or as many more as make no more than USUAL_PATCHES patches."""
    side = FINEST_PATCH
    while math.prod(patch_rows(grid, side)) > USUAL_PATCHES:
        side *= 2
    return side


def _room(triangles: int) -> int:
    """Capacity for so many triangles, with some more for the next frame."""
    return 1 << int(triangles + triangles // 8).bit_length()
