import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from orogen.camera import Camera
from orogen.errors import OutputError, SettingsError
from orogen.grid import Grid
from orogen.view.flight import CLEARANCE, Flight, Keyframe, builtin_flights
from orogen.view.spline import Spline

UTM = Grid(1197, 643, (30.0, 0.0, 390000.0, 0.0, -30.0, 3800000.0), "EPSG:32611")
DEGREES = Grid(1201, 1201, (1 / 1200, 0.0, -122.0, 0.0, -1 / 1200, 47.0), "EPSG:4326", (76000.0, 111200.0))


def keys_at(*times, **values):
    """Keyframes by position, every value a list."""
    places = {"x": [0.0] * len(times), "y": [0.0] * len(times), "z": [0.0] * len(times), **values}
    return tuple(Keyframe(t, **{k: v[i] for k, v in places.items()}) for i, t in enumerate(times))


def target_key(t, **changes):
    return Keyframe(t, **{"look_at": (391000.0, 3790000.0), "distance": 500.0, **changes})


def rng_times(rng, count):
    return np.concatenate([[0], np.cumsum(rng.uniform(0.2, 3, count - 1))])


@pytest.mark.parametrize("count", [2, 3, 9])
def test_bounded_spline_is_the_monotone_one_of_scipy(count):
    rng = np.random.default_rng(count)
    times, values = rng_times(rng, count), rng.normal(size=(count, 3)).round(0)
    t = np.linspace(0, times[-1], 200)
    assert np.allclose(Spline(times, values, bounded=True)(t), PchipInterpolator(times, values)(t), atol=1e-12)


def test_free_spline_keeps_quadratics():
    times = rng_times(np.random.default_rng(3), 7)
    t = np.linspace(0, times[-1], 100)
    spline = Spline(times, np.stack([times**2 - 3 * times, 5 - times], axis=-1))
    assert np.allclose(spline(t), np.stack([t**2 - 3 * t, 5 - t], axis=-1))


@pytest.mark.parametrize("bounded", [False, True])
def test_splines_meet_their_keys_with_a_continuous_velocity(bounded):
    rng = np.random.default_rng(4)
    times, values = rng_times(rng, 8), 1e7 + rng.normal(size=(8, 2)) * 1e4
    spline = Spline(times, values, bounded)
    assert np.array_equal(spline(times), values)
    step = 1e-5
    before, after = spline(times[1:-1]) - spline(times[1:-1] - step), spline(times[1:-1] + step) - spline(times[1:-1])
    assert np.allclose(before / step, after / step, atol=20)  # m/s, of velocities of some 10 000


def test_a_pause_of_the_free_spline_rests():
    spline = Spline([0, 1, 2, 3], [(0, 0), (5, 1), (5, 1), (9, 9)])
    assert np.array_equal(spline([1.2, 1.7]), [(5, 1), (5, 1)])


def test_cameras_at_the_keys_are_the_keys():
    keys = keys_at(
        0, 1.5, 4, x=[391000.0, 392000.5, 392000.0], y=[3790000.0, 3790500.0, 3791111.0], z=[900.0, 1000.0, 950.0],
        heading=[10.0, 350.0, 200.0], pitch=[-10.0, -90.0, 20.0], roll=[0.0, 5.0, 0.0], fov=[45.0, 30.0, 60.0],
    )  # fmt: skip
    path = Flight(keys).over(UTM, (0.0, 2000.0), exaggeration=2.0)
    for key in keys:
        camera = path.camera_at(key.t)
        assert (camera.x, camera.y, camera.z) == (key.x, key.y, 2 * key.z)
        assert (camera.heading, camera.pitch, camera.roll, camera.fov) == pytest.approx(
            (key.heading, key.pitch, key.roll, key.fov)
        )
    assert path.camera_at(-1) == path.camera_at(0)
    assert path.camera_at(99) == path.camera_at(4)


def test_headings_take_the_short_way():
    path = Flight(keys_at(0, 1, heading=[350.0, 20.0])).over(UTM, (0.0, 0.0))
    assert path.camera_at(0.5).heading == pytest.approx(5.0)
    assert 0 < path.camera_at(0.6).heading < 20
    assert 350 < path.camera_at(0.1).heading < 360


