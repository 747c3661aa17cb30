"""Letters that the panel's own font lacks."""

import shutil

import numpy as np
import pytest
from rendercanvas.offscreen import OffscreenRenderCanvas

import orogen
from orogen.view import fonts, gui
from orogen.view.session import Session
from orogen.view.window import Window

GEORGIAN = "თბილისი"


@pytest.fixture
def named():
    """What a window's picture shows where it says who is to be named."""
    pytest.importorskip("imgui_bundle")

    def show(attribution):
        with orogen.open(np.zeros((9, 9)), spacing=30.0, attribution=attribution) as terrain:
            window = Window(Session(terrain), canvas=OffscreenRenderCanvas(size=(600, 200), pixel_ratio=1.0))
            for _ in range(20):  # the picture is at rest, and so is the panel
                picture = np.asarray(window.canvas.draw())
            assert window.error is None
            assert not window.panel.settling
            window.close()
        return picture[160:, 300:, :3].astype(int)

    return show


def has(letter):
    return fonts.font_with(letter) is not None


def test_greek_and_cyrillic_are_in_the_panel_s_font(named, monkeypatch):
    monkeypatch.setattr(gui, "font_with", lambda letter: pytest.fail(f"{letter!r} is looked for"))
    named("Ελλάδα, Україна, Việt Nam, Łódź")


def test_other_letters_come_from_a_font_of_this_machine(named, monkeypatch):
    if not has(GEORGIAN[0]):
        pytest.skip("no font with Georgian letters here")
    found = named(GEORGIAN)
    monkeypatch.setattr(gui, "font_with", lambda letter: None)
    lacking, other = named(GEORGIAN), named(GEORGIAN[::-1])
    assert (np.abs(found - lacking).max(axis=-1) > 50).sum() > 30
    # placeholders are all alike, and there
    np.testing.assert_array_equal(lacking, other)
    assert (lacking.min(axis=-1) > 200).sum() > 30


def test_a_letter_that_no_font_has_is_looked_for_once(named, monkeypatch):
    asked = []
    monkeypatch.setattr(gui, "font_with", asked.append)
    named("中" + GEORGIAN[0])
    assert asked == sorted(["中", GEORGIAN[0]])


@pytest.mark.parametrize("system", ["darwin", "win32", "linux"])
def test_a_font_is_taken_only_where_it_has_the_letter(system, tmp_path, monkeypatch):
    import imgui_bundle

    own = f"{imgui_bundle.__path__[0]}/assets/fonts/Roboto/Roboto-Regular.ttf"
    (tmp_path / "damaged.ttf").write_bytes(b"no font")
    shutil.copy(own, tmp_path / "good.ttf")
    monkeypatch.setattr(fonts.sys, "platform", system)
    monkeypatch.setitem(fonts.FOLDERS, system, (str(tmp_path / "nowhere"), str(tmp_path)))
    names = "absent.ttf", "damaged.ttf", "good.ttf"
    if system == "linux":
        monkeypatch.setattr(fonts, "_listed", lambda letter: [(str(tmp_path / name), 0) for name in names])
    else:
        monkeypatch.setitem(fonts.FILES, system, names)
    monkeypatch.setattr(fonts, "_lacking", set())
    assert fonts.font_with("Ж") == (str(tmp_path / "good.ttf"), 0)
    assert fonts.font_with("ა") is None
    # the letters beside it are not looked for again
    monkeypatch.setattr(fonts, "_has", lambda *_: pytest.fail("looked for again"))
    assert fonts.font_with("ბ") is None


def test_what_fontconfig_says_is_put_in_order(monkeypatch):
    lines = ["0|200|100|0|/bold.ttf", "100|80|100|0|/slanted.ttf", "0|[0 200]|100|65538|/any|thing.ttc", ""]
    monkeypatch.setattr(fonts.shutil, "which", lambda name: f"/usr/bin/{name}")
    done = type("Done", (), {"stdout": "\n".join(lines[:3]).encode()})
    monkeypatch.setattr(fonts.subprocess, "run", lambda *given, **options: done)
    assert list(fonts._listed("中")) == [("/any|thing.ttc", 2), ("/bold.ttf", 0), ("/slanted.ttf", 0)]
    monkeypatch.setattr(fonts.shutil, "which", lambda name: None)
    assert list(fonts._listed("中")) == []
