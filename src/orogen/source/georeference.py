"""Where a raster lies: geotransform, CRS and true lengths become a `Grid`."""

from __future__ import annotations

import logging
import math
from typing import TYPE_CHECKING, Any

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.scale import ground_scale

if TYPE_CHECKING:
    from rasterio.crs import CRS

log = logging.getLogger("orogen")

STRETCH = 4.0
"""Warping that makes samples so many times longer or shorter is refused: the CRS is not made for that place."""

Transform = tuple[float, float, float, float, float, float]


def make_grid(
    width: int, height: int, transform: Transform | None, crs: CRS | None, spacing: float | None, name: str
) -> Grid:
    """The grid of a raster by its geotransform, or of square samples `spacing` metres apart from (0, 0) on."""
    if crs is not None and (crs.to_wkt().startswith(("GEOCCS", "VERT_CS", "VERTCRS", "GEODCRS"))):
        raise SourceError(f"{name}: expected a projected, geographic or local CRS, got {crs.to_string()}")
    if spacing is not None or transform is None:
        if spacing is None:
            log.warning("%s: has no georeference, taking 1 m between samples; give spacing= to change it", name)
        step = float(spacing or 1.0)
        if crs is not None and crs.is_geographic:
            raise SourceError(f"{name}: spacing= is in metres, {crs.to_string()} in degrees; give a projected crs=")
        if crs is not None:
            step /= float(crs.units_factor[1])
        transform = (step, 0.0, 0.0, 0.0, -step, step * height)
    elif crs is None and _like_degrees(width, height, transform):
        log.warning("%s: names no CRS but lies as if in degrees; give crs=EPSG:4326 if it is", name)
    a, b, c, d, e, f = transform
    x, y = a * width / 2 + b * height / 2 + c, d * width / 2 + e * height / 2 + f
    scale = ground_scale(crs, x, y, math.sqrt(abs(a * e - b * d)) or 1.0)
    try:
        return Grid(width, height, transform, crs.to_string() if crs is not None else None, scale)
    except SourceError as error:
        raise SourceError(f"{name}: {error}") from error


def affine(dataset: Any) -> Transform:
    """The geotransform of a rasterio dataset, in the order of rasterio's `Affine`."""
    t = dataset.transform
    a, b, c, d, e, f = (float(value) + 0.0 for value in (t.a, t.b, t.c, t.d, t.e, t.f))  # no -0
    return a, b, c, d, e, f


def same_place(one: CRS | None, other: CRS | None) -> bool:
    """Whether two CRSs place points alike, whatever their vertical parts are."""
    return one == other or (one is not None and other is not None and _horizontal(one) == _horizontal(other))


def check_stretch(own: Grid, warped: Grid, name: str) -> None:
    """SourceError where a grid that was warped to another CRS has samples of quite another length."""
    if not 1 / STRETCH < warped.spacing / own.spacing < STRETCH:
        raise SourceError(
            f"{name}: {warped.crs} does not suit its extent {own.bounds}: samples of {own.spacing:g} m would become "
            f"{warped.spacing:g} m; crop it first or give another crs="
        )


def _horizontal(crs: CRS) -> CRS:
    """The first part of a compound CRS."""
    from rasterio.crs import CRS

    from orogen.source.scale import element

    wkt = crs.to_wkt()
    if wkt.startswith("COMPD_CS"):
        part = element(wkt, "PROJCS") or element(wkt, "GEOGCS") or element(wkt, "LOCAL_CS")
        return CRS.from_wkt(part) if part else crs
    return crs


def _like_degrees(width: int, height: int, transform: Transform) -> bool:
    """Whether a raster lies within the range of longitudes and latitudes, with samples finer than a degree."""
    a, b, c, d, e, f = transform
    return (
        max(abs(a), abs(b), abs(d), abs(e)) <= 1
        and all(-360 <= x <= 360 for x in (c, c + a * width + b * height))
        and all(-90.5 <= y <= 90.5 for y in (f, f + d * width + e * height))
    )
