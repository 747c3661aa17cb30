"""`orogen view` as a user has it: the command, a real window, a pointer and a keyboard, and what the screen shows."""

import json
import time

import numpy as np
import pytest
from PIL import Image

import orogen
from oracle import desktop
from oracle.desktop import Display, hills, opened, write

pytestmark = pytest.mark.skipif(bool(desktop.missing()), reason=desktop.missing())
SIZE = (640, 620)
MIDDLE = (500, 300)
"""Of what the panel leaves."""


def changed(before, after):
    """Part of the pixels right of the panel that differ visibly."""
    return (np.abs(pixels(after) - pixels(before))[:, 350:].max(axis=-1) > 8).mean()


def pixels(picture):
    return np.asarray(picture).astype(int)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("desktop")
    write(path / "hills.tif", hills())
    write(path / "later.tif", hills() + 40)
    return path


@pytest.fixture(scope="module")
def running(folder):
    with Display(SIZE) as display, opened(display, folder) as user:
        user.until("watch.frames > 0")
        user.settle()
        yield user
        assert user.close() == 0
        assert "rror" not in user.errors


@pytest.fixture
def user(running):
    """The window as it is at the start, with one section of the panel open at most."""
    running.do("[panel.points.clear(), setattr(panel, 'profile', None), setattr(panel, 'measuring', False)]")
    running.do("[session.alone(), session.use('raycast'), session.exaggerate(1.0), session.freeze(None)]")
    running.do("[window.change_controls(__import__('orogen.view.window').view.window.MODES[0]), window.stand()]")
    running.display.move(630, 615)
    running.display.key("Home")
    running.settle()
    return running


BEGIN = {"Algorithm", "Look"}
"""Sections that are open at the start."""


def section(user, name):
    """Have one section open alone."""
    panel = user.ask("id(panel)")
    before = getattr(user, "opened", {}).get(panel, BEGIN)  # another panel begins anew
    for other in before ^ {name}:
        user.click(other)
    user.opened = {panel: {name}}


def under(user, place):
    """What lies under the pointer: x, y, height."""
    return np.array(user.ask(f"session.pick({place[0]}, {place[1]})"))


def test_the_screen_shows_the_whole_terrain_beside_the_panel(user, folder):
    picture = pixels(user.settle())
    assert user.ask("window.canvas.get_logical_size()") == list(SIZE)
    # the panel is where it should be, in the colours that it should have
    assert np.median(picture[20:500, 20:330]) < 60
    camera = user.ask("{n: getattr(window.controls.camera, n) for n in ('x', 'y', 'z', 'heading', 'pitch', 'fov')}")
    with orogen.open(folder / "hills.tif") as terrain:
        rendered = terrain.render(orogen.Camera(**camera), SIZE, samples=1)
    ground = np.isfinite(rendered.depth)
    columns, rows = np.nonzero(ground.any(axis=0))[0], np.nonzero(ground.any(axis=1))[0]
    assert columns.min() > 342
    assert columns.max() < 640
    assert columns.max() - columns.min() > 240 or rows.max() - rows.min() > 500
    plain = ground & (np.arange(SIZE[0]) < 560)
    assert np.abs(picture - rendered.color[..., :3])[plain].mean() < 2


