"""Compiled kernels of bintree.py and wedgies.py. Importing this takes numba, and seconds: do it where it is needed.

They are in one file, since numba compiles a kernel anew when its own file has changed, not that of what it calls.

Points of the lattice are integers (x, y). A diamond is the two triangles (at the outline one) that share a longest
side; it is named by the middle of that side. Its scale s is the lowest bit set in x or y. Where both have it the side
is a diagonal of a square of side 2 s (a *square* diamond), else it is parallel to an axis and 2 s long (an *edge* one).
Splitting a diamond makes its middle a vertex. A triangle is a middle and an apex; its apex is a diamond's middle, too:
of the one whose split made it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError

try:
    import numba
except ImportError as error:
    raise SettingsError('expected the package numba; run: pip install "orogen[compiled]"') from error

F = TypeVar("F", bound=Callable[..., Any])
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Array = NDArray[Any]

ABSENT, CANDIDATE, SPLIT = 0, 1, 2
"""States of a diamond: not in the mesh; some of its triangles are; its middle is a vertex."""
DONE, STOPPED, CROWDED, SHORT = 0, 1, 2, 3
"""Outcomes of `refine`: the queues have crossed; out of operations; the arrays are too small; there may be too few
triangles, so that the queues have to hold all diamonds."""
POOL, FREED, TRIANGLES, SPLITS, MERGES, WHOLE = 0, 1, 2, 3, 4, 5
"""Places in `Mesh.counts`: diamonds ever used, those free again, triangles, entries of both queues, whether the queues
hold all diamonds, not only those that are due."""
MARGIN = 1 << 10
"""Room that an operation may take: at most 4 diamonds and 4 triangles for each of some 60 levels, and queue entries."""
FIRST = 1e30
"""Priority of what reaches behind the near plane."""


class Ground(NamedTuple):
    """What is known about the terrain: see `wedgies.Wedgies`."""

    heights: F32
    thickness: F32
    error: F32
    within: F32
    bits: int
    """Units of the lattice between two heights: 2^bits."""
    side: int
    """Units along a root square."""
    width: int
    """Units from the first to the last column, and row, of root squares."""
    height: int
    ahead: int
    """Splits from a triangle to those that it is drawn as."""


class Eye(NamedTuple):
    """The LOD camera; metres are relative to the camera that looks."""

    origin: F64
    """The camera that looks, in units of the lattice."""
    metres: F64
    """2 x 2, units to metres."""
    exaggeration: float
    height: float
    """Of the camera that looks, metres."""
    curvature: float
    position: F64
    """Of the LOD camera."""
    basis: F64
    """Right, up and forward of the LOD camera."""
    pixels: float
    """Per radian, or per metre where orthographic."""
    orthographic: bool
    planes: F64
    """(5, 4), positive inside the frustum."""


class Mesh(NamedTuple):
    """Diamonds, their triangles and both queues; the arrays may have more room than is used."""

    place: NDArray[np.int64]
    """(n, 2) middles."""
    state: NDArray[np.uint8]
    parts: NDArray[np.uint8]
    """(n,) how many of the diamonds that depend on it are split."""
    priority: F64
    rank: NDArray[np.int64]
    known: F64
    """(n, 8) metres: heights of the ends of the longest side and of both apexes; errors of the triangles on both, -1
    where they are not split; halves of their thickness."""
    slots: NDArray[np.int32]
    """(n, 2) places of a candidate's triangles in the list, by apex; -1 where there is none."""
    free: NDArray[np.int32]
    table: NDArray[np.int32]
    """Hash table of diamonds by place."""
    triangles: NDArray[np.int32]
    """(m, 4) middle and apex of every triangle of the mesh."""
    owner: NDArray[np.int32]
    """(m,) twice the diamond, plus which apex."""
    changed: NDArray[np.bool_]
    """(m,) whether a place in the list has been written since it was last asked."""
    shift: F64
    """(n,) metres that a split diamond's middle is drawn over its place, while it morphs."""
    shifts: F32
    """(m, 3) the same for a triangle's apex and ends."""
    splits: Array
    """Binary heaps: (key, rank, diamond), the smallest first; entries that have become void are dropped at the top."""
    merges: Array
    counts: NDArray[np.int64]
    tau: F64
    """(1,) pixels above which diamonds are split."""


ENTRY = np.dtype([("key", "f8"), ("rank", "i8"), ("diamond", "i4"), ("unused", "i4")])


def compiled(function: F) -> F:
    """Compile at the first call; kept on disk."""
    return cast(F, numba.njit(cache=True, nogil=True)(function))


# -- the lattice -------------------------------------------------------------------------------------------------------


@compiled
def scale_of(x: int, y: int) -> int:
    """The diamond's scale."""
    both = x | y
    return both & -both


