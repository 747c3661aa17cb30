"""True lengths of CRS units against figures from geodesic inverse computations, and facts of the projections."""

from __future__ import annotations

import math

import pytest
from rasterio.crs import CRS

from orogen.source.scale import ground_scale

MOON = (
    'GEOGCS["Moon 2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000_IAU_IAG",1737400,0]],'
    'PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]'
)


@pytest.mark.parametrize(
    ("crs", "x", "y", "expected"),
    [
        ("EPSG:3857", 13_470_000, 2_710_000, (0.9165536097, 0.9113991402)),
        ("EPSG:32611", 400_000, 3_800_000, (1.0002768144, 1.0002768144)),
        ("EPSG:4326", 121.0, 23.5, (102141.03505, 110751.05587)),
        ("EPSG:4269", -122, 47, (76055.99830, 111170.84150)),
        ("EPSG:2263", 987_000, 200_000, (0.3048013285, 0.3048013284)),  # US survey feet
        ("EPSG:3031", 500_000, 700_000, (1.0231090291, 1.0231090291)),  # polar
        ("EPSG:5070", 100_000, 1_800_000, (1.0095263123, 0.9905636898)),  # equal area: not conformal
        ("EPSG:4807", 2.5, 54.0, (66383.55874, 100081.80114)),  # grads
    ],
)
def test_units_have_their_length_on_the_ellipsoid(crs: str, x: float, y: float, expected: tuple[float, float]) -> None:
    step = 0.001 if CRS.from_user_input(crs).is_geographic else 20.0
    assert ground_scale(CRS.from_user_input(crs), x, y, step) == pytest.approx(expected, rel=1e-8)


def test_utm_is_0_9996_too_short_on_its_central_meridian() -> None:
    scale = ground_scale(CRS.from_epsg(32633), 500_000, 5_000_000, 30)
    assert scale == pytest.approx((1 / 0.9996, 1 / 0.9996), rel=1e-9)


def test_the_moon_has_its_own_radius() -> None:
    length = 1_737_400 * math.pi / 180
    assert ground_scale(CRS.from_wkt(MOON), 0, 60, 0.01) == pytest.approx((length / 2, length), rel=1e-6)


def test_without_a_crs_units_are_metres() -> None:
    assert ground_scale(None, 1e6, 1e6, 1) == (1, 1)


def test_places_where_a_projection_is_not_defined_fall_back_to_its_unit() -> None:
    assert ground_scale(CRS.from_epsg(32633), 1e12, 1e12, 1) == (1, 1)
