"""The sections of the panel: fields, graphs and buttons. Each takes the panel and reads and changes its session."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from orogen.lod import algorithm, algorithms
from orogen.shading.ramp import ramps
from orogen.shading.style import COLOR_MODES, OVERLAYS, Style
from orogen.view.controls import OrbitControls
from orogen.view.flying import FlyControls, WalkControls
from orogen.view.forms import changed, docstrings, form_of, text_of
from orogen.view.quality import QualitySettings
from orogen.view.tools import draw_flight, draw_measure, draw_picture
from orogen.view.widgets import two_numbers

if TYPE_CHECKING:
    from orogen.view.panel import ViewPanel

MOVEMENTS = {"around": OrbitControls, "fly": FlyControls, "walk": WalkControls}
GRAPH_HEIGHT, LINE_HEIGHT = 96.0, 18.0
TALL = 600.0
"""Logical pixels of a window's height from which sections are open at the start."""


def draw_sections(panel: ViewPanel) -> None:
    """All sections, the most used first."""
    sections: tuple[tuple[str, Callable[[ViewPanel], None], bool], ...] = (
        ("Data", _data, False), ("Algorithm", _algorithm, True), ("Look", _look, True), ("Move", _move, False),
        ("Compare", _compare, False), ("Speed", _speed, False), ("Measure", draw_measure, False),
        ("Flight", draw_flight, False), ("Picture", draw_picture, False),
    )  # fmt: skip
    tall = panel.window.canvas.get_logical_size()[1] >= TALL
    for name, draw, open in sections:
        if name == "Picture" and not panel.window.session.files:
            continue
        if panel.widgets.section(name, open and tall):
            panel.imgui.push_id(name)
            draw(panel)
            panel.imgui.pop_id()
    if panel.message:
        panel.widgets.remark(panel.message)


def _data(panel: ViewPanel) -> None:
    w, session = panel.widgets, panel.window.session
    grid = session.data.grid
    low, high = session.data.height_range
    w.remark(f"{session.data.name}\n{grid.width} x {grid.height} samples, {low:.0f} to {high:.0f} m")
    if not session.files:
        return
    w.text(
        "Open", "", session.open, "A file, an address or a GDAL name; Enter opens it in place of what is shown.",
        "path of a raster, then Enter", wide=True,
    )  # fmt: skip
    if session.opening:
        w.remark("opening ...")
    if session.problem:
        w.problem(session.problem)


def _algorithm(panel: ViewPanel) -> None:
    w, session = panel.widgets, panel.window.session
    w.choice(
        "algorithm", session.algorithm, list(algorithms()), session.use,
        "What decides on the geometry. All are shaded alike.",
    )  # fmt: skip
    _settings(panel, session.algorithm, session.values, lambda values: session.use(session.algorithm, values), "")
    frozen = session.scene.lod_camera is not None
    camera = panel.window.controls.camera
    w.switch(
        "freeze level of detail (F)", frozen, lambda on: session.freeze(camera if on else None),
        "Keep levels of detail and culling as this camera has them, and look at them from elsewhere.",
    )  # fmt: skip


def _settings(
    panel: ViewPanel, name: str, values: dict[str, Any], use: Callable[[dict[str, Any]], None], suffix: str
) -> None:
    """The fields of an algorithm's settings."""
    w, kind, detail = panel.widgets, algorithm(name).Settings, algorithm(name).detail
    for field in form_of(kind):
        value = values.get(field.name, field.default)
        label = f"{field.label}##{suffix}{name}"

        def put(text: Any, name_of: str = field.name) -> None:
            use(changed(kind, name, values, name_of, text_of(text) if not isinstance(text, str) else text))

        if field.kind == "bool":
            w.switch(label, value in (True, "true", "on", "1"), put, field.help)
        elif detail and field.name == detail.setting and value is not None:
            limits = min(detail.finest, detail.coarsest), max(detail.finest, detail.coarsest)
            w.slider(label, float(value), limits, put, field.help, logarithmic=True, late=True)
        elif field.limits and value is not None and field.kind == "float":
            w.slider(label, float(value), field.limits, put, field.help, late=True)
        else:
            w.text(label, text_of(value), put, field.help)


