"""Compiled twins of quadtree.py. Importing this takes numba, and a second: do it where it is needed.

They are in one file, since numba compiles a kernel anew when its own file has changed, not that of what it calls. What
depends on a frame comes as tuples of arrays and numbers; places are columns and rows of samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.lod.quadtree import Table
from orogen.streaming.clipmap_view import ClipmapView, DrawnTables
from orogen.streaming.layer import BLOCK_MIPS
from orogen.streaming.tables import NO_SLOT
from orogen.streaming.tiles import BLOCK

try:
    import numba
except ImportError as error:
    raise SettingsError('expected the package numba; run: pip install "orogen[compiled]"') from error

F = TypeVar("F", bound=Callable[..., Any])
F64 = NDArray[np.float64]
Ints = NDArray[np.int64]
Hits = tuple[Ints, Ints, Ints]
"""Levels, columns and rows of patches."""

REACH, ERROR, EDGES, CELLS = 0, 1, 2, 3
"""Why patches are divided: see `Rule`."""
_MIX = 0x1E3779B97F4A7C15
_BLOCK_BITS = BLOCK.bit_length() - 1
"""Texels along a side of the smallest blocks of resident nodes whose ranges are kept are a power of two: this one."""


class Tree(NamedTuple):
    """The patches of a grid: see `quadtree.PatchTree`."""

    side: int
    right: int
    """Column of the last sample."""
    bottom: int
    """Row of the last sample."""
    top: int
    """The last level."""


class Eye(NamedTuple):
    """The LOD camera of a frame. Arrays are few: every function that takes one pays for it."""

    planes: F64
    """(5, 4), positive inside the frustum."""
    xx: float
    """From samples to metres: east by columns, then by rows."""
    xy: float
    yx: float
    """The same to the north."""
    yy: float
    column: float
    """Of the camera that looks, in samples."""
    row: float
    lod_column: float
    """Of the LOD eye, in samples."""
    lod_row: float
    height: float
    """Of the LOD eye: metres, exaggerated."""
    z: float
    """Of the camera that looks."""
    exaggeration: float
    curvature: float
    """Drop of the ground over the squared distance."""


class Ground(NamedTuple):
    """Where ranges of heights are looked up."""

    table: Table
    """Lowest and highest (m) of patches; empty where it is that of what may be drawn."""
    drawn: DrawnTables


class Cells(NamedTuple):
    """Bilinear heights of square cells: see `cdlod.ground.Ground`."""

    heights: NDArray[np.float32]
    bits: int
    """A cell is 2^bits samples wide."""
    table: Table
    """Lowest and highest (m) of patches of levels from `start` on."""
    start: int


class Rule(NamedTuple):
    """Which patches are divided.

    REACH: those whose box is nearer than `reach`. ERROR: those nearer than their error times `scale`, where `reach` is
    not 0. EDGES: those with an edge along a row or column nearer than these. CELLS: those whose box over `cells` is
    nearer than `reach`.
    """

    kind: int
    reach: F64
    """(levels, 2) metres, for edges along rows and columns."""
    scale: float
    sag: float
    """Metres, exaggerated, that are added to errors: at level 0, four times as much at the next."""
    error: Table
    """Metres that patches may be off."""
    cells: Cells


_NO_TABLE = Table.of([])
_NO_DRAWN = DrawnTables(
    np.zeros((0, 0), np.uint32), np.zeros((0, 0, 0, 2), np.float32), np.zeros((0, 2), np.int64),
    (np.zeros((0, 0, 0, 2), np.float32),) * BLOCK_MIPS, 0, (0.0, 0.0), (0.0, 0.0), 0.0, 0.0,
)  # fmt: skip
_NO_CELLS = Cells(np.zeros((0, 0), np.float32), 0, _NO_TABLE, 0)


def ground(heights: ClipmapView | Table) -> Ground:
    """Where a `PatchFrame` looks up ranges of heights."""
    if isinstance(heights, Table):
        return Ground(heights, _NO_DRAWN)
    return Ground(_NO_TABLE, heights.drawn_tables())


def rule(
    kind: int, reach: F64, scale: float = 0.0, sag: float = 0.0, error: Table = _NO_TABLE, cells: Cells = _NO_CELLS
) -> Rule:
    """A rule, with nothing where its kind needs nothing. `reach`: (levels,) where it is the same for all edges."""
    return Rule(kind, np.stack([reach, reach], 1) if reach.ndim == 1 else reach, scale, sag, error, cells)


def compiled(function: F) -> F:
    """Compile at the first call; kept on disk."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


