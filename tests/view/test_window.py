import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest

import orogen
from orogen.errors import GpuError, OutputError
from orogen.view import gui
from orogen.view.controls import OrbitControls
from orogen.view.flying import FlyControls, WalkControls
from orogen.view.session import Session
from orogen.view.window import Window, _open_canvas


def test_the_canvas_shows_what_the_terrain_renders(bare, terrain):
    picture = bare.settle()
    assert picture.shape == (150, 300, 4)
    rendered = terrain.render(bare.window.session.camera, (300, 150), samples=16).color
    assert np.abs(picture[..., :3].astype(int) - rendered[..., :3]).max() <= 2


def test_a_picture_that_is_rendered_meanwhile_leaves_the_window_s(bare, terrain):
    before = bare.settle().copy()
    terrain.render(bare.window.session.camera, (300, 150), samples=16)
    terrain.renderer.time_frames([bare.window.session.camera], (300, 150))
    bare.send("resize", width=200.0, height=100.0, pixel_ratio=1.5)
    assert np.array_equal(bare.settle(), before)


def test_nothing_is_drawn_while_nothing_changes(bare):
    bare.settle()
    before = bare.canvas.requests
    bare.send("pointer_move", x=5, y=5)
    bare.send("key_down", key="F5")
    bare.draw()
    assert bare.canvas.requests == before


def test_with_a_panel_nothing_is_drawn_at_rest_either(hands):
    hands.settle()
    before = hands.canvas.requests
    hands.draw(3)
    assert hands.canvas.requests == before
    hands.send("pointer_move", x=600, y=300)
    hands.settle(limit=8)  # the place under the pointer shows, and that is all


def test_events_move_the_camera_until_it_rests(bare):
    bare.settle()
    start = bare.window.controls.camera
    bare.send("wheel", dx=0.0, dy=-300.0, x=100, y=50)
    bare.settle()
    assert not bare.window.controls.moving
    x, y, z = bare.window.session.pick(150, 75)
    before, after = (np.hypot(c.x - x, np.hypot(c.y - y, c.z - z)) for c in (start, bare.window.controls.camera))
    assert after == pytest.approx(before / 1.25**3, rel=0.02)


def test_resizes_reach_the_controls_and_the_picture(bare):
    bare.draw()
    bare.canvas.set_logical_size(300, 120)
    assert bare.draw().shape == (180, 450, 4)
    assert bare.window.controls.size == (300, 120)


def test_tab_changes_the_controls_and_keeps_the_camera(bare):
    window = bare.window
    camera = window.controls.camera
    assert type(window.controls) is OrbitControls
    bare.press("Tab")
    assert type(window.controls) is FlyControls
    assert window.controls.camera == camera
    bare.press("Tab")
    assert type(window.controls) is WalkControls
    ground = window.session.data.height_at(camera.x, camera.y)
    assert np.isnan(ground) or window.controls.camera.z == pytest.approx(ground + 1.7)
    bare.press("Tab")
    assert type(window.controls) is OrbitControls
    window.controls.camera = camera.moved(orthographic=100.0)
    bare.press("Tab")
    assert type(window.controls) is OrbitControls


def test_a_frozen_level_of_detail_stays_while_the_camera_goes(bare):
    bare.draw()
    camera = bare.window.controls.camera
    bare.press("f")
    bare.send("wheel", dx=0.0, dy=-300.0, x=100, y=50)
    bare.settle()
    frame, _ = bare.window.session.renderer.shown
    assert frame.lod_camera == camera
    assert frame.camera != camera
    bare.press("f")
    bare.settle()
    assert bare.window.session.renderer.shown[0].lod_camera is None


def test_a_map_lies_beside_the_view_and_moves_by_itself(bare):
    bare.press("m")
    picture = bare.settle().astype(int)
    camera = bare.window.controls.camera
    # what one view loads counts for the other, which may have drawn without it
    whole = bare.window.session.data.render(camera, (150, 150), samples=16).color.astype(int)
    assert np.abs(picture[:, :147, :3] - whole[:, :147, :3]).max() <= 3
    # north is up: the map is the picture that a camera straight above draws
    map_camera = bare.window.map_controls.camera
    assert (map_camera.heading, map_camera.pitch) == (0.0, -90.0)
    above = bare.window.session.data.render(map_camera, (150, 150), samples=16).color.astype(int)
    assert np.abs(picture[:, 153:, :3] - above[:, 3:, :3]).max() <= 3
    # a drag there pans the map and leaves the view
    bare.send("pointer_down", x=150, y=50)
    bare.send("pointer_move", x=160, y=50)
    bare.send("pointer_up", x=160, y=50)
    bare.settle()
    moved = bare.window.map_controls.camera
    scale = map_camera.orthographic / 100
    assert moved.x < map_camera.x - 9 * scale
    assert bare.window.controls.camera == camera
    # the first view still zooms to what is under the pointer in its own half
    bare.send("wheel", dx=0.0, dy=-100.0, x=50, y=60)
    bare.settle()
    assert bare.window.controls.camera != camera
    assert bare.window.map_controls.camera == moved
    bare.press("m")
    bare.settle()
    assert bare.window.session.second is None
    assert len(bare.window.session.renderer.clipmap._views) == 1


