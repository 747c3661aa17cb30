"""Windows that are opened and closed over and over, and how soon an event shows."""

import gc
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import orogen
from orogen.view.session import Session
from orogen.view.window import Window

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
def test_a_thousand_terrains_in_windows_leave_nothing_behind(hands):
    canvas, held = type(hands.canvas), []
    heights = np.random.default_rng(1).random((48, 64)).astype(np.float32)
    for number in range(1000):
        with orogen.open(heights, spacing=10.0) as terrain:
            cycle(canvas, terrain, mapped=number % 10 == 0)
        if number in (200, 999):
            held.append(resident())
    assert held[1] <= TOLERANCE * held[0]


def test_flying_for_long_leaves_nothing_behind(bare):
    bare.settle()
    bare.press("Tab")
    bare.send("key_down", key="d")
    held = []
    for number in range(150):
        bare.draw()
        if number in (50, 149):
            held.append(resident() if sys.platform.startswith("linux") else 1)
    assert held[1] <= TOLERANCE * held[0]


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
