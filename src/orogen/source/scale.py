"""Coordinate reference systems: names, units and the true length of a CRS unit."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from orogen.errors import SourceError
from orogen.grid import Grid

if TYPE_CHECKING:
    from rasterio.crs import CRS

WGS84 = (6378137.0, 1 / 298.257223563)
"""Semi-major axis (m) and flattening."""


def parse_crs(text: str) -> CRS:
    """The CRS that a user names ('EPSG:n', WKT, PROJ); SourceError where it is not known."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    from orogen.source.gdal import quietly

    try:
        with quietly():
            return CRS.from_user_input(text)
    except (CRSError, ValueError) as error:
        raise SourceError(f"crs: expected 'EPSG:n' or WKT, got {text!r} ({error})") from error


def ground_scale(crs: CRS | None, x: float, y: float, step: float) -> tuple[float, float]:
    """True metres per CRS unit along x and y at (x, y) on the CRS's own ellipsoid.

    `step` (CRS units) is the length over which a projected CRS is compared with the ellipsoid: about a sample.
    """
    if crs is None:
        return 1.0, 1.0
    radians = math.radians(1.0)
    axis, flattening = _ellipsoid(crs)
    if crs.is_geographic:
        radians = crs.units_factor[1]
        east, north = _metres_per_radian(min(max(y * radians, -1.5), 1.5), axis, flattening)
        return east * radians, north * radians
    linear = float(crs.units_factor[1])
    try:
        longitude, latitude = _geographic(crs, [x - step, x + step, x, x], [y, y, y - step, y + step])
    except SourceError:
        return linear, linear
    east, north = _metres_per_radian(math.radians(sum(latitude) / 4), axis, flattening)

    def length(i: int) -> float:
        turn = (longitude[i + 1] - longitude[i] + 180) % 360 - 180
        rise = latitude[i + 1] - latitude[i]
        return math.hypot(turn * radians * east, rise * radians * north) / (2 * step)

    along_x, along_y = length(0), length(2)
    usable = all(math.isfinite(v) and 0.01 < v / linear < 100 for v in (along_x, along_y))
    return (along_x, along_y) if usable else (linear, linear)


def distortion(grid: Grid, places: int = 9) -> tuple[float, float]:
    """Least and greatest true length over a raster, along x or y, against the one that `grid.ground_scale` gives.

    Looked at in `places` x `places` points from edge to edge; (1, 1) without a CRS.
    """
    crs = parse_crs(grid.crs) if grid.crs else None
    a, b, _, d, e, _ = grid.transform
    step = math.sqrt(abs(a * e - b * d))
    ratios = [1.0]
    for row in range(places):
        for column in range(places):
            # half a sample inside: a global raster's edge is a pole or the seam
            tx = 0.5 + (grid.width - 1) * column / (places - 1)
            ty = 0.5 + (grid.height - 1) * row / (places - 1)
            x, y = (float(axis) for axis in grid.to_crs(tx, ty))
            local = ground_scale(crs, x, y, step)
            ratios += [here / used for here, used in zip(local, grid.ground_scale, strict=True)]
    return min(ratios), max(ratios)


def _geographic(crs: CRS, x: list[float], y: list[float]) -> tuple[list[float], list[float]]:
    """Longitudes and latitudes in degrees on the geographic CRS that a projected one is based on."""
    from rasterio.crs import CRS
    from rasterio.warp import transform

    from orogen.source.gdal import GDAL_ERRORS

    base = element(crs.to_wkt(), "GEOGCS")
    if base is None:
        raise SourceError(f"no geographic CRS in {crs}")
    try:
        result = transform(crs, CRS.from_wkt(base), x, y)
    except GDAL_ERRORS as error:
        raise SourceError(f"cannot transform from {crs} ({error})") from error
    if not all(math.isfinite(v) for axis in result for v in axis):
        raise SourceError(f"{crs} is not defined at x {x[0]:g}, y {y[0]:g}")
    return result[0], result[1]


def _ellipsoid(crs: CRS) -> tuple[float, float]:
    """Semi-major axis (m) and flattening, WGS 84's where the CRS names none."""
    found = re.search(r'SPHEROID\["[^"]*",([-+.\deE]+),([-+.\deE]+)', crs.to_wkt())
    if not found:
        return WGS84
    inverse = float(found[2])
    return float(found[1]), 1 / inverse if inverse else 0.0


def _metres_per_radian(latitude: float, axis: float, flattening: float) -> tuple[float, float]:
    """Metres per radian of longitude and of latitude on an ellipsoid."""
    e2 = flattening * (2 - flattening)
    w = math.sqrt(1 - e2 * math.sin(latitude) ** 2)
    return axis / w * math.cos(latitude), axis * (1 - e2) / w**3


def element(wkt: str, keyword: str) -> str | None:
    """The text of the first element KEYWORD[...] of a WKT string."""
    start = wkt.find(keyword + "[")
    if start < 0:
        return None
    depth = 0
    quoted = False
    for i in range(start, len(wkt)):
        character = wkt[i]
        if character == '"':
            quoted = not quoted
        elif not quoted and character == "[":
            depth += 1
        elif not quoted and character == "]":
            depth -= 1
            if depth == 0:
                return wkt[start : i + 1]
    return None
