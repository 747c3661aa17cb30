"""Two by two means that ignore nodata, level by level, and where a coarser surface differs from the finer one."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
SPAN = 128
"""Columns that are looked at together for nodata."""
HALF, QUARTER = np.float32(0.5), np.float32(0.25)


def extrapolated(last: F32, before: F32) -> F32:
    """The next sample of a line: linear from the last two, the last alone where the one before is nodata."""
    return np.where(np.isnan(before), last, 2 * last - before)


def evened(c: F32, axis: int) -> F32:
    """`c` with one more row (axis 0) or column (axis 1), extrapolated, where their number is odd."""
    n = c.shape[axis]
    if n % 2 == 0:
        return c
    last = c.take([n - 1], axis)
    return np.concatenate([c, extrapolated(last, c.take([n - 2], axis)) if n > 1 else last], axis)


def height_means(c: F32) -> F32:
    """Means without nodata of 2 x 2 heights: (rows, columns) to (ceil(rows / 2), ceil(columns / 2)).

    The missing child of an odd last row or column is extrapolated, so that planes stay exact.
    """
    c = evened(evened(c, 0), 1)
    total = c[0::2] + c[1::2]
    means = total[:, 0::2] + total[:, 1::2]
    means *= QUARTER
    for part in mixed(means):
        children = [c[i::2, 2 * part.start + j : 2 * part.stop : 2] for i in (0, 1) for j in (0, 1)]
        valid = [~np.isnan(child) for child in children]
        if not any(ok.any() for ok in valid):
            continue
        heights = sum(np.where(ok, child, np.float32(0)) for ok, child in zip(valid, children, strict=True))
        with np.errstate(invalid="ignore"):
            means[:, part] = heights / sum(ok.astype(np.float32) for ok in valid)
    return means


def mixed(c: F32) -> list[slice]:
    """Runs of at most SPAN columns with nodata in them."""
    void = np.isnan(c.min(axis=0))  # which keeps NaN, and is faster than asking each sample
    if not void.any():
        return []
    spans = (slice(start, min(start + SPAN, c.shape[1])) for start in range(0, c.shape[1], SPAN))
    return [span for span in spans if void[span].any()]


def coverage_means(c: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Rounded means of 2 x 2 coverages (0 to 255); samples outside the raster do not count."""
    c = np.pad(c, ((0, c.shape[0] % 2), (0, c.shape[1] % 2)), mode="edge")
    total = sum(c[i::2, j::2].astype(np.uint16) for i in (0, 1) for j in (0, 1))
    return ((np.asarray(total, np.uint16) + 2) >> 2).astype(np.uint8)


def colour_means(c: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Means of 2 x 2 colours (rows, columns, 4) in linear light, weighted by alpha; odd last ones repeat."""
    to_linear, to_srgb = srgb_tables()
    c = np.pad(c, ((0, c.shape[0] % 2), (0, c.shape[1] % 2), (0, 0)), mode="edge")
    children = [c[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    alpha = sum(child[..., 3].astype(np.uint16) for child in children)
    out = np.empty((*np.shape(alpha), 4), np.uint8)
    out[..., 3] = (np.asarray(alpha) + 2) >> 2
    opaque = bool(np.min(alpha) == 4 * 255)
    weight = np.float32(0.25) if opaque else np.float32(1) / np.maximum(alpha, 1).astype(np.float32)
    for band in range(3):
        linear = [to_linear[child[..., band]] for child in children]
        if not opaque:
            linear = [value * child[..., 3] for value, child in zip(linear, children, strict=True)]
        mean = np.asarray(sum(linear)) * weight
        out[..., band] = to_srgb[(mean * np.float32(len(to_srgb) - 1) + np.float32(0.5)).astype(np.intp)]
    return out


@lru_cache
def srgb_tables() -> tuple[F32, NDArray[np.uint8]]:
    """sRGB bytes to linear light, and back from linear light in steps fine enough to return every byte."""

    def decode(s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)

    linear = decode(np.arange(256) / 255)
    # byte n stands for the light between the decoded values of n - 1/2 and n + 1/2
    edges = decode((np.arange(255) + 0.5) / 255)
    steps = np.arange(2**15 + 1) / 2**15
    return linear.astype(np.float32), np.searchsorted(edges, steps, side="right").astype(np.uint8)


def filled(c: F32) -> F32:
    """`c` with nodata replaced by the mean of the valid ones of the 8 neighbours, where there is one."""
    parts = mixed(c)
    if not parts:
        return c
    out = c.copy()
    width = c.shape[1]
    for part in parts:
        reach = slice(max(part.start - 1, 0), min(part.stop + 1, width))
        valid = ~np.isnan(c[:, reach])
        if not valid.any():
            continue
        margins = ((1, 1), (int(part.start == 0), int(part.stop == width)))
        total = np.pad(np.where(valid, c[:, reach], np.float32(0)), margins)
        count = np.pad(valid.astype(np.float32), margins)
        for field in (total, count):  # sums of 3 x 3, first along the columns
            field[1:-1] = field[:-2] + field[1:-1] + field[2:]
        cols = part.stop - part.start
        total, count = (f[1:-1, :cols] + f[1:-1, 1 : cols + 1] + f[1:-1, 2 : cols + 2] for f in (total, count))
        with np.errstate(invalid="ignore"):
            mean = total / count
        out[:, part] = np.where(np.isnan(c[:, part]), mean, c[:, part])
    return out


def row_errors(p: F32, even: F32, odd: F32) -> tuple[F32, F32]:
    """|finer - coarser surface| at the corners of their common patches, in the finer rows between the coarse ones.

    p: (n, m) coarse heights. even, odd: (2 (n - 1), m) the left and right finer samples of each coarse column, in the
    rows between the first and the last coarse centre. Both surfaces are bilinear between the corners, so that these
    and `column_errors` bound the difference everywhere between the coarse centres.

    Returns (n - 1, m - 1), the maximum of each cell's four finer samples, and (n - 1, m), the maximum of the two
    corners on each coarse column's centre line.
    """
    quarter = (p[1:] - p[:-1]) * QUARTER
    lower, upper = p[:-1] + quarter, p[1:] - quarter
    samples = np.fmax(_beside(lower, even[0::2], odd[0::2]), _beside(upper, even[1::2], odd[1::2]))
    lines = np.fmax(_along(lower, even[0::2], odd[0::2]), _along(upper, even[1::2], odd[1::2]))
    return samples, lines


def column_errors(p: F32, even: F32, odd: F32) -> F32:
    """The same on the centre lines of coarse rows: p (n, m), even and odd (2 n, m); returns (n, m - 1)."""
    left, right = even[0::2] + even[1::2], odd[0::2] + odd[1::2]
    left *= HALF
    right *= HALF
    return _beside(p, left, right)


def _beside(u: F32, left: F32, right: F32) -> F32:
    """|finer - coarser| a quarter of the way right of each coarse column, and left of the next: the larger one."""
    step = u[:, 1:] - u[:, :-1]
    step *= QUARTER
    a = right[:, :-1] - u[:, :-1]
    a -= step
    np.abs(a, out=a)
    b = left[:, 1:] - u[:, 1:]
    b += step
    np.abs(b, out=b)
    return np.fmax(a, b, out=a)


def _along(u: F32, left: F32, right: F32) -> F32:
    """|finer - coarser| on the coarse columns' centre lines."""
    line = left + right
    line *= HALF
    line -= u
    return np.abs(line, out=line)