_WITHIN = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}


def inner(function: F) -> F:
    """Compile for other compiled functions alone, into them, and without counting references: nothing is allocated.

    To pass the arrays on and to count who holds them takes several times as long as the work itself.
    """
    return cast(
        F, cast(Any, numba.njit)(cache=True, nogil=True, error_model="numpy", forceinline=True, **_WITHIN)(function)
    )


def called(function: F) -> F:
    """The same, but called from there: what is large and compiled into several others would take long to compile."""
    return cast(F, cast(Any, numba.njit)(cache=True, nogil=True, error_model="numpy", **_WITHIN)(function))


# -- heights -----------------------------------------------------------------------------------------------------------


@inner
def place_in(table: Table, level: int, x: int, y: int) -> int:
    """Where a table has the values of a patch."""
    shift = table.layout[level, 2]
    return table.layout[level, 0] + (y >> shift) * table.layout[level, 1] + (x >> shift)


@inner
def pad_of(drawn: DrawnTables, left: int, above: int, right: int, below: int) -> int:
    """Samples around a rectangle that the texels of the level used there, or of the next, are means of."""
    if drawn.reach >= 1e30:
        return 2
    x = max(abs(left - drawn.eye[0]), abs(right - drawn.eye[0])) * drawn.spacing[0]
    y = max(abs(above - drawn.eye[1]), abs(below - drawn.eye[1])) * drawn.spacing[1]
    # the logarithm in whole numbers
    share, level = 2 * math.sqrt((x + y) ** 2 + drawn.above**2) / drawn.reach, 1
    while share >= 2 and level < drawn.nodes.shape[0] - 1:
        share, level = share / 2, level + 1
    return 2 << min(level, drawn.nodes.shape[0] - 1)


@inner
def block_range(
    drawn: DrawnTables, tree: Tree, left: int, above: int, right: int, below: int
) -> tuple[bool, float, float]:
    """Whether blocks of resident nodes hold a rectangle of samples; lowest and highest height of these."""
    pad, bits, side = pad_of(drawn, left, above, right, below), drawn.bits, drawn.nodes.shape[1]
    left, above = max(left - pad, 0), max(above - pad, 0)
    right, below = min(right + pad, tree.right), min(below + pad, tree.bottom)
    wide = max(right - left, below - above) + 1
    mip = 0
    while 1 << _BLOCK_BITS + mip < wide:
        mip += 1
    x, y = drawn.origins[0, 0], drawn.origins[0, 1]
    if mip >= len(drawn.blocks) or left >> bits < x or above >> bits < y:
        return False, 0.0, 0.0
    if right >> bits >= x + side or below >> bits >= y + side:
        return False, 0.0, 0.0
    low, high = math.inf, -math.inf
    table = drawn.blocks[mip]
    for k in range(4):
        column, row = right if k & 1 else left, below if k & 2 else above
        entry = int(drawn.entries[(row >> bits) & (side - 1), (column >> bits) & (side - 1)])
        slot, level = entry & 0xFFFF, entry >> 16
        if slot == NO_SLOT:
            return False, 0.0, 0.0
        inner = (1 << bits) - 1
        row, column = (row >> level & inner) >> _BLOCK_BITS + mip, (column >> level & inner) >> _BLOCK_BITS + mip
        low, high = min(low, float(table[slot, row, column, 0])), max(high, float(table[slot, row, column, 1]))
    return True, low, high


@inner
def node_range(drawn: DrawnTables, left: int, above: int, right: int, below: int) -> tuple[float, float]:
    """Lowest and highest height that may be drawn in a rectangle of samples, from nodes as wide as it."""
    wide, last, side = max(right - left, below - above, 1), drawn.nodes.shape[0] - 1, drawn.nodes.shape[1]
    level = 0
    while level < last and (1 << drawn.bits + level) < wide:
        level += 1
    while True:
        shift = drawn.bits + level
        x0, y0, x1, y1 = left >> shift, above >> shift, right >> shift, below >> shift
        x, y = drawn.origins[level, 0], drawn.origins[level, 1]
        if level == last or (x0 >= x and y0 >= y and x1 < x + side and y1 < y + side):
            break
        level += 1
    low, high = math.inf, -math.inf
    for k in range(4):
        column, row = min(x0 + (k & 1), x1) & (side - 1), min(y0 + (k >> 1), y1) & (side - 1)
        low = min(low, float(drawn.nodes[level, row, column, 0]))
        high = max(high, float(drawn.nodes[level, row, column, 1]))
    return low, high


