"""The compiled way through a block's cells. Importing this takes numba; `march.solve` is the same in numpy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError

try:
    import numba
except ImportError as error:
    raise SettingsError('expected the package numba; run: pip install "orogen[compiled]"') from error

F = TypeVar("F", bound=Callable[..., Any])
F64 = NDArray[np.float64]


def _compiled(function: F) -> F:
    return cast(F, numba.njit(cache=True, nogil=True)(function))


@_compiled
def _first_root(f0: float, f1: float, f2: float, length: float, after: float) -> float:
    """The first root of f0 + f1 s + f2 s^2 in (after, length]; -1 if there is none."""
    if f2 == 0.0:
        if f1 == 0.0:
            return -1.0
        s = -f0 / f1
        return s if after < s <= length else -1.0
    root = f1 * f1 - 4.0 * f2 * f0
    if root < 0.0:
        return -1.0
    q = -0.5 * (f1 + math.copysign(math.sqrt(root), f1))
    a = q / f2
    b = f0 / q if q != 0.0 else a
    if a > b:
        a, b = b, a
    if after < a <= length:
        return a
    return b if after < b <= length else -1.0


@_compiled
def solve(
    heights: NDArray[np.float32], valid: NDArray[np.uint8], low: NDArray[np.float32], high: NDArray[np.float32],
    start: NDArray[np.int64], shape: NDArray[np.int64], corner: tuple[int, int], rays: NDArray[Any],
    which: NDArray[np.int64], enter: F64, leave: F64, side: NDArray[np.int8], lift: float,
) -> F64:  # fmt: skip
    """First hits t of rays in a block between `enter` and `leave`; NaN for none. Updates `side`. See `march.solve`."""
    result = np.full(len(which), np.nan)
    top = len(start) - 1
    rows, cols = shape[0, 0], shape[0, 1]
    partial = valid.size > 0
    for n in range(len(which)):
        ray = which[n]
        u0, v0 = rays[0, ray] - corner[1], rays[1, ray] - corner[0]
        du, dv = rays[2, ray], rays[3, ray]
        c0, c1, c2 = rays[4, ray] + lift, rays[5, ray], rays[6, ray]
        t, end = enter[n], leave[n]
        i = min(max(math.floor(u0 + du * t), 0), cols - 1)
        j = min(max(math.floor(v0 + dv * t), 0), rows - 1)
        k = top
        state = side[n]
        zt = c0 + t * (c1 + t * c2)
        while True:
            left, above = (i >> k) << k, (j >> k) << k
            right, below = left + (1 << k), above + (1 << k)
            tx = ((right if du > 0.0 else left) - u0) / du if du != 0.0 else math.inf
            ty = ((below if dv > 0.0 else above) - v0) / dv if dv != 0.0 else math.inf
            e = min(max(min(tx, ty), t), end)
            ze = c0 + e * (c1 + e * c2)
            entry = start[k] + (j >> k) * shape[k, 1] + (i >> k)
            lowest = min(zt, ze)
            if c2 > 0.0:
                bottom = -0.5 * c1 / c2
                if t < bottom < e:
                    lowest = c0 + bottom * (c1 + bottom * c2)
            if lowest > high[entry]:
                state = 1 if low[entry] <= high[entry] or lift > 0.0 else 0
            elif max(zt, ze) < low[entry]:
                state = -1 if lift == 0.0 else 1
            elif k > 0:
                k -= 1
                continue
            else:
                h00, h10 = float(heights[j, i]), float(heights[j, i + 1])
                h01, h11 = float(heights[j + 1, i]), float(heights[j + 1, i + 1])
                x, y = min(max(u0 + du * t - i, 0.0), 1.0), min(max(v0 + dv * t - j, 0.0), 1.0)
                across, along = h10 - h00, h01 - h00
                twist = h11 - h10 - along
                f0 = zt - (h00 + across * x + along * y + twist * x * y)
                f1 = c1 + 2.0 * c2 * t - (across * du + along * dv + twist * (x * dv + y * du))
                f2 = c2 - twist * du * dv
                length = e - t
                s = 0.0
                if f0 != 0.0 and (state == 0 or (f0 > 0.0) == (state > 0)):
                    s = _first_root(f0, f1, f2, length, 0.0)
                f_end = f0 + length * (f1 + length * f2)
                if s < 0.0 and (f_end < 0.0) != (f0 < 0.0):
                    s = length  # a root that rounding has put past the end
                while s >= 0.0:
                    solid = True
                    if partial:
                        p, q = min(max(x + du * s, 0.0), 1.0), min(max(y + dv * s, 0.0), 1.0)
                        solid = (
                            (valid[j, i] * (1.0 - p) + valid[j, i + 1] * p) * (1.0 - q)
                            + (valid[j + 1, i] * (1.0 - p) + valid[j + 1, i + 1] * p) * q
                        ) >= 0.5  # fmt: skip
                    if solid:
                        result[n] = t + s
                        break
                    s = _first_root(f0, f1, f2, length, s)
                if s >= 0.0:
                    break
                state = -1 if f_end < 0.0 and lift == 0.0 else 1
            if e >= end:
                break
            if tx <= ty:
                moved = i
                i = right if du > 0.0 else left - 1
                if i < 0 or i >= cols:
                    break
                crossed = (moved ^ i) >> (k + 1)
                there = math.floor(v0 + dv * e)
                j = min(max(there, j if dv >= 0.0 else above), below - 1 if dv >= 0.0 else j)
                j = min(j, rows - 1)
            else:
                moved = j
                j = below if dv > 0.0 else above - 1
                if j < 0 or j >= rows:
                    break
                crossed = (moved ^ j) >> (k + 1)
                there = math.floor(u0 + du * e)
                i = min(max(there, i if du >= 0.0 else left), right - 1 if du >= 0.0 else i)
                i = min(i, cols - 1)
            t, zt = e, ze
            if k < top and crossed != 0:
                k += 1
        side[n] = state
    return result