def _look(panel: ViewPanel) -> None:
    w, session, style = panel.widgets, panel.window.session, panel.window.session.style
    help = docstrings(Style)
    w.choice("colour", style.color, COLOR_MODES, lambda mode: session.restyle(color=mode), help["color"])
    w.choice("ramp", style.ramp, list(ramps()), lambda ramp: session.restyle(ramp=ramp, color="ramp"), help["ramp"])

    def exaggerate(factor: float) -> None:
        session.exaggerate(factor)
        panel.window.stand()

    w.slider(
        "exaggeration", session.scene.exaggeration, (0.25, 10.0), exaggerate, "Factor on all heights.",
        logarithmic=True,
    )  # fmt: skip
    azimuth, elevation = style.sun
    w.slider(
        "sun azimuth (°)", azimuth % 360, (0.0, 360.0), lambda a: session.restyle(sun=(a, session.style.sun[1])),
        help["sun"], format="%.0f",
    )  # fmt: skip
    w.slider(
        "sun height (°)", elevation, (0.0, 90.0), lambda e: session.restyle(sun=(session.style.sun[0], e)),
        help["sun"], format="%.0f",
    )  # fmt: skip
    w.text(
        "sun at", "", session.set_sun_time,
        "A time at which the sun is put where it stands over the middle of the data; UTC unless it says otherwise.",
        "2026-06-21 09:30",
    )  # fmt: skip
    w.switch("shadows", style.shadows, lambda on: session.restyle(shadows=on), help["shadows"])
    panel.imgui.same_line()
    w.switch("light", style.lit, lambda on: session.restyle(lit=on), help["lit"])
    for number, name in enumerate(OVERLAYS):
        if number % 3:
            panel.imgui.same_line()

        def put(on: bool, name: str = name) -> None:
            kept = [n for n in OVERLAYS if (n in session.style.overlays and n != name) or (on and n == name)]
            session.restyle(overlays=tuple(kept))

        w.switch(name, name in style.overlays, put, help["overlays"])


def _move(panel: ViewPanel) -> None:
    w, window = panel.widgets, panel.window
    current = next(name for name, kind in MOVEMENTS.items() if type(window.controls) is kind)
    w.choice(
        "move (Tab)", current, list(MOVEMENTS), lambda name: window.change_controls(MOVEMENTS[name]),
        "around: drag the ground, turn with the right button, zoom with the wheel. fly, walk: W A S D, Q E, drag to "
        "look, Shift for speed.",
    )  # fmt: skip

    def go(text: str) -> None:
        x, y = two_numbers(text)
        session = window.session
        distance = 20 * max(session.data.grid.spacing, 10.0)
        camera = window.controls.camera
        if session.ruler.geographic or (abs(x) <= 180 and abs(y) <= 90 and session.data.grid.crs):
            x, y = session.ruler.from_degrees(x, y)
        window.controls.go_to(
            session.whole(look_at=(x, y), distance=max(distance, 500.0), heading=camera.heading, pitch=-35.0)
        )

    w.text("go to", "", go, "x, y in the data's CRS, or longitude, latitude in degrees.", "x, y")
    w.text(
        "bookmark", "", panel.add_bookmark, "A name under which the camera is kept for this data set (B adds one).",
        "name, then Enter",
    )  # fmt: skip
    for number, (name, camera) in enumerate(list(panel.bookmarks.cameras.items()), start=1):
        w.button(f"{name}##go", lambda c=camera: window.controls.go_to(c), f"Go there (key {number}).")  # type: ignore[misc]
        w.button(f"x##{name}", lambda n=name: panel.bookmarks.remove(n), "Forget it.", beside=True)  # type: ignore[misc]
    if "Add bookmark" in w.problems:
        w.problem(w.problems["Add bookmark"])
    mapped = window.session.second is not None and window.session.second.kind == "map"
    w.switch("map from above (M)", mapped, lambda on: window.toggle_map(), "A map beside the view, with its own zoom.")


