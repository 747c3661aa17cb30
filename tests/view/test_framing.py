import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import Grid
from orogen.view.framing import MARGIN, NEAREST, displaced, fit, frame_camera

UTM = Grid(1197, 643, (30.0, 0.0, 390000.0, 0.0, -30.0, 3800000.0), "EPSG:32611")
DEGREES = Grid(1201, 1201, (1 / 1200, 0.0, -122.0, 0.0, -1 / 1200, 47.0), "EPSG:4326", (76000.0, 111200.0))
ROTATED = Grid(400, 900, (8.0, 6.0, 5e5, 6.0, -8.0, 4e6), "EPSG:32633")
GRIDS = pytest.mark.parametrize("grid", [UTM, DEGREES, ROTATED], ids=["utm", "degrees", "rotated"])


def picture_positions(camera, grid, size, x, y, z):
    """(n, 2) positions in the picture, -1 to 1 to the right and upwards, by the frame's own matrix."""
    frame = Frame(camera, grid, size, height_range=(0.0, 4000.0))
    scale = np.array(grid.ground_scale)
    relative = np.stack([(x - camera.x) * scale[0], (y - camera.y) * scale[1], z - camera.z, np.ones_like(x)], axis=-1)
    clip = relative @ frame.view_projection.T
    assert np.all(clip[:, 3] > 0)
    return clip[:, :2] / clip[:, 3:]


def nearest_depth(camera, grid, x, y, z):
    scale = np.array(grid.ground_scale)
    offsets = np.stack([(x - camera.x) * scale[0], (y - camera.y) * scale[1], z - camera.z], axis=-1)
    return (offsets @ camera.basis[2]).min() / np.ptp(offsets, axis=0).max()


def box(grid, low, high):
    w, h = grid.width, grid.height
    x, y = grid.to_crs([0, w, w, 0] * 2, [0, 0, h, h] * 2)
    return x, y, np.repeat([low, high], 4).astype(float)


@GRIDS
@pytest.mark.parametrize("orthographic", [False, True])
@settings(max_examples=60, deadline=None)
@given(heading=st.floats(-180, 360), pitch=st.floats(-90, 0), fov=st.floats(10, 100), aspect=st.floats(0.4, 3))
def test_the_whole_data_just_fits(grid, orthographic, heading, pitch, fov, aspect):
    camera = frame_camera(
        grid,
        (200.0, 1500.0),
        heading=heading,
        pitch=pitch,
        fov=fov,
        orthographic=orthographic,
        exaggeration=2.0,
        aspect=aspect,
    )
    size = (round(1000 * aspect), 1000)
    seen = picture_positions(camera, grid, size, *box(grid, 400.0, 3000.0))
    low, high = seen.min(axis=0), seen.max(axis=0)
    limit = 1 - 2 * MARGIN
    assert np.all(np.maximum(-low, high) < limit + 5e-3)
    # no nearer camera would do: the box touches both margins of one axis, or the camera is as near as it may be
    touching = max(np.min([-low, high], axis=0)) == pytest.approx(limit, abs=5e-3)
    assert touching or (
        not orthographic and nearest_depth(camera, grid, *box(grid, 400.0, 3000.0)) == pytest.approx(NEAREST)
    )


@GRIDS
@pytest.mark.parametrize("orthographic", [False, True])
@settings(max_examples=40, deadline=None)
@given(heading=st.floats(-180, 360), pitch=st.floats(-90, -5), covered=st.floats(0, 0.6), aspect=st.floats(0.6, 3))
def test_the_whole_data_fits_beside_what_is_covered(grid, orthographic, heading, pitch, covered, aspect):
    options = {"heading": heading, "pitch": pitch, "aspect": aspect, "orthographic": orthographic}
    camera = frame_camera(grid, (200.0, 1500.0), covered=covered, **options)
    seen = picture_positions(camera, grid, (round(1000 * aspect), 1000), *box(grid, 200.0, 1500.0))
    low, high = seen.min(axis=0), seen.max(axis=0)
    limit = 1 - 2 * MARGIN
    assert low[0] > 2 * covered - limit - 5e-3
    assert low[1] > -limit - 5e-3
    assert high.max() < limit + 5e-3
    # across or upwards it fills what there is
    across = [low[0] - 2 * covered + limit, limit - high[0]]
    upwards = [low[1] + limit, limit - high[1]]
    near = not orthographic and nearest_depth(camera, grid, *box(grid, 200.0, 1500.0)) == pytest.approx(NEAREST)
    assert near or min(max(np.abs(across)), max(np.abs(upwards))) < 5e-3


