"""Open what users have as a source of heights or colours."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.colours import ArrayColours, ColourSource, FileColours, drape, picture_bands
from orogen.source.contract import Source
from orogen.source.heights import ArraySamples, Facts, FileSamples, HeightSource
from orogen.source.raster import RasterFile, file_stamp, is_direct, open_raster
from orogen.source.scale import ground_scale, parse_crs, vertical_reference
from orogen.source.values import METRES, Values, hidden_sentinel, possible_sentinel, unit_name

log = logging.getLogger("orogen")

IN_MEMORY = 2**22
"""Rasters of at most so many samples are read whole when they are opened."""
SAMPLE = 1024
"""Rows and columns, at most, of the samples that are searched for undeclared nodata in a large file."""

TERRAIN_RGB = Values(scale=0.1, offset=-10_000.0)
"""Heights packed into the colours of map tiles: -10000 m + 0.1 m * (65536 R + 256 G + B)."""

Options = dict[str, float | None]
Data = str | os.PathLike[str] | NDArray[Any] | Any


def open_height(
    data: Data,
    *,
    spacing: float | None = None,
    height_scale: float | None = None,
    height_offset: float | None = None,
    nodata: float | None = None,
    vertical_units: str | None = None,
    crs: str | None = None,
) -> Source:
    """A source of heights.

    data: path, URL or GDAL name of a raster, an open rasterio dataset, an array (rows, columns), or "synthetic".
    spacing: metres between samples of a raster without georeference; replaces the geotransform of one that has it.
    height_scale, height_offset: metres = stored * scale + offset; they replace what the file says.
    nodata: stored value that means nodata; NaN: none but NaN. Replaces what the file says.
    vertical_units: unit of the stored heights, such as 'metre', 'foot', 'us-foot'; replaces what the file says.
    crs: CRS ('EPSG:n', WKT) of data that name none.

    Raises SourceError where the data cannot be used; the message names the file, the cause and what to do.
    """
    if spacing is not None and not (math.isfinite(spacing) and spacing > 0):
        raise SourceError(f"spacing: expected metres above 0, got {spacing:g}")
    options = {"scale": height_scale, "offset": height_offset, "nodata": nodata}
    if isinstance(data, str) and data == "synthetic":
        from orogen.source.synthetic import synthetic

        return synthetic()
    if isinstance(data, np.ndarray):
        return _array(data, spacing, crs, vertical_units, options)
    return _file(open_raster(_path(data)), spacing, crs, vertical_units, options)


def open_colour(
    data: Data, heights: Source, *, color_extent: Literal["pixels", "samples"] = "pixels", crs: str | None = None
) -> Source:
    """A source of colours draped over `heights`.

    data: an image of 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGBA) bands of 8 or 16 bits or with a palette, as a path
    or dataset, or an array (rows, columns[, bands]). It is laid by its georeference; one of another CRS is warped.
    color_extent: where an image without georeference lies: over the pixel area of the heights ("pixels") or over the
    hull of the centres of their samples ("samples").
    crs: CRS of an image that names none; else that of the heights is taken.

    Raises SourceError where the data cannot be used.
    """
    if color_extent not in ("pixels", "samples"):
        raise SourceError(f"color_extent: expected 'pixels' or 'samples', got {color_extent!r}")
    if isinstance(data, np.ndarray):
        given = ArrayColours.of(data)
        grid = drape(given.data.shape[1], given.data.shape[0], heights.grid, color_extent)
        return ColourSource(pixels=given, grid=grid, name="array", dtype=str(data.dtype), units="")
    file = open_raster(_path(data))
    with file.handle() as dataset:
        if dataset.gcps[0] and dataset.transform.is_identity:
            raise _gcps(file.path)
        own = dataset.crs or (parse_crs(crs) if crs else None)
        target = heights.grid.crs
        georeferenced = not dataset.transform.is_identity
    if georeferenced and own is not None and target is not None and own != parse_crs(target):
        file = RasterFile(file.path, warp=target, source_crs=own.to_wkt())
    with file.handle() as dataset:
        bands, dtype = picture_bands(dataset, file.path)
        height, width = shape = dataset.shape
        if georeferenced:
            grid = Grid(width, height, _affine(dataset), target, heights.grid.ground_scale)
        else:
            grid = drape(width, height, heights.grid, color_extent)
        stamp = f"{file_stamp(dataset)}|colour|warp={file.warp}|{grid.transform}"
        stored = FileColours(file, shape, dataset.block_shapes[0], file.warp is None and is_direct(dataset), bands)
    small = width * height <= IN_MEMORY
    if small:
        in_memory = ArrayColours(stored.read(slice(0, height), slice(0, width)))
        file.close()
    return ColourSource(
        pixels=in_memory if small else stored, grid=grid, name=file.path, dtype=dtype, units="", fingerprint=stamp
    )


def _array(data: NDArray[Any], spacing: float | None, crs: str | None, units: str | None, options: Options) -> Source:
    valid = None
    if isinstance(data, np.ma.MaskedArray):
        data, valid = data.data, ~np.ma.getmaskarray(data)
    if data.ndim == 3 and data.shape[0] == 1:
        data, valid = data[0], None if valid is None else valid[0]
    if data.ndim != 2 or min(data.shape) < 1:
        raise SourceError(f"array: expected heights of shape (rows, columns), got {data.shape}")
    if data.dtype.kind not in "iuf":
        raise SourceError(f"array: expected numbers as heights, got {data.dtype}")
    unit = unit_name(units or "metre")
    grid = _grid(data.shape[1], data.shape[0], None, parse_crs(crs) if crs else None, spacing, "array")
    facts = Facts(grid=grid, name="array", dtype=str(data.dtype), units=unit)
    values = Values(options["nodata"]).converted(options["scale"], options["offset"], METRES[unit])
    return _in_memory(ArraySamples(data, valid), values, facts, options["nodata"] is None)


def _file(file: RasterFile, spacing: float | None, crs: str | None, units: str | None, options: Options) -> Source:
    with file.handle() as dataset:
        packed = _check_bands(dataset, file)
        height, width = shape = dataset.shape
        reference = _reference(dataset.crs, crs, file.path)
        transform = None if dataset.transform.is_identity else _affine(dataset)
        if transform is None and dataset.gcps[0] and spacing is None:
            raise _gcps(file.path)
        vertical, vertical_unit = vertical_reference(reference)
        unit = _unit(units, dataset.units[0], vertical_unit, file.path)
        declared = dataset.nodata if options["nodata"] is None else options["nodata"]
        stored = TERRAIN_RGB if packed else Values(declared, dataset.scales[0], dataset.offsets[0])
        values = stored.converted(options["scale"], options["offset"], METRES[unit])
        masked = "per_dataset" in {flag.name for flag in dataset.mask_flag_enums[0]}
        samples = FileSamples(file, shape, dataset.block_shapes[0], is_direct(dataset), masked, packed)
        stamp, dtype = file_stamp(dataset), dataset.dtypes[0]
    grid = _grid(width, height, transform, reference, spacing, file.path)
    facts = Facts(grid=grid, name=file.path, dtype=dtype, units=unit, vertical_crs=vertical)
    undeclared = declared is None and not masked and not packed
    if width * height <= IN_MEMORY:
        everything = samples.read(slice(0, height), slice(0, width))
        file.close()
        source = _in_memory(ArraySamples(*everything), values, facts, undeclared)
    else:
        source = _large(samples, values, facts, undeclared)
    return replace(source, fingerprint=f"{stamp}|height|{source.values}|{grid.transform}|{grid.crs}")


def _in_memory(samples: ArraySamples, values: Values, facts: Facts, undeclared: bool) -> HeightSource:
    """All samples are known: nodata is found for certain."""
    if undeclared and (sentinel := hidden_sentinel(samples.data)) is not None:
        values = _adopt(values, sentinel, facts.name)
    invalid = values.invalid(samples.data)
    usable = np.ones(samples.data.shape, bool) if samples.valid is None else samples.valid
    if invalid is not None:
        usable = usable & ~invalid
    if not usable.any():
        raise _no_samples(facts.name, values)
    return _source(samples, values, facts, covered=bool(usable.all()))


def _large(samples: FileSamples, values: Values, facts: Facts, undeclared: bool) -> HeightSource:
    """Only some samples are looked at; a usual sentinel among the others is nodata too."""
    if undeclared:
        rows, cols = samples.shape
        raw, _ = samples.overview((min(rows, SAMPLE), min(cols, SAMPLE)))
        if (sentinel := hidden_sentinel(raw)) is not None:
            values = _adopt(values, sentinel, facts.name)
        else:
            values = replace(values, nodata=possible_sentinel(raw))
    covered = not samples.masked and not values.possible(np.dtype(facts.dtype))
    source = _source(samples, values, facts, covered)
    if not covered and not _any_valid(source):
        raise _no_samples(facts.name, values)
    return source


def _source(samples: ArraySamples | FileSamples, values: Values, facts: Facts, covered: bool) -> HeightSource:
    known = {f.name: getattr(facts, f.name) for f in fields(facts)} | {"covered": covered}
    return HeightSource(samples=samples, values=values, **known)


def _any_valid(source: HeightSource) -> bool:
    """Whether there is a valid sample: looked for in the middle first, which nearly always ends the search."""
    height, width = source.grid.shape
    step = max(source.block[0], 256)
    starts = sorted(range(0, height, step), key=lambda row: abs(row + step // 2 - height // 2))
    middle = max(0, width // 2 - 256)
    for cols in (slice(middle, min(width, middle + 512)), slice(0, width)):
        for row in starts:
            if np.isfinite(source.read(slice(row, min(height, row + step)), cols)).any():
                return True
    return False


def _grid(width: int, height: int, transform: Any, crs: Any, spacing: float | None, name: str) -> Grid:
    if spacing is not None or transform is None:
        if spacing is None:
            log.warning("%s: has no georeference, taking 1 m between samples; give spacing= to change it", name)
        step = float(spacing or 1.0)
        if crs is not None and crs.is_geographic:
            raise SourceError(f"{name}: spacing= is in metres, {crs.to_string()} in degrees; give a projected crs=")
        if crs is not None:
            step /= float(crs.units_factor[1])
        transform = (step, 0.0, 0.0, 0.0, -step, step * height)
    a, b, c, d, e, f = transform
    x, y = a * width / 2 + b * height / 2 + c, d * width / 2 + e * height / 2 + f
    scale = ground_scale(crs, x, y, math.sqrt(abs(a * e - b * d)) or 1.0)
    return Grid(width, height, transform, crs.to_string() if crs is not None else None, scale)


def _reference(own: Any, given: str | None, path: str) -> Any:
    """The CRS of a file, or the one given for a file that names none."""
    wanted = parse_crs(given) if given is not None else None
    if own is not None and wanted is not None and own != wanted:
        raise SourceError(
            f"{path}: its CRS is {own.to_string()}, not {given}; crs= is for files that name none, "
            "warp the file (gdalwarp) to change it"
        )
    return own or wanted


def _check_bands(dataset: Any, file: RasterFile) -> bool:
    """Refuse what is no raster of heights; whether heights are packed into three bands of colour."""
    dtype = dataset.dtypes[0]
    if dtype.startswith("complex"):
        raise SourceError(f"{file.path}: complex numbers ({dtype}), expected heights; give a raster of real numbers")
    meanings = [meaning.name for meaning in dataset.colorinterp]
    if "palette" in meanings or {"red", "green", "blue"} <= set(meanings):
        if meanings[:3] == ["red", "green", "blue"] and dtype == "uint8" and _is_terrain_rgb(dataset):
            log.warning("%s: taken as heights packed into colours (Terrain-RGB)", file.path)
            return True
        raise SourceError(
            f"{file.path}: a picture of {dataset.count} band(s) of colour, expected one band of heights; "
            "drape it as color= instead"
        )
    if sum(meaning != "alpha" for meaning in meanings) > 1:
        log.warning("%s: has %d bands, taking the first as heights", file.path, dataset.count)
    return False


def _is_terrain_rgb(dataset: Any) -> bool:
    """Whether red is 1 or 2 everywhere, as in heights of -3446 to 9661 m: no picture is like that."""
    red = dataset.read(1, out_shape=(min(dataset.height, SAMPLE), min(dataset.width, SAMPLE)))
    return bool(red.min() >= 1 and red.max() <= 2)


def _unit(given: str | None, band: str | None, vertical: str | None, path: str) -> str:
    """The vertical unit: as given, else as the band says, else as the vertical CRS says, else metres."""
    if given is not None:
        return unit_name(given)
    for text in (band, vertical):
        if text:
            try:
                return unit_name(text)
            except SourceError:
                log.warning("%s: unknown vertical unit %r taken as metres; give vertical_units=", path, text)
    return "metre"


def _adopt(values: Values, sentinel: float, name: str) -> Values:
    log.warning(
        "%s: %g stands apart from all other samples and is taken as nodata; give nodata= to change it", name, sentinel
    )
    return replace(values, nodata=sentinel)


def _no_samples(name: str, values: Values) -> SourceError:
    return SourceError(
        f"{name}: no valid sample, all are nodata ({values.nodata}); give nodata= if that value is wrong"
    )


def _gcps(path: str) -> SourceError:
    return SourceError(f"{path}: placed by ground control points only; rectify it first, for example with gdalwarp")


def _path(data: Any) -> str | os.PathLike[str]:
    """The path of what a user hands over: a path, or an open dataset, which is opened anew for each thread."""
    if isinstance(data, str | os.PathLike):
        return data
    if type(data).__name__ == "DatasetReader" and isinstance(getattr(data, "name", None), str):
        return str(data.name)
    raise SourceError(f"expected a path, a rasterio dataset or a numpy array, got {type(data).__name__}")


def _affine(dataset: Any) -> tuple[float, float, float, float, float, float]:
    t = dataset.transform
    return float(t.a), float(t.b), float(t.c), float(t.d), float(t.e), float(t.f)
