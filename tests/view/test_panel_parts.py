"""Parts of the panel that know nothing of imgui: forms, bookmarks, keyframes, quality, history."""

import json
import logging
from dataclasses import dataclass

import pytest

from orogen.camera import Camera
from orogen.errors import OutputError, SettingsError
from orogen.lod import algorithms
from orogen.view.bookmarks import Bookmarks
from orogen.view.forms import changed, docstrings, form_of, text_of
from orogen.view.history import History, Sample
from orogen.view.keyframes import Keyframes
from orogen.view.quality import STEPS, Quality, QualitySettings

CAMERA = Camera(1.0, 2.0, 3.0)


@dataclass(frozen=True)
class Settings:
    """An example."""

    share: float = 0.25
    """Share of a level, from 0 to 1."""
    size: int = 16
    """Rows of quads in pixels: an even number from 2 to 64.
    More text."""
    limit: float | None = None
    """Metres, or none."""
    quick: bool = True
    """Whether it is quick."""
    name: str = "plain"
    """A word."""

    def __post_init__(self):
        if self.size % 2:
            raise SettingsError(f"size: expected an even number, got {self.size}")


def test_forms_of_settings():
    form = {field.name: field for field in form_of(Settings)}
    assert [(f.kind, f.limits, f.optional) for f in form.values()] == [
        ("float", (0.0, 1.0), False), ("int", (2.0, 64.0), False), ("float", None, True), ("bool", None, False),
        ("text", None, False),
    ]  # fmt: skip
    assert form["size"].label == "size (px)"
    assert form["size"].help.endswith("from 2 to 64. More text.")
    assert form["limit"].label == "limit (m)"


def test_every_algorithm_has_a_form_whose_defaults_are_accepted():
    for name, kind in algorithms().items():
        for field in form_of(kind.Settings):
            assert field.help, (name, field.name)
            values = changed(kind.Settings, name, {}, field.name, text_of(field.default))
            assert getattr(kind.Settings(), field.name) == field.default
            assert list(values) == [field.name]
            if field.limits and isinstance(field.default, int | float):
                assert field.limits[0] <= field.default <= field.limits[1], (name, field.name)


def test_typed_values():
    assert changed(Settings, "x", {"share": 0.5}, "size", " 8 ") == {"share": 0.5, "size": "8"}
    with pytest.raises(SettingsError, match="share: expected a value, got nothing; by default it is"):
        changed(Settings, "x", {"share": 0.5}, "share", " ")
    for name, text in (("size", "7"), ("size", "many"), ("quick", "perhaps")):
        with pytest.raises(SettingsError):
            changed(Settings, "x", {}, name, text)


def test_without_source_there_is_no_help():
    made = type("Made", (), {})
    assert docstrings(made) == {}


def test_bookmarks_survive_and_keep_to_their_data(tmp_path):
    kept = Bookmarks("/data/a.tif", tmp_path)
    kept.add(" peak ", CAMERA)
    kept.add("valley", CAMERA.moved(orthographic=50.0))
    assert dict(Bookmarks("/data/a.tif", tmp_path).cameras) == {
        "peak": CAMERA,
        "valley": CAMERA.moved(orthographic=50.0),
    }
    assert Bookmarks("/data/b.tif", tmp_path).cameras == {}
    kept.remove("peak")
    assert list(Bookmarks("/data/a.tif", tmp_path).cameras) == ["valley"]
    with pytest.raises(SettingsError, match="expected a name"):
        kept.add("  ", CAMERA)


@pytest.mark.parametrize(
    "content", ["", "[]", '{"cameras": {"a": {"x": 1}}}', '{"cameras": {"a": 3}}', '{"cameras": 1}']
)
def test_damaged_bookmarks_are_told_and_kept(tmp_path, caplog, content):
    Bookmarks("data", tmp_path).add("a", CAMERA)
    (path,) = tmp_path.glob("*.json")
    path.write_text(content)
    with caplog.at_level(logging.WARNING, "orogen"):
        again = Bookmarks("data", tmp_path)
    assert again.cameras == {}
    assert "cannot be read" in caplog.text
    again.add("b", CAMERA)
    assert path.read_text() == content


