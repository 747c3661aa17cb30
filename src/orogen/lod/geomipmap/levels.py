"""Which level every block has, as a number with a fraction: so far it has morphed into the next.

The error of a block between two levels is at most the mean of theirs, weighed by the fraction. So the fraction at which
it is what the distance allows keeps to the bound, and changes without a jump.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.geomipmap.errors import Errors
from orogen.lod.quadtree import PatchFrame, PatchTree, Table, kernels

F64 = NDArray[np.float64]
Ints = NDArray[np.int64]
_KERNELS = "orogen.lod.geomipmap.kernels"
_STEP = 1.1
"""Ratio, at least, of the errors of a level and of the next finer one."""
_NEIGHBOURS = ((0, -1), (0, 1), (-1, 0), (1, 0))
"""Steps in rows and columns to the block over the west, east, north and south edge."""


class Levels:
    """The levels of all blocks of a grid."""

    def __init__(self, tree: PatchTree, errors: Errors) -> None:
        """`tree`: its patches of level 0 are the blocks."""
        self._tree = tree
        self._shape = errors.low.shape
        self._heights = Table.of([np.stack([errors.low, errors.high], axis=-1)])
        row, column = np.indices(self._shape)
        self._blocks = np.zeros(row.size, np.int64), column.ravel(), row.ravel()
        self._pairs = [_pairs(self._shape, step) for step in _NEIGHBOURS]
        # two more that are never reached, so that there is a next level everywhere
        sides = errors.own.reshape(len(errors.own), 4, -1).astype(np.float64)
        self._sides = _followed(sides)
        self._seam = _followed(errors.seam.reshape(len(errors.seam), 4, -1).astype(np.float64))
        own = sides.max(axis=1)
        for finer, coarser in pairwise(own):
            # a coarser level is never allowed where a finer one is not, and only some way behind it: none is skipped
            np.maximum(coarser, _STEP * finer, out=coarser)
        self._own = _followed(own)

    def distance(self, frame: Frame) -> F64:
        """(rows, columns) metres from the LOD eye to the nearest point of the blocks' boxes."""
        # to the boxes where they are without curvature
        flat = replace(frame, curvature=False) if frame.curvature else frame
        return PatchFrame(self._tree, flat, self._heights).distance(*self._blocks).reshape(self._shape)

    def allowed_error(self, frame: Frame, max_error: float) -> F64:
        """(rows, columns) metres of the data that are `max_error` pixels at the blocks' distance (equation 2.3)."""
        return self.distance(frame) * max_error / (frame.pixels_per_radian(frame.lod) * frame.exaggeration)

    def at(self, allowed: F64, *, morph: bool) -> F64:
        """(rows, columns) levels; without `morph` whole numbers. Neighbours differ by one at most.

        A block beside a coarser one leaves out vertices of that edge. Where the error of that is not allowed, the
        coarser block is made finer.
        """
        # the finest level is the best there is
        bound = np.maximum(allowed.ravel(), self._own[0])
        if compiled := kernels(_KERNELS):
            level = compiled.levels(self._own, self._sides, self._seam, bound, self._shape[1], morph)
            return np.asarray(level).reshape(allowed.shape)
        level = self._free(bound)
        level = level if morph else np.floor(level)
        changed = np.ones(level.size, bool)
        while changed.any():
            lowered = np.zeros(level.size, bool)
            for edge, (own, other) in enumerate(self._pairs):
                met = changed[own] & (level[other] > level[own])
                block, neighbour = own[met], other[met]
                limit = self._limit(block, level[block], bound[block], edge)
                limit = limit if morph else np.maximum(np.floor(limit), level[block])
                finer = limit < level[neighbour]
                level[neighbour[finer]] = limit[finer]
                lowered[neighbour[finer]] = True
            changed = lowered
        return level.reshape(allowed.shape)

    def edges(self, level: F64) -> F64:
        """(4, rows, columns) levels of the blocks' west, east, north and south edges: those of the coarser side."""
        flat = level.ravel()
        if compiled := kernels(_KERNELS):
            return np.asarray(compiled.edges(flat, self._shape[1])).reshape(4, *level.shape)
        edges = np.tile(flat, (4, 1))
        for edge, (own, other) in zip(edges, self._pairs, strict=True):
            edge[own] = np.maximum(flat[own], flat[other])
        return edges.reshape(4, *level.shape)

    def _free(self, allowed: F64) -> F64:
        """Levels from the blocks' own errors alone, of which that of level 0 is allowed."""
        block = np.arange(allowed.size)
        whole = (self._own[:-2] <= allowed).sum(axis=0) - 1
        fine, coarse = self._own[whole, block], self._own[whole + 1, block]
        return whole + _share(allowed - fine, coarse - fine)

    def _limit(self, block: Ints, level: F64, allowed: F64, edge: int) -> F64:
        """The level, from their own to one more, that blocks allow the neighbour over an edge to have.

        With fractions a of the block and e of the edge its mesh is, up to the next whole level, (1 - e) times its own,
        (e - a) times that with the edge thinned and a times the next one; from there on (1 - a) times that with the
        edge thinned, (a - e) times the next one and e times the next one with the edge thinned.
        """
        whole = np.floor(level).astype(np.int64)
        a = level - whole
        own, thinned = self._sides[whole, edge, block], self._seam[whole, edge, block]
        # without a fraction there is nothing of the next one, whose error may be infinite
        next_own = np.where(a > 0, self._sides[whole + 1, edge, block], 0.0)
        next_thinned = np.where(a > 0, self._seam[whole + 1, edge, block], np.inf)
        before = _share(allowed - own + a * (thinned - next_own), thinned - own)
        after = np.minimum(_share(allowed - (1 - a) * thinned - a * next_own, next_thinned - next_own), a)
        # rounding must not make it two levels
        most = np.nextafter(whole + 2.0, 0.0)
        return np.maximum(np.where(before < 1, whole + before, np.minimum(whole + 1 + after, most)), level)


def _pairs(shape: tuple[int, ...], step: tuple[int, int]) -> tuple[Ints, Ints]:
    """Numbers, row by row, of the blocks that have a neighbour at a step, and of those neighbours."""
    (rows, columns), (down, right) = shape, step
    row, column = (part.ravel() for part in np.indices((rows, columns)))
    inside = (row + down >= 0) & (row + down < rows) & (column + right >= 0) & (column + right < columns)
    own = np.flatnonzero(inside)
    return own, own + down * columns + right


def _followed(tables: F64) -> F64:
    return np.concatenate([tables, np.full((2, *tables.shape[1:]), np.inf)])


def _share(part: F64, whole: F64) -> F64:
    """part / whole within 0 to 1; 1 where the whole is nothing or less."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(whole > 0, np.clip(part / whole, 0, 1), 1.0)
