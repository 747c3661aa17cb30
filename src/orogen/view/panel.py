"""The panel over the picture, and what is drawn on the picture itself."""

from __future__ import annotations

import math
import os
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from orogen.camera import Camera
from orogen.errors import OrogenError
from orogen.view import overlay
from orogen.view.bookmarks import Bookmarks
from orogen.view.controls import Event
from orogen.view.gui import Gui
from orogen.view.keyframes import Keyframes
from orogen.view.measure import GAP, Place, Profile, place_text
from orogen.view.player import Exporter, Player, VideoSettings
from orogen.view.sections import draw_sections
from orogen.view.tools import draw_profile
from orogen.view.widgets import Widgets

if TYPE_CHECKING:
    import wgpu

    from orogen.view.window import Window

WIDTH = 330.0
"""Logical pixels of the panel."""
MARGIN = 12.0
"""Logical pixels between the panel and the window's edge."""
NARROW = 560.0
"""Logical pixels of a window's width below which the panel is a button at the start: it would hide the picture."""


class ViewPanel:
    """The panel of a window: fields and graphs on the left, scale, north and places on the picture."""

    def __init__(self, window: Window, form: str) -> None:
        """`form`: format of the textures that are drawn to."""
        from imgui_bundle import imgui

        self.window = window
        self.imgui = imgui
        self.widgets = Widgets()
        self.visible = True
        """Whether the fields are shown; P changes that."""
        self._unfolded = False
        self.measuring = False
        """Whether clicks into the picture measure."""
        self.points: list[tuple[float, float, float]] = []
        """x, y in the data's CRS and height (m) of the points that are measured."""
        self.profile: Profile | None = None
        """Heights along the measured points."""
        self.marked: tuple[float, float] | None = None
        """x, y of the place that the pointer shows in the profile's plot."""
        self.keyframes = Keyframes()
        name = window.session.data.name
        # one file has the same bookmarks, wherever it is opened from
        self.bookmarks = Bookmarks(os.path.abspath(name) if os.path.exists(name) else name, kept=window.session.files)
        self.player: Player | None = None
        self.exporter: Exporter | None = None
        self.video = VideoSettings()
        """What videos of flights are like."""
        self.picture_size: tuple[int, int] | None = None
        """Width and height in pixels of pictures that are written; None: those of the window."""
        self.message = ""
        """What was done last."""
        self._pointer: tuple[float, float] | None = None
        self._place: Place | None = None
        self._place_of: Any = None
        self._scale: tuple[Any, float] = (None, math.nan)
        self._gui = Gui(window.session.device, form, self._build, self.widgets.letters)

    @property
    def width(self) -> float:
        """Logical pixels of the window that it covers on the left."""
        return MARGIN + WIDTH if self.visible and not self.folded else 0.0

    @property
    def folded(self) -> bool:
        """Whether there is only a button that opens it, in a narrow window."""
        return self.visible and not self._unfolded and self.window.canvas.get_logical_size()[0] < NARROW

    @property
    def settling(self) -> bool:
        """Whether another frame has to be drawn without an event."""
        busy = self.player or self.exporter or self.keyframes.recording
        return self._gui.settling or bool(busy)

    # -- events --------------------------------------------------------------------------------------------------------

    def handle(self, event: Event) -> bool:
        """Take an event; says whether it was meant for the panel alone."""
        kind = event["event_type"]
        if "x" in event:
            self._pointer = event["x"], event["y"]
        if self._gui.handle(event):
            return True
        if kind == "key_down":
            return self._key(event["key"])
        if kind == "pointer_down" or (kind == "wheel" and self.player):
            self.player = None
        return kind == "char"

    def clicked(self, x: float, y: float) -> bool:
        """Measure the point under a click."""
        if not self.measuring:
            return False
        ratio = self.window.canvas.get_pixel_ratio()
        found = self.window.session.pick(math.floor(x * ratio), math.floor(y * ratio))
        if found is None:
            self.message = "There is only sky."
            return True
        self.message = ""
        self.points.append(found)
        self.measure()
        return True

    def measure(self) -> None:
        """Work out the profile along the points."""
        self.profile = None
        if len(self.points) > 1:
            try:
                self.profile = self.window.session.ruler.profile([(x, y) for x, y, _ in self.points])
            except OrogenError as error:
                self.message = str(error)

    def _key(self, key: str) -> bool:
        if key.lower() == "p":
            if self.folded:
                self._unfolded = True
            else:
                self.visible = not self.visible
        elif key.lower() == "b":
            self.widgets.attempt("Add bookmark", lambda: self.add_bookmark(""))
        elif key.lower() == "k":
            self.widgets.attempt("Add keyframe", self.add_keyframe)
        elif key == "Escape" and (self.measuring or self.points or self.player):
            self.measuring, self.points, self.profile, self.player = False, [], None, None
        elif key.isdigit() and 0 < int(key) <= len(self.bookmarks.cameras):
            self.window.controls.go_to(list(self.bookmarks.cameras.values())[int(key) - 1])
        else:
            return False
        return True

    # -- what fields and keys do ---------------------------------------------------------------------------------------

    def add_bookmark(self, name: str) -> None:
        """Keep the camera under a name, by default "View 1" and so on."""
        number = 1
        while not name.strip() and f"View {number}" in self.bookmarks.cameras:
            number += 1
        self.bookmarks.add(name.strip() or f"View {number}", self.window.controls.camera)

    def add_keyframe(self) -> None:
        """Add the camera to the flight."""
        self.keyframes.exaggeration = self.window.session.scene.exaggeration
        self.keyframes.add(self.window.controls.camera)

    def play(self) -> None:
        """Fly the keyframes."""
        self.player = Player(self.path(), time.perf_counter())

    def path(self) -> Any:
        """The keyframes as a flight over the data."""
        session = self.window.session
        return self.keyframes.path(session.data.grid, session.data.height_range, session.scene.exaggeration)

    def frame(self, now: float) -> Camera | None:
        """Let time pass before a frame; gives the camera where a flight is played or written."""
        if self.exporter:
            exporter = self.exporter

            def step() -> None:
                if not exporter.step():
                    self.exporter, self.message = None, "The video is written."

            if not self.widgets.attempt("Write video", step):
                self.exporter = None
            return exporter.camera
        if self.player:
            camera = self.player.camera(now)
            if camera is None:
                self.player = None
            return camera
        self.keyframes.record(now, self.window.controls.camera)
        return None

    # -- drawing -------------------------------------------------------------------------------------------------------

    def draw(self, target: wgpu.GPUTextureView, size: tuple[float, float], pixel_ratio: float) -> None:
        """Draw over a texture; `size`: width and height in logical pixels."""
        self._size, self._ratio = size, pixel_ratio
        self._gui.draw(target, size, pixel_ratio)

    def renew(self, form: str) -> None:
        """Go on with the session's other device, in place of one that was lost; `form` as at the start."""
        if self.exporter:
            self.exporter.cancel()
            self.exporter, self.message = None, "No video was written: the GPU device was lost."
        self._place_of, self._scale = None, (None, math.nan)
        self._gui.renew(self.window.session.device, form)

    def close(self) -> None:
        """Give everything back."""
        if self.exporter:
            self.exporter.cancel()
            self.exporter = None
        self._gui.close()

    def _build(self) -> None:
        """Make all widgets of a frame."""
        imgui, (width, height) = self.imgui, self._size
        self._draw_overlays()
        if self.profile:
            room = min(max(300.0, width - self.width - 2 * MARGIN), width - 2 * MARGIN)
            place = width - MARGIN - room, max(height - 230 - 84, MARGIN)
            imgui.set_next_window_pos(place, imgui.Cond_.first_use_ever)
            imgui.set_next_window_size((room, min(230.0, height - 2 * MARGIN)), imgui.Cond_.first_use_ever)
            draw_profile(self, self._gui.note_window)
        if not self.visible:
            return
        imgui.set_next_window_pos((MARGIN, MARGIN))
        if self.folded:
            self._draw_button()
            return
        wide = min(WIDTH, max(width - 2 * MARGIN, 40.0))
        imgui.set_next_window_size((wide, 0.0))
        imgui.set_next_window_size_constraints((wide, 0.0), (wide, max(height - 2 * MARGIN, 40.0)))
        flags = imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_collapse
        if imgui.begin("orogen   (P hides this)###panel", None, flags):
            draw_sections(self)
        self._gui.note_window()
        imgui.end()

    def _draw_button(self) -> None:
        imgui = self.imgui
        flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_move | imgui.WindowFlags_.always_auto_resize
        if imgui.begin("###button", None, flags):
            self.widgets.button("panel (P)", lambda: setattr(self, "_unfolded", True))
        self._gui.note_window()
        imgui.end()

    def _draw_overlays(self) -> None:
        imgui, session, (width, height) = self.imgui, self.window.session, self._size
        painter = imgui.get_background_draw_list()
        if session.renderer.shown is None:
            return
        frame, camera = session.renderer.shown[0], self.window.controls.camera
        part = (session.split_at(round(width)) if session.mode == "beside" else width), height
        self._draw_lines(painter, frame, part)
        turn = session.ruler.north_turn(camera.x, camera.y)
        overlay.draw_north(painter, imgui, part[0] - 44, 44, (turn - camera.heading + 180) % 360 - 180)
        bottom = height - 18
        left = self.width + MARGIN + 10
        metres = self._metres_per_pixel(frame, camera) * frame.size[0] / max(part[0], 1)
        credit = session.data.attribution or session.data.name.replace("\\", "/").rsplit("/")[-1]
        self.widgets.see(credit, session.second.label if session.second else "")
        lines = self._place_lines(width - left - 8)
        if math.isfinite(metres) and metres > 0:
            length = overlay.nice_length(metres * overlay.SCALE_WIDTH)
            free = width - imgui.calc_text_size(credit).x - 40 - left
            # in a narrow window there is room above what is written at the right
            at = bottom if max(length / metres, 40.0) < free else bottom - 28 * (1 + len(lines))
            overlay.draw_scale(painter, imgui, left, at, overlay.nice_text(length), length / metres)
        for number, text in enumerate([credit, *reversed(lines)]):
            overlay.draw_text(painter, imgui, width - 14, bottom - 14 - 28 * number, text, 1)
        if session.mode in ("wipe", "difference") and session.second:
            at = session.divider * width
            overlay.draw_text(painter, imgui, at - 14, 16, session.algorithm, 1)
            overlay.draw_text(painter, imgui, at + 14, 16, session.second.label)
        if session.mode == "difference":
            self._draw_legend(painter, width, bottom)
        if session.preparing:
            overlay.draw_text(painter, imgui, left, 48 if session.mode == "wipe" else 16, session.preparing)

    def _place_lines(self, room: float) -> list[str]:
        """What is known of the ground under the pointer, in lines no longer than so many logical pixels."""
        place, session = self._place_under(), self.window.session
        if place is None:
            return []
        lines = [""]
        for part in place_text(place, session.ruler.geographic, session.data.grid.crs).split(GAP):
            longer = f"{lines[-1]}{GAP}{part}" if lines[-1] else part
            if lines[-1] and self.imgui.calc_text_size(longer).x > room:
                lines.append(part)
            else:
                lines[-1] = longer
        return lines

    def _draw_legend(self, painter: Any, width: float, bottom: float) -> None:
        limit = self.window.session.difference_limit
        colors = overlay.legend_colors()
        left, top, each = width - 14 - 6.0 * len(colors), bottom - 92, 6.0
        painter.add_rect_filled((left - 6, top - 22), (width - 8, top + 16), overlay.SHADE, 4.0)
        painter.add_text((left, top - 20), overlay.WHITE, f"right over left: {-limit:g} to {limit:g} m")
        for number, color in enumerate(colors):
            painter.add_rect_filled((left + number * each, top), (left + (number + 1) * each, top + 12), color)

    def _draw_lines(self, painter: Any, frame: Any, size: tuple[float, float]) -> None:
        session = self.window.session
        if self.points:
            points = np.array(self.points, np.float64)
            line = points if self.profile is None else np.column_stack([self.profile.points, self.profile.height])
            overlay.draw_line(painter, frame, line, size, overlay.YELLOW)
            overlay.draw_points(painter, frame, points, size, overlay.YELLOW)
        if self.marked and self.profile:
            x, y = self.marked
            height = float(session.data.height_at(x, y))
            overlay.draw_points(painter, frame, np.array([[x, y, height]]), size, overlay.CYAN)
        frozen = session.scene.lod_camera
        if frozen and not frozen.orthographic and frozen != frame.camera:
            low, high = session.data.height_range
            far = 4 * max(frozen.z - low * session.scene.exaggeration, high - low, 100.0)
            for line in overlay.frustum_lines(frozen, frame, far):
                overlay.draw_line(painter, frame, overlay.subdivided(line), size, overlay.CYAN, 1.5)
        if self.window.map_controls and session.second and session.second.renderer.shown:
            self._draw_on_map(painter, session.second.renderer.shown[0])

    def _draw_on_map(self, painter: Any, frame: Any) -> None:
        """Where the first view's camera is, and where it looks."""
        camera, (width, height) = self.window.controls.camera, self._size
        left = self.window.session.split_at(round(width))
        room = max(width - left, 1.0), height
        ((x, y, _),) = overlay.projected(frame, np.array([[camera.x, camera.y, 0.0]]), room).tolist()
        x, y = min(max(x, 0.0), room[0]), min(max(y, 0.0), height)  # what is off the map is on its edge
        turn = math.radians(camera.heading - frame.camera.heading)
        half = math.radians(camera.fov) / 2 * min(2.0, left / max(height, 1))
        corners = [(left + x + 60 * math.sin(turn + s * half), y - 60 * math.cos(turn + s * half)) for s in (-1, 1)]
        painter.add_triangle_filled((left + x, y), corners[0], corners[1], 0x6035D9FF)
        painter.add_circle_filled((left + x, y), 6.5, overlay.BLACK)
        painter.add_circle_filled((left + x, y), 5.0, overlay.YELLOW)

    def _metres_per_pixel(self, frame: Any, camera: Camera) -> float:
        """Metres that a pixel of the first view shows in its middle; from the latest rest while the camera moves."""
        key = frame.camera, frame.size
        stale = self._scale[0] != key or not math.isfinite(self._scale[1])
        if stale and (not self.window.controls.moving or self._scale[0] is None):
            # in the middle of what the panel leaves; where there is only sky, as far away as the middle of the data
            session, width = self.window.session, self._size[0]
            part = session.split_at(round(width)) if session.mode == "beside" else width
            across = (1 + min(self.width / max(part, 1.0), 1.0)) / 2
            found = session.renderer.pick(int(across * (frame.size[0] - 1)), frame.size[1] // 2)
            depth = float(overlay.projected(frame, np.array([found or self._middle()]), (1.0, 1.0))[0, 2])
            self._scale = key, overlay.metres_per_pixel(frame, camera, depth)
        return self._scale[1]

    def _middle(self) -> tuple[float, float, float]:
        """The middle of the data: x, y and height (m)."""
        grid, heights = self.window.session.data.grid, self.window.session.data.height_range
        x, y = grid.to_crs(grid.width / 2, grid.height / 2)
        return float(x), float(y), sum(heights) / 2

    def _place_under(self) -> Place | None:
        """What is known of the ground under the pointer; nothing while the camera moves."""
        session = self.window.session
        if self._pointer is None or self.window.controls.moving or self._gui.covers(*self._pointer):
            return None
        key = self._pointer, self.window.controls.camera, session.renderer.shown and session.renderer.shown[0].size
        if key != self._place_of:
            column, row = (math.floor(v * self._ratio) for v in self._pointer)
            left = session.split_at(round(self._size[0])) if session.mode == "beside" else math.inf
            if self._pointer[0] >= left:
                found = session.map_ground.pick(math.floor((self._pointer[0] - left) * self._ratio), row)
            else:
                found = session.pick(column, row)
            self._place = session.ruler.place(found[0], found[1]) if found else None
            self._place_of = key
        return self._place
