"""Pictures in parts are the pictures that they would be in one."""

import numpy as np
import pytest

import orogen
from orogen.errors import SettingsError
from orogen.lod import algorithms
from orogen.view import renderer
from orogen.view.parts import divisions

ALGORITHMS = ("raycast", "udlod", "cdlod", "geomipmap")
OTHERS = tuple(name for name in algorithms() if name not in ALGORITHMS)
SIZE = (156, 90)
MOST_OFF = {"hybrid": 0.1}
"""Part of the pixels that may differ, by algorithm: it chooses rays or triangles by the pixels of what is drawn."""


@pytest.fixture(scope="module")
def rough():
    """Hills with rough ground, 400 x 300 samples 10 m apart, some of them missing."""
    y, x = np.mgrid[0:300, 0:400] / 16.0
    heights = 300 + 120 * np.sin(x) * np.cos(0.7 * y) + np.random.default_rng(3).normal(0, 3, x.shape)
    heights[100:120, 200:230] = np.nan
    with orogen.open(heights.astype(np.float32), spacing=10.0) as opened:
        yield opened


def compare(terrain, camera, count, monkeypatch, size=SIZE, **options):
    """Parts of the pixels whose colour differs and that are sky in one only, and distances of the others (m)."""
    with monkeypatch.context() as patch:
        patch.setattr(renderer, "divisions", lambda *_: count)
        divided = terrain.render(camera, size, samples=2, **options)
    whole = terrain.render(camera, size, samples=2, **options)
    assert divided.frame == whole.frame
    assert divided.color.shape == whole.color.shape
    assert whole.color[..., :3].std() > 15
    off = np.abs(divided.color.astype(int) - whole.color).max(axis=-1) > 3
    ground, also = np.isfinite(whole.depth), np.isfinite(divided.depth)
    return (
        off.mean(),
        (ground != also).mean(),
        np.linalg.norm(whole.position - divided.position, axis=-1)[ground & also],
    )


@pytest.mark.parametrize("name", [*ALGORITHMS, *(pytest.param(name, marks=pytest.mark.nightly) for name in OTHERS)])
def test_a_picture_in_parts_is_the_whole_one(rough, name, monkeypatch):
    rough.use(name)
    for camera in (rough.camera(heading=300.0), rough.camera(orthographic=True, pitch=-60.0)):
        off, lost, apart = compare(rough, camera, 2, monkeypatch)
        # a ray's last bit may hit the other side of an edge
        assert off < MOST_OFF.get(name, 0.004)
        assert lost < 0.003
        assert name in MOST_OFF or np.quantile(apart, 0.99) < 0.5


@pytest.mark.parametrize("count", [3, 5])
def test_parts_may_reach_beyond_the_picture(rough, count, monkeypatch):
    rough.use("raycast")
    style, scene = orogen.Style(overlays=("contours",)), orogen.Scene(exaggeration=2.0, curvature=True)
    camera = rough.camera(heading=100.0, exaggeration=2.0, fov=70.0)
    off, lost, apart = compare(rough, camera, count, monkeypatch, (157, 91), style=style, scene=scene)
    assert off < 0.004
    assert lost < 0.001
    assert np.quantile(apart, 0.99) < 0.01


def test_a_frozen_level_of_detail_stays_so_in_parts(rough, monkeypatch):
    rough.use("cdlod", pixels_per_quad=16.0)
    frozen = rough.camera(look_at=(1000.0, 1000.0), distance=900.0)
    off, _, apart = compare(rough, rough.camera(), 2, monkeypatch, scene=orogen.Scene(lod_camera=frozen))
    assert off < 0.004
    assert np.quantile(apart, 0.99) < 0.5


def test_a_picture_wider_than_the_gpu_can_hold(rough):
    rough.use("raycast")
    most = rough.renderer.gpu.limits["max-texture-dimension-2d"]
    size = (most + 3, 5)
    camera = rough.camera(aspect=size[0] / size[1], fov=1.0)
    assert divisions(size, rough.renderer.gpu) == 2
    picture = rough.render(camera, size, samples=1)
    assert picture.color.shape == (5, most + 3, 4)
    # in the middle of it is what a picture of the middle shows
    left = (most + 3) // 2 - 50
    middle = rough.render(camera, (101 if (most + 3) % 2 else 100, 5), samples=1)
    shown = picture.color[:, left : left + middle.color.shape[1]].astype(int)
    assert (np.abs(shown - middle.color).max(axis=-1) > 3).mean() < 0.01
    assert rough.pick(0, 0) is None  # what a part showed is not the picture


def test_little_memory_makes_parts_and_a_size_beyond_reason_is_refused_at_once(rough, monkeypatch):
    heights = np.zeros((64, 64), np.float32)
    with orogen.open(heights, spacing=10.0, gpu_memory=96 << 20) as terrain:
        gpu = terrain.renderer.gpu
        assert divisions((320, 200), gpu) == 1
        size = (2400, 1200)
        assert divisions(size, gpu) > 1
        picture = terrain.render(size=size, samples=2)
        assert gpu.memory.peak <= 96 << 20
        assert np.isfinite(picture.depth[600, 1200])
    for size in ((70000, 10), (60000, 60000)):
        monkeypatch.setattr(type(rough._recovery), "draw", None)  # nothing is begun
        with pytest.raises(SettingsError, match=rf"size: expected at most 65535 .*, got {size[0]}x{size[1]}"):
            rough.render(size=size)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("exaggeration", 0), ("exaggeration", -1.0), ("exaggeration", float("nan")), ("exaggeration", float("inf")),
        ("exaggeration", "2"), ("exaggeration", None), ("coarseness", 0.5), ("coarseness", float("inf")),
        ("curvature", "yes"), ("curvature", 1), ("lod_camera", (0, 0, 0)),
    ],
)  # fmt: skip
def test_a_scene_that_cannot_be_is_refused_by_the_name_of_its_field(field, value):
    with pytest.raises(SettingsError, match=f"^{field}: expected .*, got "):
        orogen.Scene(**{field: value})
