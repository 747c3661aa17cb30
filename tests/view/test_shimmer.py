"""How much pictures flicker while the camera moves slowly, against 64 samples a pixel from the same places."""

import numpy as np
import pytest

import orogen
from orogen.view.session import Session

SIZE = (120, 68)
STEPS = 8
STEP = 5.0
"""Metres that the camera moves from frame to frame: about a fifth of a pixel."""
BOUNDS = {1: (1.6, 34.0), 8: (0.6, 11.0)}
"""Of 255 steps of colour, by samples: how far the deviation from the reference swings in time (its standard deviation),
on average and for all but a hundredth of the pixels."""


@pytest.fixture(scope="module")
def rough():
    """Ground with ridges far thinner than a pixel."""
    rng = np.random.default_rng(3)
    heights = np.zeros((257, 257), np.float32)
    for octave in range(1, 8):
        coarse, at = rng.normal(size=(2**octave + 1,) * 2) * 400 / 2**octave, np.linspace(0, 2**octave, 257)
        rows = np.array([np.interp(at, np.arange(2**octave + 1), row) for row in coarse])
        heights += np.array([np.interp(at, np.arange(2**octave + 1), column) for column in rows.T]).T.astype(np.float32)
    with orogen.open(heights, spacing=10.0) as opened:
        yield opened


@pytest.mark.parametrize("algorithm", ["raycast", "cdlod"])
def test_slow_motion_does_not_shimmer(rough, algorithm):
    rough.use(algorithm)
    start = rough.camera()
    cameras = [start.moved(x=start.x + STEP * step) for step in range(STEPS)]
    reference = np.stack([rough.render(camera, SIZE, samples=64).color[..., :3] for camera in cameras]).astype(float)
    session, gpu = Session(rough), rough.renderer.gpu
    target = gpu.texture("target", SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC", "view")
    swings = {}
    for smooth, samples in ((0, 1), (3, 8)):
        frames = []
        for camera in cameras:
            session.quality._smooth, session.quality._step, session.quality._detail = smooth, 0, 0
            session.draw(target.view(), camera, SIZE, moving=True)
            assert session.history.latest.samples == samples
            frames.append(gpu.read_texture(target).result()[..., :3].astype(float))
        swing = (np.stack(frames) - reference).std(axis=0).max(axis=-1)
        swings[samples] = swing.mean(), np.percentile(swing, 99)
    target.destroy()
    session.close()
    for samples, bounds in BOUNDS.items():
        assert swings[samples] < bounds, samples
        assert swings[samples][1] < bounds[1], samples
    # what a machine has to spare goes into calm pictures
    assert swings[8][0] < 0.5 * swings[1][0]
