"""Moving pictures of fewer triangles: the algorithms' side, the session's, and what decides."""

import numpy as np
import pytest

import orogen
from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.lod import algorithms
from orogen.view.quality import DETAILS, Quality, QualitySettings, geometry_share, least_detail
from orogen.view.renderer import Scene
from orogen.view.session import Session

SIZE = (160, 90)
COARSE = 4.0
PREPARED = ("bdam", "roam", "rustic")
"""Algorithms that compile or prepare data for long."""
WITH_DETAIL = [
    pytest.param(name, marks=pytest.mark.nightly if name in PREPARED else ())
    for name, kind in algorithms().items()
    if kind.detail
]


@pytest.fixture(scope="module")
def rough():
    """Ground that is rough at all scales: each halving of the edges shows."""
    rng = np.random.default_rng(3)
    heights = np.zeros((257, 257), np.float32)
    for octave in range(1, 7):
        coarse = rng.normal(size=(2**octave + 1,) * 2) * 400 / 2**octave
        at = np.linspace(0, 2**octave, 257)
        rows = np.array([np.interp(at, np.arange(2**octave + 1), row) for row in coarse])
        heights += np.array([np.interp(at, np.arange(2**octave + 1), column) for column in rows.T]).T.astype(np.float32)
    with orogen.open(heights, spacing=10.0) as opened:
        yield opened


def triangles(terrain, scene):
    return terrain.render(terrain.camera(distance=1500.0), SIZE, scene=scene).statistics.triangles


@pytest.mark.parametrize("name", WITH_DETAIL)
def test_a_coarse_frame_has_the_triangles_that_the_setting_would_give(rough, name):
    kind = algorithms()[name]
    setting = kind.detail.setting
    # where there is room on both sides: the data bounds the finest, patches the coarsest
    start = kind.detail.finest
    rough.use(name, **{setting: start})
    fine, coarse = triangles(rough, Scene()), triangles(rough, Scene(coarseness=COARSE))
    rough.use(name, **{setting: start * COARSE if kind.detail.coarsest > start else start / COARSE})
    assert coarse == pytest.approx(triangles(rough, Scene()), rel=0.02)
    # the finest of hybrid's are rays
    assert coarse < fine or name == "hybrid"


def test_algorithms_say_how_coarse_they_can_get(rough):
    rough.use("raycast")
    assert least_detail(rough.renderer.algorithm) == 1.0
    rough.use("cdlod", pixels_per_quad=64.0)
    assert least_detail(rough.renderer.algorithm) == 64 / 256
    rough.use("cdlod", pixels_per_quad=1000.0)
    assert least_detail(rough.renderer.algorithm) == 1.0


def test_a_moving_picture_has_fewer_triangles_and_one_at_rest_all(rough):
    rough.use("cdlod", pixels_per_quad=1.0)
    session, gpu = Session(rough), rough.renderer.gpu
    target = gpu.texture("target", SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC", "view")
    camera = session.camera

    def drawn(moving):
        while session.draw(target.view(), camera, SIZE, moving=moving) and not moving:
            pass
        return session.renderer.statistics().triangles

    full = drawn(False)
    session.quality._detail = DETAILS.index(0.25)
    assert drawn(True) < full / 3
    assert session.history.latest.detail == 0.25
    assert drawn(False) == full
    assert session.history.latest.detail == 1.0
    session.close()
    target.destroy()


def fly(quality, pixels, geometry, frames=400, screen=16.7, least=0.125):
    """Frames of so many milliseconds for pixels and for triangles at full size and detail; the second half's times."""
    times = []
    for _ in range(frames):
        drawn, made = pixels * quality.scale**2, geometry * (quality.scale * max(quality.detail, least)) ** 2
        work = 1 + (drawn + made) * quality.samples
        times.append(max(work, screen))
        quality.took(times[-1], work, geometry_share({"shade": drawn, "raster": made}, drawn + made), least)
    return times[frames // 2 :]


@pytest.mark.parametrize(("pixels", "geometry"), [(5.0, 5.0), (100.0, 2.0), (2.0, 100.0), (80.0, 80.0), (10.0, 400.0)])
def test_the_frame_time_is_kept_by_what_takes_it(pixels, geometry):
    quality = Quality(QualitySettings(frame_time=33.0))
    assert max(fly(quality, pixels, geometry)) <= 1.1 * 33.0
    if pixels != geometry:
        assert (quality.scale < 1) == (pixels > 30)
        assert (quality.detail < 1) == (geometry > 30)
    # what is left makes the picture smoother, no more
    assert max(fly(quality, 1.0, 1.0)) <= 1.1 * 33.0
    assert (quality.scale, quality.detail, quality.samples) == (1.0, 1.0, 8)
    fly(quality, 3.0, 3.0)
    assert (quality.scale, quality.detail, quality.samples) == (1.0, 1.0, 4)


def test_the_bounds_are_kept():
    quality = Quality(QualitySettings(coarsest=0.5, coarsest_detail=0.35))
    fly(quality, 4000.0, 4000.0)
    assert (quality.scale, quality.detail) == (0.5, 0.35)
    # an algorithm that has no setting for it: the picture alone
    quality = Quality()
    fly(quality, 1.0, 100.0, least=1.0)
    assert quality.detail == 1.0
    assert quality.scale < 1
    with pytest.raises(SettingsError, match="coarsest_detail"):
        QualitySettings(coarsest_detail=0.1)
    with pytest.raises(SettingsError, match=r"coarseness: expected 1 or more, got 0\.5"):
        Scene(coarseness=0.5)
    with pytest.raises(SettingsError, match="coarseness: expected a number above 0, got 0"):
        Frame(Camera(0.0, 0.0, 1.0), None, SIZE, coarseness=0.0)


def test_the_share_of_geometry():
    assert geometry_share({}, 5.0) == 0.5
    assert geometry_share({"shade": 3.0, "refine": 1.0}, 4.0) == 0.25
    assert geometry_share({"rays": 9.0}, 4.0) == 0.0