def test_heights_do_not_swing_below_their_keys():
    path = Flight(keys_at(0, 1, 1.2, 4, z=[5000.0, 100.0, 100.0, 4000.0])).over(UTM, (0.0, 0.0))
    assert min(path.camera_at(t).z for t in np.linspace(0, 4, 300)) == 100.0


@pytest.mark.parametrize("grid", [UTM, DEGREES], ids=["utm", "degrees"])
def test_a_target_stays_in_the_middle_at_its_distance(grid):
    left, bottom, right, top = grid.bounds
    x, y = (left + right) / 2, (bottom + top) / 2
    keys = [
        Keyframe(t, look_at=(x, y), distance=800.0, heading=h, pitch=-30.0)
        for t, h in ((0, 0), (1, 90), (2, 180), (3, 270), (4, 360))
    ]
    path = Flight(tuple(keys)).over(grid, (0.0, 500.0), exaggeration=1.5, height_at=lambda *_: 200.0)
    for t in np.linspace(0, 4, 17):
        camera = path.camera_at(t)
        scale = grid.ground_scale
        offset = np.array([(x - camera.x) * scale[0], (y - camera.y) * scale[1], 300.0 - camera.z])
        assert offset == pytest.approx(800 * camera.basis[2], abs=1e-4)
        assert camera.heading == pytest.approx(90 * t % 360, abs=1e-9)


def test_distances_change_by_equal_factors():
    path = Flight((target_key(0, distance=100.0, pitch=-90.0), target_key(2, distance=1e4, pitch=-90.0))).over(
        UTM, (0.0, 0.0)
    )
    assert path.camera_at(1).z == pytest.approx(1000.0)


def test_targets_without_height_lie_at_mid_height():
    flight = Flight((target_key(0, pitch=-90.0), target_key(1, pitch=-90.0)))
    assert flight.over(UTM, (100.0, 300.0), height_at=lambda *_: math.nan).camera_at(0).z == pytest.approx(700.0)
    assert flight.over(UTM, (100.0, 300.0)).camera_at(0).z == pytest.approx(700.0)


def test_relative_positions():
    flight = Flight(keys_at(0, 1, x=[0.0, 1.0], y=[0.0, 0.5], z=[0.0, 1.0]), relative=True)
    path = flight.over(DEGREES, (100.0, 1000.0), exaggeration=2.0)
    left, bottom, right, top = DEGREES.bounds
    start, end = path.camera_at(0), path.camera_at(1)
    assert (start.x, start.y, start.z) == pytest.approx((left, bottom, 2000.0))
    half_diagonal = math.hypot((right - left) * 76000, (top - bottom) * 111200) / 2
    assert (end.x, end.y, end.z) == pytest.approx((right, (bottom + top) / 2, 2 * (1000 + half_diagonal)))


def test_a_relative_flight_is_lifted_smoothly_over_obstacles():
    def height_at(x, y):
        return 2000.0 if 400000 < x < 404000 else 0.0

    flight = Flight(keys_at(0, 20, x=[0.0, 1.0], y=[0.5, 0.5], z=[-0.09, -0.09]), relative=True)
    plain = flight.over(UTM, (0.0, 2000.0), exaggeration=1.5)
    lifted = flight.over(UTM, (0.0, 2000.0), exaggeration=1.5, height_at=height_at)
    times = np.linspace(0, 20, 2000)
    cameras = [lifted.camera_at(t) for t in times]
    z = np.array([c.z for c in cameras])
    ground = np.array([1.5 * height_at(c.x, c.y) for c in cameras])
    assert plain.camera_at(7).z < 3000.0
    # between two look-ups of the ground a wall may come a little late
    assert np.mean(z >= ground + CLEARANCE * UTM.spacing - 1) > 0.99
    assert np.all(z > ground)
    assert (z[0], z[-1]) == pytest.approx((plain.camera_at(0).z, plain.camera_at(20).z))
    assert np.abs(np.diff(z)).max() / (times[1] - times[0]) < 3000 / 1.5


