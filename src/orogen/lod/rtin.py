"""Right-triangulated irregular networks: which vertices of a square grid of heights a mesh needs.

Triangles are right-angled with two equal sides; one is split at the middle of its longest side, together with the one
across it. A vertex is the middle of such a side. Grids are (n + 1) x (n + 1) values, n a power of two, and vertices are
numbered row by row; the first split is along the diagonal from the upper left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Generation:
    """Triangles of one size; the two that a triangle is split into follow one another in the next generation."""

    corners: Ints
    """(count, 3) vertices: both ends of the longest side, then the right angle."""
    middles: Ints
    """(count,) vertices that split them."""
    inside: Ints
    """(count, points) vertices in and on the triangles."""
    weights: Floats
    """(points, 3) share of every corner in the plane through them, at these points."""


@lru_cache
def generations(n: int) -> tuple[Generation, ...]:
    """All triangles over a grid of n x n quads, the largest first; the last ones are not split."""
    corner = np.array([[[0, 0], [n, n], [n, 0]], [[n, n], [0, 0], [0, n]]])
    grid = np.stack(np.meshgrid(np.arange(n + 1), np.arange(n + 1)), axis=-1).reshape(-1, 2)
    result = []
    while True:
        a, b, c = corner.swapaxes(0, 1)
        # triangles of one size differ by a symmetry of the grid: what holds for the first one holds for all
        shares = (grid - c[0]) @ np.linalg.inv(np.stack([a[0] - c[0], b[0] - c[0]]))
        weights = np.column_stack([shares, 1 - shares.sum(axis=1)])
        weights = weights[(weights > -1e-9).all(axis=1)]
        inside = np.rint(np.einsum("pk,tkd->tpd", weights, corner)).astype(np.int64)
        middle = (a + b) // 2
        at = np.array([1, n + 1])
        result.append(Generation(corner @ at, middle @ at, inside @ at, weights))
        if len(corner) == 2 * n * n:
            return tuple(result)
        corner = np.stack([np.stack([c, a, middle], 1), np.stack([b, c, middle], 1)], 1).reshape(-1, 3, 2)


def vertex_errors(heights: Floats) -> Floats:
    """(n + 1, n + 1): how far a mesh may be off that lacks a vertex.

    The distance of the grid's own surface to the triangles that the vertex would split, or to any within these: errors
    never grow from a triangle to its parts, so that leaving out all vertices below a threshold keeps to it.
    """
    flat = heights.ravel()
    n = heights.shape[0] - 1
    errors = np.zeros(flat.size)
    finer: Generation | None = None
    for generation in generations(n)[-2::-1]:
        planes = flat[generation.corners] @ generation.weights.T
        error = np.abs(flat[generation.inside] - planes).max(axis=1)
        if finer is not None:
            error = np.maximum(error, errors[finer.middles].reshape(-1, 2).max(axis=1))
        np.maximum.at(errors, generation.middles, error)
        finer = generation
    return errors.reshape(heights.shape)


def triangles(needed: NDArray[np.bool_]) -> Ints:
    """(m, 3) vertices of the mesh's triangles, from a mask (n + 1, n + 1) of the vertices that split triangles."""
    *split, last = generations(needed.shape[0] - 1)
    splits = needed.ravel()
    reached = np.ones(2, bool)
    found = []
    for generation in split:
        divided = reached & splits[generation.middles]
        found.append(generation.corners[reached & ~divided])
        reached = np.repeat(divided, 2)
    found.append(last.corners[reached])
    return np.concatenate(found)


def surface(heights: Floats, needed: NDArray[np.bool_]) -> Floats:
    """Heights of the mesh at all vertices of the grid."""
    flat, splits = heights.flatten(), needed.ravel()
    for generation in generations(heights.shape[0] - 1)[:-1]:
        missing = ~splits[generation.middles]
        ends = flat[generation.corners[missing, :2]]
        flat[generation.middles[missing]] = ends.mean(axis=1)
    return flat.reshape(heights.shape)


def refined(heights: NDArray[np.floating], odd: bool = False) -> NDArray[np.floating]:
    """A grid of twice the quads on the same surface, that of its smallest triangles.

    Their diagonals fall where the sum of column and row is even, and rise elsewhere; `odd`: the other way round.
    """
    rows, columns = heights.shape
    out = np.empty((2 * rows - 1, 2 * columns - 1), heights.dtype)
    half = heights.dtype.type(0.5)
    out[::2, ::2] = heights
    out[::2, 1::2] = (heights[:, 1:] + heights[:, :-1]) * half
    out[1::2, ::2] = (heights[1:] + heights[:-1]) * half
    for j in (0, 1):
        for i in (0, 1):
            h = heights[j:, i:]
            if (i + j + odd) % 2:
                rising = h[:-1, 1:] + h[1:, :-1]
            else:
                rising = h[:-1, :-1] + h[1:, 1:]
            out[1 + 2 * j :: 4, 1 + 2 * i :: 4] = rising[::2, ::2] * half
    return out
