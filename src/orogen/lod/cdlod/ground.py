"""The approximate height of every point, which the distances of CDLOD are measured to: nodes' boxes and vertices alike.

A function of position alone, whatever is resident, so that two nodes agree about the vertices that they share.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.keys import level_shape
from orogen.lod.quadtree import Ints, PatchTree, Table
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.retry import steadily

F32 = NDArray[np.float32]
Bounds = tuple[NDArray[np.float64], NDArray[np.float64]]


class Ground:
    """Heights at the corners of square cells of 2^bits samples, bilinear between them."""

    def __init__(self, clipmap: Clipmap, tree: PatchTree) -> None:
        """Of the finest level that has at most 1024 rows and columns: the samples themselves where there are no more.

        Raises what reading that level raises.
        """
        pyramid = clipmap.heights.pyramid
        self.tree = tree
        self.bits = pyramid.estimate_level
        rows, columns = level_shape(tree.grid.shape, self.bits)
        tiles, whole = clipmap.heights.tiles, (slice(0, rows), slice(0, columns))
        heights: F32 = steadily(lambda: tiles.window(self.bits, *whole)).astype(np.float32)
        heights[np.isnan(heights)] = sum(pyramid.height_range) / 2
        if self.bits:
            # a cell's corners lie between the centres of coarser texels
            around = np.pad(heights, 1, mode="edge")
            heights = np.float32(0.25) * (around[:-1, :-1] + around[:-1, 1:] + around[1:, :-1] + around[1:, 1:])
        rows, columns = heights.shape
        self.heights: F32 = np.pad(heights, ((0, rows == 1), (0, columns == 1)), mode="edge")
        """(rows, columns) metres of the data at the corners of the cells, two of each at least."""
        self.first = max(0, self.bits - int(np.log2(tree.side)))
        """The first level whose nodes are made of whole cells."""
        self.table = Table.of(self._reduced(max(1, tree.side >> self.bits)))
        """Lowest and highest height (m) of the nodes of these levels."""

    def _reduced(self, cells: int) -> list[F32]:
        """(rows, columns, 2) per level whose nodes are made of whole cells; `cells`: along those of the first."""
        corners = self.heights[:-1, :-1], self.heights[:-1, 1:], self.heights[1:, :-1], self.heights[1:, 1:]
        low = _blocks(np.minimum.reduce(corners), cells, np.min)
        high = _blocks(np.maximum.reduce(corners), cells, np.max)
        tables = [np.stack([low, high], axis=-1)]
        for _ in range(self.first + 1, self.tree.level_count):
            low, high = _blocks(low, 2, np.min), _blocks(high, 2, np.max)
            tables.append(np.stack([low, high], axis=-1))
        return tables

    def bounds(self, level: int, x: Ints, y: Ints) -> Bounds:
        """Lowest and highest height (m) in the nodes of a level."""
        if level >= self.first:
            found = self.table.at(level - self.first, x, y)
            return found[:, 0], found[:, 1]
        # within a cell a bilinear surface is lowest and highest in corners
        first, last = self.tree.samples(level, x, y)
        corners = [self.at(column, row) for column in (first[:, 0], last[:, 0]) for row in (first[:, 1], last[:, 1])]
        return np.minimum.reduce(corners), np.maximum.reduce(corners)

    def at(self, column: NDArray, row: NDArray) -> NDArray[np.float64]:
        """Heights (m) at samples' columns and rows, which may be fractions."""
        at = np.stack([row, column]) / 2.0**self.bits
        last = np.array(self.heights.shape)[:, None] - 2
        cell = np.clip(np.floor(at).astype(np.int64), 0, last)
        (v, u), (i, j) = at - cell, cell
        h = self.heights.astype(np.float64)
        return (h[i, j] * (1 - u) + h[i, j + 1] * u) * (1 - v) + (h[i + 1, j] * (1 - u) + h[i + 1, j + 1] * u) * v


def _blocks(values: F32, size: int, way: Callable[..., Any]) -> F32:
    """Minimum or maximum of blocks of size x size values, the last ones of what there is."""
    padding = [(0, -length % size) for length in values.shape]
    rows, columns = (length + pad[1] for length, pad in zip(values.shape, padding, strict=True))
    padded = np.pad(values, padding, mode="edge")
    return way(padded.reshape(rows // size, size, columns // size, size), axis=(1, 3))
