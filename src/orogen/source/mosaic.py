"""Several rasters as one: a list of them, a pattern such as "dem/*.tif", or a folder of rasters."""

from __future__ import annotations

import glob
import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from orogen.errors import NoSampleError, SettingsError, SourceError
from orogen.grid import Grid
from orogen.source import files
from orogen.source.contract import Source
from orogen.source.georeference import affine, make_grid, same_place
from orogen.source.names import is_local
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.parts import MosaicSource, Part
from orogen.source.raster import RasterFile, is_dataset, is_direct, open_raster
from orogen.source.scale import element, parse_crs
from orogen.source.turn import full_turn
from orogen.source.vertical import require_alike, vertical_reference
from orogen.source.warp import border, warped_grid

if TYPE_CHECKING:
    from rasterio.crs import CRS

SUFFIXES = {".tif", ".tiff", ".hgt", ".asc", ".img", ".dem", ".bil", ".flt", ".jp2", ".dt0", ".dt1", ".dt2"}
"""Of the rasters in a folder that are taken."""
ALIGNED = 0.01
"""Part of a sample by which two grids may be apart and still count as one."""
SCANNERS = 8
"""Headers that are read side by side."""


def recognises(data: Any) -> bool:
    """Whether `data` is a list of rasters, a pattern that names files, or a folder of rasters."""
    if isinstance(data, list | tuple):
        return all(isinstance(item, str | os.PathLike) or is_dataset(item) for item in data)
    if not isinstance(data, str | os.PathLike):
        return False
    name = os.fspath(data)
    if not is_local(name) or os.path.isfile(name):
        return False
    return bool(_rasters(name)) if os.path.isdir(name) else glob.has_magic(name)


def absolute(data: Any) -> Any:
    """Paths, patterns and lists of them as processes with another working folder understand them too."""
    if isinstance(data, list | tuple):
        return type(data)(absolute(part) for part in data)
    if isinstance(data, str | os.PathLike) and (os.path.exists(data) or recognises(data)):
        return os.path.abspath(data)
    return data


def open_height(data: Any, options: HeightOptions) -> Source:
    """Heights of all of them in the grid of the finest; where they overlap, the later one where it is valid."""
    items = _items(data)
    if len(items) == 1:
        return files.open_height(items[0], options)
    if options.spacing is not None:
        raise SettingsError(
            f"{_name(data, items)}: spacing= would lay all {len(items)} rasters over each other; leave it out"
        )
    with ThreadPoolExecutor(SCANNERS) as pool:
        parts = list(pool.map(lambda item: _scanned(item, options), items))
    require_alike(cast(Any, parts))
    name = _name(data, items)
    frame = _frame(parts, options.crs)
    grid, placed = _united(_together([_boxed(part, frame) for part in parts], frame), frame, name)
    source = MosaicSource(
        grid=grid, name=name, dtype="float32", parts=placed, options=options,
        vertical_crs=next((part.vertical_crs for part in parts if part.vertical_crs), None),
        fingerprint=_stamp(parts, grid, options), attribution=_credits(parts),
    )  # fmt: skip
    if all(source.part(number) is None for number in range(len(parts))):
        raise NoSampleError(
            f"{name}: none of its {len(parts)} rasters has a valid sample; give nodata= if that is wrong"
        )
    return source


def open_colour(data: Any, heights: Source, options: ColourOptions) -> Source:
    """All of them in the grid of the finest, in the CRS of the heights; where they overlap, the later one."""
    items = _items(data)
    if len(items) == 1:
        return files.open_colour(items[0], heights, options)
    with ThreadPoolExecutor(SCANNERS) as pool:
        parts = list(pool.map(lambda item: _scanned_image(item, heights, options), items))
    name = _name(data, items)
    frame = min((part.grid for part in parts), key=lambda grid: grid.spacing)
    grid, placed = _united([_boxed(part, frame) for part in parts], frame, name)
    grid = replace(grid, crs=heights.grid.crs, ground_scale=heights.grid.ground_scale)
    return MosaicSource(
        grid=grid, name=name, dtype="uint8", units="", parts=placed, options=options, heights=heights,
        fingerprint=_stamp(parts, grid, options), attribution=_credits(parts),
    )  # fmt: skip


