"""Mutated rasters, and the process that opens them: run by test_fuzz.py, `python fuzzing.py FOLDER FIRST COUNT`.

A case is a number: it picks a raster, a mutation and the random numbers of both, so that each can be run again alone.
The process writes a line of JSON before each case and one after it, and never opens a GPU.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import struct
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.enums import Resampling
from rasterio.transform import from_origin

NASTY = (
    0,
    1,
    2,
    3,
    7,
    255,
    256,
    32767,
    32768,
    65535,
    65536,
    2**24,
    2**30,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**63 - 1,
    2**64 - 1,
)
"""Numbers that readers of headers stumble over."""
WORDS = (
    b"0",
    b"-1",
    b"1",
    b"2147483647",
    b"2147483648",
    b"4294967296",
    b"1e308",
    b"nan",
    b"-inf",
    b"99999999999999999999",
    b"",
)
"""The same as text."""
FORMATS: dict[str, dict[str, Any]] = {
    "striped.tif": {},
    "tiled.tif": {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate", "predictor": 2},
    "lzw.tif": {"compress": "lzw", "nodata": -5},
    "zstd.tif": {"compress": "zstd", "dtype": "float32", "predictor": 3},
    "lerc.tif": {"compress": "lerc", "dtype": "float32"},
    "jpeg.tif": {"compress": "jpeg", "dtype": "uint8", "tiled": True, "blockxsize": 16, "blockysize": 16},
    "packbits.tif": {"compress": "packbits", "dtype": "uint8"},
    "double.tif": {"dtype": "float64", "nodata": -9999},
    "big.tif": {"BIGTIFF": "YES", "tiled": True, "blockxsize": 16, "blockysize": 16},
    "motorola.tif": {"ENDIANNESS": "BIG"},
    "twelve.tif": {"dtype": "uint16", "nbits": 12},
    "bands.tif": {"count": 3, "interleave": "pixel"},
    "overviews.tif": {"tiled": True, "blockxsize": 16, "blockysize": 16, "overviews": True},
    "mask.tif": {"mask": True, "compress": "deflate"},
    "palette.tif": {"dtype": "uint8", "photometric": "palette"},
    "a.png": {"driver": "PNG", "dtype": "uint16"},
    "a.jpg": {"driver": "JPEG", "dtype": "uint8"},
    "a.jp2": {"driver": "JP2OpenJPEG"},
    "a.asc": {"driver": "AAIGrid"},
    "a.img": {"driver": "HFA", "COMPRESSED": "YES"},
    "a.nc": {"driver": "netCDF"},
    "b.nc": {"driver": "netCDF", "FORMAT": "NC4"},
    "a.grb": {"driver": "GRIB", "dtype": "float32"},
    "a.vrt": {"driver": "VRT"},
    "a.gpkg": {"driver": "GPKG", "dtype": "float32"},
    "a.bmp": {"driver": "BMP", "dtype": "uint8"},
    "a.grd": {"driver": "GSBG", "dtype": "float32"},
    "a.dem": {"driver": "USGSDEM"},
    "a.bt": {"driver": "BT"},
    "a.ntf": {"driver": "NITF"},
}
"""File names and how they are written."""


def rasters(folder: Path) -> list[Path]:
    """A small raster of each format that this GDAL writes, in `folder`."""
    y, x = np.indices((40, 52))
    hills = 500 + 200 * np.sin(x / 9) * np.cos(y / 7) + x
    paths = []
    with warnings.catch_warnings(), rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True, GDAL_PAM_ENABLED="NO"):
        warnings.simplefilter("ignore")
        for name, given in FORMATS.items():
            settings = {"driver": "GTiff", "dtype": "int16", "count": 1, **given}
            driver = settings.pop("driver")
            overviews, mask = settings.pop("overviews", False), settings.pop("mask", False)
            plain = folder.parent / "plain.tif" if driver != "GTiff" else folder / name
            heights = hills / 4 if settings["dtype"] == "uint8" else hills
            place = {
                "crs": "EPSG:32633",
                "transform": from_origin(500_000, 5_000_000, 30, 30),
                "width": 52,
                "height": 40,
            }
            basic = {key: settings[key] for key in ("dtype", "count")}
            creation = settings if driver == "GTiff" else basic
            with rasterio.open(plain, "w", driver="GTiff", **place, **creation) as dataset:
                for band in dataset.indexes:
                    dataset.write(heights.astype(settings["dtype"]), band)
                if mask:
                    dataset.write_mask((hills > 400).astype(np.uint8) * 255)
                if overviews:
                    dataset.build_overviews([2, 4], Resampling.average)
                if settings.get("photometric") == "palette":
                    dataset.write_colormap(1, {i: (i, 255 - i, 0, 255) for i in range(256)})
            if driver != "GTiff":
                try:
                    rasterio.shutil.copy(
                        plain, folder / name, driver=driver, **{k: settings[k] for k in settings.keys() - basic}
                    )
                    if driver == "VRT":  # the same bytes wherever the folder lies
                        text = (folder / name).read_text().replace('relativeToVRT="0"', 'relativeToVRT="1"')
                        (folder / name).write_text(text.replace(str(plain), "plain.tif"))
                except rasterio.errors.RasterioError:
                    continue
            paths.append(folder / name)
    return paths


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes of a raster with one to three faults."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        fault = FAULTS[rng.integers(len(FAULTS))]
        data = fault(data, rng) if len(data) > 16 else data
    return data


def _place(data: bytes, rng: np.random.Generator, size: int = 1) -> int:
    """Where to change `size` bytes: in the header mostly, where it hurts."""
    end = len(data) - size
    return int(rng.integers(0, min(end, 400) + 1 if rng.random() < 0.7 else end + 1))


def _truncated(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(1, len(data))]


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        changed[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _overwritten(data: bytes, rng: np.random.Generator) -> bytes:
    size = int(rng.choice([1, 2, 4, 8]))
    number = NASTY[rng.integers(len(NASTY))] % 2 ** (8 * size)
    at = _place(data, rng, size)
    return data[:at] + number.to_bytes(size, "little" if rng.random() < 0.8 else "big") + data[at + size :]


def _cut_out(data: bytes, rng: np.random.Generator) -> bytes:
    at, size = _place(data, rng), int(rng.integers(1, 64))
    return data[:at] + data[at + size :]


def _repeated(data: bytes, rng: np.random.Generator) -> bytes:
    at, size = _place(data, rng), int(rng.integers(1, 256))
    return data[: at + size] + data[at:]


def _noisy(data: bytes, rng: np.random.Generator) -> bytes:
    at, size = _place(data, rng), int(rng.integers(1, 64))
    return data[:at] + rng.bytes(size) + data[at + size :]


def _renumbered(data: bytes, rng: np.random.Generator) -> bytes:
    """Another number in a text, such as a VRT's or an ASCII grid's; of other formats the same as `_overwritten`."""
    numbers = list(re.finditer(rb"-?\d+(\.\d+)?", data[:3000]))
    if not numbers or b"\0" in data[:200]:
        return _overwritten(data, rng)
    found = numbers[rng.integers(len(numbers))]
    return data[: found.start()] + WORDS[rng.integers(len(WORDS))] + data[found.end() :]


def _retagged(data: bytes, rng: np.random.Generator) -> bytes:
    """Another type, count or value of a tag of a TIFF; of other formats the same as `_overwritten`."""
    if data[:4] != b"II*\0":
        return _overwritten(data, rng)
    start = struct.unpack_from("<I", data, 4)[0]
    if start + 2 > len(data):
        return data
    count = struct.unpack_from("<H", data, start)[0]
    entry = start + 2 + 12 * int(rng.integers(max(count, 1)))
    if entry + 12 > len(data):
        return data
    part, size = ((0, 2), (2, 2), (4, 4), (8, 4), (8, 4), (8, 4))[rng.integers(6)]
    number = NASTY[rng.integers(len(NASTY))] % 2 ** (8 * size)
    return data[: entry + part] + number.to_bytes(size, "little") + data[entry + part + size :]


FAULTS = (_truncated, _flipped, _overwritten, _cut_out, _repeated, _noisy, _renumbered, _retagged, _retagged)


def case(paths: list[Path], number: int) -> tuple[str, bytes]:
    """File name and bytes of a case."""
    rng = np.random.default_rng(number)
    path = paths[number % len(paths)]
    return path.name, mutated(path.read_bytes(), rng)


def load(path: Path) -> str:
    """Open and read a raster as a user would: "refused", or "loaded" once it equals what rasterio reads."""
    from orogen.errors import SourceError
    from orogen.source import open_colour, open_height
    from orogen.source.heights import ArraySamples, HeightSource

    flat = open_height(np.zeros((8, 8)), spacing=1)
    with contextlib.suppress(SourceError):
        open_colour(path, flat).read(slice(0, 1), slice(0, 1))
    try:
        source = open_height(path)
        rows, cols = source.grid.shape
        windows = [(slice(0, min(rows, 256)), slice(0, min(cols, 256)))]
        windows.append((slice(max(0, rows - 256), rows), slice(max(0, cols - 256), cols)))
        parts: list[Any] = [(window, source.read(*window)) for window in windows]
        if rows * cols < 2**26:
            source.overview((64, 64))
        for overview in source.overviews:
            parts.append((None, overview.read(*(slice(0, min(size, 256)) for size in overview.shape))))
    except SourceError as error:
        return "refused" if path.name in str(error) else f"the error does not name the file: {error}"
    assert isinstance(source, HeightSource)
    for _, part in parts:
        finite = part[np.isfinite(part)]
        assert not finite.size or np.abs(finite).max() <= 1e9, "a height beyond the valid range"
    source.close()
    if isinstance(source.samples, ArraySamples):
        same_as_rasterio(path, [part for part in parts if part[0]], source.values)
    return "loaded"


def same_as_rasterio(path: Path, parts: list[Any], values: Any) -> None:
    """AssertionError where valid heights differ from what rasterio reads, scaled in float64."""
    # GDAL's own threads lose what JPEG 2000 tiles lack, and show what happens to be in memory
    with warnings.catch_warnings(), rasterio.Env(GDAL_NUM_THREADS="1"):
        warnings.simplefilter("ignore")
        try:
            dataset = rasterio.open(path)
        except rasterio.errors.RasterioError:
            return  # libraries that keep state refuse a damaged file the second time
        with dataset:
            for (rows, cols), part in parts:
                window = ((rows.start, rows.stop), (cols.start, cols.stop))
                raw = dataset.read(1, window=window)
                with np.errstate(all="ignore"):
                    expected = raw.astype(np.float64) * values.scale + values.offset
                masked = dataset.read_masks(1, window=window) == 0
                valid = np.isfinite(part)
                assert not (valid & masked).any(), "nodata was taken as a height"
                np.testing.assert_allclose(part[valid], expected[valid], rtol=1e-6, atol=1e-30)


def peak() -> float:
    """Most memory that this process has had (MB)."""
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def tell(what: dict[str, Any]) -> None:
    """A line of JSON, at once."""
    os.write(OUT, (json.dumps(what) + "\n").encode())


def main(folder: Path, first: int, count: int) -> None:
    """Open the cases `first` and on; print what became of each."""
    import logging

    logging.getLogger("orogen").setLevel(logging.ERROR)
    paths = sorted((folder / "whole").iterdir())
    for path in paths:
        if path.suffix != ".vrt":
            assert load(path) == ("refused" if path.name == "palette.tif" else "loaded")
    idle = peak()
    work = folder / f"case-{first}"
    work.mkdir()
    shutil.copy(folder / "plain.tif", work)  # what the VRT shows
    for number in range(first, first + count):
        name, data = case(paths, number)
        # a path of its own: the netCDF library may keep what it once read at a path
        path = work / f"{number}-{name}"
        path.write_bytes(data)
        tell({"case": number, "name": name})
        start = time.process_time()
        try:
            outcome = load(path)
        except Exception as error:
            outcome = f"{type(error).__name__}: {error}"
        seconds = time.process_time() - start
        tell({"outcome": outcome, "seconds": seconds, "memory": peak() - idle})
        path.unlink()
    assert "wgpu" not in sys.modules, "opening a raster takes no GPU"


if __name__ == "__main__":
    OUT = os.dup(1)
    os.dup2(2, 1)  # some libraries below GDAL write to stdout
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
