"""Arrays of xarray, which know their coordinates, their CRS and, by the CF conventions, what their values mean."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.arrays import array_samples
from orogen.source.colours import ArrayColours, ColourSource, drape
from orogen.source.contract import Source
from orogen.source.georeference import Transform, make_grid, same_place
from orogen.source.heights import Facts
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.scale import parse_crs
from orogen.source.survey import survey
from orogen.source.values import Values
from orogen.source.vertical import metres_per_unit, vertical_reference, vertical_unit
from orogen.source.warp import warped_source

X_NAMES = ("x", "lon", "longitude", "easting", "projection_x_coordinate", "xc", "rlon")
"""Names and CF standard names of coordinates that run to the east."""
Y_NAMES = ("y", "lat", "latitude", "northing", "projection_y_coordinate", "yc", "rlat")
"""The same to the north."""
UNEVEN = 0.01
"""Largest deviation of a coordinate from even spacing, in samples."""


def recognises(data: Any) -> bool:
    """Whether `data` is an xarray DataArray or Dataset; does not import xarray."""
    xarray = sys.modules.get("xarray")
    return xarray is not None and isinstance(data, xarray.DataArray | xarray.Dataset)


def open_height(data: Any, options: HeightOptions) -> Source:
    """Heights of a DataArray: by CF, its attributes say scale_factor, add_offset, _FillValue, units and positive."""
    array, name = _chosen(data)
    x_dim, y_dim = _axes(array, name)
    others = [dim for dim in array.dims if dim not in (x_dim, y_dim)]
    if any(array.sizes[dim] != 1 for dim in others):
        raise SourceError(
            f"{name}: expected dimensions ({y_dim}, {x_dim}), got {dict(array.sizes)}; "
            f"choose one of each other, as in .isel({others[0]}=0)"
        )
    array = array.isel(dict.fromkeys(others, 0)).transpose(y_dim, x_dim)
    if array.dtype.kind not in "iuf" or min(array.shape) < 1:
        raise SourceError(f"{name}: expected numbers as heights, got {array.dtype} of shape {array.shape}")
    crs = _crs(array, x_dim)
    wanted = parse_crs(options.crs) if options.crs else None
    reference = crs if crs is not None and not (options.spacing and wanted) else wanted
    transform = None if options.spacing else _transform(array, x_dim, y_dim, name)
    vertical = vertical_reference(reference)
    attributes = array.attrs
    unit = vertical_unit(options.vertical_units, attributes.get("units"), vertical.unit, name)
    down = vertical.down or attributes.get("positive") == "down"
    height, width = array.shape
    grid = make_grid(width, height, transform, reference, options.spacing, name)
    fills = [value for key in ("_FillValue", "missing_value") for value in np.ravel(attributes.get(key, []))]
    fills = [float(value) for value in fills] if options.nodata is None else [options.nodata]
    told = float(attributes.get("scale_factor", 1.0)), float(attributes.get("add_offset", 0.0))
    given = options.height_scale, options.height_offset
    stored = replace(Values.told(name, fills[0] if fills else None, told, given), sentinels=tuple(fills[1:]))
    values = stored.converted(*given, metres_per_unit(unit, down))
    facts = Facts(grid=grid, name=name, dtype=str(array.dtype), units=unit, vertical_crs=vertical.name)
    # what a file or a task graph stands behind is read by window, all else is in memory
    lazy = array.chunks or array.encoding.get("source")
    samples, _ = array_samples(array.variable if lazy else array.values, name)
    source = survey(samples, values, facts, doubt=options.nodata is None)
    if crs is None or wanted is None or options.spacing or same_place(crs, wanted):
        return source
    return warped_source(source, wanted)


def open_colour(data: Any, heights: Source, options: ColourOptions) -> Source:
    """Colours of a DataArray (rows, columns) with 1 to 4 bands along a further dimension."""
    array, name = _chosen(data)
    x_dim, y_dim = _axes(array, name)
    array = array.transpose(y_dim, x_dim, ...)
    pixels = ArrayColours.of(array.values)
    height, width = pixels.data.shape[:2]
    transform = _transform(array, x_dim, y_dim, name)
    if transform is None:
        grid = drape(width, height, heights.grid, options.color_extent)
    else:
        crs = _crs(array, x_dim) or (parse_crs(options.crs) if options.crs else None)
        target = parse_crs(heights.grid.crs) if heights.grid.crs else None
        if crs is not None and target is not None and not same_place(crs, target):
            there = make_grid(width, height, transform, crs, None, name)
            return warped_source(
                ColourSource(pixels=pixels, grid=there, name=name, dtype=str(array.dtype), units=""), target
            )
        grid = Grid(width, height, transform, heights.grid.crs, heights.grid.ground_scale)
    return ColourSource(pixels=pixels, grid=grid, name=name, dtype=str(array.dtype), units="")


def _chosen(data: Any) -> tuple[Any, str]:
    """The DataArray that is meant, and what messages call it."""
    if hasattr(data, "data_vars"):
        names = [name for name, array in data.data_vars.items() if array.ndim >= 2]
        if len(names) != 1:
            raise SourceError(
                f"Dataset: expected one variable of heights, got {', '.join(map(str, names)) or 'none'}; "
                "choose one, as in dataset['elevation']"
            )
        data = data[names[0]]
    return data, f"DataArray {data.name!r}" if data.name is not None else "DataArray"


def _axes(array: Any, name: str) -> tuple[Any, Any]:
    """The dimensions that run along x and along y."""
    found = []
    for axis, names in (("X", X_NAMES), ("Y", Y_NAMES)):
        for dim in array.dims:
            attributes = array.coords[dim].attrs if dim in array.coords else {}
            known = {str(dim).lower(), str(attributes.get("standard_name", "")).lower()}
            if attributes.get("axis") == axis or known & set(names):
                found.append(dim)
                break
    if len(found) == 2 and found[0] != found[1]:
        return found[0], found[1]
    if array.ndim == 2 and not found:
        return array.dims[1], array.dims[0]
    raise SourceError(
        f"{name}: cannot tell x from y among the dimensions {', '.join(map(str, array.dims))}; rename them to x and y"
    )


def _transform(array: Any, x_dim: Any, y_dim: Any, name: str) -> Transform | None:
    """The geotransform of the coordinates of sample centres, else the one that is written down; None without either."""
    if x_dim in array.coords and y_dim in array.coords:
        c, a = _even(array.coords[x_dim], name)
        f, e = _even(array.coords[y_dim], name)
        if a is None and e is None:
            raise SourceError(f"{name}: a single sample says nothing of the spacing; give spacing=")
        a, e = a or abs(e or 0), e or -abs(a or 0)
        return a, 0.0, c - a / 2, 0.0, e, f - e / 2
    written = _mapping(array).get("GeoTransform")
    if written is None:
        return None
    c, a, b, f, d, e = (float(word) for word in str(written).split())
    return a, b, c, d, e, f


def _even(coordinate: Any, name: str) -> tuple[float, float | None]:
    """First value and step of a coordinate (None where it has one value only)."""
    values = coordinate.values
    if values.dtype.kind not in "iuf" or not np.isfinite(values).all():
        raise SourceError(f"{name}: expected finite numbers as coordinate {coordinate.name}, got {values.dtype}")
    values = values.astype(np.float64)
    if len(values) < 2:
        return float(values[0]), None
    step = (values[-1] - values[0]) / (len(values) - 1)
    if step == 0 or np.abs(values - values[0] - step * np.arange(len(values))).max() > UNEVEN * abs(step):
        raise SourceError(
            f"{name}: coordinate {coordinate.name} is not evenly spaced, expected a regular grid; use .interp"
        )
    return float(values[0]), float(step)


def _mapping(array: Any) -> dict[str, Any]:
    """The attributes of the CF grid mapping of an array."""
    name = array.encoding.get("grid_mapping") or array.attrs.get("grid_mapping") or "spatial_ref"
    return dict(array.coords[name].attrs) if name in array.coords else {}


def _crs(array: Any, x_dim: Any) -> Any:
    """The CRS of an array: by rioxarray if it is installed, else by its CF grid mapping, else by its coordinates."""
    try:
        import rioxarray  # noqa: F401
    except ImportError:
        mapping = _mapping(array)
        if text := mapping.get("crs_wkt") or mapping.get("spatial_ref") or array.attrs.get("crs"):
            return parse_crs(str(text))
    else:
        if (crs := array.rio.crs) is not None:
            return parse_crs(crs.to_wkt())
    attributes = array.coords[x_dim].attrs if x_dim in array.coords else {}
    degrees = str(attributes.get("units", "")).lower() in ("degrees_east", "degree_east")
    return parse_crs("EPSG:4326") if degrees else None
