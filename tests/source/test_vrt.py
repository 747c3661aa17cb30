"""What virtual rasters show: damaged, hostile or missing files, and each other."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.vrt import WarpedVRT

from orogen.errors import SourceError
from orogen.source import open_height
from rasters import everything, hills, write

DATA = hills(40, 52).astype(np.int16)


@pytest.fixture
def good(tmp_path: Path) -> str:
    """The text of a VRT that shows good.tif beside it, of the samples `DATA`."""
    write(tmp_path / "good.tif", DATA)
    rasterio.shutil.copy(tmp_path / "good.tif", tmp_path / "good.vrt", driver="VRT")
    text = (tmp_path / "good.vrt").read_text()
    text = text.replace('relativeToVRT="0"', 'relativeToVRT="1"').replace(str(tmp_path / "good.tif"), "good.tif")
    assert 'relativeToVRT="1">good.tif<' in text
    (tmp_path / "good.vrt").write_text(text)
    return text


def showing(name: Path, text: str, part: str, relative: bool = True) -> Path:
    """A VRT that shows another file."""
    new = f'relativeToVRT="{int(relative)}">{part}<'
    name.write_text(text.replace('relativeToVRT="1">good.tif<', new))
    return name


def refused(path: Path, message: str) -> None:
    with pytest.raises(SourceError, match=rf"{path.name}: {message}"):
        open_height(path)


def cut(path: Path, share: float) -> Path:
    """The file, without its end."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def test_a_vrt_in_a_vrt_is_the_raster(tmp_path: Path, good: str) -> None:
    outer = showing(tmp_path / "outer.vrt", good, "good.vrt")
    np.testing.assert_array_equal(everything(open_height(outer)), DATA)
    inline = good.replace('relativeToVRT="1">good.tif', f'relativeToVRT="0">{tmp_path / "good.tif"}')
    for escaped in (inline.replace("&", "&amp;").replace("<", "&lt;"), f"<![CDATA[{inline}]]>"):
        outer = showing(tmp_path / "inline.vrt", good, escaped, relative=False)
        np.testing.assert_array_equal(everything(open_height(outer)), DATA)


@pytest.mark.parametrize("lost", [r"<SrcRect[^>]*>", r"(?<=<SrcRect xOff=)\"0\"", r"<SimpleSource>.*</SimpleSource>"])
def test_a_damaged_vrt_in_a_vrt_is_refused(tmp_path: Path, good: str, lost: str) -> None:
    inner = re.sub(lost, "", good, flags=re.DOTALL)
    assert inner != good
    (tmp_path / "inner.vrt").write_text(inner)
    refused(showing(tmp_path / "outer.vrt", good, "inner.vrt"), r"shows .*inner\.vrt: .*damaged VRT")
    showing(tmp_path / "middle.vrt", good, "inner.vrt")
    refused(showing(tmp_path / "outer.vrt", good, "middle.vrt"), r"shows .*inner\.vrt: .*damaged VRT")
    inline = inner.replace("<", "&lt;")
    refused(showing(tmp_path / "outer.vrt", good, inline), r"shows a VRT within it: .*damaged VRT")


def test_a_vrt_that_shows_itself_is_refused(tmp_path: Path, good: str) -> None:
    refused(showing(tmp_path / "a.vrt", good, "a.vrt"), r"shows .*a\.vrt: shows itself")
    showing(tmp_path / "b.vrt", good, "a.vrt")
    refused(showing(tmp_path / "a.vrt", good, "b.vrt"), r"shows .*a\.vrt: shows itself")


def test_vrts_within_each_other_are_bounded(tmp_path: Path, good: str) -> None:
    """GDAL shows no more than so many, and would read the raster of a few files for years."""
    last = "good.tif"
    for number in range(40):
        last = showing(tmp_path / f"{number}.vrt", good, last).name
    np.testing.assert_array_equal(everything(open_height(tmp_path / "20.vrt")), DATA)
    refused(tmp_path / "39.vrt", r"shows .*\.vrt: more than 32 VRTs within each other")
    source = re.search(r"<SimpleSource>.*</SimpleSource>", good, re.DOTALL)
    assert source
    last = "good.tif"
    for number in range(9):
        path = tmp_path / f"times{number}.vrt"
        path.write_text(good.replace(source[0], source[0].replace("good.tif", last) * 9))
        last = path.name
    np.testing.assert_array_equal(everything(open_height(tmp_path / "times1.vrt")), DATA)
    refused(path, r".*shows \d+ rasters, most of them again and again")


@pytest.mark.parametrize("share", [0.02, 0.6])
def test_what_is_cut_off_is_named(tmp_path: Path, good: str, share: float) -> None:
    outer = showing(tmp_path / "outer.vrt", good, "other.tif")
    write(tmp_path / "other.tif", DATA, compress="deflate", blockysize=8)
    np.testing.assert_array_equal(everything(open_height(outer)), DATA)
    cut(tmp_path / "other.tif", share)
    refused(outer, r".*other\.tif")


def test_a_wrong_checksum_is_told(tmp_path: Path, good: str) -> None:
    other = write(tmp_path / "other.tif", DATA, compress="deflate", tiled=True, blockxsize=64, blockysize=64)
    with rasterio.open(other) as dataset:
        start, size = (int(dataset.get_tag_item(f"BLOCK_{what}_0_0", "TIFF", bidx=1)) for what in ("OFFSET", "SIZE"))
    outer = showing(tmp_path / "outer.vrt", good, "other.tif")
    np.testing.assert_array_equal(everything(open_height(outer)), DATA)
    data = bytearray(other.read_bytes())
    data[start + size - 1] ^= 16
    other.write_bytes(data)
    refused(outer, r"(shows .*|.*: )other\.tif: ")


