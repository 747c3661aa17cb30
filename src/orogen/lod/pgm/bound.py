"""The error-bounded variant: where the grid's screen-space error may be too large, rays are cast."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer
from orogen.lod.contract import Module, Patches, Rays
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent
PRISM_TRIANGLES = 14
"""Triangles of a prism: its sides, lid and floor, and the cell's own two."""
_PRISM_BYTES = 12
_GROUP = 64
_LIMIT = np.dtype(
    [
        ("forward", "f4", 3),
        ("pixels", "f4"),
        ("pixel_metres", "f4"),
        ("near", "f4"),
        ("secant", "f4"),
        ("padding", "f4"),
    ]
)


class Bound:
    """Kernel and modules, shared by all views."""

    def __init__(self, clipmap: Clipmap, constants: Mapping[str, Any], kernel: Callable[[str, str, Any], Any]) -> None:
        """`kernel`: makes the pipeline of a WGSL file's entry point with a layout of group 1."""
        gpu = clipmap.gpu
        self.gpu = gpu
        uniform, read, storage = ("COMPUTE", "uniform"), ("COMPUTE", "read"), ("COMPUTE", "storage")
        self.layout = gpu.layout("pgm bound", {0: uniform, 2: read, 3: uniform, 4: storage, 5: storage})
        self.pipeline = kernel("bound", "find_cells", self.layout)
        stages = "VERTEX|COMPUTE"
        layout = gpu.layout("pgm prisms", {0: (stages, "uniform"), 2: (stages, "read"), 5: (stages, "read")})
        self.prisms = Module(FOLDER / "prism.wgsl", layout, constants)
        self.rays = Module(FOLDER / "replace.wgsl", gpu.layout("pgm rays", {0: storage}))


class BoundView:
    """The prisms of one view."""

    def __init__(self, bound: Bound) -> None:
        self._bound = bound
        gpu = bound.gpu
        self._limit = gpu.buffer("pgm limit", _LIMIT.itemsize, "UNIFORM|COPY_DST", "pgm")
        self._arguments = gpu.buffer("pgm prisms draw", 16, "STORAGE|INDIRECT|COPY_DST|COPY_SRC", "pgm")
        self._count = gpu.buffer("pgm rays", 4, "STORAGE|COPY_DST|COPY_SRC", "pgm")
        self._rays_group = gpu.bind("pgm rays", bound.rays.layout, {0: self._count})

    def make_room(self, block: Buffer, vertices: Buffer, cells: int) -> None:
        """For the prisms of a grid of so many cells."""
        bound, gpu = self._bound, self._bound.gpu
        prisms = gpu.buffer("pgm prisms", _PRISM_BYTES * cells, "STORAGE", "pgm")
        self._group = gpu.bind(
            "pgm bound", bound.layout, {0: block, 2: vertices, 3: self._limit, 4: self._arguments, 5: prisms}
        )
        self._prism_group = gpu.bind("pgm prisms", bound.prisms.layout, {0: block, 2: vertices, 5: prisms})

    def record(
        self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView, cells: int, pixels: float
    ) -> tuple[Patches, Rays]:
        """Find the cells that may be off by more than `pixels`; gives what is drawn before the grid, and its rays."""
        bound, gpu = self._bound, self._bound.gpu
        gpu.write(self._limit, _limit(frame, pixels))
        gpu.write(self._arguments, np.array([3 * PRISM_TRIANGLES, 0, 0, 0], np.uint32))
        gpu.write(self._count, np.zeros(1, np.uint32))
        run = timer.compute_pass(encoder, "bound")
        run.set_pipeline(bound.pipeline)
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._group)
        groups = -(-cells // _GROUP)
        run.dispatch_workgroups(min(groups, 65536 // _GROUP), -(-groups // (65536 // _GROUP)))
        run.end()
        prisms = Patches(bound.prisms, self._prism_group, self._arguments, topology="triangle-list")
        return prisms, Rays(bound.rays, self._rays_group, replace=True)

    def counts(self) -> tuple[int, int]:
        """Prisms that were drawn and rays that were cast."""
        arguments, rays = self._bound.gpu.read_buffer(self._arguments), self._bound.gpu.read_buffer(self._count)
        return int(arguments.result().view(np.uint32)[1]), int(rays.result().view(np.uint32)[0])


def _limit(frame: Frame, pixels: float) -> Any:
    block = np.zeros((), _LIMIT)
    camera = frame.lod
    block["forward"], block["pixels"], block["near"] = camera.basis[2], pixels, camera.near
    block["pixel_metres"] = camera.orthographic / frame.size[1] if camera.orthographic else 0.0
    half = math.tan(math.radians(camera.fov) / 2)
    block["secant"] = math.sqrt(1 + half**2 * (1 + (frame.size[0] / frame.size[1]) ** 2))
    return block
