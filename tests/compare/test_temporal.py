"""Stability over synthetic flights whose changes are known, and places followed through pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from oracle.cellwalk import depth_picture
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.temporal import STRIDE, VISIBLE_JUMP, History, Stability
from orogen.compare.track import REACH, interpolate, sight
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import Grid

SIDE = 65
GRID = Grid(SIDE, SIDE, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
HILLS = hills(SIDE, 300.0)
SURFACE = TrueSurface(HILLS)
START = Camera(5e5 + 900, 4e6 - 2300, 900, heading=8, pitch=-30)
Floats = NDArray[np.float64]


def frame_at(step: float, **changes: float) -> Frame:
    """A flight north-east that turns a little; one step is a frame."""
    camera = START.moved(x=START.x + 4.1 * step, y=START.y + 9.3 * step, heading=8 + 0.11 * step, **changes)
    return Frame(camera, GRID, (160, 100), height_range=(-100.0, 500.0))


def fly(surfaces: list[Floats], steps: list[float] | None = None) -> list[Stability | None]:
    history = History()
    steps = steps or [float(k) for k in range(len(surfaces))]
    frames = [frame_at(step) for step in steps]
    pictures = [depth_picture(frame, heights) for frame, heights in zip(frames, surfaces, strict=True)]
    return [
        history.add_depth(frame, picture.astype(np.float32), SURFACE)
        for frame, picture in zip(frames, pictures, strict=True)
    ]


def change_on_screen(step: float, before: Floats, after: Floats) -> Floats:
    """Pixels by which points that the earlier surface shows at `step` move in the next frame, by trigonometry."""
    depth = depth_picture(frame_at(step), before)
    x, y, z = np.moveaxis(frame_at(step).positions(depth)[STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE], -1, 0)
    tx, ty = GRID.to_texel(x, y)
    grown = TrueSurface(after - before).height(tx, ty)
    frame = frame_at(step + 1)
    right, up, ahead = frame.camera.basis
    places = []
    for height in (z, z + grown):
        point = np.stack([x - frame.camera.x, y - frame.camera.y, height - frame.camera.z], axis=-1)
        places.append(np.stack([point @ right, point @ up]) / (point @ ahead))
    scale = frame.size[1] / 2 / np.tan(np.radians(frame.camera.fov) / 2)
    return np.hypot(*(places[1] - places[0])) * scale


def coarse(heights: Floats, step: int) -> Floats:
    """Only every so-manieth sample, bilinear in between."""
    at = np.arange(heights.shape[0]) / step
    lower = np.minimum(at.astype(int), (heights.shape[0] - 1) // step - 1)
    part = (at - lower)[:, None]
    kept = heights[::step, ::step]
    rows = kept[lower] * (1 - part) + kept[lower + 1] * part
    return rows[:, lower] * (1 - part.T) + rows[:, lower + 1] * part.T


@pytest.mark.parametrize("error", [0.0, 12.0, -7.0])
def test_a_static_error_is_stable(error: float) -> None:
    first, second, third = fly([HILLS + error] * 3)
    assert first is None
    assert second is not None
    assert np.isnan(second.swimming)
    assert third is not None
    assert third.count > 2000
    assert third.p99 < 1e-3
    assert third.mean < 1e-3
    assert third.swimming == third.mean
    assert third.popping == 0


def test_a_coarse_surface_that_stands_still_is_stable() -> None:
    *_, last = fly([coarse(HILLS, 4)] * 3)
    assert last is not None
    assert last.mean < 0.02
    assert last.p99 < 0.2
    # places between pixels are known to a few tenths, hardly ever worse
    assert last.popping < 0.002


def test_an_error_that_slides_swims() -> None:
    _, x = np.mgrid[:SIDE, :SIDE]
    waves = [HILLS + 25 * np.sin(x / 3 + 0.3 * k) for k in range(4)]
    for k, found in enumerate(fly(waves)[2:], start=1):
        expected = change_on_screen(k, waves[k], waves[k + 1])
        assert found is not None
        assert np.nanmean(expected) > 0.3
        assert found.mean == pytest.approx(np.nanmean(expected), rel=0.05)
        assert found.swimming == pytest.approx(found.mean, rel=0.01)
        assert found.popping < 0.002


def test_a_sudden_step_pops_once() -> None:
    x = np.arange(SIDE)
    # narrow slopes, so that no cliff hides anything
    plateau = 20 * np.clip((x - 15) / 4, 0, 1) * np.clip((38 - x) / 4, 0, 1)
    after = HILLS + plateau
    _, quiet, jump, again, still = fly([HILLS, HILLS, after, after, after])
    expected = change_on_screen(1, HILLS, after)
    assert quiet is not None
    assert quiet.p99 < 1e-3
    assert jump is not None
    share = (expected[~np.isnan(expected)] > VISIBLE_JUMP).mean()
    assert 0.2 < share < 0.6
    assert jump.popping == pytest.approx(share, abs=0.03)
    assert jump.p99 == pytest.approx(np.nanpercentile(expected, 99), rel=0.1)
    assert jump.swimming < 0.05
    for later in (again, still):
        assert later is not None
        assert later.popping == 0
        assert later.mean < 0.01


def test_a_change_in_proportion_to_the_camera_s_motion_does_not_pop() -> None:
    y, x = np.mgrid[:SIDE, :SIDE]

    def drifted(metres: float) -> Floats:
        return HILLS + metres * (1 + 0.2 * np.sin(x / 5 + y / 7))

    surfaces = [drifted(0), drifted(2), drifted(18)]
    faster = fly(surfaces, [0.0, 1.0, 9.0])[-1]
    steady = fly(surfaces, [0.0, 1.0, 2.0])[-1]
    assert faster is not None
    assert steady is not None
    assert faster.mean > 2 * VISIBLE_JUMP
    assert faster.popping < 0.005
    assert steady.popping > 0.9


def test_a_jump_before_a_camera_at_rest_pops() -> None:
    *_, last = fly([HILLS, HILLS, HILLS + 15], [2.0, 2.0, 2.0])
    assert last is not None
    assert last.popping > 0.95
    assert last.swimming < VISIBLE_JUMP


def test_nothing_is_said_of_frames_that_share_no_ground() -> None:
    history = History()
    for turn in (0.0, 180.0):
        frame = frame_at(0.0, z=600.0, pitch=-60.0)
        frame = replace(frame, camera=frame.camera.moved(heading=turn, y=4e6 - 900))
        found = history.add_depth(frame, depth_picture(frame, HILLS), SURFACE)
    assert found is not None
    assert np.isnan([found.mean, found.p99, found.swimming, found.popping]).all()


def test_a_cut_forgets_the_flight() -> None:
    frame = frame_at(0.0)
    picture = depth_picture(frame, HILLS)
    history = History()
    assert history.add_depth(frame, picture, SURFACE) is None
    assert history.add_depth(frame, picture, SURFACE) is not None
    history.clear()
    assert history.add_depth(frame, picture, SURFACE) is None


def test_an_empty_picture_has_no_stability() -> None:
    history, frame = History(), frame_at(0.0)
    history.add_depth(frame, np.zeros((100, 160)), SURFACE)
    found = history.add_depth(frame, depth_picture(frame, HILLS), SURFACE)
    assert found is not None
    assert found.count == 0
    assert np.isnan(found.mean)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"depth: expected a picture of shape \(100, 160\), got \(160, 100\)"):
        History().add_depth(frame_at(0.0), np.zeros((160, 100)), SURFACE)
    with pytest.raises(SettingsError, match=r"surface: expected the grid's shape \(65, 65\), got \(64, 65\)"):
        History().add_depth(frame_at(0.0), np.zeros((100, 160)), TrueSurface(HILLS[1:]))


@pytest.mark.parametrize("changes", [{}, {"pitch": -90.0}, {"roll": 40.0}, {"orthographic": 900.0}])
@pytest.mark.parametrize("metres", [3.0, -20.0])
def test_a_place_is_found_where_it_is_drawn(changes: dict[str, float], metres: float) -> None:
    ty, tx = np.mgrid[:SIDE, :SIDE] * 1.0
    plane = 60 + 1.2 * tx - 0.7 * ty
    frame = frame_at(0.0, **changes)
    if changes:
        frame = replace(frame, camera=frame.camera.moved(y=4e6 - 1200))
    rng = np.random.default_rng(5)
    px, py = rng.uniform(1, SIDE - 1, (2, 1500))
    x, y = GRID.to_crs(px, py)
    height = 60 + 1.2 * (px - 0.5) - 0.7 * (py - 0.5)
    found = sight(frame, depth_picture(frame, plane), x, y, height - metres)
    seen = ~np.isnan(found.risen)
    # from the surface the drawn place is no way off
    exact = sight(frame, depth_picture(frame, plane), x, y, height)
    both = seen & ~np.isnan(exact.risen)
    assert both.sum() > 200
    assert np.abs(exact.risen[both]).max() < 1e-4
    off = np.hypot(found.column - exact.column, found.row - exact.row)[both]
    assert np.percentile(off, 99) < 1e-3
    # one step from the sky the depth between pixels is less certain
    assert off.max() < 0.1
    np.testing.assert_allclose(found.risen_by(np.full(1500, metres))[both], found.risen[both], atol=0.1)
    assert (np.sign(found.risen[both]) == np.sign(metres)).mean() > 0.99


def test_places_out_of_sight_are_not_found() -> None:
    wall = np.zeros((SIDE, SIDE))
    wall[45:47] = 400.0
    frame = frame_at(0.0, z=200.0, pitch=0.0)
    depth = depth_picture(frame, wall)
    x, y = GRID.to_crs([30.5, 30.5, 30.5], [20.5, 55.5, 200.0])
    behind, before, outside = sight(frame, depth, x, y, np.zeros(3)).risen
    assert np.isnan(behind)
    assert before == pytest.approx(0, abs=1e-3)
    assert np.isnan(outside)
    # in the picture, but more than REACH pixels above the ground
    high = sight(frame, depth, x[1:2], y[1:2], np.array([450.0]))
    assert high.pixels[0] * 450 > REACH
    assert np.isnan(high.risen).all()


def test_interpolation_is_exact_for_planes_and_nothing_outside() -> None:
    y, x = np.mgrid[:7, :9] * 1.0
    picture = 3 * x - 2 * y + 1
    column, row = np.array([0.0, 8.0, 2.25, 3.5]), np.array([0.0, 6.0, 5.75, 0.5])
    np.testing.assert_allclose(interpolate(picture, column, row), 3 * column - 2 * row + 1)
    assert np.isnan(interpolate(picture, np.array([-0.1, 8.1, np.nan]), np.array([1.0, 1.0, 1.0]))).all()
