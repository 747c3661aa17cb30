"""A window on a rendercanvas canvas: events to controls and panel, and frames only while something changes."""

from __future__ import annotations

import logging
import time
import warnings
from typing import TYPE_CHECKING, Any, Protocol

from orogen.camera import Camera
from orogen.errors import OutputError
from orogen.view.controls import Controls, Event, OrbitControls
from orogen.view.downloads import survive_lost_devices
from orogen.view.flying import FlyControls, WalkControls
from orogen.view.session import Session

if TYPE_CHECKING:
    import wgpu

log = logging.getLogger("orogen")

HELP = (
    "drag: pan, right drag: turn, wheel: zoom, double click: go there, Tab: around, fly, walk (W A S D Q E), N: north, "
    "Home: back, P: panel, M: map, F: freeze the level of detail"
)
EVENTS = (
    "resize", "pointer_down", "pointer_move", "pointer_up", "double_click", "wheel", "key_down", "key_up", "char",
    "pointer_leave", "close",
)  # fmt: skip
SHORTEST_REST = 0.1
"""Seconds, at least, between frames that only look whether what had failed is there."""
PROGRESS = 1.0
"""Seconds between frames that only show how far something is."""
FIRST_STEP = 1 / 60
"""Seconds of the step that follows a rest."""
CLICK = 4.0
"""Logical pixels that the pointer may move between press and release of a click."""
GRIP = 6.0
"""Logical pixels beside the divider where it can be taken."""
MODES: tuple[type[Controls], ...] = (OrbitControls, FlyControls, WalkControls)
"""What Tab goes through."""


class Panel(Protocol):
    """What is drawn over the picture, and takes events before the controls do."""

    @property
    def width(self) -> float:
        """Logical pixels of the window that it covers on the left."""

    @property
    def settling(self) -> bool:
        """Whether another frame has to be drawn without an event."""

    def handle(self, event: Event) -> bool:
        """Take an event; says whether it was meant for the panel alone."""

    def clicked(self, x: float, y: float) -> bool:
        """Take a click into the picture, at logical pixels; says whether it meant something."""

    def frame(self, now: float) -> Camera | None:
        """Let time pass (seconds of a clock) before a frame; gives the camera where the panel flies it."""

    def draw(self, target: wgpu.GPUTextureView, size: tuple[float, float], pixel_ratio: float) -> None:
        """Draw over a texture; `size`: width and height in logical pixels."""

    def renew(self, form: str) -> None:
        """Draw with the session's other device, to textures of a format."""

    def close(self) -> None:
        """Give everything back."""


