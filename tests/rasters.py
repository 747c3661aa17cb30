"""Rasters that the tests of several rooms write, and what is read of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

from orogen.source import Source

UTM = {"crs": "EPSG:32633", "transform": from_origin(500_000, 5_000_000, 30, 30)}
DEGREES = {"crs": "EPSG:4326", "transform": from_origin(15, 45, 0.01, 0.01)}
TILED = {"tiled": True, "blockxsize": 256, "blockysize": 256}


def write(path: Path, data: NDArray[Any], **profile: Any) -> Path:
    """A GeoTIFF of (rows, columns) or (bands, rows, columns), in UTM unless `profile` says otherwise."""
    bands = data if data.ndim == 3 else data[None]
    profile = {"driver": "GTiff", "dtype": data.dtype, "count": len(bands), **UTM, **profile}
    after = {key: profile.pop(key) for key in ("scales", "offsets", "units") if key in profile}
    with rasterio.open(path, "w", height=bands.shape[1], width=bands.shape[2], **profile) as dataset:
        dataset.write(bands)
        for key, value in after.items():
            setattr(dataset, key, (value,) * len(bands))
    return path


def write_tiled(path: Path, data: NDArray[Any], **profile: Any) -> Path:
    """The same in compressed tiles, as large rasters are kept."""
    return write(path, data, **{**TILED, "compress": "zstd", **profile})


def hills(rows: int = 60, cols: int = 70, dtype: str = "int16") -> NDArray[Any]:
    """(rows, cols) heights around 1000, smooth, and different everywhere."""
    y, x = np.indices((rows, cols))
    return (1000 + 300 * np.sin(x / 20) * np.cos(y / 15) + x / 7).astype(dtype)


def cone(rows: int, cols: int, height: float = 1000) -> NDArray[np.float32]:
    """(rows, cols) heights of a cone in the middle of a plain, which falls by 25 a sample."""
    y, x = np.mgrid[0:rows, 0:cols]
    return np.maximum(0, height - 25 * np.hypot(x - cols // 2, y - rows // 2)).astype(np.float32)


def everything(source: Source) -> NDArray[Any]:
    """All samples of a source."""
    rows, cols = source.grid.shape
    return source.read(slice(0, rows), slice(0, cols))
