"""Trees of map tiles in web Mercator (EPSG:3857) as heights or colours: folders {z}/{x}/{y}.png and URL templates."""

from __future__ import annotations

import hashlib
import itertools
import logging
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.colours import ColourSource
from orogen.source.contract import Source
from orogen.source.georeference import make_grid, same_place
from orogen.source.heights import MASKED, Facts
from orogen.source.options import Area, ColourOptions, HeightOptions
from orogen.source.packed import encoding_named, packed, recognised
from orogen.source.scale import parse_crs
from orogen.source.survey import survey
from orogen.source.tilepixels import TilePixels
from orogen.source.tiletree import DEEPEST, LocalTiles, RemoteTiles, Template, Tile, open_tiles, template_of
from orogen.source.values import METRES, unit_name
from orogen.source.warp import WarpedSource, warped_grid

log = logging.getLogger("orogen")

CRS = "EPSG:3857"
"""Of all tiles."""
EDGE = math.pi * 6378137.0
"""Metres from the middle of the map to its edges."""
WHOLE = 4096
"""Tiles of a template that are taken without an area."""
SEARCHED = 16
"""Tiles of a server that are asked for to find one that exists, to learn size and encoding."""
REACH = 64
"""Tiles to each side of the middle that are looked into for one that exists."""

Range = tuple[int, int, int, int]
"""First column, first row, last column and last row of tiles."""


def recognises(data: Any) -> bool:
    """Whether `data` is a template or a folder of tiles."""
    return isinstance(data, str | os.PathLike) and template_of(data) is not None


def open_height(data: Any, options: HeightOptions) -> Source:
    """Heights of the finest zoom, or of `options.zoom`, where tiles are or in `options.area`."""
    if options.spacing is not None:
        raise SourceError(f"{data}: tiles have their georeference; leave spacing= out")
    pixels, grid, stamp = _opened(data, options.zoom, options.area, lossless=True)
    name = pixels.tiles.template.name
    encoding = options.encoding or _encoding(pixels, name)
    unit = unit_name(options.vertical_units or "metre")
    values = encoding_named(encoding).converted(options.height_scale, options.height_offset, METRES[unit])
    facts = Facts(grid=grid, name=name, dtype="int32", units=unit)
    known = survey(TileHeights(pixels), values, facts, doubt=False)
    source: Source = replace(known, fingerprint=stamp and f"{stamp}|{values}")
    if options.crs is None or same_place(parse_crs(options.crs), parse_crs(CRS)):
        return source
    return WarpedSource(source, warped_grid(grid, options.crs, name))


def open_colour(data: Any, heights: Source, options: ColourOptions) -> Source:
    """Colours of the coarsest zoom that is as fine as the heights, over them."""
    target = heights.grid.crs
    if target is None:
        raise SourceError(f"{data}: tiles cannot be laid over heights without a CRS; give crs=")
    area = _area_of(heights.grid)
    pixels, grid, stamp = _opened(data, _like(data, heights.grid, area), area, lossless=False)
    source: Source = ColourSource(
        pixels=pixels, grid=grid, name=pixels.tiles.template.name, dtype="uint8", units="", fingerprint=stamp
    )
    if same_place(parse_crs(target), parse_crs(CRS)):
        return source
    return WarpedSource(source, warped_grid(grid, target, source.name))


