"""What is worked out about a terrain before chunks are drawn: heights and errors of every chunk of the quadtree.

A chunk of tree level t spans 2^t samples along a side and n quads, n = 2^k: at t = k every sample is a vertex, below
that the bilinear cells are divided further. Its floor is what the spacing of its quads costs by itself: no point of the
surface over all its quads is further from the true one. The samples are read once, tile by tile.
"""

from __future__ import annotations

import logging
import time

import numpy as np
from numpy.typing import NDArray

from orogen.lod.quadtree import PatchTree, Table
from orogen.lod.rtin import refined
from orogen.streaming.samples import Positions, Samples

_log = logging.getLogger("orogen")

F32 = NDArray[np.float32]
Ints = NDArray[np.int64]

CELL = 8
"""Samples along the cells in which heights and errors are kept; coarser vertices are kept, finer ones read again."""
_CELL_BITS = 3
_TILE = 512
"""Samples along a tile that is worked on at once: few enough for the processor's cache."""


class Survey:
    """Bounds of all chunks of a tree, and the samples that chunks of coarse levels are made of."""

    def __init__(self, samples: Samples, tree: PatchTree, n: int) -> None:
        """`tree`: with patches of 1 sample; `n`: quads along a chunk. Raises what reading the samples raises."""
        samples.wait()
        self.samples = samples
        self.tree = tree
        self.n = n
        self.k = n.bit_length() - 1
        self._last = np.array(samples.shape) - 1
        """Row and column of the last sample."""
        start = time.monotonic()
        shape = self._cells(0)
        self._low, self._high = np.full(shape, np.inf, np.float32), np.full(shape, -np.inf, np.float32)
        self._twist, self._rest = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._floors: dict[int, F32] = {}
        for level in range(min(_CELL_BITS, tree.level_count - self.k)):
            self._floors[level] = np.zeros(tree.shape(self.k + level), np.float32)
        gather = self._gatherer()
        self.right, self.bottom = np.zeros(samples.shape[0], np.float32), np.zeros(samples.shape[1], np.float32)
        """Heights of the raster's last column and row."""
        tiles = [(y, x) for y in range(0, max(1, self._last[0]), _TILE) for x in range(0, max(1, self._last[1]), _TILE)]
        said = start
        for done, (y, x) in enumerate(tiles):
            self._measure(y, x, gather)
            if time.monotonic() > said + 2:
                said = time.monotonic()
                _log.info("chunked_lod: %d %% of the chunks measured", 100 * done // len(tiles))
        self.grids = self._coarse_grids(gather)
        """Per level from CELL_BITS up (of samples, 2^level apart): heights of its chunks' vertices."""
        self.ranges = self._ranges()
        """Lowest and highest true height in metres of chunks."""
        self.floors = self._all_floors()
        """Per tree level: floors in metres per chunk (rows, columns)."""
        _log.info("chunked_lod: %d samples measured in %.1f s", np.prod(samples.shape), time.monotonic() - start)

    # -- one tile ----------------------------------------------------------------------------------------------------

    def _measure(self, y: int, x: int, gather: _Gather) -> None:
        """Everything that needs all samples of a tile, whose first one is at row y and column x."""
        inner = [slice(first, min(first + _TILE, last) + 1) for first, last in zip((y, x), self._last, strict=True)]
        window, valid = self.samples.window(*inner)
        gather.add(window, *inner)
        self._keep_borders(window, *inner)
        # the ground beyond the raster's edges only rounds cells off
        unit = max(CELL << _CELL_BITS, self.n << _CELL_BITS)
        size = [max(1, -(-(part.stop - 1 - part.start) // unit)) * unit for part in inner]
        rows, cols = y + np.arange(size[0] + 1), x + np.arange(size[1] + 1)
        z = window
        if z.shape != (rows.size, cols.size):
            z = self.samples.at(rows, cols)
        twist = np.abs(z[:-1, :-1] + z[1:, 1:] - z[:-1, 1:] - z[1:, :-1]) * np.float32(0.25)
        counts = self._counting(z.shape, inner, valid)
        if counts is not None:
            twist[~(counts[:-1, :-1] & counts[1:, :-1] & counts[:-1, 1:] & counts[1:, 1:])] = 0
        top, left = y // CELL, x // CELL
        place = np.s_[top : top + (rows.size - 1) // CELL, left : left + (cols.size - 1) // CELL]
        target = self._low[place].shape

        def kept(values: F32) -> F32:
            """Those over the raster."""
            return values[: target[0], : target[1]]

        low, high = (z, z) if counts is None else (np.where(counts, z, np.inf), np.where(counts, z, -np.inf))
        self._low[place] = kept(-closed_maxima(-low, CELL))
        self._high[place] = kept(closed_maxima(high, CELL))
        twists = block_maxima(twist, CELL)
        self._twist[place] = kept(twists)
        for level in range(_CELL_BITS + 1):
            coarse = z[:: 1 << level, :: 1 << level]
            for _ in range(level):
                coarse = refined(coarse)
            off = np.abs(z - coarse)
            if counts is not None:
                off[~counts] = 0
            errors = closed_maxima(off, CELL) + twists
            if level in self._floors:
                chunk = 1 << (self.k + level)
                table = self._floors[level]
                found = block_maxima(errors, chunk // CELL)
                part = table[y // chunk :, x // chunk :][: found.shape[0], : found.shape[1]]
                np.maximum(part, found[: part.shape[0], : part.shape[1]], out=part)
        self._rest[place] = kept(errors)

    def _counting(
        self, shape: tuple[int, ...], inner: list[slice], valid: NDArray[np.bool_] | None
    ) -> NDArray[np.bool_] | None:
        """Which vertices of a tile are corners of true surface: None for all."""
        rows, cols = (part.stop - part.start for part in inner)
        if valid is None and shape == (rows, cols):
            return None
        counts = np.zeros(shape, bool)
        if valid is None:
            counts[:rows, :cols] = True
            return counts
        # cells with a valid corner are drawn in part; void borders of a tile are its neighbours' concern
        near = np.zeros((rows + 2, cols + 2), bool)
        for dy in range(3):
            for dx in range(3):
                near[dy : dy + rows, dx : dx + cols] |= valid
        counts[:rows, :cols] = near[1:-1, 1:-1]
        return counts

    def _keep_borders(self, window: F32, rows: slice, cols: slice) -> None:
        if rows.stop - 1 == self._last[0]:
            self.bottom[cols] = window[-1]
        if cols.stop - 1 == self._last[1]:
            self.right[rows] = window[:, -1]

    # -- the whole tree ----------------------------------------------------------------------------------------------

    def _cells(self, level: int) -> tuple[int, int]:
        """(rows, columns) of cells of CELL samples << level."""
        rows, cols = (max(1, -(-int(last) // (CELL << level))) for last in self._last)
        return rows, cols

    def _levels(self) -> range:
        """Levels of samples whose chunks' vertices are kept."""
        return range(_CELL_BITS, self.tree.level_count - self.k)

    def _positions(self, level: int) -> tuple[Ints, Ints]:
        rows, cols = self.tree.shape(self.k + level)
        return np.arange(rows * self.n + 1) << level, np.arange(cols * self.n + 1) << level

    def _gatherer(self) -> _Gather:
        axes = [
            [Positions.of(self._positions(level)[axis], self.samples.shape[axis]).needed for level in self._levels()]
            for axis in (0, 1)
        ]
        return _Gather(*(np.unique(np.concatenate([*parts, [0]])).astype(np.int64) for parts in axes))

    def _coarse_grids(self, gather: _Gather) -> dict[int, F32]:
        grids = {}
        for level in self._levels():
            down, right = (
                Positions.of(at, count) for at, count in zip(self._positions(level), self.samples.shape, strict=True)
            )
            picked = gather.values[
                np.ix_(np.searchsorted(gather.rows, down.needed), np.searchsorted(gather.cols, right.needed))
            ]
            grids[level] = down.take(right.take(picked, 1), 0)
        return grids

    def _ranges(self) -> Table:
        low, high = self._low, self._high
        levels = [np.stack([low, high], axis=-1)] * (_CELL_BITS + 1)
        for _ in range(_CELL_BITS + 1, self.tree.level_count):
            low, high = -block_maxima(-low, 2), block_maxima(high, 2)
            levels.append(np.stack([low, high], axis=-1))
        table = Table.of(levels[: self.tree.level_count], _CELL_BITS)
        # where all is void any height will do
        table.values[np.isinf(table.values)] = min(float(low.min()), float(high.max()))
        return table

    def _all_floors(self) -> list[F32]:
        floors: list[F32] = []
        for t in range(self.tree.level_count):
            level = t - self.k
            if level < 0:
                cells = block_maxima(self._twist, max(1, (1 << t) // CELL))
                # a bilinear cell cut into quads of half the side is a quarter as far from its triangles
                floors.append(cells * np.float32(4.0**level))
                continue
            found = self._floors.get(level)
            found = self._coarse_floor(level) if found is None else found
            # a coarser surface may be nearer to the true one by chance: errors never grow towards finer levels
            finer = floors[-1] if floors else None
            if finer is not None:
                halves = block_maxima(finer, 2 if 1 << (t - 1) >= CELL else 1)[: found.shape[0], : found.shape[1]]
                found = np.maximum(found, halves)
            floors.append(found)
        return floors

    def _coarse_floor(self, level: int) -> F32:
        """Errors of vertices 2^level samples apart: against those CELL samples apart, and what these leave out."""
        exact = self.grids[_CELL_BITS][tuple(slice(size + 1) for size in self._cells(0))]
        coarse = self.grids[level]
        for finer in range(level, _CELL_BITS, -1):
            # as far as the raster goes
            needed = tuple(slice(size + 1) for size in self._cells(finer - _CELL_BITS))
            coarse = refined(coarse[needed])
        off = np.abs(exact - coarse[: exact.shape[0], : exact.shape[1]])
        return block_maxima(closed_maxima(off, 1) + self._rest, 1 << (self.k + level - _CELL_BITS))


class _Gather:
    """Samples at chosen rows and columns, picked from windows as they come by."""

    def __init__(self, rows: Ints, cols: Ints) -> None:
        self.rows, self.cols = rows, cols
        self.values = np.zeros((rows.size, cols.size), np.float32)

    def add(self, window: F32, rows: slice, cols: slice) -> None:
        r = slice(*np.searchsorted(self.rows, [rows.start, rows.stop]))
        c = slice(*np.searchsorted(self.cols, [cols.start, cols.stop]))
        self.values[r, c] = window[np.ix_(self.rows[r] - rows.start, self.cols[c] - cols.start)]


def block_maxima(values: F32, side: int) -> F32:
    """Maxima of blocks of side x side values; those at the far ends may have fewer."""
    if side == 1:
        return values
    rows, cols = values.shape
    padded = np.pad(values, ((0, -rows % side), (0, -cols % side)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // side, side, padded.shape[1] // side, side)
    return blocks.max(axis=1).max(axis=2)


def closed_maxima(vertices: F32, side: int) -> F32:
    """Maxima over cells of side x side quads, the vertices on their edges included."""
    rows, cols = ((size - 1) // side for size in vertices.shape)
    down = vertices[:-1].reshape(rows, side, -1).max(axis=1)
    np.maximum(down, vertices[side::side], out=down)
    across = down[:, :-1].reshape(rows, cols, side).max(axis=2)
    return np.maximum(across, down[:, side::side], out=across)
