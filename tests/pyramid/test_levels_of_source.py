"""Pyramids that are not built: of a source that makes its own levels, and from a file's overviews."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.shutil import copy
from rasterio.transform import from_origin

import orogen
from orogen.compare.surface_error import surface_error
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.keys import NODE_SIZE, level_shape
from orogen.pyramid import Pyramid, open_pyramid
from orogen.source import open_colour, open_height
from orogen.source.procedural import ProceduralSettings, ProceduralSource
from orogen.source.raster import RasterFile
from orogen.view.renderer import Scene
from rasters import TILED, write

TAIWAN = "taiwan_20m_10481x19401_int16.tif"
Builds = Literal["auto", "wait", "background", "never"]


def everything(pyramid: Pyramid, level: int) -> tuple[slice, slice]:
    rows, cols = level_shape(pyramid.grid.shape, level)
    return slice(0, rows), slice(0, cols)


def cog(folder: Path, data: NDArray[Any], resampling: str, **profile: Any) -> Path:
    """A COG as GDAL writes it: sizes of overviews are rounded down."""
    path = folder / f"cog-{resampling}.tif"
    copy(
        str(write(folder / "plain.tif", data, **TILED, **profile)), str(path),
        driver="COG", overview_resampling=resampling, blocksize=256, compress="DEFLATE",
    )  # fmt: skip
    return path


def pair(path: Path, folder: Path) -> tuple[Pyramid, Pyramid]:
    """The pyramid from the overviews of a file, and the built one."""
    own = open_pyramid(open_height(path), cache=folder / "none", build="auto")
    return own, open_pyramid(open_height(path), cache=folder / "built", build="wait")


@pytest.fixture(scope="module")
def taiwan(data_dir: Path) -> NDArray[np.int16]:
    """A piece of steep land, of odd size."""
    with rasterio.open(data_dir / TAIWAN) as file:
        return file.read(1, window=((6000, 8601), (4000, 6163)))


@pytest.fixture(scope="module", params=["AVERAGE", "CUBIC", 3, 5])
def steep(request: pytest.FixtureRequest, taiwan: NDArray[np.int16], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A COG of it, in a folder of its own; or a GeoTIFF with overviews of odd factors."""
    folder = tmp_path_factory.mktemp("steep")
    if isinstance(request.param, str):
        return cog(folder, taiwan, request.param, nodata=-32768)
    path = write(folder / "odd.tif", taiwan, **TILED, nodata=-32768)
    with rasterio.open(path, "r+") as file:
        file.build_overviews([request.param**n for n in (1, 2, 3)], Resampling.average)
    return path


# A source that makes its own levels


def test_a_source_with_levels_is_never_built(tmp_path: Path) -> None:
    builds: tuple[Builds, ...] = ("auto", "wait", "background", "never")
    for build in builds:
        with open_pyramid(ProceduralSource(), cache=tmp_path / "cache", build=build) as pyramid:
            assert pyramid.wait(0) is False
            assert pyramid.exact
            assert all(pyramid.available(level) for level in range(pyramid.level_count))
    assert not (tmp_path / "cache").exists()


def test_its_levels_and_bounds_are_read_by_window() -> None:
    source = ProceduralSource(ProceduralSettings(3001))
    with open_pyramid(source) as pyramid:
        whole = pyramid.read(2, *everything(pyramid, 2))
        assert whole.shape == (751, 751)
        np.testing.assert_array_equal(pyramid.read(2, slice(100, 300), slice(7, 500)), whole[100:300, 7:500])
        assert (pyramid.read_coverage(2, slice(0, 9), slice(0, 9)) == 255).all()
        bounds = pyramid.node_bounds(0)
        assert bounds is not None
        assert bounds.shape == (12, 12, 3)
        part = pyramid.node_bounds(0, slice(3, 5), slice(11, 12))
        assert part is not None
        np.testing.assert_array_equal(part, bounds[3:5, 11:12])
        low, high = pyramid.height_range
        assert low <= whole.min() < whole.max() <= high


def test_windows_of_built_bounds(tmp_path: Path) -> None:
    heights = np.arange(700 * 900, dtype=np.float32).reshape(700, 900)
    with open_pyramid(open_height(heights, spacing=1), cache=tmp_path) as pyramid:
        assert pyramid.exact
        bounds = pyramid.node_bounds(0)
        part = pyramid.node_bounds(0, slice(1, 3), slice(2, 4))
        assert bounds is not None
        assert part is not None
        np.testing.assert_array_equal(part, bounds[1:3, 2:4])


# Overviews of a file


def test_a_file_without_overviews_is_built(tmp_path: Path) -> None:
    path = write(tmp_path / "plain.tif", np.zeros((2100, 2100), np.int16), **TILED)
    with open_pyramid(open_height(path), cache=tmp_path / "cache", build="never") as pyramid:
        assert not pyramid.available(1)
        assert not pyramid.exact
    with open_pyramid(open_height(path), cache=tmp_path / "cache", build="auto") as pyramid:
        assert pyramid.built


