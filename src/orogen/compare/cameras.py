"""Twelve standard views of a data set, for measuring every algorithm alike."""

from __future__ import annotations

import numpy as np

from orogen.camera import Camera
from orogen.compare.truth import TrueSurface
from orogen.errors import SourceError
from orogen.grid import Grid


def standard_cameras(grid: Grid, surface: TrueSurface) -> dict[str, Camera]:
    """High, low, at the edge, straight down, looking up from a valley, outside the data ...: name to camera.

    `surface` lies over `grid`, without exaggeration. All cameras are above the surface; those outside are above its
    highest point. Deterministic. Raises SourceError where no sample is valid.
    """
    rows, columns = grid.shape
    heights = np.where(surface.valid, surface.filled, np.nan)
    if not surface.valid.any():
        raise SourceError("expected heights with at least one valid sample, got none")
    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    wide, deep = np.abs(grid.metres @ np.diag([columns, rows])).sum(axis=1)
    extent = float(max(wide, deep, grid.spacing))
    margin = max(2.0, 0.05 * grid.spacing)

    def ground(tx: float, ty: float) -> float:
        """Highest ground within two texels, so that a coarser surface does not swallow the camera."""
        i, j = int(np.clip(tx, 0, columns - 1)), int(np.clip(ty, 0, rows - 1))
        window = heights[max(j - 2, 0) : j + 3, max(i - 2, 0) : i + 3]
        return float(np.nanmax(window)) if np.isfinite(window).any() else high

    def over(tx: float, ty: float, above: float, **angles: float) -> Camera:
        x, y = grid.to_crs(tx, ty)
        return Camera(float(x), float(y), ground(tx, ty) + margin + above, **angles)

    def apart(east: float, north: float, z: float, **angles: float) -> Camera:
        """So many extents from the middle."""
        step = np.linalg.solve(grid.metres, np.array([east, north]) * extent)
        x, y = grid.to_crs(step[0] + columns / 2, step[1] + rows / 2)
        return Camera(float(x), float(y), z, **angles)

    def bearing(tx: float, ty: float) -> float:
        """Heading of a step in texels."""
        east, north = grid.metres @ np.array([tx, ty])
        return float(np.degrees(np.arctan2(east, north)))

    inner = np.full(grid.shape, np.nan)
    part = np.s_[rows // 4 : rows - rows // 4, columns // 4 : columns - columns // 4]
    inner[part] = heights[part]
    if not np.isfinite(inner).any():
        inner = heights
    valley_y, valley_x = np.unravel_index(np.nanargmin(inner), inner.shape)
    peak_y, peak_x = np.unravel_index(np.nanargmax(heights), heights.shape)
    valley = (float(valley_x) + 0.5, float(valley_y) + 0.5)
    to_peak = grid.metres @ (np.array([peak_x, peak_y]) - [valley_x, valley_y])
    heading = bearing(float(peak_x - valley_x), float(peak_y - valley_y))
    rise = float(np.degrees(np.arctan2(high - heights[valley_y, valley_x], np.hypot(*to_peak))))
    middle = (columns / 2, rows / 2)
    # a ray to the middle of the ground from 0.9 extents away
    tilt = -float(np.degrees(np.arctan2(0.45, 0.9)))
    return {
        "whole": apart(0.0, -0.9, low + 0.45 * extent, pitch=tilt),
        "high": over(*middle, 0.3 * extent, heading=120.0, pitch=-45.0),
        "low": over(*middle, 0.004 * extent, heading=200.0, pitch=-8.0),
        "eye level": over(*middle, 0.0, heading=300.0, pitch=0.0),
        "straight down": over(*middle, 0.5 * extent, heading=30.0, pitch=-90.0),
        "straight down, low": over(columns * 0.4, rows * 0.6, 6 * grid.spacing, pitch=-90.0),
        "valley": over(*valley, 0.0, heading=heading, pitch=max(rise, 3.0)),
        "summit": over(float(peak_x) + 0.5, float(peak_y) + 0.5, 0.0, heading=heading + 180.0, pitch=-12.0),
        "edge": over(0.5, rows / 2, 0.02 * extent, heading=bearing(1, 0) - 10, pitch=-10.0),
        "along the edge": over(columns - 0.5, rows - 0.5, 0.02 * extent, heading=bearing(0, -1), pitch=-10.0),
        "outside": apart(0.8, 0.3, high + 0.1 * extent, heading=249.0, pitch=-12.0),
        "rolled": over(columns * 0.3, rows * 0.3, 0.05 * extent, heading=135.0, pitch=-20.0, roll=35.0),
    }
