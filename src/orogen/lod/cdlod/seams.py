"""What happens where two levels of CDLOD meet: levels differ by one, the finer side is morphed fully, the coarser not.

Distances bring that about by themselves on ground without walls. Where a node's box is high in comparison with its
range they do not, and there the edges are told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.lod.quadtree import Ints, Leaves

_EDGES = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""Steps in x and y over the west, east, north and south edge; the opposite of edge e is e ^ 1."""
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


def thin(leaves: Leaves, inside: list[NDArray[np.bool_]]) -> list[NDArray[np.bool_]]:
    """Which leaves are drawn with every second vertex: those not `inside` the range of their own level.

    Adjacent leaves differ by one level at most. The levels of their grids must not differ by more either, so a leaf
    stays whole beside one that is whole and finer.
    """
    thinned = [~own for own in inside]
    for level in range(1, len(leaves)):
        x, y = (part[~thinned[level - 1]] for part in leaves[level - 1])
        for dx, dy in _EDGES:
            thinned[level] &= ~np.isin(_key(*leaves[level]), _key((x + dx) >> 1, (y + dy) >> 1))
    return thinned


def joined(leaves: Leaves, thinned: list[NDArray[np.bool_]]) -> Pieces:
    """The pieces of all levels, with what is beyond their edges; the whole ones first."""
    level = np.repeat(np.arange(len(leaves)), [x.size for x, _ in leaves])
    x, y = np.concatenate(leaves, axis=1)
    thin = np.concatenate(thinned)
    order = np.lexsort((_key(x, y), level, thin))
    level, x, y, thin = level[order], x[order], y[order], thin[order]
    edges = np.zeros(level.size, np.uint32)
    groups = {(own, way): np.flatnonzero((level == own) & (thin == way)) for own in set(level) for way in (0, 1)}
    for (own, way), pieces in groups.items():
        # a coarser neighbour has the next level's grid: as a node of that level, or as a quadrant of such a node
        for other, other_way in ((own + way + 1, 0), (own + way, 1)):
            candidates = groups.get((other, other_way), np.zeros(0, np.int64))
            if not (pieces.size and candidates.size):
                continue
            shift = other - own
            quarters = 4 >> shift
            known = _key(x[candidates], y[candidates])
            for edge, (dx, dy) in enumerate(_EDGES):
                wanted = _key((x[pieces] + dx) >> shift, (y[pieces] + dy) >> shift)
                place = np.minimum(np.searchsorted(known, wanted), known.size - 1)
                met = known[place] == wanted
                edges[pieces[met]] |= 1 << (COARSER_BIT + edge)
                along = (y if edge < 2 else x)[pieces[met]] & ((1 << shift) - 1)
                covered = ((1 << quarters) - 1) << (along * quarters + 4 * (edge ^ 1))
                np.bitwise_or.at(edges, candidates[place[met]], covered.astype(np.uint32))
    return Pieces(level, x, y, thin, edges)


def _key(x: Ints, y: Ints) -> Ints:
    return (y << 32) | (x & 0xFFFFFFFF)
