import numpy as np
import pytest
import wgpu
from rendercanvas.offscreen import OffscreenRenderCanvas

from orogen.camera import Camera
from orogen.errors import GpuError, OutputError
from orogen.grid import Grid
from orogen.view import window as window_module
from orogen.view.controls import FlyControls, Ground, OrbitControls
from orogen.view.window import Window

GRID = Grid(4000, 4000, (10.0, 0.0, 5e5, 0.0, -10.0, 4e6), "EPSG:32633")
GROUND = Ground(GRID, lambda x, y: 100.0, lambda column, row: (520000.0, 3980000.0, 100.0))
CAMERA = Camera(520000.0, 3975000.0, 3000.0, pitch=-30.0)


class Painter:
    """Clears the texture to a colour that tells the camera's heading, and notes what it was asked."""

    def __init__(self, device):
        self.device = device
        self.unfinished = False
        self.calls = []

    def draw(self, view, camera, size):
        self.calls.append((camera, size))
        encoder = self.device.create_command_encoder()
        clear = (camera.heading / 360, 0.25, 0.5, 1.0)
        attachment = {"view": view, "load_op": "clear", "store_op": "store", "clear_value": clear}
        encoder.begin_render_pass(color_attachments=[attachment]).end()
        self.device.queue.submit([encoder.finish()])
        return self.unfinished


class Canvas(OffscreenRenderCanvas):
    """An offscreen canvas that counts how often a picture is asked for."""

    requests = 0

    def request_draw(self, draw_function=None):
        self.requests += 1
        super().request_draw(draw_function)


@pytest.fixture(scope="module")
def device():
    return wgpu.gpu.request_adapter_sync().request_device_sync()


@pytest.fixture
def painter(device):
    return Painter(device)


@pytest.fixture
def window(painter):
    canvas = Canvas(size=(200, 100), pixel_ratio=1.5)
    yield Window(painter.device, painter.draw, CAMERA, GROUND, canvas=canvas)
    canvas.close()


def encoded(color):
    """8-bit values of a linear colour as the canvas shows it, in sRGB."""
    return np.append(np.round(255 * (1.055 * np.array(color[:3]) ** (1 / 2.4) - 0.055)), 255)


def send(window, kind, **event):
    window.canvas.submit_event({"modifiers": (), "button": 1, **event, "event_type": kind})
    window.canvas._process_events()


def test_the_canvas_shows_what_was_drawn(window, painter):
    window.controls.camera = CAMERA.moved(heading=90.0)
    picture = np.asarray(window.canvas.draw())
    assert picture.shape == (150, 300, 4)
    assert np.abs(picture - encoded([0.25, 0.25, 0.5, 1])).max() <= 1
    camera, size = painter.calls[-1]
    assert size == (300, 150)
    assert camera.heading == 90.0


def test_nothing_is_drawn_while_nothing_changes(window, painter):
    window.canvas.draw()
    before = window.canvas.requests
    send(window, "pointer_move", x=5, y=5, buttons=())
    send(window, "key_down", key="F5")
    window.canvas.draw()
    assert window.canvas.requests == before


def test_an_unfinished_picture_is_drawn_again(window, painter):
    window.canvas.draw()  # the first one tells the size
    painter.unfinished = True
    before = window.canvas.requests
    window.canvas.draw()
    assert window.canvas.requests == before + 1
    painter.unfinished = False
    window.canvas.draw()
    assert window.canvas.requests == before + 1


def test_events_move_the_camera_until_it_rests(window, painter):
    window.canvas.draw()
    before = window.canvas.requests
    send(window, "wheel", dx=0.0, dy=-300.0, x=100, y=50)
    assert window.canvas.requests == before + 1
    draws = 0
    while window.controls.moving and draws < 5000:
        asked = window.canvas.requests
        window.canvas.draw()
        draws += 1
        assert window.canvas.requests == asked + window.controls.moving
    assert painter.calls[-1][0].z == pytest.approx(100 + 2900 / 1.25**3, rel=1e-3)
    assert not window.controls.moving


def test_resizes_reach_the_controls_and_the_renderer(window, painter):
    window.canvas.set_logical_size(300, 120)
    window.canvas.draw()
    assert window.controls.size == (300, 120)
    assert painter.calls[-1][1] == (450, 180)


def test_tab_changes_the_controls_and_keeps_the_camera(window):
    camera = window.controls.camera
    assert isinstance(window.controls, OrbitControls)
    send(window, "key_down", key="Tab")
    assert isinstance(window.controls, FlyControls)
    assert window.controls.camera == camera
    send(window, "key_down", key="Tab")
    assert isinstance(window.controls, OrbitControls)
    window.controls.camera = camera.moved(orthographic=100.0)
    send(window, "key_down", key="Tab")
    assert isinstance(window.controls, OrbitControls)


def test_errors_while_drawing_are_raised_by_run(painter):
    def fail(*_):
        raise GpuError("lost")

    window = Window(painter.device, fail, CAMERA, GROUND, canvas=Canvas(size=(20, 10)))
    window.canvas.draw()
    with pytest.raises(GpuError, match="lost"):
        window.run()


def test_without_a_display_one_error_says_what_to_do(monkeypatch, painter):
    import glfw

    monkeypatch.setattr(glfw, "init", lambda: False)
    monkeypatch.setattr(glfw, "get_error", lambda: (65550, b"X11: The DISPLAY environment variable is missing"))
    with pytest.raises(OutputError, match=r"DISPLAY.*use orogen render"):
        window_module.Window(painter.device, painter.draw, CAMERA, GROUND)
