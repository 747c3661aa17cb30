"""Levels from a file's own overviews, which need no building.

Overviews are laid by their own scale: writers round their sizes and stretch them over the whole raster, so that their
samples are not those of the levels. A sample of a level is the mean of a finer overview over its texel.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.keys import level_count
from orogen.pyramid.reduce import F32, colour_means, extrapolated, height_means, srgb_tables
from orogen.source.contract import Overview, Source, overviews_of

MOST = 4.5
"""Samples of an overview along a texel of a level, at most: beyond, too much is read for a node."""
ONE = 0.9
"""Samples of an overview along a texel that count as one."""
COARSE = 2048
"""Rows and columns, at most, of an overview that is read whole to make the levels that are coarser than all of them."""
LAST = 8
"""Windows of heights that are kept: their coverage is asked for next."""
LEAST = 1e-6
"""Parts of a sample below which two edges are the same."""


@dataclass(frozen=True)
class _Whole:
    """Level 0, or an overview in memory."""

    shape: tuple[int, int]
    source: Source | NDArray[Any]

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        if isinstance(self.source, np.ndarray):
            return self.source[rows, cols]
        return self.source.read(rows, cols)


class OverviewLevels:
    """The levels of a source, from its overviews; `orogen.source.contract.Levels`."""

    exact = False
    """They are near to what building gives, and nothing is known of bounds."""
    chunked = True
    """Files are read by the block."""

    def __init__(self, source: Source, overviews: Sequence[Overview]) -> None:
        """`overviews`: at least one, the finest first."""
        self._source = source
        self._shape = source.grid.shape
        self._lock = threading.Lock()
        self._last: OrderedDict[tuple[int, ...], tuple[F32, F32]] = OrderedDict()
        self._overviews = [_Whole(self._shape, source), *overviews]
        # means of two by two samples hide where these lie; where reading is dear, one for one has to do. Sizes are
        # rounded either way
        self._least = 1.8 if source.direct else ONE

    @property
    def complete(self) -> bool:
        """Whether no level needs much more reading than there are samples in it."""
        if max(self._overviews[-1].shape) > COARSE:
            return False
        chosen = (self._finer(level, self._overviews) for level in range(1, level_count(self._shape)))
        return all(step <= MOST or overview is self._overviews[-1] for overview, step in chosen)

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest height (m) of the coarsest overview; 0 and 0 where all of it is nodata."""
        heights = self._coarse[0].read(slice(None), slice(None))
        valid = heights[np.isfinite(heights)]
        return (float(valid.min()), float(valid.max())) if valid.size else (0.0, 0.0)

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """The samples of a window of a level, as `Source.read` gives those of level 0."""
        if level == 0:
            return self._source.read(rows, cols)
        if self._source.kind == "colour":
            return self._colours(level, rows, cols)
        heights, _ = self._heights(level, rows, cols)
        return heights

    def read_coverage(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """The valid part, 0 to 255, of each sample of a window of heights."""
        _, valid = self._heights(level, rows, cols)
        return np.rint(valid * np.float32(255)).astype(np.uint8)

    def node_bounds(self, level: int, rows: slice, cols: slice) -> None:
        """Unknown: overviews do not say how high the samples are that they stand for."""

    def _heights(self, level: int, rows: slice, cols: slice) -> tuple[F32, F32]:
        """Means over texels, and the part of each that is valid."""
        key = level, rows.start, rows.stop, cols.start, cols.stop
        with self._lock:
            found = self._last.get(key)
        if found is None:
            found = _heights(self._window(level, rows, cols))
            with self._lock:
                self._last[key] = found
                while len(self._last) > LAST:
                    self._last.popitem(last=False)
        return found

    def _colours(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """Means over texels in linear light, weighted by alpha."""
        window = self._window(level, rows, cols)
        if window.plain:
            return window.means(window.values)
        to_linear, to_srgb = srgb_tables()
        alpha = window.values[..., 3].astype(np.float32)
        share = window.means(alpha)
        out = np.empty((*share.shape, 4), np.uint8)
        out[..., 3] = np.rint(share)
        for band in range(3):
            light = window.means(to_linear[window.values[..., band]] * alpha) / np.maximum(share, np.float32(LEAST))
            out[..., band] = to_srgb[np.rint(np.minimum(light, 1) * np.float32(len(to_srgb) - 1)).astype(np.intp)]
        return out

    def _window(self, level: int, rows: slice, cols: slice) -> _Window:
        overview, _ = self._finer(level, self._overviews)
        if overview is self._overviews[-1]:
            overview, _ = self._finer(level, self._coarse)
        axes = [
            _Axis.of(part, level, size, count)
            for part, size, count in zip((rows, cols), self._shape, overview.shape, strict=True)
        ]
        values = overview.read(*(axis.needed for axis in axes))
        return _Window(_extended(_extended(values, axes[0].beyond, 0), axes[1].beyond, 1), axes[0], axes[1])

    def _finer(self, level: int, overviews: Sequence[Overview]) -> tuple[Overview, float]:
        """The coarsest overview that is fine enough for a level, and its samples along a texel."""
        chosen = overviews[0], np.inf
        for overview in overviews:
            step = min(2**level * n / size for n, size in zip(overview.shape, self._shape, strict=True))
            if step > self._least or (step > ONE and chosen[1] > MOST):
                chosen = overview, step
        return chosen

    @cached_property
    def _coarse(self) -> list[_Whole]:
        """The coarsest overview and its means, down to a sample or two."""
        overview = self._overviews[-1]
        values = overview.read(slice(0, overview.shape[0]), slice(0, overview.shape[1]))
        means = height_means if self._source.kind == "height" else colour_means
        result = [_Whole(overview.shape, values)]
        while all(count % 2 == 0 for count in values.shape[:2]):
            values = means(values)  # type: ignore[arg-type]
            result.append(_Whole(values.shape[:2], values))
        return result


def overview_levels(source: Source) -> OverviewLevels | None:
    """Levels from the overviews of a source whose windows can be read, where they are fine and coarse enough."""
    rows, cols = source.block
    tiled = rows <= COARSE and cols <= COARSE and cols < source.grid.width
    overviews = overviews_of(source) if source.direct or tiled else ()
    if not overviews:
        return None
    levels = OverviewLevels(source, overviews)
    return levels if levels.complete else None


def _heights(window: _Window) -> tuple[F32, F32]:
    """Means over texels, and the part of each that is valid."""
    if not np.isnan(window.values.min()):
        total = window.means(window.values)
        return total, np.ones_like(total)
    valid = np.isfinite(window.values)
    total = window.means(np.where(valid, window.values, np.float32(0)))
    share = window.means(valid.astype(np.float32))
    with np.errstate(invalid="ignore"):
        return np.where(np.rint(share * 255) > 0, total / share, np.float32(np.nan)), share


@dataclass(frozen=True)
class _Axis:
    """Which samples of an overview lie under each texel of a level, along rows or columns."""

    needed: slice
    """The samples to read."""
    beyond: int
    """Samples past the last one: texels may reach past the raster."""
    index: NDArray[np.int64]
    """(texels, samples) numbers of the samples under each texel, from the first one needed."""
    weight: F32
    """(texels, samples) their parts of it."""

    @classmethod
    def of(cls, part: slice, level: int, size: int, count: int) -> _Axis:
        """`part`: texels of a level of `size` samples; `count`: samples of the overview."""
        step = 2**level * count / size
        edges = np.arange(part.start, part.stop + 1) * step
        first = np.floor(edges[:-1] + LEAST).astype(np.int64)
        taps = int(np.ceil((edges[1:] - first).max() - LEAST))
        index = first[:, None] + np.arange(taps)
        overlap = np.minimum(edges[1:, None], index + 1) - np.maximum(edges[:-1, None], index)
        weight = np.where(overlap > LEAST, overlap, 0.0)
        # a line through the last two samples goes on
        start = max(0, min(int(index[0, 0]), count - 2))
        stop = int(index[weight > 0].max()) + 1
        index = np.minimum(index, stop - 1) - start
        return cls(
            slice(start, min(stop, count)),
            max(0, stop - count),
            index,
            (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32),
        )

    def means(self, values: NDArray[Any], axis: int) -> NDArray[Any]:
        """Means over the texels along an axis."""
        if self.plain:
            return values.take(self.index[:, 0], axis)
        shape = [1] * values.ndim
        shape[axis] = -1
        total = values.take(self.index[:, 0], axis) * self.weight[:, 0].reshape(shape)
        for tap in range(1, self.index.shape[1]):
            total += values.take(self.index[:, tap], axis) * self.weight[:, tap].reshape(shape)
        return total

    @property
    def plain(self) -> bool:
        """Whether texels are samples."""
        return self.index.shape[1] == 1


@dataclass(frozen=True)
class _Window:
    """Samples of an overview under a window of texels."""

    values: NDArray[Any]
    rows: _Axis
    cols: _Axis

    @property
    def plain(self) -> bool:
        """Whether texels are samples."""
        return self.rows.plain and self.cols.plain

    def means(self, values: NDArray[Any]) -> NDArray[Any]:
        """Means over the texels of (rows, columns) values at the samples."""
        return self.cols.means(self.rows.means(values, 0), 1)


def _extended(values: NDArray[Any], beyond: int, axis: int) -> NDArray[Any]:
    """Values with some more along an axis: heights go on along the slope of the last two, colours repeat."""
    for _ in range(beyond):
        last = values.take([-1], axis)
        if values.ndim == 2 and values.shape[axis] > 1:
            last = extrapolated(last, values.take([-2], axis))
        values = np.concatenate([values, last], axis)
    return values