def test_positions_in_another_crs():
    lonlat = Flight(keys_at(0, 1, x=[-118.2, -118.1], y=[34.3, 34.35], z=[9.0, 9.0]), crs="EPSG:4326")
    camera = lonlat.over(UTM, (0.0, 1000.0)).camera_at(0)
    # UTM zone 11 by its series (Snyder, Map projections: a working manual, 1987) at 34.3 N, 1.2 degrees west of 117 W
    assert (camera.x, camera.y) == pytest.approx(utm(34.3, -118.2, -117.0), abs=0.5)
    same = Flight(lonlat.keyframes, crs="OGC:CRS84").over(UTM, (0.0, 1000.0)).camera_at(0)
    assert (same.x, same.y) == pytest.approx((camera.x, camera.y))
    with pytest.raises(SettingsError, match="crs: cannot go from EPSG:nonsense"):
        Flight(lonlat.keyframes, crs="EPSG:nonsense").over(UTM, (0.0, 1000.0))
    with pytest.raises(SettingsError, match="the data has no CRS"):
        lonlat.over(Grid(10, 10, (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)), (0.0, 1.0))


def utm(lat, lon, centre):
    a, e2 = 6378137.0, 0.00669437999014
    phi, ep2 = math.radians(lat), e2 / (1 - e2)
    n = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    t, c, w = math.tan(phi) ** 2, ep2 * math.cos(phi) ** 2, math.radians(lon - centre) * math.cos(phi)
    m = a * (
        (1 - e2 / 4 - 3 * e2**2 / 64 - 5 * e2**3 / 256) * phi
        - (3 * e2 / 8 + 3 * e2**2 / 32 + 45 * e2**3 / 1024) * math.sin(2 * phi)
        + (15 * e2**2 / 256 + 45 * e2**3 / 1024) * math.sin(4 * phi)
        - 35 * e2**3 / 3072 * math.sin(6 * phi)
    )
    x = 0.9996 * n * (w + (1 - t + c) * w**3 / 6 + (5 - 18 * t + t * t + 72 * c - 58 * ep2) * w**5 / 120)
    y = 0.9996 * (m + n * math.tan(phi) * (w**2 / 2 + (5 - t + 9 * c + 4 * c * c) * w**4 / 24))
    return x + 500000.0, y


def test_the_sun_moves_with_the_flight():
    keys = keys_at(0, 2, sun=[(350.0, 10.0), (30.0, 50.0)])
    assert Flight(keys).over(UTM, (0.0, 0.0)).sun_at(1) == pytest.approx((10.0, 30.0))
    assert Flight(keys_at(0, 2)).over(UTM, (0.0, 0.0)).sun_at(1) is None


def test_frames_last_for_the_duration():
    path = Flight(keys_at(0, 2, x=[0.0, 10.0])).over(UTM, (0.0, 0.0))
    frames = list(path.frames(25))
    assert len(frames) == path.frame_count(25) == 50
    assert [t for t, _ in frames] == pytest.approx(np.arange(50) / 25)
    assert [c.x for _, c in frames] == pytest.approx(np.arange(50) / 5)
    assert path.frame_count(0.1) == 1
    with pytest.raises(SettingsError, match="fps"):
        path.frame_count(0)


@pytest.mark.parametrize("grid", [UTM, DEGREES], ids=["utm", "degrees"])
@pytest.mark.parametrize("name", [name for name in builtin_flights() if not name.startswith("descent-")])
def test_built_in_flights_suit_any_data(name, grid):
    flight = Flight.load(name)
    assert (flight.name, flight.relative) == (name, True)
    path = flight.over(grid, (0.0, 3000.0), height_at=lambda x, y: 1500.0)
    cameras = [camera for _, camera in path.frames(2)]
    assert min(camera.z for camera in cameras) >= 1500.0 + CLEARANCE * grid.spacing - 1e-6
    left, _, right, _ = grid.bounds
    assert max(abs(camera.x - (left + right) / 2) for camera in cameras) < 4 * (right - left)


def test_a_cut_jumps_and_rests_until_then():
    keys = keys_at(0, 1, 3, 4, x=[0.0, 10.0, 500.0, 510.0], heading=[0.0, 0.0, 90.0, 90.0])
    keys = (*keys[:2], replace(keys[2], cut=True), keys[3])
    path = Flight(keys).over(UTM, (0.0, 0.0))
    assert path.cuts == (3,)
    assert [path.camera_at(t).x for t in (0.5, 1, 2, 2.999999, 3, 3.5, 9)] == [5.0, 10, 10, 10, 500, 505, 510]
    assert (path.camera_at(2.9).heading, path.camera_at(3).heading) == (0.0, 90.0)
    # the way before a cut is that of a flight which ends there
    alone = Flight(keys[:2]).over(UTM, (0.0, 0.0))
    assert [path.camera_at(t) for t in (0, 0.3, 0.9)] == [alone.camera_at(t) for t in (0, 0.3, 0.9)]
    assert Flight(keys).lasting(8).over(UTM, (0.0, 0.0)).cuts == (6,)


