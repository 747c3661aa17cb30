"""The compiled twin of `choose.DiamondFrame`. Importing this takes numba, and a second: do it where it is needed.

What it calls of quadtree_kernels.py is compiled into it, and kept on disk until this file changes: change it, too,
after a change there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.lod.bdam.diamonds import Diamonds, Floats, Ints
from orogen.lod.bdam.ground import CELL, Ground
from orogen.lod.quadtree_kernels import Eye, above_range, compiled, inner, is_box_seen, nearest_square

__all__ = ["Eye", "Facts", "choose", "facts"]


class Facts(NamedTuple):
    """Diamonds, their errors and the ground under them."""

    bits: int
    right: int
    """Column of the last sample."""
    bottom: int
    """Row of the last sample."""
    top: int
    lowest: int
    levels: Ints
    """(levels, 3) half extent in subtexels, and which cells of the ground suit boxes around diamonds and patches."""
    errors: NDArray[np.float32]
    """Metres, level by level from 1 on."""
    rows_of_errors: Ints
    """(levels above 0, 2) where a level starts, and its columns."""
    ranges: NDArray[np.float32]
    """(cells, 3) as in `Ground.mips`."""
    rows_of_ranges: Ints
    """(mips, 3) where one starts, its rows and columns."""


Box = tuple[float, float, float, float]
"""Column and row of the first sample, then of the last one."""
Corners = tuple[int, int, int, int, int, int]
"""x and y of three corners."""


def facts(diamonds: Diamonds, ground: Ground, errors: Sequence[NDArray[np.float32]]) -> Facts:
    """All that does not depend on a frame; `errors`: of the diamonds of level 1 and on, by cy and cx."""
    levels = range(diamonds.lowest, diamonds.top + 1)
    halves = np.array([diamonds.half(level) for level in levels], np.int64)
    mips = [[ground.mip(width * half / (1 << diamonds.bits)) for width in (6, 2)] for half in halves.tolist()]
    starts = np.cumsum([0, *(table.size for table in errors)])[:-1]
    columns = np.array([table.shape[1] for table in errors], np.int64)
    sizes = [mip.shape[0] * mip.shape[1] for mip in ground.mips]
    shapes = np.array([mip.shape[:2] for mip in ground.mips], np.int64)
    return Facts(
        diamonds.bits, int(diamonds.last[0]), int(diamonds.last[1]), diamonds.top, diamonds.lowest,
        np.column_stack([halves, np.array(mips, np.int64)]),
        np.concatenate([np.zeros(0, np.float32), *(table.ravel() for table in errors)]),
        np.column_stack([starts, columns]).astype(np.int64),
        np.concatenate([mip.reshape(-1, 3) for mip in ground.mips]),
        np.column_stack([np.cumsum([0, *sizes])[:-1], shapes]),
    )  # fmt: skip


@inner
def corners_of(level: int, half: int, cx: int, cy: int, side: int) -> Corners:
    """Subtexels: both ends of the hypotenuse, then the right angle."""
    sign = 2 * side - 1
    if level % 2:
        ox, oy = sign * (1 - cx % 2), sign * (cx % 2)
    else:
        ox, oy = sign, -sign if (cx + cy) // 2 % 2 else sign
    return (cx - oy) * half, (cy + ox) * half, (cx + oy) * half, (cy - ox) * half, (cx + ox) * half, (cy + oy) * half


@inner
def crossing(x: int, y: int, other_x: int, other_y: int, limit: int) -> float:
    """The y at which a side of a triangle crosses a limit of x; infinite where it does not."""
    if (x < limit) == (other_x < limit):
        return math.inf
    return y + (limit - x) * (other_y - y) / (other_x - x)


@inner
def is_there(facts: Facts, level: int, cx: int, cy: int, side: int) -> bool:
    """Whether a patch lies over the raster, in part at least: see `Diamonds.exists`."""
    half = facts.levels[level - facts.lowest, 0]
    limit_x, limit_y = facts.right << facts.bits, facts.bottom << facts.bits
    if cx > 0 and cy > 0 and cx < limit_x // half and cy < limit_y // half:
        return True
    x0, y0, x1, y1, x2, y2 = corners_of(level, half, cx, cy, side)
    lowest = min(
        float(y0) if x0 < limit_x else math.inf,
        float(y1) if x1 < limit_x else math.inf,
        float(y2) if x2 < limit_x else math.inf,
        crossing(x0, y0, x1, y1, limit_x),
        crossing(x1, y1, x2, y2, limit_x),
        crossing(x2, y2, x0, y0, limit_x),
    )
    return lowest < limit_y and max(x0, x1, x2) > 0 and max(y0, y1, y2) > 0


@inner
def clipped(facts: Facts, left: int, above: int, right: int, below: int) -> Box:
    """Subtexels to samples within the raster."""
    scale = float(1 << facts.bits)
    return (
        min(max(left / scale, 0.0), float(facts.right)), min(max(above / scale, 0.0), float(facts.bottom)),
        min(max(right / scale, 0.0), float(facts.right)), min(max(below / scale, 0.0), float(facts.bottom)),
    )  # fmt: skip


@inner
def most(facts: Facts, mip: int, box: Box) -> tuple[float, float, float]:
    """Highest values of the cells that a box touches."""
    first, rows, columns = facts.rows_of_ranges[mip]
    side = CELL << mip
    x0, y0 = math.floor(box[0] / side), math.floor(box[1] / side)
    x1, y1 = max(math.ceil(box[2] / side) - 1, x0), max(math.ceil(box[3] / side) - 1, y0)
    a = b = c = -math.inf
    for y in range(min(y0, rows - 1), min(y1, rows - 1) + 1):
        for x in range(min(x0, columns - 1), min(x1, columns - 1) + 1):
            at = first + y * columns + x
            a = max(a, float(facts.ranges[at, 0]))
            b = max(b, float(facts.ranges[at, 1]))
            c = max(c, float(facts.ranges[at, 2]))
    return a, b, c


@inner
def is_patch_seen(eye: Eye, facts: Facts, level: int, cx: int, cy: int, side: int) -> bool:
    """Whether a patch may be in the picture."""
    half, mip = facts.levels[level - facts.lowest, 0], facts.levels[level - facts.lowest, 2]
    x0, y0, x1, y1, x2, y2 = corners_of(level, half, cx, cy, side)
    box = clipped(facts, min(x0, x1, x2), min(y0, y1, y2), max(x0, x1, x2), max(y0, y1, y2))
    low, high, _ = most(facts, mip, box)
    return is_box_seen(eye, box[0], box[1], box[2], box[3], -low, high)


@inner
def is_too_coarse(
    eye: Eye, facts: Facts, sags: Floats, scale: float, near: float, level: int, cx: int, cy: int
) -> bool:
    """Whether a diamond has to be split: see `DiamondFrame.shares`."""
    if level == facts.lowest:
        return False
    half, mip = facts.levels[level - facts.lowest, 0], facts.levels[level - facts.lowest, 1]
    reach = half * (2 if level % 2 else 3)
    box = clipped(facts, cx * half - reach, cy * half - reach, cx * half + reach, cy * half + reach)
    low, high, twist = most(facts, mip, box)
    if not is_box_seen(eye, box[0], box[1], box[2], box[3], -low, high):
        return False
    if level > 0:
        first, columns = facts.rows_of_errors[level - 1]
        error = float(facts.errors[first + cy * columns + cx])
    else:
        error = twist * 4.0 ** (level // 2)
    square = nearest_square(eye, box[0], box[1], box[2], box[3])
    distance = math.sqrt(square + above_range(eye, square, -low, high) ** 2)
    return (error * eye.exaggeration + sags[level - facts.lowest]) * scale / max(distance, near) > 1


@inner
def has(numbers: Ints, number: int) -> bool:
    """Whether a number is among ordered ones."""
    first, last = 0, numbers.size
    while first < last:
        middle = (first + last) // 2
        if numbers[middle] < number:
            first = middle + 1
        else:
            last = middle
    return first < numbers.size and numbers[first] == number


@compiled
def choose(
    eye: Eye, facts: Facts, sags: Floats, scale: float, near: float, resident: Ints, everything: bool
) -> tuple[Ints, Ints, Ints, Ints, Ints]:
    """Level, cx, cy and side of the patches to draw, and codes of those on the way: see `DiamondFrame.choose`.

    `everything`: all patches count as resident.
    """
    level = facts.top
    cx, cy, side = np.ones(64, np.int64), np.ones(64, np.int64), np.zeros(64, np.int64)
    seen = np.zeros(64, np.bool_)
    out = np.empty((4, 256), np.int64)
    wanted = np.empty(256, np.int64)
    drawn = asked = count = 0
    for half in range(2):
        if is_there(facts, level, 1, 1, half):
            side[count] = half
            seen[count] = is_patch_seen(eye, facts, level, 1, 1, half)
            if seen[count]:
                wanted[asked] = (level + 32) << 57 | 1 << 29 | 1 << 1 | half
                if not everything and not has(resident, wanted[asked]):
                    nothing = np.empty(0, np.int64)
                    return nothing, nothing, nothing, nothing, nothing
                asked += 1
            count += 1
    while count > 0:
        order = np.argsort(cy[:count] << 32 | cx[:count])
        split = np.zeros(count, np.bool_)
        room = 4 * count
        new_cx, new_cy, new_side = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
        new_seen = np.empty(room, np.bool_)
        made = 0
        if asked + room > wanted.size:
            longer = np.empty(2 * (asked + room), np.int64)
            longer[:asked] = wanted[:asked]
            wanted = longer
        n = 0
        while n < count:
            x, y = cx[order[n]], cy[order[n]]
            last = n + 1
            while last < count and cx[order[last]] == x and cy[order[last]] == y:
                last += 1
            halves = int(is_there(facts, level, x, y, 0)) + int(is_there(facts, level, x, y, 1))
            # a diamond is split as a whole, so all of it has to be there
            if last - n == halves and is_too_coarse(eye, facts, sags, scale, near, level, x, y):
                before, whole, first = asked, True, made
                for k in range(4):
                    if level % 2:
                        dx, dy = 2 * (k & 1) - 1, 2 * (k >> 1) - 1
                        px, py = 2 * x + dx, 2 * y + dy
                    else:
                        dx, dy = (-1, 1, 0, 0)[k], (0, 0, -1, 1)[k]
                        px, py = x + dx, y + dy
                    half = 0 if dx > 0 or (dx == 0 and dy > 0) else 1
                    if not is_there(facts, level - 1, px, py, half):
                        continue
                    visible = is_patch_seen(eye, facts, level - 1, px, py, half)
                    new_cx[made], new_cy[made], new_side[made], new_seen[made] = px, py, half, visible
                    made += 1
                    if visible:
                        wanted[asked] = (level + 31) << 57 | py << 29 | px << 1 | half
                        whole = whole and (everything or has(resident, wanted[asked]))
                        asked += 1
                if whole:
                    for k in range(n, last):
                        split[order[k]] = True
                else:
                    asked, made = before, first
            n = last
        if drawn + count > out.shape[1]:
            more = np.empty((4, 2 * (drawn + count)), np.int64)
            more[:, :drawn] = out[:, :drawn]
            out = more
        for n in range(count):
            if seen[n] and not split[n]:
                out[0, drawn], out[1, drawn], out[2, drawn], out[3, drawn] = level, cx[n], cy[n], side[n]
                drawn += 1
        cx, cy, side, seen, count = new_cx, new_cy, new_side, new_seen, made
        level -= 1
    return out[0, :drawn], out[1, :drawn], out[2, :drawn], out[3, :drawn], wanted[:asked]