@GRIDS
def test_look_at_is_in_the_middle_at_the_distance(grid):
    x, y = (float(v) for v in grid.to_crs(100.0, 300.0))
    camera = frame_camera(
        grid,
        (0.0, 1000.0),
        look_at=(x, y),
        distance=2500.0,
        heading=120.0,
        pitch=-20.0,
        exaggeration=1.5,
        height_at=lambda *_: 800.0,
    )
    target = np.array([(x - camera.x) * grid.ground_scale[0], (y - camera.y) * grid.ground_scale[1], 1200.0 - camera.z])
    assert np.linalg.norm(target) == pytest.approx(2500.0)
    assert target / 2500.0 == pytest.approx(camera.basis[2], abs=1e-9)


def test_look_at_alone_keeps_the_scale_of_the_whole_picture():
    whole = frame_camera(UTM, (0.0, 1000.0), orthographic=True)
    part = frame_camera(UTM, (0.0, 1000.0), orthographic=True, look_at=(400000.0, 3790000.0))
    assert part.orthographic == whole.orthographic
    assert (part.x, part.y) != (whole.x, whole.y)


def test_distance_alone_looks_at_the_middle():
    camera = frame_camera(UTM, (0.0, 1000.0), distance=1e4, pitch=-90.0)
    left, bottom, right, top = UTM.bounds
    assert (camera.x, camera.y) == pytest.approx(((left + right) / 2, (bottom + top) / 2))
    assert camera.z == pytest.approx(500.0 + 1e4)


def test_an_orthographic_camera_shows_what_the_perspective_one_does_at_the_target():
    camera = frame_camera(UTM, (0.0, 1000.0), distance=1e4, fov=60.0, orthographic=True)
    assert camera.orthographic == pytest.approx(2e4 * math.tan(math.radians(30)))


def test_bounds_are_framed_with_the_heights_found_there():
    bounds = (400000.0, 3790000.0, 401000.0, 3791000.0)
    camera = frame_camera(UTM, (0.0, 3000.0), bounds=bounds, height_at=lambda x, y: 2000.0 + (x - 400000.0) / 10)
    x, y = np.array(bounds)[[0, 2, 2, 0] * 2], np.array(bounds)[[1, 1, 3, 3] * 2]
    seen = picture_positions(camera, UTM, (1600, 900), x, y, np.repeat([2000.0, 2100.0], 4))
    assert 0.9 < np.abs(seen).max() < 0.95
    assert abs(camera.z - 2050.0) < 2000.0


def test_a_target_without_height_lies_at_mid_height():
    camera = frame_camera(UTM, (0.0, 1000.0), look_at=(0.0, 0.0), distance=100.0, height_at=lambda *_: math.nan)
    assert camera.z == pytest.approx(500.0 + 100.0 * math.sin(math.radians(35.0)))


def test_fit_keeps_off_a_single_point():
    eye, depth = fit(Camera(0, 0, 0, pitch=-90), np.array([[1.0, 2.0, 3.0]]), 1.0)
    assert depth == pytest.approx(NEAREST)
    assert eye == pytest.approx([1.0, 2.0, 3.0 + NEAREST])


def test_displaced_steps_in_true_metres():
    camera = displaced(Camera(-122.0, 46.0, 10.0), DEGREES, np.array([760.0, -1112.0, 5.0]))
    assert (camera.x, camera.y, camera.z) == pytest.approx((-121.99, 45.99, 15.0))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"look_at": (math.nan, 0.0)}, "look_at"),
        ({"distance": math.inf}, "distance"),
        ({"distance": 0.0}, "distance"),
        ({"heading": math.nan}, "heading"),
        ({"pitch": -91.0}, "pitch"),
        ({"fov": 180.0}, "fov"),
        ({"aspect": 0.0}, "aspect"),
        ({"covered": 0.95}, r"covered: expected 0 to 0\.9"),
        ({"exaggeration": -1.0}, "exaggeration"),
        ({"bounds": (0.0, 0.0, math.nan, 1.0)}, "bounds"),
        ({"bounds": (401000.0, 3790000.0, 400000.0, 3791000.0)}, "left < right"),
        ({"bounds": (0.0, 0.0, 1.0, 1.0)}, "meets the data"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(SettingsError, match=message):
        frame_camera(UTM, (0.0, 1000.0), **options)