def test_the_pointer_pans_turns_zooms_and_goes_there(user):
    held = under(user, MIDDLE)
    user.drag(MIDDLE, (530, 330))
    user.until("not window.moving")
    assert np.hypot(*(under(user, (530, 330)) - held)[:2]) < 60 or user.ask("window.controls.camera") is None
    heading = user.ask("window.controls.camera.heading")
    pivot = under(user, MIDDLE)
    user.drag(MIDDLE, (560, 300), button=3)
    user.until("not window.moving")
    turned = (user.ask("window.controls.camera.heading") - heading + 180) % 360 - 180
    assert abs(turned) > 8
    # towards what is under the pointer
    pivot = under(user, (470, 320))
    eye = np.array(user.ask("[window.controls.camera.x, window.controls.camera.y, window.controls.camera.z]"))
    user.display.wheel(470, 320, dy=-3)
    user.until("not window.moving")
    user.settle()
    after = np.array(user.ask("[window.controls.camera.x, window.controls.camera.y, window.controls.camera.z]"))
    assert np.linalg.norm(pivot - after) == pytest.approx(np.linalg.norm(pivot - eye) / 1.25**3, rel=0.03)
    assert np.hypot(*(under(user, (470, 320)) - pivot)[:2]) < 60
    # two fingers sideways turn about it
    heading = user.ask("window.controls.camera.heading")
    user.display.wheel(470, 320, dx=2)
    user.until("not window.moving")
    user.settle()
    assert abs((user.ask("window.controls.camera.heading") - heading + 180) % 360 - 180) == pytest.approx(20, abs=1)
    away = np.linalg.norm(pivot - after)
    user.double_click(470, 320)
    time.sleep(0.1)
    user.settle()
    after = np.array(user.ask("[window.controls.camera.x, window.controls.camera.y, window.controls.camera.z]"))
    assert np.linalg.norm(pivot - after) < 0.7 * away


def test_keys_fly_walk_and_turn_north(user):
    start = user.ask("window.controls.camera.heading")
    assert abs((start + 180) % 360 - 180) > 5
    user.display.key("n")
    user.until("window.controls.camera.heading % 360 < 0.1 or window.controls.camera.heading % 360 > 359.9")
    user.display.key("Home")
    user.until(f"abs(window.controls.camera.heading - {start}) < 0.1")
    user.settle()
    user.display.key("Tab")
    user.until("type(window.controls).__name__ == 'FlyControls'")
    place = user.ask("[window.controls.camera.x, window.controls.camera.y]")
    user.display.key("w", True)
    user.until(f"abs(window.controls.camera.y - {place[1]}) > 50")
    user.display.key("w", False)
    user.until("not window.moving")
    user.display.key("Tab")
    user.until("type(window.controls).__name__ == 'WalkControls'")
    above = user.ask("window.controls.camera.z - float(session.data.height_at(window.controls.camera.x, "
                     "window.controls.camera.y))")  # fmt: skip
    assert above == pytest.approx(1.7, abs=0.01) or np.isnan(above)


def test_fields_of_the_panel_do_what_they_say(user):
    section(user, "Look")
    before = user.settle()
    user.click("contours")
    assert user.ask("session.style.overlays") == ["contours"]
    assert changed(before, user.settle()) > 0.005
    user.click("contours")
    x, y = user.steady("exaggeration")
    user.drag((x - 20, y), (x + 100, y))
    assert user.ask("session.scene.exaggeration") > 2
    user.type("sun at", "2026-06-21 19:30")
    azimuth, elevation = user.ask("session.style.sun")
    assert elevation > 60
    user.type("sun at", "now")
    assert "expected a time" in user.ask("panel.widgets.problems['sun at']")
    assert user.ask("session.style.sun") == [azimuth, elevation]
    section(user, "Algorithm")
    user.click("algorithm")
    user.settle()  # the list is open, however busy the machine is
    x, y = user.place("algorithm")
    user.click((x, y + 46))  # the second of the list
    name = user.ask("session.algorithm")
    assert name != "raycast"
    user.do("session.use('udlod')")
    user.type("grid size##udlod", "8")
    assert user.ask("session.values") == {"grid_size": "8"}
    user.type("grid size##udlod", "7x")
    assert "grid_size: expected int" in user.ask("panel.widgets.problems['grid size##udlod']")
    assert user.ask("[session.values, window.error is None]") == [{"grid_size": "8"}, True]


