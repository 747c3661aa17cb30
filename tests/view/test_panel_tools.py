import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from orogen.view.flight import Flight

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


def test_a_profile_along_clicked_points(hands, monkeypatch):
    from imgui_bundle import implot

    limits = []

    def end(ended=implot.end_plot):
        limits.append(implot.get_plot_limits().y)
        ended()

    monkeypatch.setattr(implot, "end_plot", end)
    section(hands, "Measure")
    hands.click("click points")
    hands.settle()
    for x in (600, 700, 760):
        hands.click_at(x, 480)
    panel = hands.window.panel
    assert len(panel.points) == 3
    (x0, y0, z0), *_, (x1, y1, z1) = panel.points
    profile = panel.profile
    assert profile.height[0] == pytest.approx(z0, abs=2)
    assert profile.height[-1] == pytest.approx(z1, abs=2)
    assert profile.length >= math.hypot(x1 - x0, y1 - y0) * 0.95
    assert profile.height == pytest.approx(hands.window.session.data.height_at(*profile.points.T), nan_ok=True)
    # the plot cuts nothing off the line, which has a width
    hands.draw(3)
    low, high = float(np.nanmin(profile.height)), float(np.nanmax(profile.height))
    assert limits[-1].min < low - 0.03 * (high - low) < high + 0.03 * (high - low) < limits[-1].max
    # dragging still moves the camera, and measures nothing
    hands.send("pointer_down", x=650, y=480)
    hands.send("pointer_move", x=680, y=480)
    hands.send("pointer_up", x=680, y=480)
    assert len(panel.points) == 3
    hands.press("Escape")
    hands.draw(2)
    assert panel.points == []
    assert not panel.measuring


def test_a_flight_of_keyframes_is_edited_played_saved_and_loaded(hands, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    section(hands, "Flight")
    panel, controls = hands.window.panel, hands.window.controls
    hands.click("play")
    assert "at least 2 keyframes" in hands.widgets.problems["play"]
    first = controls.camera
    hands.click("add keyframe (K)")
    hands.send("wheel", dx=0.0, dy=-300.0, x=GROUND[0], y=GROUND[1])
    hands.settle()
    second = hands.window.controls.camera
    hands.press("k")
    assert panel.keyframes.times == [0.0, 3.0]
    hands.draw(2)
    hands.type("##t1", "0")
    assert "expected more than 0 s" in hands.widgets.problems["##t1"]
    hands.type("##t1", "0.5")
    assert panel.keyframes.times == [0.0, 0.5]
    hands.click("play")
    assert panel.player
    seen = []
    while panel.player:
        hands.draw()
        seen.append(hands.window.controls.camera)
    assert len(seen) > 1
    hands.type("save as", "mine.json")
    flight = Flight.load("mine.json")
    assert flight.duration == 0.5
    assert (flight.keyframes[1].x, flight.keyframes[1].heading) == pytest.approx((second.x, second.heading))
    hands.type("save as", "mine.json")
    assert "exists already" in hands.widgets.problems["save as"]
    hands.type("load", "orbit")
    assert len(panel.keyframes.times) > 2
    hands.type("load", "nothing.json")
    assert "expected a flight file" in hands.widgets.problems["load"]
    assert first != second


def test_a_flight_is_recorded(hands):
    panel, controls = hands.window.panel, hands.window.controls
    panel.keyframes.start(0.0)
    for t in np.arange(0, 2.05, 0.1):
        panel.keyframes.record(float(t), controls.camera.moved(x=controls.camera.x + 10 * float(t)))
    panel.keyframes.stop()
    assert panel.keyframes.times == pytest.approx([0, 0.5, 1.0, 1.5, 2.0], abs=0.11)
    path = panel.path()
    assert path.camera_at(1.2).x == pytest.approx(controls.camera.x + 12, abs=0.5)


def test_a_flight_is_written_as_a_video(hands, tmp_path):
    av = pytest.importorskip("av")
    from orogen.view.player import Exporter, VideoSettings

    panel, session = hands.window.panel, hands.window.session
    panel.keyframes.add(hands.window.controls.camera)
    panel.keyframes.add(hands.window.controls.camera.moved(z=hands.window.controls.camera.z + 500))
    panel.keyframes.set_time(1, 0.2)
    path = tmp_path / "flight.mkv"
    wanted = VideoSettings((64, 48), 25, samples=1)
    panel.exporter = Exporter(session.renderer, panel.path(), path, wanted, session.style, session.scene)
    while panel.exporter:
        hands.draw()
    with av.open(str(path)) as video:
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(frames) == 5
    expected = session.data.render(panel.path().camera_at(4 / 25), (64, 48), samples=1).color
    assert np.abs(frames[4].astype(int) - expected[..., :3]).max() <= 2
    # one that is given up leaves nothing
    gone = tmp_path / "gone.mkv"
    panel.exporter = Exporter(session.renderer, panel.path(), gone, wanted, session.style, session.scene)
    panel.frame(0.0)
    panel.exporter.cancel()
    panel.exporter = None
    assert [file.name for file in tmp_path.glob("*gone*")] == []


def test_size_rate_and_quality_of_a_video_are_chosen_in_the_panel(hands, tmp_path):
    av = pytest.importorskip("av")
    panel = hands.window.panel
    panel.keyframes.add(hands.window.controls.camera)
    panel.keyframes.add(hands.window.controls.camera.moved(z=hands.window.controls.camera.z + 500))
    panel.keyframes.set_time(1, 0.25)
    section(hands, "Flight")
    hands.type("video size", "64 x 48")
    hands.type("video rate (1/s)", "12")
    assert hands.widgets.problems == {}
    panel.video = replace(panel.video, quality="low")
    hands.type("video", str(tmp_path / "small.mp4"))
    while panel.exporter:
        hands.draw()
    assert hands.widgets.problems == {}
    with av.open(str(tmp_path / "small.mp4")) as video:
        stream = video.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (64, 48, 12)
        assert sum(1 for _ in video.decode(video=0)) == 3


def test_a_picture_of_any_size_is_written(hands, tmp_path):
    section(hands, "Picture")
    hands.type("size", "300 x 70")
    hands.type("write to", str(tmp_path / "picture.png"))
    assert hands.widgets.problems == {}
    with Image.open(tmp_path / "picture.png") as picture:
        assert picture.size == (300, 70)
    hands.type("size", "0 x 70")
    assert "expected 1 to" in hands.widgets.problems["size"]
    hands.type("write to", str(tmp_path / "picture.jpg"))
    assert "suffix" in hands.widgets.problems["write to"]
