"""A window whose device is lost goes on with another one."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest
from rendercanvas.offscreen import RenderCanvas

from faults.scene import Place, walk
from orogen.view.session import Session
from orogen.view.window import Window


class Canvas(RenderCanvas):
    """Counts the pictures that are asked for."""

    asked = 0

    def request_draw(self, *arguments: Any) -> None:
        self.asked += 1
        super().request_draw(*arguments)


def settled(window: Window) -> np.ndarray:
    """The picture once no further one is asked for."""
    for _ in range(400):
        before = window.canvas.asked
        picture = np.array(window.canvas.draw())
        if window.canvas.asked == before:
            return picture
    raise AssertionError("the picture does not come to rest")


def test_the_window_goes_on(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    with place.terrain(algorithm="udlod") as terrain:
        canvas = Canvas(size=(96, 64), pixel_ratio=1)
        window = Window(Session(terrain, camera=walk()[1]), canvas=canvas, panel=False)
        before = settled(window)
        camera, device = window.controls.camera, terrain.device
        device.destroy()
        after = settled(window)
        assert terrain.device is not device
        assert window._error is None
        assert window.controls.camera == camera
        assert window.session.renderer.algorithm.name == "udlod"
        assert before.std() > 5
        assert np.abs(after.astype(int) - before).max() <= 1
