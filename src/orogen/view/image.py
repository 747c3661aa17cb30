"""Pictures, depths and positions as files."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from orogen.errors import SettingsError
from orogen.view.output import publish

COLOR_SUFFIXES = (".png",)
DEPTH_SUFFIXES = (".npy", ".tif", ".tiff")
POSITION_SUFFIXES = (".npy",)


def write_color(path: str | os.PathLike[str], color: NDArray[np.uint8], overwrite: bool = False) -> None:
    """Write (height, width, 3 or 4) uint8 sRGB values, row 0 uppermost, as PNG (.png).

    Raises SettingsError for another shape or type, OutputError where the file cannot be written.
    """
    color = np.asarray(color)
    if color.dtype != np.uint8 or color.ndim != 3 or color.shape[2] not in (3, 4) or 0 in color.shape:
        raise SettingsError(f"expected uint8 (height, width, 3 or 4), got {color.dtype} {color.shape}")
    # Pillow writes no sRGB chunk of its own; without it viewers may guess another colour space
    info = PngInfo()
    info.add(b"sRGB", b"\0")
    with publish(path, COLOR_SUFFIXES, overwrite) as temporary:
        Image.fromarray(color).save(temporary, format="PNG", compress_level=3, pnginfo=info)


def write_depth(path: str | os.PathLike[str], depth: NDArray[np.floating], overwrite: bool = False) -> None:
    """Write (height, width) metres along the view axis, NaN for the sky, as float32 (.npy or .tif).

    Raises SettingsError for another shape, OutputError where the file cannot be written.
    """
    depth = np.asarray(depth, np.float32)
    if depth.ndim != 2 or 0 in depth.shape:
        raise SettingsError(f"expected depths (height, width), got {depth.shape}")
    with publish(path, DEPTH_SUFFIXES, overwrite) as temporary:
        if temporary.suffix.lower() == ".npy":
            np.save(temporary, depth)
        else:
            _write_tiff(temporary, depth)


def write_position(path: str | os.PathLike[str], position: NDArray[np.floating], overwrite: bool = False) -> None:
    """Write (height, width, 3) float64 x, y in the data's CRS and height in metres, NaN for the sky (.npy).

    Raises SettingsError for another shape, OutputError where the file cannot be written.
    """
    position = np.asarray(position, np.float64)
    if position.ndim != 3 or position.shape[2] != 3 or 0 in position.shape:
        raise SettingsError(f"expected positions (height, width, 3), got {position.shape}")
    with publish(path, POSITION_SUFFIXES, overwrite) as temporary:
        np.save(temporary, position)


def _write_tiff(path: Path, values: NDArray[np.float32]) -> None:
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    height, width = values.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with rasterio.open(
                path,
                "w",
                driver="GTiff",
                width=width,
                height=height,
                count=1,
                dtype="float32",
                nodata=np.nan,
                compress="deflate",
                predictor=3,
            ) as file:
                file.write(values, 1)
        except RasterioError as error:
            raise OSError(str(error)) from error
