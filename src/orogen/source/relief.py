"""The shape of the endless terrain: heights of a window of a level, from its coarser levels and one octave of noise.

A level is made from the next coarser one, interpolated bilinearly at its sample centres, and one octave of ridged
gradient noise whose waves are four samples long. Rough ground lies high and gentle ground low, and steep slopes have
less detail: what erosion makes of mountains. Gradients come from an integer hash of their lattice points, and all else
from sums, products and quotients of each sample on its own: neither the window that is asked for nor the machine
changes a bit of the result.

What can be said of all heights follows from the bounds of the noise. Let B(k) be the most that the octave of level k
adds or takes. Interpolated heights stay between those around them, so that all octaves finer than level k together move
a height by B(k - 1) + ... + B(0) at most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TOP = 18
"""The level that the construction starts from, flat: its samples lie further apart than mountain ranges are wide."""
WAVE = 4
"""Samples of its level from one lattice point of an octave to the next."""
BROAD = 14
"""Octaves from this level on shape lowlands and highlands: they are not ridged, and the same everywhere."""
LIFT = 500.0
"""Height (m) of the ground that the octaves are added to."""
SLOPE = 0.16
"""Height of an octave per length of its waves, where these are neither long nor short."""
LONG = 12_000.0
"""Length of the waves (m) from which on octaves hardly grow higher."""
SHORT = 24.0
"""Length of the waves (m) below which octaves are lower than their length says: bare ground is smooth."""
ROUGH = 1800.0
"""Height (m) from which on the ground is as rough as it gets."""
SMOOTH = 0.04
"""Roughness of ground at 0 m and below as a part of that."""
STEEP = 2.5
"""How much weaker detail is on slopes."""
SHARP = 2.6
"""Ridges are where noise is 0; at 1 / SHARP, either way, it is as low as it gets."""
MIDDLE = 0.38
"""About the mean of the ridges, which are 0 to 1 high."""
ROUNDING = 1.000001
"""More than octaves may be off by, which are computed as float32."""
BAND = 1 << 15
"""Samples worked on at once: what they need meanwhile stays in a processor's cache."""

_TURNS = ((4, 3, 5), (5, 12, 13), (15, 8, 17), (7, 24, 25), (21, 20, 29))
"""Right-angled triangles, whose angles turn the lattices of the octaves against each other."""

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]


