"""JupyterLab as its users have it: a server of its own, and a real browser before a notebook."""

import contextlib
import importlib.util
import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

from oracle import chromium

NEEDED = ("jupyterlab", "ipykernel", "anywidget", "websockets", "nbformat")
CODE_CELLS = "Array.from(document.querySelectorAll('.jp-NotebookPanel:not(.lm-mod-hidden) .jp-CodeCell'))"


def missing():
    """Why JupyterLab cannot be driven here, or ""."""
    absent = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if absent:
        return f"no {', '.join(absent)}: a real JupyterLab"
    return "" if chromium.find() else "no Chromium: a browser for JupyterLab"


def write(path, cells):
    """A notebook of these code cells."""
    import nbformat

    made = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in cells])
    made.metadata["kernelspec"] = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(made, path)


class Lab:
    """A server in a folder, with a browser. Use it as a context manager."""

    def __init__(self, folder, size=(1100, 900)):
        self.folder = Path(folder)
        self._stack = contextlib.ExitStack()
        names = (
            "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTERLAB_SETTINGS_DIR",
            "JUPYTERLAB_WORKSPACES_DIR", "IPYTHONDIR", "OROGEN_CONFIG_DIR", "OROGEN_CACHE_DIR",
        )  # fmt: skip
        own = {name: str(self.folder / ".lab" / name.lower()) for name in names}
        variables = {**os.environ, **own}
        self.log = self.folder / ".lab" / "log.txt"
        self.log.parent.mkdir(parents=True)
        asks = Path(own["JUPYTERLAB_SETTINGS_DIR"]) / "@jupyterlab" / "apputils-extension"
        asks.mkdir(parents=True)
        (asks / "notification.jupyterlab-settings").write_text('{"fetchNews": "false", "checkForUpdates": false}')
        with contextlib.ExitStack() as stack:
            errors = stack.enter_context(self.log.open("w"))
            self._server = subprocess.Popen(
                [
                    sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--ip=127.0.0.1",
                    "--ServerApp.port=0", "--LabApp.expose_app_in_browser=True", f"--ServerApp.root_dir={self.folder}",
                ],
                env=variables, cwd=self.folder, stdout=errors, stderr=subprocess.STDOUT,
            )  # fmt: skip
            stack.callback(self._end)
            known = Path(own["JUPYTER_RUNTIME_DIR"]) / f"jpserver-{self._server.pid}.json"
            chromium.until(lambda: known.is_file() and known.read_text().strip().endswith("}"), 90)
            note = json.loads(known.read_text())
            self.address, self.token = note["url"], note["token"]
            self.browser = stack.enter_context(chromium.Browser(self.folder / ".lab" / "browser", size))
            self._stack = stack.pop_all()

    def _end(self):
        self._server.terminate()
        try:
            self._server.wait(20)
        except subprocess.TimeoutExpired:
            self._server.kill()
            self._server.wait()

    def open(self, name):
        """Show a notebook alone, with its kernel ready; also in place of a page that shows it."""
        shown = "window.jupyterapp?.shell.currentWidget?.context"
        if self.browser.run(f"Boolean({shown})"):
            # a page with changes asks whether it may go
            self.command("docmanager:save")
            chromium.until(lambda: not self.browser.run(f"{shown}.model.dirty"))
        self.browser.open(f"{self.address}lab/workspaces/tests/tree/{name}?token={self.token}&reset")
        chromium.until(lambda: self.browser.run(f"Boolean(window.jupyterapp && {CODE_CELLS}.length)"), 120)
        if self.browser.run("!document.getElementById('jp-left-stack').classList.contains('lm-mod-hidden')"):
            self.command("application:toggle-left-area")
        self.until_idle()

    def command(self, name):
        """Carry out a command of JupyterLab, without waiting for its end."""
        self.browser.run(f"(window.jupyterapp.commands.execute({name!r}), 0)")

    def kernel(self, what):
        """An expression of JavaScript on the notebook's session, as `session`."""
        panel = "window.jupyterapp.shell.currentWidget"
        return self.browser.run(f"(() => {{ const session = {panel}.sessionContext.session; return {what} }})()")

    def execute(self, code):
        """Run code that stands in no cell."""
        self.kernel(f"session.kernel.requestExecute({{code: {json.dumps(code)}}}).done.then(() => 0)")

    def until_idle(self, seconds=120):
        """Wait until the kernel has nothing to do."""
        chromium.until(lambda: self.kernel("session && session.kernel && session.kernel.status") == "idle", seconds)

    def restart(self):
        """Have a new kernel, whatever the one before does."""
        self.browser.run("window.jupyterapp.shell.currentWidget.sessionContext.restartKernel().then(() => 0)")
        self.until_idle()

    def run(self, number, wait=True):
        """Run a code cell by its number."""
        book = "window.jupyterapp.shell.currentWidget.content"
        self.browser.run(f"({book}.activeCellIndex = {number}, {book}.deselectAll(), 0)")
        if wait:
            self.browser.run("window.jupyterapp.commands.execute('notebook:run-cell').then(() => 0)")
        else:
            self.command("notebook:run-cell")

    def output(self, number):
        """The text of a cell's output."""
        return self.browser.run(f"{CODE_CELLS}[{number}].querySelector('.jp-OutputArea')?.textContent || ''")

    def value(self, number):
        """Run a cell and give what it prints, as JSON."""
        self.run(number)
        chromium.until(lambda: self.output(number).strip())
        return json.loads(self.output(number).strip().split("\n")[-1])

    def box(self, number):
        """Left, top, width and height of a cell's view in the page, scrolled to; None where it has none."""
        script = (
            f"(() => {{ const i = {CODE_CELLS}[{number}].querySelector('.renderview-wrapper img');"
            " if (!i) return null; const h = i.getBoundingClientRect();"
            " if (h.top < 80 || h.bottom > innerHeight) i.scrollIntoView({block: 'center'});"
            " const r = i.getBoundingClientRect(); return [r.left, r.top, r.width, r.height] })()"
        )
        return self.browser.run(script)

    def picture(self, number):
        """What the page shows of a cell's view."""
        box = chromium.until(lambda: self.box(number))
        whole = Image.open(io.BytesIO(self.browser.picture())).convert("RGB")
        left, top, width, height = (round(v) for v in box)
        return np.asarray(whole.crop((left, top, left + width, top + height))).astype(int)

    def settled(self, number, seconds=90):
        """A cell's view, once it shows a terrain and no longer changes."""
        end, before = time.monotonic() + seconds, None
        while True:
            now = self.picture(number)
            if now.std() > 5 and before is not None and now.shape == before.shape and (now == before).all():
                return now
            assert time.monotonic() < end, "the view never comes to rest"
            before = now
            time.sleep(0.7)

    def drag(self, number, start, end, button="left"):
        """Drag within a cell's view."""
        left, top, _, _ = self.box(number)
        self.browser.drag((left + start[0], top + start[1]), (left + end[0], top + end[1]))

    def click(self, number, x, y):
        """Click into a cell's view, as slowly as a hand does."""
        left, top, _, _ = self.box(number)
        for kind, buttons in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 0)):
            pressed = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
            self.browser.mouse(kind, left + x, top + y, buttons=buttons, **pressed)
            time.sleep(0.4)

    def type(self, text):
        """Press the keys of a text, and Enter."""
        for letter in [*text, "Enter"]:
            more = {"key": letter, "windowsVirtualKeyCode": 13 if letter == "Enter" else ord(letter.upper())}
            letters = "\r" if letter == "Enter" else letter
            self.browser.ask("Input.dispatchKeyEvent", type="keyDown", text=letters, **more)
            self.browser.ask("Input.dispatchKeyEvent", type="keyUp", **more)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._stack.close()
