"""The nine index lists of a patch (Houska 2019, figure 2.21): which of its borders adjoin a coarser patch.

A vertex is written as one number that the vertex shader reads its place from, so that no vertex buffer exists: see
`Bits`. Children of one parent never have a coarser neighbour on the sides that they share, so of west and east one at
most is stitched, and of north and south.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

QUADS = 32
"""Quads along a patch's side."""
PATTERNS = 9
"""Columns none, west, east; rows none, north, south."""


class Bits(IntEnum):
    """Where the parts of a vertex number start; the column is in the lowest bits."""

    ROW = 6
    HIDE_COLUMN = 12
    """Set where the vertical grid line through the vertex does not exist in the triangle."""
    HIDE_ROW = 13
    """The same for the horizontal one."""
    PATTERN = 14


def pattern_of(coarser: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) pattern of patches; `coarser`: (n, 4) whether the patch in the west, east, north and south is coarser."""
    west, east, north, south = coarser.T.astype(np.int64)
    return west + 2 * east + 3 * (north + 2 * south)


def index_list(pattern: int) -> NDArray[np.uint32]:
    """(triangles, 3) vertex numbers of a pattern.

    Quads are split towards the middle of each block of two by two, so that a vertex on a border between two blocks
    belongs to two triangles: where it is removed, the two become one, which is the neighbour's.
    """
    horizontal, vertical = pattern % 3, pattern // 3
    removed = {"west": horizontal == 1, "east": horizontal == 2, "north": vertical == 1, "south": vertical == 2}
    last = QUADS - 1
    triangles: list[list[int]] = []
    for row in range(1, QUADS, 2):
        for column in range(1, QUADS, 2):
            middle = (column, row)
            # counter-clockwise seen with rows going down: from the corner before each side to the one after it
            sides = {
                "north": ((-1, -1), (1, -1), row == 1), "east": ((1, -1), (1, 1), column == last),
                "south": ((1, 1), (-1, 1), row == last), "west": ((-1, 1), (-1, -1), column == 1),
            }  # fmt: skip
            for name, (start, end, outer) in sides.items():
                a, b = _moved(middle, start), _moved(middle, end)
                if outer and removed[name]:
                    hide = Bits.HIDE_COLUMN if name in ("north", "south") else Bits.HIDE_ROW
                    triangles.append([_number(v, pattern) | 1 << hide for v in (middle, a, b)])
                else:
                    between = ((a[0] + b[0]) // 2, (a[1] + b[1]) // 2)
                    triangles.append([_number(v, pattern) for v in (middle, a, between)])
                    triangles.append([_number(v, pattern) for v in (middle, between, b)])
    return np.array(triangles, np.uint32)


def index_lists() -> list[NDArray[np.uint32]]:
    """The lists of all patterns."""
    return [index_list(pattern) for pattern in range(PATTERNS)]


def _moved(vertex: tuple[int, int], step: tuple[int, int]) -> tuple[int, int]:
    return vertex[0] + step[0], vertex[1] + step[1]


def _number(vertex: tuple[int, int], pattern: int) -> int:
    return pattern << Bits.PATTERN | vertex[1] << Bits.ROW | vertex[0]
