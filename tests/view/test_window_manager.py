"""`orogen view` under a real window manager: what its buttons and menus do to a window."""

import contextlib
import os
import shutil
import subprocess
import time

import numpy as np
import pytest

from oracle import desktop
from oracle.desktop import Desktop, Display, hills, write

REASON = desktop.missing() or ("" if shutil.which("openbox") else "no openbox: a window manager")
pytestmark = [pytest.mark.nightly, pytest.mark.skipif(bool(REASON), reason=REASON)]
SIZE = (900, 700)
REMOVE, ADD = 0, 1
ICONIFIED = "__import__('glfw').get_window_attrib(window.canvas._window, 0x20002)"


class Managed:
    """What a window manager and those who speak to it do."""

    def __init__(self, display, folder):
        self.display = display
        self._process = subprocess.Popen(
            ["openbox", "--sm-disable"], env={**os.environ, "DISPLAY": display.name, "HOME": str(folder)},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._until(lambda: self._read(self._root, "_NET_SUPPORTING_WM_CHECK"))

    @property
    def _root(self):
        return self.display.server.screen().root

    def _read(self, window, name):
        found = window.get_full_property(self.display.server.intern_atom(name), 0)
        return list(found.value) if found else []

    def _until(self, condition, seconds=60):
        end = time.monotonic() + seconds
        while not (found := condition()):
            assert time.monotonic() < end, "waited for too long"
            time.sleep(0.05)
        return found

    @property
    def window(self):
        """The window of the latest program."""
        number = self._until(lambda: self._read(self._root, "_NET_CLIENT_LIST"))[-1]
        return self.display.server.create_resource_object("window", number)

    def tell(self, name, *values):
        """Ask the window manager for something; atoms by their names."""
        from Xlib import X
        from Xlib.protocol.event import ClientMessage

        server, window = self.display.server, self.window
        data = [server.intern_atom(v) if isinstance(v, str) else v for v in values]
        event = ClientMessage(window=window, client_type=server.intern_atom(name), data=(32, (data + [0] * 5)[:5]))
        self._root.send_event(event, event_mask=X.SubstructureRedirectMask | X.SubstructureNotifyMask)
        server.sync()

    def state(self, *names, on=True):
        """Maximise, make full-screen and the like."""
        names = [f"_NET_WM_STATE_{name}" for name in names]
        self.tell("_NET_WM_STATE", ADD if on else REMOVE, *names)
        self._until(lambda: all((self.display.server.intern_atom(n) in self.states) == on for n in names))

    @property
    def states(self):
        """What the window manager says of the window."""
        return self._read(self.window, "_NET_WM_STATE")

    def iconify(self):
        from Xlib import Xutil

        self.tell("WM_CHANGE_STATE", Xutil.IconicState)

    def restore(self):
        self.tell("_NET_ACTIVE_WINDOW", 2)

    def end(self):
        self._process.terminate()
        self._process.wait()


@contextlib.contextmanager
def managed(folder):
    """A display with a window manager and `orogen view` on it."""
    with Display(SIZE) as display:
        manager = Managed(display, folder)
        try:
            cache = {"OROGEN_CACHE_DIR": str(folder / "cache"), "STILL_SAMPLES": "1"}
            with Desktop(display, ["hills.tif", "--size", "600x500"], folder, **cache) as user:
                yield manager, user
        finally:
            manager.end()


def cpu_seconds(user):
    """User and system time of the program so far."""
    return user.ask("sum(__import__('os').times()[:2])")


def idle(user, seconds=3.0):
    """Frames and processor seconds in so many seconds."""
    before = user.ask("watch.frames"), cpu_seconds(user)
    time.sleep(seconds)
    return user.ask("watch.frames") - before[0], cpu_seconds(user) - before[1]


def test_iconified_restored_maximised_and_moved_between_workspaces(tmp_path):
    write(tmp_path / "hills.tif", hills())
    with managed(tmp_path) as (manager, user):
        user.until("watch.frames > 0")
        before = np.asarray(user.settle()).astype(int)
        user.display.move(450, 300)
        user.display.key("Tab")
        user.until("type(window.controls).__name__ == 'FlyControls'")
        user.display.key("w", True)
        user.until("window.moving")
        # flying on, it is put away
        manager.iconify()
        user.until(ICONIFIED)
        time.sleep(1)  # for the frame that was under way
        frames, seconds = idle(user)
        user.display.key("w", False)
        assert frames == 0
        assert seconds < 0.3, "an iconified window costs time"
        manager.restore()
        user.until(f"not {ICONIFIED}")
        after = np.asarray(user.settle()).astype(int)
        assert (np.abs(after - before).max(axis=-1) > 8).mean() > 0.005
        for names in (("MAXIMIZED_VERT", "MAXIMIZED_HORZ"), ("FULLSCREEN",)):
            manager.state(*names)
            user.until("window.canvas.get_logical_size()[0] > 880")
            assert np.asarray(user.settle())[300:600, 500:].std() > 5
            manager.state(*names, on=False)
            user.until("window.canvas.get_logical_size()[0] < 880")
            user.settle()
        manager.tell("_NET_WM_DESKTOP", 1, 2)
        frames, seconds = idle(user)
        assert frames <= 1
        assert seconds < 0.3
        manager.tell("_NET_WM_DESKTOP", 0, 2)
        manager.restore()
        for width, height in ((1, 1), (3000, 2000), (320, 240)):
            manager.window.configure(width=width, height=height)
            manager.display.server.sync()
            time.sleep(0.3)
        user.until("window.canvas.get_logical_size() == (320, 240)")
        assert np.asarray(user.settle()).std() > 5
        assert user.ask("window.error is None")
        manager.tell("_NET_CLOSE_WINDOW", 0, 2)
        assert user.process.wait(30) == 0
        assert "rror" not in user.errors