def test_a_place_between_two_cuts_is_held():
    keys = [target_key(t, distance=d, heading=10 * t, sun=(t, 30.0)) for t, d in ((0, 100.0), (1, 200.0), (2, 300.0))]
    keys[1:] = [replace(key, cut=True) for key in keys[1:]]
    path = Flight(tuple(keys)).over(UTM, (0.0, 0.0))
    assert {path.camera_at(t) for t in (1, 1.5, 1.99)} == {path.camera_at(1)}
    assert [round(path.camera_at(t).heading) for t in (0, 0.99, 1, 2, 5)] == [0, 0, 10, 20, 20]
    assert [path.sun_at(t)[0] for t in (0.5, 1.5, 2.5)] == [0, 1, 2]


def test_each_side_of_a_cut_is_lifted_by_itself():
    keys = [Keyframe(t, x, 0.5, -0.2) for t, x in ((0, 0.2), (1, 0.8))]
    keys[1] = replace(keys[1], cut=True)
    heights = {True: 50.0, False: 900.0}
    middle = sum(UTM.bounds[::2]) / 2
    path = Flight((*keys, replace(keys[1], t=2.0, cut=False)), relative=True).over(
        UTM, (0.0, 900.0), height_at=lambda x, y: heights[x < middle]
    )
    clear = CLEARANCE * UTM.spacing
    assert [path.camera_at(t).z for t in (0, 0.99, 1, 2)] == pytest.approx([50 + clear] * 2 + [900 + clear] * 2)


def test_a_relative_flight_stays_above_the_lowest_height_where_there_is_no_ground():
    flight = Flight(keys_at(0, 1, x=[0.5, 0.5], y=[0.5, 0.5], z=[-3.0, -3.0]), relative=True)
    path = flight.over(UTM, (100.0, 900.0), exaggeration=2.0, height_at=lambda *_: math.nan)
    assert path.camera_at(0.5).z == pytest.approx(200 + CLEARANCE * UTM.spacing)


def test_there_are_an_orbit_and_a_descent():
    assert {"orbit", "descent"} <= set(builtin_flights())
    orbit, descent = (Flight.load(n).over(UTM, (0.0, 1000.0)) for n in ("orbit", "descent"))
    assert orbit.camera_at(0) == orbit.camera_at(orbit.duration)
    headings = [camera.heading for _, camera in orbit.frames(4)]
    assert np.histogram(headings, 12, (0, 360))[0].min() > 0
    heights = [camera.z for _, camera in descent.frames(4)]
    assert heights == sorted(heights, reverse=True)
    assert heights[-1] < 0.2 * heights[0]


def test_save_and_load(tmp_path):
    flight = Flight(
        keys_at(0, 1.25, x=[391000.125, 1e-9], pitch=[-5.0, 7.0], sun=[(1.0, 2.0), (3.0, 4.0)], cut=[False, True]),
        "try",
        "EPSG:32611",
    )
    flight.save(tmp_path / "f.json")
    assert Flight.load(tmp_path / "f.json") == flight
    with pytest.raises(OutputError, match="exists already"):
        flight.save(tmp_path / "f.json")
    flight.save(tmp_path / "f.json", overwrite=True)
    relative = Flight((target_key(0, look_at=(0, 1)), target_key(1)), relative=True)
    relative.save(tmp_path / "r.json")
    assert Flight.load(str(tmp_path / "r.json")) == relative


def test_recording():
    cameras = [Camera(391000.0 + i, 3790000.0, 3000.0 - i, heading=40.0 * i, pitch=-i, fov=50.0) for i in range(4)]
    flight = Flight.from_cameras([7.0, 8.0, 8.5, 10.0], cameras, "mine", exaggeration=2.0)
    path = flight.over(UTM, (0.0, 2000.0), exaggeration=2.0)
    assert [path.camera_at(t) for t in (0.0, 1.0, 1.5, 3.0)] == cameras
    with pytest.raises(SettingsError, match="orthographic"):
        Flight.from_cameras([0, 1], [cameras[0], cameras[1].moved(orthographic=5.0)])
    with pytest.raises(SettingsError, match="as many times"):
        Flight.from_cameras([0], cameras)


