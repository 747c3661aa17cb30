"""Damage on which a library below GDAL hangs, or shows what happens to be in memory: refused, and nothing else is."""

from __future__ import annotations

import gzip
import os
import re
import struct
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.transform import from_origin

from orogen.errors import SourceError
from orogen.source import open_height


def hills(rows: int, cols: int) -> NDArray[np.float64]:
    y, x = np.indices((rows, cols))
    return 500 + 200 * np.sin(x / 9) * np.cos(y / 7) + x


def written(path: Path, data: NDArray[Any], driver: str = "GTiff", **creation: Any) -> Path:
    """A raster in UTM of some driver."""
    plain = path if driver == "GTiff" else path.with_name("plain.tif")
    place = {"crs": "EPSG:32633", "transform": from_origin(500_000, 5_000_000, 30, 30)}
    height, width = data.shape
    given = creation if driver == "GTiff" else {}
    with rasterio.open(
        plain, "w", driver="GTiff", height=height, width=width, count=1, dtype=data.dtype, **place, **given
    ) as dataset:
        dataset.write(data, 1)
    if driver != "GTiff":
        rasterio.shutil.copy(plain, path, driver=driver, **creation)
    return path


def whole(path: Path | str) -> NDArray[np.float32]:
    source = open_height(path)
    rows, cols = source.grid.shape
    return source.read(slice(0, rows), slice(0, cols))  # type: ignore[return-value]


@pytest.fixture
def netcdf4(tmp_path: Path) -> tuple[Path, int]:
    """A netCDF-4 file, and where the first collection of its heap begins."""
    path = written(tmp_path / "dem.nc", hills(40, 52).astype(np.int16), "netCDF", FORMAT="NC4")
    return path, path.read_bytes().index(b"GCOL\1\0\0\0")


