"""Compiled twins of levels.py. Importing this takes numba, and a second: do it where it is needed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orogen.lod.quadtree_kernels import compiled, inner

F64 = NDArray[np.float64]


@inner
def _share(part: float, whole: float) -> float:
    """part / whole within 0 to 1; 1 where the whole is nothing or less."""
    return min(max(part / whole, 0.0), 1.0) if whole > 0 else 1.0


@inner
def _limit(sides: F64, seam: F64, edge: int, block: int, level: float, allowed: float) -> float:
    """See `Levels._limit`."""
    whole = math.floor(level)
    a = level - whole
    own, thinned = sides[whole, edge, block], seam[whole, edge, block]
    next_own, next_thinned = 0.0, math.inf
    if a > 0:
        next_own, next_thinned = sides[whole + 1, edge, block], seam[whole + 1, edge, block]
    before = _share(allowed - own + a * (thinned - next_own), thinned - own)
    if before < 1:
        return max(whole + before, level)
    after = min(_share(allowed - (1 - a) * thinned - a * next_own, next_thinned - next_own), a)
    return max(min(whole + 1 + after, np.nextafter(whole + 2.0, 0.0)), level)


@compiled
def levels(own: F64, sides: F64, seam: F64, bound: F64, columns: int, morph: bool) -> F64:
    """(blocks,) see `Levels.at`; `bound`: metres that blocks may be off, in rows of `columns`."""
    count = bound.size
    rows = count // columns
    level = np.empty(count)
    for block in range(count):
        whole = 0
        while own[whole + 1, block] <= bound[block]:
            whole += 1
        fine, coarse = own[whole, block], own[whole + 1, block]
        level[block] = whole + _share(bound[block] - fine, coarse - fine) if morph else whole
    changed, lowered = np.ones(count, np.bool_), np.zeros(count, np.bool_)
    going = True
    while going:
        going = False
        for edge in range(4):
            step = (-1, 1, -columns, columns)[edge]
            for n in range(count):
                # whatever is made finer has had its turn over this edge before
                block = n if step < 0 else count - 1 - n
                if not changed[block]:
                    continue
                row, column = block // columns, block % columns
                if (column == 0, column == columns - 1, row == 0, row == rows - 1)[edge]:
                    continue
                other = block + step
                if level[other] <= level[block]:
                    continue
                limit = _limit(sides, seam, edge, block, level[block], bound[block])
                if not morph:
                    limit = max(math.floor(limit), level[block])
                if limit < level[other]:
                    level[other] = limit
                    lowered[other] = going = True
        changed[:] = lowered
        lowered[:] = False
    return level


@compiled
def edges(level: F64, columns: int) -> F64:
    """(4, blocks) see `Levels.edges`."""
    count = level.size
    result = np.empty((4, count))
    for block in range(count):
        row, column = block // columns, block % columns
        result[0, block] = max(level[block], level[block - 1]) if column > 0 else level[block]
        result[1, block] = max(level[block], level[block + 1]) if column < columns - 1 else level[block]
        result[2, block] = max(level[block], level[block - columns]) if row > 0 else level[block]
        result[3, block] = max(level[block], level[block + columns]) if block + columns < count else level[block]
    return result