GOOD = {"t": 0, "x": 1, "y": 2, "z": 3}
LATER = {**GOOD, "t": 1}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([1], "expected an object"),
        ({}, "keyframes: expected a list"),
        ({"keyframes": [GOOD]}, "keyframes: expected at least 2, got 1"),
        ({"keyframes": [GOOD, GOOD]}, "keyframe 2: t: expected more than 0, got 0"),
        ({"keyframes": [LATER, {**GOOD, "t": 2}]}, "keyframe 1: t: expected the first"),
        ({"keyframes": [GOOD, {**LATER, "haeding": 3}]}, "keyframe 2: haeding: unknown key; did you mean heading?"),
        ({"keyframes": [GOOD, LATER], "qqq": 1}, "qqq: unknown key; expected one of keyframes"),
        ({"keyframes": [GOOD, {**LATER, "x": math.nan}]}, "keyframe 2: x: expected a number, got nan"),
        ({"keyframes": [GOOD, {**LATER, "x": 10**400}]}, "keyframe 2: x: expected a number, got inf"),
        ({"keyframes": [GOOD, {**LATER, "z": "high"}]}, "keyframe 2: z: expected a number, got 'high'"),
        ({"keyframes": [GOOD, {**LATER, "z": True}]}, "keyframe 2: z: expected a number, got True"),
        ({"keyframes": [GOOD, {**LATER, "heading": None}]}, "keyframe 2: heading: expected a number, got None"),
        ({"keyframes": [GOOD, {**LATER, "pitch": 91}]}, "keyframe 2: camera pitch: expected -90 to 90"),
        ({"keyframes": [GOOD, {**LATER, "sun": [1]}]}, "keyframe 2: sun: expected two numbers"),
        ({"keyframes": [GOOD, {**LATER, "sun": [1, 91]}]}, "keyframe 2: sun: expected an elevation"),
        ({"keyframes": [GOOD, {**LATER, "sun": [1, 2]}]}, "keyframe 2: sun: expected on all keyframes or on none"),
        ({"keyframes": [GOOD, {"t": 1, "x": 1, "y": 1}]}, "keyframe 2: expected either x, y and z or look_at"),
        ({"keyframes": [GOOD, {**LATER, "distance": 4}]}, "keyframe 2: expected either"),
        ({"keyframes": [GOOD, {**LATER, "cut": 1}]}, "keyframe 2: cut: expected true or false, got 1"),
        ({"keyframes": [{**GOOD, "cut": True}, LATER]}, "keyframe 1: cut: expected a keyframe to jump from"),
        ({"keyframes": [GOOD, {"t": 1, "look_at": [1, 2], "distance": 1}]}, "keyframe 2: look_at: expected on all"),
        ({"keyframes": [GOOD, {"t": 1, "look_at": [1, 2], "distance": 0}]}, "keyframe 2: distance: expected more"),
        ({"keyframes": [GOOD, {"x": 1, "y": 2, "z": 3}]}, "keyframe 2: t: expected a time"),
        ({"keyframes": [GOOD, 5]}, "keyframe 2: expected an object"),
        ({"keyframes": [GOOD, LATER], "crs": 4326}, "crs: expected a str, got 4326"),
        ({"keyframes": [GOOD, LATER], "crs": "EPSG:4326", "relative": True}, "crs: a relative flight has none"),
    ],
)
def test_errors_name_the_file_and_the_key(tmp_path, data, message):
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(data))
    with pytest.raises(SettingsError) as caught:
        Flight.load(path)
    assert str(caught.value).startswith(f"flight {path}: {message}")


def test_files_that_are_no_flights(tmp_path):
    (tmp_path / "bad.json").write_text('{"keyframes":\n [,]}')
    with pytest.raises(SettingsError, match=r"bad\.json: line 2: not JSON"):
        Flight.load(tmp_path / "bad.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match="not a text file"):
        Flight.load(tmp_path / "binary.json")
    with pytest.raises(SettingsError, match=r"orbits: No such file.*built-in flights.*orbit"):
        Flight.load("orbits")
