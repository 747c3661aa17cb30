"""The tables of a clipped quadtree: for every place around a centre the best resident node."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.grid import Grid
from orogen.streaming.layer import Layer
from orogen.streaming.requests import LayerGrid

NO_SLOT = 0xFFFF
"""In place of a slot where no node is resident."""


def build_tables(
    layer: Layer, bits: int, origins: list[tuple[int, int]]
) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """The clipped quadtree of a layer: per level 2^bits x 2^bits entries by wrapped node row and column.

    First `slot | level << 16` of the best current node that covers the entry, then, for heights, the lowest and highest
    height (m) drawn there.
    """
    side, mask = 1 << bits, (1 << bits) - 1
    count = layer.grid.level_count
    nothing = NO_SLOT | (count - 1) << 16
    table = np.empty((count, side, side), np.uint32)
    bounds = np.zeros((count if layer.is_height else 0, side, side, 2), np.float32)
    by_level: dict[int, list[tuple[int, int, int]]] = {}
    for key, slot in layer.current.items():
        by_level.setdefault(key.level, []).append((key.y, key.x, slot))
    above = np.full((side, side), nothing, np.uint32)
    for level in range(count - 1, -1, -1):
        y0, x0 = origins[level]
        rows, cols = y0 + np.arange(side), x0 + np.arange(side)
        entries = above
        if level + 1 < count:
            # a window lies within that of the next coarser level; entries past the data may be anything
            up_y, up_x = origins[level + 1]
            entries = above[np.clip((rows >> 1) - up_y, 0, mask)[:, None], np.clip((cols >> 1) - up_x, 0, mask)]
        if level in by_level:
            y, x, slots = np.array(by_level[level]).T
            inside = (y >= y0) & (y < y0 + side) & (x >= x0) & (x < x0 + side)
            entries[y[inside] - y0, x[inside] - x0] = slots[inside] | level << 16
        wrapped = np.ix_(rows & mask, cols & mask)
        table[level][wrapped] = entries
        if layer.is_height:
            low, high = layer.bounds(level, *np.meshgrid(rows, cols, indexing="ij"))
            # what is drawn comes from resident texels, whose fill and border may leave the range of the samples below
            drawn = layer.slots[np.minimum(entries & 0xFFFF, len(layer.slots) - 1)]
            bounds[level][wrapped] = np.stack(
                [np.minimum(low, drawn[..., 0]), np.maximum(high, drawn[..., 1])], axis=-1
            )
        above = entries
    return table, bounds


def table_bits(layer: LayerGrid, load_distance: float) -> int:
    """Logarithm of the window's side: node_count >= 2 load_distance + 1, and room for whole groups of four."""
    return math.ceil(math.log2(min(max(layer.nodes(0)), 2 * load_distance * layer.stretch + 8)))


def half_nodes(layer: LayerGrid, centre: Sequence[float]) -> tuple[int, int]:
    """Half nodes of level 0 before a place in texels (column, row): all that windows around it depend on."""
    x, y = (math.floor(min(max(at, -1e15), 1e15) * 2 / layer.node_size) for at in centre)
    return x, y


def origins_around(layer: LayerGrid, bits: int, centre: Sequence[float]) -> list[tuple[int, int]]:
    """First node (row, column) of each level's window around a centre in texels (column, row), kept over the data."""
    side = 1 << bits
    origins = []
    x, y = half_nodes(layer, centre)
    for level in range(layer.level_count):
        rows, cols = layer.nodes(level)
        # to the nearest whole node, in half nodes of level 0
        nearest_row, nearest_col = (y + (1 << level)) >> level + 1, (x + (1 << level)) >> level + 1
        first_row, first_col = nearest_row - side // 2, nearest_col - side // 2
        origins.append((max(0, min(first_row, rows - side)), max(0, min(first_col, cols - side))))
    return origins


def lod_texel(frame: Frame, grid: Grid) -> tuple[float, float]:
    """Where distances for the level of detail start, in texels (column, row) of a grid."""
    x, y = frame.eye_texel if grid is frame.grid else grid.texel_of(frame.camera.x, frame.camera.y)
    east, north, _ = frame.lod_place
    if (east, north) == (0.0, 0.0):
        return x, y
    (a, b), (c, d) = grid.texels.tolist()
    return x + a * east + b * north, y + c * east + d * north