def _items(data: Any) -> list[Any]:
    """The rasters of a list, a pattern or a folder."""
    if not isinstance(data, list | tuple):
        name = os.fspath(data)
        found = _rasters(name) if os.path.isdir(name) else sorted(glob.glob(name, recursive=True))
        if not found:
            raise SourceError(f"{name}: no file is named so; check the pattern")
        return list(found)
    items = [path for item in data for path in (_items(item) if recognises(item) else [item])]
    if not items:
        raise SourceError("expected one raster or more, got an empty list")
    return items


def _rasters(folder: str) -> list[str]:
    return sorted(entry.path for entry in os.scandir(folder) if Path(entry.name).suffix.lower() in SUFFIXES)


def _name(data: Any, items: list[Any]) -> str:
    if isinstance(data, str | os.PathLike):
        return os.fspath(data)
    return f"{_named(items[0])} and {len(items) - 1} more"


def _named(item: Any) -> str:
    return str(getattr(item, "name", item))


def _scanned(item: Any, options: HeightOptions) -> Part:
    """What the header of a raster says."""
    file: RasterFile = open_raster(item)
    with file.handle() as dataset:
        if dataset.transform.is_identity:
            raise SourceError(
                f"{file.path}: has no georeference, which a mosaic needs; add a geotransform (gdal_translate -a_ullr)"
            )
        files.packing(dataset, file.path, options)  # a picture among them is refused now, not when it is read
        own, wanted = dataset.crs, parse_crs(options.crs) if options.crs else None
        grid = make_grid(dataset.width, dataset.height, affine(dataset), own or wanted, None, file.path)
        part = Part(
            grid=grid, name=file.path, dtype=dataset.dtypes[0], reference=_reference(own, options.crs),
            vertical_crs=files.vertical_of(own, wanted, file.path).name,
            fingerprint=file.stamp(dataset), data=item, direct=is_direct(dataset),
            attribution=files.credit_of(dataset),
        )  # fmt: skip
    file.close()
    return part


def _scanned_image(item: Any, heights: Source, options: ColourOptions) -> Part:
    """What the header of an image says."""
    file = open_raster(item)
    with file.handle() as dataset:
        if dataset.transform.is_identity:
            raise SourceError(
                f"{file.path}: has no georeference, which a mosaic of images needs; add a geotransform "
                "(gdal_translate -a_ullr) or a world file"
            )
    file.close()
    image = files.open_colour(item, heights, options, hold=False)
    part = Part(
        grid=image.grid, name=image.name, dtype=image.dtype, units="", fingerprint=image.fingerprint, data=item,
        direct=image.direct, attribution=image.attribution,
    )  # fmt: skip
    image.close()
    return part


def _reference(own: CRS | None, crs: str | None) -> str | None:
    """The CRS that a raster is opened with where `crs` is asked for: its own place, with the vertical part of `crs`."""
    if own is None or crs is None:
        return crs
    vertical = element(parse_crs(crs).to_wkt(), "VERT_CS")
    if vertical is None or vertical_reference(own).name is not None:
        return None
    return f'COMPD_CS["its own place, heights as given",{own.to_wkt()},{vertical}]'


def _stamp(parts: list[Part], grid: Grid, options: HeightOptions | ColourOptions) -> str | None:
    """Changes with every change of a part, where that can be known of all."""
    stamps = [part.fingerprint for part in parts]
    digest = hashlib.sha256("\n".join(map(str, stamps)).encode()).hexdigest()
    return f"mosaic|{grid.transform}|{grid.crs}|{options}|{digest}" if all(stamps) else None


