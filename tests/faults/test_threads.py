"""Closing at any moment, and several threads at one terrain."""

from __future__ import annotations

import gc
import os
import random
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scipy.interpolate import RegularGridInterpolator

import orogen
from faults.scene import GRID, SIDE, SIZE, Place, walk
from orogen.errors import OrogenError
from orogen.gpu import Gpu
from orogen.terrain import Terrain
from orogen.view.renderer import Picture


@pytest.fixture(scope="module")
def raster(place: Place, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The heights as a tiled GeoTIFF."""
    path = tmp_path_factory.mktemp("raster") / "heights.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=SIDE, height=SIDE, count=1, dtype="float32", nodata=-9999.0, tiled=True,
        blockxsize=256, blockysize=256, transform=rasterio.Affine(*GRID.transform),
    ) as dataset:  # fmt: skip
        dataset.write(np.where(np.isnan(place.heights), np.float32(-9999), place.heights), 1)
    return path


def open_files() -> int | None:
    """Files that the process has open, where the system tells."""
    folder = Path("/proc/self/fd")
    return len(list(folder.iterdir())) if folder.is_dir() else None


def resident() -> int:
    """Bytes of memory of the process, 0 where the system does not tell."""
    path = Path("/proc/self/statm")
    return int(path.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if path.exists() else 0


def own_threads() -> set[threading.Thread]:
    """Threads of terrains; those that fetch from servers are kept for the next one."""
    running = threading.enumerate()
    return {thread for thread in running if thread.name.startswith("orogen") and "fetch" not in thread.name}


def open_and_close(raster: Path, gpu: Gpu, rng: random.Random) -> None:
    """Open a raster, start to load and close it after a random while, from this thread or another."""
    build = rng.choice(["wait", "background", "never"])
    terrain = orogen.open(raster, settings={"view_distance": 2.0, "memory": 8 << 20}, build=build)
    if rng.random() < 0.5:
        renderer = terrain.renderer
        target = renderer.gpu.texture("target", SIZE, "rgba8unorm", "RENDER_ATTACHMENT", "test")
        for _ in range(rng.randrange(3)):
            terrain.draw_to(target.view(), rng.choice(walk()), SIZE)
    else:
        terrain.height_at(505000.0, 3995000.0)
    time.sleep(rng.random() * 0.01)
    closer = threading.Thread(target=terrain.close)
    closer.start()
    if rng.random() < 0.5:
        terrain.close()
    closer.join(60)
    assert not closer.is_alive()


def closed_often(raster: Path, gpu: Gpu, times: int, seed: int = 5) -> None:
    rng = random.Random(seed)
    for _ in range(6):
        open_and_close(raster, gpu, rng)
    gc.collect()
    threads, files, memory, allocated = own_threads(), open_files(), resident(), gpu.memory.total
    for _ in range(times):
        open_and_close(raster, gpu, rng)
    gc.collect()
    assert own_threads() <= threads
    assert open_files() == files
    assert gpu.memory.total - allocated < 1 << 20
    # the driver keeps some for later, however many were closed
    assert resident() - memory < 160 << 20


def test_closing_while_it_loads(raster: Path, gpu: Gpu, one_device: None) -> None:
    closed_often(raster, gpu, 30)


@pytest.mark.nightly
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("part", range(10))
def test_closing_while_it_loads_a_thousand_times(
    raster: Path, gpu: Gpu, one_device: None, part: int, record_property: Callable[[str, object], None]
) -> None:
    closed_often(raster, gpu, 100, seed=100 + part)
    record_property("terrains closed while they load", 100)


def test_two_threads_use_one_terrain(place: Place, clean: list[Picture]) -> None:
    """One draws, another one draws and asks for heights: each gets what it would get alone."""
    rng = np.random.default_rng(8)
    tx, ty = rng.uniform(0.5, SIDE - 0.5, (2, 4000))
    x, y = GRID.to_crs(tx, ty)
    cameras = walk()
    with place.terrain(host_memory=1 << 20) as terrain:

        def draw(seed: int) -> None:
            for at in np.random.default_rng(seed).integers(0, len(cameras), 12):
                picture = terrain.render(cameras[at], SIZE, samples=1)
                np.testing.assert_array_equal(picture.color, clean[at].color)
                np.testing.assert_array_equal(picture.reverse_depth, clean[at].reverse_depth)

        def ask() -> int:
            times = 0
            while not over.is_set():
                found.append(terrain.height_at(x, y))
                times += 1
            return times

        over, found = threading.Event(), []
        with ThreadPoolExecutor(4) as pool:
            asking = [pool.submit(ask) for _ in range(2)]
            try:
                for drawing in [pool.submit(draw, seed) for seed in (1, 2)]:
                    drawing.result(100)
            finally:
                over.set()
            assert sum(task.result(60) for task in asking) > 2
    centres = np.arange(SIDE) + 0.5
    true = RegularGridInterpolator((centres, centres), place.heights.astype(np.float64))(np.stack([ty, tx], -1))
    for heights in found:
        np.testing.assert_array_equal(heights, found[0])
        valid = np.isfinite(true)
        np.testing.assert_allclose(heights[valid], true[valid], atol=1e-6)


def test_closing_while_another_thread_draws(place: Place) -> None:
    threads = own_threads()
    for wait in (0.0, 0.05, 0.3):
        terrain = place.terrain()
        stopped: list[BaseException] = []

        def draw(terrain: Terrain = terrain, stopped: list[BaseException] = stopped) -> None:
            try:
                while True:
                    terrain.render(walk()[1], SIZE, samples=1)
            except OrogenError as error:
                stopped.append(error)

        thread = threading.Thread(target=draw)
        thread.start()
        time.sleep(wait)
        terrain.close()
        thread.join(60)
        assert not thread.is_alive()
        assert "expected an open terrain" in str(stopped[0])
        assert own_threads() <= threads
