"""Level-0 samples in square blocks for rays: voids filled as in pictures, with the range of heights of every 2^k cells.

A cell lies between four sample centres and is named by its upper left one; sample coordinates (u, v) count samples to
the right and down from the first one's centre.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from orogen.keys import NODE_SIZE, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.reduce import filled
from orogen.queries.pages import Pages, Side
from orogen.streaming.tiles import DecodedTiles

F32 = NDArray[np.float32]

MANY = 1 << 20
"""Blocks whose bounds are held together; those of more are looked up where rays pass."""
UNKNOWN = np.float32(1e6)
"""Metres: no ground is as far above or below zero."""


Levels = list[tuple[F32 | Side, F32 | Side]]
"""Lowest and highest surface over squares of cells, indexed by (rows, columns): single squares first, each level's
twice as wide as those before, the last a single one over all. +inf and -inf where there is no surface."""


@dataclass(frozen=True)
class Block:
    """The samples around a square of cells."""

    row: int
    """Row of the first sample."""
    column: int
    """Column of the first sample."""
    heights: F32
    """(cell rows + 1, cell columns + 1) metres; NaN only where no sample of a cell is valid."""
    valid: NDArray[np.uint8]
    """The same shape, 1 where a sample is valid; (0, 0) where all are."""

    @cached_property
    def levels(self) -> list[tuple[F32, F32]]:
        """Heights of 1, 2 x 2, 4 x 4 ... cells."""
        h = self.heights
        corners = h[:-1, :-1], h[:-1, 1:], h[1:, :-1], h[1:, 1:]
        low = np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3]))
        high = np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3]))
        return _levels(low, high)

    @cached_property
    def flat(self) -> tuple[F32, F32, NDArray[np.int64], NDArray[np.int64]]:
        """The levels for compiled code: low and high one after the other, each level's first entry, and its shape."""
        starts = np.cumsum([0, *(low.size for low, _ in self.levels[:-1])])
        low, high = (np.concatenate([level[part].ravel() for level in self.levels]) for part in (0, 1))
        return low, high, starts, np.array([part.shape for part, _ in self.levels], np.int64)


def _levels(low: F32, high: F32) -> list[tuple[F32, F32]]:
    """The levels above single squares; NaN stands for no surface."""
    low, high = _surfaceless(low, high)
    levels = [(low, high)]
    while low.size > 1:
        low, high = _halved(low, np.minimum), _halved(high, np.maximum)
        levels.append((low, high))
    return levels


def _surfaceless(low: F32, high: F32) -> tuple[F32, F32]:
    """Ranges that nothing is within where there is no surface (NaN)."""
    empty = np.isnan(low)
    if not empty.any():
        return low, high
    return np.where(empty, np.float32(np.inf), low), np.where(empty, np.float32(-np.inf), high)


def _halved(values: F32, extreme: np.ufunc) -> F32:
    if values.shape[0] % 2 or values.shape[1] % 2:
        values = np.pad(values, ((0, values.shape[0] % 2), (0, values.shape[1] % 2)), mode="edge")
    values = extreme(values[0::2], values[1::2])
    return extreme(values[:, 0::2], values[:, 1::2])


