"""A desktop window: canvas, controls and renderer brought together."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from orogen.camera import Camera
from orogen.errors import OutputError
from orogen.view.controls import Controls, Event, FlyControls, Ground, OrbitControls

if TYPE_CHECKING:
    import wgpu

log = logging.getLogger("orogen")

HELP = "drag: pan, right drag: turn, wheel: zoom, double click: go there, Tab: fly (W A S D Q E), N: north, Home: back"
EVENTS = (
    "resize", "pointer_down", "pointer_move", "pointer_up", "double_click", "wheel", "key_down", "key_up"
)  # fmt: skip
FIRST_STEP = 1 / 60
"""Seconds of the step that follows a rest."""


Draw = Callable[["wgpu.GPUTextureView", Camera, tuple[int, int]], bool]
"""Draws a frame into a texture by a render pass, without waiting for data; the size is (width, height) in physical
pixels. Says whether a further call would improve the picture: data streams in, or more samples would smooth it."""


class Window:
    """Shows terrain and lets the user move through it; draws only when something changes.

    `device` is the one that `draw` draws with, `size` is in logical pixels. `canvas` is a rendercanvas canvas to use in
    place of a new desktop window.
    Raises OutputError where no window can be opened.
    """

    def __init__(
        self,
        device: wgpu.GPUDevice,
        draw: Draw,
        camera: Camera,
        ground: Ground,
        *,
        size: tuple[int, int] = (1280, 720),
        title: str = "orogen",
        canvas: Any = None,
    ) -> None:
        self._draw = draw
        self.canvas: Any = canvas
        self._loop: Any = None
        if canvas is None:
            self.canvas, self._loop = _open_canvas(size, title)
        self.controls: Controls = OrbitControls(
            camera, ground, self.canvas.get_logical_size(), self.canvas.get_pixel_ratio()
        )
        self._context = self.canvas.get_wgpu_context()
        self._context.configure(device=device, format=self._context.get_preferred_format(device.adapter))
        self._last_draw: float | None = None
        self._error: BaseException | None = None
        self.canvas.add_event_handler(self.handle, *EVENTS)
        self.canvas.request_draw(self.draw)

    def run(self) -> None:
        """Show the window until it is closed. An error while drawing closes it and is raised here."""
        log.info(HELP)
        if self._loop:
            self._loop.run()
        if self._error:
            raise self._error

    def handle(self, event: Event) -> None:
        """Take an event of the canvas."""
        try:
            if event["event_type"] == "key_down" and event["key"] == "Tab":
                self._change_controls()
            elif not self.controls.handle(event):
                return
            self.canvas.request_draw()
        except Exception as error:
            self._fail(error)

    def draw(self) -> None:
        """Draw a frame; the canvas calls it when one was asked for."""
        try:
            now = time.perf_counter()
            camera = self.controls.advance(FIRST_STEP if self._last_draw is None else now - self._last_draw)
            texture = self._context.get_current_texture()
            size = texture.size[0], texture.size[1]
            unfinished = self._draw(texture.create_view(), camera, size)
            if unfinished or self.controls.moving:
                self.canvas.request_draw()
            self._last_draw = now if self.controls.moving else None
        except Exception as error:
            self._fail(error)

    def _change_controls(self) -> None:
        old = self.controls
        kind = FlyControls if isinstance(old, OrbitControls) and not old.camera.orthographic else OrbitControls
        self.controls = kind(old.camera, old.ground, old.size, old.pixel_ratio)

    def _fail(self, error: Exception) -> None:
        """Keep the error for `run`: the canvas would only log it, and go on."""
        self._error = self._error or error
        if self._loop:
            self._loop.call_soon(self.canvas.close)


def _open_canvas(size: tuple[int, int], title: str) -> tuple[Any, Any]:
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", glfw.GLFWError)
        # asked first: rendercanvas does not, and the process would abort
        if not glfw.init():
            message = glfw.get_error()[1] or "no display"
            reason = message if isinstance(message, str) else message.decode()
            raise OutputError(f"no window can be opened here ({reason}); use orogen render or orogen fly instead")
    from rendercanvas.glfw import RenderCanvas, loop

    # 60 rather than the default of 30 frames a second: what is idle costs nothing either way
    return RenderCanvas(size=size, title=title, max_fps=60), loop