@compiled
def apexes_of(x: int, y: int) -> tuple[int, int, int, int]:
    """x, y of both apexes of a diamond; the first is further up, or at its left."""
    s = scale_of(x, y)
    if x & s and y & s:
        if ((x - s) // (2 * s) + (y - s) // (2 * s)) & 1 == 0:
            return x + s, y - s, x - s, y + s
        return x - s, y - s, x + s, y + s
    if x & s:
        return x, y - s, x, y + s
    return x - s, y, x + s, y


@compiled
def dependent(x: int, y: int, number: int) -> tuple[int, int]:
    """Middle of one of the four diamonds that get a triangle when this one is split."""
    s = scale_of(x, y)
    if x & s and y & s:
        step = s if number < 2 else -s
        return (x + step, y) if number & 1 == 0 else (x, y + step)
    h = s // 2
    return x + (h if number & 1 else -h), y + (h if number & 2 else -h)


@compiled
def is_inside(ground: Ground, x: int, y: int) -> bool:
    """Whether a point lies in the root squares."""
    return 0 <= x <= ground.width and 0 <= y <= ground.height


@compiled
def which_apex(x: int, y: int, apex_x: int, apex_y: int) -> int:
    """0 or 1, in the order of `apexes_of`."""
    return 0 if apex_y < y or (apex_y == y and apex_x < x) else 1


@compiled
def rank_of(x: int, y: int) -> int:
    """Numbers diamonds: what others depend on comes first."""
    s = scale_of(x, y)
    level = 62
    while s > 1:
        s >>= 1
        level -= 2
    if not (x & y & scale_of(x, y)):
        level += 1
    return (level << 54) | (y << 27) | x


# -- wedgies -----------------------------------------------------------------------------------------------------------


@compiled
def part_of(values: F32, cells: F32, x: int, y: int, s: int, end_x: int, end_y: int, apex_x: int, apex_y: int) -> float:
    """Value of one of the parts of a triangle: of that with the end `end`. `values`: (2, rows, columns) by apex.

    `cells` likewise, or (1, rows, columns) where the halves of a cell are the same.
    """
    if x & s and y & s:
        at_x, at_y = (apex_x + end_x) // 2, (apex_y + end_y) // 2
        return values[which_apex(at_x, at_y, x, y), at_y, at_x]
    if s == 1:
        # halves of a cell of the lattice
        at_x, at_y = min(apex_x, end_x), min(apex_y, end_y)
        return cells[0 if y == at_y else cells.shape[0] - 1, at_y, at_x]
    at_x, at_y = (apex_x + end_x) // 2, (apex_y + end_y) // 2
    return values[which_apex(at_x, at_y, x, y), at_y, at_x]


@compiled
def nest(heights: F32, cells: F32, wedgies: F32, top: int) -> None:
    """Fill in `wedgies` (2, rows, columns), from the smallest triangles to those of scale `top`.

    Half the thickness of a triangle's wedgie is that of the thicker one of its parts, and the height of the new vertex
    over the triangle (Duchaineau et al. 1997). `cells` (2, rows, columns): of the halves of cells; -1 where
    nothing is drawn. Scales count in cells here.
    """
    rows, columns = heights.shape
    s = 1
    while s <= top:
        for kind in range(2):
            for y in range(0, rows, s):
                odd = (y // s) & 1
                # edge diamonds first: square ones of this scale are made of them
                start = s if (kind == 1) or not odd else 0
                if kind == 1 and not odd:
                    continue
                for x in range(start, columns, 2 * s):
                    apexes = apexes_of(x, y)
                    for which in range(2):
                        apex_x, apex_y = apexes[2 * which], apexes[2 * which + 1]
                        if not (0 <= apex_x < columns and 0 <= apex_y < rows):
                            wedgies[which, y, x] = -1
                            continue
                        # ends of the longest side: a quarter turn from the apex
                        dx, dy = apex_x - x, apex_y - y
                        a = part_of(wedgies, cells, x, y, s, x - dy, y + dx, apex_x, apex_y)
                        b = part_of(wedgies, cells, x, y, s, x + dy, y - dx, apex_x, apex_y)
                        thicker = max(a, b)
                        if thicker >= 0:
                            middle = (np.float64(heights[y + dx, x - dy]) + np.float64(heights[y - dx, x + dy])) / 2
                            thicker += abs(np.float64(heights[y, x]) - middle)
                            # rounding up, so that they stay nested
                            thicker *= 1 + 1e-7
                        wedgies[which, y, x] = thicker
        s *= 2


@compiled
def look_ahead(cells: F32, errors: F32, top: int) -> None:
    """Put the greater one of its parts' errors in place of every triangle's."""
    _, rows, columns = errors.shape
    s = top
    while s >= 1:
        for kind in range(1, -1, -1):
            for y in range(0, rows, s):
                odd = (y // s) & 1
                start = s if (kind == 1) or not odd else 0
                if kind == 1 and not odd:
                    continue
                for x in range(start, columns, 2 * s):
                    apexes = apexes_of(x, y)
                    for which in range(2):
                        apex_x, apex_y = apexes[2 * which], apexes[2 * which + 1]
                        if not (0 <= apex_x < columns and 0 <= apex_y < rows):
                            continue
                        dx, dy = apex_x - x, apex_y - y
                        a = part_of(errors, cells, x, y, s, x - dy, y + dx, apex_x, apex_y)
                        b = part_of(errors, cells, x, y, s, x + dy, y - dx, apex_x, apex_y)
                        errors[which, y, x] = max(a, b)
        s //= 2


# -- priorities --------------------------------------------------------------------------------------------------------


@compiled
def height_of(ground: Ground, x: int, y: int) -> float:
    """Metres at a point of the lattice; bilinear between heights."""
    bits = ground.bits
    mask = (1 << bits) - 1
    i, j = x >> bits, y >> bits
    if (x | y) & mask == 0:
        return np.float64(ground.heights[j, i])
    u, v = (x & mask) / (1 << bits), (y & mask) / (1 << bits)
    i1, j1 = min(i + 1, ground.heights.shape[1] - 1), min(j + 1, ground.heights.shape[0] - 1)
    above = ground.heights[j, i] * (1 - u) + ground.heights[j, i1] * u
    below = ground.heights[j1, i] * (1 - u) + ground.heights[j1, i1] * u
    return above * (1 - v) + below * v


@compiled
def wedgie_of(ground: Ground, x: int, y: int, which: int) -> tuple[float, float]:
    """Metres that one of a diamond's triangles may be off where it is drawn, and half its wedgie's thickness."""
    bits, s = ground.bits, scale_of(x, y)
    if s >= 1 << bits:
        i, j = x >> bits, y >> bits
        return np.float64(ground.error[which, j, i]), np.float64(ground.thickness[which, j, i])
    square = x & s and y & s
    # the apex of an edge diamond lies in a cell, not on its outline
    apexes = apexes_of(x, y)
    i, j = (x >> bits, y >> bits) if square else (apexes[2 * which] >> bits, apexes[2 * which + 1] >> bits)
    depth, wide = 0 if square else 1, s
    while wide < 1 << (bits - 1):
        wide *= 2
        depth += 2
    last = ground.within.shape[0] - 1
    error = within_of(ground, i, j, depth + ground.ahead)
    if last == 0:
        return error, within_of(ground, i, j, depth)
    # the corners' heights are not known, only those of the cell's corners: see `base_of`
    share = s / (1 << (bits - 1))
    share *= share if square else share / 4
    twist = abs(
        np.float64(ground.heights[j, i]) + ground.heights[j + 1, i + 1]
        - ground.heights[j, i + 1] - ground.heights[j + 1, i]
    )  # fmt: skip
    return error, ground.within[0, j, i] + twist * (0.25 + share / 3)


@compiled
def within_of(ground: Ground, i: int, j: int, depth: int) -> float:
    """Half the thickness of the thickest wedgie in a cell, so many splits below its halves."""
    last = ground.within.shape[0] - 1
    if depth <= last:
        return np.float64(ground.within[depth, j, i])
    # in a bilinear cell every other split quarters it, the first one included
    return ground.within[last, j, i] * 0.25 ** ((depth - last + 1) // 2)


@compiled
def base_of(twist: float, thickness: float) -> float:
    """Half the thickness of a half of a cell of several samples, so that it holds those of all its parts.

    Their corners are taken to be on the cell's bilinear surface, which is a quarter of its twist from its diagonal; all
    their new vertices together rise by a third.
    """
    return thickness + twist * (1 / 4 + 1 / 3)


@compiled
def collect(heights: F32, cells: F32, nested: F32, level: int, halves: F32, within: F32) -> None:
    """Sum up the wedgies of all triangles of a tile by cells of 2^level samples, whose corners are all that is kept.

    `halves` (2, rows, columns): of the halves of cells. `within` (2 level + 1, rows, columns): the thickest of their
    parts by depth. Both are -1 at first.
    """
    rows, columns = heights.shape
    one = 1 << level
    for y in range(rows):
        for x in range(columns):
            if y < rows - 1 and x < columns - 1:
                found = cells[0, y, x]
                within[2 * level, y >> level, x >> level] = max(within[2 * level, y >> level, x >> level], found)
            s = scale_of(x, y)
            if (x | y) == 0 or s >= one:
                continue
            apexes = apexes_of(x, y)
            square = x & s and y & s
            depth, wide = 0 if square else 1, s
            while 2 * wide < one:
                wide *= 2
                depth += 2
            for which in range(2):
                at_x, at_y = (x, y) if square else (apexes[2 * which], apexes[2 * which + 1])
                if 0 <= at_x < columns and 0 <= at_y < rows:
                    found, i, j = nested[which, y, x], at_x >> level, at_y >> level
                    within[depth, j, i] = max(within[depth, j, i], found)
                    if depth == 0 and found >= 0:
                        twist = abs(
                            heights[j * one, i * one] + heights[j * one + one, i * one + one]
                            - heights[j * one, i * one + one] - heights[j * one + one, i * one]
                        )  # fmt: skip
                        halves[which, j, i] = base_of(twist, found)


@compiled
def flat_metres(eye: Eye, x: float, y: float) -> tuple[float, float]:
    """Metres east and north of the camera that looks."""
    across, down = x - eye.origin[0], y - eye.origin[1]
    return eye.metres[0, 0] * across + eye.metres[0, 1] * down, eye.metres[1, 0] * across + eye.metres[1, 1] * down


@compiled
def distance(east: float, north: float, other_east: float, other_north: float) -> float:
    """Metres between two points of the map."""
    return math.sqrt((east - other_east) * (east - other_east) + (north - other_north) * (north - other_north))


@compiled
def lifted(eye: Eye, east: float, north: float, height: float) -> float:
    """Metres above the camera that looks."""
    return height * eye.exaggeration - eye.height - eye.curvature * (east * east + north * north)


@compiled
def in_camera(eye: Eye, axis: int, east: float, north: float, up: float) -> float:
    """Metres to the right, up or forward of the LOD camera."""
    east, north, up = east - eye.position[0], north - eye.position[1], up - eye.position[2]
    return eye.basis[axis, 0] * east + eye.basis[axis, 1] * north + eye.basis[axis, 2] * up


@compiled
def spread_of(eye: Eye, east: float, north: float, up: float) -> tuple[float, float]:
    """Square of how fast a point moves across the picture as it is lifted, times its depth squared; and its depth."""
    a, b, c = eye.basis[0, 2], eye.basis[1, 2], eye.basis[2, 2]
    p, q, r = (
        in_camera(eye, 0, east, north, up), in_camera(eye, 1, east, north, up), in_camera(eye, 2, east, north, up),
    )  # fmt: skip
    across, along = a * r - c * p, b * r - c * q
    return across * across + along * along, r


@compiled
def above_plane(eye: Eye, plane: int, east: float, north: float, up: float) -> float:
    """Metres that a point lies inside a side of the frustum."""
    planes = eye.planes
    return planes[plane, 0] * east + planes[plane, 1] * north + planes[plane, 2] * up + planes[plane, 3]


@compiled
def learn(mesh: Mesh, ground: Ground, diamond: int) -> None:
    """Keep what a diamond's priority depends on beside the camera: its rank, heights of corners, wedgie."""
    x, y = mesh.place[diamond, 0], mesh.place[diamond, 1]
    mesh.rank[diamond] = rank_of(x, y)
    apexes = apexes_of(x, y)
    dx, dy = apexes[0] - x, apexes[1] - y
    known = mesh.known[diamond]
    known[0], known[1] = height_of(ground, x - dy, y + dx), height_of(ground, x + dy, y - dx)
    for which in range(2):
        known[4 + which] = -1
        if is_inside(ground, apexes[2 * which], apexes[2 * which + 1]):
            known[2 + which] = height_of(ground, apexes[2 * which], apexes[2 * which + 1])
            if scale_of(x, y) >= 2:
                known[4 + which], known[6 + which] = wedgie_of(ground, x, y, which)


@compiled
def priority_of(mesh: Mesh, ground: Ground, eye: Eye, diamond: int) -> float:
    """The greater distortion of its triangles, split or not: pixels that points may be from where they belong.

    Half the greatest projected thickness of a wedgie (Duchaineau et al. 1997); 0 outside the frustum and
    where nothing is left to split. The bounds never grow from a triangle to its parts.
    """
    known = mesh.known[diamond]
    most = max(known[4], known[5])
    if most < 0 or (most == 0 and eye.curvature == 0):
        return 0.0
    x, y = mesh.place[diamond, 0], mesh.place[diamond, 1]
    apexes = apexes_of(x, y)
    # a quarter turn from an apex: ends of the side that both triangles share
    dx, dy = apexes[0] - x, apexes[1] - y
    east0, north0 = flat_metres(eye, x - dy, y + dx)
    east1, north1 = flat_metres(eye, x + dy, y - dx)
    up0, up1 = lifted(eye, east0, north0, known[0]), lifted(eye, east1, north1, known[1])
    length = distance(east0, north0, east1, north1)
    spread0, depth0 = spread_of(eye, east0, north0, up0)
    spread1, depth1 = spread_of(eye, east1, north1, up1)
    result = 0.0
    for which in range(2):
        if known[4 + which] < 0:
            continue
        east, north = flat_metres(eye, apexes[2 * which], apexes[2 * which + 1])
        up = lifted(eye, east, north, known[2 + which])
        sag = 0.0
        if eye.curvature > 0:
            # triangles are sheared where columns and rows are: no more than the circle around their longest side
            longest = max(length, distance(east, north, east0, north0), distance(east, north, east1, north1))
            sag = eye.curvature * longest * longest / 3
        thickness = known[6 + which] * eye.exaggeration + 2 * sag
        seen = True
        for plane in range(5):
            most = max(
                above_plane(eye, plane, east0, north0, up0), above_plane(eye, plane, east1, north1, up1),
                above_plane(eye, plane, east, north, up),
            )  # fmt: skip
            # the slack shrinks from level to level: what is rounded must not put a part inside and the whole outside
            if most + abs(eye.planes[plane, 2]) * thickness + 1e-3 * length < 0:
                seen = False
                break
        if not seen:
            continue
        error = known[4 + which] * eye.exaggeration + sag * 0.5**ground.ahead
        if eye.orthographic:
            found = error * math.hypot(eye.basis[0, 2], eye.basis[1, 2]) * eye.pixels
        else:
            spread, depth = spread_of(eye, east, north, up)
            nearest = min(depth0, depth1, depth) - abs(eye.basis[2, 2]) * thickness
            most = math.sqrt(max(spread0, spread1, spread))
            found = min(FIRST, error * most / (nearest * nearest) * eye.pixels) if nearest > 0 else FIRST
        result = max(result, found)
    # parents keep before their parts whatever is rounded
    level = mesh.rank[diamond] >> 54
    return result * (1 + 1e-9 * (64 - level))


# -- heaps -------------------------------------------------------------------------------------------------------------


@compiled
def before(a: Any, b: Any) -> bool:
    """Order of entries."""
    return a["key"] < b["key"] or (a["key"] == b["key"] and a["rank"] < b["rank"])


@compiled
def sift_up(heap: Array, at: int) -> None:
    """Move an entry towards the top."""
    while at > 0:
        above = (at - 1) // 2
        if not before(heap[at], heap[above]):
            break
        swap(heap, at, above)
        at = above


@compiled
def sift_down(heap: Array, at: int, count: int) -> None:
    """Move an entry away from the top."""
    while True:
        least = at
        for below in range(2 * at + 1, min(2 * at + 3, count)):
            if before(heap[below], heap[least]):
                least = below
        if least == at:
            break
        swap(heap, at, least)
        at = least


@compiled
def swap(heap: Array, a: int, b: int) -> None:
    """Exchange two entries."""
    key, rank, diamond = heap[a]["key"], heap[a]["rank"], heap[a]["diamond"]
    heap[a]["key"], heap[a]["rank"], heap[a]["diamond"] = heap[b]["key"], heap[b]["rank"], heap[b]["diamond"]
    heap[b]["key"], heap[b]["rank"], heap[b]["diamond"] = key, rank, diamond


@compiled
def append(mesh: Mesh, heap: Array, which: int, diamond: int) -> None:
    """Put a diamond at the end of a heap. The most important split is first, and the least important merge."""
    sign = -1 if which == SPLITS else 1
    at = mesh.counts[which]
    heap[at]["key"] = sign * mesh.priority[diamond]
    heap[at]["rank"] = -sign * mesh.rank[diamond]
    heap[at]["diamond"] = diamond
    mesh.counts[which] = at + 1


@compiled
def push(mesh: Mesh, heap: Array, which: int, diamond: int) -> None:
    """Add a diamond to a heap, if its turn can come."""
    if is_due(mesh, which, diamond):
        append(mesh, heap, which, diamond)
        sift_up(heap, mesh.counts[which] - 1)


@compiled
def is_due(mesh: Mesh, which: int, diamond: int) -> bool:
    """Whether a diamond is to be split, or merged, if only its threshold decides; all are where triangles are short."""
    if mesh.counts[WHOLE] != 0:
        return True
    above = mesh.priority[diamond] > mesh.tau[0]
    return above if which == SPLITS else not above


@compiled
def drop(mesh: Mesh, heap: Array, which: int) -> None:
    """Remove a heap's first entry."""
    mesh.counts[which] -= 1
    swap(heap, 0, mesh.counts[which])
    sift_down(heap, 0, mesh.counts[which])


@compiled
def first_of(mesh: Mesh, heap: Array, which: int) -> int:
    """The first diamond of a heap that is still what it was; -1 where there is none."""
    sign = -1 if which == SPLITS else 1
    while mesh.counts[which] > 0:
        diamond = heap[0]["diamond"]
        rank = -sign * mesh.rank[diamond]
        state = mesh.state[diamond]
        valid = state == CANDIDATE if which == SPLITS else (state == SPLIT and mesh.parts[diamond] == 0)
        if valid and heap[0]["rank"] == rank:
            return diamond
        drop(mesh, heap, which)
    return -1


# -- the mesh ----------------------------------------------------------------------------------------------------------


@compiled
def hashed(x: int, y: int, mask: int) -> int:
    """Place in the table to start at."""
    h = (x * 73856093) ^ (y * 19349663)
    return (h ^ (h >> 15)) & mask


@compiled
def find(mesh: Mesh, x: int, y: int) -> int:
    """The diamond at a place, or -1."""
    mask = mesh.table.size - 1
    at = hashed(x, y, mask)
    while mesh.table[at] >= 0:
        diamond = mesh.table[at]
        if mesh.place[diamond, 0] == x and mesh.place[diamond, 1] == y:
            return diamond
        at = (at + 1) & mask
    return -1


@compiled
def enter(mesh: Mesh, diamond: int) -> None:
    """Put a diamond into the table."""
    mask = mesh.table.size - 1
    at = hashed(mesh.place[diamond, 0], mesh.place[diamond, 1], mask)
    while mesh.table[at] >= 0:
        at = (at + 1) & mask
    mesh.table[at] = diamond


@compiled
def leave(mesh: Mesh, diamond: int) -> None:
    """Take a diamond out of the table; what was put behind it moves up."""
    mask = mesh.table.size - 1
    at = hashed(mesh.place[diamond, 0], mesh.place[diamond, 1], mask)
    while mesh.table[at] != diamond:
        at = (at + 1) & mask
    hole = at
    while True:
        at = (at + 1) & mask
        other = mesh.table[at]
        if other < 0:
            break
        home = hashed(mesh.place[other, 0], mesh.place[other, 1], mask)
        if ((at - home) & mask) >= ((at - hole) & mask):
            mesh.table[hole] = other
            hole = at
    mesh.table[hole] = -1


@compiled
def created(mesh: Mesh, ground: Ground, eye: Eye, x: int, y: int) -> int:
    """The diamond at a place; a new candidate, in its queue, where there was none."""
    diamond = find(mesh, x, y)
    if diamond >= 0:
        return diamond
    if mesh.counts[FREED] > 0:
        mesh.counts[FREED] -= 1
        diamond = mesh.free[mesh.counts[FREED]]
    else:
        diamond = mesh.counts[POOL]
        mesh.counts[POOL] += 1
    mesh.place[diamond, 0], mesh.place[diamond, 1] = x, y
    mesh.state[diamond] = CANDIDATE
    mesh.parts[diamond] = 0
    mesh.slots[diamond, 0] = mesh.slots[diamond, 1] = -1
    learn(mesh, ground, diamond)
    mesh.priority[diamond] = priority_of(mesh, ground, eye, diamond)
    enter(mesh, diamond)
    push(mesh, mesh.splits, SPLITS, diamond)
    return diamond


@compiled
def add_triangle(mesh: Mesh, diamond: int, which: int) -> None:
    """Add one of a diamond's triangles to the list."""
    x, y = mesh.place[diamond, 0], mesh.place[diamond, 1]
    apexes = apexes_of(x, y)
    slot = mesh.counts[TRIANGLES]
    mesh.counts[TRIANGLES] += 1
    mesh.triangles[slot, 0], mesh.triangles[slot, 1] = x, y
    mesh.triangles[slot, 2], mesh.triangles[slot, 3] = apexes[2 * which], apexes[2 * which + 1]
    mesh.owner[slot] = 2 * diamond + which
    mesh.changed[slot] = True
    mesh.slots[diamond, which] = slot


@compiled
def remove_triangle(mesh: Mesh, diamond: int, which: int) -> None:
    """Take a triangle out of the list; the last one takes its place."""
    slot = mesh.slots[diamond, which]
    mesh.slots[diamond, which] = -1
    mesh.counts[TRIANGLES] -= 1
    last = mesh.counts[TRIANGLES]
    if slot != last:
        mesh.triangles[slot] = mesh.triangles[last]
        owner = mesh.owner[last]
        mesh.owner[slot] = owner
        mesh.slots[owner >> 1, owner & 1] = slot
        mesh.changed[slot] = True


@compiled
def parent_state(mesh: Mesh, ground: Ground, x: int, y: int) -> tuple[int, int]:
    """State and number of the diamond whose middle is an apex; corners of root squares are vertices from the start."""
    if x % ground.side == 0 and y % ground.side == 0:
        return SPLIT, -1
    diamond = find(mesh, x, y)
    return (mesh.state[diamond], diamond) if diamond >= 0 else (ABSENT, -1)


@compiled
def split(mesh: Mesh, ground: Ground, eye: Eye, diamond: int) -> None:
    """Make a diamond's middle a vertex; all that it depends on is split."""
    x, y = mesh.place[diamond, 0], mesh.place[diamond, 1]
    apexes = apexes_of(x, y)
    for which in range(2):
        if mesh.slots[diamond, which] >= 0:
            remove_triangle(mesh, diamond, which)
            _, parent = parent_state(mesh, ground, apexes[2 * which], apexes[2 * which + 1])
            if parent >= 0:
                mesh.parts[parent] += 1
    mesh.state[diamond] = SPLIT
    for number in range(4):
        part_x, part_y = dependent(x, y, number)
        if is_inside(ground, part_x, part_y):
            part = created(mesh, ground, eye, part_x, part_y)
            add_triangle(mesh, part, which_apex(part_x, part_y, x, y))
    push(mesh, mesh.merges, MERGES, diamond)


@compiled
def merge(mesh: Mesh, ground: Ground, eye: Eye, diamond: int) -> None:
    """Undo a split on which nothing depends."""
    x, y = mesh.place[diamond, 0], mesh.place[diamond, 1]
    for number in range(4):
        part_x, part_y = dependent(x, y, number)
        if is_inside(ground, part_x, part_y):
            part = find(mesh, part_x, part_y)
            remove_triangle(mesh, part, which_apex(part_x, part_y, x, y))
            if mesh.slots[part, 0] < 0 and mesh.slots[part, 1] < 0:
                leave(mesh, part)
                mesh.state[part] = ABSENT
                mesh.free[mesh.counts[FREED]] = part
                mesh.counts[FREED] += 1
    mesh.state[diamond] = CANDIDATE
    apexes = apexes_of(x, y)
    for which in range(2):
        if is_inside(ground, apexes[2 * which], apexes[2 * which + 1]):
            add_triangle(mesh, diamond, which)
            _, parent = parent_state(mesh, ground, apexes[2 * which], apexes[2 * which + 1])
            if parent >= 0:
                mesh.parts[parent] -= 1
                if mesh.parts[parent] == 0:
                    mesh.priority[parent] = priority_of(mesh, ground, eye, parent)
                    push(mesh, mesh.merges, MERGES, parent)
    push(mesh, mesh.splits, SPLITS, diamond)


@compiled
def chain_of(mesh: Mesh, ground: Ground, diamond: int, chain: NDArray[np.int64]) -> tuple[int, int]:
    """The diamonds that have to be split, the last one first, to split one; how many, and triangles they add.

    At most one of the two that a candidate depends on is not split, and that one is a candidate.
    """
    count, added = 0, 0
    while diamond >= 0:
        chain[count] = diamond
        count += 1
        apexes = apexes_of(mesh.place[diamond, 0], mesh.place[diamond, 1])
        following = -1
        for which in range(2):
            apex_x, apex_y = apexes[2 * which], apexes[2 * which + 1]
            if is_inside(ground, apex_x, apex_y):
                added += 1
                state, parent = parent_state(mesh, ground, apex_x, apex_y)
                if state != SPLIT:
                    following = parent
        diamond = following
    return count, added


@compiled
def root(mesh: Mesh, ground: Ground, eye: Eye) -> None:
    """Start with two triangles a root square."""
    for y in range(ground.side // 2, ground.height, ground.side):
        for x in range(ground.side // 2, ground.width, ground.side):
            diamond = created(mesh, ground, eye, x, y)
            add_triangle(mesh, diamond, 0)
            add_triangle(mesh, diamond, 1)


@compiled
def aim(mesh: Mesh, ground: Ground, eye: Eye, tau: float, whole: bool) -> None:
    """Both queues anew, for a camera and a threshold; `whole`: with all diamonds, not only those that are due."""
    mesh.counts[SPLITS] = mesh.counts[MERGES] = 0
    mesh.tau[0], mesh.counts[WHOLE] = tau, whole
    for diamond in range(mesh.counts[POOL]):
        state = mesh.state[diamond]
        if state == CANDIDATE or (state == SPLIT and mesh.parts[diamond] == 0):
            mesh.priority[diamond] = priority_of(mesh, ground, eye, diamond)
            if state == CANDIDATE and is_due(mesh, SPLITS, diamond):
                append(mesh, mesh.splits, SPLITS, diamond)
            elif state == SPLIT and is_due(mesh, MERGES, diamond):
                append(mesh, mesh.merges, MERGES, diamond)
    for at in range(mesh.counts[SPLITS] // 2, -1, -1):
        sift_down(mesh.splits, at, mesh.counts[SPLITS])
    for at in range(mesh.counts[MERGES] // 2, -1, -1):
        sift_down(mesh.merges, at, mesh.counts[MERGES])


@compiled
def refine(mesh: Mesh, ground: Ground, eye: Eye, most: int, operations: int) -> int:
    """Split and merge until the queues have crossed (Duchaineau et al. 1997).

    What is above the threshold is split, and all else merged; where `most` triangles are too few for that, the least
    important ones make room for more important ones. Equal ones go by rank: the mesh in the end does not depend on that
    at the start.
    """
    chain = np.empty(256, np.int64)
    tau = mesh.tau[0]
    for _ in range(operations):
        used = mesh.counts[POOL] - mesh.counts[FREED]
        full = used + MARGIN > mesh.place.shape[0] or mesh.counts[TRIANGLES] + MARGIN > mesh.triangles.shape[0]
        queue = max(mesh.counts[SPLITS], mesh.counts[MERGES])
        if full or queue + MARGIN > mesh.splits.shape[0]:
            return CROWDED
        top, bottom = first_of(mesh, mesh.splits, SPLITS), first_of(mesh, mesh.merges, MERGES)
        triangles = mesh.counts[TRIANGLES]
        if triangles > most and mesh.counts[WHOLE] == 0:
            return SHORT
        if bottom >= 0 and (triangles > most or mesh.priority[bottom] <= tau):
            drop(mesh, mesh.merges, MERGES)
            merge(mesh, ground, eye, bottom)
            continue
        if top < 0 or mesh.priority[top] <= tau:
            return DONE
        length, added = chain_of(mesh, ground, top, chain)
        if triangles + added <= most:
            for at in range(length - 1, -1, -1):
                split(mesh, ground, eye, chain[at])
            continue
        if mesh.counts[WHOLE] == 0:
            return SHORT
        if bottom < 0:
            return DONE
        one, other = mesh.priority[top], mesh.priority[bottom]
        if one > other or (one == other and mesh.splits[0]["rank"] < -mesh.merges[0]["rank"]):
            drop(mesh, mesh.merges, MERGES)
            merge(mesh, ground, eye, bottom)
            continue
        return DONE
    return STOPPED


@compiled
def shift_at(mesh: Mesh, ground: Ground, x: int, y: int) -> float:
    """Metres that a vertex of the mesh is drawn over its place."""
    _, diamond = parent_state(mesh, ground, x, y)
    return mesh.shift[diamond] if diamond >= 0 else 0.0


@compiled
def morph(mesh: Mesh, ground: Ground, eye: Eye, length: float) -> None:
    """Put vertices between their place and the side that they split, by how far they are above the threshold.

    A vertex is in its place from (1 + `length`) times the threshold on. Where triangles are short the threshold is the
    priority of what had to be left out.
    """
    low = mesh.tau[0]
    top = first_of(mesh, mesh.splits, SPLITS)
    if top >= 0:
        low = max(low, mesh.priority[top])
    used = mesh.counts[POOL]
    # the coarse ones first: the others' sides end there
    starts = np.zeros(66, np.int64)
    for diamond in range(used):
        if mesh.state[diamond] == SPLIT:
            starts[(mesh.rank[diamond] >> 54) + 1] += 1
    starts = np.cumsum(starts)
    order = np.empty(starts[-1], np.int64)
    for diamond in range(used):
        if mesh.state[diamond] == SPLIT:
            level = mesh.rank[diamond] >> 54
            order[starts[level]] = diamond
            starts[level] += 1
    for diamond in order:
        mesh.shift[diamond] = 0.0
        way = (priority_of(mesh, ground, eye, diamond) - low) / (length * low)
        if way < 1:
            x, y = mesh.place[diamond, 0], mesh.place[diamond, 1]
            apexes = apexes_of(x, y)
            dx, dy = apexes[0] - x, apexes[1] - y
            known = mesh.known[diamond]
            one = known[0] + shift_at(mesh, ground, x - dy, y + dx)
            other = known[1] + shift_at(mesh, ground, x + dy, y - dx)
            mesh.shift[diamond] = (1 - max(way, 0.0)) * ((one + other) / 2 - height_of(ground, x, y))
    for slot in range(mesh.counts[TRIANGLES]):
        x, y, apex_x, apex_y = (
            mesh.triangles[slot, 0], mesh.triangles[slot, 1], mesh.triangles[slot, 2], mesh.triangles[slot, 3],
        )  # fmt: skip
        dx, dy = apex_x - x, apex_y - y
        for corner in range(3):
            turn = 0 if corner == 0 else (1 if corner == 1 else -1)
            at_x, at_y = (apex_x, apex_y) if corner == 0 else (x - turn * dy, y + turn * dx)
            shift = np.float32(shift_at(mesh, ground, at_x, at_y))
            if mesh.shifts[slot, corner] != shift:
                mesh.shifts[slot, corner] = shift
                mesh.changed[slot] = True


@compiled
def rehash(mesh: Mesh) -> None:
    """Fill an empty table."""
    for diamond in range(mesh.counts[POOL]):
        if mesh.state[diamond] != ABSENT:
            enter(mesh, diamond)