def test_overviews_that_do_not_go_far_enough_are_not_used(tmp_path: Path) -> None:
    path = write(tmp_path / "plain.tif", np.zeros((300, 40_000), np.int8), sparse_ok=True, **TILED)
    with rasterio.open(path, "r+") as file:
        file.build_overviews([2], Resampling.average)
    with open_pyramid(open_height(path), cache=tmp_path / "cache", build="never") as pyramid:
        assert not pyramid.available(1)


def test_which_pyramids_come_from_overviews(tmp_path: Path) -> None:
    path = cog(tmp_path, np.arange(2500, dtype=np.float32)[:, None] + np.zeros((2500, 2300), np.float32), "AVERAGE")
    builds: tuple[Builds, ...] = ("auto", "background", "never")
    for build in builds:
        with open_pyramid(open_height(path), cache=tmp_path / "cache", build=build) as pyramid:
            assert not pyramid.built
            assert not pyramid.exact
            assert pyramid.node_bounds(0) is None
            assert all(pyramid.available(level) for level in range(pyramid.level_count))
    assert not (tmp_path / "cache").exists()
    with open_pyramid(open_height(path), cache=tmp_path / "cache", build="wait") as pyramid:
        assert pyramid.built
        assert pyramid.exact
    # once built, it is used
    with open_pyramid(open_height(path), cache=tmp_path / "cache", build="auto") as pyramid:
        assert pyramid.built
    with pytest.raises(SettingsError, match="auto, wait, background, never"):
        open_pyramid(open_height(path), build="later")  # type: ignore[arg-type]


@pytest.mark.parametrize("resampling", ["AVERAGE", "CUBIC", "BILINEAR"])
@pytest.mark.parametrize("shape", [(2301, 2063), (5000, 1201)])
def test_planes_lie_where_they_belong(tmp_path: Path, shape: tuple[int, int], resampling: str) -> None:
    rows, cols = np.indices(shape) + 0.5
    path = cog(tmp_path, (2 * rows - 3 * cols).astype(np.float32), resampling)
    with open_pyramid(open_height(path), cache=tmp_path / "none", build="auto") as pyramid:
        assert not pyramid.built
        for level in range(pyramid.level_count):
            heights = pyramid.read(level, *everything(pyramid, level))
            down, right = ((np.arange(n) + 0.5) * 2**level for n in heights.shape)
            expected = np.add.outer(2 * down, -3 * right)
            # texels; addressed as halves the overviews of (2301, 2063) would drift by 13 and 15
            apart = np.abs(heights - expected) / np.hypot(2, 3)
            assert apart[1:-1, 1:-1].max() <= 0.05 * 2**level, level
            # overviews are not made for what lies past the raster, nor is cubic interpolation
            assert apart.max() <= 0.3 * 2**level, level
            assert np.median(apart) <= 0.001 * 2**level, level


def test_real_ground_is_near_the_means(steep: Path) -> None:
    own, built = pair(steep, steep.parent)
    with own, built:
        for level in range(own.level_count):
            apart = np.abs(own.read(level, *everything(own, level)) - built.read(level, *everything(own, level)))
            texel = 20 * 2**level
            assert apart.mean() <= 0.025 * texel, level
            assert apart[:-1, :-1].max() <= 0.4 * texel, level
            # the last ones reach past the raster, where either goes on along its own slope
            assert apart.max() <= 1.25 * texel, level
        low, high = built.height_range
        assert own.height_range == pytest.approx((low, high), abs=0.05 * (high - low))


def test_windows_of_levels_agree_with_each_other(steep: Path) -> None:
    with open_pyramid(open_height(steep), cache=steep.parent / "none", build="auto") as pyramid:
        rng = np.random.default_rng(5)
        for level in range(1, pyramid.level_count):
            whole = pyramid.read(level, *everything(pyramid, level))
            for _ in range(6):
                (r0, r1), (c0, c1) = (sorted(rng.choice(n + 1, 2, replace=False)) for n in whole.shape)
                part = pyramid.read(level, slice(int(r0), int(r1)), slice(int(c0), int(c1)))
                np.testing.assert_allclose(part, whole[r0:r1, c0:c1], rtol=1e-5)


