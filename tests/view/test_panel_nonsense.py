"""Bad input in every field of the panel: a message beside the field, and the view goes on."""

import math

import numpy as np
import pytest

from orogen.errors import SettingsError
from orogen.lod import algorithms
from orogen.view.forms import changed, form_of
from orogen.view.widgets import shortened

TEXTS = ("nonsense", "", "nan", "inf", "-1e30", "1e400", "0", "9" * 40, "\x00", "1 2 3", "../..", "%s%n", "ä" * 300)
NUMBERS = (math.nan, math.inf, -math.inf, -1e30, 1e30, 0.0, -1.0)
FREE = {"bookmark", "##t0", "##t1"}
"""Fields for which "nonsense" is fine (a name), or that are tried by themselves."""
PATHS = {"Open", "other data"}
"""Fields whose message comes when opening has failed."""


@pytest.fixture
def panel(hands, tmp_path, monkeypatch):
    """The panel with everything open that has a field."""
    monkeypatch.chdir(tmp_path)
    hands.draw(3)
    session, panel = hands.window.session, hands.window.panel
    session.use("udlod")
    session.compare("cdlod", {"pixels_per_quad": 32})
    panel.keyframes.add(hands.window.controls.camera)
    panel.keyframes.add(hands.window.controls.camera.moved(z=hands.window.controls.camera.z + 500))
    return panel


@pytest.fixture
def fields(panel, hands, monkeypatch):
    """What every field of the panel does with its input, by the field's name."""
    found = {"text": {}, "slider": {}, "choice": {}}
    for kind, actions in found.items():
        drawn = getattr(panel.widgets, kind)

        def record(name, value, *given, drawn=drawn, actions=actions, place=1 if kind != "text" else 0, **options):
            actions[name] = given[place]
            drawn(name, value, *given, **options)

        monkeypatch.setattr(panel.widgets, kind, record)
    monkeypatch.setattr(panel.widgets, "section", lambda name, open=False: True)
    hands.draw(2)
    return found


def opened(hands):
    while hands.window.session.opening:
        hands.draw()


def test_nonsense_that_is_typed_is_told_beside_its_field(panel, hands, monkeypatch):
    """With the keyboard, section by section."""
    shown, tried = [], 0
    monkeypatch.setattr(panel.widgets, "section", lambda name, open=False: name in shown)
    for name in ("Data", "Algorithm", "Look", "Move", "Compare", "Flight", "Picture"):
        names = []
        with monkeypatch.context() as patch:
            drawn = panel.widgets.text

            def note(field, *given, drawn=drawn, names=names, **options):
                names.append(field)
                drawn(field, *given, **options)

            patch.setattr(panel.widgets, "text", note)
            shown[:] = [name]
            hands.draw()
        for field in dict.fromkeys(names):
            if field in FREE:
                continue
            hands.type(field, "nonsense")
            opened(hands)
            message = hands.window.session.problem if field in PATHS else panel.widgets.problems[field]
            assert message, field
            tried += 1
    assert tried >= 12
    assert np.asarray(hands.draw()).std() > 5


def test_no_text_in_any_field_stops_the_view(panel, fields, hands):
    names = [name for name in fields["text"] if not name.startswith("##")]
    assert len(names) >= 12
    for name in names:
        for text in TEXTS[:3] if name in PATHS else TEXTS[::2]:
            panel.widgets.attempt(name, lambda name=name, text=text: fields["text"][name](text))
            opened(hands)
        hands.draw()
    assert not hands.window.session.opened
    assert np.asarray(hands.draw()).std() > 5


def test_a_field_that_is_emptied_says_what_belongs_there(panel, fields, hands):
    for name, put in fields["text"].items():
        if name != "bookmark":  # names it by itself
            assert not panel.widgets.attempt(name, lambda put=put: put("  ")), name
            assert "got nothing" in panel.widgets.problems[name], name


def test_no_number_in_any_slider_stops_the_view(panel, fields, hands):
    """A slider takes any number that is typed into it."""
    assert len(fields["slider"]) >= 8
    for name, put in fields["slider"].items():
        told = []
        for number in NUMBERS:
            told.append(not panel.widgets.attempt(name, lambda put=put, number=number: put(number)))
            hands.draw()
        assert told[0], f"{name} takes what is no number"
    assert np.asarray(hands.draw()).std() > 5


@pytest.mark.parametrize("name", algorithms())
def test_settings_are_taken_or_refused_whatever_is_typed(name):
    kind = algorithms()[name].Settings
    for field in form_of(kind):
        problems = [problem(kind, name, field.name, text) for text in TEXTS]
        told = [text for text in problems if text]
        assert told, field.name
        assert all(field.name in text or field.name.replace("_", " ") in text for text in told), told


def problem(kind, name, field, text):
    """What a form says to a text in a field; "" where it takes it."""
    try:
        changed(kind, name, {}, field, text)
    except SettingsError as error:
        return str(error)
    return ""


def test_nonsense_that_is_typed_into_a_slider_is_told_beside_it(panel, hands, monkeypatch):
    """A double click or Ctrl-click makes a text field of it."""
    monkeypatch.setattr(panel.widgets, "section", lambda name, open=False: name == "Look")
    hands.draw(3)
    session = hands.window.session
    before, sun = session.scene.exaggeration, session.style.sun
    for text in ("letters", "nan", "1e400", "-5", "", "9" * 60, "ä漢" * 40):
        panel.widgets.problems.clear()
        hands.draw(4)
        hands.send("key_down", key="Control")
        hands.click("exaggeration")
        hands.send("key_up", key="Control")
        hands.overwrite(text)  # all of it is selected
        hands.settle()
        assert "expected" in panel.widgets.problems["exaggeration"], text
        assert len(panel.widgets.problems) == 1
        assert (session.scene.exaggeration, session.style.sun) == (before, sun)
        assert not panel._gui.typing
    panel.widgets.problems.clear()
    hands.draw(4)
    x, y = panel.widgets.places["sun height (°)"]
    hands.send("pointer_move", x=x, y=y)
    hands.draw()
    for kind in 2 * ("pointer_down", "pointer_up"):
        hands.send(kind, x=x, y=y)
        hands.draw()
    for letter in "52":
        hands.send("char", data=letter)
    hands.draw()
    hands.press("Enter")
    hands.settle()
    assert session.style.sun[1] == 52
    assert not panel.widgets.problems


def test_messages_and_names_stay_short(panel, hands):
    assert len(shortened("a" + "x" * 5000 + ": no such file")) < 320
    assert shortened("x" * 5000 + ": no such file").endswith(": no such file")
    assert not panel.widgets.attempt("bookmark", lambda: panel.add_bookmark("x" * 61))
    assert "1 to 60 letters" in panel.widgets.problems["bookmark"]
