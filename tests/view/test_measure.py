import math
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from rasterio.warp import transform

from orogen.errors import SettingsError
from orogen.grid import Grid
from orogen.view.measure import Ruler, distance_text, place_text
from orogen.view.overlay import nice_length, nice_text, projected
from orogen.view.sun import parse_time, sun_position

UTM = Grid(400, 300, (30.0, 0.0, 390000.0, 0.0, -30.0, 3800000.0), "EPSG:32611")
DEGREES = Grid(400, 300, (1 / 1200, 0.0, -122.0, 0.0, -1 / 1200, 47.0), "EPSG:4326", (76000.0, 111200.0))
LOCAL = Grid(400, 300, (2.0, 0.0, 0.0, 0.0, -2.0, 600.0))


def plane(grid, east, north):
    """Heights that rise by so many metres a metre."""

    def height_at(x, y):
        return 100 + np.asarray(x) * grid.ground_scale[0] * east + np.asarray(y) * grid.ground_scale[1] * north

    return height_at


@pytest.mark.parametrize("grid", [UTM, DEGREES, LOCAL], ids=["utm", "degrees", "local"])
@pytest.mark.parametrize(("east", "north"), [(0.0, 0.0), (1.0, 0.0), (0.3, -0.4)])
def test_the_slope_of_a_plane(grid, east, north):
    x, y = (float(v) for v in grid.to_crs(200.0, 100.0))
    expected = math.degrees(math.atan(math.hypot(east, north)))
    assert Ruler(grid, plane(grid, east, north)).slope(x, y) == pytest.approx(expected, abs=1e-5)


def test_places_in_both_reference_systems():
    place = Ruler(UTM, plane(UTM, 0.0, 0.0)).place(395000.0, 3795000.0)
    (longitude,), (latitude,) = transform("EPSG:32611", "EPSG:4326", [395000.0], [3795000.0])
    assert (place.longitude, place.latitude) == pytest.approx((longitude, latitude))
    text = place_text(place, False, UTM.crs)
    assert text.startswith("EPSG:32611 395000.0, 3795000.0   34.")
    assert "° W   100.0 m   slope 0°" in text
    back = Ruler(UTM, plane(UTM, 0, 0)).from_degrees(longitude, latitude)
    assert back == pytest.approx((395000.0, 3795000.0), abs=1e-3)
    local = Ruler(LOCAL, plane(LOCAL, 0, 0))
    assert local.place(3.0, 4.0).longitude is None
    with pytest.raises(SettingsError, match="expected data with a CRS"):
        local.from_degrees(1.0, 2.0)


# T. Vincenty's and C. Karney's geodesics between these places, in metres
@pytest.mark.parametrize(
    ("start", "end", "metres"),
    [
        ((0.0, 0.0), (1.0, 0.0), 111319.491),
        ((0.0, 0.0), (0.0, 1.0), 110574.389),
        ((0.0, 89.0), (0.0, 90.0), 111693.865),
    ],
)
def test_distances_on_the_ellipsoid(start, end, metres):
    ruler = Ruler(DEGREES, plane(DEGREES, 0, 0))
    assert ruler.distances(np.array([start, end]))[-1] == pytest.approx(metres, abs=0.05)


def test_distances_in_a_projection_are_those_on_the_ground():
    # in zone 11 at its central meridian the scale is 0.9996
    ruler = Ruler(UTM, plane(UTM, 0, 0))
    found = ruler.distances(np.array([[500000.0, 3790000.0], [500000.0, 3800000.0], [500000.0, 3800100.0]]))
    assert found == pytest.approx([0, 10000 / 0.9996, 10100 / 0.9996], rel=1e-6)


def test_a_profile_follows_its_corners():
    ruler = Ruler(LOCAL, plane(LOCAL, 0.5, 0.0))
    profile = ruler.profile([(0.0, 0.0), (0.0, 0.0), (100.0, 0.0), (100.0, 50.0)], count=301)
    assert profile.length == pytest.approx(150.0)
    assert profile.climb == pytest.approx((50.0, 0.0))
    assert profile.points[200] == pytest.approx((100.0, 0.0))
    assert profile.height[100] == pytest.approx(100 + 25)
    for points in ([(1.0, 2.0)], [(1.0, 2.0), (1.0, 2.0)]):
        with pytest.raises(SettingsError, match="profile: expected"):
            ruler.profile(points)


def test_true_north_in_a_projection():
    ruler = Ruler(UTM, plane(UTM, 0, 0))
    # the convergence of meridians: longitude from the central meridian times the sine of the latitude
    (longitude,), (latitude,) = transform("EPSG:32611", "EPSG:4326", [395000.0], [3795000.0])
    convergence = math.degrees(math.atan(math.tan(math.radians(longitude + 117)) * math.sin(math.radians(latitude))))
    assert ruler.north_turn(395000.0, 3795000.0) == pytest.approx(-convergence, abs=1e-3)
    assert Ruler(DEGREES, plane(DEGREES, 0, 0)).north_turn(-121.9, 46.9) == 0.0


def test_the_sun():
    # the worked example of I. Reda and A. Andreas, Solar Position Algorithm, 2004: zenith 50.11162, azimuth 194.34024
    when = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    azimuth, elevation = sun_position(-105.1786, 39.742476, when)
    assert azimuth == pytest.approx(194.34, abs=0.03)
    assert elevation == pytest.approx(90 - 50.12, abs=0.03)
    # midnight sun, and a shadow to the south under the tropic of Capricorn's noon
    assert sun_position(25.0, 71.0, parse_time("2026-06-21 22:20"))[1] > 0
    assert sun_position(0.0, -23.44, parse_time("2026-12-21 12:00"))[1] == pytest.approx(90, abs=1)
    with pytest.raises(ValueError):
        parse_time("yesterday")


@pytest.mark.parametrize(("longest", "nice"), [(9.99, 5), (10, 10), (1234, 1000), (0.3, 0.2), (49, 20), (5e5, 5e5)])
def test_lengths_of_scale_bars(longest, nice):
    assert nice_length(longest) == pytest.approx(nice)


def test_scale_bars_say_no_more_than_they_know():
    assert [nice_text(v) for v in (0.5, 200.0, 1000.0, 5e4, 2e6)] == ["0.5 m", "200 m", "1 km", "50 km", "2,000 km"]


def test_distances_for_people():
    assert [distance_text(v) for v in (3.25, 250.0, 1234.0, 250000.0)] == ["3.2 m", "250 m", "1.23 km", "250 km"]


def test_points_are_where_the_picture_shows_them():
    from orogen.camera import Camera
    from orogen.frame import Frame

    frame = Frame(Camera(395000.0, 3795000.0, 900.0, heading=20.0, pitch=-30.0), UTM, (300, 200), exaggeration=1.5)
    depth = np.full((200, 300), 1e-4, np.float32)
    points = frame.positions(depth)[[10, 100, 190], [20, 150, 250]]
    found = projected(frame, points, (150.0, 100.0))
    expected = [(10.25, 5.25), (75.25, 50.25), (125.25, 95.25)]
    assert found[:, :2] == pytest.approx(np.array(expected), abs=1e-3)
    assert found[:, 2] == pytest.approx(frame.view_depth(np.array([1e-4]))[0], rel=1e-5)
