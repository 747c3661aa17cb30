"""Around the globe nothing begins or ends: the same ground from rasters that begin at different longitudes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rasterio.io import MemoryFile
from rasterio.transform import from_origin
from scipy.interpolate import RegularGridInterpolator

from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries
from orogen.source.open import open_height

COLUMNS, ROWS = 720, 200
STEP = 360 / COLUMNS
NORTH = 50.0


def ground() -> NDArray[np.float32]:
    """Mountains around the globe, (ROWS, COLUMNS), higher than the drop over many samples; the first at 0 degrees."""
    rng = np.random.default_rng(4)
    lon = np.radians((np.arange(COLUMNS) + 0.5) * STEP)[None, :]
    y = np.arange(ROWS)[:, None] / ROWS
    waves = sum(np.sin(k * lon + 7 * y + p) / k for k, p in zip((3, 8, 21, 55), rng.uniform(0, 6, 4), strict=True))
    return (40_000 * (1.5 + waves) + rng.uniform(0, 8000, (ROWS, COLUMNS))).astype(np.float32)


def asked(first: int, columns: int = COLUMNS, **options: Any) -> Queries:
    """Queries of a raster whose first column is the `first` one of the ground."""
    heights = np.take(ground(), np.arange(first, first + columns), axis=1, mode="wrap")
    place = from_origin(first * STEP, NORTH, STEP, STEP)
    memory = MemoryFile()
    with memory.open(
        driver="GTiff", width=columns, height=ROWS, count=1, dtype="float32", crs="EPSG:4326", transform=place
    ) as dataset:
        dataset.write(heights, 1)
    # read now: the file is small and kept in memory
    source = open_height(memory.open())
    return Queries(open_pyramid(source, **options))


@pytest.fixture(scope="module")
def seam_at_180() -> Queries:
    return asked(-COLUMNS // 2)


@pytest.fixture(scope="module")
def seam_at_0() -> Queries:
    return asked(0)


def places(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Longitudes within a few samples of 180 degrees, and latitudes."""
    rng = np.random.default_rng(5)
    return 180 + rng.uniform(-3 * STEP, 3 * STEP, count), NORTH - rng.uniform(1, ROWS - 1, count) * STEP


def test_heights_and_normals_across_the_seam(seam_at_180: Queries, seam_at_0: Queries) -> None:
    lon, lat = places(3000)
    columns = np.arange(-2, COLUMNS + 2)
    surface = RegularGridInterpolator(
        ((np.arange(ROWS) + 0.5) * -STEP + NORTH, (columns + 0.5) * STEP),
        np.take(ground(), columns, axis=1, mode="wrap").astype(np.float64),
    )
    for queries in (seam_at_180, seam_at_0):
        for turn in (-720, -360, 0, 360):
            np.testing.assert_allclose(queries.height_at(lon + turn, lat), surface(np.stack([lat, lon], -1)), rtol=1e-9)
        np.testing.assert_allclose(
            queries.normal_at(lon - 360, lat), seam_at_0.normal_at(lon, lat), rtol=1e-6, atol=1e-9
        )
    for exactly in (180.0, -180.0, 540.0):
        assert seam_at_180.height_at(exactly, 10.1) == pytest.approx(surface((10.1, 180.0)), rel=1e-9)
    assert np.isnan(seam_at_180.height_at([180.0, 0.0, np.nan, np.inf], [NORTH + 1, -80.0, 0.0, 0.0])).all()


def test_lines_of_sight_and_rays_across_the_seam(seam_at_180: Queries, seam_at_0: Queries) -> None:
    rng = np.random.default_rng(6)
    lon, lat = places(400)
    a = np.stack([lon, lat, rng.uniform(0, 30_000, 400)], -1)
    b = np.stack([lon + rng.uniform(-12, 12, 400), np.clip(lat + rng.uniform(-8, 8, 400), -48, 48), a[:, 2]], -1)
    # as they are usually given: from -180 to 180 degrees
    wrapped = [np.stack([(p[:, 0] + 180) % 360 - 180, *p[:, 1:].T], -1) for p in (a, b)]
    assert ((wrapped[0][:, 0] > 0) != (wrapped[1][:, 0] > 0)).sum() > 100
    found, expected = seam_at_180.line_of_sight(*wrapped), seam_at_0.line_of_sight(a, b)
    assert 50 < expected.visible.sum() < 350
    np.testing.assert_array_equal(found.visible, expected.visible)
    assert found.known.all()
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-9)
    np.testing.assert_allclose(found.obstacle[:, 0] % 360, expected.obstacle[:, 0] % 360, rtol=1e-8)
    np.testing.assert_allclose(found.obstacle[:, 1:], expected.obstacle[:, 1:], rtol=1e-6, atol=1e-6)
    assert np.nanmax(np.abs(found.obstacle[:, 0])) <= 180
    origin = wrapped[0] + [0, 0, 150_000]
    direction = np.stack([rng.uniform(-1, 1, 400), rng.uniform(-1, 1, 400), rng.uniform(-0.4, 0, 400)], -1)
    hits, others = (queries.raycast(origin, direction) for queries in (seam_at_180, seam_at_0))
    assert np.isfinite(others).all(axis=1).sum() > 200
    np.testing.assert_allclose(hits[:, 0] % 360, others[:, 0] % 360, rtol=1e-8)
    np.testing.assert_allclose(hits[:, 1:], others[:, 1:], rtol=1e-6, atol=1e-6)


