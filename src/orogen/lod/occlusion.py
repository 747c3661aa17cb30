"""The hierarchical depth that boxes are tested against, and the frame that it was seen in."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer, Texture
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

STEP = 4
"""Cells of a level along the side of a cell of the next."""

_ALIGNMENT = 256
_TILE = 8


class DepthReduction:
    """Kernels that make depth pyramids, shared by all views."""

    def __init__(self, clipmap: Clipmap, name: str) -> None:
        """`name`: of the algorithm."""
        self.gpu = clipmap.gpu
        self.name = name
        self._clipmap = clipmap
        self.layout = clipmap.gpu.layout(
            f"{name} pyramid",
            {0: ("COMPUTE", "uniform"), 1: ("COMPUTE", "texture unfilterable"), 2: ("COMPUTE", "storage")},
        )

    @cached_property
    def pipelines(self) -> list[Any]:
        """For level 1, and for the others; compiled when they are first used."""
        gpu, name = self.gpu, self.name
        shader = gpu.shader(
            f"{name} pyramid", FOLDER / "build_pyramid.wgsl", search=SEARCH, constants=self._clipmap.constants
        )
        layouts = [self._clipmap.layout, self.layout]
        return [gpu.compute(f"{name} {e}", shader, e, layouts) for e in ("reduce_surface", "reduce_cells")]


class DepthPyramid:
    """Farthest depths over cells of 4, 16, 64 ... pixels a side, of one view."""

    def __init__(self, reduction: DepthReduction) -> None:
        self._reduction = reduction
        name = reduction.name
        self._numbers = reduction.gpu.buffer(f"{name} levels", _level_numbers(), "UNIFORM", name)
        self._size = (0, 0)
        self._depth: Texture | None = None
        self._groups: list[Any] = []
        self.cells: Buffer = reduction.gpu.buffer(f"{name} depth", 4, "STORAGE", name)
        """float32 depths, level after level."""
        self.seen: Frame | None = None
        """The frame whose depths it holds; None before the first."""

    def fit(self, size: tuple[int, int]) -> bool:
        """Make room for pictures of a size; True where `cells` is another buffer for that."""
        if size == self._size:
            return False
        self._size = size
        self._depth = self.seen = None
        total = sum(width * height for width, height in _cells(size))
        name = self._reduction.name
        self.cells = self._reduction.gpu.buffer(f"{name} depth", 4 * total, "STORAGE", name)
        return True

    def build(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView, depth: Texture) -> None:
        """Record the reduction of a surface's depths."""
        reduction = self._reduction
        if depth is not self._depth:
            self._depth = depth
            self._groups = [
                reduction.gpu.bind(
                    f"{reduction.name} pyramid",
                    reduction.layout,
                    {0: (self._numbers, _ALIGNMENT * level, 16), 1: depth, 2: self.cells},
                )
                for level in range(len(_cells(frame.size)))
            ]
        run = timer.compute_pass(encoder, "pyramid")
        run.set_bind_group(0, view.bind_group)
        for level, (group, (width, height)) in enumerate(zip(self._groups, _cells(frame.size), strict=True)):
            run.set_pipeline(reduction.pipelines[level > 0])
            run.set_bind_group(1, group)
            run.dispatch_workgroups(-(-width // _TILE), -(-height // _TILE))
        run.end()
        self.seen = frame

    def projection(self, frame: Frame) -> tuple[float, ...] | None:
        """4 x 4, columns first, from metres relative to `frame`'s camera to the clip space of what was seen."""
        if self.seen is None:
            return None
        east, north = (frame.grid.metres @ (frame.eye - self.seen.eye)).tolist()
        up = frame.camera.z - self.seen.camera.z
        rows = [(x, y, z, x * east + y * north + z * up + w) for x, y, z, w in self.seen.clip_rows]
        return tuple(value for column in zip(*rows, strict=True) for value in column)


def _level_numbers() -> NDArray[np.uint32]:
    numbers = np.zeros((16, _ALIGNMENT // 4), np.uint32)
    numbers[:, 0] = np.arange(1, 17)
    return numbers


def _cells(size: tuple[int, int]) -> list[tuple[int, int]]:
    """Columns and rows of cells of levels 1, 2 ..., up to a single cell."""
    levels = [(-(-size[0] // STEP), -(-size[1] // STEP))]
    while max(levels[-1]) > 1:
        levels.append((-(-levels[-1][0] // STEP), -(-levels[-1][1] // STEP)))
    return levels
