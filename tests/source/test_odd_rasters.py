"""Rasters that are seldom seen, written here: each loads as rasterio reads it or is refused with one clear error."""

from __future__ import annotations

import logging
import os
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.control import GroundControlPoint
from rasterio.transform import Affine, from_origin

from orogen.errors import SourceError
from orogen.source import open_height
from rasters import DEGREES, everything, hills, write

# -- types and layouts ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dtype", "layout"),
    [
        ("int8", {}),
        ("uint8", {"compress": "packbits"}),
        ("uint16", {"nbits": 12}),
        ("uint32", {"compress": "lzma"}),
        ("int64", {"compress": "lzw", "predictor": 2}),
        ("uint64", {"tiled": True}),
        ("float32", {"nbits": 16}),
        ("float32", {"compress": "lerc"}),
        ("float64", {"compress": "zstd", "predictor": 3}),
        ("int16", {"BIGTIFF": "YES", "ENDIANNESS": "BIG"}),
        ("uint8", {"compress": "jpeg", "tiled": True}),
    ],
)
@pytest.mark.usefixtures("either_way")
def test_every_type_and_layout_equals_rasterio(tmp_path: Path, dtype: str, layout: dict[str, Any]) -> None:
    data = (hills() // 11 if dtype.endswith("t8") else hills()).astype(dtype)
    path = write(tmp_path / "a.tif", data, **layout)
    with rasterio.open(path) as dataset:
        expected = dataset.read(1).astype(np.float64)
    np.testing.assert_array_equal(everything(open_height(path)), expected)


@pytest.mark.parametrize(
    "driver",
    ["AAIGrid", "HFA", "ENVI", "netCDF", "VRT", "GPKG", "Zarr", "GSBG", "SAGA", "NITF", "EHdr", "COG", "PCIDSK"],
)
def test_formats_equal_rasterio(tmp_path: Path, driver: str) -> None:
    plain = write(tmp_path / "plain.tif", hills(dtype="float32"))
    path = tmp_path / {"Zarr": "a.zarr", "SAGA": "a.sdat"}.get(driver, "a.dat")
    rasterio.shutil.copy(plain, path, driver=driver)
    with rasterio.open(path) as dataset:
        assert dataset.driver in (driver, "GTiff")
        expected = dataset.read(1)
        place = tuple(dataset.transform)[:6]
    source = open_height(path)
    np.testing.assert_array_equal(everything(source), expected)
    assert source.grid.transform == pytest.approx(place)


def test_hgt_tiles_know_their_place(tmp_path: Path) -> None:
    data = np.full((1201, 1201), 300, ">i2")
    data[5, 7] = -32768
    (tmp_path / "N46W122.hgt").write_bytes(data.tobytes())
    source = open_height(tmp_path / "N46W122.hgt")
    assert source.grid.bounds == pytest.approx((-122 - 1 / 2400, 46 - 1 / 2400, -121 + 1 / 2400, 47 + 1 / 2400))
    assert np.argwhere(np.isnan(everything(source))).tolist() == [[5, 7]]


@pytest.mark.parametrize("shape", [(1, 1), (1, 90), (70, 1), (2, 2)])
def test_the_smallest_rasters(tmp_path: Path, shape: tuple[int, int]) -> None:
    data = hills(*shape)
    np.testing.assert_array_equal(everything(open_height(write(tmp_path / "a.tif", data))), data)


def test_a_sparse_raster_beyond_2_to_the_31_samples(tmp_path: Path) -> None:
    size = 2**18
    path, data = tmp_path / "a.tif", hills(100, 100)
    profile = {"driver": "GTiff", "dtype": "int16", "count": 1, "width": size, "height": size, "nodata": -1}
    place = {"crs": "EPSG:32633", "transform": from_origin(500_000, 5_000_000, 0.1, 0.1)}
    layout = {"SPARSE_OK": "YES", "tiled": True, "blockxsize": 2048, "blockysize": 2048}
    with rasterio.open(path, "w", **profile, **place, **layout) as dataset:
        dataset.write(data, 1, window=((size - 300, size - 200), (size - 100, size)))
    source = open_height(path)
    got = source.read(slice(size - 301, size - 199), slice(size - 101, size))
    np.testing.assert_array_equal(got[1:-1, 1:], data)
    assert np.isnan(got[0]).all()
    assert np.isnan(source.read(slice(0, 256), slice(0, 256))).all()


def test_grey_palettes_are_samples_and_coloured_ones_a_picture(tmp_path: Path) -> None:
    data = hills().astype("uint8")
    path = write(tmp_path / "a.tif", data, photometric="palette")
    for coloured in (False, True):
        with rasterio.open(path, "r+") as dataset:
            dataset.write_colormap(1, {i: (i, 255 - i if coloured else i, i, 255) for i in range(256)})
        if coloured:
            with pytest.raises(SourceError, match=r"a\.tif: a picture of 1 band.*color=.*height_scale="):
                open_height(path)
            np.testing.assert_array_equal(everything(open_height(path, height_scale=2)), data * 2.0)
        else:
            np.testing.assert_array_equal(everything(open_height(path)), data)


def test_bands_and_parts_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = np.stack([hills(), hills() + 1, hills() + 2])
    path = write(tmp_path / "a.tif", data, interleave="pixel", photometric="minisblack")
    with caplog.at_level(logging.WARNING, "orogen"):
        np.testing.assert_array_equal(everything(open_height(path)), data[0])
    assert "vrt://" in caplog.text
    np.testing.assert_array_equal(everything(open_height(f"vrt://{path}?bands=3")), data[2])
    single = write(tmp_path / "b.tif", hills(dtype="float32"))
    for name in ("one", "two"):
        rasterio.shutil.copy(single, tmp_path / "a.gpkg", driver="GPKG", RASTER_TABLE=name, APPEND_SUBDATASET="YES")
    with pytest.raises(SourceError, match=r"a\.gpkg: .*name one of its parts: GPKG:.*:ONE, GPKG:.*:TWO"):
        open_height(tmp_path / "a.gpkg")
    assert open_height(f"GPKG:{tmp_path / 'a.gpkg'}:TWO").grid.shape[0] >= 60


# -- nodata ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dtype", "nodata"), [("uint8", -9999), ("int16", 1e30), ("uint16", 0.5), ("int16", float("nan"))]
)
def test_nodata_that_the_type_cannot_hold_means_none(tmp_path: Path, dtype: str, nodata: float) -> None:
    data = hills().astype(dtype)
    source = open_height(write(tmp_path / "a.tif", data), nodata=nodata)
    assert source.covered
    np.testing.assert_array_equal(everything(source), data)


