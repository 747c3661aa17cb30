"""Heights from arrays and files against rasterio and float64 numpy."""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.enums import Resampling

from orogen.errors import SettingsError, SourceError
from orogen.source import open_height, survey
from rasters import everything, hills, write


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "int32", "float32", "float64"])
def test_arrays_become_float32_metres(dtype: str) -> None:
    data = hills(40, 50, dtype)
    source = open_height(data, spacing=30)
    assert source.kind == "height"
    assert source.direct
    assert source.covered
    assert source.dtype == dtype
    got = source.read(slice(3, 9), slice(10, 40))
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got, data[3:9, 10:40].astype(np.float32))


def test_scale_offset_and_feet_round_once() -> None:
    data = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    source = open_height(data, spacing=1, height_scale=0.1, height_offset=-10_000, vertical_units="ft")
    expected = (data.astype(np.float64) * 0.1 - 10_000) * 0.3048
    np.testing.assert_allclose(everything(source), expected, rtol=6e-8, atol=1e-4)
    assert source.units == "foot"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_what_is_not_finite_is_nodata(value: float) -> None:
    data = np.ones((4, 5))
    data[1, 2] = value
    source = open_height(data, spacing=1)
    assert np.argwhere(np.isnan(everything(source))).tolist() == [[1, 2]]


def test_masked_arrays_and_a_leading_axis() -> None:
    data = np.ma.MaskedArray(hills(6, 7), mask=np.eye(6, 7, dtype=bool))
    source = open_height(data[None], spacing=1)
    assert not source.covered
    np.testing.assert_array_equal(np.isnan(everything(source)), np.eye(6, 7, dtype=bool))


@pytest.mark.parametrize("layout", [{"tiled": True, "blockxsize": 128, "blockysize": 128, "compress": "deflate"}, {}])
@pytest.mark.usefixtures("either_way")
def test_files_equal_rasterio_window_by_window(tmp_path: Path, layout: dict[str, Any]) -> None:
    data = hills(500, 700)
    data[100:120, 50:300] = -5
    source = open_height(write(tmp_path / "a.tif", data, nodata=-5, **layout))
    expected = np.where(data == -5, np.nan, data).astype(np.float32)
    rng = np.random.default_rng(1)
    for _ in range(20):
        r, c = rng.integers(0, 400), rng.integers(0, 600)
        rows, cols = slice(r, r + rng.integers(1, 100)), slice(c, c + rng.integers(1, 100))
        np.testing.assert_array_equal(source.read(rows, cols), expected[rows, cols])
    assert source.nodata == -5
    assert not source.covered
    assert source.grid.crs == "EPSG:32633"
    assert source.grid.transform == (30, 0, 500_000, 0, -30, 5_000_000)


@pytest.mark.usefixtures("either_way")
def test_a_file_says_its_scale_offset_and_unit(tmp_path: Path) -> None:
    data = hills(20, 30)
    source = open_height(write(tmp_path / "a.tif", data, scales=0.01, offsets=500.0, units="US survey foot"))
    assert source.units == "us-foot"
    np.testing.assert_allclose(everything(source), (data * 0.01 + 500) * 1200 / 3937, rtol=1e-6)
    overridden = open_height(tmp_path / "a.tif", height_scale=2, height_offset=0, vertical_units="m")
    np.testing.assert_array_equal(everything(overridden), data * 2)


def test_settings_change_the_fingerprint(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(20, 30))
    stamps = {
        open_height(path, **options).fingerprint
        for options in ({}, {"height_scale": 2}, {"height_offset": 1}, {"nodata": 1000}, {"spacing": 7})
    }
    assert len(stamps) == 5
    write(tmp_path / "a.tif", hills(20, 31))
    assert open_height(path).fingerprint not in stamps


@pytest.mark.usefixtures("either_way")
def test_a_mask_band_is_nodata(tmp_path: Path) -> None:
    data, mask = hills(20, 300), np.full((20, 300), 255, np.uint8)
    mask[5:9, 100:200] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        write(tmp_path / "a.tif", data)
        with rasterio.open(tmp_path / "a.tif", "r+") as dataset:
            dataset.write_mask(mask)
    source = open_height(tmp_path / "a.tif")
    assert not source.covered
    np.testing.assert_array_equal(np.isnan(everything(source)), mask == 0)


