"""Stores: complete or not trusted, checked, shared by processes, readable by others; builds in the background."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from orogen.errors import OutputError, SettingsError, SourceError, StoreError
from orogen.keys import level_shape
from orogen.pyramid import Pyramid, build, open_pyramid
from orogen.source import cache, open_colour, open_height, survey
from rasters import write_tiled as write

SHAPE = (700, 900)


def heights(shape: tuple[int, int] = SHAPE, seed: int = 1) -> NDArray[np.int16]:
    y, x = np.indices(shape)
    rough = np.random.default_rng(seed).integers(0, 30, shape)
    return (1000 + 400 * np.sin(x / 60) * np.cos(y / 45) + rough).astype(np.int16)


@pytest.fixture
def dem(tmp_path: Path) -> Path:
    data = heights()
    data[100:160, 200:400] = -1
    return write(tmp_path / "dem.tif", data, nodata=-1)


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    return tmp_path / "cache"


def whole(pyramid: Pyramid, level: int) -> NDArray[Any]:
    rows, cols = level_shape(pyramid.grid.shape, level)
    return pyramid.read(level, slice(0, rows), slice(0, cols))


def only_entry(shelf: Path) -> Path:
    (entry,) = shelf.iterdir()
    return entry


def test_a_built_pyramid_is_opened_not_built_again(dem: Path, shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_pyramid(open_height(dem), cache=shelf) as first:
        levels = [whole(first, level) for level in range(first.level_count)]
    monkeypatch.setattr(build.Builder, "run", None)
    with open_pyramid(open_height(dem), cache=shelf) as second:
        assert second.built
        assert second.height_range == first.height_range
        for level, expected in enumerate(levels):
            np.testing.assert_array_equal(whole(second, level), expected)
            np.testing.assert_array_equal(second.node_bounds(level), first.node_bounds(level))


def test_changed_data_and_settings_get_a_pyramid_of_their_own(dem: Path, shelf: Path) -> None:
    for options in ({}, {"height_scale": 2.0}):
        open_pyramid(open_height(dem, **options), cache=shelf).close()
    write(dem, heights(seed=2))
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        assert pyramid.covered
    assert len(list(shelf.iterdir())) == 3


def test_the_mark_of_another_format_is_not_trusted(dem: Path, shelf: Path) -> None:
    open_pyramid(open_height(dem), cache=shelf).close()
    text = (only_entry(shelf) / "zarr.json").read_text()
    (only_entry(shelf) / "zarr.json").write_text(text.replace('"format": 1', '"format": 0'))
    with open_pyramid(open_height(dem), cache=shelf, build="never") as pyramid:
        assert not pyramid.built
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        assert pyramid.built
    assert (only_entry(shelf) / "zarr.json").read_text() == text


@pytest.mark.parametrize("name", ["height", "coverage"])
def test_a_missing_shard_is_not_nodata(dem: Path, shelf: Path, name: str) -> None:
    open_pyramid(open_height(dem), cache=shelf).close()
    shards = [path for path in (only_entry(shelf) / "1" / name / "c").rglob("*") if path.is_file()]
    shards[0].unlink()
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        read = pyramid.read if name == "height" else pyramid.read_coverage
        with pytest.raises(StoreError, match=r"level 1 is damaged or incomplete .*run `orogen cache clear`"):
            read(1, slice(0, 350), slice(0, 450))


@pytest.mark.parametrize("position", [0.1, 0.5, 0.999])
def test_a_flipped_bit_is_found(dem: Path, shelf: Path, position: float) -> None:
    open_pyramid(open_height(dem), cache=shelf).close()
    shard = next(path for path in (only_entry(shelf) / "1" / "height" / "c").rglob("*") if path.is_file())
    content = bytearray(shard.read_bytes())
    content[int(len(content) * position)] ^= 4
    shard.write_bytes(content)
    with open_pyramid(open_height(dem), cache=shelf) as pyramid, pytest.raises(StoreError, match="level 1 is damaged"):
        whole(pyramid, 1)


def test_damaged_bounds_are_found_when_the_store_is_opened(dem: Path, shelf: Path) -> None:
    open_pyramid(open_height(dem), cache=shelf).close()
    chunk = only_entry(shelf) / "2" / "bounds" / "c" / "0" / "0" / "0"
    content = bytearray(chunk.read_bytes())
    content[0] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(StoreError, match="level 2 is damaged"):
        open_pyramid(open_height(dem), cache=shelf)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_a_killed_build_leaves_nothing_trusted(dem: Path, shelf: Path) -> None:
    script = """
