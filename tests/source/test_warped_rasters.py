"""Datasets of rasterio, warping and vertical references, against bilinear interpolation in float64."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.enums import Resampling
from rasterio.io import MemoryFile
from rasterio.transform import from_origin
from rasterio.vrt import WarpedVRT
from rasterio.warp import transform

from orogen.errors import SourceError
from orogen.source import open_colour, open_height
from orogen.source.vertical import require_alike
from rasters import DEGREES, everything, hills, write

# -- datasets of rasterio -------------------------------------------------------------------------------------------


def test_datasets_in_memory_and_virtual_ones(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills())
    with MemoryFile(path.read_bytes()) as memory:
        np.testing.assert_array_equal(everything(open_height(memory)), hills())
        with memory.open() as dataset:
            np.testing.assert_array_equal(everything(open_height(dataset)), hills())
            with WarpedVRT(dataset, crs="EPSG:4326", resampling=Resampling.cubic) as warped:
                source = open_height(warped)
                np.testing.assert_array_equal(
                    everything(source), np.where(warped.read_masks(1) > 0, warped.read(1), np.nan)
                )
                assert source.grid.transform == pytest.approx(tuple(warped.transform)[:6])
                assert source.grid.crs == "EPSG:4326"
    with pytest.raises(SourceError, match="the dataset is closed"):
        open_height(dataset)
    with rasterio.open(path, "r+") as dataset, pytest.raises(SourceError, match=r"a\.tif: .*open for writing"):
        open_height(dataset)


# -- warping --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dtype", "nodata"),
    [("int16", None), ("int16", -5), ("float32", None), ("float64", -9999), ("uint8", 0), ("int32", None)],
)
@pytest.mark.usefixtures("either_way")
def test_crs_warps_onto_the_bilinear_surface(tmp_path: Path, dtype: str, nodata: float | None) -> None:
    data = (hills(120, 160) // 8 if dtype == "uint8" else hills(120, 160)).astype(dtype)
    if nodata is not None:
        data[30:50, 40:60] = nodata
    source = open_height(write(tmp_path / "a.tif", data, nodata=nodata), crs="EPSG:4326")
    assert source.grid.crs == "EPSG:4326"
    got = everything(source).astype(np.float64)
    ty, tx = np.indices(got.shape) + 0.5
    x, y = source.grid.to_crs(tx, ty)
    east, north = (np.reshape(v, x.shape) for v in transform("EPSG:4326", "EPSG:32633", x.ravel(), y.ravel()))
    u, v = (east - 500_000) / 30 - 0.5, (5_000_000 - north) / 30 - 0.5
    inner = (u > 0) & (v > 0) & (u < 159) & (v < 119)
    i, j = (np.where(inner, np.floor(w), 0).astype(int) for w in (u, v))
    stored = np.where(data == nodata, np.nan, data) if nodata is not None else data.astype(np.float64)
    f, g = u - i, v - j
    expected = (stored[j, i] * (1 - f) + stored[j, i + 1] * f) * (1 - g)
    expected += (stored[j + 1, i] * (1 - f) + stored[j + 1, i + 1] * f) * g
    known = inner & np.isfinite(expected)
    assert known.mean() > 0.8
    np.testing.assert_allclose(got[known], expected[known], atol=2e-4)
    outside = (u < -1) | (v < -1) | (u > 160) | (v > 120)
    assert np.isnan(got[outside]).all()
    finite = got[np.isfinite(got)]
    assert stored[np.isfinite(stored)].min() <= finite.min()
    assert finite.max() <= stored[np.isfinite(stored)].max()


def test_several_kinds_of_nodata_are_never_mixed_into_warped_heights(tmp_path: Path) -> None:
    data = hills(120, 160)
    data[30:50, 40:60], data[70:80, 90:99] = -32768, -9999
    path = write(tmp_path / "a.tif", data)
    warped, valid = everything(open_height(path, crs="EPSG:4326")), data[data > 0]
    assert valid.min() <= np.nanmin(warped)
    assert np.nanmax(warped) <= valid.max()
    assert 400 < np.isnan(warped[20:-20, 20:-20]).sum() < 600


def test_warping_keeps_scale_unit_and_mask(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(100, 100))
    mask = np.full((100, 100), 255, np.uint8)
    mask[40:60, 40:60] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets, dataset.units = (0.1,), (50.0,), ("ft",)
        dataset.write_mask(mask)
    own, warped = open_height(path), open_height(path, crs="EPSG:3857")
    assert warped.units == "foot"
    assert np.nanmin(everything(warped)) >= np.nanmin(everything(own)) - 1e-3
    assert np.nanmax(everything(warped)) <= np.nanmax(everything(own)) + 1e-3
    rows, cols = warped.grid.shape
    middle = warped.read(slice(rows * 9 // 20, rows * 11 // 20), slice(cols * 9 // 20, cols * 11 // 20))
    assert np.isnan(middle).all()


def test_the_same_crs_or_a_given_spacing_does_not_warp(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(), crs="EPSG:32633+5773")
    for options in ({"crs": "EPSG:32633"}, {"crs": "EPSG:3857", "spacing": 10}):
        np.testing.assert_array_equal(everything(open_height(path, **options)), hills())


def test_a_crs_that_does_not_suit_the_place_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(90, 180), crs="EPSG:4326", transform=from_origin(-180, 90, 2, 2))
    with pytest.raises(SourceError, match=r"a\.tif: EPSG:3857 does not suit its extent"):
        open_height(path, crs="EPSG:3857")


# -- the third dimension --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("crs", "name", "factor"),
    [
        ("EPSG:32633+5773", "EGM96 height", 1.0),
        ("EPSG:32633+6360", "NAVD88 height (ftUS)", 1200 / 3937),
        ("EPSG:32633+5715", "MSL depth", -1.0),
        ("EPSG:32633+6358", "NAVD88 depth (ftUS)", -1200 / 3937),
    ],
)
def test_vertical_units_and_directions_become_metres_upwards(
    tmp_path: Path, crs: str, name: str, factor: float
) -> None:
    source = open_height(write(tmp_path / "a.tif", hills(), crs=crs))
    assert source.vertical_crs == name
    np.testing.assert_allclose(everything(source), hills() * factor, rtol=1e-6)


def test_three_dimensional_systems_name_the_ellipsoid(tmp_path: Path) -> None:
    source = open_height(write(tmp_path / "a.tif", hills(), **{**DEGREES, "crs": "EPSG:4979"}))
    assert source.vertical_crs == "WGS 84 (ellipsoidal height)"


def test_heights_are_never_shifted_between_references(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(), crs="EPSG:32633+5773")
    with pytest.raises(SourceError, match=r"a\.tif: its heights refer to 'EGM96 height', not to 'EGM2008 height'"):
        open_height(path, crs="EPSG:4326+3855")
    other = open_height(write(tmp_path / "b.tif", hills(), crs="EPSG:32633+3855"))
    unnamed = open_height(write(tmp_path / "c.tif", hills()))
    require_alike([open_height(path), unnamed, open_height(path)])
    with pytest.raises(SourceError, match=r"b\.tif: .*'EGM2008 height'.*a\.tif.*'EGM96 height'"):
        require_alike([open_height(path), unnamed, other])


def test_an_image_over_a_compound_crs_is_not_warped(tmp_path: Path) -> None:
    heights = open_height(write(tmp_path / "a.tif", hills(), crs="EPSG:32633+5773"))
    pixels = np.random.default_rng(0).integers(0, 256, (3, 60, 70), np.uint8)
    colours = open_colour(write(tmp_path / "b.tif", pixels, photometric="rgb"), heights)
    np.testing.assert_array_equal(everything(colours)[..., :3], np.moveaxis(pixels, 0, 2))
