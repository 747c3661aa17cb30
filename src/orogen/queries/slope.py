"""Steepness and direction of slopes at the samples, by Horn's third-order differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.grid import Grid
from orogen.source.scale import ground_scale, parse_crs

F64 = NDArray[np.float64]


def gradients(around: NDArray[np.float32]) -> tuple[F64, F64]:
    """d height / d column and / d row (m per sample) of the samples inside a window that is one sample wider all round.

    Berthold K. P. Horn, "Hill shading and the reflectance map", 1981: differences of 3 x 3 samples, the middle ones
    twice. A missing neighbour (NaN) continues the line from the opposite one, or the plane of those beside it, so that
    planes stay planes; where there is no opposite one it is as high as the sample.
    """
    h = around.astype(np.float64)
    rows, cols = h.shape[0] - 2, h.shape[1] - 2

    def at(j: int, i: int) -> F64:
        return h[1 + j : 1 + j + rows, 1 + i : 1 + i + cols]

    middle = at(0, 0)
    ways = ((-1, 0), (1, 0), (0, -1), (0, 1))
    beside = {way: _first(at(*way), 2 * middle - at(-way[0], -way[1]), middle) for way in ways}
    corners = {(j, i): _first(at(j, i), beside[j, 0] + beside[0, i] - middle) for j in (-1, 1) for i in (-1, 1)}
    right, left = (corners[-1, i] + 2 * beside[0, i] + corners[1, i] for i in (1, -1))
    below, above = (corners[j, -1] + 2 * beside[j, 0] + corners[j, 1] for j in (1, -1))
    empty = np.isnan(middle)
    return np.where(empty, np.nan, (right - left) / 8), np.where(empty, np.nan, (below - above) / 8)


def _first(*values: F64) -> F64:
    """The first that is not NaN."""
    result = values[0]
    for other in values[1:]:
        result = np.where(np.isnan(result), other, result)
    return result


@dataclass(frozen=True)
class RowScale:
    """True metres per CRS unit in each row of a raster: degrees grow shorter, Mercator metres longer, to the poles."""

    rows: F64
    """Rows where it was measured."""
    scale: F64
    """(len(rows), 2) along x and y."""

    @classmethod
    def of(cls, grid: Grid, count: int = 65) -> RowScale:
        """Measured at up to `count` rows in the middle of the raster."""
        rows = np.unique(np.linspace(0, grid.height - 1, count).astype(int)).astype(np.float64)
        if grid.crs is None:
            return cls(rows, np.tile(np.array(grid.ground_scale), (len(rows), 1)))
        crs = parse_crs(grid.crs)
        x, y = grid.to_crs(grid.width / 2, rows + 0.5)
        step = float(np.sqrt(abs(grid.transform[0] * grid.transform[4] - grid.transform[1] * grid.transform[3])))
        return cls(rows, np.array([ground_scale(crs, float(a), float(b), step) for a, b in zip(x, y, strict=True)]))

    def at(self, rows: NDArray[np.int64]) -> tuple[F64, F64]:
        """Metres per CRS unit along x and y in rows."""
        return np.interp(rows, self.rows, self.scale[:, 0]), np.interp(rows, self.rows, self.scale[:, 1])


def to_metres(grid: Grid, scale: RowScale, rows: slice, across: F64, down: F64) -> tuple[F64, F64]:
    """Slopes to the east and to the north (m per m) from those per sample in a window of rows."""
    a, b, _, d, e, _ = grid.transform
    det = a * e - b * d
    sx, sy = scale.at(np.arange(rows.start, rows.stop))
    return (e * across - d * down) / det / sx[:, None], (a * down - b * across) / det / sy[:, None]