class Blocks:
    """The blocks of a pyramid, those used last kept. Thread-safe."""

    def __init__(self, pyramid: Pyramid, tiles: DecodedTiles, memory: int) -> None:
        """`memory`: bytes of blocks that are kept."""
        self._pyramid, self._tiles = pyramid, tiles
        self._level = min(1, pyramid.level_count - 1)
        self.side = NODE_SIZE << self._level
        """Cells along a block's side."""
        self._room = max(1, memory // (16 * self.side**2))
        self._kept: OrderedDict[tuple[int, int], Block] = OrderedDict()
        self._bounds: Levels | None = None
        self._lock = threading.Lock()

    def bounds(self) -> Levels:
        """Heights of 1, 2 x 2, 4 x 4 ... blocks; all that can be until the pyramid is built."""
        if self._bounds is None:
            rows, cols = self._count()
            if rows * cols > MANY:
                return self._paged()
            found = self._widened_nodes(0, slice(0, rows), slice(0, cols))
            if found is None:
                return self._unknown()
            self._bounds = list(_levels(*found))
        return self._bounds

    def _widened_nodes(self, k: int, rows: slice, cols: slice) -> tuple[F32, F32] | None:
        """Lowest and highest in a window of squares of 2^k blocks and around them; None while they are unknown.

        Cells reach into the next node, and filled voids into all.
        """
        level = self._level + k
        shape = [-(-size // NODE_SIZE) for size in level_shape(self._pyramid.grid.shape, level)]
        window = [
            slice(max(part.start - 1, 0), min(part.stop + 1, size))
            for part, size in zip((rows, cols), shape, strict=True)
        ]
        nodes = self._pyramid.node_bounds(level, *window)
        if nodes is None:
            return None
        inner = tuple(
            slice(part.start - whole.start, part.stop - whole.start)
            for part, whole in zip((rows, cols), window, strict=True)
        )
        return _widened(nodes[..., 0], np.fmin)[inner], _widened(nodes[..., 1], np.fmax)[inner]

    def _paged(self) -> Levels:
        if self._pyramid.node_bounds(self._pyramid.level_count - 1) is None:
            return self._unknown()
        levels: Levels = []
        rows, cols = self._count()
        for k in range(self._pyramid.level_count - self._level):
            pages = Pages((rows, cols), partial(self._page, k))
            levels.append((Side(pages, 0), Side(pages, 1)))
            rows, cols = -(-rows // 2), -(-cols // 2)
        self._bounds = levels
        return levels

    def _page(self, k: int, rows: slice, cols: slice) -> tuple[F32, F32]:
        found = self._widened_nodes(k, rows, cols)
        assert found is not None, "bounds that were known once stay so"
        return _surfaceless(*found)

    def _count(self) -> tuple[int, int]:
        """Rows and columns of blocks: a last sample alone begins no cell."""
        rows, cols = self._pyramid.grid.shape
        return max(1, -(-(rows - 1) // self.side)), max(1, -(-(cols - 1) // self.side))

    def _unknown(self) -> Levels:
        rows, cols = self._count()
        levels: Levels = []
        while True:
            # no memory, however many blocks there are
            levels.append((np.broadcast_to(-UNKNOWN, (rows, cols)), np.broadcast_to(UNKNOWN, (rows, cols))))
            if rows == cols == 1:
                return levels
            rows, cols = -(-rows // 2), -(-cols // 2)

    def get(self, row: int, column: int) -> Block:
        """The block in a row and column of blocks. Raises what the pyramid raises."""
        key = (row, column)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        block = self._read(row * self.side, column * self.side)
        with self._lock:
            self._kept[key] = block
            while len(self._kept) > self._room:
                self._kept.popitem(last=False)
        return block

    def _read(self, row: int, column: int) -> Block:
        height, width = self._pyramid.grid.shape
        bottom, right = min(row + self.side + 1, height), min(column + self.side + 1, width)
        # voids are filled from their neighbours, those outside the block too
        top, left = max(row - 1, 0), max(column - 1, 0)
        around = self._tiles.window(0, slice(top, min(bottom + 1, height)), slice(left, min(right + 1, width)))
        part = np.s_[row - top : bottom - top, column - left : right - left]
        void = np.isnan(around[part])
        if not void.any():
            return Block(row, column, np.ascontiguousarray(around[part]), np.empty((0, 0), np.uint8))
        heights = np.ascontiguousarray(filled(around)[part])
        return Block(row, column, heights, (~void).astype(np.uint8))


def _widened(values: F32, extreme: np.ufunc) -> F32:
    """Values of nodes with those of their neighbours."""
    padded = np.pad(values, 1, mode="edge")
    padded = extreme(extreme(padded[:-2], padded[1:-1]), padded[2:])
    return extreme(extreme(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