@pytest.mark.parametrize("driver", ["netCDF", "JP2OpenJPEG", "GPKG"])
def test_other_formats_are_checked_too(tmp_path: Path, good: str, driver: str) -> None:
    """The library of netCDF ends the process over such a header, and takes what is cut off for zeros."""
    name = {"netCDF": "other.nc", "JP2OpenJPEG": "other.jp2", "GPKG": "other.gpkg"}[driver]
    settings = {"REVERSIBLE": "YES", "QUALITY": "100"} if driver == "JP2OpenJPEG" else {}
    rasterio.shutil.copy(
        write(tmp_path / "plain.tif", DATA.astype("float32") if driver == "GPKG" else DATA),
        tmp_path / name, driver=driver, **settings,
    )  # fmt: skip
    outers = [showing(tmp_path / "outer.vrt", good, name)]
    if driver == "netCDF":
        outers.append(showing(tmp_path / "part.vrt", good, f"NETCDF:&quot;{name}&quot;:Band1"))
    for outer in outers:
        np.testing.assert_array_equal(everything(open_height(outer))[:40, :52], DATA)
    if driver == "netCDF":
        data = bytearray((tmp_path / name).read_bytes())
        data[12:16] = b"\x7f\xff\xff\xff"
        (tmp_path / name).write_bytes(data)
        for outer in outers:
            refused(outer, r"shows .*other\.nc: .*damaged netCDF header")
        data[12:16] = b"\0\0\0\2"
        (tmp_path / name).write_bytes(data)
    cut(tmp_path / name, 0.8)
    for outer in outers:
        refused(outer, rf".*{name}")


@pytest.mark.skipif(sys.platform == "win32", reason="it has no such files")
def test_pipes_and_devices_are_refused(tmp_path: Path, good: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    raw = re.sub(
        r"<VRTRasterBand.*</VRTRasterBand>",
        '<VRTRasterBand dataType="Int16" band="1" subClass="VRTRawRasterBand">'
        '<SourceFilename relativetoVRT="1">good.tif</SourceFilename></VRTRasterBand>',
        good,
        flags=re.DOTALL,
    )
    for name in ("pipe", "/dev/zero"):
        for text in (good, raw.replace("relativetoVRT", "relativeToVRT")):
            refused(showing(tmp_path / "outer.vrt", text, name), rf"shows .*{name}: .*a pipe or device")
    with pytest.raises(SourceError, match="a pipe or device"):
        open_height(f"vrt://{tmp_path / 'pipe'}?bands=1")


def test_bare_samples_must_all_be_there(tmp_path: Path, good: str) -> None:
    (tmp_path / "samples.bin").write_bytes(b"head" + DATA.astype(">i2").tobytes())
    path = tmp_path / "raw.vrt"
    path.write_text(
        re.sub(
            r"<VRTRasterBand.*</VRTRasterBand>",
            '<VRTRasterBand dataType="Int16" band="1" subClass="VRTRawRasterBand">'
            '<SourceFilename relativetoVRT="1">samples.bin</SourceFilename><ImageOffset>4</ImageOffset>'
            "<PixelOffset>2</PixelOffset><LineOffset>104</LineOffset><ByteOrder>MSB</ByteOrder></VRTRasterBand>",
            good,
            flags=re.DOTALL,
        )
    )
    np.testing.assert_array_equal(everything(open_height(path)), DATA)
    cut(tmp_path / "samples.bin", 0.99)
    refused(path, r"shows .*samples\.bin: 4122 bytes of bare samples, expected at least 4164")


def test_what_a_warped_raster_shows_is_named_where_it_is_missing(tmp_path: Path, good: str) -> None:
    with rasterio.open(tmp_path / "good.tif") as dataset, WarpedVRT(dataset, crs="EPSG:4326") as warped:
        rasterio.shutil.copy(warped, tmp_path / "warped.vrt", driver="VRT")
    assert np.nanmax(everything(open_height(tmp_path / "warped.vrt"))) <= DATA.max()
    (tmp_path / "good.tif").rename(tmp_path / "elsewhere.tif")
    refused(tmp_path / "warped.vrt", r"shows .*good\.tif: no such file")


@pytest.mark.parametrize(
    "part", ["gone.tif", ".", "empty.tif", "text.tif", "/vsicurl/http://127.0.0.1:9/a.tif", "/vsistdin/"]
)
def test_what_is_no_raster_is_one_error(tmp_path: Path, good: str, part: str) -> None:
    (tmp_path / "empty.tif").touch()
    (tmp_path / "text.tif").write_text("hello")
    refused(showing(tmp_path / "outer.vrt", good, part, relative=not part.startswith("/")), "cannot be read")


def test_a_part_of_a_file_of_several_is_shown(tmp_path: Path, good: str) -> None:
    """The file itself has no band then."""
    from scipy.io import netcdf_file

    with netcdf_file(tmp_path / "two.nc", "w") as file:
        for name, size in (("y", 40), ("x", 52)):
            file.createDimension(name, size)
        for name in ("z", "other"):
            file.createVariable(name, "h", ("y", "x"))[:] = DATA
    outer = showing(tmp_path / "outer.vrt", good, "NETCDF:&quot;two.nc&quot;:z")
    assert np.isin(everything(open_height(outer)), DATA).all()
