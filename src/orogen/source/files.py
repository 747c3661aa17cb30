"""Raster files, and datasets that rasterio has open: whatever GDAL reads."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from typing import Any

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.checksums import check_blocks
from orogen.source.colours import ArrayColours, ColourSource, FileColours, drape, picture_bands
from orogen.source.contract import Source
from orogen.source.georeference import affine, check_stretch, make_grid, same_place
from orogen.source.heights import Facts, FileSamples, HeightSource
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.packed import encoding_named, recognised
from orogen.source.raster import RasterFile, Warp, is_dataset, is_direct, is_sequential, open_raster
from orogen.source.scale import parse_crs
from orogen.source.survey import fits_memory, survey
from orogen.source.turn import full_turn, turned
from orogen.source.values import Values
from orogen.source.vertical import Vertical, metres_per_unit, same_datum, vertical_reference, vertical_unit
from orogen.source.warp import WarpedSource, warped_source

log = logging.getLogger("orogen")

TILE = 1024
"""Rows and columns that are looked at to tell packed heights from pictures."""
HEIGHTS = {"int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float16", "float32", "float64"}
"""Types of samples that can be heights."""


def recognises(data: Any) -> bool:
    """Whether `data` names a raster or is a dataset of rasterio."""
    return isinstance(data, str | os.PathLike) or is_dataset(data)


def open_height(data: Any, options: HeightOptions) -> Source:
    """Heights of the first band, or packed into three bands of colour."""
    file = open_raster(data)
    wanted = parse_crs(options.crs) if options.crs is not None else None
    with file.handle() as dataset:
        encoding = packing(dataset, file.path, options)
        packed = encoding is not None
        if options.encoding is None:
            _tell(dataset, file.path, encoding)
        _check_place(dataset, file.path, options)
        own = dataset.crs
        transform = None if dataset.transform.is_identity else affine(dataset)
        warped = not (own is None or wanted is None or options.spacing or transform is None or same_place(own, wanted))
        vertical = vertical_of(own, wanted, file.path)
        if dataset.driver == "BAG":  # heights upwards, whatever its CRS says: so the format has it
            vertical = replace(vertical, down=False)
        unit = vertical_unit(options.vertical_units, dataset.units[0], vertical.unit, file.path)
        declared = dataset.nodata if options.nodata is None else options.nodata
        given = options.height_scale, options.height_offset
        own_scale = dataset.scales[0], dataset.offsets[0]
        stored = encoding_named(encoding) if encoding else Values.told(file.path, declared, own_scale, given)
        values = stored.converted(options.height_scale, options.height_offset, metres_per_unit(unit, vertical.down))
        masked = not {"all_valid", "nodata"} & {flag.name for flag in dataset.mask_flag_enums[0]}
        samples = _samples(file, dataset, masked, packed)
        height, width = dataset.shape
        stamp, dtype, credit = file.stamp(dataset), dataset.dtypes[0], credit_of(dataset)
    reference = wanted if own is None or (options.spacing and wanted) else own
    grid = make_grid(width, height, transform, reference, options.spacing, file.path)
    facts = Facts(
        grid=grid, name=file.path, dtype=dtype, units=unit, vertical_crs=vertical.name, attribution=credit
    )  # fmt: skip
    source = survey(samples, values, facts, doubt=options.nodata is None and not packed)
    if fits_memory(samples.shape):
        check_blocks(file)
    if stamp is not None:
        source = replace(source, fingerprint=f"{stamp}|height|{source.values}|{grid.transform}|{grid.crs}")
    if not warped:
        return source
    there = _warped(file, source, wanted, packed)
    if isinstance(there, WarpedSource) or stamp is None:
        return there
    return replace(there, fingerprint=f"{source.fingerprint}|warp={there.grid.transform}|{there.grid.crs}")


def open_colour(data: Any, heights: Source, options: ColourOptions, hold: bool = True) -> ColourSource:
    """Pixels of an image, warped where its CRS is not that of the heights; small ones are read now if `hold`."""
    file = open_raster(data)
    with file.handle() as dataset:
        _check_place(dataset, file.path, HeightOptions())
        own = dataset.crs or (parse_crs(options.crs) if options.crs else None)
        target = heights.grid.crs
        georeferenced = not dataset.transform.is_identity
        credit = credit_of(dataset)
    if georeferenced and own is not None and target is not None and not same_place(own, parse_crs(target)):
        file = replace(file, warp=Warp(target, source_crs=own.to_wkt()))
    with file.handle() as dataset:
        bands, dtype = picture_bands(dataset, file.path)
        height, width = shape = dataset.shape
        if georeferenced:
            grid = Grid(width, height, affine(dataset), target, heights.grid.ground_scale)
        else:
            grid = drape(width, height, heights.grid, options.color_extent)
        stamp = file.stamp(dataset)
        stored = FileColours(file, shape, dataset.block_shapes[0], file.warp is None and is_direct(dataset), bands)
    small = hold and fits_memory(shape)
    if small:
        in_memory = ArrayColours(stored.read(slice(0, height), slice(0, width)))
        file.close()
    source = ColourSource(
        pixels=in_memory if small else stored, grid=grid, name=file.path, dtype=dtype, units="",
        fingerprint=stamp and f"{stamp}|colour|warp={file.warp}|{grid.transform}", attribution=credit,
    )  # fmt: skip
    turn = full_turn(parse_crs(target) if target else None)
    return turned(source, heights.grid, turn) if georeferenced else source


def credit_of(dataset: Any) -> str:
    """Who is to be named, as a TIFF file or its metadata say."""
    return " ".join(str(dataset.tags().get("TIFFTAG_COPYRIGHT", "")).split())


def _samples(file: RasterFile, dataset: Any, masked: bool, packed: bool) -> FileSamples:
    direct = file.warp is None and is_direct(dataset)
    return FileSamples(
        file, dataset.shape, dataset.block_shapes[0], direct, masked, sequential=is_sequential(dataset), packed=packed
    )


def _warped(file: RasterFile, source: HeightSource, crs: Any, packed: bool) -> HeightSource | WarpedSource:
    """Heights warped bilinearly to another CRS, in a grid of about as many samples."""
    marks = source.values.marks()
    if packed or (source.nodata is not None and len(marks) > 1):  # GDAL would mix bytes, or nodata into heights
        return warped_source(source, crs)
    file = replace(file, warp=Warp(crs.to_wkt(), heights=True, nodata=marks[0] if marks else None))
    with file.handle() as dataset:
        samples = _samples(file, dataset, masked=False, packed=False)
        height, width = dataset.shape
        grid = make_grid(width, height, affine(dataset), crs, None, file.path)
        dtype = dataset.dtypes[0]
    check_stretch(source.grid, grid, file.path)
    facts = Facts(
        grid=grid, name=file.path, dtype=dtype, units=source.units, vertical_crs=source.vertical_crs,
        attribution=source.attribution,
    )  # fmt: skip
    return survey(samples, replace(source.values, nodata=None, sentinels=()), facts, doubt=False)


def vertical_of(own: Any, wanted: Any, path: str) -> Vertical:
    """The vertical reference of a file, or the one given for a file that names none."""
    vertical, other = vertical_reference(own), vertical_reference(wanted)
    if vertical.name is not None and other.name is not None and not same_datum(vertical.name, other.name):
        raise SourceError(
            f"{path}: its heights refer to {vertical.name!r}, not to {other.name!r}; heights are never shifted: "
            "give crs= without a vertical part, or convert the file (gdalwarp)"
        )
    return vertical if vertical.name is not None else other


def _check_place(dataset: Any, path: str, options: HeightOptions) -> None:
    """Refuse what lies on no grid in its CRS."""
    if not dataset.transform.is_identity or options.spacing is not None:
        return
    for what, found in (
        ("ground control points", dataset.gcps[0]),
        ("rational polynomials (RPC)", dataset.rpcs),
        ("arrays of coordinates (GEOLOCATION)", dataset.tags(ns="GEOLOCATION")),
    ):
        if found:
            raise SourceError(
                f"{path}: placed by {what} only, expected a geotransform; rectify it first (gdalwarp), "
                "or give spacing= to show it as it is"
            )


def packing(dataset: Any, path: str, options: HeightOptions) -> str | None:
    """How heights are packed into three bands of colour, None where the first holds them; SourceError without any."""
    dtype = dataset.dtypes[0]
    if dtype not in HEIGHTS:
        raise SourceError(
            f"{path}: {'complex numbers' if dtype.startswith('complex') else 'samples'} ({dtype}), expected "
            "heights as integers or floats; make a raster of real numbers of it first (gdal_translate, gdal_calc)"
        )
    meanings = [meaning.name for meaning in dataset.colorinterp]
    coloured = (meanings[0] == "palette" and not _is_grey(dataset)) or {"red", "green", "blue"} <= set(meanings)
    rgb = meanings[:3] == ["red", "green", "blue"] and dtype == "uint8"
    if options.encoding is not None:
        if not rgb:
            raise SourceError(f"{path}: encoding= is for pictures of red, green and blue; leave it out")
        return options.encoding
    if not coloured or options.height_scale is not None:
        return None
    if rgb and (encoding := _encoding(dataset)):
        return encoding
    raise SourceError(
        f"{path}: a picture of {dataset.count} band(s) of colour, expected one band of heights; "
        "drape it as color= instead, give encoding= if its colours hold heights, or "
        "height_scale= if its first band does"
    )


def _tell(dataset: Any, path: str, encoding: str | None) -> None:
    """Say how the bands were understood, where others might be meant."""
    if encoding is not None:
        log.warning("%s: taken as heights packed into colours (%s)", path, encoding)
    elif sum(meaning.name != "alpha" for meaning in dataset.colorinterp) > 1:
        log.warning(
            "%s: has %d bands, taking the first as heights; name another as vrt://%s?bands=2",
            path, dataset.count, path,
        )  # fmt: skip


def _is_grey(dataset: Any) -> bool:
    """Whether a palette is a ramp of greys, as some formats must have one: its indices are samples then."""
    entries = [entry for _, entry in sorted(dataset.colormap(1).items())]
    greys = [red for red, green, blue, *_ in entries if red == green == blue]
    return len(greys) == len(entries) and greys == sorted(greys)


def _encoding(dataset: Any) -> str | None:
    """How the colours of a picture hold heights; None where they do not."""
    return recognised(dataset.read([1, 2, 3], window=((0, min(dataset.height, TILE)), (0, min(dataset.width, TILE)))))
