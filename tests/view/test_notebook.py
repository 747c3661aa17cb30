import asyncio
import base64
import io
import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from wgpu import GPUPromise

import orogen
from oracle.frontend import FrontEnd
from orogen.errors import OutputError
from orogen.view import notebook
from orogen.view.session import Session
from orogen.view.window import Window

PROMISES = GPUPromise._UNRESOLVED
EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "example.ipynb"


def decoded(text):
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text)))).astype(int)


def test_the_example_runs_in_a_kernel(monkeypatch, tmp_path):
    """A kernel with nobody in front of it: the widget is there for who comes, and a picture for who does not."""
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    pytest.importorskip("anywidget")
    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    notebook = nbformat.read(EXAMPLE, as_version=4)
    nbclient.NotebookClient(notebook, timeout=100, kernel_name="python3").execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    results = [output.data for output in outputs if output.output_type == "execute_result"]
    (shown,) = [data for data in results if "image/jpeg" in data]
    picture = decoded(shown["image/jpeg"])
    assert picture.shape == (540, 960, 3)
    assert picture.std() > 20
    assert shown["application/vnd.jupyter.widget-view+json"]["model_id"]
    assert "(270, 480, 4), (270, 480)" in results[-1]["text/plain"]


def test_the_example_s_widget_answers_its_page(monkeypatch, tmp_path, record_property):
    """The cells up to the widget in a real kernel, and a page in front of it that speaks Jupyter's protocol."""
    manager = pytest.importorskip("jupyter_client").KernelManager(kernel_name="python3")
    pytest.importorskip("ipykernel")
    pytest.importorskip("anywidget")
    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    cells = [c for c in json.loads(EXAMPLE.read_text(encoding="utf-8"))["cells"] if c["cell_type"] == "code"]
    codes = ["".join(cell["source"]) for cell in cells]
    manager.start_kernel()
    client = manager.blocking_client()
    try:
        client.start_channels()
        client.wait_for_ready(timeout=60)
        page = FrontEnd(client)
        page.run(codes[0])
        shown = page.run(codes[1])
        model = shown["application/vnd.jupyter.widget-view+json"]["model_id"]
        assert page.opened[model]["_esm"]
        page.show(model, (320, 180))
        before = page.settled(model).astype(int)
        assert before.shape == (180, 320, 3)
        # what is at rest is what the terrain renders from there
        code = "import io, base64, numpy; base64.b64encode(terrain.render(view.window.controls.camera, (320, 180), "
        code += "samples=16).color.tobytes()).decode()"
        page.run("view.window.panel.visible = False")
        page.tell(model, "key_down", key="F5")
        plain = page.settled(model).astype(int)
        pixels = base64.b64decode(page.run(code)["text/plain"].strip("'"))
        expected = np.frombuffer(pixels, np.uint8).reshape(180, 320, 4)[..., :3].astype(int)
        assert np.abs(plain[20:120, :250] - expected[20:120, :250]).mean() < 2
        # events move it, and the next picture shows it
        start = time.perf_counter()
        page.tell(model, "wheel", x=160, y=90, dx=0.0, dy=-300.0)
        page.picture(model)
        record_property("input_to_picture_ms", round(1000 * (time.perf_counter() - start), 1))
        after = page.settled(model).astype(int)
        assert (np.abs(after - plain).max(axis=-1) > 8).mean() > 0.3
        # what is no event does no harm
        page.tell(model, "nonsense")
        assert page.run("view.window.error is None")["text/plain"] == "True"
        page.run(codes[-1])
        assert model in page.closed
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)