@pytest.mark.parametrize("size", [0, 128, 4040, 2**64 - 16, 2**63])
def test_a_heap_of_hdf5_that_does_not_advance_is_refused(netcdf4: tuple[Path, int], size: int) -> None:
    """128 bytes on lie zeros: an object of size 0."""
    path, heap = netcdf4
    data = bytearray(path.read_bytes())
    end, at = heap + struct.unpack_from("<Q", data, heap + 8)[0], heap + 16
    while struct.unpack_from("<H", data, at)[0]:
        at += 16 + -(-struct.unpack_from("<Q", data, at + 8)[0] // 8) * 8
    assert at + 16 <= end, "the heap has free space"
    struct.pack_into("<Q", data, at + 8, size)
    path.write_bytes(data)
    for name in (path, f'NETCDF:"{path}":Band1', f"netcdf:{path}:Band1"):
        with pytest.raises(SourceError, match=r"dem\.nc: .*damaged HDF5.*copy the file anew"):
            open_height(name)


def test_numbers_that_look_like_a_heap_are_data(netcdf4: tuple[Path, int]) -> None:
    path, heap = netcdf4
    expected = whole(path)
    rng = np.random.default_rng(1)
    data = path.read_bytes()
    for size in (0, 7, 4095, 10**6, 2**64 - 1):
        like = data[heap : heap + 8] + struct.pack("<Q", size) + rng.bytes(8000)
        path.write_bytes(data + like)  # what follows is not part of the file for the library
        np.testing.assert_array_equal(whole(path), expected)


def test_large_files_are_searched_at_both_ends(netcdf4: tuple[Path, int], monkeypatch: pytest.MonkeyPatch) -> None:
    path, heap = netcdf4
    data = bytearray(path.read_bytes())
    data[heap + 64 : heap + 80] = bytes(16)
    path.write_bytes(data)
    monkeypatch.setattr("orogen.source.hdf5.SEARCHED", len(data) - heap)
    with pytest.raises(SourceError, match="damaged HDF5"):
        open_height(path)


@pytest.mark.parametrize(
    "window",
    [
        '<SrcRect xOff="0" yOff="0" xSize="52" />',
        '<SrcRect xOff="0" yOff="0" xSize="-1" ySize="40" />',
        '<SrcRect xOff="0" yOff="0" xSize="52" ySize="nan" />',
        '<SrcRect xOff="0" yOff="0"xSize="52" ySize="40" />',
        '<SrcRect xOff="0" yOff="0" xSize="52" yS"40" />',
        '<SrcRect xOff="0" yOff="0" xSize="52" ySize="forty" />',
        '<DstRect xOff="0" yOff="0" xSize="52" ySize="0" />',
        "<srcrect xoff='0' yoff='0' xsize='52'/>",
    ],
)
def test_a_window_of_a_vrt_without_all_its_sides_is_refused(tmp_path: Path, window: str) -> None:
    path = written(tmp_path / "dem.vrt", hills(40, 52).astype(np.int16), "VRT")
    name = "DstRect" if "DstRect" in window else "SrcRect"
    path.write_text(re.sub(rf"<{name}[^>]*>", window, path.read_text()))
    for given in (path, f"vrt://{path}?bands=1", f"file://{path}"):
        with pytest.raises(SourceError, match=r"dem\.vrt: .*damaged VRT, expected xOff, yOff, xSize and ySize"):
            open_height(given)


@pytest.mark.parametrize("lost", [r"<SrcRect[^>]*>", r"<DstRect[^>]*>", r"<SimpleSource>.*</SimpleSource>"])
def test_a_vrt_that_would_show_nothing_but_zeros_is_refused(tmp_path: Path, lost: str) -> None:
    path = written(tmp_path / "dem.vrt", hills(40, 52).astype(np.int16), "VRT")
    path.write_text(re.sub(lost, "", path.read_text(), flags=re.DOTALL))
    with pytest.raises(SourceError, match=r"dem\.vrt: .*damaged VRT, expected a (SrcRect|raster)"):
        open_height(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r"<SrcRect[^>]*>", "<srcrect xoff='0' yoff='0' xsize='52.0' ysize='40.0'></srcrect>"),
        (r"<SrcRect[^>]*>\s*<DstRect[^>]*>", ""),
        (r"(<SrcRect)", r'<!-- <SrcRect xOff="0" /> -->\1'),
        (r"<SourceBand>1</SourceBand>", ""),
        (r"<SourceProperties[^>]*>", ""),
        (r"<VRTRasterBand", "<!-- \u00e4 & b -->\n<VRTRasterBand"),
    ],
)
def test_what_a_vrt_may_leave_out_changes_nothing(tmp_path: Path, old: str, new: str) -> None:
    data = hills(40, 52).astype(np.int16)
    path = written(tmp_path / "dem.vrt", data, "VRT")
    path.write_text(re.sub(old, new, path.read_text()), encoding="utf-8")
    np.testing.assert_array_equal(whole(path), data)


def test_a_vrt_whose_raster_is_gone_or_another_one_is_not_shown_as_heights(tmp_path: Path) -> None:
    path = written(tmp_path / "dem.vrt", hills(40, 52).astype(np.int16), "VRT")
    plain = tmp_path / "plain.tif"
    plain.rename(tmp_path / "elsewhere.tif")
    with pytest.raises(SourceError, match=r"dem\.vrt: "):
        open_height(path)
    other = hills(40, 52).astype(np.int16) + 7
    written(plain, other)
    np.testing.assert_array_equal(whole(path), other)  # it names a file, not its content


@pytest.mark.parametrize("threads", [None, "8"])
def test_a_tile_of_jpeg_2000_that_cannot_be_decoded_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: str | None
) -> None:
    """GDAL's threads keep it to themselves: the tile would be whatever is in memory."""
    if threads:
        monkeypatch.setenv("GDAL_NUM_THREADS", threads)
    creation = {"QUALITY": "100", "REVERSIBLE": "YES", "BLOCKXSIZE": "64", "BLOCKYSIZE": "64"}
    path = written(tmp_path / "dem.jp2", hills(256, 256).astype(np.int16), "JP2OpenJPEG", **creation)
    np.testing.assert_array_equal(whole(path), hills(256, 256).astype(np.int16))
    data = bytearray(path.read_bytes())
    tiles = [found.start() for found in re.finditer(rb"\xff\x90\x00\x0a", data)]
    assert len(tiles) == 16
    outcomes = set()
    for number in (0, 5, 15):
        changed = bytearray(data)
        start = changed.index(b"\xff\x93", tiles[number]) + 2
        changed[start : start + 12] = bytes([255] * 12)  # its first packet
        path.write_bytes(changed)
        found = []
        for _ in range(4):
            try:
                found.append(whole(path).tobytes())
            except SourceError:
                found.append(b"refused")
        assert len(set(found)) == 1, "the same each time"
        outcomes.add(found[0] == b"refused")
    assert True in outcomes


