"""Bounds of the blocks of terrains that are too large to hold those of all: looked up where rays pass."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
PAGE = 64
"""Squares along a page's side."""
KEPT = 512
"""Pages of a level that are kept: 16 MB."""


class Pages:
    """Lowest and highest of one level's squares, read a page at a time. Thread-safe."""

    def __init__(self, shape: tuple[int, int], read: Callable[[slice, slice], tuple[F32, F32]]) -> None:
        """`read` gives lowest and highest of a window of squares."""
        self.shape = shape
        self._read = read
        self._kept: OrderedDict[int, tuple[F32, F32]] = OrderedDict()
        self._lock = threading.Lock()

    def at(self, part: int, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> F32:
        """Lowest (part 0) or highest (1) of squares by row and column."""
        across = -(-self.shape[1] // PAGE)
        page = rows // PAGE * across + cols // PAGE
        out = np.empty(rows.shape, np.float32)
        for number in np.unique(page):
            here = page == number
            top, left = int(number) // across * PAGE, int(number) % across * PAGE
            out[here] = self._page(int(number), top, left)[part][rows[here] - top, cols[here] - left]
        return out

    def _page(self, number: int, top: int, left: int) -> tuple[F32, F32]:
        with self._lock:
            if number in self._kept:
                self._kept.move_to_end(number)
                return self._kept[number]
        page = self._read(slice(top, min(top + PAGE, self.shape[0])), slice(left, min(left + PAGE, self.shape[1])))
        with self._lock:
            self._kept[number] = page
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return page


class Side:
    """The lowest or the highest of pages, indexed like an array (rows, columns)."""

    def __init__(self, pages: Pages, part: int) -> None:
        self.shape = pages.shape
        self._pages, self._part = pages, part

    def __getitem__(self, index: tuple[NDArray[np.int64], NDArray[np.int64]]) -> F32:
        return self._pages.at(self._part, *index)
