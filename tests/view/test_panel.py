import json

import numpy as np
import pytest

from orogen.view import overlay
from orogen.view.flying import FlyControls
from orogen.view.window import PROGRESS

GROUND = (650, 480)
"""A logical pixel beside the panel that shows ground."""


def section(hands, name, closed=("Algorithm", "Look")):
    """Only this section is open."""
    hands.draw(3)
    for each in closed:
        if each != name:
            hands.click(each)
    if name not in ("Algorithm", "Look"):
        hands.click(name)


def test_one_key_hides_and_shows_the_panel(hands):
    hands.draw(3)
    shown = hands.settle()
    hands.press("p")
    hidden = hands.settle()
    assert not hands.window.panel.visible
    # where the panel was there is the picture now
    assert np.abs(shown[25, 5:80].astype(int) - hidden[25, 5:80]).mean() > 30
    assert not hands.window.panel._gui.covers(100, 100)
    hands.press("p")
    again = hands.settle()
    assert np.abs(shown.astype(int) - again).max() <= 1


def test_what_happens_on_the_panel_stays_there(hands):
    hands.settle()
    camera = hands.window.controls.camera
    hands.send("pointer_move", x=100, y=60)
    hands.draw()
    hands.send("wheel", dx=0.0, dy=-300.0, x=100, y=60)
    hands.send("pointer_down", x=100, y=60)
    hands.send("pointer_move", x=500, y=400, buttons=(1,))
    hands.send("pointer_up", x=500, y=400)
    hands.settle()
    assert hands.window.controls.camera == camera


def test_choices_switches_and_sliders_change_what_is_drawn(hands):
    session = hands.window.session
    before = hands.settle()
    hands.click("contours")
    assert session.style.overlays == ("contours",)
    assert np.abs(hands.settle().astype(int) - before).max() > 10
    hands.click("shadows")
    assert not session.style.shadows
    hands.slide("sun height (°)", 0.5)
    assert session.style.sun[1] == pytest.approx(45, abs=4)
    hands.slide("exaggeration", 0.8)
    assert session.scene.exaggeration > 2
    assert hands.window.controls.ground.exaggeration == session.scene.exaggeration


def test_an_algorithm_is_chosen_and_set(hands):
    session = hands.window.session
    hands.draw(3)
    session.use("cdlod")
    hands.draw(3)
    label = "pixels per quad (px)##cdlod"
    assert label in hands.widgets.places
    hands.slide(label, 0.9)
    assert session.renderer.algorithm.settings.pixels_per_quad > 50
    assert session.values.keys() == {"pixels_per_quad"}


def test_a_bad_setting_is_told_beside_its_field_and_the_view_goes_on(hands):
    session = hands.window.session
    session.use("udlod")
    hands.draw(3)
    before = session.renderer.algorithm.settings
    hands.type("tile capacity##udlod", "7")
    assert "tile_capacity: expected at least 64" in hands.widgets.problems["tile capacity##udlod"]
    assert session.renderer.algorithm.settings == before
    hands.type("tile capacity##udlod", "many")
    assert "expected int, got 'many'" in hands.widgets.problems["tile capacity##udlod"]
    hands.type("tile capacity##udlod", "4096")
    assert hands.widgets.problems == {}
    assert session.renderer.algorithm.settings.tile_capacity == 4096


def test_the_sun_stands_where_it_does_at_a_time(hands):
    hands.draw(3)
    hands.type("sun at", "noon")
    assert "expected a time such as" in hands.widgets.problems["sun at"]
    # EPSG:32611 at x = 0 lies far west of its zone, where the sun is up in the evening of UTC
    hands.type("sun at", "2026-06-21 20:00")
    assert "sun at" not in hands.widgets.problems
    assert hands.window.session.style.sun[1] > 20
    hands.type("sun at", "2026-06-21 08:00")
    assert "below the horizon" in hands.widgets.problems["sun at"]


def test_other_data_takes_the_place_of_what_is_shown(hands, tmp_path):
    from orogen.view.image import write_depth

    section(hands, "Data")
    hands.type("Open", str(tmp_path / "missing.tif"))
    while hands.window.session.opening:
        hands.draw()
    assert "missing.tif" in hands.window.session.problem
    before = hands.window.session
    bad = tmp_path / "bad.tif"
    bad.write_bytes(b"not a raster")
    hands.type("Open", str(bad))
    while hands.window.session.opening:
        hands.draw()
    assert "bad.tif" in hands.window.session.problem
    write_depth(tmp_path / "other.tif", np.add.outer(np.arange(40.0), np.arange(60.0)).astype(np.float32))
    hands.type("Open", str(tmp_path / "other.tif"))
    while hands.window.session.opening:
        hands.draw()
    hands.settle()
    assert hands.window.session is not before
    assert hands.window.session.data.grid.shape == (40, 60)
    x, y, z = hands.window.session.pick(156, 125)  # the middle of what the panel leaves
    assert z == pytest.approx(hands.window.session.data.height_at(x, y), abs=0.3)


