"""Heights and normals at points, against the true surface of the comparison, finite differences and other CRS."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.warp import transform

from oracle.landscapes import hills
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries
from orogen.source.open import open_height
from orogen.terrain import open_terrain

AFFINE = rasterio.Affine(8.0, 3.0, 471000.0, 2.0, -9.0, 5.2e6)


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """300 x 420 samples over several chunks, rotated, with single voids and a wide one."""
    heights = hills(420, 800.0)[:300].astype(np.float32)
    rng = np.random.default_rng(1)
    heights[rng.random(heights.shape) < 0.03] = np.nan
    heights[120:160, 200:290] = np.nan
    path = tmp_path_factory.mktemp("points") / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=420, height=300, count=1, dtype="float32", crs="EPSG:32633",
        transform=AFFINE, nodata=np.nan, tiled=True, blockxsize=128, blockysize=128,
    ) as file:  # fmt: skip
        file.write(heights, 1)
    return path


def asked(path: Path) -> tuple[Queries, TrueSurface]:
    with rasterio.open(path) as file:
        surface = TrueSurface(file.read(1))
    return Queries(open_pyramid(open_height(path))), surface


def test_heights_are_those_of_the_true_surface(raster: Path) -> None:
    queries, surface = asked(raster)
    rng = np.random.default_rng(2)
    tx, ty = rng.uniform(-5, 425, 20_000), rng.uniform(-5, 305, 20_000)
    # samples themselves, and the corners and edges of the hull
    tx[:4000], ty[:4000] = np.floor(tx[:4000]) + 0.5, np.floor(ty[:4000]) + 0.5
    tx[:4], ty[:4] = [0.5, 419.5, 0.5, 419.5], [0.5, 0.5, 299.5, 299.5]
    x, y = AFFINE @ (tx, ty)
    expected = np.where(surface.exists(tx, ty), surface.height(tx, ty), np.nan)
    found = queries.height_at(x, y)
    # CRS coordinates of 5e6 hold texels to 1e-10: points on the border of a void may fall either way
    firm = np.abs(surface.coverage(tx, ty) - 0.5) > 1e-6
    firm &= np.minimum(surface.clamp(tx, ty)[0] - tx, 0) == 0
    edge = np.abs(np.stack([tx - 0.5, tx - 419.5, ty - 0.5, ty - 299.5])).min(axis=0) < 1e-6
    firm &= ~edge
    assert 0.05 < np.isnan(expected).mean() < 0.3
    np.testing.assert_allclose(found[firm], expected[firm], atol=2e-4)
    deep = firm & (surface.coverage(tx, ty) == 1)
    np.testing.assert_allclose(found[deep], expected[deep], atol=1e-7)


def test_shapes_and_what_lies_outside(raster: Path) -> None:
    queries, _ = asked(raster)
    x, y = AFFINE @ (10.5, 20.5)
    assert queries.height_at(x, y).shape == ()
    assert queries.height_at([x, x + 1], [[y], [y]]).shape == (2, 2)
    assert queries.normal_at([x, x + 1], [[y], [y]]).shape == (2, 2, 3)
    assert queries.height_at([], []).shape == (0,)
    assert np.isnan(queries.height_at([0.0, np.nan, np.inf], y)).all()
    assert np.isnan(queries.normal_at(0.0, y)).all()
    with open_terrain(str(raster)) as terrain:
        assert isinstance(terrain.height_at(x, y), float)
        assert terrain.height_at(x, y) == queries.height_at(x, y)


def test_points_may_come_in_another_crs(raster: Path) -> None:
    queries, _ = asked(raster)
    rng = np.random.default_rng(3)
    x, y = AFFINE @ (rng.uniform(1, 419, 500), rng.uniform(1, 299, 500))
    lon, lat = transform("EPSG:32633", "EPSG:4326", x, y)
    np.testing.assert_allclose(
        queries.height_at(lon, lat, crs="EPSG:4326"), queries.height_at(x, y), atol=1e-3, equal_nan=True
    )
    with pytest.raises(SettingsError, match="expected 'EPSG:n' or WKT, got 'nonsense'"):
        queries.height_at(lon, lat, crs="nonsense")
    flat = Queries(open_pyramid(open_height(np.zeros((4, 4), np.float32), spacing=1.0)))
    with pytest.raises(SettingsError, match="since the data has none"):
        flat.height_at(1.0, 1.0, crs="EPSG:4326")


def test_normals_are_those_of_finite_differences(raster: Path) -> None:
    queries, surface = asked(raster)
    rng = np.random.default_rng(4)
    # inside cells: the surface has edges between them
    tx = np.floor(rng.uniform(1, 418, 3000)) + 0.5 + rng.uniform(0.1, 0.9, 3000)
    ty = np.floor(rng.uniform(1, 298, 3000)) + 0.5 + rng.uniform(0.1, 0.9, 3000)
    whole = surface.coverage(tx, ty) == 1
    tx, ty = tx[whole], ty[whole]
    grid = open_height(raster).grid
    h = 0.05
    ahead = np.stack([surface.height(tx + h, ty) - surface.height(tx - h, ty)], -1)[..., 0] / (2 * h)
    aside = (surface.height(tx, ty + h) - surface.height(tx, ty - h)) / (2 * h)
    # two steps on the surface in metres, and what is at right angles to both
    steps = [
        np.stack([np.full(len(tx), m[0]), np.full(len(tx), m[1]), d], -1)
        for m, d in zip(grid.metres.T, (ahead, aside), strict=True)
    ]
    expected = np.cross(*steps)
    expected *= np.sign(expected[:, 2:]) / np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(queries.normal_at(*(AFFINE @ (tx, ty))), expected, atol=1e-6)


def test_a_line_of_samples_and_a_single_one() -> None:
    line = Queries(open_pyramid(open_height(np.array([[1.0, 3.0, 7.0]], np.float32), spacing=1.0)))
    np.testing.assert_allclose(line.height_at([0.5, 1.0, 1.5, 2.5], 0.5), [1, 2, 3, 7])
    assert np.isnan(line.height_at(1.0, 0.4))
    one = Queries(open_pyramid(open_height(np.array([[5.0]], np.float32), spacing=1.0)))
    assert one.height_at(0.5, 0.5) == 5.0
    assert np.isnan(one.raycast([0.5, 0.5, 10.0], [0.0, 0.0, -1.0])).all()


def test_threads_get_the_same(raster: Path) -> None:
    queries, _ = asked(raster)
    small = Queries(open_pyramid(open_height(raster)), memory=1 << 20)
    rng = np.random.default_rng(5)
    places = [AFFINE @ (rng.uniform(0, 420, 400), rng.uniform(0, 300, 400)) for _ in range(24)]
    with ThreadPoolExecutor(6) as pool:
        results = list(pool.map(lambda place: small.height_at(*place), places))
    for place, result in zip(places, results, strict=True):
        np.testing.assert_array_equal(result, queries.height_at(*place))
