"""Files that people have: odd names, grids as text, what is no raster at all. Each loads or says what to do."""

from __future__ import annotations

import gzip
import logging
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil

from orogen.errors import NoSampleError, SourceError
from orogen.source import open_height
from rasters import everything, hills, write

NAMES = [
    "with space.tif", "ünïcödé_日本.tif", "quote'.tif", "glob[1].tif", "{z}.tif", "percent%20.tif", "hash#1.tif",
    "semi;amp&.tif", "-dash.tif", "UPPER.TIF", "noext", "dem.tar.gz.tif", "a,b.tif", "!bang.tif", "dem.hgt.tif",
]  # fmt: skip
UNIX_NAMES = ['dq".tif', "star*.tif", "q?.tif", "colon:x.tif", "back\\slash.tif", "new\nline.tif"]


@pytest.mark.parametrize("name", NAMES + ([] if sys.platform == "win32" else UNIX_NAMES))
def test_a_file_of_any_name_is_that_file(tmp_path: Path, name: str) -> None:
    shutil.copy(write(tmp_path / "plain", hills(20, 30)), tmp_path / name)
    write(tmp_path / "glob1.tif", hills(20, 30) + 1)
    np.testing.assert_array_equal(everything(open_height(tmp_path / name)), hills(20, 30))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("dem.tif", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
        ("dem.tif", b"\n<!DOCTYPE html><html>404</html>", "a web page"),
        ("dem.las", b"LASF" + bytes(400), "a point cloud"),
        ("dem.npy", b"\x93NUMPY\1\0" + bytes(400), r"numpy\.load"),
        ("dem.hgt", bytes(2 * 1201 * 1201), r"known by their names, such as N46W122\.hgt"),
        ("dem.geojson", b'{"type": "FeatureCollection", "features": []}', "a vector file holds no heights"),
        ("dem.xyz", b"0 0 1\n31 -3 2\n60 8 3\n95 40 4\n7 7 5\n", "points that lie on no grid.*gdal_grid"),
        ("dem.asc", b"ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n4\n", "File short"),
        ("dem.tif", b"\x1f\x8b" + bytes(50), "not recognized"),
    ],
)
def test_what_is_no_raster_says_what_to_do(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SourceError, match=rf"(?s){name}: cannot be read as a raster: .*{message}"):
        open_height(tmp_path / name)


def test_a_folder_without_rasters_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "readme.txt").write_text("hello")
    with pytest.raises(SourceError, match=r"expected a raster, or a folder with rasters"):
        open_height(tmp_path)


@pytest.mark.parametrize("comma", [False, True])
def test_grids_as_text(tmp_path: Path, comma: bool) -> None:
    data = hills(10, 12, "float64").round(2)
    lines = [f"{500000 + 30 * c} {5000000 - 30 * r} {data[r, c]:.2f}" for r in range(10) for c in range(12)]
    rows = [" ".join(f"{value:.2f}" for value in row) for row in data]
    head = ["ncols 12", "nrows 10", "xllcorner 499985", "yllcorner 4999715", "cellsize 30", "NODATA_value -9999"]
    for name, text in (("dem.xyz", lines), ("head.xyz", ["X Y Z", *lines]), ("dem.asc", head + rows)):
        whole = "\n".join(text) + "\n"
        (tmp_path / name).write_text(whole.replace(".", ",") if comma else whole)
        source = open_height(tmp_path / name)
        np.testing.assert_allclose(everything(source), data, atol=1e-3)
        assert source.grid.bounds == pytest.approx((499985, 4999715, 500345, 5000015))


def test_tiles_of_srtm_in_archives(tmp_path: Path) -> None:
    data = np.tile(np.arange(1201, dtype=">i2"), (1201, 1)).tobytes()
    with zipfile.ZipFile(tmp_path / "N46W122.SRTMGL3.hgt.zip", "w") as archive:
        archive.writestr("N46W122.hgt", data)
    (tmp_path / "N46W122.hgt.gz").write_bytes(gzip.compress(data, 1))
    for name in (
        tmp_path / "N46W122.SRTMGL3.hgt.zip",
        f"zip://{tmp_path / 'N46W122.SRTMGL3.hgt.zip'}!N46W122.hgt",
        f"gzip://{tmp_path / 'N46W122.hgt.gz'}",
    ):
        source = open_height(name)
        assert source.grid.bounds[0] == pytest.approx(-122 - 1 / 2400)
        assert everything(source)[7].tolist() == list(range(1201))


def test_bathymetry_grids_count_upwards_whatever_their_crs_says(tmp_path: Path) -> None:
    depths = -hills(dtype="float32")
    rasterio.shutil.copy(write(tmp_path / "a.tif", depths), tmp_path / "a.bag", driver="BAG")
    with rasterio.open(tmp_path / "a.bag") as dataset:
        assert 'AXIS["Depth",DOWN]' in dataset.crs.to_wkt()
    np.testing.assert_array_equal(everything(open_height(tmp_path / "a.bag")), depths)


@pytest.mark.parametrize(("shape", "told"), [((1, 1), True), ((1, 9), True), ((9, 1), True), ((2, 2), False)])
def test_rasters_without_a_surface_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, shape: tuple[int, int], told: bool
) -> None:
    with caplog.at_level(logging.WARNING, "orogen"):
        open_height(write(tmp_path / "a.tif", hills(*shape)))
    assert ("a.tif: a single row or column of samples spans no surface" in caplog.text) == told


@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_nothing_but_a_usual_sentinel_is_nothing(tmp_path: Path, dtype: str) -> None:
    empty = write(tmp_path / "empty.tif", np.full((60, 70), -9999, dtype))
    with pytest.raises(NoSampleError, match=r"empty\.tif: no valid sample, all are nodata \(-9999\).*nodata="):
        open_height(empty)
    assert (everything(open_height(empty, nodata=np.nan)) == -9999).all()
    full = write(tmp_path / "full.tif", hills(dtype=dtype))
    np.testing.assert_array_equal(everything(open_height([full, empty])), hills(dtype=dtype))
    np.testing.assert_array_equal(everything(open_height(write(tmp_path / "flat.tif", np.zeros((9, 9), dtype)))), 0)


def test_a_picture_among_the_rasters_of_a_folder_is_refused_at_once(tmp_path: Path) -> None:
    write(tmp_path / "dem.tif", hills())
    write(tmp_path / "ortho.tif", np.stack([hills() // 6] * 3).astype("uint8"), photometric="RGB")
    with pytest.raises(SourceError, match=r"ortho\.tif: a picture of 3 band\(s\).*color="):
        open_height(tmp_path)
