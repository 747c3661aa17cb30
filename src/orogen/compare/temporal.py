"""Temporal stability: how much the drawn surface moves over the same ground point from frame to frame.

The true surface stands still, so the change of a point's error is the change of the height that is drawn over it. It is
measured in pixels of the later frame, so that a static error is stable however the camera moves. A change is told
apart by the point's own past: what moves as it moved a frame earlier *swims*, what jumps *pops*.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orogen.compare import screen
from orogen.compare.track import interpolate, sight
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame

if TYPE_CHECKING:
    from orogen.view.renderer import Picture

Floats = NDArray[np.float64]

REACH = 2
"""Earlier frames that a frame is compared with."""
STRIDE = 2
"""Every so many pixels of every so many rows is followed: a quarter of the points tells as much."""
VISIBLE_JUMP = 0.5
"""Pixels that a point must move within a frame to pop."""
UNUSUAL = 4.0
"""Times the expected change that a point must move to pop."""
NEIGHBOURS = 4
"""Followed points to each side whose past tells what change is to be expected."""
STILL = 0.01
"""Pixels per frame: a camera that moves less stands still."""
FEWEST = 100
"""Points that must be seen in both frames for their change to mean anything."""


@dataclass(frozen=True)
class Stability:
    """How steady the drawn surface was between a frame and the one before."""

    count: int
    """Points that both frames show."""
    mean: float
    """Mean of |change| (pixels); NaN where too few points are seen in both frames."""
    p99: float
    """99 % of the points change by at most this (pixels)."""
    swimming: float
    """Mean of |change| over the points that do not pop (pixels); NaN without a frame before the one before."""
    popping: float
    """Share of the points that pop, 0 to 1; NaN without a frame before the one before."""


@dataclass(frozen=True)
class _Drawn:
    """What is kept of a frame."""

    frame: Frame
    depth: Floats
    """(height, width) reverse-z depth."""
    error: Floats
    """(height, width) metres that the drawn surface is too high; NaN where nothing is drawn or nothing true is."""
    position: Floats
    """(rows, columns, 3) of the followed pixels: x, y in the data's CRS, height in metres."""

    @classmethod
    def of(cls, frame: Frame, depth: NDArray[np.floating], surface: TrueSurface) -> _Drawn:
        exact: Floats = np.asarray(depth, np.float64)
        position = frame.positions(exact)
        tx, ty = frame.grid.to_texel(position[..., 0], position[..., 1])
        true = np.where(surface.coverage(tx, ty) >= 0.5, surface.height(tx, ty), math.nan)
        return cls(frame, exact, position[..., 2] - true, _followed(position))


class History:
    """The latest frames of a flight; they must come in order and in equal steps of time."""

    def __init__(self) -> None:
        self._frames: deque[_Drawn] = deque(maxlen=REACH)

    def clear(self) -> None:
        """Forget the flight so far: what follows is not compared with it (a cut)."""
        self._frames.clear()

    def add(self, drawn: Picture, surface: TrueSurface) -> Stability | None:
        """Add the next frame; tells how steady it was, None for the first.

        `surface`: the true surface over the frame's grid. Raises SettingsError where its shape is another one.
        """
        return self.add_depth(drawn.frame, drawn.reverse_depth, surface)

    def add_depth(self, frame: Frame, depth: NDArray[np.floating], surface: TrueSurface) -> Stability | None:
        """`add` for a (height, width) reverse-z depth, 0 for the sky, seen through `frame`."""
        if depth.shape != frame.size[::-1]:
            raise SettingsError(f"depth: expected a picture of shape {frame.size[::-1]}, got {depth.shape}")
        if surface.shape != frame.grid.shape:
            raise SettingsError(f"surface: expected the grid's shape {frame.grid.shape}, got {surface.shape}")
        latest = _Drawn.of(frame, depth, surface)
        earlier = list(self._frames)
        self._frames.append(latest)
        return _compare(latest, earlier) if earlier else None


def _compare(latest: _Drawn, earlier: list[_Drawn]) -> Stability:
    """`earlier`: the frame before the latest, last, and the one before that."""
    before = earlier[-1]
    change, motion = _change(before, latest)
    seen = ~np.isnan(change)
    size = np.abs(change[seen])
    if size.size < FEWEST:
        return Stability(size.size, *(math.nan,) * 4)
    swimming = popping = math.nan
    if len(earlier) == REACH:
        past, past_motion = _change(before, earlier[0])
        # a change in proportion to the camera's motion is no surprise
        expected = _smooth(np.abs(past)) * (motion / past_motion if past_motion > STILL else 1.0)
        known = size[~np.isnan(expected[seen])]
        if known.size >= FEWEST:
            popped = (known > VISIBLE_JUMP) & (known > UNUSUAL * expected[seen & ~np.isnan(expected)])
            popping = float(popped.mean())
            swimming = float(known[~popped].mean()) if not popped.all() else 0.0
    return Stability(size.size, float(size.mean()), float(np.percentile(size, 99)), swimming, popping)


def _change(points: _Drawn, other: _Drawn) -> tuple[Floats, float]:
    """How the drawn height over a frame's followed points differs in another frame, and how the camera moved.

    First (rows, columns) pixels of the other frame, NaN where it does not show the place; second the median of the
    pixels that the points move on the screen.
    """
    position, error = points.position.reshape(-1, 3), _followed(points.error).ravel()
    change = np.full(error.shape, math.nan)
    known = np.nonzero(np.isfinite(error))[0]
    if known.size < FEWEST:
        return change.reshape(points.position.shape[:2]), 0.0
    place = position[known].T
    sighting = sight(other.frame, other.depth, *place)
    # Depth between pixels is uncertain where the drawn surface is rough, error where it is smooth and the true one
    # rough. What has really changed shows in both, so the smaller change counts.
    by_error = sighting.risen_by(interpolate(other.error, sighting.column, sighting.row) - error[known])
    change[known] = np.where(np.abs(by_error) < np.abs(sighting.risen), by_error, sighting.risen)
    (c0, r0), (c1, r1) = (screen.pixels(frame, screen.clip(frame, *place)) for frame in (points.frame, other.frame))
    moved = np.hypot(c1 - c0, r1 - r0)
    motion = float(np.nanmedian(moved)) if np.isfinite(moved).any() else 0.0
    return change.reshape(points.position.shape[:2]), motion


def _followed(picture: Floats) -> Floats:
    start = STRIDE // 2
    return picture[start::STRIDE, start::STRIDE]


def _smooth(values: Floats) -> Floats:
    """Mean of the values around every one, NaN left out; NaN where there is none."""
    side = 2 * NEIGHBOURS + 1
    sums = []
    for part in (np.nan_to_num(values), (~np.isnan(values)).astype(np.float64)):
        total = np.pad(part, NEIGHBOURS + 1).cumsum(axis=0).cumsum(axis=1)[:-1, :-1]
        sums.append(total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(sums[1] > 0.5, sums[0] / sums[1], math.nan)
