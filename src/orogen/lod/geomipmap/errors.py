"""How far a block's mesh at each level is from the surface, measured once from all samples (de Boer 2000).

A mesh has every 2^n-th sample of a block as a vertex. Squares of two by two quads are fans around their
middles, so that every level's triangles are unions of those of the level below, and a fan's outer edges can each be
halved or not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.keys import NodeKey
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.settings import HEIGHT_BORDER
from orogen.streaming.tiles import height_node

F32 = NDArray[np.float32]
_BAND = 256
"""Rows of samples that are measured at once."""


@dataclass(frozen=True)
class Errors:
    """Bounds, in metres of the data, on what meshes differ by from the surface of the samples."""

    own: F32
    """(levels, 4, rows, columns) with every vertex of the level: in the quarters of a block at its west, east, north
    and south edge."""
    seam: F32
    """(levels - 1, 4, rows, columns) likewise, of blocks whose edges have only every second vertex."""
    low: F32
    """(rows, columns) lowest sample of the blocks."""
    high: F32
    """(rows, columns) highest sample of the blocks."""


def measured(heights: F32, side: int, finer: int) -> Errors:
    """Errors of blocks of `side` samples, a power of two, over (rows, columns) samples.

    `finer`: levels before the one with every sample as a vertex; each splits the quads of the next one in four.
    """
    rows, columns = (max(1, -(-(count - 1) // side)) for count in heights.shape)
    step = max(1, _BAND // side)
    bands = [_measured_band(heights, side, first, min(first + step, rows), columns) for first in range(0, rows, step)]
    own, seam, low, high = (np.concatenate(parts, axis=-2) for parts in zip(*bands, strict=True))
    # parts of a bilinear cell have a quarter of its twist, and their outer edges are straight, thinned or not
    splits = np.stack([own[0] / 4.0 ** (finer - level) for level in range(finer)]) if finer else own[:0]
    return Errors(np.concatenate([splits, own]), np.concatenate([splits, seam]), low, high)


def _measured_band(heights: F32, side: int, first: int, last: int, columns: int) -> tuple[F32, F32, F32, F32]:
    """The fields of `Errors` for the rows of blocks from `first` up to `last`."""
    row, column = np.arange(first * side, last * side + 1), np.arange(columns * side + 1)
    h = extended(heights, row, column)
    # a bilinear cell is off the plane of half of it by a quarter of its twist in the middle of the diagonal
    bent = np.abs(h[:-1, :-1] + h[1:, 1:] - h[:-1, 1:] - h[1:, :-1]) / 4
    drawn = np.logical_and.outer(row[:-1] < heights.shape[0] - 1, column[:-1] < heights.shape[1] - 1)
    corners = h[:-1, :-1], h[:-1, 1:], h[1:, :-1], h[1:, 1:]
    low = _blocks(np.where(drawn, np.minimum.reduce(corners), np.inf), side).min(axis=(1, 3))
    high = _blocks(np.where(drawn, np.maximum.reduce(corners), -np.inf), side).max(axis=(1, 3))
    # a raster with a single row or column has no cells
    nothing = low > high
    low[nothing] = high[nothing] = h[:-1:side, :-1:side][nothing]
    beside = _beside(side)
    own: list[list[F32]] = []
    seam: list[list[F32]] = []
    for level in range(side.bit_length()):
        vertices = h[:: 1 << level, :: 1 << level]
        for meshes, mesh in ((own, vertices), (seam, _thinned(vertices, side >> level))):
            off = _blocks((_off(mesh, h, level, side) + bent) * drawn, side)
            meshes.append([np.where(part[:, None, :], off, 0).max(axis=(1, 3)) for part in beside])
    # the last level has no vertices to leave out
    return np.array(own, np.float32), np.array(seam[:-1], np.float32), low, high


def extended(heights: F32, row: NDArray[np.int64], column: NDArray[np.int64]) -> F32:
    """Heights at rows and columns that may lie past the last ones: there the surface is turned about its rim."""
    size = np.array(heights.shape) - 1
    rim = np.minimum(row, size[0]), np.minimum(column, size[1])
    back = [np.maximum(2 * edge - at, 0) for edge, at in zip(rim, (row, column), strict=True)]
    return 2 * heights[np.ix_(*rim)] - heights[np.ix_(*back)]


def refined(values: F32, quads: int) -> F32:
    """The surface of a mesh at twice as many vertices; `quads`: along the side of a block of the given mesh."""
    rows, columns = values.shape
    out = np.empty((2 * rows - 1, 2 * columns - 1), np.float32)
    out[::2, ::2] = values
    out[::2, 1::2] = (values[:, :-1] + values[:, 1:]) / 2
    out[1::2, ::2] = (values[:-1] + values[1:]) / 2
    # diagonals run to the middles of the fans
    odd = np.add.outer(np.arange(rows - 1) % quads, np.arange(columns - 1) % quads) & 1
    middle = np.where(odd, values[:-1, 1:] + values[1:, :-1], values[:-1, :-1] + values[1:, 1:])
    out[1::2, 1::2] = middle / 2
    return out


def _off(vertices: F32, h: F32, level: int, side: int) -> F32:
    """Greatest difference between a level's mesh and the samples in the corners of every cell."""
    surface = vertices
    for finer in range(level, 0, -1):
        surface = refined(surface, side >> finer)
    off = np.abs(surface - h)
    return np.maximum.reduce((off[:-1, :-1], off[:-1, 1:], off[1:, :-1], off[1:, 1:]))


def _thinned(vertices: F32, quads: int) -> F32:
    """Vertices of a level with every second one on the edges of blocks put on the line of those beside it."""
    out = vertices.copy()
    if quads == 1:
        return out
    out[::quads, 1::2] = (vertices[::quads, :-1:2] + vertices[::quads, 2::2]) / 2
    out[1::2, ::quads] = (vertices[:-1:2, ::quads] + vertices[2::2, ::quads]) / 2
    return out


def _beside(side: int) -> NDArray[np.bool_]:
    """(4, rows, columns) the cells of a block that are nearest to its west, east, north and south edge."""
    row, column = np.mgrid[:side, :side]
    away = np.stack([column, side - 1 - column, row, side - 1 - row])
    return away == away.min(axis=0)


def _blocks(cells: NDArray, side: int) -> NDArray:
    """(block rows, side, block columns, side) of cells."""
    return cells.reshape(cells.shape[0] // side, side, cells.shape[1] // side, side)


def drawn_samples(clipmap: Clipmap) -> F32:
    """All samples of level 0, invalid ones filled in as they are where nodes are drawn.

    Waits for the pyramid where level 0 cannot be read before it is built. Raises what reading it raises.
    """
    layer = clipmap.heights
    if not layer.pyramid.available(0):
        layer.pyramid.wait()
    size, (height, width) = layer.grid.node_size, clipmap.grid.shape
    samples = np.empty((height, width), np.float32)
    inside = slice(HEIGHT_BORDER, HEIGHT_BORDER + size)
    for y, x in np.ndindex(*layer.grid.nodes(0)):
        node = height_node(layer.tiles, layer.pyramid, NodeKey(0, x, y), size, layer.covered)
        part = samples[y * size : (y + 1) * size, x * size : (x + 1) * size]
        part[:] = node.heights[inside, inside][: part.shape[0], : part.shape[1]]
    return samples
