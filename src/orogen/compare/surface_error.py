"""Screen-space error: pixels between where a surface point is drawn and where it belongs, both ways.

Forward: a drawn point (x, y, z) belongs at (x, y, true height at x, y); both are projected, the error is their
distance. Backward: a true visible point (x, y, z) is drawn where the drawn surface passes over or under (x, y); that
place lies on the picture of the vertical line through the point and is found in the drawn depth picture.

Why that search is well posed: the picture of a vertical line is a straight line; along it, from below to above, the
drawn surface of a height field only recedes. So it crosses the vertical line once, at the pixel that is sought, or
jumps across it where a drawn ridge hides it. Reverse-z depth is an affine function of the pixel over a plane and along
a line, so interpolating it between pixels is exact for planes. Points that are seen from below (through a void, or
beneath the data's edge) have no such order and are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.compare import screen
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REACH = 64
"""Pixel steps that a place is searched for; one that is not found counts with that distance."""
JUMP = 2.0
"""A step in depth is a jump, not a surface, where it is this many times the steps on both its sides."""
ROUNDING = 1e-6
"""Relative difference of depths that counts as none: float32 and its interpolation give no better."""
STRAY = 1e-3
"""Texels beyond the extent, and coverage below one half, that float32 depths may cause."""
CHUNK = 1 << 18
"""Pixels that are searched at once, to bound memory."""


@dataclass(frozen=True)
class Spread:
    """How errors in pixels are distributed; NaN where there is none."""

    count: int
    """Pixels that were measured."""
    mean: float
    """Mean (pixels)."""
    p95: float
    """95 % of the pixels are at or below this (pixels)."""
    p99: float
    """99 % of the pixels are at or below this (pixels)."""
    max: float
    """Largest (pixels)."""
    over_one: float
    """Share of pixels above one pixel, 0 to 1."""

    @classmethod
    def of(cls, errors: NDArray[np.floating]) -> Spread:
        """The spread of an array of errors in pixels; NaN is left out."""
        values = errors[~np.isnan(errors)]
        if not values.size:
            return cls(0, *(math.nan,) * 5)
        p95, p99 = (float(v) for v in np.percentile(values, (95, 99)))
        return cls(values.size, float(values.mean()), p95, p99, float(values.max()), float((values > 1).mean()))


@dataclass(frozen=True)
class SurfaceError:
    """The screen-space error of a drawn picture."""

    forward: Spread
    """Drawn points against the true surface."""
    backward: Spread
    """True visible points against the drawn surface."""
    forward_map: Floats
    """(height, width) pixels; NaN where nothing is drawn or a drawn point has no place at all."""
    backward_map: Floats
    """(height, width) pixels; NaN where the true picture shows no terrain, or terrain from below."""
    hidden: float
    """Share of the true visible points whose place the drawn picture hides, by more than a pixel, or lacks."""
    stray: float
    """Share of the drawn pixels that lie where there is no true surface (outside the extent, in a void)."""
    missing: float
    """Share of the true picture's terrain pixels where nothing is drawn."""
    extra: float
    """Share of the drawn pixels where the true picture shows no terrain."""


def surface_error(
    drawn: NDArray[np.floating], reference: NDArray[np.floating], frame: Frame, surface: TrueSurface
) -> SurfaceError:
    """Compare a drawn picture with the true one.

    `drawn`, `reference`: (height, width) reverse-z depths, 0 for the sky, both seen through `frame`; `reference` shows
    the true surface. `surface`: the true surface over `frame.grid`. Raises SettingsError for shapes that do not fit.
    """
    drawn, reference = (np.asarray(picture, np.float64) for picture in (drawn, reference))
    width, height = frame.size
    for name, picture in (("drawn", drawn), ("reference", reference)):
        if picture.shape != (height, width):
            raise SettingsError(f"{name}: expected a depth picture of shape {(height, width)}, got {picture.shape}")
    if surface.shape != frame.grid.shape:
        raise SettingsError(f"surface: expected heights of the grid's shape {frame.grid.shape}, got {surface.shape}")
    forward_map, stray = _forward(drawn, frame, surface)
    backward_map, hidden = _backward(drawn, reference, frame, surface)
    terrain, covered = reference > 0, drawn > 0
    return SurfaceError(
        Spread.of(forward_map),
        Spread.of(backward_map),
        forward_map,
        backward_map,
        _share(hidden, terrain),
        _share(stray, covered),
        _share(terrain & ~covered, terrain),
        _share(covered & ~terrain, covered),
    )


def _share(part: Bools, whole: Bools) -> float:
    return float(part.sum()) / max(float(whole.sum()), 1.0)


