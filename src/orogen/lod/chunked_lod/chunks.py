"""Chunks: meshes within an error, with the heights that they morph to and skirts, as pages for the GPU."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.lod import rtin
from orogen.lod.chunked_lod.survey import CELL, Survey
from orogen.lod.quadtree import Table

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CLUSTER = 64
"""Triangles that are drawn together."""
SIDES = 3
"""Bits of a mesh's vertex number that say on which side of a chunk a skirt hangs: 1 to 4, 0 for the surface."""
_NUMBER_BITS = 16 - SIDES
_HEADER = 2
_FLOORS = 4.0
"""Mean floors that the chunks of a level may be off, where nothing else is asked for."""
_MARGIN = 1.5
"""A chunk's bound is at least this many floors: a mesh may add half of what the spacing of its quads costs."""


class ChunkKey(NamedTuple):
    """A chunk: 2^level samples along a side."""

    level: int
    """Level of the tree; 0 is the finest."""
    x: int
    """Column in its level."""
    y: int
    """Row in its level."""


class Mesh(NamedTuple):
    """A chunk's triangles, without skirts."""

    places: Ints
    """(vertices, 2) columns and rows from the chunk's corner, in `ChunkMaker.unit`."""
    heights: NDArray[np.float32]
    """(vertices,) metres."""
    parents: NDArray[np.float32]
    """(vertices,) metres of the parent's surface there."""
    triangles: Ints
    """(triangles, 3) numbers of vertices."""


