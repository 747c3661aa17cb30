"""What is worked out about a terrain before tiles are drawn: heights of coarse vertices, ranges of heights."""

from __future__ import annotations

import logging
import time

import numpy as np
from numpy.typing import NDArray

from orogen.lod.quadtree import PatchTree, Table
from orogen.streaming.samples import Samples

_log = logging.getLogger("orogen")

F32 = NDArray[np.float32]
Ints = NDArray[np.int64]

CELL_BITS = 3
_CELL = 1 << CELL_BITS
_WINDOW = 512
"""Samples along the windows that are read at once: a multiple of a cell."""


class Ground:
    """Exact heights at any vertex. Vertices beyond the raster are drawn on its edge, and have the height there."""

    def __init__(self, samples: Samples, tree: PatchTree) -> None:
        """Reads all samples once, and raises what reading them raises. `tree`: with patches of 1 sample."""
        samples.wait()
        self._samples = samples
        self.shape = samples.shape
        """(rows, columns) of samples."""
        self._last = np.array(samples.shape) - 1
        start = time.monotonic()
        cells = [max(1, -(-int(last) >> CELL_BITS)) for last in self._last]
        low, high = np.empty(cells, np.float32), np.empty(cells, np.float32)
        self._coarse = np.empty([size + 1 for size in cells], np.float32)
        for y in range(0, max(1, self._last[0]), _WINDOW):
            for x in range(0, max(1, self._last[1]), _WINDOW):
                parts = [slice(a, min(a + _WINDOW, last) + 1) for a, last in zip((y, x), self._last, strict=True)]
                heights = self._read(*parts)
                rows, cols = (_marks(part.stop - 1 - part.start) for part in parts)
                place = np.s_[y >> CELL_BITS :, x >> CELL_BITS :]
                self._coarse[place][: rows.size, : cols.size] = heights[np.ix_(rows, cols)]
                low[place][: rows.size - 1, : cols.size - 1] = _blocks(heights, np.minimum)
                high[place][: rows.size - 1, : cols.size - 1] = _blocks(heights, np.maximum)
        levels = [np.stack([low, high], axis=-1)] * (CELL_BITS + 1)
        for _ in range(CELL_BITS + 1, tree.level_count):
            low, high = _pairs(low, np.minimum), _pairs(high, np.maximum)
            levels.append(np.stack([low, high], axis=-1))
        self.ranges = Table.of(levels[: tree.level_count], CELL_BITS)
        """Lowest and highest height (m) of patches; below 8 samples those of 8."""
        _log.info("hqterrain: %d samples read in %.1f s", np.prod(samples.shape), time.monotonic() - start)

    def grid(self, level: int, rows: Ints, cols: Ints) -> NDArray[np.float64]:
        """Heights at rows and columns counted in steps of 2^level samples; between samples they are bilinear."""
        if level >= CELL_BITS:
            r, c = (
                np.minimum(at << (level - CELL_BITS), size - 1)
                for at, size in zip((rows, cols), self._coarse.shape, strict=True)
            )
            return self._coarse[np.ix_(r, c)].astype(np.float64)
        y, x = (np.minimum(at * 2.0**level, last) for at, last in zip((rows, cols), self._last, strict=True))
        first = [np.floor(at).astype(np.int64) for at in (y, x)]
        next_ = [np.minimum(at + 1, last) for at, last in zip(first, self._last, strict=True)]
        z = self._read(*(slice(int(a[0]), int(b[-1]) + 1) for a, b in zip(first, next_, strict=True))).astype(
            np.float64
        )
        (j, i), (below, right) = ([at - a[0] for at, a in zip(part, first, strict=True)] for part in (first, next_))
        z = z[:, i] + (z[:, right] - z[:, i]) * (x - first[1])
        return z[j] + (z[below] - z[j]) * (y - first[0])[:, None]

    def _read(self, rows: slice, cols: slice) -> F32:
        return self._samples.window(rows, cols)[0]


def _marks(last: int) -> Ints:
    """Every cell's first sample, and the last one."""
    return np.append(np.arange(0, max(last, 1), _CELL), last)


def _blocks(heights: F32, pick: np.ufunc) -> F32:
    """Lowest or highest of the cells of a window, the samples on their far edges included."""
    for axis in (0, 1):
        starts = _marks(heights.shape[axis] - 1)
        inner = pick.reduceat(heights, starts[:-1], axis=axis)
        heights = pick(inner, heights.take(starts[1:], axis=axis))
    return heights


def _pairs(values: F32, pick: np.ufunc) -> F32:
    for axis in (0, 1):
        values = pick.reduceat(values, np.arange(0, values.shape[axis], 2), axis=axis)
    return values
