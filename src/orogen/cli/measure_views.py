"""How soon an event shows in the live views: a part of `orogen bench`."""

from __future__ import annotations

import io
import json
import statistics
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from orogen.cli.console import Report
from orogen.cli.measure import Figure
from orogen.terrain import Terrain, open_terrain

SIZE = (1280, 720)
EVENTS = 30
"""Turns of the wheel whose answer is timed."""
QUIET = {True: 5.0, False: 1.0}
"""Seconds without a picture after which a page is at rest, with a software driver and with a GPU."""


def measure(data: Any, report: Report, **options: Any) -> list[Figure]:
    """Milliseconds from an event to the picture that answers it, and what a page is sent for it.

    In a window without a screen the picture is finished in memory; on the way to a page it is also encoded, sent
    through a socket of this machine and decoded. `options`: as `orogen.open` takes them.
    """
    with open_terrain(data, build="wait", **options) as terrain:
        group = f"views, {terrain.name} {SIZE[0]}x{SIZE[1]}, {terrain.renderer.gpu.info.name}"
        report(0.0, group)
        figures = _timed(group, "window, from event to picture", _window_times(terrain))
        report(0.5, group)
        try:
            figures += _page(group, terrain)
        except ModuleNotFoundError as error:
            figures.append(Figure(group, "browser", None, note=f"{error.name} is not installed"))
        report(1.0, group)
    return figures


def _timed(group: str, name: str, milliseconds: Sequence[float]) -> list[Figure]:
    worst = sorted(milliseconds)[int(0.95 * len(milliseconds))]
    return [
        Figure(group, f"{name}, median", statistics.median(milliseconds), "ms"),
        Figure(group, f"{name}, 95 %", worst, "ms"),
    ]


def _window_times(terrain: Terrain) -> list[float]:
    from rendercanvas.offscreen import OffscreenRenderCanvas

    from orogen.view.session import Session
    from orogen.view.window import Window

    window = Window(Session(terrain), canvas=OffscreenRenderCanvas(size=SIZE, pixel_ratio=1))
    times = []
    try:
        for number in range(EVENTS + 5):
            start = time.perf_counter()
            window.handle({**WHEEL, "event_type": "wheel", "dx": 40.0 if number % 2 else -40.0})
            np.asarray(window.canvas.draw())
            times.append(1000 * (time.perf_counter() - start))
            if window.error:
                raise window.error
    finally:
        window.close()
    # the first ones make pipelines and load
    return times[5:]


WHEEL: dict[str, Any] = {"x": 640.0, "y": 360.0, "dx": 40.0, "dy": 0.0, "buttons": (), "modifiers": ()}
"""Turns the view about what lies in the middle."""


def _page(group: str, terrain: Terrain) -> list[Figure]:
    from orogen.view.serve import Server, ServerSettings

    with Server(terrain, ServerSettings(port=0)) as server:
        drawing = threading.Thread(target=server.run)
        drawing.start()
        try:
            times, pictures, size = _asked(server.address, QUIET[terrain.renderer.gpu.info.kind == "cpu"])
        finally:
            server.stop()
            drawing.join()
    return [
        *_timed(group, "browser, from event to picture", times),
        Figure(group, "browser, pictures until rest for an event, median", statistics.median(pictures)),
        Figure(group, "browser, sent until rest for an event, median", statistics.median(size) / 1000, "kB"),
    ]


def _asked(address: str, quiet: float) -> tuple[list[float], list[int], list[int]]:
    """Of each event: milliseconds to the picture, and pictures and bytes until rest."""
    from PIL import Image
    from websockets.sync.client import connect
    from websockets.typing import Origin

    times, counts, sizes = [], [], []
    place, origin = f"{address.replace('http', 'ws', 1)}socket", Origin("/".join(address.split("/")[:3]))
    with connect(place, origin=origin, max_size=None) as socket:

        def tell(kind: str, **values: Any) -> None:
            socket.send(json.dumps({"type": kind, **values}))

        def shown(timeout: float) -> int:
            message = socket.recv(timeout=timeout)
            assert isinstance(message, bytes)
            Image.open(io.BytesIO(message[8:])).load()
            tell("shown", index=int.from_bytes(message[:8], "big"))
            return len(message)

        def rest() -> list[int]:
            found = []
            while True:
                try:
                    found.append(shown(quiet))
                except TimeoutError:
                    return found

        tell("resize", width=SIZE[0], height=SIZE[1], pwidth=SIZE[0], pheight=SIZE[1], ratio=1.0)
        shown(60.0)
        rest()
        for number in range(EVENTS // 3):
            start = time.perf_counter()
            tell("wheel", **{**WHEEL, "dx": 40.0 if number % 2 else -40.0})
            first = shown(60.0)
            times.append(1000 * (time.perf_counter() - start))
            found = [first, *rest()]
            counts.append(len(found))
            sizes.append(sum(found))
    return times, counts, sizes
