"""Which chunks a frame shows, how far each has morphed into its parent, and how deep its skirts hang."""

from __future__ import annotations

from collections.abc import Container, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.chunked_lod.chunks import ChunkKey, ChunkMaker, cell_shift
from orogen.lod.quadtree import PatchFrame

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

_EDGES = ((-1, 0), (1, 0), (0, -1), (0, 1))


@dataclass(frozen=True)
class Choice:
    """Chunks to draw."""

    keys: list[ChunkKey]
    morph: Floats
    """(n,) 0: the chunk's own heights, 1: those of its parent's mesh."""
    drops: Floats
    """(n, 4) metres of the data that the skirts in the west, east, north and south have to hang down."""


class ChunkFrame(PatchFrame):
    """The chunks as the LOD camera of a frame sees them."""

    def __init__(self, maker: ChunkMaker, frame: Frame, tau: float, lowest: int) -> None:
        """`tau`: pixels that a chunk may be off; `lowest`: finest level of the tree that is used."""
        # the bounds below stand for those of the clipmap's nodes
        super().__init__(maker.tree, frame, cast(Any, None))
        self._maker = maker
        self._lowest = lowest
        self._scale = frame.pixels_per_radian(frame.lod) / tau

    def bounds(self, level: int, x: Ints, y: Ints) -> tuple[Floats, Floats]:
        """Lowest and highest true height (metres of the data) in chunks."""
        shift, survey = cell_shift(level), self._maker.survey
        at = y >> shift, x >> shift
        return survey.low[level][at].astype(np.float64), survey.high[level][at].astype(np.float64)

    def errors(self, level: int, x: Ints, y: Ints) -> Floats:
        """Metres (drawn ones, exaggerated) that chunks may be off."""
        # with curvature, flat triangles also pass under the bent ground, as far as a chord of the chunk's diagonal does
        diagonals = self._maker.tree.grid.metres @ np.array([[1.0, 1.0], [1.0, -1.0]]) * 2.0**level
        sag = self.frame.curvature_factor * float((diagonals**2).sum(axis=0).max()) / 4
        return self._maker.bound(level, x, y).astype(np.float64) * self.frame.exaggeration + sag

    def shares(self, level: int, x: Ints, y: Ints) -> Floats:
        """Screen-space errors rho (Houska 2019, equation 2.2) of chunks, over tau; infinite around the eye."""
        distance = self.distance(level, x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = self.errors(level, x, y) * self._scale / distance
        return np.where(np.isnan(shares), 0.0, shares)

    def wanted(self) -> list[ChunkKey]:
        """Chunks that are fine enough, and all above them, the coarsest first."""
        leaves = self._leaves()
        keys = set(leaves)
        top = self.tree.level_count - 1
        for key in leaves:
            keys.update(_above(key, top))
        return sorted(keys, reverse=True)

    def choose(self, resident: Container[ChunkKey], morph_range: float) -> Choice:
        """What to draw of the `resident` chunks: coarser ones where finer ones are not there yet."""
        keys = _drawable(self._leaves(), resident, self.tree.level_count - 1)
        level, x, y = np.array(keys, np.int64).reshape(-1, 3).T
        errors, morph = np.zeros(len(keys)), np.zeros(len(keys))
        for t in np.unique(level).tolist():
            at = np.flatnonzero(level == t)
            errors[at] = self.errors(t, x[at], y[at])
            if t + 1 < self.tree.level_count:
                share = self.shares(t, x[at], y[at])
                above = t + 1, x[at] >> 1, y[at] >> 1
                morph[at] = morphs(share, self.shares(*above), morph_range)
                errors[at] += morph[at] * (self.errors(*above) - errors[at])
        return Choice(keys, morph, _drops(level, x, y, errors / self.frame.exaggeration))

    def _leaves(self) -> list[ChunkKey]:
        def split(level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
            return (self.shares(level, x, y) > 1) & (level > self._lowest)

        leaves = self.select(split)
        return [
            ChunkKey(level, *place)
            for level, (x, y) in enumerate(leaves)
            for place in zip(x.tolist(), y.tolist(), strict=True)
        ]


def morphs(share: Floats, above: Floats, morph_range: float) -> Floats:
    """Morph factors from a chunk's and its parent's screen-space error over tau.

    1 where the parent has just become too coarse, 0 where the chunk itself is about to, and never so much that the
    morphed surface, whose error lies between the two, is off by more than tau.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        allowed = np.where(above > share, (1 - share) / (above - share), 1.0)
    return np.clip(np.minimum(1 - (above - 1) / morph_range, allowed), 0.0, 1.0)


def _drawable(leaves: list[ChunkKey], resident: Container[ChunkKey], top: int) -> list[ChunkKey]:
    """The leaves, or the nearest resident chunks above them, none below another."""
    if all(key in resident for key in leaves):
        return leaves
    found: set[ChunkKey] = set()
    for key in leaves:
        found.update(islice((other for other in (key, *_above(key, top)) if other in resident), 1))
    return sorted(key for key in found if not any(above in found for above in _above(key, top)))


def _above(key: ChunkKey, top: int) -> Iterator[ChunkKey]:
    """The chunks that a chunk is a part of, the finest first."""
    for level in range(key.level + 1, top + 1):
        step = level - key.level
        yield ChunkKey(level, key.x >> step, key.y >> step)


def _drops(level: Ints, x: Ints, y: Ints, errors: Floats) -> Floats:
    """(n, 4): a chunk's error and that of the worst chunk beyond each edge, which is as far as their edges gape."""
    drops = np.zeros((level.size, 4))
    numbers = level << 58 | y << 29 | x
    order = np.argsort(numbers)
    known = numbers[order]
    for edge, (dx, dy) in enumerate(_EDGES):
        open_ = np.flatnonzero((x + dx >= 0) & (y + dy >= 0))
        for step in range(int(np.ptp(level)) + 1 if level.size else 0):
            t, px, py = level[open_] + step, x[open_] + dx >> step, y[open_] + dy >> step
            number = t << 58 | py << 29 | px
            place = np.minimum(np.searchsorted(known, number), known.size - 1)
            met = known[place] == number
            one, other = open_[met], order[place[met]]
            gap = errors[one] + errors[other]
            np.maximum.at(drops, (one, edge), gap)
            np.maximum.at(drops, (other, edge ^ 1), gap)
            # a parent of its own is no neighbour: whatever lies beyond the edge is finer, and meets it from there
            own = (px == x[open_] >> step) & (py == y[open_] >> step)
            open_ = open_[~met & ~own]
    return drops