@pytest.mark.parametrize("kind", ["algorithm", "data", "map"])
def test_a_second_view_outlives_the_device(bare, terrain, kind):
    window, later = bare.window, None
    if kind == "map":
        bare.press("m")
        bare.send("wheel", dx=0.0, dy=-200.0, x=150, y=50)
    elif kind == "algorithm":
        window.session.restyle(overlays=("levels",))
        window.session.compare("cdlod", {"pixels_per_quad": 16})
    else:
        heights = terrain.heights.source.read(slice(0, 96), slice(0, 128))
        later = orogen.open(heights[::-1].copy(), spacing=30.0, crs="EPSG:32611")
        window.session.compare_data(later)
    before, second = bare.settle().astype(int), window.session.second
    terrain.device.destroy()
    bare.send("resize", width=200.0, height=100.0, pixel_ratio=1.5)
    after = bare.settle()
    assert window.session.second is not second
    assert (window.session.second.kind, window.session.second.label) == (second.kind, second.label)
    assert window.session.second.renderer.gpu is window.session.renderer.gpu
    assert np.abs(after - before).max() <= 2
    # and it ends as the one before it would have
    window.session.alone()
    assert bare.settle().any()
    assert later is None or later._closed


def test_a_second_view_that_cannot_be_made_again_is_told(bare, terrain, monkeypatch, caplog):
    bare.window.session.compare("cdlod")
    bare.settle()

    def fail(*_):
        raise GpuError("no room")

    monkeypatch.setattr(bare.window.session, "compare", fail)
    terrain.device.destroy()
    bare.settle()
    assert bare.window.session.second is None
    assert "the second view is closed: no room" in caplog.text


def test_the_divider_follows_the_pointer(bare):
    bare.window.session.compare("cdlod")
    bare.draw()
    camera = bare.window.controls.camera
    bare.send("pointer_down", x=101, y=50)
    bare.send("pointer_move", x=60, y=50)
    bare.send("pointer_up", x=60, y=50)
    assert bare.window.session.divider == pytest.approx(0.3)
    picture = bare.settle()
    assert bare.window.controls.camera == camera
    assert (picture[:, 90, :3] == 255).all()


def test_errors_while_drawing_are_raised_by_run(bare, monkeypatch):
    def fail(*_):
        raise GpuError("lost")

    monkeypatch.setattr(bare.window.session, "draw", fail)
    bare.canvas.draw()
    with pytest.raises(GpuError, match="lost"):
        bare.window.run()


def test_closing_while_loading_and_twice_is_no_error(terrain, hands):
    opened = []

    def slowly(text):
        time.sleep(0.3)
        opened.append(orogen.open(np.zeros((8, 9), np.float32), spacing=1.0))
        return opened[0]

    window = Window(Session(terrain, opener=slowly), canvas=type(hands.canvas)(size=(100, 60)))
    np.asarray(window.canvas.draw())
    window.session.open("anything")
    window.close()
    window.close()
    assert opened[0]._closed  # what came too late is closed with the rest


def test_without_a_panel_the_window_says_once_how_to_get_it(terrain, hands, monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    monkeypatch.setattr(gui, "_told", False)
    for _ in range(2):
        window = Window(Session(terrain), canvas=type(hands.canvas)(size=(100, 60)))
        assert window.panel is None
        assert np.asarray(window.canvas.draw()).shape == (60, 100, 4)
        window.close()
    assert [record.message for record in caplog.records if "imgui-bundle" in record.message][1:] == []
    assert "pip install imgui-bundle" in caplog.text


def test_without_a_display_one_error_says_what_to_do(monkeypatch):
    import glfw

    monkeypatch.setattr(glfw, "init", lambda: False)
    monkeypatch.setattr(glfw, "get_error", lambda: (65550, b"X11: The DISPLAY environment variable is missing"))
    with pytest.raises(OutputError, match=r"DISPLAY.*use orogen render"):
        _open_canvas((200, 100), "orogen")


DESKTOP = """
import numpy as np, orogen
from orogen.view.session import Session
from orogen.view.window import Window

heights = np.add.outer(np.arange(40.0), np.arange(50.0)).astype(np.float32)
with orogen.open(heights, spacing=10.0) as terrain:
    window = Window(Session(terrain), size=(320, 200))
    seen = []
    def look():
        if window.session.history.latest:
            seen.append(1)
        if len(seen) >= 3:
            window.canvas.close()
        else:
            window._loop.call_later(0.3, look)
    window._loop.call_later(0.3, look)
    window.run()
    window.close()
    print("frames", len(window.session.history.series("frame")), window.controls.size)
"""


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="no Xvfb: a virtual display for a real window")
def test_a_real_window_opens_draws_and_closes():
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x24"], pass_fds=(write,), stderr=subprocess.DEVNULL
    )
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            display = pipe.readline().strip()
        environment = {**os.environ, "DISPLAY": f":{display}"}
        environment.pop("WAYLAND_DISPLAY", None)
        done = subprocess.run(
            [sys.executable, "-c", DESKTOP], env=environment, capture_output=True, text=True, timeout=100
        )
    finally:
        server.terminate()
        server.wait()
    assert done.returncode == 0, done.stderr
    frames, size = done.stdout.removeprefix("frames ").split(" ", 1)
    assert int(frames) > 0
    assert size.strip() == "(320.0, 200.0)"