def stray_pixels(drawn: NDArray[np.floating], frame: Frame, surface: TrueSurface) -> Bools:
    """(height, width): where a picture of reverse-z depths shows something beside the true surface or over a void."""
    x, y, _ = np.moveaxis(frame.positions(drawn), -1, 0)
    return _astray(drawn, *frame.grid.to_texel(x, y), surface)


def _astray(drawn: NDArray[np.floating], tx: Floats, ty: Floats, surface: TrueSurface) -> Bools:
    valid = surface.inside(tx, ty, STRAY) & (surface.coverage(*surface.clamp(tx, ty)) >= 0.5 - STRAY)
    return (drawn > 0) & ~valid


def _forward(drawn: Floats, frame: Frame, surface: TrueSurface) -> tuple[Floats, Bools]:
    x, y, _ = np.moveaxis(frame.positions(drawn), -1, 0)
    tx, ty = frame.grid.to_texel(x, y)
    stray = _astray(drawn, tx, ty, surface)
    # a point outside belongs on the edge: that keeps rounding small and real strays large
    tx, ty = surface.clamp(tx, ty)
    true_x, true_y = frame.grid.to_crs(tx, ty)
    clipped = screen.clip(frame, true_x, true_y, surface.height(tx, ty))
    column, row = screen.pixels(frame, clipped)
    width, height = frame.size
    error = np.hypot(column - (np.arange(width) + 0.5), row - (np.arange(height) + 0.5)[:, None])
    behind = (clipped[..., 3] <= 0) & (drawn > 0)
    return np.where(behind, math.hypot(width, height), np.minimum(error, math.hypot(width, height))), stray


def _backward(drawn: Floats, reference: Floats, frame: Frame, surface: TrueSurface) -> tuple[Floats, Bools]:
    error = np.full(reference.shape, np.nan)
    hidden = np.zeros(reference.shape, bool)
    position = frame.positions(reference)
    before = np.where(drawn == 0, np.inf, drawn)
    rows, columns = np.nonzero((reference > 0) & ~_from_below(frame, position, surface))
    for start in range(0, rows.size, CHUNK):
        at = rows[start : start + CHUNK], columns[start : start + CHUNK]
        clipped = screen.clip(frame, *np.moveaxis(position[at], -1, 0))
        line = _Line.through(frame, clipped, at, reference[at])
        front = drawn[at] - reference[at]
        front[np.abs(front) <= ROUNDING * reference[at]] = 0
        bare = drawn[at] == 0
        # background is behind what is below it (the sky) and in front of what is above it (the gap before a near edge)
        distance, unseen = np.where(front == 0, 0.0, np.inf), bare.copy()
        for picture, part in ((drawn, bare | (front > 0)), (before, bare | (front < 0))):
            chosen = np.nonzero(part)[0]
            length, concealed, found = _search(picture, line.at(chosen))
            better = (length < distance[chosen]) & (found | np.isinf(distance[chosen]))
            distance[chosen[better]], unseen[chosen[better]] = length[better], concealed[better]
        error[at], hidden[at] = distance, unseen
        # seen along the vertical, height moves nothing on the screen
        still = line.step == 0
        error[at] = np.where(still, 0.0, error[at])
        hidden[at] &= ~still | (drawn[at] == 0)
    return error, hidden


def _from_below(frame: Frame, position: Floats, surface: TrueSurface) -> Bools:
    """Where the surface is seen from below: the ray rises faster than the surface."""
    _, direction = frame.rays()
    tx, ty = frame.grid.to_texel(position[..., 0], position[..., 1])
    slope = np.stack(surface.gradient(*surface.clamp(tx, ty)), axis=-1) @ frame.grid.texels
    flat = np.stack([tx - frame.eye[0], ty - frame.eye[1]], axis=-1) @ frame.grid.metres.T
    bend = 2 * frame.curvature_factor * (flat * direction[..., :2]).sum(axis=-1)
    return (direction[..., 2] + bend) / frame.exaggeration > (slope * direction[..., :2]).sum(axis=-1)


