"""Vertical references: their names, units and directions. Heights are never shifted from one to another."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from orogen.errors import SourceError
from orogen.source.contract import Source
from orogen.source.scale import element
from orogen.source.values import METRES, unit_name

if TYPE_CHECKING:
    from rasterio.crs import CRS

log = logging.getLogger("orogen")

AXIS = re.compile(r"\s+(?:height|depth)(?:\s*\((?:m|cm|ft\w*)\))?$", re.IGNORECASE)
"""What EPSG's names of references tell of direction and unit, behind the datum: "NAVD88 depth (ftUS)"."""


@dataclass(frozen=True)
class Vertical:
    """The vertical part of a CRS."""

    name: str | None = None
    """Name of the reference, or None where the CRS has no vertical part."""
    unit: str | None = None
    """Name of its unit as the CRS spells it."""
    down: bool = False
    """Whether its values grow downwards, as depths do."""


def vertical_reference(crs: CRS | None) -> Vertical:
    """The vertical part of a compound or three-dimensional CRS."""
    if crs is None:
        return Vertical()
    wkt = crs.to_wkt()
    if vertical := element(wkt, "VERT_CS") or element(wkt, "VERTCRS"):
        name = re.match(r'\w+\["([^"]*)"', vertical)
        unit = re.search(r'(?<!ANGLE)UNIT\["([^"]*)"', vertical)
        down = re.search(r'AXIS\["[^"]*",\s*DOWN', vertical, re.IGNORECASE)
        return Vertical(name[1] if name else None, unit[1] if unit else None, down is not None)
    axis = re.search(r'AXIS\["ellipsoidal height[^"]*",\s*up[^]]*\][^]]*?UNIT\["([^"]*)"', wkt, re.IGNORECASE)
    if "CS[ellipsoidal,3]" in wkt:
        name = re.match(r'\w+\["([^"]*)"', wkt)
        return Vertical(f"{name[1] if name else 'unknown'} (ellipsoidal height)", axis[1] if axis else "metre")
    return Vertical()


def vertical_unit(given: str | None, band: str | None, vertical: str | None, name: str) -> str:
    """The unit of stored heights: as given, else as the band says, else as the vertical CRS says, else metres."""
    if given is not None:
        return unit_name(given)
    for text in (band, vertical):
        if text and text.lower() not in ("unknown", "unspecified", "none"):
            try:
                return unit_name(text)
            except SourceError:
                log.warning("%s: unknown vertical unit %r taken as metres; give vertical_units=", name, text)
    return "metre"


def same_datum(one: str, other: str) -> bool:
    """Whether two references, by their names, count from the same surface, in whatever unit and direction."""
    return AXIS.sub("", one) == AXIS.sub("", other)


def require_alike(sources: Iterable[Source]) -> None:
    """SourceError where two sources of heights name different vertical datums; one that names none fits any."""
    named: Source | None = None
    for source in sources:
        if source.vertical_crs is None:
            continue
        if named is not None and not same_datum(source.vertical_crs, named.vertical_crs or ""):
            raise SourceError(
                f"{source.name}: its heights refer to {source.vertical_crs!r}, those of {named.name} to "
                f"{named.vertical_crs!r}; heights are never shifted between references: convert one of them (gdalwarp)"
            )
        named = source


def metres_per_unit(unit: str, down: bool) -> float:
    """Metres upwards per stored unit."""
    return -METRES[unit] if down else METRES[unit]
