"""What hides what: lines of sight between points, and rasters of them.

A line of sight is the straight line between its ends over ground that drops by (1 - refraction) d^2 / 2R with the
distance d from one of them: the drop of pictures with curvature, lessened by the bending of light in the air. Which end
it is makes no difference. The line is clear where it nowhere passes under the surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.grid import EARTH_RADIUS, Grid
from orogen.queries.blocks import Blocks
from orogen.queries.march import Rays, first_hits

F64 = NDArray[np.float64]
REFRACTION = 0.13
"""Part of the earth's curvature that the air's refraction makes up for, in usual weather."""
HIDDEN, VISIBLE, UNKNOWN = 0, 1, 255
"""Values of rasters of visibility; unknown: nodata, or too far."""


@dataclass(frozen=True)
class Sight:
    """Lines of sight; every array has the shape of the lines, a single line gives arrays of shape ()."""

    visible: NDArray[np.bool_]
    """Whether one end is seen from the other; false where an end lies outside the data or in a void."""
    known: NDArray[np.bool_]
    """Whether there is data all the way: where not, nothing is known to hide the end, but something may."""
    distance: F64
    """Metres between the ends along the geodesic."""
    obstacle: F64
    """(..., 3) x, y in the data's CRS and height (m) where a line from a to b is stopped; NaN where it is not."""


def bend_of(curvature: bool, refraction: float) -> float:
    """The drop of the ground is this times the squared distance."""
    if not (math.isfinite(refraction) and 0 <= refraction < 1):
        raise SettingsError(f"refraction: expected 0 to 1, such as 0.13, got {refraction:g}")
    return (1 - refraction) * 0.5 / EARTH_RADIUS if curvature else 0.0


def lines(grid: Grid, a: F64, b: F64, bend: float) -> Rays:
    """Lines from a to b, (3, n) texel coordinates and height (m), for t from 0 to 1."""
    columns, rows, rise = b - a
    drop = bend * _squared_length(grid, columns, rows)
    values = np.stack([a[0] - 0.5, a[1] - 0.5, columns, rows, a[2], rise - drop, drop])
    return Rays(values, np.zeros(len(drop)), np.ones(len(drop)))


def rays(grid: Grid, origin: F64, direction: F64, bend: float) -> Rays:
    """Rays from (3, n) texel coordinates and height (m) in directions (3, n) of metres east, north and up."""
    east, north, up = direction
    to = grid.texels
    columns, rows = to[0, 0] * east + to[0, 1] * north, to[1, 0] * east + to[1, 1] * north
    values = np.stack([origin[0] - 0.5, origin[1] - 0.5, columns, rows, origin[2], up, bend * (east**2 + north**2)])
    return Rays(values, np.zeros(len(up)), np.full(len(up), np.inf))


def _squared_length(grid: Grid, columns: F64, rows: F64) -> F64:
    (a, b), (c, d) = grid.metres
    return (a * columns + b * rows) ** 2 + (c * columns + d * rows) ** 2


def seen_from(
    grid: Grid, blocks: Blocks, eye: tuple[float, float, float], rows: slice, cols: slice, wanted: NDArray[np.bool_],
    ground: NDArray[np.float32], target_height: float, bend: float,
) -> NDArray[np.uint8]:  # fmt: skip
    """Visibility of the `wanted` samples of a window from an eye (texel coordinates and height).

    ground: their heights (NaN: void). An exact line of sight to each: through no grid of horizons.
    """
    result = np.full(wanted.shape, UNKNOWN, np.uint8)
    j, i = np.nonzero(wanted & ~np.isnan(ground))
    ends = np.stack([i + cols.start + 0.5, j + rows.start + 0.5, ground[j, i] + np.float64(target_height)])
    hits = first_hits(blocks, lines(grid, np.broadcast_to(eye, ends.shape[::-1]).T, ends, bend), grid.shape, sight=True)
    result[j, i] = np.where(np.isnan(hits), VISIBLE, HIDDEN)
    return result


def sunlit(
    grid: Grid, blocks: Blocks, sun: tuple[float, float], rows: slice, cols: slice, ground: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """Whether the sun, in a direction (azimuth from grid north, elevation) in degrees, is seen from samples."""
    azimuth, elevation = np.radians(sun)
    towards = np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    # along rows or columns exactly, so that rays on the edge of the data do not leave it for rounding
    towards[np.abs(towards) < 1e-15] = 0.0
    result = np.full(ground.shape, UNKNOWN, np.uint8)
    j, i = np.nonzero(~np.isnan(ground))
    places = np.stack([i + cols.start + 0.5, j + rows.start + 0.5, ground[j, i]])
    to_sun = rays(grid, places, np.broadcast_to(towards, places.shape[::-1]).T, 0.0)
    hits = first_hits(blocks, to_sun, grid.shape, sight=True)
    result[j, i] = np.where(np.isnan(hits), VISIBLE, HIDDEN)
    return result
