"""Screen-space error where the answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oracle.cellwalk import depth_picture
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.surface_error import REACH, Spread, surface_error
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import Grid

SIDE = 65
GRID = Grid(SIDE, SIDE, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
HILLS = hills(SIDE, 300.0)
VIEWS = {
    "oblique": Camera(5e5 + 900, 4e6 - 2300, 900, heading=8, pitch=-30),
    "rolled": Camera(5e5 + 900, 4e6 - 1900, 500, heading=8, pitch=-15, roll=50),
    "low": Camera(5e5 + 1000, 4e6 - 1900, 330, heading=-20, pitch=-5),
    "down": Camera(5e5 + 1000, 4e6 - 1000, 2500, heading=30, pitch=-90),
    "flat": Camera(5e5 + 900, 4e6 - 1900, 1500, heading=30, pitch=-40, orthographic=1200),
    "flat down": Camera(5e5 + 1000, 4e6 - 1000, 1500, pitch=-90, orthographic=1200),
}


def frame_of(view: str, **changes: object) -> Frame:
    frame = Frame(VIEWS[view], GRID, (120, 80), height_range=(-100.0, 500.0))
    return replace(frame, **changes)


def shift_on_screen(frame: Frame, depth: np.ndarray, metres: float | np.ndarray) -> np.ndarray:
    """Pixels that the points of a picture move when they rise by `metres`, by the camera's own trigonometry."""
    origin, direction = frame.rays()
    point = origin + direction * frame.view_depth(depth)[..., None]
    right, up, ahead = frame.camera.basis
    raised = point + np.multiply.outer(metres * frame.exaggeration * np.ones(depth.shape), [0, 0, 1])
    if frame.camera.orthographic:
        return np.hypot((raised - point) @ right, (raised - point) @ up) * frame.size[1] / frame.camera.orthographic
    scale = frame.size[1] / 2 / np.tan(np.radians(frame.camera.fov) / 2)
    before = np.stack([point @ right, point @ up]) / (point @ ahead)
    after = np.stack([raised @ right, raised @ up]) / (raised @ ahead)
    return np.hypot(*(after - before)) * scale


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("changes", [{}, {"exaggeration": 0.7, "curvature": True, "jitter": (0.3, -0.4)}])
def test_the_true_picture_has_no_error(view: str, changes: dict[str, object]) -> None:
    frame = frame_of(view, **changes)
    true = depth_picture(frame, HILLS)
    error = surface_error(true, true, frame, TrueSurface(HILLS))
    assert error.forward.count == error.backward.count == (true > 0).sum() > 2000
    assert error.forward.max < 1e-6
    assert error.backward.max == 0
    assert (error.hidden, error.stray, error.missing, error.extra) == (0, 0, 0, 0)


@pytest.mark.parametrize("view", VIEWS)
def test_float32_depths_cost_a_thousandth_of_a_pixel(view: str) -> None:
    frame = frame_of(view)
    true = depth_picture(frame, HILLS)
    error = surface_error(true.astype(np.float32), true, frame, TrueSurface(HILLS))
    assert error.forward.max < 1e-3
    assert error.backward.max < 1e-3
    assert error.stray == 0


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("metres", [0.4, -2.0])
def test_a_raised_plane_is_off_by_its_projected_height_everywhere(view: str, metres: float) -> None:
    ty, tx = np.mgrid[:SIDE, :SIDE] * 1.0
    plane = 50 + 1.5 * tx - 0.8 * ty
    frame = frame_of(view)
    true, drawn = depth_picture(frame, plane), depth_picture(frame, plane + metres)
    error = surface_error(drawn, true, frame, TrueSurface(plane))
    expected = np.where(true > 0, shift_on_screen(frame, true, metres), np.nan)
    # pixels at the data's edge and the picture's border see something else
    away = np.zeros(true.shape, bool)
    away[3:-3, 3:-3] = True
    for row, column in ((3, 0), (-3, 0), (0, 3), (0, -3)):
        away &= np.roll(true, (row, column), (0, 1)) > 0
    np.testing.assert_allclose(error.backward_map[away], expected[away], atol=2e-5)
    expected = shift_on_screen(frame, drawn, -metres)
    np.testing.assert_allclose(error.forward_map[drawn > 0], expected[drawn > 0], atol=1e-6)
    assert error.backward.max < np.nanmax(expected) + 1.5


