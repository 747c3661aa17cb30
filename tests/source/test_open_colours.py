"""Colours of images of every usual layout, and where they lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin

from orogen.errors import SettingsError, SourceError
from orogen.source import Source, open_colour, open_height
from rasters import everything

TRANSFORM = from_origin(500_000, 5_000_000, 30, 30)


@pytest.fixture
def heights() -> Source:
    return open_height(np.zeros((20, 30)), spacing=10)


def image(path: Path, bands: NDArray[Any], **profile: Any) -> Path:
    """A GeoTIFF of (bands, rows, columns)."""
    count, height, width = bands.shape
    with rasterio.open(
        path, "w", driver="GTiff", count=count, height=height, width=width, dtype=bands.dtype, **profile
    ) as dataset:
        dataset.write(bands)
    return path


def noise(bands: int, seed: int = 1, top: int = 256, dtype: str = "uint8") -> NDArray[Any]:
    return np.random.default_rng(seed).integers(0, top, (bands, 25, 40)).astype(dtype)


@pytest.mark.usefixtures("either_way")
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_grey_and_rgb_with_and_without_alpha(tmp_path: Path, heights: Source, count: int) -> None:
    bands = noise(count)
    path = image(tmp_path / "a.tif", bands, photometric="RGB" if count > 2 else "MINISBLACK")
    if count in (2, 4):
        with rasterio.open(path, "r+") as dataset:
            dataset.colorinterp = [*dataset.colorinterp[:-1], ColorInterp.alpha]
    source = open_colour(path, heights)
    pixels = everything(source)
    assert source.kind == "colour"
    assert pixels.shape == (25, 40, 4)
    assert pixels.dtype == np.uint8
    colours = bands[:3] if count > 2 else bands[:1].repeat(3, axis=0)
    np.testing.assert_array_equal(pixels[..., :3], np.moveaxis(colours, 0, 2))
    np.testing.assert_array_equal(pixels[..., 3], bands[-1] if count in (2, 4) else 255)


@pytest.mark.usefixtures("either_way")
def test_bands_are_taken_by_their_meaning(tmp_path: Path, heights: Source) -> None:
    bands = noise(3)
    path = image(tmp_path / "a.tif", bands)
    with rasterio.open(path, "r+") as dataset:
        dataset.colorinterp = [ColorInterp.blue, ColorInterp.green, ColorInterp.red]
    np.testing.assert_array_equal(everything(open_colour(path, heights))[..., :3], np.moveaxis(bands[::-1], 0, 2))


@pytest.mark.usefixtures("either_way")
def test_palettes(tmp_path: Path, heights: Source) -> None:
    index = noise(1, top=3)
    path = image(tmp_path / "a.tif", index, photometric="palette")
    table = {0: (10, 20, 30, 255), 1: (200, 100, 0, 255), 2: (0, 0, 255, 255)}
    with rasterio.open(path, "r+") as dataset:
        dataset.write_colormap(1, table)
    expected = np.array([table[i] for i in range(3)], np.uint8)[index[0]]
    np.testing.assert_array_equal(everything(open_colour(path, heights)), expected)


def test_sixteen_bits_become_eight(tmp_path: Path, heights: Source) -> None:
    bands = noise(3, top=65536, dtype="uint16")
    bands[:, 0, 0], bands[:, 0, 1] = 65535, 0
    pixels = everything(open_colour(image(tmp_path / "a.tif", bands), heights))
    np.testing.assert_array_equal(pixels[..., :3], np.moveaxis(np.rint(bands / 257), 0, 2))


def test_nodata_is_transparent(tmp_path: Path, heights: Source) -> None:
    bands = noise(3, top=255) + 1
    bands[:, 3:9, 5:7] = 0
    pixels = everything(open_colour(image(tmp_path / "a.tif", bands, nodata=0), heights))
    np.testing.assert_array_equal(pixels[..., 3] == 0, (bands == 0).all(axis=0))


def test_arrays(heights: Source) -> None:
    rgb = np.moveaxis(noise(3), 0, 2)
    np.testing.assert_array_equal(everything(open_colour(rgb, heights))[..., :3], rgb)
    np.testing.assert_array_equal(everything(open_colour(rgb[..., 0], heights))[..., 1], rgb[..., 0])


@pytest.mark.parametrize(
    ("extent", "corners"), [("pixels", ([0, 30], [0, 20])), ("samples", ([0.5, 29.5], [0.5, 19.5]))]
)
def test_an_image_without_georeference_spans_pixels_or_samples(
    heights: Source, extent: Any, corners: tuple[list[float], list[float]]
) -> None:
    source = open_colour(np.moveaxis(noise(3), 0, 2), heights, color_extent=extent)
    x, y = source.grid.to_crs([0, 40], [0, 25])
    np.testing.assert_allclose(heights.grid.to_texel(x, y), corners, atol=1e-9)


@pytest.mark.usefixtures("either_way")
def test_an_image_of_another_crs_is_warped(tmp_path: Path) -> None:
    with rasterio.open(
        tmp_path / "h.tif", "w", driver="GTiff", count=1, height=200, width=300, dtype="int16", crs="EPSG:32633",
        transform=TRANSFORM,
    ) as dataset:  # fmt: skip
        dataset.write(np.zeros((200, 300), np.int16), 1)
    heights = open_height(tmp_path / "h.tif")
    # longitude and latitude as red and green: 15 to 15.15 degrees east, 45.1 to 45.2 north
    lon, lat = np.meshgrid(15 + (np.arange(150) + 0.5) / 1000, 45.2 - (np.arange(100) + 0.5) / 1000)
    red, green = (lon - 15) * 1500, (lat - 45.05) * 1500
    path = image(
        tmp_path / "a.tif", np.stack([red, green, 0 * red]).round().astype(np.uint8), crs="EPSG:4326",
        transform=from_origin(15, 45.2, 0.001, 0.001), photometric="RGB",
    )  # fmt: skip
    source = open_colour(path, heights)
    assert source.grid.crs == "EPSG:32633"
    pixels = everything(source).astype(float)
    tx, ty = np.meshgrid(np.arange(pixels.shape[1]) + 0.5, np.arange(pixels.shape[0]) + 0.5)
    x, y = source.grid.to_crs(tx, ty)
    from rasterio.warp import transform

    lon, lat = (np.reshape(v, x.shape) for v in transform("EPSG:32633", "EPSG:4326", x.ravel(), y.ravel()))
    inside = (lon > 15.005) & (lon < 15.145) & (lat > 45.105) & (lat < 45.195)
    assert inside.mean() > 0.5
    assert (pixels[inside, 3] == 255).all()
    assert np.abs(pixels[..., 0] - (lon - 15) * 1500)[inside].max() < 2
    assert np.abs(pixels[..., 1] - (lat - 45.05) * 1500)[inside].max() < 2
    assert (pixels[(lon < 14.995) | (lat > 45.205), 3] == 0).all()


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (np.zeros((2, 3, 5), np.uint8), "expected colours of shape"),
        (np.zeros((2, 3)), "expected colours of type uint8 or uint16, got float64"),
    ],
)
def test_arrays_that_are_no_picture_are_refused(heights: Source, pixels: NDArray[Any], message: str) -> None:
    with pytest.raises(SourceError, match=message):
        open_colour(pixels, heights)


def test_files_that_are_no_picture_and_unknown_extents_are_refused(tmp_path: Path, heights: Source) -> None:
    with pytest.raises(SourceError, match=r"a\.tif: expected colours of type uint8 or uint16, got float32"):
        open_colour(image(tmp_path / "a.tif", noise(3).astype(np.float32)), heights)
    with pytest.raises(SettingsError, match="expected 'pixels' or 'samples', got 'edges'"):
        open_colour(np.zeros((2, 2), np.uint8), heights, color_extent="edges")  # type: ignore[arg-type]