import sys, time
from pathlib import Path
from orogen.pyramid import open_pyramid
from orogen.source import open_height
def progress(fraction, text):
    print("building", flush=True)
    time.sleep(60)
open_pyramid(open_height(sys.argv[1]), cache=Path(sys.argv[2]), progress=progress)
"""
    process = subprocess.Popen([sys.executable, "-c", script, str(dem), str(shelf)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"building\n"
    left = only_entry(shelf)
    with open_pyramid(open_height(dem), cache=shelf, build="never") as pyramid:
        assert not pyramid.built
    cache.tidy(shelf)
    assert left.exists()  # the builder is alive
    process.send_signal(signal.SIGKILL)
    process.wait()
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        assert pyramid.built
        assert only_entry(shelf) != left


def test_builders_at_the_same_time_agree(dem: Path, shelf: Path) -> None:
    with ThreadPoolExecutor(3) as pool:
        pyramids = list(pool.map(lambda _: open_pyramid(open_height(dem), cache=shelf), range(3)))
    for pyramid in pyramids:
        np.testing.assert_array_equal(whole(pyramid, 1), whole(pyramids[0], 1))
        pyramid.close()
    only_entry(shelf)


def test_a_pyramid_in_use_is_not_cleared(dem: Path, shelf: Path) -> None:
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        cache.clear(shelf)
        assert whole(pyramid, 1).shape == (350, 450)
    cache.clear(shelf)
    assert not list(shelf.iterdir())


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() != 0, reason="needs a folder that even root cannot write")
def test_a_pyramid_that_can_never_fit_is_not_begun(dem: Path, shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = SHAPE[0] * SHAPE[1] * 2 // 3 // 16 - 1
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(2 * free, free, free))
    for way in ("auto", "wait"):
        with pytest.raises(OutputError, match=r"GB free in .*got \d+ x \d+ samples.*gdaladdo"):
            open_pyramid(open_height(dem), cache=shelf, build=way)
    with open_pyramid(open_height(dem), cache=shelf, build="background") as pyramid:
        with pytest.raises(OutputError, match="GB free in"):
            pyramid.wait()
        assert pyramid.read_estimate(pyramid.estimate_level, slice(0, 4), slice(0, 4)).any()
    assert not shelf.exists() or not list(shelf.iterdir())
    open_pyramid(open_height(dem), cache=shelf, build="never").close()
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(2 * free, free, free + 1))
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        assert pyramid.built


def test_a_cache_that_cannot_be_written_is_one_clear_error(dem: Path) -> None:
    with pytest.raises(OutputError, match=r"cannot be written there .*OROGEN_CACHE_DIR"):
        open_pyramid(open_height(dem), cache=Path("/proc/orogen"))


def test_a_cache_that_is_a_file_is_one_clear_error(dem: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written there"):
        open_pyramid(open_height(dem), cache=tmp_path / "file")


@pytest.mark.skipif(sys.platform == "win32", reason="there is no RLIMIT_FSIZE")
def test_a_full_disk_is_one_clear_error_and_leaves_nothing(dem: Path, shelf: Path) -> None:
    script = """
import resource, signal, sys
from pathlib import Path
from orogen.errors import OutputError
from orogen.pyramid import open_pyramid
from orogen.source import open_height
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
source = open_height(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
try:
    open_pyramid(source, cache=Path(sys.argv[2]))
except OutputError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script, str(dem), str(shelf)], capture_output=True, text=True)
    assert "cannot be written there" in done.stdout, done.stderr
    assert not list(shelf.iterdir())


