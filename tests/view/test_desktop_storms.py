"""A real window that is resized wildly, hidden, and closed at bad moments."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from oracle import desktop
from oracle.desktop import Display, hills, opened, write

pytestmark = pytest.mark.skipif(bool(desktop.missing()), reason=desktop.missing())


def test_sizes_in_a_storm_and_windows_that_are_hidden(tmp_path):
    write(tmp_path / "hills.tif", hills())
    with Display((800, 700), dpi=192) as display, opened(display, tmp_path) as user:
        user.until("watch.frames > 0")
        assert user.ask("window.canvas.get_pixel_ratio()") == 2
        user.settle()
        window = display.window()
        rng = np.random.default_rng(5)
        for number in range(60):
            width, height = (1, 1) if number % 20 == 7 else rng.integers(1, 800, 2).tolist()
            window.configure(width=width, height=height)
            display.server.sync()
            time.sleep(0.01)
        window.unmap()
        display.server.sync()
        display.wheel(400, 300, dy=-2)
        time.sleep(0.2)
        # what is looked at is deleted meanwhile
        os.remove(tmp_path / "hills.tif")
        window.map()
        window.configure(width=800, height=700)
        display.server.sync()
        user.until("window.canvas.get_physical_size() == (800, 700)")
        user.until("window.panel.folded")  # in a narrow window the panel begins as a button
        display.key("p")
        user.until("not window.panel.folded")
        picture = np.asarray(user.settle())
        assert user.ask("window.error is None")
        # logical pixels are two by two: the panel reaches as far
        assert np.median(picture[40:200, 40:640]) < 60
        assert user.close() == 0
        assert "rror" not in user.errors


def test_closing_while_it_loads(tmp_path):
    y, x = np.mgrid[0:1500, 0:1500] / 9.0
    write(tmp_path / "hills.tif", 500 + 100 * np.sin(x) * np.cos(y))
    with Display((320, 240)) as display:
        for early in (True, False):
            with opened(display, tmp_path) as user:
                user.until("True" if early else "watch.frames > 1")
                assert user.close() == 0
                assert "rror" not in user.errors


@pytest.mark.nightly
@pytest.mark.timeout(3 * 3600)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")
def test_flying_for_long_in_a_real_window_leaves_nothing_behind(tmp_path, record_property):
    """As many minutes as OROGEN_SOAK_MINUTES says, 10 unless told otherwise: flights, sizes, maps and algorithms."""
    y, x = np.mgrid[0:2048, 0:2048] / 40.0
    write(tmp_path / "hills.tif", 600 + 300 * np.sin(x) * np.cos(0.7 * y))
    end, held, number = time.monotonic() + 60 * float(os.environ.get("OROGEN_SOAK_MINUTES", 10)), [], 0
    fly = "panel.player or [panel.keyframes.load(orbit, 1.0), panel.play()]"
    orbit = (
        "__import__('orogen.view.flight').view.flight.Flight.load('teleport')"
        ".over(session.data.grid, session.data.height_range)"
    )
    with Display((480, 360)) as display, opened(display, tmp_path) as user:
        user.until("watch.frames > 0")
        while time.monotonic() < end:
            user.do(fly.replace("orbit", orbit))
            number += 1
            if number % 20 == 7:
                display.key("m")
            if number % 20 == 13:
                user.do("session.use('udlod' if session.algorithm == 'raycast' else 'raycast')")
            if number % 20 == 19:
                display.window().configure(width=480 - number % 3 * 60, height=360)
                display.server.sync()
            time.sleep(0.5)
            pages = int(Path(f"/proc/{user.process.pid}/statm").read_text().split()[1])
            held.append(pages * os.sysconf("SC_PAGE_SIZE"))
        assert user.ask("window.error is None")
        record_property("frames", user.ask("watch.frames"))
        assert user.close() == 0
    # a whole round of what is done at each end
    warm, last = held[len(held) // 5 : 2 * len(held) // 5], held[-(len(held) // 5) :]
    record_property("growth_percent", round(100 * (np.mean(last) / np.mean(warm) - 1), 2))
    assert np.mean(last) <= 1.02 * np.mean(warm)
