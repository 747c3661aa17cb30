"""Makes the pictures of docs/view.md and docs/serve.md anew: of a real window on a virtual display, of a browser and,
where JupyterLab is installed, of a notebook.

    python tools/view_pictures.py ../shared/data/bigtujunga_30m_utm.tif

Needs Xvfb, Chromium and python-xlib.
"""

import io
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from oracle import chromium, lab, pages  # noqa: E402
from oracle.desktop import Desktop, Display  # noqa: E402

SIZE = (1280, 720)
IMAGES = ROOT / "docs" / "images"


def keep(picture, name):
    """Write a picture as the documentation shows it."""
    picture.convert("RGB").save(IMAGES / name, quality=88, optimize=True, progressive=True)


def near(session):
    """A camera over the middle of the data that looks at the mountains."""
    grid = session.data.grid
    x, y = (float(v) for v in grid.to_crs(grid.width / 2, grid.height / 2))
    return session.whole(look_at=(x, y), distance=0.4 * grid.width * grid.spacing, heading=15.0, pitch=-20.0)


def window_pictures(display, data, folder):
    """A profile, two algorithms beside each other, and a map."""
    arguments = [data, "--size", "x".join(map(str, SIZE))]
    with Desktop(display, arguments, folder) as user:
        user.until("watch.frames > 0")
        user.do("window.controls.go_to(__import__('view_pictures').near(session))")
        user.settle()
        for name in ("Algorithm", "Look", "Measure", "click points"):
            user.click(name)
        user.until("panel.measuring")
        for number, place in enumerate([(560, 330), (1060, 250)], start=1):
            user.click(place)
            user.until(f"len(panel.points) == {number}")
        display.move(760, 560)
        keep(user.settle(), "view-profile.jpg")
        user.click("clear")
        user.click("click points")
        user.click("Measure")
        user.do("[session.compare('udlod', {'pixels_per_quad': 16.0}), session.restyle(overlays=('wireframe',))]")
        user.click("Compare")
        display.move(1000, 560)
        keep(user.settle(), "view-split.jpg")
        user.do("[session.alone(), session.restyle(overlays=())]")
        user.click("Compare")
        user.click("Speed")
        display.key("m")
        user.until("session.mode == 'beside'")
        user.settle()
        display.move(600, 450)
        keep(user.settle(), "view-map.jpg")
        user.close()


def browser_picture(data, folder):
    """The page of `orogen serve`."""
    import orogen
    from orogen.view.serve import Look, Server, ServerSettings
    from orogen.view.session import Session

    with (
        orogen.open(data) as terrain,
        Server(terrain, ServerSettings(port=0), Look(camera=near(Session(terrain)))) as server,
    ):
        drawing = threading.Thread(target=server.run)
        drawing.start()
        try:
            with chromium.Browser(folder / "browser", SIZE) as browser:
                browser.open(server.address)
                chromium.until(lambda: browser.run("document.documentElement?.dataset.shown"), 60)
                browser.mouse("mouseMoved", 900, 500)
                time.sleep(2)  # until the server has heard of it
                chromium.until(lambda: all(pages.at_rest(server, client) for client in server._clients), 300)
                time.sleep(2)
                keep(Image.open(io.BytesIO(browser.picture())), "serve-browser.jpg")
        finally:
            server.stop()
            drawing.join()


def notebook_picture(data, folder):
    """A notebook in JupyterLab."""
    cells = [
        f"import orogen\n\nterrain = orogen.open({Path(data).name!r})\nterrain.shape, terrain.height_range",
        "view = terrain.view(size=(860, 480))\nview",
    ]
    (folder / "lab").mkdir()
    (folder / "lab" / Path(data).name).symlink_to(data)
    lab.write(folder / "lab" / "valley.ipynb", cells)
    near_now = (
        "import view_pictures; view.window.controls.go_to(view_pictures.near(view.session)); view.window.handle("
        "{'event_type': 'key_down', 'key': 'F13', 'modifiers': ()})"
    )
    with lab.Lab(folder / "lab", (1100, 810)) as page:
        page.open("valley.ipynb")
        page.run(0)
        page.run(1)
        page.settled(1)
        page.execute(near_now)
        page.settled(1)
        keep(Image.open(io.BytesIO(page.browser.picture())), "view-notebook.jpg")


def main(data):
    """Make all of them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["OROGEN_CONFIG_DIR"] = str(folder / "config")
        os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        with Display(SIZE) as display:
            window_pictures(display, Path(data).resolve(), folder)
        browser_picture(str(Path(data).resolve()), folder)
        if not lab.missing():
            notebook_picture(str(Path(data).resolve()), folder)


if __name__ == "__main__":
    main(sys.argv[1])
