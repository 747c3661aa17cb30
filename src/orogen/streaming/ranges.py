"""How high and low nodes reach, looked up for those around the views: a level may have more nodes than memory holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.keys import NODE_SIZE as CHUNK
from orogen.pyramid.contract import Pyramid
from orogen.streaming.requests import LayerGrid

WHOLE = 128
"""Levels of at most so many rows and columns of nodes are kept whole."""
SPARE = 16
"""Nodes that are kept around those that were asked for: the next ones will be asked for next to them."""
KEPT = 4
"""Parts that are kept of a larger level: as many views can be far from each other."""


@dataclass(frozen=True)
class _Part:
    """Nodes of a level."""

    row: int
    """The first row."""
    col: int
    """The first column."""
    table: NDArray[np.float32]
    """(rows, columns, 3) lowest and highest height, with the nodes around, and the error (m)."""

    def holds(self, top: int, bottom: int, left: int, right: int) -> bool:
        """Whether all nodes of a window are in it."""
        rows, cols = self.table.shape[:2]
        return self.row <= top and bottom <= self.row + rows and self.col <= left and right <= self.col + cols


class NodeRanges:
    """Ranges and errors of the nodes of heights of a pyramid whose bounds are known. Belongs to one thread."""

    def __init__(self, pyramid: Pyramid, grid: LayerGrid) -> None:
        """`grid`: the nodes, which are as wide as some chunks of the pyramid."""
        self._pyramid = pyramid
        self._grid = grid
        self._everywhere = pyramid.height_range
        self._parts: dict[int, list[_Part]] = {}

    def over(self, level: int, rows: NDArray[np.integer], cols: NDArray[np.integer]) -> NDArray[np.float32]:
        """(..., 3) lowest and highest height that nodes and those around them reach, and their errors (m).

        Nodes past the level have those of the nearest one.
        """
        if not rows.size:
            return np.zeros((*rows.shape, 3), np.float32)
        count = self._grid.nodes(level)
        rows, cols = np.clip(rows, 0, count[0] - 1), np.clip(cols, 0, count[1] - 1)
        if max(count) <= WHOLE:
            part = self._part(level, (0, count[0], 0, count[1]))
        else:
            part = self._part(level, (int(rows.min()), int(rows.max()) + 1, int(cols.min()), int(cols.max()) + 1))
        return part.table[rows - part.row, cols - part.col]

    def _part(self, level: int, window: tuple[int, int, int, int]) -> _Part:
        parts = self._parts.setdefault(level, [])
        for part in parts:
            if part.holds(*window):
                return part
        rows, cols = self._grid.nodes(level)
        top, left = max(0, window[0] - SPARE), max(0, window[2] - SPARE)
        bottom, right = min(rows, window[1] + SPARE), min(cols, window[3] + SPARE)
        part = _Part(top, left, self._table(level, top, bottom, left, right))
        parts.insert(0, part)
        del parts[KEPT:]
        return part

    def _table(self, level: int, top: int, bottom: int, left: int, right: int) -> NDArray[np.float32]:
        scale = self._grid.node_size // CHUNK
        # chunks of the nodes and those that touch them, as far as there are any
        side = CHUNK << level
        shape = (-(-self._grid.grid.height // side), -(-self._grid.grid.width // side))
        starts = [max(0, first * scale - 1) for first in (top, left)]
        stops = [min(last * scale + 1, n) for last, n in zip((bottom, right), shape, strict=True)]
        chunks = self._pyramid.node_bounds(level, *(slice(a, b) for a, b in zip(starts, stops, strict=True)))
        assert chunks is not None, "bounds are known"
        out = np.full((bottom - top, right - left, 3), (np.inf, -np.inf, 0), np.float32)
        for dy in range(-1, scale + 1):
            for dx in range(-1, scale + 1):
                index = [
                    np.clip(np.arange(first, last) * scale + step, 0, n - 1) - start
                    for first, last, step, n, start in zip(
                        (top, left), (bottom, right), (dy, dx), shape, starts, strict=True
                    )
                ]
                near = chunks[np.ix_(*index)]
                out[..., 0] = np.fmin(out[..., 0], near[..., 0])
                out[..., 1] = np.fmax(out[..., 1], near[..., 1])
                if 0 <= dy < scale and 0 <= dx < scale:
                    out[..., 2] = np.fmax(out[..., 2], near[..., 2])
        # nodata all around
        out[..., :2] = np.where((out[..., 0] > out[..., 1])[..., None], self._everywhere, out[..., :2])
        return out