def test_bookmarks_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    kept = Bookmarks("data", tmp_path / "file")
    with pytest.raises(OutputError, match="cannot be written"):
        kept.add("a", CAMERA)
    assert kept.cameras == {}


def test_keyframes_are_edited():
    keys = Keyframes()
    for x in (0.0, 10.0, 30.0):
        keys.add(CAMERA.moved(x=x))
    assert keys.times == [0.0, 3.0, 6.0]
    keys.set_time(1, 1.0)
    assert keys.times == [0.0, 1.0, 4.0]
    with pytest.raises(SettingsError, match=r"keyframe 3: expected more than 1 s, got 0\.5"):
        keys.set_time(2, 0.5)
    with pytest.raises(SettingsError, match="keyframe 1"):
        keys.set_time(0, 1.0)
    keys.replace(1, CAMERA.moved(x=20.0))
    keys.remove(0)
    assert (keys.times, [c.x for c in keys.cameras]) == ([0.0, 3.0], [20.0, 30.0])
    for change in (keys.add, lambda camera: keys.replace(0, camera)):
        with pytest.raises(SettingsError, match="perspective"):
            change(CAMERA.moved(orthographic=10.0))
    assert keys.flight().duration == 3.0
    keys.remove(0)
    with pytest.raises(SettingsError, match="at least 2 keyframes, got 1"):
        keys.flight()


def test_recordings_keep_rests():
    keys = Keyframes()
    keys.start(100.0)
    for t in (100.0, 100.3, 104.0, 104.4, 104.6):
        keys.record(t, CAMERA.moved(x=t))
    keys.stop()
    keys.record(110.0, CAMERA)
    assert keys.times == pytest.approx([0.0, 0.3, 4.0, 4.6])
    assert [c.x for c in keys.cameras] == [100.0, 100.3, 104.0, 104.6]


def fly(quality, cost, frames=400, screen=16.7):
    """Frames that take `cost` milliseconds at full size; gives the times of the second half."""
    times = []
    for _ in range(frames):
        work = 1 + cost * quality.scale**2
        times.append(max(work, screen))
        quality.took(times[-1], work)
    return times[frames // 2 :]


@pytest.mark.parametrize("cost", [5.0, 60.0, 150.0, 400.0])
def test_the_frame_time_is_kept(cost):
    quality = Quality(QualitySettings(frame_time=33.0))
    times = fly(quality, cost)
    assert max(times) <= 1.1 * 33.0
    assert quality.scale == 1.0 if cost < 30 else 1 + cost * (quality.scale * 1.45) ** 2 > 0.6 * 33.0


def test_the_picture_gets_fine_again_and_is_whole_at_rest():
    quality = Quality()
    fly(quality, 400.0)
    assert quality.size((1000, 500), moving=True)[0] <= 400
    assert quality.size((1000, 500), moving=False) == (1000, 500)
    fly(quality, 5.0)
    assert quality.scale == 1.0
    quality.settings = QualitySettings(adaptive=False)
    fly(quality, 400.0)
    assert quality.size((1000, 500), moving=True) == (1000, 500)


def test_the_coarsest_picture_is_a_setting():
    quality = Quality(QualitySettings(coarsest=0.5))
    fly(quality, 4000.0)
    assert quality.scale == 0.5
    with pytest.raises(SettingsError, match="frame_time"):
        QualitySettings(frame_time=1.0)
    with pytest.raises(SettingsError, match="coarsest"):
        QualitySettings(coarsest=STEPS[-1] / 2)


def test_history_keeps_the_latest_frames():
    history = History(length=3)
    for i in range(5):
        history.add(Sample(frame=i, cpu=2 * i, gpu={"shade": i} if i > 2 else {"rays": 9.0, "shade": i}))
    assert history.series("cpu").tolist() == [4, 6, 8]
    assert {name: values.tolist() for name, values in history.passes().items()} == {
        "shade": [2, 3, 4], "rays": [9, 0, 0]
    }  # fmt: skip


def test_bookmark_files_are_plain_json(tmp_path):
    Bookmarks("Größe", tmp_path).add("Überblick", CAMERA)
    (path,) = tmp_path.glob("*.json")
    stored = json.loads(path.read_text(encoding="utf-8"))
    assert (stored["data"], stored["cameras"]["Überblick"]["z"]) == ("Größe", 3.0)