def _credits(parts: list[Part]) -> str:
    """Who is to be named for the parts, each once."""
    return "; ".join(dict.fromkeys(part.attribution for part in parts if part.attribution))


def _frame(parts: list[Part], crs: str | None) -> Grid:
    """The grid of the finest part, or that one warped to `crs`."""
    finest = min(parts, key=lambda part: part.grid.spacing)
    for part in parts:
        if (part.grid.crs is None) != (finest.grid.crs is None):
            one, other = (part, finest) if part.grid.crs is None else (finest, part)
            raise SourceError(f"{one.name}: names no CRS, {other.name} does; give crs= for those that name none")
    if crs is None or _same(crs, finest.grid.crs):
        return finest.grid
    return warped_grid(finest.grid, crs, finest.name)


def _boxed(part: Part, frame: Grid) -> Part:
    """The part with its box in texels of `frame`."""
    grid = part.grid
    if grid.crs == frame.crs or _same(grid.crs, frame.crs):
        tx, ty = frame.to_texel(*grid.to_crs([0, grid.width, 0], [0, 0, grid.height]))
        row, col = round(float(ty[0])), round(float(tx[0]))
        expected = np.array([[col, col + grid.width, col], [row, row, row + grid.height]])
        if np.abs(np.array([tx, ty]) - expected).max() < ALIGNED:
            return replace(part, box=(row, row + grid.height, col, col + grid.width), aligned=True)
    tx, ty = border(grid, frame, part.name)
    low, high = np.floor([ty.min(), tx.min()]).astype(int), np.ceil([ty.max(), tx.max()]).astype(int)
    return replace(part, box=(int(low[0]), int(high[0]), int(low[1]), int(high[1])))


def _together(parts: list[Part], frame: Grid) -> list[Part]:
    """Parts moved by whole turns, where those on both sides of 180 degrees lie side by side then."""
    a, b, _, d, _, _ = frame.transform
    turn = None if b or d or frame.crs is None else full_turn(parse_crs(frame.crs))
    period = round(turn / abs(a)) if turn else 0
    if not turn or abs(period * abs(a) - turn) > ALIGNED * abs(a):
        return parts
    lefts, widths = (np.array(column) for column in zip(*((p.box[2], p.box[3] - p.box[2]) for p in parts), strict=True))
    # whichever comes first, the others follow it to the east
    starts = np.unique(lefts % period, return_index=True)[1]
    spans = [((lefts - lefts[start]) % period + widths).max() for start in starts]
    best = int(np.argmin(spans))
    if 2 * spans[best] > (lefts + widths).max() - lefts.min():
        return parts  # little would be won: longitudes stay as they are
    turns = (lefts - lefts[starts[best]]) // period
    return [
        replace(
            part,
            box=(*part.box[:2], part.box[2] - int(count) * period, part.box[3] - int(count) * period),
            turn=-int(count) * period * a,
        )
        for part, count in zip(parts, turns, strict=True)
    ]


def _united(parts: list[Part], frame: Grid, name: str) -> tuple[Grid, tuple[Part, ...]]:
    """The grid over all boxes, and the parts with their boxes in it."""
    boxes = np.array([part.box for part in parts])
    top, left = int(boxes[:, 0].min()), int(boxes[:, 2].min())
    height, width = int(boxes[:, 1].max()) - top, int(boxes[:, 3].max()) - left
    a, b, _, d, e, _ = frame.transform
    x, y = frame.to_crs(left, top)
    crs = parse_crs(frame.crs) if frame.crs is not None else None
    grid = make_grid(width, height, (a, b, float(x), d, e, float(y)), crs, None, name)
    shift = np.array([top, top, left, left])
    return grid, tuple(replace(part, box=tuple((np.array(part.box) - shift).tolist())) for part in parts)


def _same(one: str | None, other: str | None) -> bool:
    return one is not None and other is not None and same_place(parse_crs(one), parse_crs(other))