@pytest.mark.parametrize("value", [3.4028235e38, -3.4e38, 1e30, 1e10, np.inf])
@pytest.mark.usefixtures("either_way")
def test_what_lies_beyond_any_height_is_nodata(tmp_path: Path, value: float) -> None:
    data = hills(dtype="float32")
    data[3, 4], data[5, 6] = value, -9999
    source = open_height(write(tmp_path / "a.tif", data, nodata=-9999))
    assert sorted(map(tuple, np.argwhere(np.isnan(everything(source))))) == [(3, 4), (5, 6)]


@pytest.mark.usefixtures("either_way")
def test_several_undeclared_sentinels(tmp_path: Path) -> None:
    data = hills()
    data[3, 4], data[5, 6] = -32768, -9999
    assert np.isnan(everything(open_height(write(tmp_path / "a.tif", data)))).sum() == 2
    declared = everything(open_height(write(tmp_path / "b.tif", data, nodata=-32768)))
    assert np.isnan(declared).sum() == 2


@pytest.mark.usefixtures("either_way")
def test_alpha_and_masks_beside_the_file(tmp_path: Path) -> None:
    mask = np.full((60, 70), 255, np.uint8)
    mask[10:20, 30:50] = 0
    alpha = write(
        tmp_path / "alpha.tif",
        np.stack([hills(dtype="uint16"), mask * np.uint16(257)]),
        photometric="minisblack",
        alpha="yes",
    )
    np.testing.assert_array_equal(np.isnan(everything(open_height(alpha))), mask == 0)
    beside = write(tmp_path / "beside.tif", hills())
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(beside, "r+") as dataset:
        dataset.write_mask(mask)
    assert (tmp_path / "beside.tif.msk").exists()
    np.testing.assert_array_equal(np.isnan(everything(open_height(beside))), mask == 0)


# -- place ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "place",
    [
        Affine(30, 0, 500_000, 0, 30, 5_000_000),
        Affine(30, 0, 500_000, 0, -90, 5_000_000),
        Affine(0, 30, 500_000, 30, 0, 5_000_000),
        Affine(20, 7, 500_000, 7, -20, 5_000_000),
    ],
)
def test_any_geotransform_is_kept(tmp_path: Path, place: Affine) -> None:
    source = open_height(write(tmp_path / "a.tif", hills(), transform=place))
    x, y = source.grid.to_crs(12.5, 7.5)
    assert (x, y) == pytest.approx(place @ (12.5, 7.5))
    np.testing.assert_array_equal(everything(source), hills())


def test_units_of_local_systems_count(tmp_path: Path) -> None:
    local = 'LOCAL_CS["site",UNIT["US survey foot",0.304800609601219],AXIS["x",EAST],AXIS["y",NORTH]]'
    assert open_height(write(tmp_path / "a.tif", hills(), crs=local)).grid.ground_scale == pytest.approx(
        [1200 / 3937] * 2
    )


