"""The pool of refinement patterns (Boubekeur and Schlick 2007, in Schmiade 2008, section 2.5)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

DEPTH_BITS = 16
"""Where a corner's word holds how deep its pattern goes; below lie its shares of the corners a and b, 8 bits each."""

Ints = NDArray[np.int64]
_LEGS = np.array([[1, 0], [0, 1]])
"""Corners a and b of a coarse triangle relative to c, where its right angle is."""


@lru_cache
def pattern_pool(depth: int) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """All patterns of edges that are halved up to `depth` times.

    The access table, ((depth + 1)**3, 2): first triangle and number of triangles of the pattern for the depths
    (i, j, k) of the edges opposite a, b and c, in row i * (depth + 1)**2 + j * (depth + 1) + k; and the triangles,
    (n, 3) words of their corners.
    """
    side = depth + 1
    edges = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    corners, owner = divide(edges, depth)
    table = np.zeros((len(edges), 2), np.uint32)
    table[:, 1] = np.bincount(owner, minlength=len(edges))
    table[1:, 0] = np.cumsum(table[:-1, 1])
    words = corners[..., 0] | corners[..., 1] << 8 | edges[owner].max(axis=1)[:, None] << DEPTH_BITS
    return table, words.astype(np.uint32)


def divide(edges: Ints, depth: int) -> tuple[Ints, Ints]:
    """(n, 3, 2) corners of the patterns' triangles, shares of a and b in parts of 2**depth; (n,) number of the pattern.

    `edges`: (patterns, 3) how often the edges opposite a, b and c are halved.
    """
    one = 1 << depth
    corners = np.broadcast_to(np.array([[one, 0], [0, one], [0, 0]]), (len(edges), 3, 2))
    owner = np.arange(len(edges))
    whole: list[tuple[Ints, Ints]] = []
    while len(owner):
        splits = (edges > 0).sum(axis=1)
        whole.append((corners[splits == 0], owner[splits == 0]))
        parts = [
            split(*_turned(corners[chosen], edges[chosen], count), owner[chosen])
            for count, split in enumerate((_in_two, _in_three, _in_four), start=1)
            for chosen in [splits == count]
        ]
        corners, edges, owner = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    found, owner = (np.concatenate(arrays) for arrays in zip(*whole, strict=True))
    order = np.argsort(owner, kind="stable")
    return found[order], owner[order]


def _turned(corners: Ints, edges: Ints, count: int) -> tuple[Ints, Ints]:
    """Triangles renumbered so that the last edge is the one that differs from the others in being split or not."""
    if count == 3:
        return corners, edges
    last = ((edges > 0) == (count == 1)).argmax(axis=1)
    order = (last[:, None] + np.arange(1, 4)) % 3
    return np.take_along_axis(corners, order[..., None], axis=1), np.take_along_axis(edges, order, axis=1)


def _parts(owner: Ints, *triangles: tuple[tuple[Ints, ...], tuple[Ints, ...]]) -> tuple[Ints, Ints, Ints]:
    corners = np.concatenate([np.stack(part, axis=1) for part, _ in triangles])
    edges = np.concatenate([np.stack(part, axis=1) for _, part in triangles])
    return corners, edges, np.tile(owner, len(triangles))


def _in_two(corners: Ints, edges: Ints, owner: Ints) -> tuple[Ints, Ints, Ints]:
    """Only the edge between the first two corners is split."""
    (a, b, c), (_, _, z) = corners.swapaxes(0, 1), edges.T
    middle, none = (a + b) // 2, np.zeros_like(z)
    # what is inside is as fine as the finest edge: edges cannot tell where inside it would not need to be
    return _parts(owner, ((a, middle, c), (z - 1, none, z - 1)), ((middle, b, c), (none, z - 1, z - 1)))


def _in_three(corners: Ints, edges: Ints, owner: Ints) -> tuple[Ints, Ints, Ints]:
    """All edges but the one between the first two corners are split."""
    (a, b, c), (x, y, none) = corners.swapaxes(0, 1), edges.T
    p, q, inner = (b + c) // 2, (c + a) // 2, np.maximum(x, y) - 1
    # of the two diagonals of a, b, p, q the one that makes less oblique triangles (Schmiade 2008, section 4.7.1)
    one = np.minimum(_sharpness(a, b, p), _sharpness(a, p, q))
    other = np.minimum(_sharpness(a, b, q), _sharpness(b, p, q))
    first = one >= other
    low = np.where(first[:, None], p, q)
    return _parts(
        owner,
        ((q, p, c), (x - 1, y - 1, inner)),
        ((a, b, low), (np.where(first, x - 1, inner), np.where(first, inner, y - 1), none)),
        (
            (np.where(first[:, None], a, b), p, q),
            (inner, np.where(first, y - 1, inner), np.where(first, inner, x - 1)),
        ),
    )


def _in_four(corners: Ints, edges: Ints, owner: Ints) -> tuple[Ints, Ints, Ints]:
    """All edges are split."""
    (a, b, c), (x, y, z) = corners.swapaxes(0, 1), edges.T
    p, q, r, inner = (b + c) // 2, (c + a) // 2, (a + b) // 2, edges.max(axis=1) - 1
    return _parts(
        owner,
        ((a, r, q), (inner, y - 1, z - 1)),
        ((r, b, p), (x - 1, inner, z - 1)),
        ((q, p, c), (x - 1, y - 1, inner)),
        ((p, q, r), (inner, inner, inner)),
    )


def _sharpness(*corners: Ints) -> NDArray[np.float64]:
    """Smallest angle (radians) of triangles, over the ground."""
    places = [corner @ _LEGS for corner in corners]
    angles = []
    for k in range(3):
        u, v = places[k - 2] - places[k], places[k - 1] - places[k]
        across = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        angles.append(np.arctan2(across, (u * v).sum(axis=1)))
    return np.min(angles, axis=0)
