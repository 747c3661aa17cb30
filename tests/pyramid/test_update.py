"""Updates write what has changed, and give what a new build would give."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.errors import StoreError
from orogen.pyramid import build_pyramid, open_pyramid, update_pyramid
from orogen.pyramid.task import Cancelled
from orogen.source import open_height
from rasters import write_tiled as write

SHAPE = (2119, 2109)
"""Two rows and two columns of regions of 2048 x 2048, the last ones short."""


def heights(seed: int = 1) -> NDArray[np.float32]:
    y, x = np.ogrid[: SHAPE[0], : SHAPE[1]]
    rough = np.random.default_rng(seed).integers(-9, 9, SHAPE)
    return (500 * np.sin(x / 160) * np.cos(y / 145) + rough).astype(np.float32)


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def changed(data: NDArray[np.float32], rows: slice, cols: slice) -> NDArray[np.float32]:
    data = data.copy()
    data[rows, cols] += 77
    data[rows.start, cols.start] = np.nan
    return data


WINDOWS = [
    (slice(100, 300), slice(40, 90)),
    (slice(2040, 2060), slice(2040, 2055)),  # where four regions meet
    (slice(2117, 2118), slice(2106, 2107)),  # next to the last row and column, which others are extrapolated from
]


@pytest.mark.parametrize(("rows", "cols"), WINDOWS)
@pytest.mark.parametrize("options", [{}, {"max_error": 0.25}])
def test_an_update_gives_the_bytes_of_a_new_build(
    tmp_path: Path, rows: slice, cols: slice, options: dict[str, float]
) -> None:
    dem, out = tmp_path / "dem.tif", tmp_path / "out.zarr"
    build_pyramid(write(dem, heights()), out, **options)
    before = {name: os.stat(out / name).st_ino for name in tree(out)}
    write(dem, changed(heights(), rows, cols))
    window = [(rows, cols)] if options else None  # given, or found
    built = update_pyramid(dem, out, windows=window)
    build_pyramid(dem, tmp_path / "new.zarr", **options)
    assert tree(out) == tree(tmp_path / "new.zarr")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["dem.tif", "new.zarr", "out.zarr"]
    regions = len({(r // 2048, c // 2048) for r in (rows.start, rows.stop) for c in (cols.start, cols.stop)})
    assert built.layers["height"]["regions"] == regions
    same = {name for name, number in before.items() if os.stat(out / name).st_ino == number}
    shards = {name for name in before if "/0/height/c/" in name}
    assert len(shards - same) <= regions * 4  # of 2048 x 2048 in shards of 512 x 2048
    assert regions == 4 or shards & same


def test_strips_and_colours_are_updated_too(tmp_path: Path) -> None:
    dem, image, out = tmp_path / "dem.tif", tmp_path / "image.tif", tmp_path / "out.zarr"
    strips = {"tiled": False, "blockxsize": None, "blockysize": 600}
    pixels = np.random.default_rng(2).integers(0, 256, (3, *SHAPE), dtype=np.uint8)
    write(image, pixels, photometric="RGB")
    build_pyramid(write(dem, heights(), **strips), out, color=image, max_error=1.0)
    write(dem, changed(heights(), slice(2060, 2070), slice(500, 600)), **strips)
    pixels[1, 50, 2100] ^= 255
    write(image, pixels, photometric="RGB")
    built = update_pyramid(dem, out, color=image)
    assert [built.layers[name]["regions"] for name in ("height", "color")] == [1, 1]
    build_pyramid(dem, tmp_path / "new.zarr", color=image, max_error=1.0)
    assert tree(out) == tree(tmp_path / "new.zarr")


def test_readers_see_old_or_new_or_are_told(tmp_path: Path) -> None:
    dem, out = tmp_path / "dem.tif", tmp_path / "out.zarr"
    old = np.full((600, 700), 10, np.float32)
    build_pyramid(write(dem, old), out)
    ended, found, told = threading.Event(), set(), [0]

    def read() -> None:
        while not ended.is_set():
            try:
                with open_pyramid(open_height(out)) as pyramid:
                    while not ended.is_set():
                        whole = pyramid.read(0, slice(0, 600), slice(0, 700))
                        coarse = pyramid.read(1, slice(0, 300), slice(0, 350))
                        assert whole.min() == whole.max()
                        assert coarse.min() == coarse.max()
                        found.add(float(whole[0, 0]))
            except StoreError as error:
                if "open it again" not in str(error):
                    raise
                told[0] += 1

    failures: list[BaseException] = []

    def watched() -> None:
        try:
            read()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=watched) for _ in range(2)]
    for thread in threads:
        thread.start()
    for height in range(11, 17):
        update_pyramid(write(dem, np.full_like(old, height)), out)
    ended.set()
    for thread in threads:
        thread.join()
    assert not failures
    assert told[0] >= 2
    assert len(found) >= 3


def test_an_update_that_fails_leaves_the_old(tmp_path: Path) -> None:
    dem, out, stop = tmp_path / "dem.tif", tmp_path / "out.zarr", threading.Event()
    data = heights()[:600, :300]
    build_pyramid(write(dem, data), out)
    before = tree(out)
    write(dem, data + 1)
    stop.set()
    with pytest.raises(Cancelled):
        update_pyramid(dem, out, stop=stop)
    assert tree(out) == before
    update_pyramid(dem, out)
    with open_pyramid(open_height(out)) as pyramid:
        np.testing.assert_array_equal(pyramid.read(0, slice(0, 600), slice(0, 300)), data + 1)


def test_what_an_update_cannot_do_is_refused(tmp_path: Path) -> None:
    dem, out = tmp_path / "dem.tif", tmp_path / "out.zarr"
    data = heights()[:300, :300]
    build_pyramid(write(dem, data), out, max_error=0.5)
    before = tree(out)
    with pytest.raises(StoreError, match="has the layers height; give those to update"):
        update_pyramid(dem, out, layers={"other": dem})
    with pytest.raises(StoreError, match="its grid is not that of the data now; build it again with --force"):
        update_pyramid(write(dem, data[:200]), out)
    data[7, 7] = 1e6
    with pytest.raises(StoreError, match="a height does not fit the numbers that it stores"):
        update_pyramid(write(dem, data), out)
    assert tree(out) == before