@inner
def range_of(ground: Ground, tree: Tree, level: int, x: int, y: int) -> tuple[float, float]:
    """Lowest and highest height (metres of the data) in a patch."""
    values = ground.table.values
    if values.size:
        at = place_in(ground.table, level, x, y)
        return float(values[at, 0]), float(values[at, 1])
    width = tree.side << level
    left, above = min(x * width, tree.right), min(y * width, tree.bottom)
    right, below = min(x * width + width, tree.right), min(y * width + width, tree.bottom)
    met, low, high = block_range(ground.drawn, tree, left, above, right, below)
    return (low, high) if met else node_range(ground.drawn, left, above, right, below)


@inner
def cell_height(cells: Cells, column: float, row: float) -> float:
    """Bilinear height at a sample's place."""
    x, y = column / 2.0**cells.bits, row / 2.0**cells.bits
    j = min(max(math.floor(x), 0), cells.heights.shape[1] - 2)
    i = min(max(math.floor(y), 0), cells.heights.shape[0] - 2)
    u, v = x - j, y - i
    a, b = float(cells.heights[i, j]), float(cells.heights[i, j + 1])
    c, d = float(cells.heights[i + 1, j]), float(cells.heights[i + 1, j + 1])
    return (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v


@inner
def cell_range(cells: Cells, tree: Tree, level: int, x: int, y: int) -> tuple[float, float]:
    """Lowest and highest height of cells in a patch."""
    if level >= cells.start:
        at = place_in(cells.table, level - cells.start, x, y)
        return float(cells.table.values[at, 0]), float(cells.table.values[at, 1])
    width = tree.side << level
    left, above = min(x * width, tree.right), min(y * width, tree.bottom)
    right, below = min(x * width + width, tree.right), min(y * width + width, tree.bottom)
    a, b = cell_height(cells, left, above), cell_height(cells, right, above)
    c, d = cell_height(cells, left, below), cell_height(cells, right, below)
    return min(a, b, c, d), max(a, b, c, d)


# -- distances ---------------------------------------------------------------------------------------------------------


@inner
def nearest_square(eye: Eye, left: float, above: float, right: float, below: float) -> float:
    """Squared metres along the ground from the LOD eye to a rectangle of samples: see `streaming.boxes`."""
    left, above, right, below = (
        left - eye.lod_column, above - eye.lod_row, right - eye.lod_column, below - eye.lod_row,
    )  # fmt: skip
    if left <= 0 <= right and above <= 0 <= below:
        return 0.0
    xx, xy = eye.xx * eye.xx + eye.yx * eye.yx, eye.xx * eye.xy + eye.yx * eye.yy
    yy = eye.xy * eye.xy + eye.yy * eye.yy
    least = math.inf
    for x in (left, right):
        y = min(max(-x * xy / yy, above), below)
        least = min(least, xx * x**2 + 2 * xy * x * y + yy * y**2)
    for y in (above, below):
        x = min(max(-y * xy / xx, left), right)
        least = min(least, yy * y**2 + 2 * xy * y * x + xx * x**2)
    return least


@inner
def above_range(eye: Eye, square: float, low: float, high: float) -> float:
    """Metres from the LOD eye up or down to the nearest height of an interval; `square`: along the ground."""
    height = eye.height + eye.curvature * square
    return max(low * eye.exaggeration - height, height - high * eye.exaggeration, 0.0)


@inner
def square_of(eye: Eye, tree: Tree, level: int, x: int, y: int) -> float:
    """Squared metres along the ground from the LOD eye to a patch."""
    width = tree.side << level
    left, above = min(x * width, tree.right), min(y * width, tree.bottom)
    right, below = min(x * width + width, tree.right), min(y * width + width, tree.bottom)
    return nearest_square(eye, left, above, right, below)


@inner
def distance_of(eye: Eye, tree: Tree, ground: Ground, square: float, level: int, x: int, y: int) -> float:
    """Metres from the LOD eye to the nearest point of a patch's box; `square`: `square_of` it."""
    low, high = range_of(ground, tree, level, x, y)
    return math.sqrt(square + above_range(eye, square, low, high) ** 2)


@inner
def cell_distance(eye: Eye, tree: Tree, cells: Cells, level: int, x: int, y: int) -> float:
    """The same to the box over cells, as the vertices of CDLOD measure it: without curvature."""
    height = eye.height / eye.exaggeration
    low, high = cell_range(cells, tree, level, x, y)
    above = max(low - height, height - high, 0.0) * eye.exaggeration
    return math.sqrt(square_of(eye, tree, level, x, y) + above**2)


@inner
def edge_square(eye: Eye, tree: Tree, level: int, way: int, x: int, y: int) -> float:
    """Squared metres along the ground from the LOD eye to an edge: see `seamless_patches.edges`.

    `way`: 1 along a column, 0 along a row, from the first corner of patch (x, y), which need not be in the grid.
    """
    width = tree.side << level
    left, above = min(x * width, tree.right), min(y * width, tree.bottom)
    right, below = min((x + 1 - way) * width, tree.right), min((y + way) * width, tree.bottom)
    return nearest_square(eye, left, above, right, below)


@inner
def edge_distance(eye: Eye, tree: Tree, ground: Ground, square: float, level: int, way: int, x: int, y: int) -> float:
    """Metres from the LOD eye to the upright rectangle over an edge, by the heights on both sides."""
    width = tree.side << level
    last_x, last_y = (max(tree.right, 1) - 1) // width, (max(tree.bottom, 1) - 1) // width
    low, high = math.inf, -math.inf
    for k in range(2):
        px, py = min(max(x - k * way, 0), last_x), min(max(y - k * (1 - way), 0), last_y)
        lowest, highest = range_of(ground, tree, level, px, py)
        low, high = min(low, lowest), max(high, highest)
    return math.sqrt(square + above_range(eye, square, low, high) ** 2)


@inner
def is_box_seen(eye: Eye, left: float, above: float, right: float, below: float, low: float, high: float) -> bool:
    """Whether a box over samples may be in the picture: see `BoxFrame.box_visible`."""
    column, row = (left + right) / 2 - eye.column, (above + below) / 2 - eye.row
    east, north = column * eye.xx + row * eye.xy, column * eye.yx + row * eye.yy
    half_x, half_y = (right - left) / 2, (below - above) / 2
    a, b, c, d = eye.xx * half_x, eye.xy * half_y, eye.yx * half_x, eye.yy * half_y
    away = math.sqrt(east**2 + north**2)
    slack = 1e-6 * (away + abs(low) + abs(high)) + 1e-3
    farthest = away + math.sqrt(a**2 + c**2) + math.sqrt(b**2 + d**2)
    top = (high + slack) * eye.exaggeration - eye.z
    bottom = (low - slack) * eye.exaggeration - eye.z - eye.curvature * farthest**2
    for k in range(eye.planes.shape[0]):
        p, q, r, s = eye.planes[k, 0], eye.planes[k, 1], eye.planes[k, 2], eye.planes[k, 3]
        reach = abs(p * a + q * c) + abs(p * b + q * d) + max(r * bottom, r * top)
        if not east * p + north * q + reach + s >= 0:
            return False
    return True


@called
def is_seen(eye: Eye, tree: Tree, ground: Ground, level: int, x: int, y: int) -> bool:
    """Whether a patch may be in the picture."""
    width = tree.side << level
    left, above = min(x * width, tree.right), min(y * width, tree.bottom)
    right, below = min(x * width + width, tree.right), min(y * width + width, tree.bottom)
    low, high = range_of(ground, tree, level, x, y)
    return is_box_seen(eye, left, above, right, below, low, high)


# -- the walk ----------------------------------------------------------------------------------------------------------


@called
def is_divided(eye: Eye, tree: Tree, ground: Ground, rule: Rule, level: int, x: int, y: int) -> bool:
    """Whether a patch gives way to its children."""
    reach = rule.reach[level, 0]
    if level == 0 or reach <= 0 or reach == math.inf:
        return level > 0 and reach > 0
    if rule.kind == CELLS:
        return cell_distance(eye, tree, rule.cells, level, x, y) < reach
    if rule.kind == EDGES:
        for side in range(4):
            way = side & 1
            dx, dy = int(side == 1), int(side == 2)
            square, reach = edge_square(eye, tree, level, way, x + dx, y + dy), rule.reach[level, way]
            # heights are looked up only where they have a say
            if square < reach**2 and edge_distance(eye, tree, ground, square, level, way, x + dx, y + dy) < reach:
                return True
        return False
    if rule.kind == ERROR:
        error = float(rule.error.values[place_in(rule.error, level, x, y), 0])
        reach = (error * eye.exaggeration + rule.sag * 4.0**level) * rule.scale
    square = square_of(eye, tree, level, x, y)
    return square < reach**2 and distance_of(eye, tree, ground, square, level, x, y) < reach


@compiled
def grown(values: Ints) -> Ints:
    """A copy with twice the room."""
    result = np.empty(2 * values.size, np.int64)
    # slices that are assigned take long to compile
    for i in range(values.size):
        result[i] = values[i]
    return result


@inner
def key_of(level: int, x: int, y: int) -> int:
    """One number for each patch."""
    return level << 58 | y << 29 | x


@inner
def place_of(table: Ints, keys: Ints, key: int) -> int:
    """Where a hash table of indices of keys has a key, or would have it."""
    at = (key * _MIX >> 32) & (table.size - 1)
    while table[at] >= 0 and keys[table[at]] != key:
        at = (at + 1) & (table.size - 1)
    return at


@compiled
def hashed(keys: Ints, count: int, room: int) -> Ints:
    """A hash table of the first keys with room for so many."""
    size = 64
    while size < 2 * room:
        size *= 2
    table = np.empty(size, np.int64)
    for i in range(size):
        table[i] = -1
    for i in range(count):
        table[place_of(table, keys, keys[i])] = i
    return table


@compiled
def divided_keys(tree: Tree, level: Ints, x: Ints, y: Ints, cut: Ints) -> tuple[Ints, Ints]:
    """Keys of patches that have to be divided, and their hash table: those that are, and for their neighbours' sake.

    Where a patch is divided its neighbours must exist, so their parents are divided too. Patches come top down.
    """
    keys = np.empty(2 * x.size + 64, np.int64)
    table = hashed(keys, 0, keys.size)
    count = done = 0
    i = x.size - 1
    for t in range(1, tree.top + 1):
        while i >= 0 and level[i] <= t:
            if level[i] == t and cut[i]:
                key = key_of(t, x[i], y[i])
                at = place_of(table, keys, key)
                if table[at] < 0:
                    table[at] = count
                    keys[count] = key
                    count += 1
            i -= 1
        if t == tree.top:
            break
        width = tree.side << t
        rows, columns = max(-(-tree.bottom // width), 1), max(-(-tree.right // width), 1)
        end = count
        for n in range(done, end):
            px, py = keys[n] & 0x1FFFFFFF, keys[n] >> 29 & 0x1FFFFFFF
            if count + 5 + x.size > keys.size:
                keys = grown(keys)
                table = hashed(keys, count, keys.size)
            for dx, dy in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
                if 0 <= px + dx < columns and 0 <= py + dy < rows:
                    key = key_of(t + 1, px + dx >> 1, py + dy >> 1)
                    at = place_of(table, keys, key)
                    if table[at] < 0:
                        table[at] = count
                        keys[count] = key
                        count += 1
        done = end
    return keys[:count], table


@compiled
def leaves(eye: Eye, tree: Tree, ground: Ground, rule: Rule, restricted: bool) -> Hits:
    """The leaves in the frustum, the finest first: see `PatchFrame.select`."""
    level, x, y = np.empty(256, np.int64), np.empty(256, np.int64), np.empty(256, np.int64)
    cut = np.empty(256, np.int64)
    count = before = 0
    for t in range(tree.top, -1, -1):
        width = tree.side << t
        rows, columns = max(-(-tree.bottom // width), 1), max(-(-tree.right // width), 1)
        start = count
        # the top is the one child of a parent that is not there
        for parent in range(before, start) if t < tree.top else range(-1, 0):
            if parent >= 0 and not cut[parent]:
                continue
            if count + 4 > x.size:
                level, x, y, cut = grown(level), grown(x), grown(y), grown(cut)
            for k in range(4 if parent >= 0 else 1):
                cx, cy = (2 * x[parent] + (k & 1), 2 * y[parent] + (k >> 1)) if parent >= 0 else (0, 0)
                if cx < columns and cy < rows and is_seen(eye, tree, ground, t, cx, cy):
                    level[count], x[count], y[count] = t, cx, cy
                    cut[count] = is_divided(eye, tree, ground, rule, t, cx, cy)
                    count += 1
        before = start
    level, x, y, cut = level[:count], x[:count], y[:count], cut[:count]
    keys = table = np.empty(0, np.int64)
    if restricted:
        keys, table = divided_keys(tree, level, x, y, cut)
    # top down: whole patches, then those that had to be divided have left some
    out_level, out_x, out_y = grown(level), grown(x), grown(y)
    found = i = 0
    left_x = left_y = np.empty(0, np.int64)
    left_end = 0
    for t in range(tree.top, -1, -1):
        extra_x, extra_y = np.empty(64, np.int64), np.empty(64, np.int64)
        extra_end = 0
        width = tree.side << t >> 1
        rows, columns = max(-(-tree.bottom // max(width, 1)), 1), max(-(-tree.right // max(width, 1)), 1)
        end = i
        while end < count and level[end] == t:
            end += 1
        for n in range(i, end + left_end):
            if n < end:
                if cut[n]:
                    continue
                px, py = x[n], y[n]
            else:
                px, py = left_x[n - end], left_y[n - end]
            if restricted and t > 0 and table[place_of(table, keys, key_of(t, px, py))] >= 0:
                if extra_end + 4 > extra_x.size:
                    extra_x, extra_y = grown(extra_x), grown(extra_y)
                for k in range(4):
                    cx, cy = 2 * px + (k & 1), 2 * py + (k >> 1)
                    if cx < columns and cy < rows and is_seen(eye, tree, ground, t - 1, cx, cy):
                        extra_x[extra_end], extra_y[extra_end] = cx, cy
                        extra_end += 1
                continue
            if found == out_x.size:
                out_level, out_x, out_y = grown(out_level), grown(out_x), grown(out_y)
            out_level[found], out_x[found], out_y[found] = t, px, py
            found += 1
        i = end
        left_x, left_y, left_end = extra_x, extra_y, extra_end
    return finest_first(out_level[:found], out_x[:found], out_y[:found])


@compiled
def finest_first(level: Ints, x: Ints, y: Ints) -> Hits:
    """Patches that come level by level from the top, in the other order of levels."""
    to_level, to_x, to_y = np.empty_like(level), np.empty_like(x), np.empty_like(y)
    end = x.size
    at = 0
    while end > 0:
        start = end
        while start > 0 and level[start - 1] == level[end - 1]:
            start -= 1
        for n in range(start, end):
            to_level[at], to_x[at], to_y[at] = level[n], x[n], y[n]
            at += 1
        end = start
    return to_level, to_x, to_y


@compiled
def neighbours(level: Ints, x: Ints, y: Ints, most: int) -> Ints:
    """(n, 4): see `quadtree.neighbours`."""
    result = np.full((x.size, 4), -1, np.int64)
    keys = np.empty(x.size, np.int64)
    for i in range(x.size):
        keys[i] = key_of(level[i], x[i], y[i])
    table = hashed(keys, keys.size, keys.size)
    for i in range(x.size):
        for edge in range(4):
            px, py = x[i] + (-1, 1, 0, 0)[edge], y[i] + (0, 0, -1, 1)[edge]
            if px < 0 or py < 0:
                continue
            for step in range(most + 1):
                at = table[place_of(table, keys, key_of(level[i] + step, px >> step, py >> step))]
                if at >= 0:
                    result[i, edge] = at
                    break
    return result


# -- arrays of patches -------------------------------------------------------------------------------------------------


@compiled
def distances(eye: Eye, tree: Tree, ground: Ground, level: Ints, x: Ints, y: Ints) -> F64:
    """(n,) of `distance_of`."""
    result = np.empty(x.size)
    for i in range(x.size):
        square = square_of(eye, tree, level[i], x[i], y[i])
        result[i] = distance_of(eye, tree, ground, square, level[i], x[i], y[i])
    return result


@compiled
def cell_distances(eye: Eye, tree: Tree, cells: Cells, level: Ints, x: Ints, y: Ints) -> F64:
    """(n,) of `cell_distance`."""
    result = np.empty(x.size)
    for i in range(x.size):
        result[i] = cell_distance(eye, tree, cells, level[i], x[i], y[i])
    return result


@compiled
def edge_distances(eye: Eye, tree: Tree, ground: Ground, level: Ints, way: Ints, x: Ints, y: Ints) -> F64:
    """(n,) of `edge_distance`."""
    result = np.empty(x.size)
    for i in range(x.size):
        square = edge_square(eye, tree, level[i], way[i], x[i], y[i])
        result[i] = edge_distance(eye, tree, ground, square, level[i], way[i], x[i], y[i])
    return result