@pytest.mark.parametrize("view", ["oblique", "rolled", "low", "flat"])
@pytest.mark.parametrize("changes", [{}, {"exaggeration": 0.7, "curvature": True, "jitter": (0.3, -0.4)}])
def test_raised_hills_are_off_by_their_projected_height_both_ways(view: str, changes: dict[str, object]) -> None:
    frame = frame_of(view, **changes)
    true, drawn = depth_picture(frame, HILLS), depth_picture(frame, HILLS + 1.0)
    error = surface_error(drawn, true, frame, TrueSurface(HILLS))
    off = error.backward_map - shift_on_screen(frame, true, 1.0)
    # behind outlines a place is only known to the pixel
    assert np.nanpercentile(np.abs(off), 90) < 0.06
    assert np.nanpercentile(np.abs(off), 99) < 0.5
    assert np.nanmax(np.abs(off)) < 1.5
    forward = error.forward_map - shift_on_screen(frame, drawn, -1.0)
    assert np.nanmax(np.abs(forward)) < 1e-6
    assert error.hidden < 0.02


def test_straight_down_and_parallel_height_moves_nothing() -> None:
    frame = frame_of("flat down")
    true, drawn = depth_picture(frame, HILLS), depth_picture(frame, HILLS + 20)
    error = surface_error(drawn, true, frame, TrueSurface(HILLS))
    assert error.forward.max < 1e-6
    assert error.backward.max == 0


def peak(height: float) -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    return np.maximum(0, height * (1 - np.hypot(x, y) / 8))


def ground_frame(**camera: float) -> Frame:
    frame = frame_of("low")
    return replace(frame, camera=replace(frame.camera, x=5e5 + 30 * (SIDE / 2), heading=0.0, **camera))


def test_a_missed_peak_counts_with_its_height() -> None:
    frame = ground_frame(z=60.0, pitch=0.0)
    true, drawn = depth_picture(frame, peak(200.0)), depth_picture(frame, peak(0.0))
    error = surface_error(drawn, true, frame, TrueSurface(peak(200.0)))
    height = frame.positions(true)[..., 2]
    expected = shift_on_screen(frame, true, -height)
    on_peak = height > 1
    assert on_peak.sum() > 200
    np.testing.assert_allclose(error.backward_map[on_peak], expected[on_peak], atol=0.02)
    assert error.backward.max > 15
    assert error.missing > 0.02
    assert error.hidden == 0
    # the drawn points alone know little of it
    assert error.forward.max < error.backward.max


def test_a_missed_peak_behind_a_ridge_counts_with_its_distance_from_the_skyline() -> None:
    ridge = np.zeros((SIDE, SIDE))
    ridge[50] = 80.0
    both = np.maximum(ridge, peak(400.0))
    frame = ground_frame(z=60.0, pitch=5.0)
    true, drawn = depth_picture(frame, both), depth_picture(frame, ridge)
    error = surface_error(drawn, true, frame, TrueSurface(both))
    skyline = (drawn > 0).any(axis=1).argmax()
    summit = (true > 0).any(axis=1).argmax()
    assert skyline - summit > 10
    column = true.shape[1] // 2
    rows = np.arange(summit + 1, skyline - 1)
    np.testing.assert_allclose(error.backward_map[rows, column], skyline - rows - 0.5, atol=0.55)
    assert error.hidden > 0.02
    assert error.missing >= error.hidden


def test_an_invented_peak_counts_both_ways() -> None:
    frame = frame_of("oblique")
    true, drawn = depth_picture(frame, peak(0.0)), depth_picture(frame, peak(80.0))
    error = surface_error(drawn, true, frame, TrueSurface(peak(0.0)))
    expected = shift_on_screen(frame, drawn, -frame.positions(drawn)[..., 2])
    np.testing.assert_allclose(error.forward_map[drawn > 0], expected[drawn > 0], atol=1e-6)
    assert error.backward.max == pytest.approx(error.forward.max, abs=1)
    assert error.backward.max > 3