@pytest.mark.usefixtures("either_way")
def test_an_undeclared_sentinel_is_nodata_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = hills(300, 300)
    data[50:150, 40:100] = -9999
    with caplog.at_level(logging.WARNING, "orogen"):
        source = open_height(write(tmp_path / "a.tif", data))
    assert "-9999" in caplog.text
    np.testing.assert_array_equal(np.isnan(everything(source)), data == -9999)
    kept = open_height(tmp_path / "a.tif", nodata=float("nan"))
    np.testing.assert_array_equal(everything(kept), data)


def test_a_rare_sentinel_in_a_large_file_is_nodata_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "IN_MEMORY", 0)
    data = hills(300, 300)
    data[1, 1] = -9999  # no sample of 16 x 16 meets it
    source = open_height(write(tmp_path / "a.tif", data))
    assert not source.covered
    np.testing.assert_array_equal(np.isnan(everything(source)), data == -9999)


def test_deep_sea_at_a_sentinel_value_stays() -> None:
    depths = np.linspace(-10_900, 3000, 400 * 400).astype(np.int16).reshape(400, 400)
    depths[3, 3] = -9999
    np.testing.assert_array_equal(everything(open_height(depths, spacing=1)), depths)


@pytest.mark.usefixtures("either_way")
def test_the_overview_is_near_the_heights(tmp_path: Path) -> None:
    data = hills(900, 700)
    path = write(tmp_path / "a.tif", data, tiled=True, blockxsize=128, blockysize=128)
    plain = open_height(path).overview((90, 70))
    assert plain.shape == (90, 70)
    centres = data[5::10, 5::10]
    assert np.abs(plain - centres).max() < 150  # a step of 10 samples in these hills
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4, 8], Resampling.average)
    assert np.abs(open_height(path).overview((90, 70)) - centres).max() < 150
    assert open_height(path).overview((5000, 5000)).shape == (900, 700)


def test_threads_read_what_one_thread_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "IN_MEMORY", 0)
    data = np.random.default_rng(2).integers(0, 3000, (1500, 1500)).astype(np.int16)
    source = open_height(write(tmp_path / "a.tif", data, tiled=True, compress="deflate"))

    def same(seed: int) -> bool:
        rng = np.random.default_rng(seed)
        for _ in range(25):
            r, c = rng.integers(0, 1244, 2)
            window = source.read(slice(r, r + 256), slice(c, c + 256))
            if not np.array_equal(window, data[r : r + 256, c : c + 256]):
                return False
        return True

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(same, range(8)))
    source.close()


def test_nothing_is_written_beside_the_data(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(300, 300))
    before = path.read_bytes()
    source = open_height(path)
    source.overview((10, 10))
    source.close()
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]
    assert path.read_bytes() == before


def test_png_without_georeference_takes_spacing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = hills(30, 40, "uint16")
    path = write(tmp_path / "a.png", data, driver="PNG", crs=None, transform=None)
    with caplog.at_level(logging.WARNING, "orogen"):
        assert open_height(path).grid.spacing == 1
    assert "spacing=" in caplog.text
    source = open_height(path, spacing=160, height_scale=0.1)
    assert source.grid.spacing == pytest.approx(160)
    assert source.grid.bounds == (0, 0, 6400, 4800)
    assert source.grid.crs is None
    np.testing.assert_allclose(everything(source), data * 0.1, rtol=1e-7)


def test_world_files_and_a_given_crs(tmp_path: Path) -> None:
    path = write(tmp_path / "a.png", hills(30, 40, "uint16"), driver="PNG", crs=None, transform=None)
    (tmp_path / "a.pgw").write_text("20\n0\n0\n-20\n400010\n5000490\n")
    source = open_height(path, crs="EPSG:32633")
    assert source.grid.transform == (20, 0, 400_000, 0, -20, 5_000_500)
    assert source.grid.crs == "EPSG:32633"
    (tmp_path / "a.pgw").write_text("30\n0\n0\n-30\n400010\n5000490\n")
    assert open_height(path, crs="EPSG:32633").fingerprint != source.fingerprint


