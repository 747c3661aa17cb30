"""How the user says that data is to be read."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Literal

from orogen.errors import SettingsError, SourceError
from orogen.source.packed import encoding_named
from orogen.source.scale import parse_crs
from orogen.source.values import unit_name

Area = tuple[float, float, float, float]
"""West, south, east and north in degrees of longitude and latitude."""


@dataclass(frozen=True)
class HeightOptions:
    """What replaces or completes what the data says of itself; None: as the data says."""

    spacing: float | None = None
    """Metres between samples."""
    height_scale: float | None = None
    """Factor on stored values."""
    height_offset: float | None = None
    """Added after the factor."""
    nodata: float | None = None
    """Stored value that means nodata; NaN: none but NaN."""
    vertical_units: str | None = None
    """Unit of the stored heights after factor and offset."""
    crs: str | None = None
    """CRS of data that name none; data of another CRS are warped to it."""
    encoding: str | None = None
    """How heights are packed into colours, "terrain-rgb" or "terrarium"; None: as is recognised."""
    zoom: int | None = None
    """Zoom of map tiles; None: the finest in a folder."""
    area: Area | None = None
    """Part of the world to take of map tiles; None: wherever there are tiles."""

    def __post_init__(self) -> None:
        for name in ("spacing", "height_scale", "height_offset", "nodata"):
            if not isinstance(value := getattr(self, name), Real | None):
                raise SettingsError(f"{name}: expected a number, got {value!r}")
        if self.spacing is not None and not (math.isfinite(self.spacing) and self.spacing > 0):
            raise SettingsError(f"spacing: expected metres above 0, got {self.spacing:g}")
        if self.height_scale is not None and not (math.isfinite(self.height_scale) and self.height_scale != 0):
            raise SettingsError(f"height_scale: expected a finite number other than 0, got {self.height_scale:g}")
        if self.height_offset is not None and not math.isfinite(self.height_offset):
            raise SettingsError(f"height_offset: expected a finite number, got {self.height_offset:g}")
        if self.encoding is not None:
            encoding_named(self.encoding)
        _check(unit_name, self.vertical_units)
        _check(parse_crs, self.crs)
        if self.area is not None:
            west, south, east, north = self.area
            if not (-180 <= west < east <= 180 and -90 <= south < north <= 90):
                raise SettingsError(f"area: expected (west, south, east, north) in degrees, got {self.area}")


@dataclass(frozen=True)
class ColourOptions:
    """How an image is laid over the heights."""

    color_extent: Literal["pixels", "samples"] = "pixels"
    """What an image without georeference covers: the pixel area of the heights or the hull of their centres."""
    crs: str | None = None
    """CRS of an image that names none; None: that of the heights."""

    def __post_init__(self) -> None:
        if self.color_extent not in ("pixels", "samples"):
            raise SettingsError(f"color_extent: expected 'pixels' or 'samples', got {self.color_extent!r}")
        _check(parse_crs, self.crs)


def _check(read: Callable[[str], object], text: str | None) -> None:
    """Raise SettingsError for a word of the user that nothing is known of: the data cannot be blamed for it."""
    try:
        if text is not None:
            read(text)
    except SourceError as error:
        raise SettingsError(str(error)) from error
