"""Rasters that are computed by window as tiled GeoTIFF files."""

from __future__ import annotations

import logging
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from orogen.cli.console import Report
from orogen.errors import OrogenError, OutputError
from orogen.queries import Field

log = logging.getLogger("orogen")

SUFFIXES = (".tif", ".tiff")
BLOCK = 256
"""Samples along a side of the file's tiles, and of what is computed at once."""
PATIENCE = 60.0
"""Seconds beyond which the time to come is told."""


def write_fields(path: Path, fields: list[Field], report: Report, overwrite: bool = False) -> list[dict[int, int]]:
    """Write fields of one grid and type as the bands of a GeoTIFF, tile by tile; memory does not grow with them.

    Returns how many samples of each band have which whole value; nothing for bands of other numbers. Raises OutputError
    where the file cannot be written, and what computing raises.
    """
    import rasterio

    from orogen.source.gdal import GDAL_ERRORS
    from orogen.source.scale import parse_crs
    from orogen.view.output import publish

    first = fields[0]
    grid = first.grid
    profile: dict[str, Any] = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "count": len(fields), "dtype": first.dtype,
        "nodata": first.nodata, "crs": parse_crs(grid.crs) if grid.crs else None,
        "transform": rasterio.Affine(*grid.transform), "tiled": True, "blockxsize": BLOCK, "blockysize": BLOCK,
        "compress": "deflate", "predictor": 3 if first.dtype == "float32" else 1, "BIGTIFF": "IF_SAFER",
        "interleave": "band",
    }  # fmt: skip
    counts: list[dict[int, int]] = [{} for _ in fields]
    total = len(fields) * math.ceil(grid.width / BLOCK) * math.ceil(grid.height / BLOCK)
    done, start, told = 0, time.monotonic(), False
    with publish(path, SUFFIXES, overwrite) as temporary:
        try:
            with rasterio.open(temporary, "w", **profile) as file:
                for band, field in enumerate(fields, start=1):
                    file.set_band_description(band, field.name)
                    for rows, cols, values in field.computed(BLOCK):
                        window = ((rows.start, rows.stop), (cols.start, cols.stop))
                        file.write(values, band, window=window)
                        _count(values, counts[band - 1])
                        done += 1
                        report(done / total, f"computing {' and '.join(field.name for field in fields)}")
                        spent = time.monotonic() - start
                        # the first tiles say little: they compile, and read what the others share
                        if not told and spent > 15 and done >= total / 20:
                            told = True
                            if (left := spent * (total - done) / done) > PATIENCE:
                                log.warning("%s: about %.0f minutes to go", path, math.ceil(left / 60))
        except GDAL_ERRORS as error:
            if isinstance(error, OrogenError):  # of the data, not of the file
                raise
            raise OutputError(f"{path}: cannot be written: {error}") from error
    return counts


def _count(values: np.ndarray[Any, Any], counts: dict[int, int]) -> None:
    if values.dtype == np.uint8:
        for value, number in zip(*np.unique(values, return_counts=True), strict=True):
            counts[int(value)] = counts.get(int(value), 0) + int(number)
