"""The true surface: what every algorithm is measured against.

It is the bilinear interpolation of the level-0 samples at their centres, in float64, over the hull of the sample
centres [0.5, width - 0.5] x [0.5, height - 0.5] in texels. Invalid samples take part with the mean of the valid ones of
their 8 neighbours; the surface exists where the bilinear interpolation of coverage (1 valid, 0 invalid) is at least one
half.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.errors import SourceError

Floats = NDArray[np.float64]


class TrueSurface:
    """The true surface over an array of heights."""

    def __init__(self, heights: ArrayLike) -> None:
        """`heights`: (rows, columns) in metres, any number type; NaN (or infinite) where there is none."""
        values = np.asarray(heights)
        if values.ndim != 2 or 0 in values.shape:
            raise SourceError(f"expected heights of shape (rows, columns), got {values.shape}")
        if not np.issubdtype(values.dtype, np.floating):
            values = values.astype(np.float64 if values.dtype.itemsize > 2 else np.float32)
        self.valid: NDArray[np.bool_] = np.isfinite(values)
        """(rows, columns): where a sample is valid."""
        self.filled: NDArray[np.floating] = values if self.valid.all() else _filled(values, self.valid)
        """(rows, columns): heights with the invalid ones filled from their neighbours, NaN farther inside a void."""
        self.shape: tuple[int, int] = (values.shape[0], values.shape[1])
        """(rows, columns)."""

    def clamp(self, tx: ArrayLike, ty: ArrayLike) -> tuple[Floats, Floats]:
        """The nearest texel coordinates on the hull of the sample centres."""
        rows, columns = self.shape
        return (
            np.clip(np.asarray(tx, np.float64), 0.5, columns - 0.5),
            np.clip(np.asarray(ty, np.float64), 0.5, rows - 0.5),
        )

    def inside(self, tx: ArrayLike, ty: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Whether texel coordinates lie on the hull of the sample centres, widened by `margin` texels."""
        rows, columns = self.shape
        tx, ty = np.asarray(tx, np.float64), np.asarray(ty, np.float64)
        low, right, bottom = 0.5 - margin, columns - 0.5 + margin, rows - 0.5 + margin
        return (tx >= low) & (tx <= right) & (ty >= low) & (ty <= bottom)

    def height(self, tx: ArrayLike, ty: ArrayLike) -> Floats:
        """Metres at texel coordinates; NaN outside the hull and deep inside voids. Ignores coverage."""
        return np.where(self.inside(tx, ty), self._interpolate(self.filled, *self.clamp(tx, ty)), np.nan)

    def gradient(self, tx: ArrayLike, ty: ArrayLike) -> tuple[Floats, Floats]:
        """d height / d tx and d height / d ty in metres per texel; on a cell's edge that of the cell right or below."""
        x, y = self.clamp(tx, ty)
        (v00, v10, v01, v11), fx, fy = self._corners(self.filled, x, y)
        dx = (v10 - v00) * (1 - fy) + (v11 - v01) * fy
        dy = (v01 - v00) * (1 - fx) + (v11 - v10) * fx
        inside = self.inside(tx, ty)
        return np.where(inside, dx, np.nan), np.where(inside, dy, np.nan)

    def coverage(self, tx: ArrayLike, ty: ArrayLike) -> Floats:
        """0 to 1 at texel coordinates; 0 outside the hull."""
        if self.valid.all():
            return self.inside(tx, ty).astype(np.float64)
        return np.where(self.inside(tx, ty), self._interpolate(self.valid, *self.clamp(tx, ty)), 0.0)

    def exists(self, tx: ArrayLike, ty: ArrayLike) -> NDArray[np.bool_]:
        """Whether there is a surface at texel coordinates."""
        return self.coverage(tx, ty) >= 0.5

    def _corners(
        self, values: NDArray[np.generic], x: Floats, y: Floats
    ) -> tuple[tuple[Floats, Floats, Floats, Floats], Floats, Floats]:
        rows, columns = self.shape
        i = np.clip(np.floor(np.nan_to_num(x) - 0.5), 0, max(columns - 2, 0)).astype(np.int64)
        j = np.clip(np.floor(np.nan_to_num(y) - 0.5), 0, max(rows - 2, 0)).astype(np.int64)
        right, below = np.minimum(i + 1, columns - 1), np.minimum(j + 1, rows - 1)
        corner = [values[b, a].astype(np.float64) for b, a in ((j, i), (j, right), (below, i), (below, right))]
        return (corner[0], corner[1], corner[2], corner[3]), x - 0.5 - i, y - 0.5 - j

    def _interpolate(self, values: NDArray[np.generic], x: Floats, y: Floats) -> Floats:
        corners, fx, fy = self._corners(values, x, y)
        weights = ((1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy)
        # a corner without weight may be NaN: it must not spoil the others
        terms = [np.where(weight == 0, 0.0, weight * value) for weight, value in zip(weights, corners, strict=True)]
        return terms[0] + terms[1] + terms[2] + terms[3]


def _filled(values: NDArray[np.floating], valid: NDArray[np.bool_]) -> NDArray[np.floating]:
    # only the rim of the voids has valid neighbours: few samples, even of a large raster
    padded = np.pad(valid, 1)
    rows, columns = values.shape
    around = [(j, i) for j in range(3) for i in range(3) if (j, i) != (1, 1)]
    near = np.zeros(values.shape, bool)
    for j, i in around:
        near |= padded[j : j + rows, i : i + columns]
    row, column = np.nonzero(near & ~valid)
    total, count = np.zeros(row.size), np.zeros(row.size)
    for j, i in around:
        here = padded[row + j, column + i]
        neighbour = np.clip(row + j - 1, 0, rows - 1), np.clip(column + i - 1, 0, columns - 1)
        total += np.where(here, values[neighbour], 0.0)
        count += here
    result = np.where(valid, values, np.nan).astype(values.dtype)
    result[row, column] = total / count
    return result
