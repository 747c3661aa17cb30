"""`terrain.view()` in a real JupyterLab before a real browser."""

import json
import subprocess
import sys
import time

import numpy as np
import pytest

from oracle import chromium, lab

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(1200),
    pytest.mark.skipif(bool(lab.missing()), reason=lab.missing()),
]
HILLS = """import json, numpy as np, orogen
y, x = np.mgrid[0:256, 0:384] / 32
heights = (600 + 250 * np.sin(x) * np.cos(0.7 * y) + 40 * np.sin(5 * x + 3 * y)).astype(np.float32)
terrain = orogen.open(heights, spacing=30.0, crs="EPSG:32611")"""
VIEW, OTHER = "view = terrain.view(size=(760, 560))\nview", "other = terrain.view(size=(420, 300), panel=False)\nother"
STATE = """c, w = view.window.controls.camera, view.window
print(json.dumps({
    "camera": [c.x, c.y, c.z, c.heading], "size": w.canvas.get_logical_size(), "error": repr(w.error),
    "controls": type(w.controls).__name__, "sun": view.session.style.sun, "moving": w.moving,
    "places": w.panel.widgets.places, "memory": terrain.renderer.gpu.memory.total,
}))"""
LONG = "import time\nfor _ in range(100000):\n    terrain.render(size=(160, 90))"
RENDER, CLOSE = "print(float(terrain.render(size=(160, 90)).color.std()))", "terrain.close()"


def changed(before, after):
    """Part of the pixels that differ visibly."""
    return (np.abs(after - before).max(axis=-1) > 8).mean()


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    lab.write(folder / "view.ipynb", [HILLS, VIEW, STATE, OTHER, LONG, RENDER, CLOSE])
    with lab.Lab(folder) as running:
        yield running


@pytest.fixture
def page(opened):
    """The notebook with its view, of a new kernel."""
    opened.open("view.ipynb")
    opened.restart()
    opened.run(0)
    opened.run(1)
    opened.settled(1)
    return opened


def test_pointer_keys_panel_and_size(page):
    first = page.settled(1)
    assert first.shape[:2] == (560, 760)
    state = page.value(2)
    page.drag(1, (560, 300), (500, 240))
    dragged = page.settled(1)
    assert changed(first, dragged) > 0.05
    assert page.value(2)["camera"] != state["camera"]
    # keys that JupyterLab has commands for reach the view alone: two times D would take out the cell
    cells = page.browser.run(f"{lab.CODE_CELLS}.length")
    page.click(1, 600, 500)
    for key in "ddxaby":
        page.browser.press(key)
    page.browser.press("m")
    chromium.until(lambda: changed(dragged, page.picture(1)) > 0.05)
    page.browser.press("m")
    page.settled(1)
    assert page.browser.run(f"{lab.CODE_CELLS}.length") == cells
    # a section of the panel, and a text that is typed into its field
    page.click(1, *state["places"]["Look"])
    page.settled(1)
    page.click(1, *page.value(2)["places"]["sun at"])
    page.type("2026-06-21 19:30")
    page.settled(1)
    assert page.value(2)["sun"][1] > 60
    left, top, width, height = page.box(1)
    page.browser.drag((left + width - 4, top + height - 4), (left + width - 154, top + height - 104))
    chromium.until(lambda: page.box(1)[2] < width - 100)
    small = page.settled(1)
    assert page.value(2)["size"] == [small.shape[1], small.shape[0]]


def test_two_views_and_cells_that_are_run_again(page):
    first = page.settled(1)
    page.run(3)
    other = page.settled(3)
    page.drag(3, (240, 150), (300, 120))
    assert changed(other, page.settled(3)) > 0.05
    # the other one is as it was, and so is what its pointer meets
    assert changed(first, page.settled(1)) < 0.01
    before = page.value(2)
    for _ in range(4):
        page.run(1)
        page.settled(1)
    # 11 MB for each view on the screen
    assert page.value(2)["memory"] - before["memory"] < 15e6, "views of earlier runs keep their pictures"


def test_an_interrupted_cell_and_a_page_that_is_loaded_again(page):
    first = page.settled(1)
    page.run(4, wait=False)
    chromium.until(lambda: page.kernel("session.kernel.status") == "busy")
    time.sleep(1)
    page.command("notebook:interrupt-kernel")
    page.until_idle()
    assert "KeyboardInterrupt" in page.output(4)
    assert page.value(5) > 5
    page.drag(1, (560, 300), (500, 240))
    assert changed(first, page.settled(1)) > 0.05
    # away in the middle of a flight, with pictures under way and a key held
    page.click(1, 600, 500)
    page.browser.press("Tab")
    page.browser.ask("Input.dispatchKeyEvent", type="keyDown", key="w", windowsVirtualKeyCode=87)
    time.sleep(1)
    page.command("docmanager:save")
    time.sleep(1)
    page.open("view.ipynb")
    again = page.settled(1)
    assert not page.value(2)["moving"]
    page.drag(1, (560, 300), (500, 200))
    assert changed(again, page.settled(1)) > 0.05


def test_a_terrain_that_is_closed_is_told_beside_the_picture(page):
    page.run(6)
    page.drag(1, (560, 300), (500, 240))
    title = f"{lab.CODE_CELLS}[1].querySelector('.renderview-title').textContent"
    chromium.until(lambda: "expected an open terrain" in page.browser.run(title))


def test_a_kernel_that_is_restarted_while_the_view_loads(page):
    page.run(0)
    page.run(1, wait=False)
    page.restart()
    page.run(0)
    page.run(1)
    assert page.settled(1).std() > 5
    assert page.value(2)["error"] == "None"


def test_the_page_that_is_exported_has_a_picture(page):
    pytest.importorskip("nbconvert")
    page.command("docmanager:save")
    path = page.folder / "view.ipynb"
    chromium.until(lambda: "image/jpeg" in path.read_text())
    subprocess.run([sys.executable, "-m", "nbconvert", "--to", "html", path.name], cwd=page.folder, check=True)
    kept = json.loads(path.read_text())["cells"][1]["outputs"][0]["data"]["image/jpeg"]
    assert kept.strip() in (page.folder / "view.html").read_text()
