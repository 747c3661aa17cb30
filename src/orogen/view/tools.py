"""The sections of the panel that make something: measures, flights, pictures."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from orogen.view.flight import Flight
from orogen.view.forms import docstrings
from orogen.view.image import write_color
from orogen.view.measure import distance_text
from orogen.view.overlay import CYAN, YELLOW
from orogen.view.parts import LARGEST, check_picture_size
from orogen.view.player import Exporter, VideoSettings
from orogen.view.video import QUALITIES
from orogen.view.widgets import number_of, path_of, size_of

if TYPE_CHECKING:
    from orogen.view.panel import ViewPanel

PROFILE_ROOM = 0.1
"""Part of the profile's heights that stays free above and below the line, which has a width."""


def draw_measure(panel: ViewPanel) -> None:
    """Distances and profiles along clicked points."""
    w = panel.widgets

    def put(on: bool) -> None:
        panel.measuring = on

    def clear() -> None:
        panel.points, panel.profile = [], None

    w.switch(
        "click points", panel.measuring, put, "Every click into the picture adds a point of a line; Escape ends it."
    )
    w.button("clear", clear, beside=True)
    if panel.profile:
        up, down = panel.profile.climb
        straight = panel.points[-1][2] - panel.points[0][2]
        w.remark(
            f"{distance_text(panel.profile.length)} over the ground, {straight:+.0f} m in height, "
            f"{up:.0f} m up and {down:.0f} m down"
        )
    elif panel.measuring:
        w.remark("Click two or more points on the terrain.")


def draw_profile(panel: ViewPanel, note_window: Callable[[], None]) -> None:
    """The window with the profile along the measured line."""
    from imgui_bundle import implot

    imgui, profile = panel.imgui, panel.profile
    assert profile
    panel.marked = None
    shown, open = imgui.begin("Height profile###profile", True, imgui.WindowFlags_.no_collapse)
    flags = implot.Flags_.no_legend | implot.Flags_.no_menus | implot.Flags_.no_mouse_text
    implot.push_style_var(implot.StyleVar_.fit_padding, (0.0, PROFILE_ROOM))
    if shown and implot.begin_plot("##profile", (-1.0, -1.0), flags):
        unit, name = (1000.0, "km") if profile.length >= 10000 else (1.0, "m")
        fit = implot.AxisFlags_.auto_fit | implot.AxisFlags_.no_highlight
        implot.setup_axes(f"distance ({name})", "height (m)", fit, fit)
        line, mark = implot.Spec(), implot.Spec()  # as the line and the place on the terrain look
        line.line_color, line.line_weight = imgui.color_convert_u32_to_float4(YELLOW), 2.0
        mark.marker, mark.marker_size = implot.Marker_.circle, 4.5
        mark.marker_fill_color = mark.marker_line_color = imgui.color_convert_u32_to_float4(CYAN)
        implot.plot_line("height", profile.distance / unit, profile.height, line)
        if implot.is_plot_hovered():
            at = float(np.clip(implot.get_plot_mouse_pos().x * unit, 0, profile.length))
            number = int(np.argmin(np.abs(profile.distance - at)))
            panel.marked = float(profile.points[number, 0]), float(profile.points[number, 1])
            x, y = np.array([at / unit]), np.array([profile.height[number]])
            implot.plot_scatter("here", x, y, mark)
            implot.annotation(x[0], y[0], (1, 1, 1, 1), (8, -8), True, f"{distance_text(at)}: {y[0]:.1f} m")
        implot.end_plot()
    implot.pop_style_var()
    note_window()
    imgui.end()
    if not open:
        panel.points, panel.profile, panel.measuring = [], None, False