@dataclass(frozen=True)
class TileHeights:
    """Heights packed into the pixels of tiles."""

    pixels: TilePixels
    """The pixels."""
    sequential: bool = False
    """Tiles can be read from anywhere."""
    masked: bool = True
    """Where there is no tile there is no height."""

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) of a tile."""
        return self.pixels.block

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return self.pixels.direct

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.pixels.shape

    @property
    def overviews(self) -> tuple[TileHeights, ...]:
        """The coarser zooms, the finest first."""
        return tuple(TileHeights(coarser) for coarser in self.pixels.overviews)

    def read(self, rows: slice, cols: slice) -> MASKED:
        """The packed heights of a window."""
        return _unpacked(self.pixels.read(rows, cols))

    def overview(self, shape: tuple[int, int]) -> MASKED:
        """The whole at a coarser zoom."""
        return _unpacked(self.pixels.overview(shape))

    def close(self) -> None:
        """Release what is open."""
        self.pixels.close()


def _unpacked(pixels: Any) -> MASKED:
    return packed(np.moveaxis(pixels, 2, 0)), pixels[..., 3] == 255


def _opened(data: Any, zoom: int | None, area: Area | None, lossless: bool) -> tuple[TilePixels, Grid, str | None]:
    """The pixels of a tree of tiles at a zoom, their grid, and what changes with them where that can be known."""
    template = template_of(data)
    assert template is not None
    tiles = open_tiles(template)
    if not tiles.remote:
        zoom, span, zooms, stamp = _listed(template, zoom, area)
        sample = _sample(tiles, zoom, span, lossless, None)
    else:
        zoom, span = _asked(template, zoom, area)
        zooms, stamp = tuple(range(zoom - 1, -1, -1)), None
        sample = _sample(tiles, zoom, span, lossless, SEARCHED)
    if sample is None:
        raise SourceError(f"{template.name}: there is no tile at zoom {zoom} there; check zoom= and area=")
    size = sample.shape[0]
    if sample.shape[1] != size or size & (size - 1):
        raise SourceError(
            f"{template.name}: expected square tiles of 256 or 512 pixels, got {sample.shape[1]} x {size}"
        )
    left, top, right, bottom = span
    shape = (bottom - top + 1) * size, (right - left + 1) * size
    step = 2 * EDGE / (2**zoom * size)
    transform = step, 0.0, left * size * step - EDGE, 0.0, -step, EDGE - top * size * step
    grid = make_grid(shape[1], shape[0], transform, parse_crs(CRS), None, template.name)
    pixels = TilePixels(tiles, zoom, size, (top * size, left * size), shape, zooms, lossless)
    return pixels, grid, stamp and f"{stamp}|{grid.transform}|{grid.shape}"


def _asked(template: Template, zoom: int | None, area: Area | None) -> tuple[int, Range]:
    """The zoom and the tiles to take of a server, which cannot tell what it has."""
    if zoom is None:
        raise SourceError(f"{template.name}: expected the zoom of the tiles; give zoom= (servers of heights: 10 to 15)")
    span = _within(zoom, area)
    count = (span[2] - span[0] + 1) * (span[3] - span[1] + 1)
    if area is None and count > WHOLE:
        raise SourceError(
            f"{template.name}: the whole world at zoom {zoom} is {count} tiles; give area= (west, south, east, north "
            "in degrees), or a coarser zoom="
        )
    return zoom, span


def _sample(
    tiles: LocalTiles | RemoteTiles, zoom: int, span: Range, lossless: bool, most: int | None
) -> NDArray[np.uint8] | None:
    """A tile from about the middle of a range; None where there is none among `most`."""
    probe = TilePixels(tiles, zoom, 0, (0, 0), (0, 0), (), lossless)
    return probe.first(itertools.islice(_spiral(span, zoom), most))


def _listed(template: Template, zoom: int | None, area: Area | None) -> tuple[int, Range, tuple[int, ...], str]:
    """The zoom to take of a folder, the range of its tiles, the coarser zooms that cover it, and a stamp."""
    found: dict[int, set[tuple[int, int]]] = {}
    digest = hashlib.sha256()
    for (z, x, y), entry in template.tiles(None):
        found.setdefault(z, set()).add((x, y))
        if zoom is None or z <= zoom:
            status = entry.stat()
            digest.update(f"{z}/{x}/{y}|{status.st_size}|{status.st_mtime_ns}\n".encode())
    if not found:
        raise SourceError(f"{template.name}: there is no tile; check the path")
    zoom = max(found) if zoom is None else zoom
    if zoom not in found:
        raise SourceError(f"{template.name}: there is no tile of zoom {zoom}; there are {sorted(found)}")
    limit = _within(zoom, area)
    inside = [(x, y) for x, y in found[zoom] if limit[0] <= x <= limit[2] and limit[1] <= y <= limit[3]]
    if not inside:
        raise SourceError(f"{template.name}: no tile of zoom {zoom} lies in the area; check area=")
    xs, ys = [x for x, _ in inside], [y for _, y in inside]
    zooms = []
    for coarser in range(zoom - 1, -1, -1):
        drop = zoom - coarser
        if not {(x >> drop, y >> drop) for x, y in inside} <= found.get(coarser, set()):
            break
        zooms.append(coarser)
    return zoom, (min(xs), min(ys), max(xs), max(ys)), tuple(zooms), f"{template.text}|{digest.hexdigest()}"


def _within(zoom: int, area: Area | None) -> Range:
    """The tiles of a zoom that an area meets."""
    if not 0 <= zoom <= DEEPEST:
        raise SourceError(f"zoom: expected 0 to {DEEPEST}, got {zoom}")
    last = 2**zoom - 1
    if area is None:
        return 0, 0, last, last
    west, south, east, north = area

    def column(longitude: float) -> float:
        return (longitude + 180) / 360 * 2**zoom

    def row(latitude: float) -> float:
        return (1 - math.asinh(math.tan(math.radians(latitude))) / math.pi) / 2 * 2**zoom

    def clamped(value: float) -> int:
        return min(max(int(value), 0), last)

    return (
        clamped(column(west)), clamped(row(north)),
        clamped(math.ceil(column(east)) - 1), clamped(math.ceil(row(south)) - 1),
    )  # fmt: skip


def _spiral(span: Range, zoom: int) -> Iterator[Tile]:
    """Some tiles of a range, from its middle outwards."""
    x, y = (span[0] + span[2]) // 2, (span[1] + span[3]) // 2
    reach = range(-REACH, REACH + 1)
    places = sorted(itertools.product(reach, reach), key=lambda place: place[0] ** 2 + place[1] ** 2)
    return (
        (zoom, x + i, y + j) for i, j in places if span[0] <= x + i <= span[2] and span[1] <= y + j <= span[3]
    )  # fmt: skip


def _encoding(pixels: TilePixels, name: str) -> str:
    """The encoding of the tile in the middle."""
    left, top = pixels.origin[1] // pixels.size, pixels.origin[0] // pixels.size
    span = left, top, left + pixels.shape[1] // pixels.size - 1, top + pixels.shape[0] // pixels.size - 1
    for tile in itertools.islice(_spiral(span, pixels.zoom), SEARCHED):
        sample = pixels.first([tile])
        if sample is not None and (found := recognised(np.moveaxis(sample, 2, 0))):
            log.info("%s: taken as %s", name, found)
            return found
    raise SourceError(
        f"{name}: its tiles look like pictures, expected packed heights; give encoding='terrain-rgb' or 'terrarium', "
        "or drape them as color= instead"
    )


def _area_of(grid: Grid) -> Area:
    """The area of a grid in degrees, cut at the edges of the map."""
    from rasterio.warp import transform_bounds

    from orogen.source.gdal import GDAL_ERRORS

    try:
        west, south, east, north = transform_bounds(parse_crs(grid.crs or ""), parse_crs("EPSG:4326"), *grid.bounds)
    except GDAL_ERRORS as error:
        raise SourceError(f"tiles cannot be laid over heights in {grid.crs} ({error})") from error
    return (west, south, east, north) if west < east else (-180.0, south, 180.0, north)


def _like(data: Any, grid: Grid, area: Area) -> int:
    """The coarsest zoom whose tiles of 256 pixels are as fine as a grid, or the finest that there is."""
    middle = math.radians(min(max((area[1] + area[3]) / 2, -85.0), 85.0))
    zoom = min(max(math.ceil(math.log2(2 * EDGE * math.cos(middle) / (256 * grid.spacing))), 0), DEEPEST)
    template = template_of(data)
    assert template is not None
    tiles = open_tiles(template)
    if not tiles.remote:
        there = sorted({z for (z, _, _), _ in template.tiles(None)})
        return next((z for z in there if z >= zoom), there[-1] if there else zoom)
    while zoom > 0 and _sample(tiles, zoom, _within(zoom, area), False, SEARCHED) is None:
        zoom -= 1
    tiles.close()
    return zoom
