"""Sun ceilings spare shadow rays their way, and change no picture."""

import numpy as np
import pytest

import orogen
from orogen.shading.style import Style
from orogen.streaming import blocks
from orogen.streaming.ceilings import Ceilings
from orogen.view.renderer import Scene

SIZE = (160, 100)
SUNS = [(315.0, 35.0), (40.0, 12.0), (200.0, 3.0), (90.0, 60.0), (0.0, 0.0)]


def mountains(side):
    """Heights (m) with relief at all scales, for samples 30 m apart."""
    waves = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)[None, :])
    waves[0, 0] = 1
    heights = np.fft.ifft2(np.fft.fft2(np.random.default_rng(3).normal(size=(side, side))) / waves**1.8).real
    return (4000 * (heights - heights.min()) / np.ptp(heights)).astype(np.float32)


@pytest.fixture(scope="module", params=["whole", "voids"])
def terrain(request):
    heights = mountains(700)
    if request.param == "voids":
        heights[300:330, 200:420] = np.nan
        heights[:90, :60] = np.nan
    # several levels in a picture
    with orogen.open(heights, spacing=30.0, build="wait", settings={"view_distance": 0.6}) as opened:
        opened.use("raycast")
        yield opened


def in_use(terrain):
    return terrain.renderer.view._sun_block != blocks.NO_SUN_BLOCK


def shown(terrain, camera, style, scene=None, frames=6):
    """The last of some pictures of the same: the first ones find no ceilings of their sun."""
    for _ in range(frames):
        color = terrain.render(camera, SIZE, style, scene, samples=1).color
    return color


def compared(terrain, monkeypatch, cases):
    """Pixels that differ, per case, with ceilings and without: each case is a camera, a style and a scene."""
    with_them = []
    for case in cases:
        with_them.append(shown(terrain, *case))
        assert in_use(terrain)
    monkeypatch.setattr(Ceilings, "block", lambda *_: blocks.NO_SUN_BLOCK)
    without = [shown(terrain, *case, frames=1) for case in cases]
    assert not in_use(terrain)
    # the shadows that are compared are there
    lit = shown(terrain, cases[0][0], Style(sun=cases[0][1].sun, shadows=False))
    assert (lit != without[0]).any(axis=-1).mean() > 0.01
    return [int((a != b).any(axis=-1).sum()) for a, b in zip(with_them, without, strict=True)]


def test_pictures_under_any_sun_are_those_without_ceilings(terrain, monkeypatch):
    cameras = [terrain.camera(), terrain.camera(distance=4000, pitch=-15, heading=130)]
    cases = [(camera, Style(sun=sun), None) for sun in SUNS for camera in cameras]
    # stray pixels where light grazes a crack between levels
    assert sum(compared(terrain, monkeypatch, cases)) <= 2


def test_pictures_of_tall_and_of_bent_ground_are_those_without_ceilings(terrain, monkeypatch):
    camera = terrain.camera(distance=5000, pitch=-20)
    scenes = [Scene(exaggeration=3.0), Scene(exaggeration=0.5), Scene(curvature=True)]
    cases = [(camera, Style(sun=(300.0, 20.0)), scene) for scene in scenes]
    assert sum(compared(terrain, monkeypatch, cases)) <= 2


def test_a_moving_camera_and_a_moving_sun_see_what_a_fresh_terrain_shows(terrain, monkeypatch):
    start = terrain.camera(distance=3000, pitch=-20)
    places = [start.moved(x=start.x + 500 * k, y=start.y + 200 * k) for k in range(12)]
    flight = [(camera, (315.0 + 5 * (k // 6), 30.0)) for k, camera in enumerate(places)]
    pictures, used = [], []
    for camera, sun in flight:
        pictures.append(shown(terrain, camera, Style(sun=sun), frames=1))
        used.append(in_use(terrain))
    # a sun that has just moved has none
    assert used == [False, False, False, True, True, True] * 2
    monkeypatch.setattr(Ceilings, "block", lambda *_: blocks.NO_SUN_BLOCK)
    fresh = [shown(terrain, camera, Style(sun=sun), frames=1) for camera, sun in flight]
    assert sum((a != b).any(axis=-1).sum() for a, b in zip(pictures, fresh, strict=True)) <= 2


def test_a_sun_overhead_and_one_that_casts_no_shadows_need_no_ceilings(terrain):
    shown(terrain, terrain.camera(), Style(sun=(0.0, 90.0)))
    assert not in_use(terrain)
    shown(terrain, terrain.camera(), Style(shadows=False))
    assert not in_use(terrain)
