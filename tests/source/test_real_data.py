"""Facts of the real data, and that awkward files load right or give one clear error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orogen.errors import SourceError
from orogen.source import open_colour, open_height
from rasters import everything


def test_taiwan(data_dir: Path) -> None:
    source = open_height(data_dir / "taiwan_20m_10481x19401_int16.tif")
    assert source.grid.shape == (19401, 10481)
    assert source.grid.crs == "EPSG:3857"
    assert source.direct
    assert not source.covered
    assert 1.078 < 1 / source.grid.ground_scale[0] < 1.106
    crop = source.read(slice(9000, 9512), slice(5000, 5512))
    assert 0 < np.nanmin(crop) < np.nanmax(crop) < 3948


def test_rainier_has_voids_and_degrees(data_dir: Path) -> None:
    source = open_height(data_dir / "mt_rainier_90m_wgs84_voids.tif")
    heights = everything(source)
    assert np.isnan(heights).sum() == 9033
    assert np.nanmax(heights) == 4371
    east, north = source.grid.metres.diagonal()
    assert 60 < east < 65
    assert -93 < north < -92


def test_big_tujunga_has_a_large_positive_nodata(data_dir: Path) -> None:
    source = open_height(data_dir / "bigtujunga_30m_utm.tif")
    assert source.nodata == 32767
    assert np.nanmax(everything(source)) < 2500


def test_puget_and_its_texture(data_dir: Path) -> None:
    source = open_height(data_dir / "puget_height_1k.png", spacing=160, height_scale=0.1)
    heights = everything(source)
    assert heights.max() == pytest.approx(4379.8)
    assert source.covered
    texture = open_colour(data_dir / "puget_texture_1k.png", source, color_extent="samples")
    x, y = texture.grid.to_crs(0.5, 0.5)  # one texel in the middle of each four samples
    assert [float(v) for v in source.grid.to_texel(x, y)] == [1, 1]


def test_fuji_is_terrain_rgb(data_dir: Path) -> None:
    heights = everything(open_height(data_dir / "fuji_terrainrgb_512.png", spacing=15))
    assert (heights.min(), heights.max()) == pytest.approx((13.7, 3751.0), abs=0.01)


LOADED = {
    "gz_dem_landscape.tif": (-4.732469, 921.4481, 0),
    "gz_dem_portrait.tif": (-6.263335, 920.76294, 0),
    "gz_dem_moon.tif": (-212.29616, -205.4401, 0),
    "gz_dem_nodata.dem": (682, 2932, 96),
    "imagetiff_seq-1c-16b-bigendian-68f373a0.tiff": (0, 255, 0),
    "imagetiff_seq-1c-64f-deflate-fpredict-afa8560e.tiff": (0, 1, 0),
    "rasterio_float_nan.tif": (-1.88, 1.41, 1),
    "rasterio_rotated.tif": (0, 149, 0),
    "rasterio_test_esri_wkt.tif": (1, 4, 0),
    "rasterio_world.byte.tif": (0, 1, 0),
    "riocogeo_image_known_incompatible_ghost_headers.tif": (0, 255, 0),
    "riocogeo_image_missing_nodata.tif": (-2000, 8028, 73873),
    "riocogeo_image_nan.tif": (0, 5.435047, 61292),
    "riocogeo_image_with_offsets.tif": (999.9106, 1001.3413, 6),
}
"""Lowest and highest height, and samples of nodata."""
REFUSED = {
    "imagetiff_BigTIFFMotorola.tif": "picture of 3 band",
    "imagetiff_sample-get-lzw-stuck.tiff": "picture of 3 band",
    "rasterio_RGB.byte.gcp.vrt": r"RGB\.byte\.tif: No such file",
    "rasterio_all-nodata.tif": "picture of 4 band",
    "rasterio_corrupt.tif": "cannot be read as a raster",
    "riocogeo_image_51px.tif": "picture of 3 band",
    "riocogeo_nontiff.jpg": "picture of 3 band",
    "riocogeo_slc.tif": "complex numbers",
}


@pytest.mark.parametrize("name", LOADED)
def test_awkward_files_load(data_dir: Path, name: str) -> None:
    source = open_height(data_dir / "bad" / name)
    heights = everything(source)
    low, high, voids = LOADED[name]
    assert (np.nanmin(heights), np.nanmax(heights)) == pytest.approx((low, high), rel=1e-6)
    assert np.isnan(heights).sum() == voids
    assert source.covered == (voids == 0)
    assert source.grid.spacing > 0


@pytest.mark.parametrize("name", REFUSED)
def test_broken_files_are_one_clear_error(data_dir: Path, name: str) -> None:
    with pytest.raises(SourceError, match=f"{name}.*{REFUSED[name]}"):
        open_height(data_dir / "bad" / name)


def test_no_file_is_left_out(data_dir: Path) -> None:
    names = {path.name for path in (data_dir / "bad").iterdir() if path.suffix != ".xml"}
    assert names == LOADED.keys() | REFUSED.keys()


def test_the_moon_and_a_rotated_raster_keep_their_place(data_dir: Path) -> None:
    moon = open_height(data_dir / "bad" / "gz_dem_moon.tif")
    assert moon.grid.ground_scale == pytest.approx((0.99954511, 0.99954511))
    rotated = open_height(data_dir / "bad" / "rasterio_rotated.tif")
    assert rotated.grid.transform == pytest.approx((17.3205081, 5, 100, 10, -8.66025404, 200))


def test_scale_and_offset_of_a_band_are_applied(data_dir: Path) -> None:
    import rasterio

    path = data_dir / "bad" / "riocogeo_image_with_offsets.tif"
    with rasterio.open(path) as dataset:
        raw = dataset.read(1)
    expected = np.where(raw == -1000, np.nan, raw * 1e-4 + 1000)
    np.testing.assert_allclose(everything(open_height(path)), expected, rtol=1e-7)
