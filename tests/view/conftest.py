"""A small terrain in a window without a screen, and hands to move it; shared by the tests of this room."""

import numpy as np
import pytest
from rendercanvas.offscreen import OffscreenRenderCanvas

import orogen
from orogen.view import renderer
from orogen.view.session import Session
from orogen.view.window import Window

SIZE, RATIO = (900, 1000), 0.25  # room for the whole panel, and few pixels


def hills(rows=96, columns=128):
    """Smooth heights (m) of 100 to 1100, with a slope that tells east from west."""
    y, x = np.mgrid[0:rows, 0:columns] / 16.0
    return (600 + 300 * np.sin(x) * np.cos(0.7 * y) + 4.0 * (x * 16 - columns / 2) / 2).astype(np.float32)


class Canvas(OffscreenRenderCanvas):
    """An offscreen canvas that counts how often a picture is asked for."""

    requests = 0

    def request_draw(self, draw_function=None):
        self.requests += 1
        super().request_draw(draw_function)


class Hands:
    """What a user does to a window."""

    def __init__(self, window):
        self.window = window
        self.canvas = window.canvas

    @property
    def widgets(self):
        return self.window.panel.widgets

    def send(self, kind, **event):
        self.canvas.submit_event({"modifiers": (), "button": 1, "buttons": (), **event, "event_type": kind})
        self.canvas._process_events()

    def draw(self, count=1):
        for _ in range(count):
            picture = np.asarray(self.canvas.draw())
            if self.window._error:
                raise self.window._error
        return picture

    def settle(self, limit=200):
        """Draw until nothing more is asked for; gives the last picture."""
        for _ in range(limit):
            before = self.canvas.requests
            picture = self.draw()
            if self.canvas.requests == before:
                return picture
        raise AssertionError("the window never comes to rest")

    def press(self, key):
        self.send("key_down", key=key)
        self.send("key_up", key=key)

    def click_at(self, x, y, draws=1):
        self.send("pointer_move", x=x, y=y)
        self.draw(draws)
        self.send("pointer_down", x=x, y=y)
        self.draw(draws)
        self.send("pointer_up", x=x, y=y)
        return self.draw(2)

    def click(self, name):
        """Click a field of the panel, once it has found its place."""
        places = []
        while len(places) < 4 or len(set(places[-4:])) > 1:
            self.draw()
            places.append(self.widgets.places.get(name))
        return self.click_at(*self.widgets.places[name])

    def type(self, name, text):
        """Replace what a text field holds, and press Enter."""
        self.click(name)
        self.send("key_down", key="Control")
        self.send("key_down", key="a")
        self.draw()
        self.send("key_up", key="a")
        self.send("key_up", key="Control")
        self.overwrite(text)

    def overwrite(self, text):
        """Replace what is selected in a text field, and press Enter."""
        self.send("key_down", key="Backspace")
        self.draw()
        self.send("key_up", key="Backspace")
        for letter in text:
            self.send("char", data=letter)
        self.draw()
        self.press("Enter")
        self.draw(2)

    def slide(self, name, x_part):
        """Drag a slider to a part of its width."""
        left, y = self.widgets.places[name]
        left -= 35
        self.send("pointer_move", x=left + 40, y=y)
        self.draw()
        self.send("pointer_down", x=left + 40, y=y)
        self.draw()
        self.send("pointer_move", x=left + 175 * x_part, y=y)
        self.draw()
        self.send("pointer_up", x=left + 175 * x_part, y=y)
        self.draw(2)


@pytest.fixture(scope="module")
def terrain():
    """Hills in UTM, 30 m apart."""
    with orogen.open(hills(), spacing=30.0, crs="EPSG:32611") as opened:
        yield opened


@pytest.fixture(autouse=True)
def _own_bookmarks(tmp_path, monkeypatch):
    monkeypatch.setenv("OROGEN_CONFIG_DIR", str(tmp_path / "config"))


@pytest.fixture
def hands(terrain, monkeypatch):
    """A window with its panel, which is at rest after few samples."""
    pytest.importorskip("imgui_bundle")
    monkeypatch.setattr(renderer, "STILL_SAMPLES", 2)
    window = Window(
        Session(terrain, opener=lambda text: orogen.open(text, build="background")),
        canvas=Canvas(size=SIZE, pixel_ratio=RATIO),
    )
    yield Hands(window)
    window.close()
    terrain.use()


@pytest.fixture
def bare(terrain):
    """A window without a panel."""
    window = Window(Session(terrain), canvas=Canvas(size=(200, 100), pixel_ratio=1.5), panel=False)
    yield Hands(window)
    window.close()
    terrain.use()