def test_arrays_leave_nothing_behind(shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    pyramid = open_pyramid(open_height(heights(), spacing=1), cache=shelf)
    assert pyramid.built
    assert len(list(tmp_path.glob("orogen-*"))) == 1
    pyramid.close()
    assert not list(tmp_path.glob("orogen-*"))
    assert not shelf.exists()


@pytest.mark.parametrize("driver", ["GTiff", "PNG"])
def test_level_0_of_slow_formats_is_stored(
    tmp_path: Path, shelf: Path, monkeypatch: pytest.MonkeyPatch, driver: str
) -> None:
    monkeypatch.setattr(survey, "IN_MEMORY", 0)
    data = heights((1100, 2300)).astype(np.uint16)
    layout = {"tiled": False, "blockxsize": None, "blockysize": None} if driver == "GTiff" else {"zlevel": 1}
    source = open_height(write(tmp_path / "a", data, driver=driver, **layout), spacing=1)
    assert not source.direct
    with open_pyramid(source, cache=shelf) as pyramid, open_pyramid(open_height(data, spacing=1)) as direct:
        for level in range(1, pyramid.level_count):
            np.testing.assert_array_equal(whole(pyramid, level), whole(direct, level))
            np.testing.assert_array_equal(pyramid.node_bounds(level), direct.node_bounds(level))
        monkeypatch.setattr(type(source), "read", None)  # level 0 comes from the store
        np.testing.assert_array_equal(whole(pyramid, 0), data)
        np.testing.assert_array_equal(pyramid.read(0, slice(500, 700), slice(1000, 1300)), data[500:700, 1000:1300])


def test_colours_and_heights_of_one_file_are_kept_apart(tmp_path: Path, shelf: Path) -> None:
    path = write(tmp_path / "a.tif", heights().clip(0, 2000).astype(np.uint16))
    source = open_height(path)
    with (
        open_pyramid(source, cache=shelf) as elevation,
        open_pyramid(open_colour(path, source), cache=shelf) as colour,
    ):
        assert elevation.kind == "height"
        assert colour.kind == "colour"
        assert whole(colour, 1).shape == (350, 450, 4)
        assert colour.node_bounds(1) is None


def test_threads_read_what_one_thread_reads(dem: Path, shelf: Path) -> None:
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        expected = [whole(pyramid, level) for level in range(pyramid.level_count)]

        def same(seed: int) -> bool:
            rng = np.random.default_rng(seed)
            for _ in range(30):
                level = int(rng.integers(0, pyramid.level_count))
                shape = expected[level].shape
                r, c = rng.integers(0, shape[0] - 50), rng.integers(0, shape[1] - 50)
                rows, cols = slice(r, r + 50), slice(c, c + 50)
                if not np.array_equal(pyramid.read(level, rows, cols), expected[level][rows, cols], equal_nan=True):
                    return False
            return True

        with ThreadPoolExecutor(8) as pool:
            assert all(pool.map(same, range(8)))


def test_zarr_opens_the_store(dem: Path, shelf: Path) -> None:
    zarr = pytest.importorskip("zarr")
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        group = zarr.open_group(only_entry(shelf), mode="r")
        assert group.attrs["proj:code"] == "EPSG:32633"
        for level in range(1, pyramid.level_count):
            array = group[f"{level}/height"]
            np.testing.assert_array_equal(array[:], whole(pyramid, level))
            scale = 30 * 2**level
            assert array.attrs["spatial:transform"] == [scale, 0, 500_000, 0, -scale, 5_000_000]
            assert array.attrs["proj:code"] == "EPSG:32633"
            assert array.attrs["grid_mapping"] == "spatial_ref"
            reference = group[f"{level}/spatial_ref"].attrs
            transform = [float(v) for v in reference["GeoTransform"].split()]
            assert transform == [500_000, scale, 0, 5_000_000, 0, -scale]
            assert rasterio.CRS.from_wkt(reference["crs_wkt"]) == rasterio.CRS.from_epsg(32633)


def test_xarray_sees_the_crs(dem: Path, shelf: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("rioxarray")
    with open_pyramid(open_height(dem), cache=shelf) as pyramid:
        data = xarray.open_zarr(only_entry(shelf), group="1", consolidated=False, decode_coords="all")["height"]
        assert data.rio.crs == rasterio.CRS.from_epsg(32633)
        assert tuple(data.rio.transform())[:6] == (60, 0, 500_000, 0, -60, 5_000_000)
        np.testing.assert_array_equal(data.values, whole(pyramid, 1))


def test_the_store_s_metadata_is_plain_json(dem: Path, shelf: Path) -> None:
    open_pyramid(open_height(dem), cache=shelf).close()
    facts = json.loads((only_entry(shelf) / "zarr.json").read_text())["attributes"]["orogen"]
    data = heights().astype(float)
    data[100:160, 200:400] = np.nan
    assert facts["covered"] is False
    assert (facts["minimum"], facts["maximum"]) == (np.nanmin(data), np.nanmax(data))


class Gate:
    """Holds a build back until it is opened."""

    def __init__(self) -> None:
        self.open = threading.Event()
        self.seen: list[float] = []

    def __call__(self, fraction: float, text: str) -> None:
        self.seen.append(fraction)
        assert self.open.wait(30)


def test_a_build_in_the_background_gives_estimates_first(dem: Path, shelf: Path) -> None:
    gate = Gate()
    pyramid = open_pyramid(open_height(dem), cache=shelf, build="background", progress=gate)
    assert not pyramid.built
    assert [pyramid.available(level) for level in range(4)] == [True, False, False, False]
    assert pyramid.node_bounds(0) is None
    with pytest.raises(StoreError, match="level 1 is not built yet"):
        pyramid.read(1, slice(0, 1), slice(0, 1))
    low, high = pyramid.height_range
    assert not pyramid.wait(0.01)
    shape = level_shape(SHAPE, 2)
    estimate = pyramid.read_estimate(2, slice(0, shape[0]), slice(0, shape[1]))
    gate.open.set()
    assert pyramid.wait(30)
    assert [pyramid.available(level) for level in range(4)] == [True, True, True, False]
    exact = whole(pyramid, 2)
    assert np.nanmax(np.abs(estimate - exact)) < 60
    np.testing.assert_array_equal(np.isnan(estimate), np.isnan(exact))
    assert pyramid.height_range[0] <= low < high <= pyramid.height_range[1]
    assert gate.seen == sorted(gate.seen)
    assert gate.seen[-1] == 1
    pyramid.close()


def test_closing_stops_a_build(dem: Path, shelf: Path) -> None:
    gate = Gate()
    pyramid = open_pyramid(open_height(dem), cache=shelf, build="background", progress=gate)
    while not gate.seen:
        time.sleep(0.01)
    pyramid.close()
    gate.open.set()
    assert not pyramid.wait(30)
    assert not list(shelf.iterdir())


def test_what_fails_in_the_background_is_raised_by_wait(dem: Path, shelf: Path) -> None:
    source = open_height(dem)

    def fail(fraction: float, text: str) -> None:
        raise SourceError("out of paper")

    pyramid = open_pyramid(source, cache=shelf, build="background", progress=fail)
    with pytest.raises(SourceError, match="out of paper"):
        pyramid.wait(30)
    assert not list(shelf.iterdir())
    assert whole(pyramid, 0).shape == SHAPE


def test_estimates_lie_right_where_sizes_are_no_multiples() -> None:
    shape = (1500, 4099)
    y, x = np.indices(shape)
    plane = (3.0 * x - 2.0 * y).astype(np.float32)
    pyramid = open_pyramid(open_height(plane, spacing=1), build="never")
    level = pyramid.estimate_level
    assert max(level_shape(shape, level)) <= 1025
    rows, cols = level_shape(shape, level)
    estimate = pyramid.read_estimate(level, slice(0, rows), slice(0, cols))
    scale = 2**level
    j, i = np.meshgrid(np.arange(cols), np.arange(rows))
    exact = 3.0 * ((j + 0.5) * scale - 0.5) - 2.0 * ((i + 0.5) * scale - 0.5)
    assert np.abs(estimate - exact).max() <= 5 * scale  # no more than a texel off, nowhere
    with pytest.raises(StoreError, match="expected a level of at least"):
        pyramid.read_estimate(level - 1, slice(0, 1), slice(0, 1))


@pytest.mark.parametrize(
    ("level", "rows", "message"),
    [
        (3, slice(0, 1), "expected a level of 0 to 2, got 3"),
        (-1, slice(0, 1), "expected a level of 0 to 2, got -1"),
        (1, slice(0, 351), "level 1: expected rows within 0 to 350"),
        (1, slice(4, 4), "level 1: expected rows within 0 to 350"),
    ],
)
def test_windows_outside_are_refused(level: int, rows: slice, message: str) -> None:
    with (
        open_pyramid(open_height(heights(), spacing=1)) as pyramid,
        pytest.raises(StoreError, match=message),
    ):
        pyramid.read(level, rows, slice(0, 1))


def test_unknown_ways_to_build_are_refused(dem: Path) -> None:
    with pytest.raises(SettingsError, match="build: expected one of auto, wait, background, never, got 'later'"):
        open_pyramid(open_height(dem), build="later")  # type: ignore[arg-type]