def ground(seed: int, level: int, top: int, bottom: int, left: int, right: int) -> F64:
    """Heights (m) of rows `top` to `bottom` and columns `left` to `right` of a level.

    They may be any integers: the terrain has no end.
    """
    if level >= TOP:
        return np.full((bottom - top, right - left), LIFT)
    first_row, first_col = (top >> 1) - 1, (left >> 1) - 1
    coarse = ground(seed, level + 1, first_row, (bottom + 1 >> 1) + 1, first_col, (right + 1 >> 1) + 1)
    out = np.empty((bottom - top, right - left))
    step = max(1, BAND // (right - left))
    for row in range(top, bottom, step):
        stop = min(row + step, bottom)
        part = coarse[(row >> 1) - 1 - first_row : (stop + 1 >> 1) + 1 - first_row]
        base, slope = _interpolated(part, row & 1, stop - row, left & 1, right - left, 0.5 / (1 << level))
        base += _octave(level, seed, row, stop, left, right, base, slope)
        out[row - top : stop - top] = base
    return out


def octave_height(level: int) -> float:
    """Height (m) of the octave of a level, where the ground is rough."""
    wave = float(WAVE << level)
    return SLOPE * wave / ((1.0 + wave / LONG) * (1.0 + SHORT / wave))


def octave_bound(level: int) -> float:
    """The most (m) that the octave of a level adds or takes."""
    return octave_height(level) * (1.0 if level >= BROAD else max(MIDDLE, 1.0 - MIDDLE))


def octaves_bound(level: int, heights: F64) -> F64:
    """The most (m) that all octaves finer than `level` add to or take from heights that are at most `heights`."""
    broad = sum(octave_bound(k) for k in range(BROAD, level))
    ridged = sum(octave_bound(k) for k in range(min(level, BROAD)))
    most = np.full(heights.shape, broad + ridged)
    # the ground is as rough as its highest place: what bounds the one bounds the other
    for _ in range(3):
        most = broad + ridged * np.clip((heights + most) * ((1 - SMOOTH) / ROUGH) + SMOOTH, SMOOTH, 1.0)
    return most * ROUNDING


def level_error(level: int) -> float:
    """An upper bound (m) of the distance between the surfaces of a level and of level 0, bilinear both.

    A step to the next finer level cuts corners of the bilinear surface by an eighth of the second differences along
    rows and columns, and adds an octave. Interpolation quarters second differences and an octave adds 4 times its bound
    to them, so that they stay below 4 (B(k) + B(k + 1) / 4 + B(k + 2) / 16 + ...).
    """
    total = 0.0
    for k in range(1, min(level, TOP) + 1):
        second = sum(4 * octave_bound(j) / 4 ** (j - k) for j in range(k, TOP))
        total += second / 4 + octave_bound(k - 1)
    return total * ROUNDING


def _interpolated(coarse: F64, odd_row: int, rows: int, odd_col: int, cols: int, scale: float) -> tuple[F64, F32]:
    """Bilinear heights at the centres of the next finer level, and the squares of their slopes.

    `coarse` starts a sample before the one that the first finer sample, its upper or lower one, lies in. `scale`:
    1 / metres between coarse samples.
    """
    # rows between the coarse ones: heights, and how steep they are from the row before to the row after
    step = coarse[1:] - coarse[:-1]
    quarter = step * 0.25
    down = np.empty((2 * len(coarse) - 4, coarse.shape[1]))
    np.subtract(coarse[1:-1], quarter[:-1], out=down[0::2])
    np.add(coarse[1:-1], quarter[1:], out=down[1::2])
    down = down[odd_row : odd_row + rows]
    # the same between columns
    across = down[:, 1:] - down[:, :-1]
    quarter = across * 0.25
    heights = np.empty((rows, 2 * coarse.shape[1] - 4))
    np.subtract(down[:, 1:-1], quarter[:, :-1], out=heights[:, 0::2])
    np.add(down[:, 1:-1], quarter[:, 1:], out=heights[:, 1::2])
    # squares of slopes: of the four coarse samples around
    across = (across * scale).astype(np.float32)
    across *= across
    along = (step * scale).astype(np.float32)
    along *= along
    along = along[:, 1:] + along[:, :-1]
    along *= np.float32(0.5)
    square = np.empty(heights.shape, np.float32)
    fall = np.repeat(along, 2, axis=0)[1 + odd_row : 1 + odd_row + rows]
    across += fall
    square[:, 0::2], square[:, 1::2] = across[:, :-1], across[:, 1:]
    part = slice(odd_col, odd_col + cols)
    return heights[:, part], square[:, part]


def _octave(level: int, seed: int, top: int, bottom: int, left: int, right: int, base: F64, slope: F32) -> F32:
    """What the octave of a level adds to heights `base` with squared slopes `slope`."""
    noise = _noise(level, seed, top, bottom, left, right)
    height = np.float32(octave_height(level))
    if level >= BROAD:
        noise *= height
        return noise
    np.abs(noise, out=noise)
    noise *= np.float32(-SHARP)
    noise += np.float32(1)
    np.maximum(noise, np.float32(0), out=noise)
    noise *= noise
    noise -= np.float32(MIDDLE)
    rough = base.astype(np.float32)
    rough *= np.float32((1 - SMOOTH) / ROUGH)
    rough += np.float32(SMOOTH)
    np.clip(rough, np.float32(SMOOTH), np.float32(1), out=rough)
    noise *= rough
    damped = slope * np.float32(STEEP)
    damped += np.float32(1)
    noise /= damped
    noise *= height
    return noise


def _noise(level: int, seed: int, top: int, bottom: int, left: int, right: int) -> F32:
    """Gradient noise, -1 to 1 (no gradient is longer than 1 along rows or columns), at the samples of a window."""
    a, b, c = _TURNS[level % len(_TURNS)]
    key = int(_mixed(np.array([(seed * 0x9E3779B1 + level * 0x85EBCA77) & 0xFFFFFFFF], np.uint32))[0])
    # where the lattices' origins lie, in waves: nowhere near each other
    origin = key & 0xFFFF, key >> 16
    x, y = (np.arange(left, right) + 0.5) / WAVE, (np.arange(top, bottom)[:, None] + 0.5) / WAVE
    p, dx = _cells(x * (a / c) + origin[0], y * (-b / c))
    q, dy = _cells(x * (b / c) + origin[1], y * (a / c))
    p *= np.uint32(0x9E3779B1)
    q *= np.uint32(0x85EBCA77)
    p += q
    p += np.uint32(key)
    near = [_pull(p, dx, dy), _pull(p + np.uint32(0x9E3779B1), dx - np.float32(1), dy)]
    p += np.uint32(0x85EBCA77)
    dy1 = dy - np.float32(1)
    far = [_pull(p, dx, dy1), _pull(p + np.uint32(0x9E3779B1), dx - np.float32(1), dy1)]
    across, along = _faded(dx), _faded(dy)
    for pair in (near, far):
        pair[1] -= pair[0]
        pair[1] *= across
        pair[0] += pair[1]
    far[0] -= near[0]
    far[0] *= along
    far[0] += near[0]
    return far[0]


def _cells(along: F64, down: F64) -> tuple[U32, F32]:
    """Number of the lattice cell and place in it, 0 to 1, of the sums of a row and a column."""
    place = along + down
    cell = np.floor(place)
    place -= cell
    return cell.astype(np.int32).view(np.uint32), place.astype(np.float32)


def _pull(point: U32, dx: F32, dy: F32) -> F32:
    """The gradient of a lattice point times the way from it."""
    h = _mixed(point)
    gx = (h & np.uint32(0xFFFF)).astype(np.float32)
    gx *= np.float32(2**-15)
    gx -= np.float32(1)
    gx *= dx
    h >>= np.uint32(16)
    gy = h.astype(np.float32)
    gy *= np.float32(2**-15)
    gy -= np.float32(1)
    gy *= dy
    gx += gy
    return gx


def _faded(t: F32) -> F32:
    """6 t^5 - 15 t^4 + 10 t^3."""
    out = t * np.float32(6)
    out -= np.float32(15)
    out *= t
    out += np.float32(10)
    out *= t
    out *= t
    out *= t
    return out


def _mixed(h: U32) -> U32:
    """A hash of 32-bit numbers, of which no two have the same: shifts and products as in murmur's last step."""
    h = h ^ (h >> np.uint32(16))
    h *= np.uint32(0x85EBCA6B)
    h ^= h >> np.uint32(13)
    h *= np.uint32(0xC2B2AE35)
    h ^= h >> np.uint32(16)
    return h
