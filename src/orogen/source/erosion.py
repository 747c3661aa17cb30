"""A mountain range carved by rivers: uplift against stream-power erosion, from coarse to fine.

Each step solves the stream-power law with slope exponent 1 implicitly along the drainage tree, after Jean Braun and
Sean Willett, "A very efficient O(n), implicit and parallel method to solve the stream power equation governing
fluvial incision and landscape evolution", 2013. Tree sums and the implicit solution are found by pointer doubling,
so that every operation works on whole arrays.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
Index = NDArray[np.int32]

COARSEST = 129
"""Rows and columns that the terrain starts from; each finer grid is 2 n - 1."""
STEPS = (100, 30, 12, 3, 1)
"""Steps on each grid from the coarsest on; the last figure holds for all finer ones."""
TIME_STEP = 100_000.0
"""Years."""
UPLIFT = 6e-4
"""Greatest uplift in metres a year."""
ERODIBILITY = 2.2e-6
"""K of the stream-power law with area exponent 1/2, in 1 / year."""
STEEPEST = 0.65
"""Slope that hillslopes tend to under the greatest uplift: tan of 33 degrees."""
MEANDER = 1.6
"""Greatest shift in samples of a finer grid that bends straight valleys."""
WAVE = 8
"""Samples between independent shifts."""
ROOF = 800.0
"""Height in metres of the roof-shaped ground that the rivers start on."""
NOISE = 0.25
"""Roughness added on each finer grid, as a part of the local slope."""


def eroded(size: int, seed: int, spacing: float) -> NDArray[np.float32]:
    """Heights in metres (size, size) of a range that runs from edge to edge; deterministic for a seed."""
    levels = max(0, math.ceil(math.log2(max(size - 1, 1) / (COARSEST - 1))))
    rng = np.random.default_rng(seed)
    extent = spacing * ((COARSEST - 1) << levels)
    # a roof that drains to the upper and lower rim, so that no lake is left on the plains
    y = np.linspace(-1, 1, COARSEST, dtype=np.float32)[:, None]
    heights = ROOF * (1 - y**2) + rng.random((COARSEST, COARSEST), np.float32) * 2
    for level in range(levels + 1):
        if level:
            heights = meandering(refined(heights), rng)
            slope_y, slope_x = np.gradient(heights)
            heights += rng.standard_normal(heights.shape, np.float32) * np.hypot(slope_x, slope_y) * NOISE
        n = len(heights)
        uplift, erodibility = belts(n, seed)
        uplift *= np.float32(UPLIFT)
        erodibility *= np.float32(ERODIBILITY)
        for _ in range(STEPS[min(level, len(STEPS) - 1)]):
            heights = step(heights, uplift, erodibility, extent / (n - 1), seed)
    return np.ascontiguousarray(meandering(heights, rng)[:size, :size], np.float32)


def step(heights: F32, uplift: F32, erodibility: F32, spacing: float, seed: int) -> F32:
    """Heights after one time step: uplift and the incision of rivers; the upper and lower rim stay."""
    receiver, distance = drainage(heights, spacing, seed)
    area = upstream(receiver, spacing**2)
    # hillslopes: as if this much area drained through every sample, so that slopes stay below STEEPEST
    hillslope = (UPLIFT / (ERODIBILITY * STEEPEST)) ** 2
    rate = erodibility.ravel() * np.sqrt(area + np.float32(hillslope)) * (np.float32(TIME_STEP) / distance)
    rate[receiver == np.arange(receiver.size, dtype=np.int32)] = 0
    raised = heights + np.float32(TIME_STEP) * uplift
    raised[[0, -1]] = heights[[0, -1]]
    return lowered(raised.ravel(), rate, receiver).reshape(heights.shape)


def drainage(heights: F32, spacing: float, seed: int) -> tuple[Index, F32]:
    """For each sample, flat: where its water goes (itself in a pit and on the upper and lower rim), and how far (m).

    The slopes to the neighbours sway by random factors of their own, so that rivers do not follow the grid's axes.
    """
    n, m = heights.shape[0], heights.shape[1]
    padded = np.pad(heights, ((0, 0), (1, 1)), constant_values=np.inf)
    steepest = np.zeros((n - 2, m), np.float32)
    offset = np.zeros((n - 2, m), np.int32)
    distance = np.full((n, m), spacing, np.float32)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if dy or dx:
                length = spacing * math.hypot(dy, dx)
                slope = heights[1:-1] - padded[1 + dy : n - 1 + dy, 1 + dx : m + 1 + dx]
                sway = np.random.default_rng((seed, dy + 1, dx + 1)).random(slope.shape, np.float32)
                sway += np.float32(0.75)
                sway *= np.float32(1 / length)
                slope *= sway
                better = slope > steepest
                np.copyto(steepest, slope, where=better)
                np.copyto(offset, np.int32(dy * m + dx), where=better)
                np.copyto(distance[1:-1], np.float32(length), where=better)
    receiver = np.arange(n * m, dtype=np.int32)
    receiver[m:-m] += offset.ravel()
    return receiver, distance.ravel()


def upstream(receiver: Index, cell: float) -> F32:
    """Area that drains through each sample, itself included, for samples of area `cell`."""
    count = receiver.size
    target = np.where(receiver == np.arange(count, dtype=np.int32), np.int32(count), receiver)
    target = np.append(target, np.int32(count))
    area = np.full(count + 1, cell, np.float32)
    area[-1] = 0
    while (moving := np.flatnonzero(target != count)).size:
        # after k rounds: all within 2**k samples upstream
        area += np.bincount(target[moving], area[moving], count + 1).astype(np.float32)
        area[-1] = 0
        target = target[target]
    return area[:-1]


def lowered(heights: F32, rate: F32, receiver: Index) -> F32:
    """h of h = (heights + rate h[receiver]) / (1 + rate)."""
    constant = heights / (1 + rate)
    factor = rate / (1 + rate)
    while factor.max() > 1e-9:
        constant += factor * constant[receiver]
        factor *= factor[receiver]
        receiver = receiver[receiver]
    return constant


def meandering(a: F32, rng: np.random.Generator) -> F32:
    """`a` shifted here and there by up to MEANDER samples, so that valleys along the grid's axes bend."""
    n = len(a)
    waves = MEANDER * (2 * rng.random((2, (n - 1) // WAVE + 1, (n - 1) // WAVE + 1), np.float32) - 1)
    line = np.arange(n, dtype=np.float32)
    y = np.clip(line[:, None] + smooth(waves[0], WAVE), 0, n - 1.001)
    x = np.clip(line[None, :] + smooth(waves[1], WAVE), 0, n - 1.001)
    row, col = y.astype(np.int32), x.astype(np.int32)
    y -= row
    x -= col
    flat, start = a.ravel(), row * n + col
    upper = flat[start] * (1 - x) + flat[start + 1] * x
    lower = flat[start + n] * (1 - x) + flat[start + n + 1] * x
    return upper * (1 - y) + lower * y


def smooth(lattice: F32, factor: int) -> F32:
    """(n, n) to (factor (n - 1) + 1, the same), cubic; factor is a power of 2."""
    while factor > 1:
        lattice = refined(lattice)
        factor //= 2
    return lattice


def refined(a: F32) -> F32:
    """(n, n) to (2 n - 1, 2 n - 1): cubic midpoints between the samples."""
    for axis in (0, 1):
        a = np.moveaxis(a, axis, 0)
        padded = np.concatenate([2 * a[:1] - a[1:2], a, 2 * a[-1:] - a[-2:-1]])
        middle = (9 * (a[:-1] + a[1:]) - padded[:-3] - padded[3:]) / np.float32(16)
        out = np.empty((2 * len(a) - 1, a.shape[1]), np.float32)
        out[0::2], out[1::2] = a, middle
        a = np.moveaxis(out, 0, axis)
    return a


def belts(n: int, seed: int) -> tuple[F32, F32]:
    """(n, n) uplift, 0 to 1, highest along a range that runs from edge to edge, and erodibility around 1."""
    unit = np.linspace(0, 1, n, dtype=np.float32)
    y, x = unit[:, None], unit[None, :]
    warp, blocks, rocks = (smooth_noise(n, cells, seed + i) for i, cells in enumerate((4, 8, 16)))
    across = y - 0.5 + 0.18 * (x - 0.5) + 0.16 * warp
    uplift = np.exp(-((across / 0.25) ** 2)) * (1 + 0.5 * blocks) + 0.04
    return np.clip(uplift, 0, 1.3), np.exp(0.5 * rocks)


def smooth_noise(n: int, cells: int, seed: int) -> F32:
    """(n, n) smooth noise of about -1 to 1 on a lattice of `cells` cells across."""
    lattice = 2 * np.random.default_rng(seed).random((cells + 1, cells + 1), np.float32) - 1
    return smooth(lattice, (n - 1) // cells)