@pytest.mark.nightly
def test_two_views_a_divider_and_a_map(user):
    before = user.settle()
    section(user, "Compare")
    user.do("session.compare('brute')")
    x = user.ask("session.divider") * SIZE[0]
    assert x > 342  # beside the panel
    user.settle()
    user.drag((x, 560), (420, 560))
    assert user.ask("session.divider") == pytest.approx(420 / SIZE[0], abs=0.01)
    user.type("other data", "later.tif")
    user.until("session.second.data is not None")
    user.click("difference in height")
    shown = pixels(user.settle())
    assert user.ask("session.mode") == "difference"
    # 40 m higher everywhere: red
    assert (shown[280:320, 450:520, 0] > shown[280:320, 450:520, 2] + 40).mean() > 0.8
    user.do("session.alone()")
    user.display.key("m")
    user.until("session.mode == 'beside'")
    assert changed(before, user.settle()) > 0.02
    camera = user.ask("window.controls.camera.x")
    left = user.ask("session.divider") * SIZE[0]
    size = user.ask("window.map_controls.camera.orthographic")
    user.display.wheel(left + 60, 300, dy=-2)
    user.until("not window.moving")
    user.settle()
    assert user.ask("window.map_controls.camera.orthographic") < 0.7 * size
    assert user.ask("window.controls.camera.x") == camera
    user.display.key("m")
    user.until("session.second is None")


def test_clicks_measure_a_profile(user):
    section(user, "Measure")
    user.click("click points")
    for place in ((450, 310), (540, 300)):
        user.click(place)
    length = user.ask("panel.profile.length")
    ends = np.array(user.ask("panel.points"))
    assert length == pytest.approx(np.hypot(*(ends[1] - ends[0])[:2]), rel=0.01)
    user.settle()
    user.display.key("Escape")
    user.until("panel.profile is None")


@pytest.mark.nightly
def test_bookmarks_keyframes_and_a_picture(user, folder):
    section(user, "Flight")
    user.display.move(*MIDDLE)
    for key in ("b", "k"):
        user.display.key(key)
    user.until("len(panel.keyframes.cameras) and len(panel.bookmarks.cameras)")
    user.display.wheel(*MIDDLE, dy=-4)
    user.until("not window.moving")
    user.display.key("k")
    user.until("len(panel.keyframes.cameras) == 2")
    user.type("save as", "flown.json")
    assert len(json.loads((folder / "flown.json").read_text())["keyframes"]) == 2
    near = user.ask("window.controls.camera.z")
    user.click("play")
    user.until(f"panel.player is not None and window.controls.camera.z > {near} + 100")
    user.display.key("Escape")
    user.until("panel.player is None")
    user.display.key("1")
    user.until("not window.moving")
    section(user, "Picture")
    user.type("size", "300 x 200")
    user.type("write to", "shown.png")
    with Image.open(folder / "shown.png") as picture:
        assert picture.size == (300, 200)
    user.type("size", "1e9 x 3")
    assert "expected 1 to" in user.ask("panel.widgets.problems['size']")


@pytest.mark.nightly
def test_bad_data_are_told_and_others_opened(user, folder):
    section(user, "Data")
    (folder / "bad.tif").write_bytes(b"no raster")
    for name in ("nowhere.tif", "bad.tif"):
        user.type("Open", name)
        user.until(f"{name!r} in session.problem")
    user.type("Open", "later.tif")
    user.until("session.data.name.endswith('later.tif')")
    assert pixels(user.settle()).std() > 20
    section(user, "Data")
    user.type("Open", "hills.tif")  # as the other tests have it
    user.until("session.data.name.endswith('hills.tif')")


def test_a_device_is_lost_while_a_list_is_open(user):
    section(user, "Algorithm")
    before = user.settle()
    user.click("algorithm")
    lost = user.ask("id(session.device)")
    user.do("session.device.destroy()")
    user.display.move(*MIDDLE)
    user.until(f"id(session.device) != {lost}")
    user.display.move(630, 615)
    user.frames(3)
    assert changed(before, user.settle()) < 0.05
    assert user.ask("window.error is None")
