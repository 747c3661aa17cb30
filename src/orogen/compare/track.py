"""Where a picture shows the surface over given places of the ground: the same place followed through a flight.

All points over and under a place project to one straight line, along which a height field seen from above only recedes
upwards, and reverse-z depth is affine (see surface_error). So the drawn surface is in front of the line below its place
and behind it above, and the place is found by walking along the line to the change of sign. Unlike there the walk
starts anywhere, not in the middle of a pixel, so depths are interpolated between four pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.compare import screen
from orogen.frame import Frame

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REACH = 64
"""Pixels up and down that a place is searched for."""
JUMP = 2.0
"""A step in depth is an outline, not a surface, where it is this many times the steps on both its sides."""
ROUNDING = 1e-6
"""Relative difference of depths that counts as none: float32 gives no better."""


@dataclass(frozen=True)
class Sighting:
    """What a picture shows over places of the ground, (n,) each."""

    risen: Floats
    """Pixels that the drawn surface lies above the point that was asked for; NaN where the place is not seen."""
    pixels: Floats
    """Pixels per metre of height at that point."""
    shrink: Floats
    """Relative growth of the distance per metre of height at that point: why pixels are not linear in height."""
    column: Floats
    row: Floats
    """Where the place is drawn, in pixels with centres at whole numbers."""

    def risen_by(self, metres: Floats) -> Floats:
        """Pixels that so many metres of height are."""
        return metres * self.pixels / (1 + metres * self.shrink)


def sight(frame: Frame, depth: Floats, x: Floats, y: Floats, z: Floats) -> Sighting:
    """Find the surface of a depth picture over and under points.

    `depth`: (height, width) reverse-z depths seen through `frame`, 0 for the sky. `x`, `y`: (n,) in the data's CRS,
    `z`: (n,) metres before exaggeration. A place is not seen where it is out of the picture, behind something, beside
    an outline, or farther than REACH pixels from the point.
    """
    clipped = screen.clip(frame, x, y, z)
    column, row = (values - 0.5 for values in screen.pixels(frame, clipped))
    right, down, rate = screen.vertical(frame, clipped)
    pixels = np.hypot(right, down)
    with np.errstate(divide="ignore", invalid="ignore"):
        own = clipped[..., 2] / clipped[..., 3]
        shrink = frame.view_projection[3, 2] * frame.exaggeration / clipped[..., 3]
        # seen along the vertical, height moves nothing on the screen
        end_on = pixels * screen.pixel_size(frame, own) < 1e-6
        line = _Line(column, row, right / pixels, down / pixels, own, rate / pixels)
    height, width = depth.shape
    shown = (clipped[..., 3] > 0) & (np.abs(column - (width - 1) / 2) <= (width - 1) / 2)
    shown &= np.abs(row - (height - 1) / 2) <= (height - 1) / 2
    risen = np.full(column.shape, np.nan)
    risen[shown & end_on] = 0.0
    walked = np.nonzero(shown & ~end_on)[0]
    risen[walked] = _walk(depth, line.at(walked))
    along = np.where(np.isnan(risen) | end_on, 0.0, risen)
    column, row = column + np.nan_to_num(along * line.right), row + np.nan_to_num(along * line.down)
    i, j, _, _ = _cell(depth, column, row)
    # beside an outline a place is known to a pixel only, which would look like a change
    risen[_outlines(depth)[j, i]] = math.nan
    return Sighting(risen, pixels, shrink, column, row)


def interpolate(picture: Floats, column: Floats, row: Floats) -> Floats:
    """(n,) values of a (height, width) picture between its pixels, whose centres are at whole numbers; NaN outside."""
    i, j, fx, fy = _cell(picture, column, row)
    (a, b), (c, d) = ((picture[j + n, i], picture[j + n, i + 1]) for n in (0, 1))
    upper, lower = a + fx * (b - a), c + fx * (d - c)
    return np.where(np.isnan(fx), np.nan, upper + fy * (lower - upper))


@dataclass(frozen=True)
class _Line:
    """Pictures of vertical lines, n of them, in steps of one pixel upwards."""

    column: Floats
    row: Floats
    right: Floats
    down: Floats
    depth: Floats
    slope: Floats
    """Reverse-z depth per step."""

    def at(self, k: NDArray[np.intp]) -> _Line:
        return _Line(*(getattr(self, name)[k] for name in self.__dataclass_fields__))

    def front(self, picture: Floats, steps: Floats) -> Floats:
        """Depth of the picture minus the line's: above 0 where something is drawn in front. NaN outside."""
        column, row = self.column + steps * self.right, self.row + steps * self.down
        value = interpolate(picture, column, row)
        i, j, fx, fy = _cell(picture, column, row)
        corners = [picture[j + n, i + m] for n in (0, 1) for m in (0, 1)]
        # beside the sky there is nothing to interpolate with
        nearest = picture[j + (fy > 0.5), i + (fx > 0.5)]
        value = np.where(np.minimum.reduce(corners) == 0, np.where(np.isnan(fx), np.nan, nearest), value)
        return value - (self.depth + steps * self.slope)


def _cell(picture: Floats, column: Floats, row: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats, Floats]:
    """The pixel at the upper left of four around a place, and the place between them (0 to 1; NaN outside)."""
    height, width = picture.shape
    with np.errstate(invalid="ignore"):
        outside = ~((column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1))
    column, row = np.where(outside, 0.0, column), np.where(outside, 0.0, row)
    i = np.minimum(column.astype(np.intp), width - 2)
    j = np.minimum(row.astype(np.intp), height - 2)
    return i, j, np.where(outside, np.nan, column - i), np.where(outside, np.nan, row - j)


def _walk(depth: Floats, line: _Line) -> Floats:
    """Steps, positive upwards, from the lines' starts to where the drawn surface crosses them; NaN: not found."""
    front = line.front(depth, np.zeros(line.row.size))
    side = np.sign(np.where(np.abs(front) <= ROUNDING * line.depth, 0.0, front))
    risen = np.where(side == 0, 0.0, math.nan)
    active = np.nonzero(np.abs(side) == 1)[0]
    before = front[active]
    for k in range(1, REACH + 1):
        if not active.size:
            break
        ahead = line.at(active).front(depth, side[active] * k)
        met = ahead * side[active] <= 0
        crossing = before[met] / (before[met] - ahead[met])
        risen[active[met]] = side[active[met]] * (k - 1 + crossing)
        going = ~met & ~np.isnan(ahead)
        active, before = active[going], ahead[going]
    return risen


def _outlines(depth: Floats) -> Bools:
    """(height - 1, width - 1): where an outline runs between four neighbouring pixels or one pixel beside them."""
    across, down = _jumps(depth), _jumps(depth.T).T
    here = across[:-1] | across[1:] | down[:, :-1] | down[:, 1:]
    near = here.copy()
    near[1:] |= here[:-1]
    near[:-1] |= here[1:]
    near[:, 1:] |= here[:, :-1]
    near[:, :-1] |= here[:, 1:]
    return near


def _jumps(depth: Floats) -> Bools:
    """(height, width - 1): steps to the right that are no surface."""
    step = np.abs(np.diff(depth, axis=1))
    padded = np.pad(step, ((0, 0), (1, 1)), mode="edge")
    sky = depth == 0
    return (step > JUMP * np.maximum(padded[:, :-2], padded[:, 2:])) | (sky[:, 1:] != sky[:, :-1])