def test_an_empty_picture_is_not_a_perfect_one() -> None:
    frame = frame_of("oblique")
    true = depth_picture(frame, HILLS)
    error = surface_error(np.zeros_like(true), true, frame, TrueSurface(HILLS))
    assert error.forward == Spread(0, *[pytest.approx(np.nan, nan_ok=True)] * 5)
    assert error.backward.mean > 10
    assert error.backward.max >= REACH
    assert (error.hidden, error.missing) == (1, 1)


def test_a_surface_that_reaches_too_far_is_stray() -> None:
    heights = np.full((SIDE, SIDE), 100.0)
    frame = frame_of("down")
    wide = Grid(SIDE + 10, SIDE, (30.0, 0.0, 5e5 - 150, 0.0, -30.0, 4e6))
    true = depth_picture(frame, heights)
    drawn = depth_picture(replace(frame, grid=wide), np.full((SIDE, SIDE + 10), 100.0))
    error = surface_error(drawn, true, frame, TrueSurface(heights))
    outside = (drawn > 0) & (true == 0)
    assert error.stray == pytest.approx(outside.sum() / (drawn > 0).sum())
    assert error.extra == error.stray > 0.1
    # 150 m at 2400 m, at the far left and right
    assert error.forward.max == pytest.approx(150 / 2400 * frame.pixels_per_radian(), rel=0.05)
    assert np.nanmax(error.forward_map[true > 0]) < 1e-6


def test_what_is_seen_from_below_is_left_out_backward_alone() -> None:
    frame = ground_frame(y=4e6 - 2400, z=-60.0, pitch=15.0)
    flat = np.full((SIDE, SIDE), 100.0)
    true, drawn = depth_picture(frame, flat), depth_picture(frame, flat - 5)
    assert (true > 0).sum() > 1000
    error = surface_error(drawn, true, frame, TrueSurface(flat))
    assert error.backward.count == 0
    assert error.forward.mean == pytest.approx(np.nanmean(shift_on_screen(frame, drawn, 5.0)))


def test_a_drawn_void_is_stray() -> None:
    heights = HILLS.copy()
    heights[20:40, 20:40] = np.nan
    frame = frame_of("down")
    true, drawn = depth_picture(frame, heights), depth_picture(frame, HILLS)
    error = surface_error(drawn, true, frame, TrueSurface(heights))
    hole = (drawn > 0) & (true == 0)
    assert hole.sum() > 100
    assert error.stray == pytest.approx(hole.sum() / (drawn > 0).sum(), rel=0.01)
    assert surface_error(true, true, frame, TrueSurface(heights)).stray == 0


def test_a_near_edge_that_is_drawn_too_low_or_high_counts_with_what_it_is_off() -> None:
    frame = ground_frame(y=4e6 - 2600, z=500.0, pitch=-20.0)
    flat = np.full((SIDE, SIDE), 100.0)
    true = depth_picture(frame, flat)
    assert (true[-5:] == 0).all()
    for metres in (-12.0, 12.0):
        drawn = depth_picture(frame, flat + metres)
        error = surface_error(drawn, true, frame, TrueSurface(flat))
        most = np.nanmax(shift_on_screen(frame, true, metres))
        assert most > 0.8
        assert error.backward.max < most + 1


@pytest.mark.parametrize("which", ["drawn", "reference"])
def test_pictures_of_another_size_are_refused(which: str) -> None:
    frame = frame_of("down")
    pictures = {"drawn": np.zeros((80, 120)), "reference": np.zeros((80, 120)), which: np.zeros((120, 80))}
    with pytest.raises(SettingsError, match=rf"{which}: expected a depth picture of shape \(80, 120\)"):
        surface_error(**pictures, frame=frame, surface=TrueSurface(HILLS))
    with pytest.raises(SettingsError, match="surface: expected heights of the grid's shape"):
        surface_error(np.zeros((80, 120)), np.zeros((80, 120)), frame, TrueSurface(HILLS[:-1]))


def test_spread_counts_and_leaves_nan_out() -> None:
    spread = Spread.of(np.array([0.0, 1.0, 2.0, 3.0, np.nan]))
    assert (spread.count, spread.mean, spread.max, spread.over_one) == (4, 1.5, 3, 0.5)
    assert spread.p99 == pytest.approx(2.97)
    assert spread.p95 == pytest.approx(2.85)