def test_an_open_dataset_is_read_by_its_name(tmp_path: Path) -> None:
    data = hills(20, 30)
    with rasterio.open(write(tmp_path / "a.tif", data)) as dataset:
        np.testing.assert_array_equal(everything(open_height(dataset)), data)


def test_a_compound_crs_names_the_vertical_reference(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(20, 30), crs="EPSG:32633+5773")
    assert open_height(path).vertical_crs == "EGM96 height"
    assert open_height(write(tmp_path / "b.tif", hills(20, 30))).vertical_crs is None


def test_tiled_files_are_direct_and_others_are_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "IN_MEMORY", 0)
    data = hills(600, 600, "uint16")
    tiled = write(tmp_path / "tiled.tif", data, tiled=True)
    striped = write(tmp_path / "striped.tif", data)
    assert open_height(tiled).direct
    assert not open_height(striped).direct
    assert not open_height(write(tmp_path / "a.png", data, driver="PNG", crs=None, transform=None), spacing=1).direct
    for part, direct in ((tiled, True), (striped, False)):
        vrt = tmp_path / f"{part.stem}.vrt"
        with rasterio.open(part) as dataset:
            rasterio.shutil.copy(dataset, vrt, driver="VRT")
        assert open_height(vrt).direct == direct


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spacing": 0}, "spacing: expected metres above 0"),
        ({"spacing": float("nan")}, "spacing: expected metres above 0"),
        ({"height_scale": 0}, "height_scale: expected a finite number other than 0"),
        ({"height_offset": float("inf")}, "height_offset: expected a finite number"),
        ({"vertical_units": "cubits"}, "expected one of metre, foot"),
        ({"crs": "EPSG:nonsense"}, "crs: expected 'EPSG:n' or WKT"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        open_height(hills(4, 4), **options)


def test_a_spacing_in_metres_does_not_fit_degrees() -> None:
    with pytest.raises(SourceError, match="in degrees"):
        open_height(hills(4, 4), crs="EPSG:4326", spacing=1)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (np.zeros((2, 3, 4)), r"expected heights of shape \(rows, columns\), got \(2, 3, 4\)"),
        (np.zeros((0, 3)), r"expected heights of shape"),
        (np.zeros((2, 3), complex), "expected numbers as heights, got complex"),
        (np.full((2, 3), np.nan), "no valid sample"),
        (42, "expected a path, an open rasterio dataset, an array of numpy or xarray, got int"),
        ("/nowhere/dem.tif", "/nowhere/dem.tif: no such file"),
    ],
)
def test_what_holds_no_heights_is_refused(data: Any, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        open_height(data, spacing=1)


@pytest.mark.usefixtures("either_way")
def test_a_file_of_nodata_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"a\.tif: no valid sample, all are nodata \(-5"):
        open_height(write(tmp_path / "a.tif", np.full((700, 300), -5, np.int16), nodata=-5))


@pytest.mark.usefixtures("either_way")
def test_one_valid_sample_is_enough(tmp_path: Path) -> None:
    data = np.full((700, 900), -5, np.int16)
    data[3, 2] = 100
    assert np.nanmax(everything(open_height(write(tmp_path / "a.tif", data, nodata=-5)))) == 100


def test_a_truncated_file_is_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.tif", np.random.default_rng(3).integers(0, 99, (600, 600)).astype(np.int16), tiled=True)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(SourceError, match=r"a\.tif: cannot be read as a raster"):
        everything(open_height(path))
    monkeypatch.setattr(survey, "IN_MEMORY", 0)
    with pytest.raises(SourceError, match=r"a\.tif: cannot be read as a raster"):
        everything(open_height(path))


@pytest.mark.parametrize("rows", [slice(-1, 2), slice(0, 0), slice(2, 5), slice(0, 4, 2)])
def test_windows_outside_are_refused(rows: slice) -> None:
    with pytest.raises(SourceError, match="expected rows within 0 to 4"):
        open_height(hills(4, 4), spacing=1).read(rows, slice(0, 4))
