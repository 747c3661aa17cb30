"""The pool of adaptive refinement patterns: for any three depths of its edges, the triangles that a triangle becomes.

A vertex is a pair of integers: the weights of the first and the second corner in units of 2**-most; the third corner
has the rest. Edge k lies opposite corner k, and an edge of depth d has 2**d segments of equal length. Patterns are kept
for depths in descending order; a triangle's corners are put into that order, which may also turn it over.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

Vertex = tuple[int, int]
Corners = tuple[Vertex, Vertex, Vertex]
Depths = tuple[int, int, int]


class Bits(IntEnum):
    """Where the parts of a vertex number start; the first corner's weight is in the lowest bits."""

    SECOND = 8
    CORNER = 16
    """Which of its triangle's three lines falls to 0 across from it."""
    PATTERN = 18


def pool(most: int) -> list[Depths]:
    """Depths of the patterns' edges up to `most`, descending; (i, j, k) is number C(i + 2, 3) + C(j + 1, 2) + k."""
    return [(i, j, k) for i in range(most + 1) for j in range(i + 1) for k in range(j + 1)]


def pattern(depths: Depths, most: int, way: str) -> NDArray[np.int64]:
    """(n, 3, 2) vertices of a pattern's triangles. `way`: one of `WAYS`."""
    found: list[NDArray[np.int64]] = []
    _refine(((1 << most, 0), (0, 1 << most), (0, 0)), depths, WAYS[way], found)
    return np.concatenate(found)


@cache
def index_lists(most: int, way: str) -> tuple[NDArray[np.uint32], ...]:
    """(n, 3) vertex numbers of every pattern of the pool."""
    return tuple(_numbers(pattern(depths, most, way), number) for number, depths in enumerate(pool(most)))


Way = Callable[[int, int, int], int]
"""Depth of an edge inside, as if it were as long as those outside: from those at its ends, and the least one."""

WAYS: dict[str, Way] = {
    # as the coarsest edge everywhere: only triangles at the other edges are split further
    "uniform": lambda one, other, least: least,
    # from each edge's depth to the others', step by step
    "graded": lambda one, other, least: (one + other) // 2,
}
"""Ways to fill a triangle between its edges."""


def _refine(corners: Corners, depths: Depths, way: Way, found: list[NDArray[np.int64]]) -> None:
    """Add the triangles of one. An edge's depth is all that those on both sides of it know, so that they always fit."""
    if depths[0] == depths[1] == depths[2]:
        found.append(_divided(corners, 1 << depths[0]))
    elif min(depths) > 0:
        _quarter(corners, depths, way, found)
    else:
        _halve(corners, depths, way, found)


def _quarter(corners: Corners, depths: Depths, way: Way, found: list[NDArray[np.int64]]) -> None:
    middles = _middle(corners[1], corners[2]), _middle(corners[2], corners[0]), _middle(corners[0], corners[1])

    def inner(k: int) -> int:
        after, before = (k + 1) % 3, (k + 2) % 3
        wanted = way(depths[after], depths[before], min(depths)) - 1
        return min(wanted, _deepest(middles[after], middles[before]))

    across = inner(0), inner(1), inner(2)
    for k in range(3):
        after, before = (k + 1) % 3, (k + 2) % 3
        cut_off = corners[k], middles[before], middles[after]
        _refine(cut_off, (across[k], depths[after] - 1, depths[before] - 1), way, found)
    _refine(middles, across, way, found)


def _halve(corners: Corners, depths: Depths, way: Way, found: list[NDArray[np.int64]]) -> None:
    """Cut through the middle of the deepest edge."""
    top = depths.index(max(depths))
    a, b, c = (corners[(top + k) % 3] for k in range(3))
    deep, one, other = (depths[(top + k) % 3] for k in range(3))
    middle = _middle(b, c)
    across = min(way(deep, (one + other) // 2, 0), deep - 1, _deepest(a, middle))
    _refine((a, b, middle), (deep - 1, across, other), way, found)
    _refine((a, middle, c), (deep - 1, one, across), way, found)


def _middle(one: Vertex, other: Vertex) -> Vertex:
    return (one[0] + other[0]) // 2, (one[1] + other[1]) // 2


def _deepest(one: Vertex, other: Vertex) -> int:
    """How deep an edge can be with all its points on the lattice."""
    steps = one[0] - other[0] | one[1] - other[1]
    return (steps & -steps).bit_length() - 1


def _divided(corners: Corners, parts: int) -> NDArray[np.int64]:
    """(parts**2, 3, 2): a triangle cut into equal ones."""
    a, b, c = np.array(corners)
    along = _shares(parts)
    return a + ((b - a) * along[..., :1] + (c - a) * along[..., 1:]) // parts


@cache
def _shares(parts: int) -> NDArray[np.int64]:
    """(parts**2, 3, 2): `parts` times the weights of the second and the third corner, row by row."""
    row, column, turned = np.mgrid[:parts, :parts, :2].reshape(3, -1)
    place = np.stack([column, row], axis=1)[row + column + turned < parts]
    turned = turned[row + column + turned < parts]
    corners = np.array([[[0, 0], [1, 0], [0, 1]], [[1, 0], [1, 1], [0, 1]]])
    return place[:, None] + corners[turned]


def _numbers(triangles: NDArray[np.int64], number: int) -> NDArray[np.uint32]:
    # colours the vertices of all equilateral triangles of the lattice, of any size, so that neighbours share them
    corner = (triangles[..., 0] - triangles[..., 1]) % 3
    corner[(np.sort(corner, axis=1) != np.arange(3)).any(axis=1)] = np.arange(3)
    packed = triangles[..., 0] | triangles[..., 1] << Bits.SECOND | corner << Bits.CORNER | number << Bits.PATTERN
    return packed.astype(np.uint32)
