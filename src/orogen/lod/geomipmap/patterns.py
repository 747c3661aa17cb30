"""The index lists of blocks: for each level one of the inside, and for each edge two, the second of which leaves out
every other vertex of the edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LISTS = 9
"""Lists of a level: the inside, then two for each of the west, east, north and south edge."""
NO_COLUMNS_BIT = 20
"""Bit of a vertex number: its triangle has no edge along a column inside, for the wireframe."""
NO_ROWS_BIT = 21
"""Likewise along a row."""
LIST_BIT = 22
"""First bit of the list's number in a vertex number: 9 l for the inside of level l, 9 l + 1 + 2 e for edge e with all
its vertices, one more for it with every second."""

_SIDES = (
    ((-1, -1), (0, -1), (1, -1)),
    ((1, 1), (0, 1), (-1, 1)),
    ((-1, 1), (-1, 0), (-1, -1)),
    ((1, -1), (1, 0), (1, 1)),
)
"""Start, middle and end of a fan's west, east, north and south side: steps in rows and columns from its centre."""


def index_lists(quads: int) -> list[NDArray[np.uint32]]:
    """(n, 3) vertex numbers of each list's triangles for blocks of `quads` x `quads` quads at level 0.

    Vertices are numbered row by row at level 0. All levels but the last are made of fans around the middles of squares
    of two by two quads; the last is a pair of triangles.
    """
    lists = []
    for level in range(quads.bit_length() - 1):
        lists += _fans(quads, 1 << level)
    a, b, c, d = 0, quads, quads * (quads + 1), quads * (quads + 1) + quads
    lists.append(np.array([[a, c, d], [a, d, b]]))
    return [triangles.astype(np.uint32) | np.uint32(number << LIST_BIT) for number, triangles in enumerate(lists)]


def _fans(quads: int, quad: int) -> list[NDArray[np.int64]]:
    """The lists of a level with quads of a width."""

    def number(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
        return row * (quads + 1) + column

    row, column = (part.ravel() for part in np.mgrid[quad : quads : 2 * quad, quad : quads : 2 * quad])
    rims = (column == quad, column == quads - quad, row == quad, row == quads - quad)
    inside, edges = [], []
    for edge, (side, rim) in enumerate(zip(_SIDES, rims, strict=True)):
        centre = number(row, column)
        start, middle, end = (number(row + quad * down, column + quad * right) for down, right in side)
        halves = np.stack([centre, start, middle, centre, middle, end], axis=-1).reshape(-1, 2, 3)
        mark = 1 << (NO_ROWS_BIT if edge < 2 else NO_COLUMNS_BIT)
        inside.append(halves[~rim].reshape(-1, 3))
        edges += [halves[rim].reshape(-1, 3), np.stack([centre, start, end], axis=-1)[rim] | mark]
    return [np.concatenate(inside), *edges]
