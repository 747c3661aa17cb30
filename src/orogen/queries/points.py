"""Heights and slopes of the surface at points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.keys import NODE_SIZE, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.reduce import filled
from orogen.streaming.tiles import DecodedTiles

F64 = NDArray[np.float64]


def surface_at(pyramid: Pyramid, tiles: DecodedTiles, tx: F64, ty: F64, slopes: bool = False) -> list[F64]:
    """Heights (m) at texel coordinates of one shape; with `slopes` also d height / d tx and d ty (m per texel).

    Bilinear between sample centres of level 0 (of the finest level that can be read before the pyramid is built), voids
    filled as in pictures; NaN outside the hull of the centres and where less than half of the weight is valid. Slopes
    on a cell's edge are those of the cell to the right or below. Raises what the pyramid raises.
    """
    level = next(level for level in range(pyramid.level_count) if tiles.readable(level))
    rows, cols = level_shape(pyramid.grid.shape, level)
    height, width = pyramid.grid.shape
    x, y = tx.ravel(), ty.ravel()
    inside = (x >= 0.5) & (y >= 0.5) & (x <= width - 0.5) & (y <= height - 0.5)
    u = np.clip(x[inside] / 2**level - 0.5, 0, cols - 1)
    v = np.clip(y[inside] / 2**level - 0.5, 0, rows - 1)
    i = np.minimum(u.astype(np.int64), max(cols - 2, 0))
    j = np.minimum(v.astype(np.int64), max(rows - 2, 0))
    u -= i
    v -= j
    found = np.empty((3 if slopes else 1, len(u)))
    for part in _by_chunk(j, i, cols):
        found[:, part] = _cells(tiles, level, (rows, cols), j[part], i[part], u[part], v[part], slopes)
    found[1:] /= 2**level
    results = np.full((len(found), x.size), np.nan)
    results[:, inside] = found
    return [result.reshape(tx.shape) for result in results]


def _by_chunk(j: NDArray[np.int64], i: NDArray[np.int64], cols: int) -> list[NDArray[np.int64]] | list[slice]:
    """Points in groups whose cells lie in one chunk."""
    chunk = (j // NODE_SIZE) * (cols // NODE_SIZE + 1) + i // NODE_SIZE
    if not chunk.size or (chunk == chunk[0]).all():
        return [slice(None)] if chunk.size else []
    if chunk.max() < 1 << 16:
        chunk = chunk.astype(np.uint16)  # sorted by radix: far quicker
    order = np.argsort(chunk, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(chunk[order])) + 1)


def _cells(
    tiles: DecodedTiles, level: int, shape: tuple[int, int], j: NDArray[np.int64], i: NDArray[np.int64], x: F64, y: F64,
    slopes: bool,
) -> list[F64]:  # fmt: skip
    """Heights, with `slopes` the two slopes too, at (x, y), 0 to 1, in the cells right of and below samples (i, j)."""
    top, left = max(int(j.min()) - 1, 0), max(int(i.min()) - 1, 0)
    bottom, right = min(int(j.max()) + 3, shape[0]), min(int(i.max()) + 3, shape[1])
    window = tiles.window(level, slice(top, bottom), slice(left, right))
    void = np.isnan(window)
    holes = bool(void.any())
    values = filled(window) if holes else window
    first = (j - top) * window.shape[1] + (i - left)
    across, down = min(1, shape[1] - 1), window.shape[1] * min(1, shape[0] - 1)
    corners = first, first + across, first + down, first + down + across
    h00, h10, h01, h11 = (values.ravel()[corner].astype(np.float64) for corner in corners)
    if holes:
        # a corner without weight may be deep in a void: it must not spoil the others
        weights = (1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y
        terms = zip(weights, (h00, h10, h01, h11), strict=True)
        height = sum(np.where(weight == 0, 0.0, weight * value) for weight, value in terms)
        missing = sum(weight * void.ravel()[corner] for weight, corner in zip(weights, corners, strict=True))
        height = np.where(np.asarray(missing) > 0.5, np.nan, height)
    else:
        upper = h00 + (h10 - h00) * x
        height = upper + (h01 + (h11 - h01) * x - upper) * y
    if not slopes:
        return [height]
    none = 0.0 * height  # NaN where the height is
    return [height, (h10 - h00) * (1 - y) + (h11 - h01) * y + none, (h01 - h00) * (1 - x) + (h11 - h10) * x + none]
