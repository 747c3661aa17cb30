"""Rasters of one band through colour ramps, against interpolation in float64."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin
from rasterio.warp import transform

import orogen
from orogen.errors import SettingsError, SourceError
from orogen.shading.color import srgb_encode
from orogen.shading.ramp import ramp_stops, ramp_table
from orogen.source import Source, open_colour, open_height

CLASSES = """<qgis><pipe><rasterrenderer type="singlebandpseudocolor"><rastershader>
<colorrampshader colorRampType="DISCRETE">
<item value="1" color="#0000ff"/><item value="2" color="#00ff00"/><item value="inf" color="#ff0000"/>
</colorrampshader></rastershader></rasterrenderer></pipe></qgis>"""


def raster(
    path: Path, values: NDArray[Any], crs: str | None = "EPSG:32611", step: float = 30.0, **options: Any
) -> Path:
    with rasterio.open(
        path, "w", driver="GTiff", height=values.shape[0], width=values.shape[1], count=1, dtype=values.dtype, crs=crs,
        transform=from_origin(*((400_000, 3_800_000) if step > 1 else (-118.09, 34.34)), step, step) if step else None,
        **options,
    ) as dataset:  # fmt: skip
        dataset.write(values, 1)
    return path


def whole(source: Source) -> NDArray[Any]:
    rows, cols = source.grid.shape
    return source.read(slice(0, rows), slice(0, cols))


@pytest.fixture
def heights(tmp_path: Path) -> Source:
    return open_height(raster(tmp_path / "dem.tif", np.zeros((60, 80), np.float32)))


@pytest.fixture
def slope() -> NDArray[np.float32]:
    y, x = np.indices((60, 80))
    return (30 + 25 * np.sin(x / 11) * np.cos(y / 7)).astype(np.float32)


def test_values_run_through_the_ramp_from_2_to_98_per_cent(
    tmp_path: Path, heights: Source, slope: NDArray[np.float32]
) -> None:
    slope[3, 5] = -9999
    slope[7, 9] = 1e6  # a stray does not spoil the rest
    path = raster(tmp_path / "slope.tif", slope, nodata=-9999)
    image = whole(open_colour(path, heights, ramp=ramp_stops("viridis")))
    valid = slope != -9999
    np.testing.assert_array_equal(image[..., 3], np.where(valid, 255, 0))
    low, high = np.percentile(slope[valid].astype(float), (2, 98))
    at = np.clip((slope.astype(float) - low) / (high - low), 0, 1)
    table = srgb_encode(ramp_table("viridis"))
    wanted = np.stack([np.interp(at, np.linspace(0, 1, 256), table[:, i]) for i in range(3)], axis=-1)
    assert np.abs(image[..., :3] - 255 * wanted)[valid].max() < 0.51


def test_a_file_of_a_ramp_has_its_own_range(tmp_path: Path, heights: Source, slope: NDArray[np.float32]) -> None:
    (tmp_path / "a.cpt").write_text("0 black 40 white\n40 red 90 red\n")
    image = whole(open_colour(slope, heights, ramp=ramp_stops(str(tmp_path / "a.cpt"))))
    np.testing.assert_array_equal(image[slope >= 40][:, :3], np.broadcast_to((255, 0, 0), ((slope >= 40).sum(), 3)))
    grey = image[slope < 40].astype(float)
    assert np.abs(grey[:, 0] - 255 * slope[slope < 40].astype(float) / 40).max() < 0.51


def test_classes_keep_their_colours_in_another_crs(tmp_path: Path, heights: Source) -> None:
    """QGIS's classes hold up to and with their values; warping mixes colours at edges, but no classes."""
    (tmp_path / "a.qml").write_text(CLASSES)
    random = np.random.default_rng(1)
    classes = np.repeat(np.repeat(random.integers(1, 4, (12, 16)).astype(np.uint8), 8, axis=0), 8, axis=1)
    path = raster(tmp_path / "cover.tif", classes, "EPSG:4326", 0.0003)
    source = open_colour(path, heights, ramp=ramp_stops(str(tmp_path / "a.qml")))
    assert source.grid.crs == "EPSG:32611"
    image = whole(source)
    rows, cols = np.nonzero(image[..., 3] == 255)
    x, y = source.grid.to_crs(cols + 0.5, rows + 0.5)
    lon, lat = transform("EPSG:32611", "EPSG:4326", x, y)
    i, j = (34.34 - np.array(lat)) / 0.0003, (np.array(lon) + 118.09) / 0.0003
    inner = ((i % 8 > 1) & (i % 8 < 7) & (j % 8 > 1) & (j % 8 < 7)).nonzero()[0]
    assert len(inner) > 2000
    colors = np.array([(0, 0, 255), (0, 255, 0), (255, 0, 0)])
    wanted = colors[classes[i[inner].astype(int), j[inner].astype(int)] - 1]
    np.testing.assert_array_equal(image[rows[inner], cols[inner], :3], wanted)


def test_a_raster_without_georeference_lies_over_the_heights(
    tmp_path: Path, heights: Source, slope: NDArray[np.float32]
) -> None:
    path = raster(tmp_path / "slope.tif", slope[::2, ::2], None, 0)
    for data in (path, slope[::2, ::2]):
        source = open_colour(data, heights, ramp=ramp_stops("grey"))
        assert source.grid.shape == (30, 40)
        assert source.grid.bounds == heights.grid.bounds


def test_the_terrain_takes_a_ramp_for_its_image(
    tmp_path: Path, slope: NDArray[np.float32], monkeypatch: pytest.MonkeyPatch
) -> None:
    dem = raster(tmp_path / "dem.tif", np.zeros((60, 80), np.float32))
    path = raster(tmp_path / "slope.tif", slope)
    images = {}
    for ramp in ("viridis", "grey"):
        with orogen.open(dem, color=path, color_ramp=ramp) as terrain:
            assert terrain.colors is not None
            images[ramp] = terrain.colors.read(0, slice(0, 60), slice(0, 80))
    assert (images["grey"][..., 0] == images["grey"][..., 1]).mean() > 0.9
    assert np.abs(images["viridis"].astype(int) - images["grey"]).max() > 50
    with pytest.raises(SettingsError, match="color_ramp: expected color= too"):
        orogen.open(dem, color_ramp="grey")
    with pytest.raises(SettingsError, match="ramp: expected one of"):
        orogen.open(dem, color=path, color_ramp="gray")
    with pytest.raises(SourceError, match="no valid"):
        orogen.open(dem, color=np.full((60, 80), np.nan), color_ramp="grey")