def test_a_profile_takes_the_shorter_way(seam_at_180: Queries, seam_at_0: Queries) -> None:
    points = np.array([[178.0, 10.0], [-177.0, 12.0], [175.0, -3.0]])
    found = seam_at_180.profile(points, 20_000.0)
    expected = seam_at_0.profile(np.column_stack([points[:, 0] % 360, points[:, 1]]), 20_000.0)
    assert found.complete
    assert found.distance[-1] < 2_600_000
    np.testing.assert_allclose(found.height, expected.height, rtol=1e-9)
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-9)
    assert np.abs(found.x).max() <= 180


def test_rasters_of_queries_know_no_seam(seam_at_180: Queries, seam_at_0: Queries) -> None:
    half = COLUMNS // 2
    for name, arguments in (("slope", ()), ("aspect", ()), ("shadow", ((280.0, 12.0),))):
        found, expected = (getattr(queries, name)(*arguments).values() for queries in (seam_at_180, seam_at_0))
        # rays to the sun end at the raster's far side: a quarter of the globe away
        np.testing.assert_allclose(found, np.roll(expected, half, axis=1), rtol=1e-5, atol=1e-6)
    seen, other = (queries.viewshed((179.9, 5.0), height=3000, radius=900_000) for queries in (seam_at_180, seam_at_0))
    assert seen.grid.bounds[0] < 180 < seen.grid.bounds[2]
    assert seen.grid.shape == other.grid.shape
    np.testing.assert_allclose(seen.grid.bounds, other.grid.bounds, atol=1e-9)
    values = seen.values()
    np.testing.assert_array_equal(values, other.values())
    assert {0, 1, 255} == set(np.unique(values).tolist())


def test_a_raster_across_180_degrees_is_asked_in_either_count(seam_at_0: Queries) -> None:
    part = asked(330, 60)  # 165 to 195 degrees
    lon, lat = places(200)
    np.testing.assert_allclose(part.height_at(lon - 360, lat), seam_at_0.height_at(lon, lat), rtol=1e-9)
    assert np.isnan(part.height_at(0.0, 0.0))
    found = part.line_of_sight((178.0, 0.0, 9000), (-178.0, 1.0, 9000))
    expected = seam_at_0.line_of_sight((178.0, 0.0, 9000), (182.0, 1.0, 9000))
    assert found.visible == expected.visible
    assert found.distance == pytest.approx(float(expected.distance))
    seen = part.viewshed((-179.9, 5.0), height=3000, radius=400_000)
    assert seen.grid.width < 30
    np.testing.assert_array_equal(seen.values(), seam_at_0.viewshed((180.1, 5.0), height=3000, radius=400_000).values())


def test_a_column_that_is_there_twice(seam_at_0: Queries) -> None:
    twice = asked(-COLUMNS // 2, COLUMNS + 1)
    lon, lat = places(300)
    np.testing.assert_allclose(twice.height_at(lon, lat), seam_at_0.height_at(lon, lat), rtol=1e-9)
    found = twice.line_of_sight((179.0, 0.0, 9000), (-178.0, 1.0, 9000))
    assert found.visible == seam_at_0.line_of_sight((179.0, 0.0, 9000), (182.0, 1.0, 9000)).visible
    np.testing.assert_allclose(
        twice.slope().values()[:, :-1], np.roll(seam_at_0.slope().values(), COLUMNS // 2, axis=1), rtol=1e-5
    )


def test_before_the_pyramid_is_built(seam_at_0: Queries) -> None:
    queries = asked(-COLUMNS // 2, build="never")
    np.testing.assert_allclose(queries.height_at(-180.1, 3.0), seam_at_0.height_at(179.9, 3.0), rtol=1e-9)
    found = queries.line_of_sight((179.0, 0.0, 9000), (-178.0, 1.0, 9000))
    assert found.visible == seam_at_0.line_of_sight((179.0, 0.0, 9000), (182.0, 1.0, 9000)).visible
