"""Heights on the CPU, anywhere, resident or not."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.keys import NODE_SIZE, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.streaming.tiles import DecodedTiles


class Queries:
    """Answers about a pyramid of heights in the coordinates of its data. Safe to use from several threads."""

    def __init__(self, pyramid: Pyramid, memory: int = 32 << 20) -> None:
        """`memory`: bytes of decoded tiles that are kept."""
        self._pyramid = pyramid
        self._tiles = DecodedTiles(pyramid, memory)

    def height_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Heights (m) of the surface at x, y in the data's CRS, of their broadcast shape.

        Bilinear between sample centres of level 0 (of the finest level that can be read before the pyramid is built);
        NaN outside the hull of the sample centres and where less than half of a point's surroundings is valid.
        """
        pyramid = self._pyramid
        tx, ty = np.broadcast_arrays(*pyramid.grid.to_texel(x, y))
        level = next(level for level in range(pyramid.level_count) if self._tiles.readable(level))
        rows, cols = level_shape(pyramid.grid.shape, level)
        height, width = pyramid.grid.shape
        inside = (tx >= 0.5) & (ty >= 0.5) & (tx <= width - 0.5) & (ty <= height - 0.5)
        result = np.full(tx.shape, np.nan)
        if inside.any():
            u = np.clip(tx[inside] / 2**level - 0.5, 0, cols - 1)
            v = np.clip(ty[inside] / 2**level - 0.5, 0, rows - 1)
            result[inside] = self._interpolate(level, u, v, rows, cols)
        return result

    def _interpolate(
        self, level: int, u: NDArray[np.float64], v: NDArray[np.float64], rows: int, cols: int
    ) -> NDArray[np.float64]:
        """Values at (u, v) in samples from the first one's centre."""
        i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
        out = np.empty(u.shape)
        chunk = (j // NODE_SIZE) * (cols // NODE_SIZE + 1) + i // NODE_SIZE
        order = np.argsort(chunk, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(chunk[order])) + 1):
            j0, i0 = int(j[part].min()), int(i[part].min())
            window = self._tiles.window(
                level, slice(j0, min(int(j[part].max()) + 2, rows)), slice(i0, min(int(i[part].max()) + 2, cols))
            ).astype(np.float64)
            total, weight = np.zeros(part.shape), np.zeros(part.shape)
            for dj in (0, 1):
                for di in (0, 1):
                    w = np.abs(1 - di - (u[part] - i[part])) * np.abs(1 - dj - (v[part] - j[part]))
                    value = window[
                        np.minimum(j[part] + dj - j0, window.shape[0] - 1),
                        np.minimum(i[part] + di - i0, window.shape[1] - 1),
                    ]
                    valid = np.isfinite(value)
                    total += np.where(valid, w * value, 0.0)
                    weight += np.where(valid, w, 0.0)
            with np.errstate(invalid="ignore", divide="ignore"):
                out[part] = np.where(weight >= 0.5, total / weight, np.nan)
        return out
