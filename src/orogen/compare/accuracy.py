"""The rows about accuracy that `orogen bench` prints: an algorithm's pictures against the true ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.compare.cracks import find_cracks
from orogen.compare.surface_error import Spread, SurfaceError, surface_error
from orogen.compare.truth import TrueSurface
from orogen.frame import Frame

MEAN_TARGET = 0.15
"""Screen-space error, mean (pixels)."""
P99_TARGET = 0.6
"""Screen-space error of 99 % of the pixels (pixels)."""
BIN = 1e-3
"""Width of a histogram's bins (pixels): percentiles over several views are exact to this, and never too small."""
BINS = 100_000
"""Bins of a histogram; the last one also holds what is larger."""


@dataclass(frozen=True)
class Row:
    """One figure."""

    name: str
    """What was measured."""
    value: float
    """How much; NaN where there was nothing to measure."""
    unit: str
    """'px', '%' or '' for a count."""
    target: float | None = None
    """The value that must not be exceeded; None where the figure only informs."""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without a target."""
        return None if self.target is None else self.value <= self.target


@dataclass(frozen=True)
class ViewAccuracy:
    """The accuracy of one view, without its maps."""

    view: str
    """Name of the camera."""
    forward: Spread
    """Screen-space error of drawn points."""
    backward: Spread
    """Screen-space error of true visible points."""
    histograms: NDArray[np.int64]
    """(2, BINS) pixels by error, forward and backward."""
    cracks: int
    """Crack pixels."""
    lost: int
    """Pixels lost at outlines."""
    hidden: float
    """Share of true visible points that the drawn picture hides or lacks."""
    stray: float
    """Share of drawn pixels where there is no true surface."""
    skyline: float
    """Largest distance of the skylines (pixels); NaN without one."""


def measure(
    view: str,
    drawn: NDArray[np.floating],
    reference: NDArray[np.floating],
    frame: Frame,
    surface: TrueSurface,
    *,
    tolerance: int = 1,
) -> ViewAccuracy:
    """Compare one drawn picture with the true one; arguments as in `surface_error` and `find_cracks`."""
    error = surface_error(drawn, reference, frame, surface)
    cracks = find_cracks(drawn, reference, frame, tolerance=tolerance)
    return ViewAccuracy(
        view, error.forward, error.backward, _histograms(error),
        cracks.count, cracks.lost, error.hidden, error.stray, cracks.skyline_max,
    )  # fmt: skip


def rows(views: Sequence[ViewAccuracy]) -> list[Row]:
    """The figures over all views together, those with a target first. At least one view."""
    forward, backward = sum((view.histograms for view in views), np.zeros((2, BINS), np.int64))
    skylines = [view.skyline for view in views if not math.isnan(view.skyline)]
    return [
        Row("cracks", sum(view.cracks for view in views), "", 0),
        Row("error of drawn points, mean", _mean([view.forward for view in views]), "px", MEAN_TARGET),
        Row("error of drawn points, 99 %", _percentile(forward, 0.99), "px", P99_TARGET),
        Row("error of true points, mean", _mean([view.backward for view in views]), "px", MEAN_TARGET),
        Row("error of true points, 99 %", _percentile(backward, 0.99), "px", P99_TARGET),
        Row("error of drawn points, 99 %, worst view", max(view.forward.p99 for view in views), "px"),
        Row("error of true points, 99 %, worst view", max(view.backward.p99 for view in views), "px"),
        Row("true points hidden, worst view", 100 * max(view.hidden for view in views), "%"),
        Row("drawn points outside the true surface, worst view", 100 * max(view.stray for view in views), "%"),
        Row("pixels lost at outlines", sum(view.lost for view in views), ""),
        Row("skyline apart, worst view", max(skylines, default=math.nan), "px"),
    ]


def _histograms(error: SurfaceError) -> NDArray[np.int64]:
    maps = (error.forward_map, error.backward_map)
    bins = [np.minimum(values[~np.isnan(values)] / BIN, BINS - 1).astype(np.int64) for values in maps]
    return np.stack([np.bincount(part, minlength=BINS) for part in bins])


def _mean(spreads: Sequence[Spread]) -> float:
    count = sum(spread.count for spread in spreads)
    return sum(spread.mean * spread.count for spread in spreads if spread.count) / count if count else math.nan


def _percentile(histogram: NDArray[np.int64], share: float) -> float:
    total = np.cumsum(histogram)
    if not total[-1]:
        return math.nan
    return float(np.searchsorted(total, share * total[-1]) + 1) * BIN
