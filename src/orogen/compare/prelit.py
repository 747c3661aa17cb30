"""An image of a terrain, lit once from level 0: draped without further light, pictures differ by geometry alone.

Its light is that of a style, without cast shadows and haze; one texel a sample. Kept in the cache folder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orogen.errors import OutputError
from orogen.pyramid.contract import Pyramid
from orogen.shading.color import srgb_encode
from orogen.shading.light import light_of
from orogen.shading.ramp import ramp_color, ramp_table
from orogen.shading.style import Style
from orogen.source import cache

VERSION = 1
"""Changes with the pixels that `lit` makes."""
STRIP = 512
"""Rows that are lit at once."""
STEPS = 1 << 16
"""Entries of the tables of colours and of encoded light."""
NAME = "image.tif"


def prelit_image(heights: Pyramid, style: Style, progress: Callable[[float, str], None]) -> Path:
    """The image's file, a GeoTIFF over the pixels of the heights, from the cache or made now.

    `style`: its sun, light, exposure, ramp and ramp range count. Raises OutputError where the cache cannot be written.
    """
    look = (style.sun, style.sun_intensity, style.ambient, style.exposure, style.ramp, style.ramp_range)
    source = heights.source
    key = f"{VERSION}|{source.fingerprint or content_digest(source.read, source.grid.shape)}|{look}"
    entry = cache.cache_dir() / f"prelit-{hashlib.sha256(key.encode()).hexdigest()[:20]}"
    mark = cache.hold(entry)
    if mark is not None:
        mark.close()
    else:
        try:
            with cache.building(entry) as draft:
                _write(draft / NAME, heights, style, progress)
        except OSError as error:
            raise OutputError(f"{entry}: cannot be written: {error}; set OROGEN_CACHE_DIR to another folder") from error
    return entry / NAME


def content_digest(read: Callable[[slice, slice], NDArray], shape: tuple[int, int]) -> str:
    """A digest of all samples, for data that has no fingerprint."""
    digest = hashlib.sha256(repr(shape).encode())
    for row in range(0, shape[0], STRIP):
        digest.update(np.ascontiguousarray(read(slice(row, min(row + STRIP, shape[0])), slice(0, shape[1]))).tobytes())
    return digest.hexdigest()


def lit(
    heights: NDArray[np.floating], metres: NDArray[np.float64], height_range: tuple[float, float], style: Style
) -> NDArray[np.uint8]:
    """(rows, columns, 3) sRGB of heights (rows, columns) in metres without NaN, at least 2 x 2.

    `metres`: 2 x 2 matrix from a step in texels (columns, rows) to metres. `height_range`: ends of the ramp.
    """
    down, along = np.gradient(np.asarray(heights, np.float32))
    inverse = np.linalg.inv(metres).astype(np.float32)
    east, north = (along * inverse[0, i] + down * inverse[1, i] for i in (0, 1))
    length = np.sqrt(1 + east * east + north * north)
    light = light_of(style)
    sun = light.sun.astype(np.float32)
    facing = np.maximum(sun[2] - sun[0] * east - sun[1] * north, 0) / length
    # half of what a surface sees is sky where it stands upright, all of it where it lies level
    sky = 0.5 + 0.5 / length
    low, high = style.ramp_range or height_range
    places = np.clip((np.asarray(heights, np.float32) - low) / max(high - low, 1e-9), 0, 1)
    # tables: the same pixels as by formula, many times faster
    ramp = ramp_color(ramp_table(style.ramp), np.linspace(0, 1, STEPS + 1)).astype(np.float32)
    encoded = np.rint(255 * srgb_encode(np.linspace(0, 1, STEPS + 1))).astype(np.uint8)
    rows = (places * STEPS + 0.5).astype(np.int32)
    pixels = np.empty((*heights.shape, 3), np.uint8)
    lights = zip(light.sun_color.tolist(), light.skylight.tolist(), light.bounce.tolist(), strict=True)
    for channel, (direct, above, below) in enumerate(lights):
        seen = direct * facing + above * sky + below * (1 - sky)
        shown = np.clip(ramp[rows, channel] * seen * style.exposure, 0, 1)
        pixels[..., channel] = encoded[(shown * STEPS + 0.5).astype(np.int32)]
    return pixels


def _write(path: Path, heights: Pyramid, style: Style, progress: Callable[[float, str], None]) -> None:
    import rasterio
    from rasterio.errors import RasterioError

    grid = heights.grid
    options = {
        "driver": "GTiff", "width": grid.width, "height": grid.height, "count": 3, "dtype": "uint8",
        "crs": grid.crs, "transform": rasterio.Affine(*grid.transform), "photometric": "RGB",
        "tiled": True, "blockxsize": 256, "blockysize": 256, "compress": "deflate", "zlevel": 1, "bigtiff": "if_safer",
    }  # fmt: skip
    try:
        with rasterio.open(path, "w", **options) as file:
            for row in range(0, grid.height, STRIP):
                stop = min(row + STRIP, grid.height)
                # a row more on either side, for the slope
                first, last = max(row - 1, 0), min(stop + 1, grid.height)
                part = heights.read(0, slice(first, last), slice(0, grid.width))
                part = np.where(np.isnan(part), heights.height_range[0], part)
                pixels = lit(part, grid.metres, heights.height_range, style)[row - first : stop - first]
                window = rasterio.windows.Window(0, row, grid.width, stop - row)
                file.write(np.moveaxis(pixels, 2, 0), window=window)
                progress(stop / grid.height, "lighting the terrain")
    except RasterioError as error:
        raise OSError(str(error)) from error
