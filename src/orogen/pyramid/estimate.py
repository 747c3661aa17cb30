"""Coarse levels from a decimated read, for the time before the pyramid is built."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.keys import level_count, level_shape
from orogen.pyramid.reduce import colour_means, height_means
from orogen.source.contract import Source

SIZE = 1024
"""Rows and columns, at most, of the finest estimated level."""


class Estimate:
    """The coarse levels of a source, estimated; read once, when it is made."""

    def __init__(self, source: Source) -> None:
        shape = source.grid.shape
        self.level = estimated_level(shape)
        """The finest estimated level."""
        overview = source.overview(level_shape(shape, self.level))
        finest = _resampled(overview, shape, self.level)
        self._levels = [finest]
        means = height_means if source.kind == "height" else colour_means
        for _ in range(self.level + 1, level_count(shape)):
            self._levels.append(means(self._levels[-1]))  # type: ignore[arg-type]
        self.range: tuple[float, float] | None = None
        """Lowest and highest height (m) of a source of heights, where there is a valid sample."""
        if source.kind == "height" and not np.isnan(overview).all():
            self.range = float(np.nanmin(overview)), float(np.nanmax(overview))

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[np.generic]:
        """A window of a level not finer than `level`."""
        return self._levels[level - self.level][rows, cols]


def estimated_level(shape: tuple[int, int]) -> int:
    """The finest level that has at most SIZE rows and columns."""
    return next(level for level in range(64) if max(level_shape(shape, level)) <= SIZE)


def _resampled(overview: NDArray[np.generic], shape: tuple[int, int], level: int) -> NDArray[np.generic]:
    """Nearest samples of an overview, which has its own scale, at the centres of a level's texels."""
    index = []
    for size, own, count in zip(shape, overview.shape[:2], level_shape(shape, level), strict=True):
        centre = (np.arange(count) + 0.5) * 2**level
        index.append(np.clip((centre * own / size).astype(int), 0, own - 1))
    return overview[np.ix_(*index)]
