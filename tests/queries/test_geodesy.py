"""Distances and profiles against geographiclib."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.warp import transform

from orogen.grid import Grid
from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries
from orogen.queries.geodesy import Geodesy
from orogen.source.open import open_height

geodesic = pytest.importorskip("geographiclib.geodesic")

PLACES = {
    "EPSG:4326": ((-10.0, 60.0), (30.0, 70.0)),
    "EPSG:32633": ((2e5, 8e5), (5e6, 6e6)),
    "EPSG:3857": ((1.3e7, 1.4e7), (2e6, 3e6)),
    "EPSG:2263": ((9e5, 1e6), (1.5e5, 2.5e5)),
}
"""Degrees, metres, stretched metres, feet; x and y from, to."""


def inverse(ellipsoid: object, a: tuple[float, float], b: tuple[float, float]) -> float:
    return ellipsoid.Inverse(a[1], a[0], b[1], b[0])["s12"]  # type: ignore[attr-defined]


@pytest.mark.parametrize("crs", PLACES)
def test_distances_are_those_of_geographiclib(crs: str) -> None:
    (left, right), (bottom, top) = PLACES[crs]
    rng = np.random.default_rng(14)
    x, y = rng.uniform(left, right, (2, 40)), rng.uniform(bottom, top, (2, 40))
    geodesy = Geodesy(Grid(10, 10, (1.0, 0.0, left, 0.0, -1.0, top), crs))
    found = geodesy.distance(x[0], y[0], x[1], y[1])
    base = "EPSG:4269" if crs == "EPSG:2263" else "EPSG:4326"
    lonlat = [list(zip(*transform(crs, base, px, py), strict=True)) for px, py in zip(x, y, strict=True)]
    expected = [inverse(geodesic.Geodesic.WGS84, a, b) for a, b in zip(*lonlat, strict=True)]
    # NAD 83's ellipsoid differs from WGS 84's by a tenth of a millimetre
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-3)


def test_the_moon_is_a_sphere_of_its_own(data_dir: Path) -> None:
    source = open_height(data_dir / "bad" / "gz_dem_moon.tif")
    left, bottom, right, top = source.grid.bounds
    geodesy = Geodesy(source.grid)
    with rasterio.open(data_dir / "bad" / "gz_dem_moon.tif") as file:
        base = file.crs
    assert "1737400" in base.to_wkt()
    found = float(geodesy.distance(left, bottom, right, top))
    plain = math.hypot((right - left) * source.grid.ground_scale[0], (top - bottom) * source.grid.ground_scale[1])
    assert found == pytest.approx(plain, rel=0.02)


def test_without_a_crs_or_an_ellipsoid_lengths_are_plain() -> None:
    for crs in (None, 'LOCAL_CS["site",UNIT["metre",1]]'):
        geodesy = Geodesy(Grid(10, 10, (1.0, 0.0, 0.0, 0.0, -1.0, 10.0), crs))
        assert float(geodesy.distance(0, 0, 3, 4)) == 5.0


@pytest.mark.parametrize("crs", PLACES)
def test_what_is_within_a_radius(crs: str) -> None:
    (left, right), (bottom, top) = PLACES[crs]
    size = 150
    step = (right - left) / size / 50
    grid = Grid(size, size, (step, step / 7, (left + right) / 2, step / 9, -step, (bottom + top) / 2), crs)
    geodesy = Geodesy(grid)
    place = tuple(float(v) for v in grid.to_crs(60.3, 90.9))
    radius = float(geodesy.distance(*place, *grid.to_crs(100.0, 90.9)))
    j, i = np.mgrid[:size, :size]
    x, y = grid.to_crs(i + 0.5, j + 0.5)
    expected = geodesy.distance(*place, x, y) <= radius
    assert 0.1 < expected.mean() < 0.5
    np.testing.assert_array_equal(geodesy.within(place, radius, slice(0, size), slice(0, size)), expected)
    np.testing.assert_array_equal(
        geodesy.within(place, radius, slice(33, 100), slice(71, 149)), expected[33:100, 71:149]
    )
    around = geodesy.circle(place, radius)
    assert around is not None
    length = geodesy.distance(*place, *around)
    assert (length > radius).all()
    assert (length < 1.001 * radius).all()


def test_profiles_run_through_their_points_with_geodesic_distances(data_dir: Path) -> None:
    file = data_dir / "mt_rainier_90m_wgs84_voids.tif"
    queries = Queries(open_pyramid(open_height(file)))
    points = [(-121.9, 46.7), (-121.76, 46.85), (-121.5, 46.9)]
    line = queries.profile(points, 500.0)
    ellipsoid = geodesic.Geodesic.WGS84
    legs = [inverse(ellipsoid, a, b) for a, b in itertools.pairwise(points)]
    counts = [math.ceil(leg / 500) for leg in legs]
    assert len(line.x) == sum(counts) + 1
    at = [0, counts[0], sum(counts)]
    np.testing.assert_allclose(np.column_stack([line.x, line.y])[at], points, atol=1e-9)
    steps = [inverse(ellipsoid, (line.x[k], line.y[k]), (line.x[k + 1], line.y[k + 1])) for k in range(len(line.x) - 1)]
    np.testing.assert_allclose(np.diff(line.distance), steps, rtol=1e-9)
    assert max(steps) <= 500.5
    # straight on the grid is longer than the geodesic, here by little
    assert sum(legs) <= line.distance[-1] < sum(legs) * 1.001
    np.testing.assert_array_equal(line.height, queries.height_at(line.x, line.y))
    flat = transform("EPSG:4326", "EPSG:32610", *zip(*points, strict=True))
    other = queries.profile(np.transpose(flat), 500.0, crs="EPSG:32610")
    np.testing.assert_allclose(other.x, line.x, atol=1e-6)
