"""A pyramid as a cloud-optimised GeoTIFF, with its levels as overviews."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from orogen.errors import OutputError, SettingsError
from orogen.keys import NODE_SIZE, level_count, level_shape
from orogen.pyramid import places
from orogen.pyramid.output import Output, writing
from orogen.pyramid.store import Store, transform
from orogen.pyramid.workers import Workers, threads
from orogen.source.rounding import Rounding
from orogen.source.scale import parse_crs
from orogen.source.stored import attributes

STRIP = 2 * NODE_SIZE
"""Rows written at once."""


def build_cog(output: Output, workers: Workers, *, replace: bool = False) -> dict[str, Any]:
    """Build the levels into a folder beside, as `Output.build` does, and make one file of them."""
    target = output.target
    if len(output.layers) != 1:
        raise SettingsError(f"{target}: a COG holds heights alone; leave out images and layers, or build a .zarr")
    if target.exists() and (not replace or not target.is_file()):
        raise OutputError(f"{target}: exists; give --force to replace it, or another name")
    levels = target.with_name(f"{target.name}.levels")
    facts = _done(output, levels)
    if facts is None:
        facts = _part_of(output, levels).build(workers, replace=levels.exists())["height"]
    with writing(target):
        draft = target.with_name(f"{target.name}.part")
        write_cog(Store(levels / "height"), output, facts, draft)
        os.replace(draft, target)
        places.remove(levels)
    return {"height": facts}


def _part_of(output: Output, levels: Path) -> Output:
    text = f"building {output.target}"
    return replace(output, target=levels, report=lambda part, _: output.report(0.7 * part, text))


def _done(output: Output, levels: Path) -> dict[str, Any] | None:
    """The facts of levels that an earlier call has built and not made a file of."""
    found = attributes(levels / "height") if attributes(levels) else None
    fingerprint = output.layers[0].source.fingerprint
    if found is None or not fingerprint or found["fingerprint"] != fingerprint:
        return None
    return found if found.get("max_error") == output.max_error else None


def write_cog(store: Store, output: Output, facts: dict[str, Any], path: Path) -> None:
    """Write the levels of a store as a COG: metres as float32, or whole numbers with a scale where they are rounded."""
    import rasterio
    from rasterio.shutil import copy

    grid = output.layers[0].source.grid
    scratch = path.with_name(f"{path.name}.levels")
    places.remove(scratch)
    scratch.mkdir()
    count = level_count(grid.shape)
    rounding = Rounding(facts["step"], str(store.array(0, "height").dtype.name)) if "step" in facts else None
    nodata = _nodata(output, facts, rounding)
    dtype = "float32" if rounding is None else rounding.dtype
    text = f"building {output.target}"
    with rasterio.Env(GDAL_CACHEMAX=64, GDAL_NUM_THREADS=str(threads())):
        for level in range(count):
            name = scratch / f"{level}.tif"
            _write_level(store, level, grid.shape, name, dtype, nodata)
            output.report(0.7 + 0.15 * min(1.0, (level + 1) / count), text)
        recipe = scratch / "all.vrt"
        recipe.write_bytes(_recipe(grid, count, dtype, nodata, rounding))
        copy(
            recipe, path, driver="COG", COMPRESS="DEFLATE", PREDICTOR="YES", BLOCKSIZE=str(STRIP), BIGTIFF="IF_SAFER",
            OVERVIEWS="FORCE_USE_EXISTING" if count > 1 else "NONE", SPARSE_OK="YES",
        )  # fmt: skip
    places.remove(scratch)
    output.report(1.0, text)


def _nodata(output: Output, facts: dict[str, Any], rounding: Rounding | None) -> float:
    """The value that stands for nodata: that of the source where no height can be taken for it."""
    given = output.layers[0].source.nodata
    if rounding is not None:
        return rounding.nodata
    if given is None or np.float32(given) != given or facts["minimum"] <= given <= facts["maximum"]:
        return float("nan")
    return given


def _write_level(store: Store, level: int, shape: tuple[int, int], path: Path, dtype: str, nodata: float) -> None:
    import rasterio

    rows, cols = level_shape(shape, level)
    profile = {"compress": "zstd", "zstd_level": 1, "tiled": True, "blockxsize": STRIP, "blockysize": STRIP}
    array = store.array(level, "height")
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=1, dtype=dtype, nodata=nodata, sparse_ok=True,
        bigtiff="if_safer", **profile,
    ) as file:  # fmt: skip
        for row in range(0, rows, STRIP):
            for col in range(0, cols, 8 * STRIP):
                part = slice(row, min(rows, row + STRIP)), slice(col, min(cols, col + 8 * STRIP))
                values = array[part].read(order="C").result()
                void = np.isnan(values) if dtype == "float32" else values == nodata
                if void.all():
                    continue
                values[void] = nodata
                file.write(values, 1, window=((part[0].start, part[0].stop), (part[1].start, part[1].stop)))


def _recipe(grid: Any, count: int, dtype: str, nodata: float, rounding: Rounding | None) -> bytes:
    """The VRT that puts the files of the levels together."""
    root = Xml.Element("VRTDataset", rasterXSize=str(grid.width), rasterYSize=str(grid.height))
    if grid.crs is not None:
        Xml.SubElement(root, "SRS", dataAxisToSRSAxisMapping="1,2").text = parse_crs(grid.crs).to_wkt()
    a, b, c, d, e, f = transform(grid, 0)
    Xml.SubElement(root, "GeoTransform").text = ", ".join(repr(v) for v in (c, a, b, f, d, e))
    kind = {"float32": "Float32", "int16": "Int16", "int32": "Int32"}[dtype]
    band = Xml.SubElement(root, "VRTRasterBand", dataType=kind, band="1")
    Xml.SubElement(band, "NoDataValue").text = repr(nodata)
    Xml.SubElement(band, "UnitType").text = "metre"
    if rounding is not None:
        Xml.SubElement(band, "Scale").text = repr(rounding.step)
        Xml.SubElement(band, "Offset").text = "0"
    source = Xml.SubElement(band, "SimpleSource")
    for level in range(count):
        place = source if level == 0 else Xml.SubElement(band, "Overview")
        Xml.SubElement(place, "SourceFilename", relativeToVRT="1").text = f"{level}.tif"
        Xml.SubElement(place, "SourceBand").text = "1"
    return Xml.tostring(root)
