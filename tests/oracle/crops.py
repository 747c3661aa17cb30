"""Crops of the real data, small enough for oracles on one core."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from PIL import Image

from orogen.grid import Grid

NAMES = ("taiwan", "puget", "bigtujunga")


def crop(data: Path, name: str, size: int = 129) -> tuple[NDArray[np.float32], Grid]:
    """Heights (size, size) in metres without nodata, and their grid, of a rough part of a data set."""
    if name == "puget":
        with Image.open(data / "puget_height_1k.png") as image:
            heights = np.asarray(image).astype(np.float32)[480 : 480 + size, 800 : 800 + size] * np.float32(0.1)
        return heights, Grid(size, size, (160.0, 0.0, 0.0, 0.0, -160.0, 0.0))
    file, column, row, scale = {
        "taiwan": ("taiwan_20m_10481x19401_int16.tif", 6400, 8200, 0.916),
        "bigtujunga": ("bigtujunga_30m_utm.tif", 560, 260, 1.0),
    }[name]
    with rasterio.open(data / file) as raster:
        window = ((row, row + size), (column, column + size))
        heights = raster.read(1, window=window)
        assert (heights != raster.nodata).all()
        a, b, c, d, e, f = tuple(raster.transform)[:6]
        transform = (a, b, c + a * column + b * row, d, e, f + d * column + e * row)
        return heights.astype(np.float32), Grid(size, size, transform, str(raster.crs), (scale, scale))