class ChunkMaker:
    """Makes chunks from a survey of the terrain."""

    def __init__(self, survey: Survey, base_error: float | None) -> None:
        """`base_error`: metres that chunks with a vertex at every sample may be off; None: as suits the terrain."""
        self.survey = survey
        self.n, self.k = survey.n, survey.k
        self.tree = survey.tree
        self.deltas = _suitable(survey) if base_error is None else _doubling(survey, base_error)
        """Per tree level: metres that its chunks may be off (Houska 2019, equation 2.6), but for rough ones."""
        self.bounds = self._bounds()
        """Per tree level: metres that no point of a chunk's mesh is off the true surface by (rows, columns)."""
        self.errors = Table.of([bounds[..., None] for bounds in self.bounds], cell_shift(0))
        """The same in one array, of which these are parts."""
        ends = np.cumsum([bounds.size for bounds in self.bounds])
        parts = np.split(self.errors.values[:, 0], ends[:-1])
        self.bounds = [part.reshape(bounds.shape) for part, bounds in zip(parts, self.bounds, strict=True)]
        rows, cols = survey.samples.shape
        self._last = np.array([cols - 1, rows - 1])
        corners = np.concatenate([survey.right, survey.bottom])
        self._range = (
            min(float(survey.ranges.values[:, 0].min()), float(corners.min())),
            max(float(survey.ranges.values[:, 1].max()), float(corners.max())),
        )
        n = self.n
        # every quad of a border row or column may gain vertices and triangles where the raster's edge cuts it
        self._most_vertices = (n + 1) ** 2 + 4 * n
        self._most_triangles = 2 * n * n + 4 * n + 8 * n
        self.page_bytes = 4 * (_HEADER + 4 * self._most_vertices + -(-3 * self._most_triangles // 2))
        """Bytes of the largest page."""
        self.triangle_counts: dict[ChunkKey, int] = {}
        """Triangles of every chunk that has been made, skirts included."""
        # siblings share their ancestors
        self.refined = lru_cache(maxsize=512)(self._refined)

    def unit(self, level: int) -> float:
        """Samples between two places of a mesh: a sample, or a quad where that is less."""
        return min(1.0, 2.0 ** (level - self.k))

    def __call__(self, key: ChunkKey) -> NDArray[np.uint32]:
        """The page of a chunk: counts, vertices, triangles; see vertex.wgsl."""
        mesh = self.mesh(key)
        numbers = np.concatenate([mesh.triangles, self._skirts(key, mesh)])
        self.triangle_counts[key] = len(numbers)
        vertices = np.empty((len(mesh.heights), 4), np.uint32)
        vertices[:, :2] = mesh.places
        vertices[:, 2], vertices[:, 3] = mesh.heights.view(np.uint32), mesh.parents.view(np.uint32)
        packed = np.zeros(-(-numbers.size // 2) * 2, np.uint16)
        packed[: numbers.size] = numbers.ravel()
        first = _HEADER + vertices.size
        return np.concatenate([np.array([len(numbers), first], np.uint32), vertices.ravel(), packed.view(np.uint32)])

    def mesh(self, key: ChunkKey) -> Mesh:
        """The mesh of a chunk, cut off where the raster ends."""
        n = self.n
        heights, needed, _ = self.refined(key)
        parents: NDArray[Any] = heights
        if key.level + 1 < self.tree.level_count:
            parents = rtin.refined(self._quadrant(key, self.refined(_parent(key))[2]))
        y, x = np.divmod(rtin.triangles(_turned(key, needed)), n + 1)
        x = n - x if _mirrored(key) else x
        scale = 1 << max(key.level - self.k, 0)
        corners = np.stack([x * scale, y * scale, parents[y, x]], axis=-1).astype(np.float64)
        end = (self._last - np.array([key.x, key.y]) * 2.0**key.level) / self.unit(key.level)
        for axis in (0, 1):
            if end[axis] < n * scale:
                corners = _cut(corners, axis, float(end[axis]))
        places, at, triangles = _distinct(corners)
        own = self._heights_at(key, places, heights, end, scale)
        low, high = self._range
        parents = np.clip(corners.reshape(-1, 3)[at, 2], low, high)
        return Mesh(places, own.astype(np.float32), parents.astype(np.float32), triangles)

    def _heights_at(self, key: ChunkKey, places: Ints, heights: Floats, end: Floats, scale: int) -> Floats:
        """Heights at a mesh's vertices: those of its grid, and on the raster's edge those of the edge itself."""
        x, y = places.T
        own = heights[np.minimum(y // scale, self.n), np.minimum(x // scale, self.n)]
        column, row = (np.array([key.x, key.y]) * 2.0**key.level + places * self.unit(key.level)).T
        survey = self.survey
        own = np.where(x == end[0], np.interp(row, np.arange(survey.right.size), survey.right), own)
        return np.where(y == end[1], np.interp(column, np.arange(survey.bottom.size), survey.bottom), own)

    def _bounds(self) -> list[NDArray[np.float32]]:
        """Bounds per level: delta, or what the floors of rougher chunks leave; never less than in a chunk's parts."""
        bounds: list[NDArray[np.float32]] = []
        for level, floors in enumerate(self.survey.floors):
            here = np.maximum(self.deltas[level], _MARGIN * self._slack(level) * floors).astype(np.float32)
            if bounds:
                finer = bounds[-1]
                side = 2 if cell_shift(level - 1) == 0 else 1
                padded = np.pad(finer, [(0, -size % side) for size in finer.shape], mode="edge")
                blocks = padded.reshape(padded.shape[0] // side, side, padded.shape[1] // side, side).max(axis=(1, 3))
                here = np.maximum(here, blocks)
            bounds.append(here)
        return bounds

    def _slack(self, level: int) -> NDArray[np.float32]:
        """2 for chunks that the raster's edge cuts, else 1: cutting moves vertices by as much as the mesh was off."""
        side = max(1 << level, CELL)
        rows, cols = self.survey.floors[level].shape
        height, width = self.survey.samples.shape
        cut = np.arange(1, rows + 1)[:, None] * side > height - 1
        cut = cut | (np.arange(1, cols + 1) * side > width - 1)
        return np.where(cut, np.float32(2), np.float32(1))

    def _refined(self, key: ChunkKey) -> tuple[Floats, NDArray[np.bool_], Floats]:
        """Heights of a chunk's grid, which of its vertices split triangles, and the heights of the mesh they make."""
        heights = self._grid(key).astype(np.float64)
        level, x, y = key
        shift = cell_shift(level)
        at = y >> shift, x >> shift
        allowed = self.bounds[level][at] / self._slack(level)[at] - self.survey.floors[level][at]
        needed = _turned(key, rtin.vertex_errors(_turned(key, heights))) > allowed
        if level + 1 < self.tree.level_count:
            # nested: a parent's vertices are there in its children, so that they can morph into it
            needed[::2, ::2] |= self._quadrant(key, self.refined(_parent(key))[1])
        return heights, needed, _turned(key, rtin.surface(_turned(key, heights), _turned(key, needed)))

    def _grid(self, key: ChunkKey) -> NDArray[np.float32]:
        """(n + 1, n + 1) exact heights of the vertices over a chunk; past the raster's edges such as suit them."""
        n, level = self.n, key.level - self.k
        if level in self.survey.grids:
            return self.survey.grids[level][key.y * n : (key.y + 1) * n + 1, key.x * n : (key.x + 1) * n + 1]
        steps = np.arange(n + 1)
        if level >= 0:
            return self.survey.samples.at((key.y * n + steps) << level, (key.x * n + steps) << level)
        # within bilinear cells
        side = 1 << key.level
        samples = np.arange(side + 1)
        z = self.survey.samples.at(key.y * side + samples, key.x * side + samples)
        at = steps / n * side
        first = np.minimum(at.astype(np.int64), side - 1)
        way = (at - first).astype(np.float32)
        z = z[:, first] + (z[:, first + 1] - z[:, first]) * way
        return z[first] + (z[first + 1] - z[first]) * way[:, None]

    def _quadrant(self, key: ChunkKey, values: NDArray) -> NDArray:
        """The part of the parent's vertices that lies over a chunk."""
        half = self.n // 2
        y, x = (key.y & 1) * half, (key.x & 1) * half
        return values[y : y + half + 1, x : x + half + 1]

    def _skirts(self, key: ChunkKey, mesh: Mesh) -> Ints:
        """(m, 3) triangles that hang from the edges of a chunk that lie inside the raster."""
        rows, cols = self.tree.shape(key.level)
        width = self.n << max(key.level - self.k, 0)
        inner = ((0, 0, key.x > 0), (0, width, key.x + 1 < cols), (1, 0, key.y > 0), (1, width, key.y + 1 < rows))
        found = [np.zeros((0, 3), np.int64)]
        edges = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
        for side, (axis, place, there) in enumerate(inner):
            if there:
                a, b = edges[(mesh.places[edges, axis] == place).all(axis=1)].T
                hangs = side + 1 << _NUMBER_BITS
                found += [np.stack([a, b, a | hangs], axis=1), np.stack([b, b | hangs, a | hangs], axis=1)]
        return np.concatenate(found)


def cell_shift(level: int) -> int:
    """Levels between a tree level and that of the table that knows its chunks: those below CELL samples share one."""
    return max(0, CELL.bit_length() - 1 - level)


def _parent(key: ChunkKey) -> ChunkKey:
    return ChunkKey(key.level + 1, key.x >> 1, key.y >> 1)


def _mirrored(key: ChunkKey) -> bool:
    """Whether a chunk's first split is along the rising diagonal: all chunks are parts of one such hierarchy."""
    return bool((key.x + key.y) & 1)


def _turned(key: ChunkKey, values: NDArray[Any]) -> NDArray[Any]:
    """Values of a chunk's vertices as seen by `rtin`, whose first split falls; and back."""
    return values[:, ::-1] if _mirrored(key) else values


def _doubling(survey: Survey, base_error: float) -> list[float]:
    return [base_error * 2.0 ** (level - survey.k) for level in range(survey.tree.level_count)]


def _suitable(survey: Survey) -> list[float]:
    """Some mean floors, so that meshes have a fraction of their grids' triangles; half to a quarter of the level above.

    Where the ground is smooth, as it is between samples, errors are quartered from level to level: to halve them would
    leave chunks of a few triangles each.
    """
    deltas: list[float] = []
    for floors in reversed(survey.floors):
        delta = _FLOORS * float(floors.mean())
        deltas.append(float(np.clip(delta, deltas[-1] / 4, deltas[-1] / 2)) if deltas else delta)
    return deltas[::-1]


def _cut(corners: Floats, axis: int, end: float) -> Floats:
    """The parts of triangles (m, 3, values) up to a line across an axis, values in proportion."""
    inside = corners[:, :, axis] <= end
    count = inside.sum(axis=1)
    parts = [corners[count == 3]]
    for alone, some in ((True, corners[count == 1]), (False, corners[count == 2])):
        # the corner that is alone on its side first
        first = ((some[:, :, axis] <= end) == alone).argmax(axis=1)
        a, b, c = np.take_along_axis(some, (first[:, None] + np.arange(3))[:, :, None] % 3, axis=1).swapaxes(0, 1)
        ab, ac = (a + (p - a) * ((end - a[:, axis]) / (p[:, axis] - a[:, axis]))[:, None] for p in (b, c))
        parts += [np.stack([a, ab, ac], 1)] if alone else [np.stack([ab, b, c], 1), np.stack([ab, c, ac], 1)]
    return np.concatenate(parts)


def _distinct(corners: Floats) -> tuple[Ints, Ints, Ints]:
    """Places of distinct corners, an index of each among all corners, and triangles of them that have an area."""
    places = np.rint(corners[..., :2]).astype(np.int64)
    keys, at, numbers = np.unique(
        (places[..., 1] << 32 | places[..., 0]).ravel(), return_index=True, return_inverse=True
    )
    numbers = numbers.reshape(-1, 3)
    a, b, c = places.swapaxes(0, 1)
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    return np.stack([keys & 0xFFFFFFFF, keys >> 32], axis=1), at, numbers[area != 0]
