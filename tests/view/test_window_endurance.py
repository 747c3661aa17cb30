"""Windows that are opened and closed over and over, and how soon an event shows."""

import gc
import itertools
import logging
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import orogen
from orogen.view.flight import Flight
from orogen.view.image import write_depth
from orogen.view.session import Session
from orogen.view.window import Window

log = logging.getLogger("orogen")

TOLERANCE = 1.02


def resident():
    """Bytes of the process in memory."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def cycle(canvas_type, terrain, mapped):
    window = Window(Session(terrain), canvas=canvas_type(size=(120, 80)))
    if mapped:
        window.toggle_map()
    for _ in range(2):
        assert np.asarray(window.canvas.draw()).any()
    window.close()
    assert window._error is None


WINDOWS = """
import gc, sys
import numpy as np, orogen
from rendercanvas.offscreen import OffscreenRenderCanvas
from orogen.view.session import Session
from orogen.view.window import Window

count = int(sys.argv[1])
heights = np.random.default_rng(1).random((48, 64)).astype(np.float32)
with orogen.open(heights, spacing=10.0) as terrain:
    for number in range(count):
        window = Window(Session(terrain), canvas=OffscreenRenderCanvas(size=(120, 80)))
        if number % 10 == 0:
            window.toggle_map()
        for _ in range(2):
            assert np.asarray(window.canvas.draw()).any()
        window.close()
        assert window.error is None
        if number % 50 == 0:
            gc.collect()  # what waits for it is no leak
        if number in (count // 5, count - 1):
            gc.collect()
            with open("/proc/self/statm") as file:
                print(file.read().split()[1])
"""

needs_proc = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")


@needs_proc
def test_a_hundred_windows_leave_nothing_behind(terrain, hands):
    canvas = type(hands.canvas)
    allocated, held = terrain.renderer.gpu.memory.total, []
    for number in range(100):
        cycle(canvas, terrain, mapped=number % 10 == 0)
        if number in (40, 99):
            held.append(resident())
    assert held[1] <= TOLERANCE * held[0]
    assert terrain.renderer.gpu.memory.by_category().get("view", 0) == 0
    assert terrain.renderer.gpu.memory.total <= allocated + (1 << 20)


@needs_proc
@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_a_thousand_windows_leave_nothing_behind():
    """In a process of their own: what a test runner keeps is not theirs."""
    done = subprocess.run([sys.executable, "-c", WINDOWS, "1000"], capture_output=True, text=True, timeout=3000)
    assert done.returncode == 0, done.stderr
    first, last = (int(word) for word in done.stdout.split())
    assert last <= TOLERANCE * first


@needs_proc
@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_a_thousand_terrains_are_closed_while_they_load(hands):
    """Each has a device, and software drivers keep about a tenth of a megabyte of each of its pipelines."""
    canvas, held = type(hands.canvas), []
    heights = np.random.default_rng(1).random((48, 64)).astype(np.float32)
    for number in range(1000):
        with orogen.open(heights, spacing=10.0) as terrain:
            cycle(canvas, terrain, mapped=number % 10 == 0)
        if number in (200, 999):
            held.append(resident())
    assert held[1] - held[0] <= 800 << 20


RATE = 30
"""Frames to a second of a scripted flight."""
WORTH = 2 * 3600 * RATE
"""Frames of the long flight, at most: two hours' worth."""
WINDOW = 32
"""Frames over which memory is averaged: it breathes with what is loaded."""


class Script:
    """Plays a flight over and over by frames, however long they take."""

    def __init__(self, path):
        self._path, self.frames = path, 0

    def camera(self, now):
        self.frames += 1
        return self._path.camera_at(self.frames / RATE % self._path.duration)


def fly(window, flight, frames):
    """Memory (bytes, on average) of every WINDOW frames of a flight, and what a user does now and then on the way."""
    data = window.session.data
    window.panel.player = script = Script(Flight.load(flight).over(data.grid, data.height_range))
    held = []
    for number in frames:
        np.asarray(window.canvas.draw())
        assert window.error is None
        assert window.panel.player is script
        if number % WINDOW == 0:
            held.append([])
        held[-1].append(resident() if number % 16 == 0 else held[-1][-1])
        if number % 200 == 100:
            window.toggle_map()
        if number % 200 == 150:
            window.session.use("udlod" if window.session.algorithm == "raycast" else "raycast")
    return [float(np.mean(each)) for each in held if len(each) == WINDOW]


@needs_proc
def test_flying_for_long_leaves_nothing_behind(hands):
    held = fly(hands.window, "rotation", range(8 * WINDOW))
    assert max(held[-2:]) <= TOLERANCE * max(held[4:6])


@needs_proc
@pytest.mark.nightly
@pytest.mark.timeout(5 * 3600)
def test_flying_for_hours_leaves_nothing_behind(hands, tmp_path, record_property):
    """Two hours' worth of flight, or as much of it as OROGEN_SOAK_MINUTES (240 unless told otherwise) allow.

    Over more ground than is kept resident, so that nodes come and go all the time; in small pictures, which take less
    time and make as many things. Mesa's software driver may end it (docs/reliability.md, known limits).
    """
    heights, end = tmp_path / "hills.tif", time.monotonic() + 60 * float(os.environ.get("OROGEN_SOAK_MINUTES", 240))
    y, x = np.mgrid[0:4096, 0:4096].astype(np.float32) / 64
    write_depth(heights, 600 + 300 * np.sin(x) * np.cos(0.7 * y) + 20 * np.sin(9 * x + 5 * y))
    with orogen.open(heights, spacing=30.0, settings={"memory": 48 << 20}, build="wait") as terrain:
        window = Window(Session(terrain), canvas=type(hands.canvas)(size=(900, 1000), pixel_ratio=1 / 16))
        held = fly(window, "teleport", itertools.takewhile(lambda _: time.monotonic() < end, range(WORTH)))
        window.close()
    warm, last = held[len(held) // 5 : 2 * len(held) // 5], held[-(len(held) // 5) :]
    minutes, growth = len(held) * WINDOW / RATE / 60, np.mean(last) / np.mean(warm) - 1
    record_property("minutes_flown", round(minutes, 1))
    record_property("growth_percent", round(100 * growth, 2))
    log.warning("%.0f minutes' worth of flight: memory %+.2f %%", minutes, 100 * growth)
    assert 1 + growth <= TOLERANCE


def test_an_event_shows_in_the_next_picture(bare, record_property):
    """From the event to the finished picture; the figure goes into the report of the tests."""
    bare.settle()
    latencies = []
    for number in range(8):
        before = bare.draw().copy()
        start = time.perf_counter()
        bare.send("wheel", dx=30.0, dy=0.0, x=100, y=60)
        after = bare.draw()
        latencies.append(1000 * (time.perf_counter() - start))
        assert np.abs(after.astype(int) - before).max() > 3, number
    record_property("input_to_picture_ms", round(float(np.median(latencies)), 1))
    assert np.median(latencies) < 2000
