"""Several rasters as one, against one array that they were cut from."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.merge import merge
from rasterio.transform import Affine, from_origin
from rasterio.warp import transform
from scipy.interpolate import RegularGridInterpolator

import orogen
from orogen.errors import NoSampleError, SettingsError, SourceError
from orogen.source import Source, open_colour, open_height, parts
from rasters import everything

LEFT, TOP, STEP = 500_000.0, 5_000_000.0, 30.0


def hills(rows: int, cols: int) -> NDArray[np.float64]:
    y, x = np.indices((rows, cols))
    return 1000 + 300 * np.sin(x / 40) * np.cos(y / 35) + x / 7


def write(path: Path, data: NDArray[Any], row: int = 0, col: int = 0, step: float = STEP, **profile: Any) -> Path:
    """A GeoTIFF in UTM whose first sample is (row, col) of the common grid."""
    place = from_origin(LEFT + col * STEP, TOP - row * STEP, step, step)
    profile = {"driver": "GTiff", "count": 1, "dtype": data.dtype, "crs": "EPSG:32633", "transform": place, **profile}
    units = profile.pop("units", None)
    with rasterio.open(path, "w", height=data.shape[0], width=data.shape[1], **profile) as dataset:
        dataset.write(data, 1)
        if units:
            dataset.units = (units,)
    return path


def quarters(folder: Path, data: NDArray[Any], size: int = 100, **profile: Any) -> list[Path]:
    """The data cut into tiles."""
    return [
        write(folder / f"tile_{row}_{col}.tif", data[row : row + size, col : col + size], row, col, **profile)
        for row in range(0, data.shape[0], size)
        for col in range(0, data.shape[1], size)
    ]


def test_tiles_side_by_side_are_the_raster(tmp_path: Path) -> None:
    data = hills(250, 330).astype(np.float32)
    paths = quarters(tmp_path, data)
    for given in (paths, str(tmp_path / "tile_*.tif"), tmp_path, [str(path) for path in reversed(paths)]):
        source = open_height(given)
        assert source.grid.shape == data.shape
        assert source.grid.transform == (STEP, 0, LEFT, 0, -STEP, TOP)
        np.testing.assert_array_equal(everything(source), data)
        np.testing.assert_array_equal(source.read(slice(90, 210), slice(99, 101)), data[90:210, 99:101])
        small = source.overview((50, 66))
        assert small.shape == (50, 66)
        np.testing.assert_allclose(small, data[2::5, 2::5], atol=25)
        source.close()


def test_one_of_a_list_is_itself(tmp_path: Path) -> None:
    path = write(tmp_path / "one.tif", hills(20, 20).astype(np.int16))
    assert open_height([path]).fingerprint == open_height(path).fingerprint
    with pytest.raises(SourceError, match="empty list"):
        open_height([])
    with pytest.raises(SourceError, match="no file is named so"):
        open_height(str(tmp_path / "none_*.tif"))


def test_later_ones_win_where_valid_as_in_rasterio(tmp_path: Path) -> None:
    first = hills(80, 80).astype(np.int16)
    second = (hills(80, 80) + 5000).astype(np.int16)
    second[10:30, 20:50] = -1
    paths = [write(tmp_path / "a.tif", first, nodata=-1), write(tmp_path / "b.tif", second, 20, 40, nodata=-1)]
    for order in (paths, paths[::-1]):
        expected, place = merge(order[::-1])
        source = open_height(order)
        assert Affine(*source.grid.transform) == place
        np.testing.assert_array_equal(everything(source), np.where(expected[0] == -1, np.nan, expected[0]))


def test_gaps_are_nodata_and_empty_tiles_are_gaps(tmp_path: Path) -> None:
    data = hills(60, 60).astype(np.float32)
    paths = [
        write(tmp_path / "a.tif", data),
        write(tmp_path / "b.tif", data, 100, 150),
        write(tmp_path / "sea.tif", np.full((60, 60), -9999, np.float32), 0, 90, nodata=-9999),
    ]
    source = open_height(paths)
    expected = np.full((160, 210), np.nan, np.float32)
    expected[:60, :60] = expected[100:, 150:] = data
    np.testing.assert_array_equal(everything(source), expected)
    assert not source.covered
    with pytest.raises(NoSampleError, match="none of its 2 rasters has a valid sample"):
        open_height([paths[2], write(tmp_path / "lake.tif", np.full((6, 6), -1, np.int16), nodata=-1)])


def test_units_scales_and_types_become_metres(tmp_path: Path) -> None:
    data = np.round(hills(50, 50))
    paths = [
        write(tmp_path / "metres.tif", data.astype(np.int16)),
        write(tmp_path / "feet.tif", (data / 0.3048).astype(np.float64), 0, 50, units="ft"),
        write(tmp_path / "decimetres.tif", (data * 10).astype(np.uint16), 50, 0, units="dm"),
    ]
    heights = everything(open_height(paths))
    for part in (heights[:50, :50], heights[:50, 50:], heights[50:, :50]):
        np.testing.assert_allclose(part, data, atol=1e-3)


def test_unlike_vertical_references_are_refused(tmp_path: Path) -> None:
    data = hills(20, 20).astype(np.float32)
    one = write(tmp_path / "egm.tif", data, crs="EPSG:32633+5773")
    other = write(tmp_path / "dhhn.tif", data, 0, 20, crs="EPSG:32633+7837")
    plain = write(tmp_path / "plain.tif", data, 0, 40)
    with pytest.raises(SourceError, match=r"dhhn\.tif.*egm\.tif|egm\.tif.*dhhn\.tif"):
        open_height([one, other])
    source = open_height([one, plain])
    assert "EGM96" in str(source.vertical_crs)
    assert everything(source).shape == (20, 60)
    assert np.isnan(everything(source)[:, 20:40]).all()


def test_feet_beside_metres_and_depths_of_one_datum(tmp_path: Path) -> None:
    """NAVD88 in metres, US survey feet and as depths, in three CRS: a smooth surface, computed at each sample."""

    def surface(crs: str, x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float64]:
        lon, lat = pyproj.Transformer.from_crs(crs, "EPSG:4269", always_xy=True).transform(x, y)
        return 700 + 400 * np.sin(np.radians(lon + 122) * 300) * np.cos(np.radians(lat - 38) * 280)

    def tile(name: str, crs: str, corner: tuple[float, float], step: float, size: int, unit: float) -> Path:
        """Of `size` x `size` samples from its upper left corner (degrees) on."""
        x0, y0 = pyproj.Transformer.from_crs("EPSG:4269", crs.partition("+")[0], always_xy=True).transform(*corner)
        at = (np.arange(size) + 0.5) * step
        heights = surface(crs.partition("+")[0], *np.meshgrid(x0 + at, y0 - at)) / unit
        place = from_origin(x0, y0, step, step)
        return write(tmp_path / name, heights.astype(np.float32), crs=crs, transform=place)

    survey_foot = 1200 / 3937
    metres = tile("metres.tif", "EPSG:26910+5703", (-122.0, 38.0), 30.0, 150, 1.0)
    feet = tile("feet.tif", "EPSG:2227+6360", (-121.96, 37.995), 110.0, 160, survey_foot)
    depths = tile("depths.tif", "EPSG:4269+6358", (-122.03, 37.98), 0.0008, 90, -survey_foot)
    for order in ((metres, feet, depths), (depths, metres, feet)):
        source = open_height(order)
        assert source.grid.spacing == pytest.approx(30, rel=1e-3)
        rows, cols = source.grid.shape
        x, y = source.grid.to_crs(*np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5))
        found = everything(source)
        valid = np.isfinite(found)
        assert valid.sum() > 50_000
        wrong = np.abs(found - surface("EPSG:26910", x, y))[valid]
        assert (wrong < 0.05).mean() > 0.98
        assert wrong.max() < 1.5, "half a sample of the coarsest, at its edge, where the ground rises by 0.024"
        source.close()
    other = tile("ngvd29.tif", "EPSG:26910+7968", (-122.0, 38.0), 30.0, 20, 1.0)
    with pytest.raises(SourceError, match=r"NGVD29 height.*NAVD88 height.*never shifted"):
        open_height([metres, other])


@pytest.mark.parametrize("step", [0.1, 0.05])
def test_rasters_on_both_sides_of_180_degrees_lie_side_by_side(tmp_path: Path, step: float) -> None:
    """Three degrees in tiles of one, the second a coarser or finer one, off the grid of the others."""
    data = hills(10, 30).astype(np.float32)
    paths = []
    for number, left in enumerate((178.0, 179.0, -180.0)):
        place = {"crs": "EPSG:4326", "transform": from_origin(left, 10.0, 0.1, 0.1)}
        paths.append(write(tmp_path / f"{number}.tif", data[:, 10 * number : 10 * number + 10], **place))
    for order in (paths, paths[::-1]):
        source = open_height(order)
        assert source.grid.shape == (10, 30)
        left = source.grid.bounds[0]
        assert left == pytest.approx(178) or left == pytest.approx(-182)
        np.testing.assert_array_equal(everything(source), data)
        np.testing.assert_array_equal(source.overview((10, 30)), data)
    place = {"crs": "EPSG:4326", "transform": from_origin(-179.97, 9.96, step, step)}
    other = write(tmp_path / "other.tif", np.full((10, 10), 7, np.float32), **place)
    found = open_height([*paths, other])
    inside = found.read(*(slice(*part) for part in _window(found, 180.2, 9.9 - 8 * step, 180.1 + 8 * step, 9.9)))
    np.testing.assert_array_equal(inside, 7)
    far = write(tmp_path / "far.tif", data, crs="EPSG:4326", transform=from_origin(0.0, 10.0, 0.1, 0.1))
    assert open_height([paths[2], far]).grid.shape == (10, 1830), "as they are, where little would be won"


def _window(source: Source, left: float, bottom: float, right: float, top: float) -> list[tuple[int, int]]:
    """First and last + 1 row and column of the samples inside."""
    (c0, c1), (r0, r1) = source.grid.to_texel([left, right], [top, bottom])
    if c0 > source.grid.width or c1 < 0:
        (c0, c1), (r0, r1) = source.grid.to_texel([left - 360, right - 360], [top, bottom])
    return [(int(np.ceil(r0)), int(r1)), (int(np.ceil(c0)), int(c1))]


def test_a_vertical_reference_that_is_given_holds_for_those_that_name_none(tmp_path: Path) -> None:
    data = hills(20, 20).astype(np.float32)
    one, other = write(tmp_path / "a.tif", data), write(tmp_path / "b.tif", data, 0, 20)
    source = open_height([one, other], crs="EPSG:32633+6360")
    assert source.vertical_crs == "NAVD88 height (ftUS)"
    np.testing.assert_allclose(everything(source), np.hstack([data, data]) * (1200 / 3937), rtol=1e-6)
    named = write(tmp_path / "c.tif", data, 0, 40, crs="EPSG:32633+5773")
    with pytest.raises(SourceError, match=r"c\.tif: its heights refer to 'EGM96 height', not to 'NAVD88 height"):
        open_height([one, named], crs="EPSG:32633+6360")


def test_the_crs_that_is_given_is_that_of_a_coarser_raster_without_one(tmp_path: Path) -> None:
    coarse = write(tmp_path / "coarse.tif", hills(40, 40).astype(np.float32), step=90.0, crs=None)
    fine = write(tmp_path / "fine.tif", hills(60, 60).astype(np.float32), 30, 30)
    source = open_height([coarse, fine], crs="EPSG:32633")
    named = write(tmp_path / "named.tif", hills(40, 40).astype(np.float32), step=90.0)
    np.testing.assert_array_equal(everything(source), everything(open_height([named, fine])))


def test_what_cannot_be_laid_is_refused(tmp_path: Path) -> None:
    data = hills(20, 20).astype(np.float32)
    one, other = write(tmp_path / "a.tif", data), write(tmp_path / "b.tif", data, crs=None)
    with pytest.raises(SourceError, match=r"b\.tif: names no CRS, .*a\.tif does; give crs="):
        open_height([one, other])
    assert open_height([one, other], crs="EPSG:32633").grid.shape == (20, 20)
    with pytest.raises(SettingsError, match="spacing= would lay all 2 rasters over each other"):
        open_height([one, other], spacing=3)
    bare = write(tmp_path / "c.tif", data, transform=Affine.identity())
    with pytest.raises(SourceError, match=r"c\.tif: has no georeference"):
        open_height([one, bare])
    with pytest.raises(SourceError, match=r"missing\.tif: no such file"):
        open_height([one, tmp_path / "missing.tif"])


def bilinear(data: NDArray[Any], tx: NDArray[Any], ty: NDArray[Any]) -> NDArray[np.float64]:
    """Values of the data at texel coordinates, NaN outside."""
    at = np.arange(data.shape[0]) + 0.5, np.arange(data.shape[1]) + 0.5
    return RegularGridInterpolator(at, data, bounds_error=False)(np.stack([ty, tx], axis=-1))


def test_a_coarser_one_is_resampled_to_the_finest(tmp_path: Path) -> None:
    fine = hills(60, 60).astype(np.float32)
    coarse = (hills(40, 40) + 50).astype(np.float32)
    paths = [write(tmp_path / "coarse.tif", coarse, step=90.0), write(tmp_path / "fine.tif", fine, 30, 30)]
    source = open_height(paths)
    assert source.grid.shape == (120, 120)
    assert source.grid.transform[0] == STEP
    ty, tx = (np.indices((120, 120)) + 0.5) / 3
    expected = bilinear(coarse, tx, ty)
    expected[30:90, 30:90] = fine
    found = everything(source)
    inside = np.isfinite(expected)
    np.testing.assert_allclose(found[inside], expected[inside], atol=1e-2)
    np.testing.assert_array_equal(found[30:90, 30:90], fine)
    np.testing.assert_allclose(source.read(slice(20, 35), slice(7, 44)), found[20:35, 7:44], atol=1e-4)


@pytest.mark.parametrize("crs", [None, "EPSG:4326"])
def test_another_crs_is_warped(tmp_path: Path, crs: str | None) -> None:
    fine = hills(80, 80).astype(np.float32)
    (west,), (north,) = transform("EPSG:32633", "EPSG:4326", [LEFT + 80 * STEP], [TOP])
    step = 0.0009
    degrees = {"crs": "EPSG:4326", "transform": from_origin(west, north, step, step)}
    other = (hills(50, 50) + 300).astype(np.float32)
    paths = [write(tmp_path / "fine.tif", fine), write(tmp_path / "degrees.tif", other, **degrees)]
    source = open_height(paths, crs=crs)
    assert source.grid.crs == (crs or "EPSG:32633")
    rows, cols = source.grid.shape
    x, y = source.grid.to_crs(*np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5))
    lon, lat = transform(source.grid.crs, "EPSG:4326", x.ravel(), y.ravel())
    expected = bilinear(other, (np.array(lon) - west) / step, (north - np.array(lat)) / step).reshape(rows, cols)
    found = everything(source)
    inside = np.isfinite(expected)
    assert inside.mean() > 0.2
    np.testing.assert_allclose(found[inside], expected[inside], atol=0.05)
    assert source.fingerprint != open_height(paths[::-1], crs=crs).fingerprint
    source.close()


def test_a_change_of_one_file_changes_the_fingerprint(tmp_path: Path) -> None:
    paths = quarters(tmp_path, hills(100, 200).astype(np.int16))
    before = open_height(paths).fingerprint
    assert open_height(paths).fingerprint == before
    os.utime(paths[1], (1, 1))
    assert open_height(paths).fingerprint != before


def test_many_tiles_are_opened_when_needed_and_few_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "OPEN", 5)
    opened: list[Any] = []
    real = parts.files.open_height
    monkeypatch.setattr(parts.files, "open_height", lambda data, options: opened.append(data) or real(data, options))
    data = hills(240, 240).astype(np.float32)
    source = open_height(quarters(tmp_path, data, 30))
    assert len(opened) <= 1
    np.testing.assert_array_equal(source.read(slice(0, 15), slice(0, 25)), data[:15, :25])
    assert len(opened) == 1

    def windows(seed: int) -> None:
        random = np.random.default_rng(seed)
        for _ in range(8):
            row, col = random.integers(0, 180, 2)
            window = slice(row, row + 60), slice(col, col + 60)
            np.testing.assert_array_equal(source.read(*window), data[window])
            assert len(source._open) <= 5  # type: ignore[attr-defined]

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(windows, range(3)))
    source.close()


def test_a_mosaic_is_drawn_as_the_raster_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    data = hills(120, 150).astype(np.float32)
    quarters(tmp_path, data, 50)
    with orogen.open(write(tmp_path / "cache.dat", data)) as one, orogen.open(str(tmp_path / "tile_*.tif")) as many:
        assert many.bounds == one.bounds
        pictures = [terrain.render(size=(96, 64), samples=1).color for terrain in (one, many)]
    np.testing.assert_array_equal(*pictures)


def photo(rows: int, cols: int) -> NDArray[np.uint8]:
    """(4, rows, columns): smooth colours, transparent in a corner."""
    y, x = np.indices((rows, cols))
    bands = [128 + 90 * np.sin(x / a) * np.cos(y / b) for a, b in ((15, 21), (24, 17), (19, 31))]
    return np.stack([*bands, np.where((x < 20) & (y < 30), 0, 255)]).astype(np.uint8)


def image(path: Path, bands: NDArray[Any], row: int = 0, col: int = 0, **profile: Any) -> Path:
    """A GeoTIFF of colours in UTM whose first sample is (row, col) of the common grid."""
    place = from_origin(LEFT + col * STEP, TOP - row * STEP, STEP, STEP)
    profile = {"driver": "GTiff", "crs": "EPSG:32633", "transform": place, "photometric": "RGB", **profile}
    count, height, width = bands.shape
    profile["alpha"] = "non-premultiplied" if count == 4 else "no"
    with rasterio.open(path, "w", count=count, height=height, width=width, dtype="uint8", **profile) as dataset:
        dataset.write(bands)
    return path


def test_images_side_by_side_are_the_image(tmp_path: Path) -> None:
    bands = photo(250, 330)
    heights = open_height(write(tmp_path / "dem.tif", hills(250, 330).astype(np.float32)))
    one = open_colour(image(tmp_path / "whole.tif", bands), heights)
    (tmp_path / "tiles").mkdir()
    paths = [
        image(tmp_path / "tiles" / f"{row}_{col}.tif", bands[:, row : row + 100, col : col + 100], row, col)
        for row in range(0, 250, 100)
        for col in range(0, 330, 100)
    ]
    for given in (paths, str(tmp_path / "tiles" / "*.tif"), tmp_path / "tiles"):
        many = open_colour(given, heights)
        assert (many.kind, many.grid) == ("colour", one.grid)
        found, expected = everything(many), everything(one)
        np.testing.assert_array_equal(found[..., 3], expected[..., 3])
        seen = expected[..., 3] > 0
        np.testing.assert_array_equal(found[seen], expected[seen])
        opaque = one.overview((50, 66))[..., 3] == 255
        np.testing.assert_allclose(many.overview((50, 66))[opaque], one.overview((50, 66))[opaque], atol=30)
        many.close()
    before = open_colour(paths, heights).fingerprint
    assert before
    os.utime(paths[1], (1, 1))
    assert open_colour(paths, heights).fingerprint != before


def test_later_images_win_where_they_are_opaque(tmp_path: Path) -> None:
    heights = open_height(write(tmp_path / "dem.tif", hills(60, 60).astype(np.float32)))
    first, second = photo(60, 60), 255 - photo(60, 60)
    second[3] = 255
    second[3, 10:20] = 0
    second[3, 20:30] = 100
    first[3] = 255
    source = open_colour([image(tmp_path / "a.tif", first), image(tmp_path / "b.tif", second)], heights)
    expected = np.where(second[3] == 255, second, first)
    np.testing.assert_array_equal(everything(source), np.moveaxis(expected, 0, 2))
    bare = image(tmp_path / "c.tif", first, transform=Affine.identity())
    with pytest.raises(SourceError, match=r"c\.tif: has no georeference, which a mosaic of images needs"):
        open_colour([tmp_path / "a.tif", bare], heights)


def test_images_of_other_crs_are_warped(tmp_path: Path) -> None:
    """One in degrees and a coarser one beside one in the grid: each as it is shown alone."""
    heights = open_height(write(tmp_path / "dem.tif", hills(120, 120).astype(np.float32)))
    bands = photo(60, 60)[:3]
    near = image(tmp_path / "near.tif", bands)
    (west,), (north,) = transform("EPSG:32633", "EPSG:4326", [LEFT + 70 * STEP], [TOP - 5 * STEP])
    place = from_origin(west, north, 0.0004, 0.00028)
    far = image(tmp_path / "far.tif", bands, crs="EPSG:4326", transform=place)
    both = open_colour([far, near], heights)
    assert both.grid.crs == heights.grid.crs
    assert both.grid.spacing == pytest.approx(STEP, rel=0.1)
    pixels, counts = everything(both), []
    for path in (near, far):
        alone = open_colour(path, heights)
        rows, cols = alone.grid.shape
        x, y = alone.grid.to_crs(*np.meshgrid(np.arange(3, cols - 3) + 0.5, np.arange(3, rows - 3) + 0.5))
        expected = everything(alone)[3:-3, 3:-3]
        tx, ty = both.grid.to_texel(x, y)
        found = np.stack([bilinear(pixels[..., band], tx, ty) for band in range(4)], axis=-1)
        inside = expected[..., 3] == 255
        counts.append(inside.sum())
        np.testing.assert_allclose(found[inside], expected[inside], atol=6)
    assert min(counts) > 1000


def test_a_mosaic_of_images_is_drawn_as_the_image_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    bands = photo(120, 150)
    dem = write(tmp_path / "dem.tif", hills(120, 150).astype(np.float32))
    parts = [image(tmp_path / f"{col}.tif", bands[:, :, col : col + 50], 0, col) for col in range(0, 150, 50)]
    pictures = []
    for color in (image(tmp_path / "whole.tif", bands), [str(path) for path in parts]):
        with orogen.open(dem, color=color) as terrain:
            pictures.append(terrain.render(size=(96, 64), samples=1).color)
    np.testing.assert_array_equal(*pictures)