def test_degrees_without_a_crs_are_suspected(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path / "a.tif", hills(), **{**DEGREES, "crs": None})
    with caplog.at_level(logging.WARNING, "orogen"):
        open_height(path)
    assert "EPSG:4326" in caplog.text
    assert open_height(path, crs="EPSG:4326").grid.ground_scale[0] > 70_000


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        ({"crs": "EPSG:4978"}, "expected a projected, geographic or local CRS"),
        ({"transform": Affine(float("nan"), 0, 0, 0, -30, 0)}, "expected an invertible geotransform.*spacing="),
        ({"dtype": "complex64"}, "complex numbers"),
        ({"dtype": "complex_int16"}, "complex numbers"),
        (
            {"nodata": 1000, "data": np.full((4, 4), 1000, "int16")},
            r"no valid sample, all are nodata \(1000\).*nodata=",
        ),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path: Path, profile: dict[str, Any], message: str) -> None:
    data = profile.pop("data", hills())
    with pytest.raises(SourceError, match=rf"a\.tif: .*{message}"):
        open_height(write(tmp_path / "a.tif", data, **profile))


@pytest.mark.parametrize(("scale", "offset"), [(0.0, 0.0), (float("nan"), 0.0), (1.0, float("inf"))])
def test_an_impossible_scale_of_a_file_can_be_replaced(tmp_path: Path, scale: float, offset: float) -> None:
    path = write(tmp_path / "a.tif", hills())
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = (scale,), (offset,)
    with pytest.raises(SourceError, match=r"a\.tif: tells a scale of .*height_scale= and height_offset="):
        open_height(path)
    np.testing.assert_array_equal(everything(open_height(path, height_scale=1, height_offset=0)), hills())


def test_a_damaged_file_beside_the_data_is_one_error_and_nothing_on_stderr(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "a.tif", hills())
    (tmp_path / "a.tif.msk").write_bytes(b"II*\0garbage")
    capfd.readouterr()
    with pytest.raises(SourceError, match=r"a\.tif: .*\.msk"):
        open_height(path)
    assert capfd.readouterr() == ("", "")


def test_points_instead_of_a_grid_are_refused_unless_spacing_is_given(tmp_path: Path) -> None:
    corners = [GroundControlPoint(row, col, 15 + col / 100, 45 - row / 90) for row in (0, 60) for col in (0, 70)]
    path = write(tmp_path / "a.tif", hills(), crs=None, transform=None)
    with rasterio.open(path, "r+") as dataset:
        dataset.gcps = corners, rasterio.CRS.from_epsg(4326)
    with pytest.raises(SourceError, match=r"a\.tif: placed by ground control points only.*gdalwarp.*spacing="):
        open_height(path)
    assert open_height(path, spacing=5).grid.spacing == pytest.approx(5)


# -- damage ---------------------------------------------------------------------------------------------------------


