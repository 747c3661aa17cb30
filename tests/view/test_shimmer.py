"""How much pictures flicker while the camera moves slowly, against 64 samples a pixel from the same places."""

import itertools
import math

import numpy as np
import pytest

import orogen
from orogen.lod import DEFAULT
from orogen.view.quality import SAMPLES
from orogen.view.renderer import STILL_SAMPLES, jitters, ordered_jitters
from orogen.view.session import Session

SIZE = (120, 68)
STEPS = 6
PART = 0.2
"""Part of a pixel that the middle of the picture moves by from frame to frame."""
BOUNDS = {
    "ridges": {1: (1.3, 27.0), 2: (1.0, 21.0), 4: (0.8, 16.0), 8: (0.5, 9.0)},
    "valley": {1: (2.3, 34.0), 2: (1.6, 23.0), 4: (1.0, 13.0), 8: (0.75, 9.0)},
}
"""Of 255 steps of colour, by samples: how far the deviation from the reference swings in time (its standard deviation),
on average and for all but a hundredth of the pixels."""
REST = 0.6, 6.0
"""The same for pictures at rest."""


@pytest.fixture(scope="module")
def ridges():
    """Ground with ridges far thinner than a pixel, and a camera that sees all of it."""
    rng = np.random.default_rng(3)
    heights = np.zeros((257, 257), np.float32)
    for octave in range(1, 8):
        coarse, at = rng.normal(size=(2**octave + 1,) * 2) * 400 / 2**octave, np.linspace(0, 2**octave, 257)
        rows = np.array([np.interp(at, np.arange(2**octave + 1), row) for row in coarse])
        heights += np.array([np.interp(at, np.arange(2**octave + 1), column) for column in rows.T]).T.astype(np.float32)
    with orogen.open(heights, spacing=10.0) as opened:
        yield opened, opened.camera(), 25.0


@pytest.fixture(scope="module")
def valley(data_dir):
    """Real mountains, low over a valley: ridge behind ridge, with shadows."""
    with orogen.open(data_dir / "bigtujunga_30m_utm.tif") as opened:
        x, y = (float(v) for v in opened.grid.to_crs(opened.grid.width / 2, opened.grid.height / 2))
        camera = opened.camera(look_at=(x, y), distance=15000.0, heading=0.0, pitch=-6.0)
        yield opened, camera, 2 * 15000 * math.tan(math.radians(camera.fov) / 2) / SIZE[1]


@pytest.mark.parametrize(("ground", "algorithm"), [("ridges", "cdlod"), ("valley", DEFAULT)])
def test_slow_motion_does_not_shimmer(request, ground, algorithm):
    terrain, start, metres = request.getfixturevalue(ground)
    terrain.use(algorithm)
    cameras = [start.moved(x=start.x + PART * metres * step) for step in range(STEPS)]
    reference = np.stack([terrain.render(camera, SIZE, samples=64).color[..., :3] for camera in cameras]).astype(float)
    session, gpu = Session(terrain), terrain.renderer.gpu
    target = gpu.texture("target", SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC", "view")

    def swing(moving, smooth=0):
        frames = []
        for camera in cameras:
            session.quality._smooth, session.quality._step, session.quality._detail = smooth, 0, 0
            while session.draw(target.view(), camera, SIZE, moving=moving) and not moving:
                pass
            assert session.history.latest.samples == (SAMPLES[smooth] if moving else 1)
            frames.append(gpu.read_texture(target).result()[..., :3].astype(float))
        off = (np.stack(frames) - reference).std(axis=0).max(axis=-1)
        return float(off.mean()), float(np.percentile(off, 99))

    swings = {samples: swing(True, smooth) for smooth, samples in enumerate(SAMPLES)}
    rest = swing(False) if ground == "valley" else (0.0, 0.0)
    target.destroy()
    session.close()
    for samples, bounds in BOUNDS[ground].items():
        assert np.all(np.array(swings[samples]) < bounds), samples
    assert np.all(np.array(rest) < REST)
    # what a machine has to spare goes into calm pictures, and every step towards them is worth its time
    assert swings[8][0] < 0.5 * swings[1][0]
    for some, more in itertools.pairwise(SAMPLES):
        assert swings[more][0] < 0.85 * swings[some][0], more


@pytest.mark.parametrize("together", SAMPLES)
def test_samples_of_moving_pictures_are_balanced_and_all_of_a_still_one(together):
    offsets = ordered_jitters(together)
    assert sorted(offsets) == sorted(jitters(STILL_SAMPLES))
    assert np.abs(np.mean(offsets[:together], axis=0)).max() < 0.1