def test_voids_of_overviews(tmp_path: Path, taiwan: NDArray[np.int16]) -> None:
    rows, cols = np.indices(taiwan.shape)
    holed = np.where(np.hypot(rows - 1000.3, cols - 900.7) < 400, np.int16(-32768), taiwan)
    own, built = pair(cog(tmp_path, holed, "AVERAGE", nodata=-32768), tmp_path)
    with own, built:
        assert not own.covered
        for level in range(own.level_count):
            area = everything(own, level)
            mine, theirs = own.read_coverage(level, *area), built.read_coverage(level, *area)
            heights = own.read(level, *area)
            np.testing.assert_array_equal(np.isfinite(heights), mine > 0)
            # the same ground is drawn, but for texels along the rim
            rim = 2 * np.pi * 400 / 2**level
            assert ((mine >= 128) != (theirs >= 128)).sum() <= 1.5 * rim + 8, level
            inside = np.isfinite(heights) & (theirs == 255)
            apart = np.where(inside, np.abs(heights - built.read(level, *area)), 0)
            assert apart[:-1, :-1].max() <= 0.5 * 20 * 2**level, level


def test_colours_of_overviews(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    coarse = rng.integers(30, 220, (3, 42, 37))
    picture = np.repeat(np.repeat(coarse, 64, 1), 64, 2)[:, :2301, :2009].astype(np.uint8)
    path = cog(tmp_path, picture, "AVERAGE", photometric="RGB")
    heights = open_height(np.zeros((100, 100), np.float32), spacing=520.0)
    own = open_pyramid(open_colour(path, heights), cache=tmp_path / "none", build="auto")
    built = open_pyramid(open_colour(path, heights), cache=tmp_path / "built")
    with own, built:
        assert not own.built
        for level in range(own.level_count):
            a, b = (p.read(level, *everything(p, level)).astype(int) for p in (own, built))
            assert (a[..., 3] == 255).all()
            # GDAL averages bytes, not light: edges of patches differ
            assert np.abs(a - b).mean() < 4, level
            assert np.median(np.abs(a - b)) <= 1, level


def test_only_what_is_looked_at_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = 12_288
    path = tmp_path / "large.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=1, dtype="int16", crs="EPSG:32651", tiled=True,
        transform=from_origin(300_000, 2_700_000, 10, 10), blockxsize=512, blockysize=512, compress="DEFLATE",
        SPARSE_OK=True,
    ) as file:  # fmt: skip
        relief = np.random.default_rng(0).integers(0, 900, (512, 512), np.int16)
        file.write(relief, 1, window=((6144, 6656), (6144, 6656)))
    with rasterio.open(path, "r+") as file:
        file.build_overviews([2, 4, 8, 16, 32], Resampling.average)
    samples = 0
    read = RasterFile.read

    def counted(self: RasterFile, *arguments: Any, **options: Any) -> NDArray[Any]:
        nonlocal samples
        found = read(self, *arguments, **options)
        samples += found.size
        return found

    monkeypatch.setattr(RasterFile, "read", counted)
    with open_pyramid(open_height(path), cache=tmp_path / "cache", build="auto") as pyramid:
        # every node of the coarsest three levels, and a way down to the middle
        for level in range(pyramid.level_count - 3, pyramid.level_count):
            pyramid.read(level, *everything(pyramid, level))
        for level in range(pyramid.level_count):
            at = 6144 >> level
            heights = pyramid.read(level, slice(at - at % 256, at - at % 256 + 1), slice(at, at + 1))
            assert np.isfinite(heights).all()
        assert pyramid.read(0, slice(6144, 6656), slice(6144, 6656)).tolist() == relief.tolist()
    assert samples < 0.06 * size**2
    assert not (tmp_path / "cache").exists()


# Pictures


def test_pictures_from_overviews_are_those_of_built_pyramids(steep: Path) -> None:
    """No point is drawn further than a pixel from where the built pyramid draws it.

    Behind a ridge a picture tells the place of a point no closer than a pixel. So the geometry of 320 x 180 pixels is
    looked at with half as large ones.
    """
    finer = 2
    settings = {"view_distance": 320 / NODE_SIZE}
    with (
        orogen.open(steep, cache=steep.parent / "none", settings=settings) as own,
        orogen.open(steep, cache=steep.parent / "built", build="wait", settings=settings) as built,
    ):
        assert not own.heights.built
        grid = built.grid
        truth = TrueSurface(built.heights.read(0, *everything(built.heights, 0)))
        middle = tuple(float(n) for n in grid.to_crs(1100, 1300))
        for options in ({}, {"look_at": middle, "distance": 30_000, "pitch": -35, "heading": 100}):
            camera = built.camera(aspect=16 / 9, **options)
            size, scene = (320 * finer, 180 * finer), Scene(coarseness=finer)
            mine, theirs = (terrain.render(camera, size, scene=scene, samples=1) for terrain in (own, built))
            error = surface_error(mine.reverse_depth, theirs.reverse_depth, theirs.frame, truth)
            # where the ground of one picture is drawn in the other; a ridge may hide a few points of either
            assert error.backward.count > 4000
            assert error.backward.p99 / finer <= 0.25
            assert error.backward.max / finer <= 1
            assert error.hidden <= 2e-3
            assert error.missing <= 1e-3
            assert error.extra <= 1e-3
