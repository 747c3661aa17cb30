"""Rasters that are computed where they are looked at."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.grid import Grid

TILE = 256
"""Samples along a side of what is computed at once."""


@dataclass(frozen=True)
class Field:
    """A raster over a part of the data, on its samples, computed by window: it may be larger than the memory."""

    name: str
    """What it shows."""
    grid: Grid
    """Its georeference."""
    dtype: str
    """Type of its values: 'uint8' or 'float32'."""
    nodata: float
    """The value where there is nothing to tell; may be NaN."""
    compute: Callable[[slice, slice], NDArray[Any]]
    """Gives the values (rows, columns) of a window that lies inside."""

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        """Values (rows, columns) of a window. Raises what reading the data raises."""
        for axis, part, size in zip(("rows", "columns"), (rows, cols), self.grid.shape, strict=True):
            if part.step not in (None, 1) or not 0 <= part.start < part.stop <= size:
                raise SettingsError(f"{self.name}: expected {axis} within 0 to {size}, got {part.start} to {part.stop}")
        return self.compute(rows, cols)

    def tiles(self, size: int = TILE) -> Iterator[tuple[slice, slice]]:
        """Windows that cover it, `size` samples wide and high or less."""
        height, width = self.grid.shape
        for row in range(0, height, size):
            for column in range(0, width, size):
                yield slice(row, min(row + size, height)), slice(column, min(column + size, width))

    def computed(self, size: int = TILE) -> Iterator[tuple[slice, slice, NDArray[Any]]]:
        """The tiles in their order, with their values: a few are computed ahead, in threads."""
        ahead = 2 * (os.cpu_count() or 1)
        waiting: deque[tuple[slice, slice, Future[NDArray[Any]]]] = deque()
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            try:
                for rows, cols in self.tiles(size):
                    waiting.append((rows, cols, pool.submit(self.compute, rows, cols)))
                    if len(waiting) > ahead:
                        first = waiting.popleft()
                        yield first[0], first[1], first[2].result()
                while waiting:
                    first = waiting.popleft()
                    yield first[0], first[1], first[2].result()
            finally:
                pool.shutdown(cancel_futures=True)

    def values(self) -> NDArray[Any]:
        """All of it, (rows, columns)."""
        out = np.empty(self.grid.shape, self.dtype)
        for rows, cols, values in self.computed():
            out[rows, cols] = values
        return out


def part_of(grid: Grid, rows: slice, cols: slice) -> Grid:
    """The georeference of a window of a grid."""
    a, b, _, d, e, _ = grid.transform
    x, y = grid.to_crs(cols.start, rows.start)
    transform = (a, b, float(x), d, e, float(y))
    return Grid(cols.stop - cols.start, rows.stop - rows.start, transform, grid.crs, grid.ground_scale)
