"""Pyramids that stay: what `orogen build` writes, opened without the data they were built from."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

import orogen
from orogen.errors import OutputError, SettingsError, SourceError, StoreError
from orogen.keys import level_shape
from orogen.pyramid import Pyramid, build_pyramid, open_pyramid, update_pyramid
from orogen.source import open_colour, open_height, survey
from orogen.source.heights import HeightSource
from orogen.source.rounding import Rounding
from rasters import write_tiled as write

SHAPE = (2070, 650)


def hills(shape: tuple[int, int] = SHAPE, seed: int = 1) -> NDArray[np.float32]:
    y, x = np.indices(shape)
    rough = np.random.default_rng(seed).normal(0, 3, shape)
    return (900 + 400 * np.sin(x / 160) * np.cos(y / 145) + rough).astype(np.float32)


@pytest.fixture
def dem(tmp_path: Path) -> Path:
    data = hills()
    data[300:420, 200:600] = -9999
    return write(tmp_path / "dem.tif", data, nodata=-9999)


def whole(pyramid: Pyramid, level: int) -> NDArray[Any]:
    rows, cols = level_shape(pyramid.grid.shape, level)
    return pyramid.read(level, slice(0, rows), slice(0, cols))


def assert_same(one: Pyramid, other: Pyramid) -> None:
    assert one.level_count == other.level_count
    for level in range(one.level_count):
        rows, cols = level_shape(one.grid.shape, level)
        np.testing.assert_array_equal(whole(one, level), whole(other, level))
        if one.kind == "height":
            np.testing.assert_array_equal(one.node_bounds(level), other.node_bounds(level))
            part = slice(0, rows), slice(0, cols)
            np.testing.assert_array_equal(one.read_coverage(level, *part), other.read_coverage(level, *part))


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("tiled", [True, False])
def test_what_was_built_needs_its_source_no_more(dem: Path, tmp_path: Path, tiled: bool) -> None:
    if not tiled:  # strips as wide as the raster: level 0 is copied first
        with rasterio.open(dem) as dataset:
            dem = write(tmp_path / "strips.tif", dataset.read(1), nodata=-9999, tiled=False, blockxsize=None)
    built = build_pyramid(dem, tmp_path / "out.zarr")
    assert built.size == sum(len(content) for content in tree(tmp_path / "out.zarr").values())
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["out.zarr", *(p.name for p in tmp_path.glob("*.tif"))]
    )
    with open_pyramid(open_height(dem)) as expected:
        first = open_height(dem).grid
        moved = dem.rename(tmp_path / "gone.tif")
        source = open_height(tmp_path / "out.zarr")
        assert source.grid == first
        assert source.grid.crs == "EPSG:32633"
        moved.rename(dem)
        with open_pyramid(source, build="never") as pyramid:
            assert pyramid.built
            assert pyramid.covered is False
            assert pyramid.height_range == expected.height_range
            assert_same(pyramid, expected)


def test_colours_are_kept_beside_the_heights(dem: Path, tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (3, 700, 900)).astype(np.uint8)
    image = write(tmp_path / "image.tif", pixels, photometric="RGB", transform=from_origin(500_000, 5_000_000, 70, 70))
    built = build_pyramid(dem, tmp_path / "out.zarr", color=image, images={"second-one": image})
    assert {name: facts["kind"] for name, facts in built.layers.items()} == {
        "height": "height",
        "color": "colour",
        "second-one": "colour",
    }
    with open_pyramid(open_colour(image, open_height(dem))) as expected:
        dem.unlink()
        image.unlink()
        with orogen.open(tmp_path / "out.zarr") as terrain:
            assert terrain.colors is not None
            assert_same(terrain.colors, expected)
        with orogen.open(tmp_path / "out.zarr" / "height", color=tmp_path / "out.zarr" / "second-one") as terrain:
            assert terrain.colors is not None
            assert_same(terrain.colors, expected)


def test_mosaics_of_heights_and_of_images_become_layers(tmp_path: Path) -> None:
    heights = hills((400, 700), 3)
    pixels = np.random.default_rng(3).integers(0, 256, (3, 400, 700)).astype(np.uint8)
    place = {"transform": from_origin(500_000, 5_000_000, 30, 30)}
    write(tmp_path / "dem.tif", heights, **place)
    write(tmp_path / "image.tif", pixels, photometric="RGB", **place)
    for col in (0, 350):
        part = np.s_[..., col : col + 350]
        place = {"transform": from_origin(500_000 + 30 * col, 5_000_000, 30, 30)}
        write(tmp_path / f"dem_{col}.tif", heights[part], **place)
        write(tmp_path / f"image_{col}.tif", pixels[part], photometric="RGB", **place)
    many = str(tmp_path / "dem_*.tif"), str(tmp_path / "image_*.tif")
    built = build_pyramid(many[0], tmp_path / "out.zarr", color=many[1], layers={"again": many[0]})
    assert sorted(built.layers) == ["again", "color", "height"]
    dem = open_height(tmp_path / "dem.tif")
    with open_pyramid(dem) as expected, open_pyramid(open_colour(tmp_path / "image.tif", dem)) as image:
        with orogen.open(tmp_path / "out.zarr") as terrain:
            assert_same(terrain.heights, expected)
            assert terrain.colors is not None
            assert_same(terrain.colors, image)
        with open_pyramid(open_height(tmp_path / "out.zarr" / "again")) as again:
            assert_same(again, expected)


def test_a_raster_that_changes_meanwhile_ends_the_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "IN_MEMORY", 0)  # read by window, as large ones are
    path, out = write(tmp_path / "dem.tif", hills((4200, 330))), tmp_path / "out.zarr"
    changed = hills((4200, 330), seed=2)

    def read(source: HeightSource, rows: slice, cols: slice) -> NDArray[np.float32]:
        found = real(source, rows, cols)
        if not (tmp_path / "new.tif").exists():
            write(tmp_path / "new.tif", changed)
            path.write_bytes((tmp_path / "new.tif").read_bytes())
            os.utime(path, ns=(1, 1))
        return found

    real = HeightSource.read
    monkeypatch.setattr(HeightSource, "read", read)
    with pytest.raises(SourceError, match=r"dem\.tif: changed on disk since it was opened"):
        build_pyramid(path, out)
    assert not out.exists()
    build_pyramid(path, out)
    with open_pyramid(open_height(out)) as pyramid:
        np.testing.assert_array_equal(whole(pyramid, 0), changed)


def test_several_heights(dem: Path, tmp_path: Path) -> None:
    other = write(tmp_path / "other.tif", hills((300, 400), 7))
    build_pyramid(dem, tmp_path / "out.zarr", layers={"canopy": other})
    with (
        open_pyramid(open_height(tmp_path / "out.zarr" / "canopy")) as pyramid,
        open_pyramid(open_height(other)) as expected,
    ):
        assert_same(pyramid, expected)


@pytest.mark.parametrize("bound", [5.0, 0.5, 0.1, 0.003])
def test_heights_are_off_by_no_more_than_the_bound(dem: Path, tmp_path: Path, bound: float) -> None:
    built = build_pyramid(dem, tmp_path / "out.zarr", max_error=bound)
    facts = built.layers["height"]
    with open_pyramid(open_height(dem)) as exact, open_pyramid(open_height(tmp_path / "out.zarr")) as pyramid:
        true, got = whole(exact, 0).astype(np.float64), whole(pyramid, 0).astype(np.float64)
        np.testing.assert_array_equal(np.isnan(got), np.isnan(true))
        off = np.nanmax(np.abs(got - true))
        assert 0.2 * bound < off <= bound
        assert facts["largest_error"] == pytest.approx(off, rel=1e-6)
        assert facts["max_error"] == bound
        assert pyramid.height_range == (np.nanmin(got), np.nanmax(got))
        for level in range(1, pyramid.level_count):
            # each level is rounded once more
            assert np.nanmax(np.abs(whole(pyramid, level) - whole(exact, level))) <= bound * (level + 1)
            bounds, without = pyramid.node_bounds(level), exact.node_bounds(level)
            assert bounds is not None
            assert without is not None
            assert (bounds[..., 2] >= without[..., 2] - bound * (level + 1)).all()


def test_error_bounds_hold_for_rounded_levels(tmp_path: Path) -> None:
    heights = hills((600, 700), 3)
    write(tmp_path / "a.tif", heights)
    build_pyramid(tmp_path / "a.tif", tmp_path / "out.zarr", max_error=2.0)
    with open_pyramid(open_height(tmp_path / "out.zarr")) as pyramid:
        finest = whole(pyramid, 0).astype(np.float64)
        for level in (1, 2):
            coarse, scale = whole(pyramid, level).astype(np.float64), 2**level
            rows, cols = coarse.shape
            bounds = pyramid.node_bounds(level)
            assert bounds is not None
            # at the coarse texels' centres, where the finest surface is the mean of the four around
            y, x = np.arange(1, rows - 1) * scale + scale // 2, np.arange(1, cols - 1) * scale + scale // 2
            quads = [finest[np.ix_(y + i, x + j)] for i in (-1, 0) for j in (-1, 0)]
            off = np.abs(coarse[1:-1, 1:-1] - np.mean(quads, axis=0))
            node = bounds[np.ix_((np.arange(1, rows - 1) // 256), (np.arange(1, cols - 1) // 256))]
            assert (off <= node[..., 2] + 1e-3).all()


def test_numbers_that_are_too_small_are_chosen_anew(tmp_path: Path) -> None:
    heights = hills((2070, 650), 4)
    heights[1001, 301] = 90_000  # where the decimated read does not see it
    write(tmp_path / "a.tif", heights)
    built = build_pyramid(tmp_path / "a.tif", tmp_path / "out.zarr", max_error=0.5)
    assert built.layers["height"]["maximum"] == 90_000
    assert open_height(tmp_path / "out.zarr").dtype == "int32"


@pytest.mark.parametrize("bound", [1e-5, 0.01, 0.3, 1.0, 77.0])
def test_rounding_twice_changes_nothing(bound: float) -> None:
    heights = np.random.default_rng(5).normal(0, 500, 10_000).astype(np.float32)
    heights[::7] = np.nan
    rounding = Rounding.within(bound, -3000, 3000)
    once = rounding.decode(rounding.encode(heights))
    assert np.nanmax(np.abs(once.astype(np.float64) - heights)) <= bound
    np.testing.assert_array_equal(np.isnan(once), np.isnan(heights))
    np.testing.assert_array_equal(rounding.decode(rounding.encode(once)), once)


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan"), 1e-9])
def test_bounds_that_cannot_be_kept_are_refused(dem: Path, tmp_path: Path, bound: float) -> None:
    with pytest.raises(SettingsError, match=r"max_error: .*leave it out to lose nothing"):
        build_pyramid(dem, tmp_path / "out.zarr", max_error=bound)
    assert not (tmp_path / "out.zarr").exists()


def test_nothing_is_replaced_unasked(dem: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.zarr"
    build_pyramid(dem, out)
    before = tree(out)
    other = write(tmp_path / "other.tif", hills((300, 400), 7))
    with pytest.raises(OutputError, match="exists; give --force"):
        build_pyramid(other, out)
    assert tree(out) == before
    build_pyramid(other, out, force=True)
    assert open_height(out).grid.shape == (300, 400)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").touch()
    with pytest.raises(OutputError, match="is no pyramid that orogen has built; remove it yourself"):
        build_pyramid(other, tmp_path / "mine", force=True)
    assert (tmp_path / "mine" / "file").exists()


def test_readers_of_what_is_replaced_are_told(dem: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.zarr"
    build_pyramid(dem, out)
    other = write(tmp_path / "other.tif", hills(seed=9))
    with open_pyramid(open_height(out)) as pyramid:
        whole(pyramid, 3)
        build_pyramid(other, out, force=True)
        for level in (0, 3):
            with pytest.raises(StoreError, match="was updated or replaced since it was opened; open it again"):
                whole(pyramid, level)
    with open_pyramid(open_height(out)) as pyramid:
        np.testing.assert_array_equal(whole(pyramid, 0), hills(seed=9))


@pytest.mark.parametrize("level", [0, 2])
def test_a_lost_shard_is_an_error_that_says_what_to_do(dem: Path, tmp_path: Path, level: int) -> None:
    build_pyramid(dem, tmp_path / "out.zarr")
    shards = [p for p in (tmp_path / "out.zarr" / "height" / str(level) / "height" / "c").rglob("*") if p.is_file()]
    shards[0].unlink()
    with (
        open_pyramid(open_height(tmp_path / "out.zarr")) as pyramid,
        pytest.raises(StoreError, match=f"level {level} is damaged or incomplete .*build it again: orogen build"),
    ):
        whole(pyramid, level)


def test_options_belong_to_the_build(dem: Path, tmp_path: Path) -> None:
    build_pyramid(dem, tmp_path / "out.zarr", options={"height_scale": 2.0})
    assert open_pyramid(open_height(tmp_path / "out.zarr")).height_range[1] > 2000
    with pytest.raises(SourceError, match="holds metres and their georeference; give such options when it is built"):
        open_height(tmp_path / "out.zarr", height_scale=2.0)
    with pytest.raises(SourceError, match=r"has no layer of kind colour, only height \(height\)"):
        open_colour(tmp_path / "out.zarr", open_height(dem))
    with pytest.raises(SettingsError, match="layer: expected a name of letters"):
        build_pyramid(dem, tmp_path / "other.zarr", layers={"../up": dem})


def test_the_estimate_comes_before_most_of_the_work(dem: Path, tmp_path: Path) -> None:
    seen: list[float] = []
    moments: list[float] = []
    built = build_pyramid(
        dem, tmp_path / "out.zarr", report=lambda part, text: seen.append(part),
        estimated=lambda estimate: moments.append(len(seen)),
    )  # fmt: skip
    assert built.estimate is not None
    assert len(moments) == 1
    assert built.estimate.size == pytest.approx(built.size, rel=0.5)
    assert 0 <= built.estimate.seconds < 60
    assert seen[-1] == 1


def test_others_read_the_numbers(dem: Path, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    build_pyramid(dem, tmp_path / "out.zarr", max_error=0.5)
    with open_pyramid(open_height(tmp_path / "out.zarr")) as pyramid:
        opened = xarray.open_zarr(tmp_path / "out.zarr" / "height", group="2", consolidated=False)["height"]
        np.testing.assert_array_equal(opened.values, whole(pyramid, 2))
    facts = json.loads((tmp_path / "out.zarr" / "zarr.json").read_text())["attributes"]
    assert facts["proj:code"] == "EPSG:32633"


def test_a_cog_cannot_be_updated(dem: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="a COG cannot be updated in part"):
        update_pyramid(dem, tmp_path / "out.tif")
