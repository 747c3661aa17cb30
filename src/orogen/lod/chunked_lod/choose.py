"""Which chunks a frame shows, how far each has morphed into its parent, and how deep its skirts hang."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.chunked_lod.chunks import ChunkKey, ChunkMaker
from orogen.lod.quadtree import Ints, Leaves, Level, PatchFrame, neighbours
from orogen.lod.resident import Residents, drawable, with_ancestors

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Choice:
    """Chunks to draw."""

    chunks: Leaves
    """(n,) each."""
    places: Ints
    """(n,) of these among the resident ones."""
    morph: Floats
    """(n,) 0: the chunk's own heights, 1: those of its parent's mesh."""
    drops: Floats
    """(n, 4) metres of the data that the skirts in the west, east, north and south have to hang down."""


class ChunkFrame(PatchFrame):
    """The chunks as the LOD camera of a frame sees them; heights are true ones, not those of the clipmap's nodes."""

    def __init__(self, maker: ChunkMaker, frame: Frame, tau: float, lowest: int) -> None:
        """`tau`: pixels that a chunk may be off; `lowest`: finest level of the tree that is used."""
        # what is divided is as near as its error asks for, but for the finest level
        divisible = np.arange(maker.tree.level_count) > lowest
        super().__init__(maker.tree, frame, maker.survey.ranges, np.where(divisible, 1.0, 0.0))
        self._maker = maker
        self._scale = frame.pixels_per_radian(frame.lod) / tau
        diagonals = maker.tree.grid.metres @ np.array([[1.0, 1.0], [1.0, -1.0]])
        # with curvature, flat triangles also pass under the bent ground, as far as a chord of the chunk's diagonal does
        self._sag = frame.curvature_factor * float((diagonals**2).sum(axis=0).max()) / 4

    def errors(self, level: Level, x: Ints, y: Ints) -> Floats:
        """Metres (drawn ones, exaggerated) that chunks may be off."""
        return self._maker.errors.at(level, x, y)[:, 0] * self.frame.exaggeration + self._sag * 4.0**level

    def shares(self, level: Level, x: Ints, y: Ints) -> Floats:
        """Screen-space errors rho (Houska 2019, equation 2.2) of chunks, over tau; infinite around the eye."""
        distance = self.distance(level, x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = self.errors(level, x, y) * self._scale / distance
        return np.where(np.isnan(shares), 0.0, shares)

    def divided(self, level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
        """Whether chunks are off by more than tau, and there are finer ones."""
        return (self.shares(level, x, y) > 1) & (self.reach[level] > 0)

    def rule(self, compiled: Any) -> Any:
        """The same for the module of compiled kernels."""
        return compiled.rule(compiled.ERROR, self.reach, self._scale, self._sag, self._maker.errors)

    def wanted(self) -> list[ChunkKey]:
        """Chunks that are fine enough, and all above them, the coarsest first."""
        return [ChunkKey(*key) for key in with_ancestors(self.leaves(), self.tree.level_count - 1)]

    def choose(self, residents: Residents[ChunkKey], morph_range: float) -> Choice:
        """What to draw of the resident chunks: coarser ones where finer ones are not there yet."""
        chunks, places = drawable(self.leaves(), residents)
        level, x, y = chunks
        top = self.tree.level_count - 1
        errors = self.errors(level, x, y)
        # the top has no parent, but itself
        step = (level < top).astype(np.int64)
        above = level + step, x >> step, y >> step
        morph = morphs(self.shares(level, x, y), self.shares(*above), morph_range) * step
        errors += morph * (self.errors(*above) - errors)
        return Choice(chunks, places, morph, _drops(chunks, errors / self.frame.exaggeration))


def morphs(share: Floats, above: Floats, morph_range: float) -> Floats:
    """Morph factors from a chunk's and its parent's screen-space error over tau.

    1 where the parent has just become too coarse, 0 where the chunk itself is about to, and never so much that the
    morphed surface, whose error lies between the two, is off by more than tau.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        allowed = np.where(above > share, (1 - share) / (above - share), 1.0)
    return np.clip(np.minimum(1 - (above - 1) / morph_range, allowed), 0.0, 1.0)


def _drops(chunks: Leaves, errors: Floats) -> Floats:
    """(n, 4): a chunk's error and that of the worst chunk beyond each edge, which is as far as their edges gape."""
    drops = np.zeros((errors.size, 4))
    beyond = neighbours(chunks, int(np.ptp(chunks.level)) if errors.size else 0)
    one, edge = np.nonzero(beyond >= 0)
    other = beyond[one, edge]
    gap = errors[one] + errors[other]
    drops[one, edge] = gap
    # several finer ones may lie beyond an edge, which meet it from there
    np.maximum.at(drops, (other, edge ^ 1), gap)
    return drops
