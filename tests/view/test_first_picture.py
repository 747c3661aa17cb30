"""What a window shows at first."""

import numpy as np
import pytest

import orogen
from orogen.view.renderer import FIRST_WAIT
from orogen.view.session import Session

SIZE = (160, 90)


@pytest.fixture
def begun():
    """A session on data that nothing is resident of, and a way to draw a frame of it: what is in its middle."""
    with orogen.open(np.full((300, 300), 500.0, np.float32), spacing=30.0) as terrain:
        session, gpu = Session(terrain), terrain.renderer.gpu
        target = gpu.texture("target", SIZE, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC", "view")

        def draw():
            more = session.draw(target.view(), session.camera, SIZE)
            return session.pick(SIZE[0] // 2, SIZE[1] // 2), more

        yield session, draw
        target.destroy()
        session.close()


def test_a_window_begins_with_ground(begun):
    session, draw = begun
    session.renderer._patience = 60.0  # however busy the machine is
    ground, _ = draw()
    assert ground is not None
    assert ground[2] == pytest.approx(500.0, abs=1.0)


def test_ground_that_does_not_come_is_waited_for_once(begun, monkeypatch):
    session, draw = begun
    heights, waits = session.renderer.clipmap.heights, []
    with monkeypatch.context() as patch:
        patch.setattr(heights, "wait", waits.append)
        patch.setattr(heights, "pump", lambda budget: 0)
        assert draw() == (None, True)
        assert waits
        assert max(waits) <= FIRST_WAIT
        before = len(waits)
        assert draw() == (None, True)
        assert len(waits) == before
    while True:
        ground, more = draw()
        if not more:
            break
    assert ground[2] == pytest.approx(500.0, abs=1.0)