class Window:
    """Shows a session and lets the user move through it; draws only when something changes.

    `canvas` is a rendercanvas canvas, of a notebook or a browser for one, to use in place of a new desktop window of
    `size` logical pixels. `panel`: whether there is one, where imgui-bundle is installed.
    Raises OutputError where no window can be opened.
    """

    def __init__(
        self,
        session: Session,
        *,
        size: tuple[int, int] = (1280, 720),
        title: str = "orogen",
        canvas: Any = None,
        panel: bool = True,
    ) -> None:
        self.canvas: Any = canvas
        self._loop: Any = None
        if canvas is None:
            self.canvas, self._loop = _open_canvas(size, title)
        survive_lost_devices()
        self._context = self.canvas.get_wgpu_context()
        self._with_panel = panel
        self._last_draw: float | None = None
        self._error: BaseException | None = None
        self._pressed: tuple[float, float] | None = None
        self._held = ""  # what a drag belongs to: "panel", "divider", "map" or "" for the view
        self._closed = False
        self._waking = False
        self.panel: Panel | None = None
        self._show(session)
        self.canvas.add_event_handler(self.handle, *EVENTS)
        self.canvas.request_draw(self.draw)

    def _show(self, session: Session) -> None:
        """Take a session in place of the one before."""
        self.session = session
        size, ratio = self.canvas.get_logical_size(), self.canvas.get_pixel_ratio()
        self.map_controls: OrbitControls | None = None
        self._use_device()
        self._begin(size)
        self.controls: Controls = OrbitControls(session.camera, session.ground, size, ratio)

    def _begin(self, size: tuple[float, float]) -> None:
        """Let the session choose where to begin in a window of so many logical pixels."""
        self.session.begin(size, self.panel.width / max(size[0], 1.0) if self.panel else 0.0)

    def _use_device(self) -> None:
        """Draw with the session's device."""
        form = self._context.get_preferred_format(self.session.device.adapter)
        self._context.configure(device=self.session.device, format=form)
        if self.panel:
            self.panel.renew(form)
        elif self._with_panel:
            from orogen.view.gui import available

            if available():
                from orogen.view.panel import ViewPanel

                self.panel = ViewPanel(self, form)

    def run(self) -> None:
        """Show the window until it is closed. An error while drawing closes it and is raised here."""
        log.info(HELP)
        if self._loop:
            self._loop.run()
        if self._error:
            raise self._error

    @property
    def moving(self) -> bool:
        """Whether the camera, or that of the map, moves on by itself or by what is held."""
        return self._last_draw is not None

    @property
    def error(self) -> BaseException | None:
        """What went wrong while drawing, after which there are no more pictures."""
        return self._error

    def close(self) -> None:
        """Give back what the window made, as it does when it is closed; once more does nothing."""
        if self._closed:
            return
        self._closed = True
        self.canvas.remove_event_handler(self.handle, *EVENTS)
        if self.panel:
            self.panel.close()
            self.panel = None
        self.session.close()
        self._context.unconfigure()
        self.canvas.close()

    # -- events --------------------------------------------------------------------------------------------------------

    def handle(self, event: Event) -> None:
        """Take an event of the canvas."""
        try:
            if self._take(event):
                self.canvas.request_draw()
        except Exception as error:
            if not self._revived():
                self._fail(error)

    def _take(self, event: Event) -> bool:
        """Hand an event to what it is meant for; says whether a picture has to be drawn."""
        kind = event["event_type"]
        if kind == "close":
            return False
        if kind == "resize":
            self._resize(event)
            return True
        if kind == "pointer_leave":
            return self.panel is not None
        mine = self.panel is not None and self.panel.handle(event)
        if kind == "pointer_down":
            self._pressed = event["x"], event["y"]
            self._held = "panel" if mine else self._part_at(event["x"])
        if mine or self._held == "panel":
            if kind == "pointer_up":
                self._held = ""
            return True
        # the panel shows what is under the pointer
        return self._take_outside(event, kind) or self.panel is not None

    def _take_outside(self, event: Event, kind: str) -> bool:
        if kind == "key_down" and self._take_key(event):
            return True
        if self._held == "divider":
            if kind == "pointer_move":
                width = max(self.canvas.get_logical_size()[0], 1.0)
                self.session.divider = min(max(event["x"] / width, 0.05), 0.95)
                self._resize_map()
            elif kind == "pointer_up":
                self._held = ""
            return True
        clicked = False
        if kind == "pointer_up" and self._pressed and self.panel:
            moved = max(abs(event["x"] - self._pressed[0]), abs(event["y"] - self._pressed[1]))
            if moved < CLICK and event["button"] == 1 and self._held != "map":
                clicked = self.panel.clicked(event["x"], event["y"])
        over_map = self._held == "map" or (kind in ("wheel", "double_click") and self._part_at(event["x"]) == "map")
        if kind == "pointer_up":
            self._held, self._pressed = "", None
        if over_map and self.map_controls:
            left = self.session.split_at(round(self.canvas.get_logical_size()[0]))
            return self.map_controls.handle({**event, "x": event["x"] - left}) or clicked
        return self.controls.handle(event) or clicked

    def _take_key(self, event: Event) -> bool:
        key = event["key"].lower()
        if key == "tab":
            self.change_controls()
        elif key == "f":
            self.session.freeze(None if self.session.scene.lod_camera else self.controls.camera)
        elif key == "m":
            self.toggle_map()
        else:
            return False
        return True

    def _part_at(self, x: float) -> str:
        """What lies at a column of logical pixels: the divider, the map, or "" for the view."""
        if self.session.second is None:
            return ""
        left = self.session.divider * self.canvas.get_logical_size()[0]
        if abs(x - left) <= GRIP:
            return "divider"
        return "map" if self.session.mode == "beside" and x > left else ""

    # -- what panel and keys do ----------------------------------------------------------------------------------------

    def change_controls(self, kind: type[Controls] | None = None) -> None:
        """Take other controls; None: the next kind."""
        old = self.controls
        if kind is None:
            kind = MODES[(MODES.index(type(old)) + 1) % len(MODES)]
        if old.camera.orthographic:
            kind = OrbitControls
        self.controls = kind(old.camera, old.ground, old.size, old.pixel_ratio)

    def toggle_map(self) -> None:
        """Show a map beside the view, or no longer."""
        if self.session.second and self.session.second.kind == "map":
            self.session.alone()
            self.map_controls = None
            return
        self.session.show_map()
        size, ratio = self.canvas.get_logical_size(), self.canvas.get_pixel_ratio()
        room = self._map_room(size)
        camera = self.session.map_camera(room[0] / room[1])
        self.map_controls = OrbitControls(camera, self.session.map_ground, room, ratio)

    def stand(self) -> None:
        """Let the controls know of another exaggeration."""
        self.controls.stand_on(self.session.ground)
        if self.map_controls:
            self.map_controls.stand_on(self.session.map_ground)

    def _map_room(self, size: tuple[float, float]) -> tuple[float, float]:
        return max(size[0] - self.session.split_at(round(size[0])), 1.0), max(size[1], 1.0)

    def _resize(self, event: Event) -> None:
        """Take another size; what shows all goes on doing so, until somebody moves."""
        unmoved = self.session.framed and self.controls.camera == self.session.camera
        self.controls.handle(event)
        self._begin(self.controls.size)
        if unmoved and not self.controls.moving:
            self.controls = type(self.controls)(
                self.session.camera, self.controls.ground, self.controls.size, self.controls.pixel_ratio
            )
        self._resize_map()

    def _resize_map(self) -> None:
        if self.map_controls:
            self.map_controls.size = self._map_room(self.canvas.get_logical_size())

    # -- frames --------------------------------------------------------------------------------------------------------

    def draw(self) -> None:
        """Draw a frame; the canvas calls it when one was asked for."""
        try:
            if self._draw():
                self.canvas.request_draw()
            elif self._loop and not self._waking and (rest := self._rest()) is not None:
                self._waking = True
                self._loop.call_later(rest, self._wake)
        except Exception as error:
            if not self._revived():
                self._fail(error)

    def _rest(self) -> float | None:
        """Seconds until a picture that is not asked for would show something else; None: never."""
        if self.session.retry_in is not None:
            return max(self.session.retry_in, SHORTEST_REST)
        return PROGRESS if self.panel and self.session.preparing else None

    def _wake(self) -> None:
        """Draw once more: what had failed may be there now, or work has gone on."""
        self._waking = False
        if not self._closed:
            self.canvas.request_draw()

    def _revived(self) -> bool:
        """Go on with another device where this one was lost; whether it was."""
        try:
            if not self.session.revive():
                return False
            self._context.unconfigure()
            self._use_device()
        except Exception as error:
            self._fail(error)
        self.canvas.request_draw()
        return True

    def _draw(self) -> bool:
        """Draw a frame; says whether another one has to follow."""
        self.session.poll()
        if self.session.opened:
            self._swap(self.session.opened)
        now = time.perf_counter()
        dt = FIRST_STEP if self._last_draw is None else now - self._last_draw
        if self.map_controls and not (self.session.second and self.session.second.kind == "map"):
            self.map_controls = None
        flown = self.panel.frame(now) if self.panel else None
        camera = flown or self.controls.advance(dt)
        if flown:
            self.controls.camera = flown
        beside = self.map_controls.advance(dt) if self.map_controls else None
        moving = flown is not None or self.controls.moving
        map_moving = self.map_controls is not None and self.map_controls.moving
        if self._loop:
            # wgpu ends the process where a screen's texture is asked of a lost device
            self.session.renderer.gpu.check()
        texture = self._context.get_current_texture()
        size = texture.size[0], texture.size[1]
        target = texture.create_view()
        unfinished = self.session.draw(target, camera, size, moving, beside)
        if self.panel:
            self.panel.draw(target, self.canvas.get_logical_size(), self.canvas.get_pixel_ratio())
        self._last_draw = now if moving or map_moving else None
        # asked last: the panel may have changed something
        return unfinished or map_moving or self.controls.moving or bool(self.panel and self.panel.settling)

    def _swap(self, following: Session) -> None:
        """Show other data in this window."""
        if self.panel:
            self.panel.close()
            self.panel = None
        before = self.session
        before.opened = None
        self._context.unconfigure()  # a texture of the other device is not to be drawn to
        self._show(following)
        before.close()

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