def test_the_example_holds_no_results():
    cells = json.loads(EXAMPLE.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(code) >= 5
    assert not [cell for cell in code if cell["outputs"] or cell["execution_count"]]


@pytest.fixture
def kernel(monkeypatch):
    """As seen from a kernel."""
    monkeypatch.setattr(notebook, "in_notebook", lambda: True)


def test_without_a_widget_there_is_a_picture(terrain, kernel, monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "rendercanvas.anywidget", None)
    camera = terrain.camera(heading=120.0)
    view = terrain.view(camera, size=(160, 90))
    assert "orogen[notebook]" in caplog.text
    bundle = view._repr_mimebundle_()
    assert set(bundle) == {"text/plain", "image/jpeg"}
    expected = terrain.render(camera, (160, 90)).color[..., :3].astype(int)
    assert np.abs(decoded(bundle["image/jpeg"]) - expected).mean() < 3
    view.close()


class Page:
    """The front end's part, played by hand: it says its size, and what it has shown."""

    def __init__(self, view, size=(160, 90)):
        self.widget, self.sent = view.window.canvas, []
        self.widget.send = lambda message, buffers=None: self.sent.append((message, buffers))
        place = {"width": size[0], "height": size[1], "pwidth": size[0], "pheight": size[1], "ratio": 1.0}
        self.tell("resize", **place)
        self.seen(True)

    def tell(self, kind, **event):
        self.widget._handle_custom_msg({"type": kind, "timestamp": 0, "modifiers": [], **event}, [])

    def seen(self, whether):
        self.widget._has_visible_views = whether

    def confirm(self):
        """Say that all pictures so far are shown."""
        if self.sent:
            index = self.sent[-1][0]["index"]
            self.widget._frame_feedback = {"index": index, "timestamp": 0, "localtime": 0}

    async def frames(self, count, confirm=True):
        """Wait for so many pictures."""
        end = len(self.sent) + count
        for _ in range(2000):
            await asyncio.sleep(0.02)
            if confirm:
                self.confirm()
            if len(self.sent) >= end:
                return
        raise AssertionError(f"{end - len(self.sent)} pictures never came")


async def told():
    """Wait until wgpu has told this event loop what it was asked for: it complains of loops that it finds closed."""
    loop = asyncio.get_running_loop()
    for _ in range(200):
        await asyncio.sleep(0.05)
        if not any(getattr(each._call_soon_threadsafe, "__self__", None) is loop for each in PROMISES.copy()):
            break
    await asyncio.sleep(0.1)


def played(terrain, play, *more):
    """Play with views of a terrain."""
    pytest.importorskip("anywidget")

    async def run():
        views = [terrain.view(size=(160, 90), panel=False, **options) for options in ({}, *more)]
        try:
            await play(*views)
        finally:
            for view in views:
                view.close()
            await told()

    asyncio.run(run())


def test_the_widget_draws_what_the_front_end_asks_for(terrain, kernel):
    sent = []

    async def play(view):
        page = Page(view)
        await page.frames(3)
        sent.extend(page.sent)

    played(terrain, play)
    message, buffers = sent[-1]
    picture = np.asarray(Image.open(io.BytesIO(buffers[0])))
    assert message["type"] == "framebufferdata"
    assert picture.shape[:2] == (90, 160)
    assert picture[..., :3].std() > 5


def test_a_page_that_is_loaded_again_in_a_flight_goes_on(terrain, kernel):
    async def play(view):
        page = Page(view)
        await page.frames(2)
        page.tell("key_down", key="Tab")
        page.tell("key_down", key="w")
        await page.frames(3)
        # two pictures are under way when it goes; nobody confirms them
        await page.frames(2, confirm=False)
        page.seen(False)
        again = Page(view)
        await again.frames(3)
        # nor did anybody tell that the key was released
        assert not view.window.controls._keys

    played(terrain, play)


def test_views_of_one_terrain_go_their_own_ways(terrain, kernel):
    async def play(one, other):
        pages = Page(one), Page(other, (120, 100))
        for page in pages:
            await page.frames(2)
        shown = one.window.session.pick(80, 60)
        camera = one.window.controls.camera
        pages[1].tell("wheel", x=60, y=60, dx=0.0, dy=-300.0)
        await pages[1].frames(3)
        assert one.window.controls.camera == camera
        assert one.window.session.pick(80, 60) == shown
        other.session.use("brute")
        assert one.session.renderer.algorithm.name != "brute"
        # one that nobody sees holds no pictures
        before = terrain.renderer.gpu.memory.total
        pages[1].seen(False)
        assert terrain.renderer.gpu.memory.total < before - 100_000
        pages[1].seen(True)
        await pages[1].frames(1)
        assert other.session.renderer.shown is not None

    played(terrain, play, {})


def test_a_device_that_is_lost_with_a_picture_under_way(kernel):
    async def play(view):
        page = Page(view)
        await page.frames(1)
        lost = view.session.device
        lost.destroy()
        page.tell("wheel", x=80, y=60, dx=0.0, dy=-100.0)
        await page.frames(4)
        assert view.session.device is not lost
        assert view.window.error is None

    with orogen.open(np.zeros((40, 40), np.float32), spacing=30.0) as own:
        played(own, play)


def test_a_view_that_ends_says_so_above_its_picture(kernel, caplog):
    terrain = orogen.open(np.zeros((40, 40), np.float32), spacing=30.0)

    async def run():
        view = terrain.view(size=(160, 90), panel=False)
        page = Page(view)
        await page.frames(1)
        terrain.close()
        page.tell("pointer_down", x=80, y=60, button=1, buttons=[1])
        for _ in range(2000):
            await asyncio.sleep(0.02)
            page.confirm()
            page.tell("pointer_move", x=80, y=60, button=0, buttons=[1])
            if page.widget._title:
                break
        assert "expected an open terrain" in page.widget._title
        view.close()
        await told()

    pytest.importorskip("anywidget")
    asyncio.run(run())
    assert "the view has ended" in caplog.text


def test_closing_gives_the_terrain_back_where_it_is_the_view_s_own(kernel, monkeypatch):
    monkeypatch.setitem(sys.modules, "rendercanvas.anywidget", None)
    heights = np.zeros((20, 20), np.float32)
    for owned in (False, True):
        terrain = orogen.open(heights, spacing=1.0)
        terrain.view(owned=owned).close()
        assert terrain._closed is owned
        terrain.close()


def test_elsewhere_there_is_a_window(terrain, monkeypatch):
    assert not notebook.in_notebook()
    made = []

    class Recorder(Window):
        def __init__(self, session, **options):
            made.append((session, options))
            raise OutputError("no window here")

    monkeypatch.setattr("orogen.view.window.Window", Recorder)
    camera = terrain.camera(heading=10.0)
    with pytest.raises(OutputError, match="no window here"):
        terrain.view(camera, size=(300, 200), title="hills", panel=False)
    session, options = made[0]
    assert isinstance(session, Session)
    assert session.camera == camera
    assert options == {"size": (300, 200), "title": "hills", "panel": False}
