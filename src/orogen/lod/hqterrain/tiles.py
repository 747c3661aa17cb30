"""Tiles: a nested hierarchy of vertices, those of coarse meshes first, and a list of triangles per level of detail.

Levels of detail are powers of two of the error in metres: the mesh of level j lacks only vertices without which it is
off by 2^j metres at most. So a vertex is in the meshes of its own level and of all below, and in none above.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.lod import rtin
from orogen.lod.hqterrain.ground import Ground
from orogen.lod.quadtree import PatchTree

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

FINEST, COARSEST = -20, 31
"""Levels of detail that there are: from a micrometre to more than any height."""
VERTEX = np.dtype([("place", "u4"), ("height", "f4"), ("morphed", "f4")])
"""Column, row << 8, (level of detail - FINEST) << 16; height in metres; the same on the finest mesh without it."""


class TileKey(NamedTuple):
    """A tile: 2^level samples along a side."""

    level: int
    """Level of the tree; 0 is the finest."""
    x: int
    """Column in its level."""
    y: int
    """Row in its level."""


class Shape(NamedTuple):
    """One of the meshes of a tile."""

    detail: int
    """Level of detail."""
    halved: int
    """Bits of the sides (west, east, north, south) whose middle is a corner of smaller tiles."""


class Tile:
    """A tile's vertices and triangles, and how much of them the GPU has."""

    def __init__(self, key: TileKey, heights: Floats, ends: Floats) -> None:
        """`heights`: (n + 1, n + 1) at all its vertices; `ends`: column and row where the raster ends, in quads."""
        self.key = key
        n = heights.shape[0] - 1
        # vertices beyond the raster are drawn on its edge; errors are those of ground that goes on beyond it
        ground = continued(continued(heights, ends[0]).T, ends[1]).T
        errors = self._turned(rtin.vertex_errors(self._turned(ground)))
        # 2^level < error <= 2^(level + 1)
        mantissa, exponent = np.frexp(errors)
        levels = np.clip(exponent - 1 - (mantissa == 0.5), FINEST, COARSEST)
        levels[errors <= 2.0**FINEST] = FINEST - 1
        levels[::n, ::n] = COARSEST
        self._levels = levels
        # the middles of the sides may be corners of smaller neighbours, whatever the level of detail
        sent = levels.copy()
        sent[:: n // 2, :: n // 2] = COARSEST
        order = np.argsort(-sent.ravel(), kind="stable")
        self._numbers = np.empty(order.size, np.int64)
        self._numbers[order] = np.arange(order.size)
        self.counts = np.array([(sent >= j).sum() for j in range(FINEST, COARSEST + 1)])
        """Vertices that each level of detail's mesh may have, from FINEST up."""
        self.finest = int(levels[levels >= FINEST].min())
        """The finest level of detail that has vertices of its own."""
        y, x = np.divmod(order, n + 1)
        self.vertices = np.empty(order.size, VERTEX)
        """All vertices, those of the coarsest meshes first."""
        self.vertices["place"] = x | y << 8 | (levels.ravel()[order] - FINEST).clip(0) << 16
        self.vertices["height"] = heights.ravel()[order]
        beyond = (np.arange(n + 1)[:, None] > ends[1]) | (np.arange(n + 1) > ends[0])
        morphed = np.where(beyond, heights, np.clip(self._morphed(ground), heights.min(), heights.max()))
        self.vertices["morphed"] = morphed.ravel()[order]
        self.corners = heights[[0, 0, n, n], [0, n, 0, n]]
        """Heights of the corners: north-west, north-east, south-west, south-east."""
        self.sent = 0
        """Vertices that the GPU has."""
        self.lists: dict[Shape, tuple[int, int]] = {}
        """First word in the page and number of triangles of the lists that the GPU has."""
        self.list_end = 0
        """Words of its page's lists that are taken."""
        self._borders: dict[tuple[int, Shape], tuple[Ints, Ints]] = {}

    def triangles(self, shape: Shape) -> Ints:
        """(m, 3) numbers of the vertices of a mesh's triangles."""
        n = self._levels.shape[0] - 1
        y, x = np.divmod(rtin.triangles(self._turned(self._needed(shape))), n + 1)
        return self._numbers[y * (n + 1) + (n - x if self._odd else x)]

    def border(self, side: int, shape: Shape) -> tuple[Ints, Ints]:
        """Numbers of a mesh's vertices along a side (west, east, north, south), and their places there.

        Places count in quads of all finest tiles, so that they compare between tiles.
        """
        if (side, shape) not in self._borders:
            n = self._levels.shape[0] - 1
            line = ((slice(None), 0), (slice(None), n), (0, slice(None)), (n, slice(None)))[side]
            there = np.flatnonzero(self._needed(shape)[line])
            first = self.key.y if side < 2 else self.key.x
            numbers = self._numbers.reshape(n + 1, n + 1)[line][there]
            self._borders[side, shape] = numbers, (first * n + there) << self.key.level
        return self._borders[side, shape]

    def _needed(self, shape: Shape) -> NDArray[np.bool_]:
        """(n + 1, n + 1): the vertices of a mesh."""
        needed = self._levels >= shape.detail
        half = (self._levels.shape[0] - 1) // 2
        for side, place in enumerate(((half, 0), (half, -1), (0, half), (-1, half))):
            if shape.halved >> side & 1:
                # which takes the middle of the tile, too
                needed[place] = needed[half, half] = True
        return needed

    @property
    def _odd(self) -> bool:
        """Whether its first split is along the rising diagonal: neighbouring tiles are mirror images."""
        return bool((self.key.x + self.key.y) & 1)

    def _turned(self, values: NDArray) -> NDArray:
        return values[:, ::-1] if self._odd else values

    def _morphed(self, heights: Floats) -> Floats:
        """Heights of all vertices on the meshes that just lack them."""
        morphed = heights.copy()
        for level in np.unique(self._levels[self._levels < COARSEST]).tolist():
            mesh = self._turned(rtin.surface(self._turned(heights), self._turned(self._levels > level)))
            morphed[self._levels == level] = mesh[self._levels == level]
        return morphed


class TileMaker:
    """Makes tiles, and keeps those that are on the GPU."""

    def __init__(self, ground: Ground, tree: PatchTree, n: int) -> None:
        """`n`: quads along a tile."""
        self.ground = ground
        self.tree = tree
        self.n = n
        self.k = n.bit_length() - 1
        self.tiles: dict[TileKey, Tile] = {}
        """Tiles that are on the GPU or on their way there."""
        vertices = VERTEX.itemsize * (n + 1) ** 2
        self.list_bytes = 2 * 6 * 2 * n * n
        """Bytes for lists of triangles in a page: twice the largest."""
        self.page_bytes = vertices + self.list_bytes
        """Bytes of a tile's page, enough for all its vertices."""
        self.list_start = vertices
        """Byte where the lists start."""

    def __call__(self, key: TileKey) -> NDArray[np.uint32]:
        """The beginning of a tile's page: the vertices of its coarsest mesh."""
        steps = np.arange(self.n + 1)
        heights = self.ground.grid(key.level - self.k, key.y * self.n + steps, key.x * self.n + steps)
        rows, cols = self.ground.shape
        ends = (np.array([cols - 1, rows - 1]) - np.array([key.x, key.y]) * 2.0**key.level) * 2.0 ** (
            self.k - key.level
        )
        tile = Tile(key, heights, ends)
        tile.sent = int(tile.counts[COARSEST - FINEST])
        self.tiles[key] = tile
        return tile.vertices[: tile.sent].view(np.uint32)

    def keep(self, keys: Collection[TileKey]) -> None:
        """Forget all tiles but these."""
        for key in [key for key in list(self.tiles) if key not in keys]:
            del self.tiles[key]


def continued(heights: Floats, end: float) -> Floats:
    """Heights (rows, columns) of ground that goes on past the column `end`, in place of the height at the end itself.

    The ground is reflected in its last point, so that planes stay planes.
    """
    columns = np.arange(heights.shape[1])
    outside = columns > end
    if not outside.any() or end <= 0:
        return heights
    inside = columns < end
    known = np.append(columns[inside], end)
    values = np.column_stack([heights[:, inside], heights[:, -1]])
    mirrored = 2 * end - columns[outside]
    weights = np.array([np.interp(np.maximum(mirrored, 0), known, one) for one in np.eye(known.size)])
    last = values[:, -1:]
    # further than the ground is known: as steep as all of it
    steps = np.where(mirrored < 0, columns[outside] / end - 1, 1.0)
    result = heights.copy()
    result[:, outside] = last + steps * (last - values @ weights)
    return result
