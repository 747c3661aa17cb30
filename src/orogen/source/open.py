"""Open what users have as a source of heights or colours."""

from __future__ import annotations

import logging
import os
from typing import Any, Literal, Protocol

from orogen.errors import SettingsError, SourceError
from orogen.source import arrays, files, labelled, mosaic, procedural, stored, synthetic, tiles
from orogen.source.contract import Source
from orogen.source.gdal import quietly
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.painted import Stops, open_painted

log = logging.getLogger("orogen")


class Opener(Protocol):
    """A kind of input: a module with these functions."""

    def recognises(self, data: Any) -> bool:
        """Whether `data` is of this kind; decided without reading it."""

    def open_height(self, data: Any, options: HeightOptions) -> Source:
        """Its heights; SourceError where they cannot be used."""

    def open_colour(self, data: Any, heights: Source, options: ColourOptions) -> Source:
        """Its colours, draped over `heights`; SourceError where they cannot be used."""


OPENERS: tuple[Opener, ...] = (synthetic, procedural, labelled, arrays, stored, tiles, mosaic, files)
"""The first that recognises the data opens it."""


def open_height(
    data: Any,
    *,
    spacing: float | None = None,
    height_scale: float | None = None,
    height_offset: float | None = None,
    nodata: float | None = None,
    vertical_units: str | None = None,
    crs: str | None = None,
    encoding: str | None = None,
    zoom: int | None = None,
    area: tuple[float, float, float, float] | None = None,
) -> Source:
    """A source of heights.

    data: path, URL or GDAL name of a raster, an open rasterio dataset, an array (rows, columns) of numpy or one like
    it, an xarray DataArray, "synthetic", or "procedural" (its size and seed: "procedural:size=65536,seed=3").
    spacing: metres between samples of a raster without georeference; replaces the geotransform of one that has it.
    height_scale, height_offset: metres = stored * scale + offset; they replace what the file says.
    nodata: stored value that means nodata; NaN: none but NaN. Replaces what the file says.
    vertical_units: unit of the stored heights, such as 'metre', 'foot', 'us-foot'; replaces what the file says.
    crs: CRS ('EPSG:n', WKT) of data that name none; data of another CRS are warped to it.
    encoding: how colours hold heights, "terrain-rgb" or "terrarium", where that is not recognised.
    zoom: of map tiles (a folder of {z}/{x}/{y}.png, or a path or URL with {z}, {x} and {y} or {-y}): the finest in a
    folder unless given. area: west, south, east, north in degrees of the part that is taken of them.

    Raises SourceError where the data cannot be used, SettingsError for options out of their range; the message names
    the file or option, the cause and what to do.
    """
    options = HeightOptions(
        spacing, height_scale, height_offset, nodata, vertical_units, crs, encoding, zoom, area
    )  # fmt: skip
    opener = _opener(data)
    if opener is not tiles and (zoom is not None or area is not None):
        name = data if isinstance(data, str | os.PathLike) else type(data).__name__
        raise SettingsError(f"{name}: zoom= and area= are for trees of map tiles; leave them out")
    with quietly():
        source = opener.open_height(data, options)
    if min(source.grid.shape) == 1:
        log.warning("%s: a single row or column of samples spans no surface, nothing will be seen of it", source.name)
    return source


def open_colour(
    data: Any,
    heights: Source,
    *,
    color_extent: Literal["pixels", "samples"] = "pixels",
    crs: str | None = None,
    ramp: Stops | None = None,
) -> Source:
    """A source of colours draped over `heights`.

    data: an image of 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGBA) bands of 8 or 16 bits or with a palette, as a path
    or dataset, or an array (rows, columns[, bands]). It is laid by its georeference; one of another CRS is warped.
    color_extent: where an image without georeference lies: over the pixel area of the heights ("pixels") or over the
    hull of the centres of their samples ("samples").
    crs: CRS of an image that names none; else that of the heights is taken.
    ramp: the colours of the values of a raster of one band, which `data` is then.

    Raises SourceError where the data cannot be used, SettingsError for options out of their range.
    """
    options = ColourOptions(color_extent, crs)
    with quietly():
        opener = _opener(data)
        if ramp is not None:
            return open_painted(opener, data, heights, options, ramp)
        return opener.open_colour(data, heights, options)


def _opener(data: Any) -> Opener:
    for opener in OPENERS:
        if opener.recognises(data):
            return opener
    raise SourceError(
        f"expected a path, an open rasterio dataset, an array of numpy or xarray, got {type(data).__name__}"
    )