def draw_flight(panel: ViewPanel) -> None:
    """A flight: recorded or of keyframes, played, saved and written as a video."""
    w, window, keys = panel.widgets, panel.window, panel.keyframes
    session = window.session
    if keys.recording:
        w.button("stop recording", keys.stop)
        w.remark(f"{len(keys.times)} keyframes, {keys.duration:.1f} s")
    else:
        w.button("record", lambda: keys.start(time.perf_counter()), "Keep what is flown from now on.")
        w.button("add keyframe (K)", panel.add_keyframe, "Add this camera to the flight.", beside=True)
        if "Add keyframe" in w.problems:
            w.problem(w.problems["Add keyframe"])
    shown = min(len(keys.cameras), 6)  # more of them scroll
    panel.imgui.begin_child("keyframes", (0.0, 28.0 * shown + 1))
    for number, camera in enumerate(list(keys.cameras)):
        panel.imgui.push_id(number)
        w.text(
            f"##t{number}", f"{keys.times[number]:.2f}", lambda text, n=number: keys.set_time(n, number_of(text)),  # type: ignore[misc]
            "Seconds from the start; the keyframes after it move along.",
        )  # fmt: skip
        w.button(f"go##{number}", lambda c=camera: window.controls.go_to(c), "Go to this keyframe.", beside=True)  # type: ignore[misc]
        w.button(
            f"set##{number}", lambda n=number: keys.replace(n, window.controls.camera),  # type: ignore[misc]
            "Put this camera in its place.", beside=True,
        )  # fmt: skip
        w.button(f"x##{number}", lambda n=number: keys.remove(n), "Take it out.", beside=True)  # type: ignore[misc]
        panel.imgui.pop_id()
    panel.imgui.end_child()
    w.button("play", panel.play, "Fly the keyframes; a click or Escape stops.")
    if not session.files:
        return
    w.text(
        "save as", "", lambda text: keys.flight().save(path_of(text, "flight.json")),
        "A file for orogen fly and for loading.", "flight.json",
    )  # fmt: skip

    def load(text: str) -> None:
        flight = Flight.load(path_of(text, "flight.json or orbit"))
        ex = session.scene.exaggeration
        over = flight.over(
            session.data.grid, session.data.height_range, exaggeration=ex, height_at=session.data.height_at
        )
        keys.load(over, ex)

    w.text("load", "", load, "A flight file, or a built-in flight such as orbit or descent.", "flight.json or orbit")
    if panel.exporter:
        panel.imgui.progress_bar(panel.exporter.done)

        def cancel() -> None:
            if panel.exporter:
                panel.exporter.cancel()
            panel.exporter, panel.message = None, "No video was written."

        w.button("cancel", cancel)
        return

    def export(text: str) -> None:
        panel.exporter = Exporter(
            session.renderer, panel.path(), path_of(text, "flight.mp4"), panel.video, session.style, session.scene
        )

    def put(**changes: Any) -> None:
        panel.video = replace(panel.video, **changes)

    video, help = panel.video, docstrings(VideoSettings)
    w.text(
        "video size", f"{video.size[0]} x {video.size[1]}", lambda text: put(size=_picture_size(text)),
        help["size"],
    )  # fmt: skip
    w.text("video rate (1/s)", f"{video.fps:g}", lambda text: put(fps=number_of(text)), help["fps"])
    w.choice("video quality", video.quality, list(QUALITIES), lambda quality: put(quality=quality), help["quality"])
    w.text("video", "", export, "Writes the flight as a video; .mp4 and .webm, or .mkv without loss.", "flight.mp4")
    if "Write video" in w.problems:
        w.problem(w.problems["Write video"])


def draw_picture(panel: ViewPanel) -> None:
    """A picture of any size, written as a file."""
    w, session = panel.widgets, panel.window.session
    size = panel.picture_size or tuple(
        round(v * panel.window.canvas.get_pixel_ratio()) for v in panel.window.canvas.get_logical_size()
    )

    def resize(text: str) -> None:
        panel.picture_size = _picture_size(text)

    def write(text: str) -> None:
        camera = panel.window.controls.camera
        path = path_of(text, "picture.png")
        picture = session.renderer.render(camera, size, session.style, session.scene, samples=16)
        write_color(path, picture.color)
        panel.message = f"{text.strip()} is written."

    w.text("size", f"{size[0]} x {size[1]}", resize, "Width and height in pixels of the picture that is written.")
    w.text("write to", "", write, "Writes what the camera sees, without the panel, as a PNG file.", "picture.png")


def _picture_size(text: str) -> tuple[int, int]:
    size = size_of(text, LARGEST)
    check_picture_size(size)
    return size
