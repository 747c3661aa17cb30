"""A real window on a virtual display: moved by events of pointer and keyboard, and seen as the screen shows it."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rasterio
from PIL import Image

SIGNS = {
    " ": "space", ".": "period", "/": "slash", "-": "minus", ",": "comma", "_": "underscore", ":": "colon",
    "+": "plus", "=": "equal",
}  # fmt: skip
WHEEL = {(0, -1): 4, (0, 1): 5, (-1, 0): 6, (1, 0): 7}


def missing():
    """Why there is no virtual display here, or ""."""
    if shutil.which("Xvfb") is None:
        return "no Xvfb: a virtual display for a real window"
    try:
        import Xlib  # noqa: F401
    except ImportError:
        return "no python-xlib: it sends events of pointer and keyboard"
    return ""


class Display:
    """A virtual screen. Use it as a context manager."""

    def __init__(self, size=(900, 640), dpi=96):
        from Xlib import Xatom
        from Xlib import display as xlib

        self.size = size
        read, write = os.pipe()
        screen = f"{size[0]}x{size[1]}x24"
        self._server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", screen, "-nolisten", "tcp"],
            pass_fds=(write,), stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(write)
        with os.fdopen(read) as pipe:
            self.name = f":{pipe.readline().strip()}"
        self.server = xlib.Display(self.name)
        self._root = self.server.screen().root
        # where desktops say how many pixels make a logical one
        self._root.change_property(Xatom.RESOURCE_MANAGER, Xatom.STRING, 8, f"Xft.dpi:\t{dpi}\n".encode())
        self.server.sync()

    def picture(self):
        """What the screen shows."""
        from Xlib import X

        raw = self._root.get_image(0, 0, *self.size, X.ZPixmap, 0xFFFFFFFF)
        return Image.frombytes("RGB", self.size, raw.data, "raw", "BGRX")

    def window(self, title="orogen"):
        """The window whose title holds a word."""
        found = [w for w in self._root.query_tree().children if title in (w.get_wm_name() or "")]
        assert found, f"there is no window whose title holds {title!r}"
        return found[0]

    def _fake(self, kind, *detail, **more):
        from Xlib.ext import xtest

        xtest.fake_input(self.server, kind, *detail, **more)
        self.server.sync()

    def move(self, x, y):
        from Xlib import X

        self._fake(X.MotionNotify, x=round(x), y=round(y))

    def button(self, number, down):
        from Xlib import X

        self._fake(X.ButtonPress if down else X.ButtonRelease, number)

    def wheel(self, x, y, dx=0, dy=0):
        """Notches to the right and downwards."""
        self.move(x, y)
        for way, count in (((1, 0), dx), ((0, 1), dy)):
            for _ in range(abs(count)):
                sign = 1 if count > 0 else -1
                for down in (True, False):
                    self.button(WHEEL[way[0] * sign, way[1] * sign], down)

    def key(self, name, down=None):
        """Press and release a key by its name in X, or only one of both."""
        from Xlib import XK, X

        code = self.server.keysym_to_keycode(XK.string_to_keysym(name))
        for kind in [X.KeyPress, X.KeyRelease] if down is None else [X.KeyPress if down else X.KeyRelease]:
            self._fake(kind, code)

    def close(self):
        with contextlib.suppress(Exception):
            self.server.close()
        self._server.terminate()
        self._server.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


class Desktop:
    """`orogen view` on a display, and a user before it. `ask` looks into it where the picture does not tell enough."""

    def __init__(self, display, arguments, folder, **environment):
        self.display = display
        variables = {**os.environ, "DISPLAY": display.name, "OROGEN_CONFIG_DIR": str(folder / "config"), **environment}
        variables.pop("WAYLAND_DISPLAY", None)
        # sessions of desktops have one, and drivers complain to stderr where there is none
        variables.setdefault("XDG_RUNTIME_DIR", str(folder))
        variables["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parents[1]), variables.get("PYTHONPATH", "")])
        self._errors = (folder / "errors.txt").open("w+")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "oracle.desktop", *map(str, arguments)],
            env=variables, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True,
        )  # fmt: skip

    @property
    def errors(self):
        """What the command has said to stderr."""
        self._errors.flush()
        return Path(self._errors.name).read_text()

    def ask(self, expression):
        """What an expression of Python gives where the window is `window`, between two frames."""
        self.process.stdin.write(json.dumps(expression) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        assert line, f"the window is gone: {self.errors}"
        answer = json.loads(line)
        assert "error" not in answer, answer["error"]
        return answer["value"]

    def do(self, expression):
        """Change something from within, and have it drawn."""
        self.ask(f"[{expression}, window.canvas.request_draw()] and None")

    def until(self, expression, seconds=60):
        """Wait until an expression is true; gives it."""
        end = time.monotonic() + seconds
        while not (found := self.ask(expression)):
            assert time.monotonic() < end, f"waited for too long: {expression}"
            time.sleep(0.03)
        return found

    def settle(self):
        """Wait until the window is at rest, and give what the screen shows."""
        before, end = None, time.monotonic() + 90
        while (now := self.ask("[watch.frames, watch.wanted or window.moving]")) != before or now[1]:
            assert time.monotonic() < end, f"the window never comes to rest: {now}"
            before = now
            time.sleep(0.15)
        return self.display.picture()

    def frames(self, count=2):
        """Wait for so many more frames."""
        time.sleep(0.03)  # what was sent has to arrive
        drawn = self.ask("watch.frames")
        self.until(f"watch.frames >= {drawn + count} or not watch.wanted")

    def place(self, name):
        """Where a field of the panel lies on the screen."""
        self.until(f"{name!r} in panel.widgets.places")
        x, y = self.ask(f"panel.widgets.places[{name!r}]")
        ratio = self.ask("window.canvas.get_pixel_ratio()")
        return x * ratio, y * ratio

    def click(self, at, button=1):
        """Click a place, or a field by its name."""
        if isinstance(at, str):
            at = self.steady(at)
        self.display.move(*at)
        self.frames(3)
        self.display.button(button, True)
        self.frames()
        self.display.button(button, False)
        self.frames(3)

    def steady(self, name):
        """Where a field lies once it no longer moves."""
        places = [self.place(name)]
        while len(places) < 3 or len(set(places[-3:])) > 1:
            self.frames(1)
            places.append(self.place(name))
        return places[-1]

    def double_click(self, x, y):
        self.display.move(x, y)
        self.frames()
        for _ in range(2):
            self.display.button(1, True)
            self.display.button(1, False)

    def drag(self, start, end, button=1, steps=6):
        self.display.move(*start)
        self.frames()
        self.display.button(button, True)
        self.frames()
        for step in range(1, steps + 1):
            self.display.move(*(a + (b - a) * step / steps for a, b in zip(start, end, strict=True)))
            time.sleep(0.03)
        self.frames()
        self.display.button(button, False)

    def type(self, name, text):
        """Write into a text field in place of what is there, and press Enter."""
        self.click(name)
        self.display.key("Control_L", True)
        self.display.key("a")
        self.display.key("Control_L", False)
        for letter in text:
            shifted = letter.isupper() or letter in "_:+"
            if shifted:
                self.display.key("Shift_L", True)
            self.display.key(SIGNS.get(letter, letter))
            if shifted:
                self.display.key("Shift_L", False)
            time.sleep(0.02)
        self.display.key("Return")
        self.until("not panel._gui.typing and not watch.wanted")

    def close(self):
        """As the cross of the window does; gives the status of the process."""
        from Xlib import X
        from Xlib.protocol.event import ClientMessage

        server = self.display.server
        kinds = [server.intern_atom(name) for name in ("WM_PROTOCOLS", "WM_DELETE_WINDOW")]
        window = self.display.window()
        window.send_event(
            ClientMessage(window=window, client_type=kinds[0], data=(32, [kinds[1], X.CurrentTime, 0, 0, 0]))
        )
        server.sync()
        return self.process.wait(30)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()
        self._errors.close()


def write(path, heights, spacing=30.0):
    """Write heights (m) as a GeoTIFF in UTM."""
    with rasterio.open(
        path, "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0], count=1, dtype="float32",
        crs="EPSG:32611", transform=rasterio.Affine(spacing, 0, 4e5, 0, -spacing, 38e5), tiled=True,
    ) as file:  # fmt: skip
        file.write(heights.astype(np.float32), 1)
    return path


def hills(rows=96, columns=128):
    """Smooth heights (m)."""
    y, x = np.mgrid[0:rows, 0:columns] / 16.0
    return 600 + 300 * np.sin(x) * np.cos(0.7 * y) + 2 * (x * 16 - columns / 2)


def opened(display, folder, *arguments, **environment):
    """`orogen view` of hills.tif in a folder, as large as the display and soon at rest."""
    size = ["--size", "x".join(map(str, display.size))]
    cache = {"OROGEN_CACHE_DIR": str(folder / "cache"), "STILL_SAMPLES": "1", **environment}
    return Desktop(display, ["hills.tif", *size, *arguments], folder, **cache)


class Watch:
    """What the window has done, for `Desktop.ask`."""

    frames = 0
    wanted = False
    """Whether a frame has been asked for since the latest one."""

    def see(self, window):
        """Be told of a window's frames."""
        draw, request = window._draw, window.canvas.request_draw

        def drawn():
            self.wanted = False
            more = draw()
            self.frames += 1
            return more

        def requested(*given):
            self.wanted = True
            request(*given)

        window._draw, window.canvas.request_draw = drawn, requested

    def answer(self, window):
        """Answer questions from stdin in the window's own thread."""
        told = sys.stdout

        def reply(line):
            try:
                names = {"window": window, "session": window.session, "panel": window.panel, "watch": self}
                text = json.dumps({"value": eval(json.loads(line), names)})
            except Exception as error:
                text = json.dumps({"error": f"{type(error).__name__}: {error}"})
            told.write(text + "\n")
            told.flush()

        for line in sys.stdin:
            window._loop.call_soon_threadsafe(reply, line)


def main():
    from orogen import cli
    from orogen.view import renderer
    from orogen.view.window import Window

    renderer.STILL_SAMPLES = int(os.environ.get("STILL_SAMPLES", renderer.STILL_SAMPLES))
    run, watch = Window.run, Watch()

    def watched(window):
        watch.see(window)
        answering = threading.Thread(target=watch.answer, args=(window,), daemon=True)
        window._loop.call_soon(answering.start)  # what is handed to a loop that does not run yet is lost
        run(window)

    Window.run = watched
    sys.exit(cli.run(["view", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
