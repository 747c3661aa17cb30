"""The bintree of right-triangular patches, two of which across a common hypotenuse are a diamond.

Levels count bisections upwards: the patches of level 0 are half squares of n samples, those of level l + 1 have twice
the area, those below 0 lie within the bilinear cells. A diamond is named by its level and its centre (cx, cy) in units
of `half(level)`: half the side of its square on even levels, half its diagonal on odd ones, whose squares stand on a
corner. Centres are (odd, odd) on even levels, and on odd ones those whose sum is odd. Lengths are in subtexels from
the first sample.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orogen.frame import subtexel_bits
from orogen.grid import Grid

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_AXES = ((-1, 0), (1, 0), (0, -1), (0, 1))
_DIAGONALS = ((-1, -1), (1, -1), (-1, 1), (1, 1))
_LIFT = 32
"""Added to levels in codes, which are not negative."""


class Diamonds:
    """The diamonds over a raster."""

    def __init__(self, grid: Grid, n: int) -> None:
        """`n`: quads along the legs of a patch that has all its vertices, a power of two."""
        self.grid = grid
        self.n = n
        self.bits = subtexel_bits(grid)
        self.last = np.array([grid.width, grid.height]) - 1
        """Column and row of the last sample."""
        self.top = 2 * max(0, math.ceil(math.log2(max(1, int(self.last.max())) / n)))
        """Level of the two patches that cover the raster together."""
        self.lowest = -2 * self.bits
        """The finest level: there, vertices are a subtexel apart."""

    def half(self, level: int) -> int:
        """Half the extent of a level's diamonds along the axes, in subtexels."""
        return int(self.n * 2.0 ** (self.bits - 1 + -(-level // 2)))

    def unit(self, level: int) -> int:
        """Subtexels that all positions of a level's vertices are multiples of."""
        return 1 << self.bits + min(0, level // 2)

    def shape(self, level: int) -> tuple[int, int]:
        """(rows, columns) of a table of a level's diamonds by cy and cx."""
        last = (self.last << self.bits) // self.half(level)
        return int(last[1]) + 2, int(last[0]) + 2

    def apex(self, level: int, cx: Ints, cy: Ints, side: Ints) -> tuple[Ints, Ints]:
        """From a diamond's centre to the right angle of its patch on a side (0 or 1), in units of `half`."""
        sign = 2 * side - 1
        if level % 2:
            upright = cx % 2
            return sign * (1 - upright), sign * upright
        falling = ((cx + cy) // 2) % 2
        return sign, np.where(falling == 1, -sign, sign)

    def corners(self, level: int, cx: Ints, cy: Ints, side: Ints) -> Ints:
        """(n, 3, 2) subtexels: both ends of the hypotenuse, then the right angle; all the same way round."""
        ox, oy = self.apex(level, cx, cy, side)
        steps = np.stack([np.stack([-oy, ox], -1), np.stack([oy, -ox], -1), np.stack([ox, oy], -1)], axis=1)
        return (np.stack([cx, cy], axis=-1)[:, None] + steps) * self.half(level)

    def exists(self, level: int, cx: Ints, cy: Ints, side: Ints) -> NDArray[np.bool_]:
        """Whether a patch lies over the raster, in part at least."""
        last = (self.last << self.bits) // self.half(level)
        within = (cx > 0) & (cy > 0) & (cx < last[0]) & (cy < last[1])
        if not within.all():
            rest = np.flatnonzero(~within)
            within[rest] = self._reaches(self.corners(level, cx[rest], cy[rest], side[rest]))
        return within

    def _reaches(self, corners: Ints) -> NDArray[np.bool_]:
        """Whether triangles (n, 3, 2) have an area in common with the raster."""
        x, y = corners[..., 0], corners[..., 1]
        limit_x, limit_y = (self.last << self.bits).tolist()
        # the lowest y of the part where x is less than the limit: at a corner, or where a side crosses that
        inside = x < limit_x
        lowest = np.where(inside, y, np.inf).min(axis=1)
        for i, j in ((0, 1), (1, 2), (2, 0)):
            crosses = inside[:, i] != inside[:, j]
            step = np.where(crosses, x[:, j] - x[:, i], 1)
            at = y[:, i] + (limit_x - x[:, i]) * (y[:, j] - y[:, i]) / step
            lowest = np.where(crosses, np.minimum(lowest, at), lowest)
        return (lowest < limit_y) & (corners.max(axis=1) > 0).all(axis=1)

    def over_raster(self, level: int) -> tuple[Ints, Ints]:
        """cx, cy of all diamonds of a level of which some patch exists."""
        cy, cx = (index.ravel() for index in np.indices(self.shape(level)))
        fits = (cx + cy) % 2 == 1 if level % 2 else (cx % 2 == 1) & (cy % 2 == 1)
        cx, cy = cx[fits].astype(np.int64), cy[fits].astype(np.int64)
        side = np.zeros_like(cx)
        there = self.exists(level, cx, cy, side) | self.exists(level, cx, cy, side + 1)
        return cx[there], cy[there]

    def children(self, level: int, cx: Ints, cy: Ints) -> tuple[Ints, Ints, Ints]:
        """The four patches (cx, cy, side) of the level below that diamonds are split into: (n, 4) each."""
        dx, dy = np.array(_DIAGONALS if level % 2 else _AXES).T
        scale = 2 if level % 2 else 1
        x, y = scale * cx[:, None] + dx, scale * cy[:, None] + dy
        # the right angle of each is the diamond's centre
        side = np.where((dx > 0) | ((dx == 0) & (dy > 0)), 0, 1)
        return x, y, np.broadcast_to(side, x.shape)

    def box(self, level: int, cx: Ints, cy: Ints) -> tuple[Floats, Floats]:
        """(n, 2) columns and rows of first and last samples of a box around diamonds.

        It holds the boxes of all diamonds that are there once this one has been split, at any level below: twice the
        half extent for odd levels, three times for even ones.
        """
        half = self.half(level)
        centre = np.stack([cx, cy], axis=-1) * half
        reach = half * (2 if level % 2 else 3)
        return self._clipped(centre - reach, centre + reach)

    def patch_box(self, level: int, cx: Ints, cy: Ints, side: Ints) -> tuple[Floats, Floats]:
        """(n, 2) columns and rows of the first and the last sample of patches, as far as the raster goes."""
        corners = self.corners(level, cx, cy, side)
        return self._clipped(corners.min(axis=1), corners.max(axis=1))

    def _clipped(self, first: Ints, last: Ints) -> tuple[Floats, Floats]:
        scale = 1 << self.bits
        return np.clip(first / scale, 0, self.last), np.clip(last / scale, 0, self.last)


def code(level: int | Ints, cx: Ints, cy: Ints, side: Ints | int) -> Ints:
    """One number for each patch."""
    return (level + _LIFT) << 57 | cy << 29 | cx << 1 | side


def place(number: int) -> tuple[int, int, int, int]:
    """Level, cx, cy and side of a patch, from its code."""
    part = (1 << 28) - 1
    return (number >> 57) - _LIFT, number >> 1 & part, number >> 29 & part, number & 1
