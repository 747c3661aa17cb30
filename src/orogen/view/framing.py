"""Where a camera stands to show a data set, or a part of it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.grid import Grid

MARGIN = 0.03
"""Part of the picture that automatic framing leaves free on every side."""

NEAREST = 0.02
"""Least depth of what automatic framing shows, as a part of its longest extent (of one metre where it has none)."""
BOUNDS_SAMPLES = 16
"""Heights are looked up on this many points along each side of `bounds`."""


def frame_camera(
    grid: Grid,
    height_range: tuple[float, float],
    *,
    look_at: tuple[float, float] | None = None,
    distance: float | None = None,
    heading: float = 330.0,
    pitch: float = -35.0,
    fov: float = 45.0,
    orthographic: bool = False,
    bounds: tuple[float, float, float, float] | None = None,
    exaggeration: float = 1.0,
    aspect: float = 16 / 9,
    covered: float = 0.0,
    height_at: Callable[[float, float], float] | None = None,
) -> Camera:
    """A camera that shows the data of `grid` between the heights `height_range` (metres, before exaggeration).

    With neither `look_at` nor `distance` the whole data, or the part within `bounds`, fills the picture: of all cameras
    with this direction it is the nearest one that sees all corners of the data's box, with a small margin.
    `look_at` (x, y in the data's CRS) is the point on the ground in the middle of the picture and `distance` (metres)
    how far in front of the camera it lies; with one of them alone, the other is the middle of the data, or the
    distance of the camera that shows all of it.

    `heading` is in degrees clockwise from grid north, `pitch` in degrees above the horizon, `fov` the vertical angle
    of view in degrees. An orthographic camera shows, at the looked-at point, what the perspective one would.
    `bounds` is (left, bottom, right, top) in the data's CRS, `aspect` width / height of the picture, `covered` the part
    of its width, from 0 to 0.9, that something hides on the left: what is to fill the picture fills the rest.
    `height_at` gives the height in metres at (x, y), NaN where there is none: that of the looked-at point and the range
    within `bounds`; without it the ground is at the middle of `height_range`.

    Raises SettingsError, naming the option, for values that are not finite or out of range.
    """
    for name, place, count in (("look_at", look_at, 2), ("bounds", bounds, 4)):
        if place is not None and np.shape(place) != (count,):
            raise SettingsError(f"{name}: expected {count} numbers, got {place}")
    _check_finite(look_at=look_at, distance=distance, heading=heading, pitch=pitch, fov=fov, bounds=bounds)
    _check_finite(exaggeration=exaggeration, aspect=aspect, covered=covered, height_range=height_range)
    if distance is not None and distance <= 0:
        raise SettingsError(f"distance: expected more than 0 metres, got {distance:g}")
    for name, factor in (("exaggeration", exaggeration), ("aspect", aspect)):
        if factor <= 0:
            raise SettingsError(f"{name}: expected more than 0, got {factor:g}")
    if not 0 <= covered <= 0.9:
        raise SettingsError(f"covered: expected 0 to 0.9 of the width, got {covered:g}")
    flat = _outline(grid, bounds)
    x, y = (float(v) for v in flat.mean(axis=0))
    camera = Camera(x, y, 0.0, heading=heading, pitch=pitch, fov=fov)
    low, high = _heights_within(bounds, height_range, height_at)
    ground = (flat - (x, y)) * grid.ground_scale
    corners = np.array([(e, n, z * exaggeration) for e, n in ground for z in (low, high)])
    eye, depth = fit(camera, corners, aspect, orthographic, covered)
    if look_at is None and distance is None:
        shown = displaced(camera, grid, eye)
    else:
        depth = distance or depth
        x, y = look_at or (x, y)
        z = height_at(x, y) if height_at else math.nan
        target = camera.moved(x=x, y=y, z=(z if math.isfinite(z) else (low + high) / 2) * exaggeration)
        shown = displaced(target, grid, -depth * camera.basis[2])
    if orthographic:
        return shown.moved(orthographic=2 * depth * math.tan(math.radians(fov) / 2))
    return shown


def fit(
    camera: Camera, points: NDArray[np.float64], aspect: float, orthographic: bool = False, covered: float = 0.0
) -> tuple[NDArray[np.float64], float]:
    """Nearest position from which a camera of this direction and angle of view sees all `points`, with a margin.

    They are seen right of the part of the width that is `covered`.

    `points` is (n, 3) metres (east, north, up); the camera's own position does not count. Gives the position in the
    same coordinates and the depth of the points' middle in front of it. For an orthographic camera that depth is the
    one at which the angle of view spans the visible height.
    """
    right, up, forward = (points @ axis for axis in camera.basis)
    full = math.tan(math.radians(camera.fov) / 2)
    half = full * (1 - 2 * MARGIN)
    # tangents of the angles from the view axis to both sides
    sides = ((half - 2 * covered * full) * aspect, half * aspect), (half, half)
    middle_depth = float(forward.min() + forward.max()) / 2
    position = np.zeros(3)
    depths = []
    for index, (along, (below, above)) in enumerate(zip((right, up), sides, strict=True)):
        if orthographic:
            position[index] = (along.min() + along.max()) / 2
            depths.append(middle_depth - np.ptp(along) / (below + above))
            continue
        # two planes through the eye touch the points: along - eye >= -below (forward - depth), and its mirror image
        low, high = np.min(below * forward + along), np.min(above * forward - along)
        position[index] = (low - high) / 2
        depths.append((low + high) / (below + above))
    # a wide angle of view would have the camera in the nearest corner; an orthographic one has no place along its axis
    clear = NEAREST * max(float(np.ptp(points, axis=0).max()), 1.0)
    position[2] = min(*depths, (middle_depth if orthographic else float(forward.min())) - clear)
    # where one side sees less than the other, the points are between both only from aside
    for index, (below, above) in enumerate(sides):
        position[index] += (above - below) / 2 * (position[2] - (middle_depth if orthographic else 0.0))
    return position @ camera.basis, middle_depth - position[2]


def displaced(camera: Camera, grid: Grid, step: NDArray[np.float64]) -> Camera:
    """The camera moved by `step` metres (east, north, up)."""
    east, north, up = step.tolist()
    per_x, per_y = grid.ground_scale
    return camera.moved(x=camera.x + east / per_x, y=camera.y + north / per_y, z=camera.z + up)


def _outline(grid: Grid, bounds: tuple[float, float, float, float] | None) -> NDArray[np.float64]:
    """(4, 2): corners in the data's CRS."""
    if bounds is None:
        w, h = grid.width, grid.height
        return np.stack(grid.to_crs([0, w, w, 0], [0, 0, h, h]), axis=-1)
    left, bottom, right, top = bounds
    if left >= right or bottom >= top:
        raise SettingsError(f"bounds: expected left < right and bottom < top, got {bounds}")
    data = grid.bounds
    if right <= data[0] or left >= data[2] or top <= data[1] or bottom >= data[3]:
        raise SettingsError(f"bounds: expected a box that meets the data's {data}, got {bounds}")
    return np.array([(left, bottom), (right, bottom), (right, top), (left, top)])


def _heights_within(
    bounds: tuple[float, float, float, float] | None,
    height_range: tuple[float, float],
    height_at: Callable[[float, float], float] | None,
) -> tuple[float, float]:
    if bounds is None or height_at is None:
        return height_range
    left, bottom, right, top = bounds
    heights = np.array(
        [
            height_at(float(x), float(y))
            for x in np.linspace(left, right, BOUNDS_SAMPLES)
            for y in np.linspace(bottom, top, BOUNDS_SAMPLES)
        ]
    )
    heights = heights[np.isfinite(heights)]
    return (float(heights.min()), float(heights.max())) if heights.size else height_range


def _check_finite(**options: object) -> None:
    for name, value in options.items():
        try:
            good = value is None or bool(np.all(np.isfinite(np.asarray(value, np.float64))))
        except (TypeError, ValueError):
            good = False
        if not good:
            raise SettingsError(f"{name}: expected finite numbers, got {value}")
