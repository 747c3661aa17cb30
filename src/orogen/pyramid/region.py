"""One region of a level from the level below, band by band, with the bound of the error that each node makes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.keys import NODE_SIZE
from orogen.pyramid.reduce import (
    F32,
    column_errors,
    coverage_means,
    evened,
    extrapolated,
    filled,
    height_means,
    row_errors,
)

BAND = 256
"""Rows of finer samples that are worked on at once: few enough for the processor's cache."""


class Edges(NamedTuple):
    """On which sides a region ends where the raster ends."""

    top: bool
    bottom: bool
    left: bool
    right: bool


@dataclass(frozen=True)
class Strips:
    """The two outermost rows and columns of finer heights in a region: what its seams with others need."""

    top: F32
    """(2, columns)."""
    bottom: F32
    """(2, columns)."""
    left: F32
    """(rows, 2)."""
    right: F32
    """(rows, 2)."""


class Ringed(NamedTuple):
    """Heights with one more column, extrapolated, beyond each raster edge; finer samples there are NaN where the
    surface does not reach them, so that nothing is compared.
    """

    p: F32
    """(rows, m) coarse heights."""
    even: F32
    """(2 rows, m) the left finer sample of each coarse one."""
    odd: F32
    """(2 rows, m) the right one."""


class HeightRegion:
    """Takes bands of finer heights from top to bottom; then holds their means and the errors of the nodes."""

    def __init__(self, shape: tuple[int, int], edges: Edges, covered: bool, level: int) -> None:
        """shape: (rows, columns) of the finer heights; covered: no coverage is kept; level: that of the means."""
        rows, cols = -(-shape[0] // 2), -(-shape[1] // 2)
        self.means = np.empty((rows, cols), np.float32)
        self.coverage = None if covered else np.full((rows, cols), 255, np.uint8)
        self.steps = np.zeros((-(-rows // NODE_SIZE), -(-cols // NODE_SIZE)), np.float32)
        """(node rows, node columns): maximum of |finer - coarser surface| in each node, but for the region's seams."""
        self._edges = edges
        self._level = level
        self._row = 0
        self._last: Ringed | None = None
        self._top: F32 | None = None
        self._bottom: F32 | None = None
        self._sides: list[tuple[F32, F32]] = []

    def add(self, c: F32, coverage: NDArray[np.uint8] | None = None) -> None:
        """The next finer rows, at least 4 but for a raster with less: an even number, unless they end the raster."""
        self._top = c[:2].copy() if self._top is None else self._top
        self._bottom = c[-2:].copy()
        self._sides.append((c[:, :2].copy(), c[:, -2:].copy()))
        if np.isnan(c[0, 0]) and np.isnan(c).all():
            self._add_void(c.shape)
            return
        p, c = means_and_evened(c)
        rows = slice(self._row, self._row + p.shape[0])
        self.means[rows] = p
        if self.coverage is not None and coverage is not None and coverage.min() < 255:
            self.coverage[rows] = coverage_means(coverage)
        self._compare(ringed(p, c, self._edges.left, self._edges.right, self._level))
        self._row = rows.stop

    def _add_void(self, shape: tuple[int, int]) -> None:
        """What `add` comes to for nodata alone, without computing it."""
        rows = slice(self._row, self._row - (-shape[0] // 2))
        self.means[rows] = np.nan
        if self.coverage is not None:
            self.coverage[rows] = 0
        width = self.means.shape[1] + int(self._edges.left) + int(self._edges.right)
        heights = (min(2, rows.stop - rows.start), 2, 2)
        self._last = Ringed(*(np.full((height, width), np.nan, np.float32) for height in heights))
        self._row = rows.stop

    def finish(self) -> Strips:
        """Compare beyond the raster's last row too; what the seams with other regions need."""
        assert self._last is not None
        assert self._top is not None
        assert self._bottom is not None
        if self._edges.bottom:
            self._score(self._row - 1, between(self._last, beyond(self._last, self._level, below=True)))
        left, right = zip(*self._sides, strict=True)
        return Strips(self._top, self._bottom, np.concatenate(left), np.concatenate(right))

    def _compare(self, new: Ringed) -> None:
        above = beyond(new, self._level, below=False) if self._row == 0 and self._edges.top else self._last
        if above is not None:
            gap = between(above, new)
            self._score(self._row, gap)
            self._score(max(self._row - 1, 0), gap)
        self._score(self._row, np.fmax.reduce(column_errors(*new)))
        if len(new.p) > 1:
            samples, lines = row_errors(new.p, new.even[1:-1], new.odd[1:-1])
            self._score(self._row, cells(np.fmax.reduce(samples), np.fmax.reduce(lines)))
        self._last = Ringed(*(part[-2:].copy() for part in new))

    def _score(self, row: int, gaps: F32) -> None:
        """Raise the errors of the nodes at coarse `row` to those of the cells between its coarse columns."""
        steps = self.steps[row // NODE_SIZE]
        np.fmax(steps, node_maxima(gaps, len(steps), int(self._edges.left)), out=steps)


def means_and_evened(c: F32) -> tuple[F32, F32]:
    """The 2 x 2 means of finer heights, and those heights with even numbers of rows and columns and voids filled."""
    c = evened(evened(c, 0), 1)
    return height_means(c), filled(c)


def ringed(p: F32, c: F32, left: bool, right: bool, level: int) -> Ringed:
    """Coarse heights of `level` and the finer ones they came from, with the columns beyond the raster's edges."""
    p = filled(p)
    before, cols = int(left), p.shape[1]
    even, odd = np.empty((2, c.shape[0], before + cols + int(right)), np.float32)
    even[:, before : before + cols] = c[:, 0::2]
    odd[:, before : before + cols] = c[:, 1::2]
    if left:
        p = np.concatenate([extrapolated(p[:, :1], p[:, 1:2] if cols > 1 else p), p], axis=1)
    if right:
        p = np.concatenate([p, extrapolated(p[:, -1:], p[:, -2:-1] if cols > 1 else p[:, -1:])], axis=1)
    out = _reaches_out(level)
    if left:
        even[:, 0], odd[:, 0] = np.nan, extrapolated(c[:, 0], c[:, 1]) if out else np.nan
    if right:
        even[:, -1], odd[:, -1] = extrapolated(c[:, -1], c[:, -2]) if out else np.nan, np.nan
    return Ringed(p, even, odd)


def beyond(rows: Ringed, level: int, below: bool) -> Ringed:
    """The row beyond the raster's lower or upper edge."""
    order = -1 if below else 1
    p, even, odd = (part[::order][:2] for part in rows)
    p, even, odd = (extrapolated(part[:1], part[1:] if len(part) > 1 else part) for part in (p, even, odd))
    if not _reaches_out(level):
        even, odd = np.full((2, *even.shape), np.nan, np.float32)
    return Ringed(p, even, odd)


def _reaches_out(level: int) -> bool:
    """Whether the surface of the level below `level` is drawn beyond its outermost texel centres; level 0's is not."""
    return level > 1


def between(above: Ringed, below: Ringed) -> F32:
    """Errors in the cells between the last coarse row of `above` and the first of `below`: (m - 1,)."""
    parts = Ringed(*(np.concatenate([a[-1:], b[:1]]) for a, b in zip(above, below, strict=True)))
    samples, lines = row_errors(*parts)
    return cells(samples[0], lines[0])


def cells(samples: F32, lines: F32) -> F32:
    """(m - 1,) maxima of the cells between coarse columns, from those inside and on their two sides, which are (m,)."""
    return np.fmax(samples, np.fmax(lines[:-1], lines[1:]))


def node_maxima(gaps: F32, count: int, before: int) -> F32:
    """(count,) maxima of each node's cells, the half ones at its two sides included; `before` cells lie left of it."""
    starts = [max(0, node * NODE_SIZE - 1 + before) for node in range(count)]
    stops = [(node + 1) * NODE_SIZE + before for node in range(count)]
    return np.array([np.fmax.reduce(gaps[a:b], initial=0) for a, b in zip(starts, stops, strict=True)], np.float32)


def seam_errors(above: F32, below: F32, count: int, before: bool, after: bool, level: int) -> F32:
    """(count,) errors of the nodes of `level` along a seam, from the two rows of finer heights on either side of it.

    before, after: whether the raster ends where the rows start and end.
    """
    sides = [ringed(*means_and_evened(strip), before, after, level) for strip in (above, below)]
    return node_maxima(between(*sides), count, int(before))