def _compare(panel: ViewPanel) -> None:
    w, session = panel.widgets, panel.window.session
    second = session.second
    compared = second is not None and second.kind == "compare"
    name = second.renderer.algorithm.name if second and compared and not second.data else ""
    w.choice(
        "beside", name or "nothing", ["nothing", *algorithms()],
        lambda chosen: session.alone() if chosen == "nothing" else session.compare(chosen),
        "Draws the right part with another algorithm; drag the divider.",
    )  # fmt: skip
    if session.files:
        w.text(
            "other data", "", lambda text: session.open(text, "compare"),
            "A data set in the same CRS, such as another year's, for the right part.", "path, then Enter",
        )  # fmt: skip
    if session.opening:
        w.remark("opening ...")
    if session.problem:
        w.problem(session.problem)
    if second and compared:
        if name:
            chosen = second.renderer.algorithm.settings
            values = asdict(chosen)
            _settings(panel, name, values, lambda values: session.compare(name, values), "second ")

        def show(on: bool) -> None:
            session.difference = on

        w.switch(
            "difference in height", session.difference, show,
            "Colours how much higher (red) or lower (blue) the right one is than the left one.",
        )  # fmt: skip
        w.slider(
            "strongest colour (m)", session.difference_limit, (0.01, 1000.0), session.limit_difference,
            "Difference in height that has the strongest colour.", logarithmic=True,
        )  # fmt: skip


def _speed(panel: ViewPanel) -> None:
    w, session = panel.widgets, panel.window.session
    settings = session.quality.settings
    help = docstrings(QualitySettings)

    def put(**changes: Any) -> None:
        session.quality.settings = replace(settings, **changes)

    w.switch("adapt to this machine", settings.adaptive, lambda on: put(adaptive=on), help["adaptive"])
    w.slider(
        "frame time (ms)", settings.frame_time, (8.0, 100.0), lambda t: put(frame_time=t), help["frame_time"],
        format="%.0f",
    )  # fmt: skip
    w.slider("coarsest picture", settings.coarsest, (0.25, 1.0), lambda c: put(coarsest=c), help["coarsest"])
    w.slider(
        "coarsest triangles", settings.coarsest_detail, (0.125, 1.0), lambda c: put(coarsest_detail=c),
        help["coarsest_detail"],
    )  # fmt: skip
    latest = session.history.latest
    if latest is None:
        return
    gpu = sum(latest.gpu.values())
    w.remark(
        f"frame {latest.frame:.1f} ms, CPU {latest.cpu:.1f}, GPU {gpu:.1f}\n"
        f"picture {100 * latest.scale:.0f} %, detail {100 * latest.detail:.0f} %, samples {latest.samples}\n"
        f"{latest.triangles:,} triangles, {latest.resident} nodes resident, {latest.queue} in the queue\n"
        f"{latest.memory / 2**20:.0f} MiB of GPU memory"
    )
    _graph(panel, "ms", [("frame", session.history.series("frame")), ("CPU", session.history.series("cpu"))])
    _graph(panel, "GPU ms", list(session.history.passes().items())[:6])
    counts = [("resident", session.history.series("resident")), ("queue", session.history.series("queue"))]
    _graph(panel, "nodes", counts)
    _graph(panel, "k triangles", [("triangles", session.history.series("triangles") / 1000)])
    _graph(panel, "MiB", [("GPU memory", session.history.series("memory") / 2**20)])


def _graph(panel: ViewPanel, name: str, lines: Sequence[tuple[str, np.ndarray]]) -> None:
    """Lines over the latest frames; none where there is nothing to draw, as GPU times without timestamps."""
    if not lines:
        return
    from imgui_bundle import implot

    flags = implot.Flags_.no_mouse_text | implot.Flags_.no_inputs | implot.Flags_.no_menus
    # room for the names of all lines
    height = GRAPH_HEIGHT + LINE_HEIGHT * max(0, len(lines) - 2)
    if implot.begin_plot(f"##{name}", (-1.0, height), flags):
        axis = implot.AxisFlags_.auto_fit
        implot.setup_axes("", name, axis | implot.AxisFlags_.no_tick_labels, axis)
        implot.setup_legend(implot.Location_.north_west)
        for label, values in lines:
            implot.plot_line(label, np.ascontiguousarray(values))
        implot.end_plot()
