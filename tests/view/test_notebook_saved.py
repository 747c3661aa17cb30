"""What a reader sees of a view in a notebook without a kernel: as it was saved, or exported as a page."""

import base64
import io
import json
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from oracle import chromium
from orogen.view import notebook

MODEL = """
(async () => {
  const state = JSON.parse(atob("STATE"))
  const model = { get: name => state[name], set: () => {}, save_changes: () => {}, send: () => {}, on: (name, told) => {
    if (name === 'msg:custom') { window.tell = told }
  } }
  const url = URL.createObjectURL(new Blob([state._esm], { type: 'text/javascript' }))
  const widget = (await import(url)).default()
  const el = document.body.appendChild(document.createElement('div'))
  widget.initialize({ model })
  widget.render({ model, el })
  await el.querySelector('img').decode()
  return 0
})()
"""
FRAME = (
    "(window.tell({type: 'framebufferdata', data_b64: 'FRAME', index: 1, timestamp: 0, mimetype: 'image/png'}, []), 0)"
)
CELLS = (
    "import numpy, orogen\n"
    "terrain = orogen.open(numpy.add.outer(numpy.arange(40.0), 5 * numpy.sin(numpy.arange(50.0))), spacing=30.0)",
    "terrain.view(size=(320, 180))",
)


@pytest.fixture
def saved(terrain, monkeypatch):
    """What a cell shows, and the state of its widget that a notebook may save."""
    pytest.importorskip("anywidget")
    monkeypatch.setattr(notebook, "in_notebook", lambda: True)
    view = terrain.view(size=(160, 90))
    bundle = view._repr_mimebundle_()
    state = view.window.canvas.get_state()
    yield bundle, {name: value for name, value in state.items() if isinstance(value, str | int | bool | dict)}
    view.close()


def test_the_picture_is_saved_with_the_widget_s_state(saved):
    bundle, state = saved
    assert bundle["application/vnd.jupyter.widget-view+json"]["model_id"]
    assert state["kept"] == f"data:image/jpeg;base64,{bundle['image/jpeg']}"
    assert state["_esm"].count("export default") == 1
    picture = Image.open(io.BytesIO(base64.b64decode(bundle["image/jpeg"])))
    assert picture.size == (160, 90)


@pytest.mark.skipif(chromium.find() is None, reason="no Chromium here")
def test_a_saved_widget_shows_its_picture_until_a_frame_comes(saved, tmp_path):
    pytest.importorskip("websockets")
    _, state = saved
    text = base64.b64encode(json.dumps(state).encode()).decode()
    with chromium.Browser(tmp_path / "browser", (400, 300)) as browser:
        browser.run(MODEL.replace("STATE", text))
        assert browser.run("document.querySelector('img').src") == state["kept"]
        assert browser.run("document.querySelector('img').naturalWidth") == 160
        browser.run(FRAME.replace("FRAME", "data:image/png;base64,AA"))
        chromium.until(lambda: browser.run("document.querySelector('img').src").endswith(",AA"))
        assert not browser.faults


@pytest.mark.nightly
@pytest.mark.skipif(chromium.find() is None, reason="no Chromium here")
@pytest.mark.parametrize("stateful", [False, True])
def test_a_page_that_is_exported(stateful, tmp_path, monkeypatch):
    """Run and exported with one command."""
    pytest.importorskip("nbconvert")
    pytest.importorskip("websockets")
    from oracle import lab

    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    lab.write(tmp_path / "view.ipynb", CELLS)
    command = [sys.executable, "-m", "nbconvert", "--execute", "--to", "html", "view.ipynb"]
    options = [] if stateful else ["--ExecutePreprocessor.store_widget_state=False"]
    subprocess.run([*command, *options], cwd=tmp_path, check=True, timeout=110)
    page = (tmp_path / "view.html").read_text()
    if stateful:  # shown by a library from the internet
        assert '"kept": "data:image' in page
    with chromium.Browser(tmp_path / "browser", (1000, 700)) as browser:
        browser.open((tmp_path / "view.html").as_uri())
        chromium.until(lambda: browser.run("document.readyState") == "complete")
        assert "rror" not in browser.run("document.body.innerText")
        if not stateful:
            chromium.until(
                lambda: browser.run("document.querySelector('.jp-OutputArea-output img')?.naturalWidth") == 320
            )
            shown = np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB"))
            assert shown.std() > 10
