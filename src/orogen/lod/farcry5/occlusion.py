"""The hierarchical depth that patches are tested against, and the frame that it was seen in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer, Gpu, Texture
from orogen.streaming.clipmap import ClipmapView

STEP = 4
"""Cells of a level along the side of a cell of the next."""

_ALIGNMENT = 256
_TILE = 8


class DepthPyramid:
    """Farthest depths over cells of 4, 16, 64 ... pixels a side."""

    def __init__(self, gpu: Gpu, layout: Any, reduce_surface: Any, reduce_cells: Any) -> None:
        """`layout`: that of bind group 1 of the two pipelines of build_pyramid.wgsl."""
        self._gpu = gpu
        self._layout = layout
        self._pipelines = reduce_surface, reduce_cells
        self._numbers = gpu.buffer("farcry5 levels", _level_numbers(), "UNIFORM", "farcry5")
        self._size = (0, 0)
        self._depth: Texture | None = None
        self._groups: list[Any] = []
        self.cells: Buffer = gpu.buffer("farcry5 depth", 4, "STORAGE", "farcry5")
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
        self.cells = self._gpu.buffer("farcry5 depth", 4 * total, "STORAGE", "farcry5")
        return True

    def build(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView, depth: Texture) -> None:
        """Record the reduction of a surface's depths."""
        if depth is not self._depth:
            self._depth = depth
            self._groups = [
                self._gpu.bind(
                    "farcry5 pyramid",
                    self._layout,
                    {0: (self._numbers, _ALIGNMENT * level, 16), 1: depth, 2: self.cells},
                )
                for level in range(len(_cells(frame.size)))
            ]
        run = timer.compute_pass(encoder, "pyramid")
        run.set_bind_group(0, view.bind_group)
        for level, (group, (width, height)) in enumerate(zip(self._groups, _cells(frame.size), strict=True)):
            run.set_pipeline(self._pipelines[level > 0])
            run.set_bind_group(1, group)
            run.dispatch_workgroups(-(-width // _TILE), -(-height // _TILE))
        run.end()
        self.seen = frame

    def projection(self, frame: Frame) -> NDArray[np.float64] | None:
        """4 x 4 (rows first) from metres relative to `frame`'s camera to the clip space of what was seen."""
        if self.seen is None:
            return None
        shift = np.eye(4)
        shift[:2, 3] = frame.grid.metres @ (frame.eye - self.seen.eye)
        shift[2, 3] = frame.camera.z - self.seen.camera.z
        return self.seen.view_projection @ shift


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