def test_a_wrong_checksum_of_a_deflate_block_is_told(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", hills(300, 300), compress="deflate", tiled=True, blockxsize=128, blockysize=128)
    with rasterio.open(path) as dataset:
        start, size = (int(dataset.get_tag_item(f"BLOCK_{what}_1_2", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
    data = bytearray(path.read_bytes())
    data[start + size - 1] ^= 16  # GDAL reads on as if nothing had happened
    path.write_bytes(data)
    with rasterio.open(path) as dataset:
        dataset.read(1)
    with pytest.raises(SourceError, match=r"a\.tif: cannot be read as a raster: .*column 1, row 2 .* damaged"):
        open_height(path)


@pytest.mark.parametrize(("tag", "true", "forged"), [(256, 52, 60), (257, 40, 20)], ids=["width", "height"])
def test_a_deflate_strip_of_another_size_is_told(tmp_path: Path, tag: int, true: int, forged: int) -> None:
    """GDAL leaves samples unset."""
    path = write(tmp_path / "a.tif", hills(40, 52), compress="deflate", blockysize=40)
    data = path.read_bytes()
    entry = struct.pack("<HHIHH", tag, 3, 1, true, 0)
    assert data.count(entry) == 1
    path.write_bytes(data.replace(entry, struct.pack("<HHIHH", tag, 3, 1, forged, 0)))
    with pytest.raises(SourceError, match=r"a\.tif: cannot be read as a raster"):
        open_height(path)


def test_bits_and_bands_in_deflate_blocks_are_no_damage(tmp_path: Path) -> None:
    odd = hills(41, 53).astype(np.uint16) % 4096
    for options in ({"nbits": 12}, {"tiled": True, "blockxsize": 16, "blockysize": 32}, {"blockysize": 7}):
        path = write(tmp_path / "a.tif", odd, compress="deflate", **options)
        np.testing.assert_array_equal(everything(open_height(path)), odd)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "int32", "float32", "float64"])
def test_compressed_imagine_files_equal_rasterio(tmp_path: Path, dtype: str) -> None:
    flat = np.repeat(np.arange(200), 2)[None, :] // 37 + np.zeros((150, 1))
    for name, data in (("hills", hills(150, 400) // 11), ("flat", flat), ("level", np.full((150, 400), 7))):
        path = tmp_path / f"{name}.img"
        rasterio.shutil.copy(write(tmp_path / "a.tif", data.astype(dtype)), path, driver="HFA", COMPRESSED="YES")
        with rasterio.open(path) as dataset:
            expected = dataset.read(1).astype(np.float64)
        np.testing.assert_array_equal(everything(open_height(path)), expected)


@pytest.mark.parametrize("what", ["runs", "types"])
def test_damaged_runs_of_an_imagine_file_are_told(tmp_path: Path, what: str) -> None:
    """GDAL reads either as if nothing had happened, and shows what was in memory."""
    path = tmp_path / "a.img"
    flat = np.repeat(np.arange(64), 64).reshape(64, 64)
    rasterio.shutil.copy(write(tmp_path / "a.tif", flat.astype(np.int16)), path, driver="HFA", COMPRESSED="YES")
    data = bytearray(path.read_bytes())
    # the only block: its least value, 64 runs whose lengths take two bytes each, and where their values begin
    start = next(n for n in range(len(data) - 12) if struct.unpack_from("<iII", data, n) == (0, 64, 13 + 128))
    if what == "runs":
        struct.pack_into("<I", data, start + 4, 60)
    else:
        at = data.index(b"1:Loffset,1:lsize,")
        data[at + 2 : at + 3] = b"s"
    path.write_bytes(data)
    with rasterio.open(path) as dataset:
        dataset.read(1)
    with pytest.raises(SourceError, match=r"a\.img: cannot be read as a raster: damaged IMAGINE file"):
        open_height(path)


def test_a_jpeg2000_of_more_tiles_than_it_has_room_for_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.jp2"
    rasterio.shutil.copy(
        write(tmp_path / "a.tif", hills(300, 400).astype(np.int16)), path, driver="JP2OpenJPEG", REVERSIBLE="YES",
        QUALITY=100, BLOCKXSIZE=64, BLOCKYSIZE=64,
    )  # fmt: skip
    np.testing.assert_array_equal(everything(open_height(path)), hills(300, 400).astype(np.int16))
    data = bytearray(path.read_bytes())
    struct.pack_into(">I", data, data.index(bytes.fromhex("ff4fff51")) + 8, 1 << 20)
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r"a\.jp2: .*damaged JPEG 2000, 1048576 x 300 samples in tiles of 64 x 64"):
        open_height(path)


def test_gigantic_headers_are_refused_before_anything_is_read(tmp_path: Path) -> None:
    """A TIFF of 200 bytes that claims one block of 2^31 x 2^31 samples, and others like it."""
    for name, width, height, rows in (
        ("a", 2**31 - 1, 2**31 - 1, 2**31 - 1),
        ("b", 2**31 - 1, 8, 8),
        ("c", 60_000, 60_000, 60_000),
    ):
        tags = [
            (256, 4, width),
            (257, 4, height),
            (258, 3, 16),
            (259, 3, 1),
            (262, 3, 1),
            (273, 4, 8),
            (278, 4, rows),
            (279, 4, 64),
        ]
        directory = struct.pack("<H", len(tags)) + b"".join(
            struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags
        )
        path = tmp_path / f"{name}.tif"
        path.write_bytes(b"II*\0" + struct.pack("<I", 80) + bytes(72) + directory + bytes(4))
        with pytest.raises(SourceError, match=rf"{name}\.tif"):
            everything(open_height(path, spacing=1))


def test_a_png_of_a_gigantic_row_is_refused(tmp_path: Path) -> None:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 16, 0, 0, 0, 0)
    path = tmp_path / "a.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(99))) + chunk(b"IEND", b"")
    )
    with pytest.raises(SourceError, match=r"a\.png"):
        open_height(path, spacing=1)


def test_what_is_no_file_of_data_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.tif").touch()
    (tmp_path / "text.tif").write_text("hello")
    (tmp_path / "folder").mkdir()
    cases = [("empty.tif", "an empty file of 0 bytes"), ("text.tif", "not recognized"), ("folder", "an empty folder")]
    if sys.platform != "win32":
        os.mkfifo(tmp_path / "pipe")
        cases.append(("pipe", "a pipe or device"))
    for name, message in cases:
        with pytest.raises(SourceError, match=f"{name}: .*{message}"):
            open_height(tmp_path / name)
    for path in ("", "a\0b"):
        with pytest.raises(SourceError, match="expected the path of a raster"):
            open_height(path)
