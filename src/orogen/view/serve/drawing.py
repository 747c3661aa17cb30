"""Draws for all pages in one thread: each has its own window on the same terrain, and they share what is resident."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass, field
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.errors import BudgetError, OrogenError
from orogen.shading.style import Style
from orogen.view.opening import Data, Shared
from orogen.view.quality import Quality
from orogen.view.renderer import Scene
from orogen.view.serve.canvas import RemoteCanvas
from orogen.view.serve.client import Client
from orogen.view.session import Session
from orogen.view.window import SHORTEST_REST, Window

log = logging.getLogger("orogen")

MOST_FPS = 60.0
"""Pictures a second for one page, at most."""
CALM = 1.0
"""Seconds after the last motion or event from which pictures are sent at their finest, even if more samples follow."""
LEVELS, SHARE, STRIDE = 12, 0.01, 3
"""Of 255 steps of colour, of all pixels: two pictures differ where more than that share differ by more than that; of
rows and columns every third is looked at."""


class Page(Shared):
    """A data set for one page."""

    @property
    def name(self) -> str:
        """What the page shows as the name: without the folders of this machine."""
        name = super().name
        return PurePath(name.replace("\\", "/")).name or name


@dataclass(frozen=True)
class Look:
    """How every page begins."""

    style: Style = field(default_factory=Style)
    """What pictures look like."""
    scene: Scene = field(default_factory=Scene)
    """How the terrain is put before the camera."""
    camera: Camera | None = None
    """Where the camera is; None shows all."""
    panel: bool = True
    """Whether there is a panel."""


class DrawingQuality(Quality):
    """Goes by what drawing takes: how long a page takes to show pictures says nothing on that."""

    cost = 0.0
    """Milliseconds that the latest picture took to draw and to read back."""

    def took(self, interval: float, work: float, geometry: float = 0.0, least_detail: float = 1.0) -> None:
        """Learn from a moving frame."""
        super().took(max(work, self.cost), max(work, self.cost), geometry, least_detail)


def differs(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Whether two (height, width, 4) pictures differ so much that one sees it at once: not by smoother edges alone."""
    if one.shape != other.shape:
        return True
    first, second = (picture[::STRIDE, ::STRIDE, :3].astype(np.int16) for picture in (one, other))
    return bool((np.abs(first - second).max(axis=-1) > LEVELS).mean() > SHARE)


class View:
    """A page's window. Used by the drawing thread alone."""

    def __init__(self, client: Client, data: Data, look: Look) -> None:
        assert client.size
        self.client = client
        self.canvas = RemoteCanvas()
        self._size = client.size
        self.canvas.resize(self._size.width, self._size.height, self._size.ratio)
        session = Session(
            Page(data), look.style, look.scene, camera=look.camera, owned=True, files=False
        )  # fmt: skip
        try:
            self.window = Window(session, canvas=self.canvas, panel=look.panel)
        except BaseException:
            session.close()
            raise
        self._quality = session.quality = DrawingQuality()
        self._due = 0.0
        self._retry = float("inf")
        self._answers = True  # whether the next picture answers what the page has said, however little it changes
        self._seen: NDArray[np.uint8] | None = None  # the picture that was sent last
        self._lively = 0.0  # when something last moved or was said

    def step(self, now: float) -> float:
        """Hear the page and draw for it where it is time; gives the time (s) of the next step, inf: on an event."""
        size = self.client.size
        if size and size != self._size:
            self._size, self._answers = size, True
            self.canvas.resize(size.width, size.height, size.ratio)
        events = self.client.take()
        self._answers = self._answers or bool(events)
        self.canvas.take(events)
        if now >= self._retry:
            self.canvas.wanted = True
        if self.canvas.wanted:
            self.client.resting = self._calm
        if self.canvas.wanted and self.client.ready:
            if now < self._due:
                return self._due
            self._due = now + 1 / MOST_FPS
            start = time.perf_counter()
            picture = self.canvas.picture()
            self._quality.cost = 1000 * (time.perf_counter() - start)
            if self.window.error:
                raise self.window.error
            if picture is not None:
                self._hand_over(picture)
            self.client.resting = self._calm or not self.canvas.wanted
            wait = self.window.session.retry_in
            self._retry = float("inf") if wait is None else time.monotonic() + max(wait, SHORTEST_REST)
        elif self.window.error:
            raise self.window.error
        if self.canvas.wanted:
            return self._due if self.client.ready else float("inf")
        return self._retry

    @property
    def _calm(self) -> bool:
        """Whether nothing has moved or been said for so long that the picture is worth its finest form."""
        return not self._answers and time.monotonic() - self._lively > CALM

    def _hand_over(self, picture: NDArray[np.uint8]) -> None:
        """Send a picture that moves or answers; of those that only get finer what is seen to, and the last."""
        panel, seen = self.window.panel, self._seen
        lively = self._answers or self.window.moving or (panel is not None and panel.settling)
        if lively:
            self._lively = time.monotonic()
        if lively or seen is None or (not self._calm and differs(picture, seen)):
            self._answers, self._seen = False, picture
            self.client.show(picture)
        else:
            self.client.keep(picture)

    def close(self) -> None:
        """Give everything back."""
        self.window.close()


class Drawing:
    """The loop that draws."""

    def __init__(self, data: Data, look: Look) -> None:
        self._data, self._look = data, look
        self._changed = threading.Event()
        self._lock, self._running = threading.Lock(), threading.Lock()
        self._clients: list[Client] = []
        self._views: dict[Client, View] = {}
        self._stopped = False

    def wake(self) -> None:
        """Look at all pages again; from any thread."""
        self._changed.set()

    def add(self, client: Client) -> None:
        """Draw for a page from now on, until it is gone; from any thread."""
        with self._lock:
            self._clients.append(client)
        self.wake()

    def stop(self) -> None:
        """End `run`; from any thread."""
        self._stopped = True
        self.wake()

    def run(self) -> None:
        """Draw until stopped; nothing is done while nothing changes."""
        with self._running:
            try:
                while not self._stopped:
                    self._changed.clear()
                    wait = self._turn() - time.monotonic()
                    if wait > 0:
                        # bounded, because on Windows a wait without an end keeps Ctrl-C from being heard
                        self._changed.wait(min(wait, 1.0))
            finally:
                for client in list(self._views):
                    self._drop(client)

    def join(self) -> None:
        """Wait until `run` has ended."""
        with self._running:
            pass

    def _turn(self) -> float:
        """A step for each page; gives the time of the next one."""
        with self._lock:
            clients = list(self._clients)
        due = float("inf")
        for client in clients:
            if client.gone:
                self._drop(client)
                continue
            if client.size is None:
                continue
            try:
                if client not in self._views:
                    self._views[client] = View(client, self._data, self._look)
                due = min(due, self._views[client].step(time.monotonic()))
            except Exception as error:
                # one page's trouble is not the others'
                log.error("a page was closed: %s", error, exc_info=not isinstance(error, OrogenError))
                full = isinstance(error, BudgetError)
                client.fail("there is no memory left for this view" if full else "this view has failed")
                self._drop(client)
        return due

    def _drop(self, client: Client) -> None:
        with self._lock:
            self._clients = [other for other in self._clients if other is not client]
        view = self._views.pop(client, None)
        if view:
            try:
                view.close()
            except Exception as error:
                log.warning("closing a page's view: %s", error)