def test_the_place_under_the_pointer(hands):
    hands.settle()
    hands.send("pointer_move", x=GROUND[0], y=GROUND[1])
    hands.settle()
    place = hands.window.panel._place
    x, y, z = hands.window.session.pick(round(GROUND[0] * 0.25), round(GROUND[1] * 0.25))
    assert (place.x, place.y) == pytest.approx((x, y), abs=30)
    assert place.height == pytest.approx(z, abs=15)
    assert place.longitude is not None


def test_bookmarks_are_kept_for_the_data(hands, tmp_path):
    section(hands, "Move")
    first = hands.window.controls.camera
    hands.type("bookmark", "start")
    hands.type("bookmark", "   ")
    files = list((tmp_path / "config" / "bookmarks").glob("*.json"))
    assert len(files) == 1
    assert list(json.loads(files[0].read_text())["cameras"]) == ["start", "View 1"]
    hands.send("wheel", dx=0.0, dy=-300.0, x=GROUND[0], y=GROUND[1])
    hands.settle()
    hands.press("1")
    hands.settle()
    assert hands.window.controls.camera == first
    hands.click("x##start")
    assert list(hands.window.panel.bookmarks.cameras) == ["View 1"]


def test_going_to_coordinates_and_other_controls(hands):
    section(hands, "Move")
    session = hands.window.session
    grid = session.data.grid
    x, y = (float(v) for v in grid.to_crs(70.0, 40.0))
    hands.type("go to", "somewhere")
    assert "expected two numbers" in hands.widgets.problems["go to"]
    hands.type("go to", f"{x + 200}, {y}")
    hands.settle()
    hands.settle()
    found = session.pick(112, 125)
    assert found[:2] == pytest.approx((x + 200, y), abs=60)
    hands.window.change_controls(FlyControls)
    hands.draw(2)
    hands.click("map from above (M)")
    assert session.mode == "beside"


def test_graphs_and_the_speed_section(hands):
    section(hands, "Speed")
    hands.settle()
    latest = hands.window.session.history.latest
    assert latest.resident > 0
    assert latest.queue == 0
    assert latest.memory == hands.window.session.renderer.gpu.memory.total
    hands.slide("frame time (ms)", 0.9)
    assert hands.window.session.quality.settings.frame_time > 80
    hands.slide("coarsest triangles", 0.9)
    assert hands.window.session.quality.settings.coarsest_detail > 0.8
    hands.click("adapt to this machine")
    assert not hands.window.session.quality.settings.adaptive


def test_comparing_from_the_panel(hands):
    section(hands, "Compare")
    session = hands.window.session
    session.compare("cdlod", {"pixels_per_quad": 32})
    hands.draw(3)
    hands.click("difference in height")
    assert session.mode == "difference"
    hands.type("other data", "nowhere.tif")
    while session.opening:
        hands.draw()
    assert "nowhere.tif" in session.problem
    assert session.second.label == "cdlod pixels_per_quad=32"


def test_a_lost_device_leaves_the_panel_as_it_was(hands):
    """What is open, half typed, measured and kept is still there, and looks as before."""
    panel, window = hands.window.panel, hands.window
    hands.draw(3)
    hands.click("Algorithm")
    hands.click("Move")
    panel.keyframes.add(window.controls.camera)
    panel.points = [(1000.0, -1000.0, 600.0)]
    hands.click("go to")
    for letter in "12, 3":
        hands.send("char", data=letter)
    before = hands.settle()
    places = dict(panel.widgets.places)
    lost = window.session.device
    lost.destroy()
    hands.press("Shift")
    after = hands.settle()
    assert window.session.device is not lost
    assert window.panel is panel
    assert panel.widgets.places == places
    assert panel._gui.typing
    assert len(panel.points) == 1
    assert len(panel.keyframes.cameras) == 1
    assert (np.abs(after.astype(int) - before).max(axis=-1) > 8).mean() < 0.002
    hands.send("char", data="4")
    hands.press("Enter")
    hands.draw(2)
    assert "go to" not in panel.widgets.problems
    assert window.controls.moving


def test_in_a_narrow_window_the_panel_is_a_button_at_first(hands):
    panel = hands.window.panel
    hands.canvas.set_logical_size(320, 240)
    hands.draw(3)
    assert panel.folded
    assert panel.width == 0
    assert "Look" not in panel.widgets.places
    hands.click("panel (P)")
    hands.draw(3)
    assert not panel.folded
    assert "Look" in panel.widgets.places
    hands.press("p")
    hands.draw(2)
    assert not panel.visible
    hands.press("p")
    assert panel.visible
    assert not panel.folded


def test_the_picture_tells_how_far_its_data_are_prepared(hands, monkeypatch):
    written = []
    draw = overlay.draw_text
    monkeypatch.setattr(overlay, "draw_text", lambda *given: (written.append(given[4]), draw(*given)))
    hands.settle()
    assert not [text for text in written if "preparing" in text]
    heights = hands.window.session.data.heights
    monkeypatch.setattr(type(heights), "progress", 0.37)
    hands.draw()
    assert "preparing the data for fast access: 37 %" in written
    # it goes on by itself
    assert hands.window._rest() == PROGRESS