def large(path: Path, offset: int) -> NDArray[np.int16]:
    """A tiled raster that is not read whole when it is opened."""
    data = (np.indices((2100, 2100)).sum(axis=0) + offset).astype(np.int16)
    written(path, data, tiled=True, blockxsize=256, blockysize=256)
    return data


@pytest.mark.parametrize("replaced", [True, False])
def test_a_file_that_changes_while_it_is_open_is_not_mixed_with_what_it_was(tmp_path: Path, replaced: bool) -> None:
    path = tmp_path / "dem.tif"
    data = large(path, 0)
    source = open_height(path)
    window = slice(300, 400), slice(500, 600)
    np.testing.assert_array_equal(source.read(*window), data[window])
    other = large(tmp_path / "new.tif", 5)
    if replaced:
        (tmp_path / "new.tif").replace(path)
    else:
        path.write_bytes((tmp_path / "new.tif").read_bytes())
    os.utime(path, ns=(1, 1))
    for _ in range(2):
        with pytest.raises(SourceError, match=r"dem\.tif: changed on disk since it was opened; open it again"):
            source.read(*window)
    again = open_height(path)
    np.testing.assert_array_equal(again.read(*window), other[window])
    again.close()
    source.close()


@pytest.mark.skipif(sys.platform == "win32", reason="open files cannot be removed there")
def test_a_file_that_is_removed_while_it_is_open_stays_readable(tmp_path: Path) -> None:
    path = tmp_path / "dem.tif"
    data = large(path, 0)
    source = open_height(path)
    window = slice(300, 400), slice(500, 600)
    source.read(*window)
    path.unlink()
    np.testing.assert_array_equal(source.read(*window), data[window])
    source.close()
    with pytest.raises(SourceError, match=r"dem\.tif: "):
        source.read(*window)


def test_a_part_that_changes_before_it_is_read_is_refused(tmp_path: Path) -> None:
    one = written(tmp_path / "a.tif", np.full((40, 40), 7, np.int16))
    other = written(tmp_path / "b.tif", np.full((40, 40), 9, np.int16))
    source = open_height([one, other])
    source.close()  # a mosaic opens its parts when they are needed
    written(other, np.full((20, 80), 11, np.int16))
    os.utime(other, ns=(1, 1))
    with pytest.raises(SourceError, match=r"b\.tif: changed since the mosaic was opened"):
        source.read(slice(0, 40), slice(0, 40))


@pytest.mark.parametrize(
    ("name", "hint"), [("a.zip", "zip://"), ("a.tar", "tar://"), ("a.tgz", "tar://"), ("a.tif.gz", "gzip://")]
)
def test_how_to_name_what_lies_in_an_archive(tmp_path: Path, name: str, hint: str) -> None:
    data = hills(40, 52).astype(np.int16)
    plain = written(tmp_path / "dem.tif", data)
    path = tmp_path / name
    if hint == "zip://":
        with zipfile.ZipFile(path, "w") as archive:
            archive.write(plain, "dem.tif")
    elif hint == "tar://":
        with tarfile.open(path, "w:gz" if name.endswith("gz") else "w") as bundle:
            bundle.add(plain, "dem.tif")
    else:
        path.write_bytes(gzip.compress(plain.read_bytes()))
    with pytest.raises(SourceError, match="open it as ") as error:
        open_height(path)
    advised = str(error.value).partition("open it as ")[2].partition(", ")[0]
    assert advised.startswith(f"{hint}{path}")
    np.testing.assert_array_equal(whole(advised), data)