@dataclass(frozen=True)
class _Line:
    """Pictures of vertical lines, n of them, in steps of one row or column upwards."""

    row: Floats
    column: Floats
    down: Floats
    """Rows per step."""
    right: Floats
    """Columns per step."""
    step: Floats
    """Pixels per step, 1 to sqrt 2; 0 where the line is seen end on."""
    depth: Floats
    slope: Floats
    """Reverse-z depth per step."""

    @classmethod
    def through(cls, frame: Frame, clipped: Floats, at: tuple[NDArray[np.intp], ...], depth: Floats) -> _Line:
        right, down, rate = screen.vertical(frame, clipped)
        longer = np.maximum(np.abs(right), np.abs(down))
        end_on = longer * screen.pixel_size(frame, depth) < 1e-6
        scale = 1 / np.where(end_on, np.inf, longer)
        right, down = right * scale, down * scale
        row, column = at[0].astype(np.float64), at[1].astype(np.float64)
        return cls(row, column, down, right, np.hypot(right, down), depth, rate * scale)

    def at(self, k: NDArray[np.intp]) -> _Line:
        return _Line(*(getattr(self, name)[k] for name in self.__dataclass_fields__))

    def sample(self, picture: Floats, steps: Floats | int) -> tuple[Floats, Floats]:
        """Depth of `picture` minus the line's (above 0: in front), and itself; NaN outside the picture.

        Between two pixels it is interpolated, except beside background (0 or infinite).
        """
        row, column = self.row + steps * self.down, self.column + steps * self.right
        height, width = picture.shape
        inside = (np.abs(row - (height - 1) / 2) <= height / 2) & (np.abs(column - (width - 1) / 2) <= width / 2)
        row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
        j, i = np.floor(row + 1e-6).astype(np.intp), np.floor(column + 1e-6).astype(np.intp)
        fx, fy = np.maximum(column - i, 0), np.maximum(row - j, 0)
        # one of the two is a whole number, so two pixels suffice
        f = np.maximum(fx, fy)
        first = picture[j, i]
        second = picture[np.minimum(j + (fy > fx), height - 1), np.minimum(i + (fx >= fy), width - 1)]
        product = first * second
        nearest = np.where(f < 0.5, first, second)
        with np.errstate(invalid="ignore"):
            value = np.where((product == 0) | np.isinf(product), nearest, first + f * (second - first))
        value = np.where(inside, value, np.nan)
        return value - (self.depth + steps * self.slope), value


def _search(drawn: Floats, line: _Line) -> tuple[Floats, Bools, Bools]:
    """Pixels from the lines' own pixels to where the drawn surface crosses them.

    Also tells whether the place is hidden, and whether it was found in the picture and within reach; else the distance
    is as far as the search went.
    """
    error = np.zeros(line.row.size)
    hidden = np.zeros(line.row.size, bool)
    inside = np.ones(line.row.size, bool)
    front, _ = line.sample(drawn, 0)
    active = np.nonzero((front != 0) & (line.step > 0))[0]
    side = np.sign(front)
    for k in range(1, REACH + 1):
        if not active.size:
            break
        ahead, _ = line.at(active).sample(drawn, side[active] * k)
        met = ~(ahead * side[active] > 0)
        done = active[met]
        fraction, hidden[done] = _cross(drawn, line.at(done), side[done], k)
        error[done] = (k - 1 + fraction) * line.step[done]
        inside[done] = ~np.isnan(ahead[met])
        active = active[~met]
    error[active] = REACH * line.step[active]
    hidden[active], inside[active] = True, False
    return error, hidden, inside


def _cross(drawn: Floats, line: _Line, side: Floats, k: int) -> tuple[Floats, Bools]:
    """Where between steps k - 1 and k the surface crosses the line (0 to 1), and whether it is hidden there."""
    front, value = zip(*(line.sample(drawn, side * n) for n in (k - 2, k - 1, k, k + 1)), strict=True)
    sky = [(v == 0) | np.isinf(v) for v in value]
    outside = np.isnan(front[2])
    with np.errstate(invalid="ignore", divide="ignore"):
        whole = front[2] - front[1]
        before = np.where(sky[0] | sky[1], np.nan, front[1] - front[0])
        after = np.where(sky[2] | sky[3], np.nan, front[3] - front[2])
        jump = sky[1] | sky[2] | (np.abs(whole) > JUMP * np.fmax(np.abs(before), np.abs(after)))
        # at a jump each side is prolonged; the nearer answer within the step counts, else its middle: hidden
        prolonged = np.fmin(_within(-front[1] / before), _within(1 - front[2] / after))
        fraction = np.where(jump, prolonged, -front[1] / whole)
        fraction = np.where(outside, np.clip(-front[1] / before, 0, 1), fraction)
    # just past the border the place is only out of the picture
    hidden = np.where(outside, sky[1] | (k > 1), jump & np.isnan(prolonged))
    return np.clip(np.where(np.isnan(fraction), 0.5, fraction), 0, 1), hidden


def _within(fraction: Floats) -> Floats:
    return np.where(np.abs(fraction - 0.5) <= 0.75, np.clip(fraction, 0, 1), np.nan)
