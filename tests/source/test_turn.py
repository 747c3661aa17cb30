"""Around 180 degrees: rasters across it, and images that count longitudes otherwise than the heights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from orogen.source import open_colour, open_height, survey
from orogen.source.scale import distortion


def image(path: Path, west: float, columns: int, degree: int = 2) -> Path:
    """Pixels whose red says their longitude (half degrees east of 180 west, modulo 360)."""
    longitude = (west + (np.arange(columns) + 0.5) / degree + 180) % 360
    red = np.broadcast_to((longitude / 360 * 250).astype(np.uint8), (180, columns))
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=180, count=3, dtype="uint8", crs="EPSG:4326",
        transform=from_origin(west, 90, 1 / degree, 1), photometric="rgb",
    ) as dataset:  # fmt: skip
        for band in (1, 2, 3):
            dataset.write(red, band)
    return path


def heights(path: Path, west: float, columns: int) -> Path:
    """One degree samples from `west` on."""
    data = np.arange(60 * columns, dtype=np.float32).reshape(60, columns)
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=60, count=1, dtype="float32", crs="EPSG:4326",
        transform=from_origin(west, 30, 1, 1),
    ) as dataset:  # fmt: skip
        dataset.write(data, 1)
    return path


@pytest.mark.parametrize("limit", [2**22, 0])
@pytest.mark.parametrize(
    ("ground", "picture"),
    [
        ((170, 20), (-180, 720)),
        ((0, 360), (-180, 720)),
        ((-180, 360), (0, 720)),
        ((-190, 20), (170, 40)),
        ((-10, 20), (350, 40)),
    ],
)
def test_images_lie_where_the_heights_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int, ground: tuple[int, int], picture: tuple[int, int]
) -> None:
    monkeypatch.setattr(survey, "IN_MEMORY", limit)
    source = open_height(heights(tmp_path / "a.tif", *ground))
    colours = open_colour(image(tmp_path / "b.tif", *picture), source)
    left, _, right, _ = source.grid.bounds
    x = np.arange(left + 0.5, right, 1.0)
    tx, ty = colours.grid.to_texel(x, np.zeros_like(x))
    column, row = np.floor(tx).astype(int), int(ty[0])
    assert column.min() >= 0
    assert column.max() < colours.grid.width
    window = colours.read(slice(row, row + 1), slice(int(column.min()), int(column.max()) + 1))[0]
    expected = ((x + 180) % 360 / 360 * 250).astype(int)
    np.testing.assert_allclose(window[column - column.min(), 0].astype(int), expected, atol=1)
    assert (window[:, 3] == 255).all()
    small = colours.overview((9, 36))
    middle = colours.grid.to_crs((np.arange(36) + 0.5) * colours.grid.width / 36, np.full(36, 9.0))[0]
    away = np.abs(small[4, :, 0] - (middle + 180) % 360 / 360 * 250)
    assert np.minimum(away, 250 - away).max() <= 8


def test_a_raster_across_180_degrees_is_one_piece(tmp_path: Path) -> None:
    source = open_height(heights(tmp_path / "a.tif", 170, 20))
    assert source.grid.bounds == (170, -30, 190, 30)
    ratio = source.grid.ground_scale[0] / open_height(heights(tmp_path / "b.tif", 0, 20)).grid.ground_scale[0]
    assert ratio == pytest.approx(1, abs=1e-12)


def test_distortion_is_that_of_the_ellipsoid(tmp_path: Path) -> None:
    low, high = distortion(open_height(heights(tmp_path / "a.tif", 170, 20)).grid)
    # the length of a degree of longitude at 29.5 degrees against the equator: cos(latitude) on the ellipsoid
    assert low == pytest.approx(96966.28 / 111319.49, rel=1e-5)
    assert high == pytest.approx(1.0024, abs=1e-3)
    assert distortion(open_height(np.zeros((5, 5)), spacing=3).grid) == (1, 1)
