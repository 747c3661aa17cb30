"""Rays to the surface: which blocks they may meet, block by block from near to far, and where they do, exactly.

The surface is bilinear in a cell, so the height of a ray above it is a quadratic there. Rays go down the tree of
heights (`Levels`) side by side, all of them a level at a time; what is wholly above or below a square leaves it out.
Cells are solved by the compiled kernel where numba is installed, else by the same in numpy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.queries.blocks import Block, Blocks
from orogen.queries.pages import F32, Side

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

BATCH = 1 << 16
"""Rays that are followed together: bounds the memory."""
GRAZE = 1e-6
"""Metres that a line of sight is lifted by, so that the ground that it starts and ends on does not hide it."""


@dataclass(frozen=True)
class Rays:
    """Rays at (u, v) = (u0 + t du, v0 + t dv) in sample coordinates and height c0 + t c1 + t^2 c2 (m), c2 >= 0."""

    values: F64
    """(7, n) u0, v0, du, dv, c0, c1, c2."""
    start: F64
    """(n,) first t."""
    end: F64
    """(n,) last t; may be infinite."""

    def height(self, index: I64, t: F64) -> F64:
        """Heights (m) of the rays of an index at t."""
        c0, c1, c2 = self.values[4:]
        return c0[index] + t * (c1[index] + t * c2[index])


@dataclass(frozen=True)
class Pieces:
    """Parts of rays, each over one square."""

    ray: I64
    """(n,) which ray."""
    row: I64
    """(n,) row of the square."""
    column: I64
    """(n,) column of the square."""
    enter: F64
    """(n,) t where the ray comes over the square."""
    leave: F64
    """(n,) t where it leaves it."""

    def ordered(self) -> Pieces:
        """By ray, and from near to far."""
        by = np.lexsort((self.enter, self.ray))
        return Pieces(self.ray[by], self.row[by], self.column[by], self.enter[by], self.leave[by])


def first_hits(blocks: Blocks, rays: Rays, shape: tuple[int, int], *, sight: bool = False) -> F64:
    """(n,) t of the first point of each ray on the surface of a raster of `shape` (rows, columns); NaN for none.

    Rays meet the surface from either side. With `sight` they start above it, are lifted by `GRAZE`, and have hit it
    wherever they are below. Raises what the pyramid raises.
    """
    result = np.empty(len(rays.start))
    for k in range(0, len(result), BATCH):
        part = slice(k, k + BATCH)
        result[part] = _batch(blocks, Rays(rays.values[:, part], rays.start[part], rays.end[part]), shape, sight)
    return result


def _batch(blocks: Blocks, rays: Rays, shape: tuple[int, int], sight: bool) -> F64:
    bounds = blocks.bounds()
    lift = GRAZE if sight else 0.0
    only = np.zeros(1, np.int64)
    low, high = (float(side[only, only][0]) for side in bounds[-1])
    start, end = _within(rays, shape, low - 1, high + 1)
    way = _Way(blocks, bounds[0][0].shape, rays, lift)
    # most lines of sight end in the block that they start in
    first = _first_pieces(rays, blocks.side, bounds[0][0].shape, start, end)
    way.follow(first, np.arange(len(first.ray)))
    start[first.ray] = first.leave
    start[~np.isnan(way.hits) | (start >= end)] = np.inf
    pieces = descend(bounds, blocks.side, rays, start, end, lift).ordered()
    # one block of each ray a round, from near to far
    turn = np.flatnonzero(np.diff(pieces.ray, prepend=-1))
    while turn.size:
        way.follow(pieces, turn)
        turn = turn[np.isnan(way.hits[pieces.ray[turn]])] + 1
        turn = turn[turn < len(pieces.ray)]
        turn = turn[pieces.ray[turn] == pieces.ray[turn - 1]]
    return way.hits


class _Way:
    """Rays on their way through blocks."""

    def __init__(self, blocks: Blocks, count: tuple[int, ...], rays: Rays, lift: float) -> None:
        """`count`: rows and columns of blocks."""
        self._blocks, self._columns, self._rays, self._lift = blocks, count[1], rays, lift
        self.hits = np.full(len(rays.start), np.nan)
        """(rays,) t of the first hit; NaN while there is none."""
        self._side = np.full(len(rays.start), int(lift > 0), np.int8)
        self._until = np.full(len(rays.start), np.nan)

    def follow(self, pieces: Pieces, turn: I64) -> None:
        """Through the blocks of some pieces, each of another ray."""
        keys = pieces.row[turn] * self._columns + pieces.column[turn]
        order = np.argsort(keys, kind="stable")
        for group in np.split(turn[order], np.flatnonzero(np.diff(keys[order])) + 1):
            if not group.size:
                continue
            block = self._blocks.get(int(pieces.row[group[0]]), int(pieces.column[group[0]]))
            ray, enter, leave = pieces.ray[group], pieces.enter[group], pieces.leave[group]
            known = np.where((self._until[ray] == enter) | (self._lift > 0), self._side[ray], 0).astype(np.int8)
            self.hits[ray] = _solver()(block, self._rays.values, ray, enter, leave, known, self._lift)
            self._side[ray], self._until[ray] = 1 if self._lift > 0 else known, leave


def _first_pieces(rays: Rays, side: int, count: tuple[int, ...], start: F64, end: F64) -> Pieces:
    """The parts of rays in the blocks that they start in."""
    ray = np.flatnonzero(start <= end)
    begin = start[ray]
    leave = end[ray].copy()
    index = []
    for at, pace, size in (
        (rays.values[0, ray], rays.values[2, ray], count[1]),
        (rays.values[1, ray], rays.values[3, ray], count[0]),
    ):
        place = np.clip((at + begin * pace) // side, 0, size - 1).astype(np.int64)
        with np.errstate(divide="ignore", invalid="ignore"):
            border = ((place + (pace > 0)) * float(side) - at) / pace
        leave = np.where(pace == 0, leave, np.minimum(leave, np.maximum(border, begin)))
        index.append(place)
    return Pieces(ray, index[1], index[0], begin, leave)


def _within(rays: Rays, shape: tuple[int, int], low: float, high: float) -> tuple[F64, F64]:
    """First and last t over the raster and, where that can be told, between two heights; first > last if never."""
    u0, v0, du, dv, c0, c1, c2 = rays.values
    start, end = rays.start.copy(), rays.end.copy()
    straight = c2 == 0
    limits = [(u0, du, 0.0, shape[1] - 1.0), (v0, dv, 0.0, shape[0] - 1.0)]
    if low > high or min(shape) < 2:
        return start, np.full(len(end), -np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for at, pace, first, last in limits:
            _clip(start, end, at, pace, first, last)
        _clip(start, end, np.where(straight, c0, low), np.where(straight, c1, 0.0), low, high)
        # a bent ray is under the ceiling between two roots
        root = c1**2 - 4 * c2 * (c0 - high)
        q = -0.5 * (c1 + np.copysign(np.sqrt(root), c1))
        a, b = q / c2, (c0 - high) / q
        bent = ~straight & np.isfinite(a) & np.isfinite(b)
        start = np.where(bent, np.maximum(start, np.minimum(a, b)), start)
        end = np.where(bent, np.minimum(end, np.maximum(a, b)), end)
        end = np.where(~straight & (root < 0), -np.inf, end)
    # what stands still over a place for ever meets nothing there but at its ends
    return start, np.where(np.isfinite(start) & np.isfinite(end), end, -np.inf)


def _clip(start: F64, end: F64, at: F64, pace: F64, first: float, last: float) -> None:
    """Cut the t that start and end bound to where at + t pace lies between first and last."""
    a, b = (first - at) / pace, (last - at) / pace
    moving = pace != 0
    inside = (at >= first) & (at <= last)
    np.maximum(start, np.where(moving, np.minimum(a, b), np.where(inside, -np.inf, np.inf)), out=start)
    np.minimum(end, np.where(moving, np.maximum(a, b), np.where(inside, np.inf, -np.inf)), out=end)


def descend(
    levels: Sequence[tuple[F32 | Side, F32 | Side]], size: int, rays: Rays, start: F64, end: F64, lift: float = 0.0
) -> Pieces:
    """The parts of rays between start and end over the squares, `size` cells wide, whose heights they may meet."""
    ray: I64 = np.flatnonzero(start <= end)
    row, column, a, b = np.zeros_like(ray), np.zeros_like(ray), start[ray], end[ray]
    for k in range(len(levels) - 1, -1, -1):
        low, high = levels[k]
        row, column = np.minimum(row, low.shape[0] - 1), np.minimum(column, low.shape[1] - 1)
        lowest, highest = _heights_on(rays, ray, a, b)
        keep = (lowest + lift <= high[row, column]) & (highest + lift >= low[row, column])
        ray, row, column = ray[keep], row[keep], column[keep]
        a, b = a[keep], b[keep]
        if k:
            ray, row, column, a, b = _split(rays, ray, row, column, a, b, float(size << k))
    return Pieces(ray, row, column, a, b)


def _heights_on(rays: Rays, ray: I64, a: F64, b: F64) -> tuple[F64, F64]:
    """Lowest and highest of rays between a and b."""
    za, zb = rays.height(ray, a), rays.height(ray, b)
    low = np.minimum(za, zb)
    if rays.values[6].any():
        c1, c2 = rays.values[5, ray], rays.values[6, ray]
        bent = c2 > 0
        bottom = np.divide(-0.5 * c1, c2, out=np.zeros_like(c1), where=bent)
        between = bent & (bottom > a) & (bottom < b)
        low = np.where(between, rays.height(ray, bottom), low)
    return low, np.maximum(za, zb)


def _split(rays: Rays, ray: I64, row: I64, column: I64, a: F64, b: F64, width: float) -> tuple[Any, ...]:
    """The parts over the four quarters of squares `width` cells wide: at most three of each ray."""
    crossings, past = [], []
    u, v, du, dv = (part[ray] for part in rays.values[:4])
    for at, pace, index in ((u, du, column), (v, dv, row)):
        middle = (index + 0.5) * width
        still = pace == 0
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings.append(np.clip(np.where(still, b, (middle - at) / pace), a, b))
        past.append((still, np.where(still, at >= middle, pace < 0)))
    first, second = np.minimum(*crossings), np.maximum(*crossings)
    resting = past[0][0] & past[1][0]
    out = []
    for lo, hi in ((a, first), (first, second), (second, b)):
        keep = (hi > lo) | (resting & (lo is a))
        lo, hi = lo[keep], hi[keep]
        middle = 0.5 * (lo + hi)
        sides = [
            # the second half after the crossing, or where a ray that goes back has not come to it
            np.where(still[keep], there[keep], (middle > crossing[keep]) != there[keep])
            for crossing, (still, there) in zip(crossings, past, strict=True)
        ]
        out.append((ray[keep], 2 * row[keep] + sides[1], 2 * column[keep] + sides[0], lo, hi))
    return tuple(np.concatenate(parts) for parts in zip(*out, strict=True))


def solve(block: Block, rays: F64, which: I64, enter: F64, leave: F64, side: NDArray[np.int8], lift: float) -> F64:
    """First hits t of the rays `which` in a block between enter and leave; NaN for none.

    side: 1 for rays that come from above the surface, -1 from below, 0 where that is not known; set to what holds at
    the end. Being on the other side at once is a hit: no ray slips between two cells for rounding.
    """
    corner = np.array([block.column, block.row, 0, 0, -lift, 0, 0], np.float64)
    local = Rays(rays[:, which] - corner[:, None], enter, leave)
    pieces = descend(block.levels, 1, local, enter, leave).ordered()
    ray, j, i, a, b = pieces.ray, pieces.row, pieces.column, pieces.enter, pieces.leave
    u0, v0, du, dv, c0, c1, c2 = local.values[:, ray]
    h = block.heights.astype(np.float64)
    h00, h10, h01, h11 = h[j, i], h[j, i + 1], h[j + 1, i], h[j + 1, i + 1]
    x, y = np.clip(u0 + du * a - i, 0, 1), np.clip(v0 + dv * a - j, 0, 1)
    across, along, twist = h10 - h00, h01 - h00, h11 - h10 - h01 + h00
    f0 = c0 + a * (c1 + a * c2) - (h00 + across * x + along * y + twist * x * y)
    f1 = c1 + 2 * c2 * a - (across * du + along * dv + twist * (x * dv + y * du))
    f2 = c2 - twist * du * dv
    length = b - a
    f_end = f0 + length * (f1 + length * f2)
    # what is known of the side: from the piece before, from the caller, or nothing
    new = np.diff(ray, prepend=-1) != 0
    known = np.where(f_end[:-1] < 0, -1, 1) if len(ray) else f_end
    known = np.where(new, np.where(enter[ray] == a, side[ray], 0), np.append(0, known)[: len(ray)])
    gap = ~new & (np.append(np.nan, b[:-1])[: len(ray)] != a)
    forced = (side[ray] == 1) & (lift > 0)
    known = np.where(forced, 1, np.where(gap, 0, known))

    def solid(s: F64) -> NDArray[np.bool_]:
        if not block.valid.size:
            return np.ones(s.shape, bool)
        p, q = np.clip(x + du * s, 0, 1), np.clip(y + dv * s, 0, 1)
        m00, m10, m01, m11 = (block.valid[j + dj, i + di] for dj in (0, 1) for di in (0, 1))
        return ((m00 * (1 - p) + m10 * p) * (1 - q) + (m01 * (1 - p) + m11 * p) * q) >= 0.5

    found = np.full(len(ray), np.nan)
    at_once = (f0 == 0) | ((known != 0) & ((f0 > 0) != (known > 0)))
    candidates = [np.where(at_once, 0.0, np.nan), *_roots(f0, f1, f2)]
    within = [np.where((s >= 0) & (s <= length), s, np.nan) for s in candidates]
    lost = np.isnan(within[1]) & np.isnan(within[2]) & ((f_end < 0) != (f0 < 0))
    for s in (*within, np.where(lost, length, np.nan)):
        found = np.where(np.isnan(found) & ~np.isnan(s) & solid(np.nan_to_num(s)), a + s, found)
    result = np.full(len(which), np.nan)
    hits = np.flatnonzero(~np.isnan(found))[::-1]
    result[ray[hits]] = found[hits]
    # pieces that were left out say nothing; the last one does, where it reaches the end
    last = np.flatnonzero(np.diff(ray, append=-1) != 0)
    side[:] = 0
    side[ray[last]] = np.where(b[last] == leave[ray[last]], np.where(f_end[last] < 0, -1, 1), 0)
    return result


def _roots(f0: F64, f1: F64, f2: F64) -> tuple[F64, F64]:
    """Roots of f0 + f1 s + f2 s^2, the smaller one first; NaN where there are none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        q = -0.5 * (f1 + np.copysign(np.sqrt(f1 * f1 - 4 * f2 * f0), f1))
        a, b = q / f2, f0 / q
    a, b = np.where(np.isfinite(a), a, b), np.where(np.isfinite(b), b, a)
    a, b = np.where(np.isfinite(a), a, np.nan), np.where(np.isfinite(b), b, np.nan)
    return np.minimum(a, b), np.maximum(a, b)


@cache
def _solver() -> Any:
    """The compiled kernel where numba is there, else `solve`."""
    try:
        from orogen.queries import kernel
    except SettingsError:
        return solve

    def compiled(
        block: Block, rays: F64, which: I64, enter: F64, leave: F64, side: NDArray[np.int8], lift: float
    ) -> F64:
        place = block.row, block.column
        return kernel.solve(block.heights, block.valid, *block.flat, place, rays, which, enter, leave, side, lift)

    return compiled
