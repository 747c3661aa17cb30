"""Flights frame by frame: which frames are measured, and flights that do not fit the data."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orogen.compare.flights import Reel
from orogen.errors import SettingsError
from orogen.grid import Grid
from orogen.source import open_height
from orogen.view.flight import CLEARANCE, Flight, Keyframe, builtin_flights

GRID = Grid(200, 200, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6), "EPSG:32633")
RANGE = (0.0, 500.0)
ABSOLUTE = {"descent-puget", "descent-taiwan"}


def hill(x: float, y: float) -> float:
    """A cone in the middle, NaN outside."""
    left, bottom, right, top = GRID.bounds
    if not (left <= x <= right and bottom <= y <= top):
        return math.nan
    return max(0.0, 500.0 - math.hypot(x - (left + right) / 2, y - (bottom + top) / 2) / 3)


def reel(name: str, fps: float = 30.0) -> Reel:
    return Reel(Flight.load(name).over(GRID, RANGE, height_at=hill), fps)


def keys(*places: tuple[float, float, float, float], cuts: tuple[int, ...] = ()) -> Flight:
    """By position: t, x, y, z."""
    return Flight(tuple(Keyframe(t, x, y, z, cut=i in cuts) for i, (t, x, y, z) in enumerate(places)), "made up")


@pytest.mark.parametrize("name", sorted(set(builtin_flights()) - ABSOLUTE))
def test_relative_flights_fit_any_data(name: str) -> None:
    flown = reel(name)
    flown.check((160, 100), RANGE, hill)
    heights = [hill(c.x, c.y) for c in (flown.shot(n).camera for n in range(flown.count))]
    above = [flown.shot(n).camera.z - ground for n, ground in enumerate(heights) if math.isfinite(ground)]
    assert min(above, default=math.inf) > 0.9 * CLEARANCE * GRID.spacing


def test_rotation_turns_in_place_in_360_steps_of_a_degree() -> None:
    flown = reel("rotation")
    assert flown.count == 360
    cameras = [flown.shot(n).camera for n in range(360)]
    assert [c.heading for c in cameras] == pytest.approx(np.arange(360), abs=1e-9)
    assert len({(c.x, c.y, c.z, c.pitch) for c in cameras}) == 1
    assert cameras[0].z == pytest.approx(hill(cameras[0].x, cameras[0].y) + CLEARANCE * GRID.spacing)


def test_zoom_covers_two_orders_of_magnitude_in_two_seconds() -> None:
    flown = reel("zoom")
    high, low = flown.shot(15).camera, flown.shot(75).camera
    assert (high.z - 500) / (low.z - hill(low.x, low.y)) > 50


def test_teleport_jumps_and_rests() -> None:
    flown = reel("teleport")
    assert flown.path.cuts == (1.0, 2.0, 3.0, 4.0, 5.0)
    cameras = [flown.shot(n).camera for n in range(flown.count)]
    moves = [n for n in range(1, flown.count) if cameras[n] != cameras[n - 1]]
    assert moves == [30, 60, 90, 120, 150]
    # at another frame rate no frame lies between two places either
    other = reel("teleport", fps=47.0)
    assert {other.shot(n).camera for n in range(other.count)} == set(cameras)


def test_crawl_moves_less_than_a_pixel_a_frame() -> None:
    flown = reel("crawl")
    a, b = flown.shot(100).camera, flown.shot(101).camera
    away = 0.04 * math.hypot(6000, 6000) / 2
    pixel = away * 2 * math.tan(math.radians(22.5)) / 900
    assert 0 < math.hypot(b.x - a.x, b.y - a.y) < pixel


def test_frames_evenly_from_first_to_last() -> None:
    flown = reel("rotation")
    assert flown.numbers(1, None) == [0]
    assert flown.numbers(4, None) == [0, 120, 239, 359]
    assert flown.numbers(10_000, None) == list(range(360))
    assert flown.numbers(None, 100) == [0, 100, 200, 300]


def test_frames_before_one_end_at_cuts() -> None:
    flown = reel("teleport")
    assert flown.before(0, 2) == []
    assert flown.before(1, 2) == [0]
    assert flown.before(29, 2) == [27, 28]
    assert flown.before(30, 2) == []
    assert flown.before(31, 2) == [30]
    assert flown.before(200, 3) == [197, 198, 199]


def check(flight: Flight, **options: float) -> None:
    Reel(flight.over(GRID, RANGE, height_at=hill), 10.0).check((160, 100), RANGE, hill, **options)


def test_a_flight_far_away_names_itself_and_both_extents() -> None:
    with pytest.raises(SettingsError) as caught:
        check(keys((0, 100.0, 100.0, 2000.0), (1, 200.0, 300.0, 2000.0)))
    for text in ("made up: outside the data", "at 0 s", "x 500000 to 506000", "y 3994000 to 4000000", "x 100 to "):
        assert text in str(caught.value)


def test_a_flight_that_looks_away_is_outside_the_data() -> None:
    away = Flight(
        tuple(Keyframe(t, 503000.0, 4001000.0, 300.0, heading=h) for t, h in ((0, 180.0), (2, 20.0))), "turning"
    )
    with pytest.raises(SettingsError, match="turning: outside the data: at 1"):
        check(away)


def test_a_flight_below_the_ground_says_how_deep() -> None:
    with pytest.raises(SettingsError, match=r"made up: expected a camera above the ground, got one 300\.0 m below it"):
        check(keys((0, 503000.0, 3997000.0, 200.0), (1, 503001.0, 3997000.0, 200.0)))
    check(keys((0, 503000.0, 3997000.0, 501.0), (1, 503001.0, 3997000.0, 501.0)))


def test_exaggeration_raises_flight_and_ground_alike() -> None:
    flight = keys((0, 503000.0, 3997000.0, 501.0), (1, 503001.0, 3997000.0, 501.0))
    path = flight.over(GRID, RANGE, exaggeration=3.0, height_at=hill)
    Reel(path, 10.0).check((160, 100), RANGE, hill, 3.0)


def test_descents_stay_above_their_mountains(data_dir) -> None:
    source = open_height(data_dir / "puget_height_1k.png", spacing=160.0, height_scale=0.1)
    heights = source.read(slice(0, 1025), slice(0, 1025))

    def height_at(x: float, y: float) -> float:
        i, j = (int(v) for v in source.grid.to_texel(x, y))
        return float(heights[j, i]) if 0 <= i < 1025 and 0 <= j < 1025 else math.nan

    limits = (float(heights.min()), float(heights.max()))
    path = Flight.load("descent-puget").over(source.grid, limits, height_at=height_at)
    flown = Reel(path, 30.0)
    assert flown.count == 1800
    flown.check((160, 100), limits, height_at)
    first, last = flown.shot(0).camera, flown.shot(1799).camera
    assert first.z > 40 * limits[1]
    assert last.z - height_at(last.x, last.y) < 600
    # the three mountains stand in the last picture
    for x, y in ((128560, 79280), (150480, 7600), (96080, 5520)):
        bearing = math.degrees(math.atan2(x - last.x, y - last.y))
        assert abs((bearing - last.heading + 180) % 360 - 180) < 36
    with pytest.raises(SettingsError, match="descent-puget: outside the data"):
        check(Flight.load("descent-puget"))


def test_the_descent_over_taiwan_suits_all_of_it_and_the_middle(data_dir) -> None:
    from orogen.compare.crop import Crop

    source = open_height(data_dir / "taiwan_20m_10481x19401_int16.tif")
    for data in (source, Crop(source, (1200, 4700, 8192, 8192))):

        def height_at(x: float, y: float, data=data) -> float:
            i, j = (int(v) for v in data.grid.to_texel(x, y))
            inside = 0 <= i < data.grid.width and 0 <= j < data.grid.height
            return float(data.read(slice(j, j + 1), slice(i, i + 1))[0, 0]) if inside else math.nan

        path = Flight.load("descent-taiwan").over(data.grid, (-33.0, 3947.0), height_at=height_at)
        Reel(path, 10.0).check((160, 100), (-33.0, 3947.0), height_at)
    source.close()
