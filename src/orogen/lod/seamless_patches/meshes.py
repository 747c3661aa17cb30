"""The cached meshes of a patch: a trile per resolution, and a stitching strip per pair of resolutions.

A patch is a square of `most` x `most` units. Meshes are made for one orientation and turned by the vertex shader. A
trile of resolution R lies along the north side, in steps of most / R units; its legs run one step inside the diagonals.
A strip lies along the diagonal from the north-west corner to the middle, between the legs of the north trile and of the
west trile, and has vertices of its own on the diagonal, as densely as the finer of the two.

All triangles stay as they are turned, or lose their area, where the shader moves what hangs over the data onto its
border: each has a side along a row or column, or a corner that is east of, and north of, two others on the diagonal.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Place = tuple[int, int]
"""Column and row in units."""
Triangle = tuple[Place, Place, Place]


class Bits(IntEnum):
    """Where the parts of a vertex number start; the column is in the lowest bits."""

    ROW = 7
    CORNER = 14
    """Which corner of a strip's triangle, from 1; 0 in triles."""
    MESH = 16


def resolutions(most: int) -> list[int]:
    """Segments that a patch's side can have: 2, 4 ... `most`."""
    return [1 << k for k in range(1, most.bit_length())]


def trile(resolution: int, most: int) -> list[Triangle]:
    """The triangular tile along the north side; nothing at a resolution of 2, where strips fill the patch."""
    step = most // resolution
    found: list[Triangle] = []
    for row in range(resolution // 2 - 1):
        first, last = row + 1, resolution - row - 1
        found.append(((first, row), (first + 1, row), (first + 1, row + 1)))
        for column in range(first + 1, last - 1):
            a, b, c, d = (column, row), (column + 1, row), (column, row + 1), (column + 1, row + 1)
            # the diagonals continue the legs
            found += [(a, b, d), (a, d, c)] if (column + row) % 2 else [(a, b, c), (b, d, c)]
        found.append(((last - 1, row), (last, row), (last - 1, row + 1)))
    return [((a * step, b * step), (c * step, d * step), (e * step, f * step)) for (a, b), (c, d), (e, f) in found]


def strip(north: int, west: int, most: int) -> list[Triangle]:
    """The strip between triles of resolutions `north` and `west`."""
    half = most // 2
    dense = most // max(north, west)
    sides = []
    for resolution in (north, west):
        step = most // resolution
        found: list[Triangle] = []
        for start in range(0, half, step):
            leg = (start + step, start)
            found += [(leg, (at + dense, at + dense), (at, at)) for at in range(start, start + step, dense)]
            if start + step < half:
                found.append((leg, (start + 2 * step, start + step), (start + step, start + step)))
        sides.append(found)
    return sides[0] + [(_mirrored(a), _mirrored(c), _mirrored(b)) for a, b, c in sides[1]]


def index_lists(most: int) -> list[NDArray[np.uint32]]:
    """(triangles, 3) vertex numbers of all triles by resolution, then of all strips by north and west resolution."""
    known = resolutions(most)
    lists = [[[_number(v, 0) for v in corners] for corners in trile(r, most)] for r in known]
    lists += [
        [[_number(v, corner) for corner, v in enumerate(corners, 1)] for corners in strip(north, west, most)]
        for north in known
        for west in known
    ]
    return [
        np.array(numbers, np.uint32).reshape(-1, 3) | np.uint32(mesh << Bits.MESH) for mesh, numbers in enumerate(lists)
    ]


def _mirrored(place: Place) -> Place:
    return place[1], place[0]


def _number(place: Place, corner: int) -> int:
    return corner << Bits.CORNER | place[1] << Bits.ROW | place[0]
