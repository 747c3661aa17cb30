"""What happens where two levels of CDLOD meet: levels differ by one, the finer side is morphed fully, the coarser not.

Distances bring that about by themselves on ground without walls. Where a node's box is high in comparison with its
range they do not, and there the edges are told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.lod.quadtree import Ints, Leaves, neighbours

COARSER_BIT = 16
"""First of the four bits that mark edges with a coarser neighbour. Before them are four bits for each edge: its
quarters that have a finer one."""


@dataclass(frozen=True)
class Pieces:
    """What is drawn: nodes with all vertices, and quadrants of nodes, with every second vertex of their own grid."""

    level: Ints
    """(n,) level of the node whose place it takes."""
    x: Ints
    """(n,) column in that level."""
    y: Ints
    """(n,) row in that level."""
    thinned: NDArray[np.bool_]
    """(n,) every second vertex: the grid of level + 1."""
    edges: NDArray[np.uint32]
    """(n,) bits of the edges where levels meet."""


def thin(leaves: Leaves, inside: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Ints]:
    """Which leaves are drawn with every second vertex: those not `inside` the range of their own level. And neighbours.

    Adjacent leaves differ by one level at most. The levels of their grids must not differ by more either, so a leaf
    stays whole beside one that is whole and finer.
    """
    level, beyond = leaves.level, neighbours(leaves)
    thinned = ~inside
    # who has a coarser one beyond which edge, level by level: what stays whole keeps the next level whole
    finer, edge = np.nonzero(np.append(level, -1)[beyond] > level[:, None])
    coarser = beyond[finer, edge]
    starts = np.searchsorted(level[finer], np.arange(int(level.max(initial=-1)) + 2))
    for first, last in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        thinned[coarser[first:last][~thinned[finer[first:last]]]] = False
    return thinned, beyond


def joined(leaves: Leaves, thinned: NDArray[np.bool_], beyond: Ints) -> Pieces:
    """The pieces of all levels, with what is beyond their edges; the whole ones first. `beyond`: `neighbours`."""
    level, x, y = leaves
    edges = np.zeros(level.size, np.uint32)
    # a coarser neighbour has the next level's grid: as a node of that level, or as a quadrant of such a node
    grid = level + thinned
    piece, edge = np.nonzero(np.append(grid, -1)[beyond] == grid[:, None] + 1)
    other = beyond[piece, edge]
    np.bitwise_or.at(edges, piece, np.uint32(1) << (COARSER_BIT + edge).astype(np.uint32))
    shift = level[other] - level[piece]
    quarters = 4 >> shift
    along = np.where(edge < 2, y[piece], x[piece]) & ((1 << shift) - 1)
    covered = ((1 << quarters) - 1) << (along * quarters + 4 * (edge ^ 1))
    np.bitwise_or.at(edges, other, covered.astype(np.uint32))
    order = np.lexsort((y << 32 | x, level, thinned))
    return Pieces(level[order], x[order], y[order], thinned[order], edges[order])
