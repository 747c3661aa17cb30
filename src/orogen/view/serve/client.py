"""One page: what it has said and not been heard, and what it has been sent and not shown. Bounded at every place."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.view.controls import Event
from orogen.view.serve.messages import Shown, Size
from orogen.view.serve.pace import BEST, Fineness, Pace

UNDERWAY = 2
"""Pictures that are sent and not yet shown, at most: two keep a long way busy."""
MOST_EVENTS = 256
"""Events that wait to be heard, at most."""
REST = 0.25
"""Seconds without a new picture after which the latest is sent as finely as can be."""


class Client:
    """Stands between the thread that talks to the page and the one that draws for it; both may use it."""

    def __init__(self, changed: Callable[[], None], loop: asyncio.AbstractEventLoop) -> None:
        """`changed` is called where there may be something to draw. `loop`: of the thread that talks to the page."""
        self.size: Size | None = None
        """The page's size; None before it is known."""
        self.resting = False
        """Whether the latest picture is final; the drawing thread says so."""
        self.gone = False
        """Whether the page is gone."""
        self.pace = Pace()
        self._changed, self._loop = changed, loop
        self._lock = threading.Lock()
        self._events: deque[Event] = deque()
        self._picture: NDArray[np.uint8] | None = None
        self._coarse: NDArray[np.uint8] | None = None  # the latest picture, where it has not been sent at its finest
        self._arrived = asyncio.Event()
        self._sent: dict[int, float | None] = {}
        self._count = 0
        self._failed: str | None = None

    # -- by the drawing thread -----------------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the page can take another picture."""
        return not self.gone and self._picture is None and len(self._sent) < UNDERWAY

    def take(self) -> list[Event]:
        """The events since the last time."""
        with self._lock:
            events = list(self._events)
            self._events.clear()
            return events

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Have a picture sent."""
        with self._lock:
            self._picture = picture
        self._loop.call_soon_threadsafe(self._arrived.set)

    def keep(self, picture: NDArray[np.uint8]) -> None:
        """Have a picture sent as soon as the view rests; one that is shown by then takes its place."""
        with self._lock:
            if self._picture is not None:
                self._picture = picture
            else:
                self._coarse = picture
        # whoever waits without an end begins to count
        self._loop.call_soon_threadsafe(self._arrived.set)

    def fail(self, reason: str) -> None:
        """Have the page told that there will be no more pictures."""
        self._failed = reason
        self._loop.call_soon_threadsafe(self._arrived.set)

    # -- by the thread that talks to the page --------------------------------------------------------------------------

    def hear(self, message: Event | Size | Shown) -> None:
        """Take a message. Raises SettingsError where it does not fit."""
        if isinstance(message, Shown):
            if message.index not in self._sent:
                raise SettingsError("expected the number of a picture that is under way")
            since = self._sent.pop(message.index)
            if since is not None:
                self.pace.took(time.monotonic() - since)
        elif isinstance(message, Size):
            self.size = message
        else:
            with self._lock:
                self._keep(message)
        self._changed()

    def _keep(self, event: Event) -> None:
        """Append an event, or make it one with the last, as rendercanvas would later."""
        last, kind = self._events[-1] if self._events else None, event["event_type"]
        same = last is not None and all(
            last.get(key) == event.get(key) for key in ("event_type", "buttons", "modifiers")
        )
        if last is not None and same and kind in ("pointer_move", "wheel"):
            if kind == "wheel":
                event = {**event, "dx": event["dx"] + last["dx"], "dy": event["dy"] + last["dy"]}
            self._events[-1] = event
            return
        if len(self._events) >= MOST_EVENTS:
            raise SettingsError("too many events at once")
        self._events.append(event)

    async def next(self) -> tuple[int, NDArray[np.uint8], Fineness]:
        """Wait for the next picture to send: its number, itself and how finely it is to be encoded.

        Raises SettingsError where there will be none.
        """
        while True:
            try:
                async with asyncio.timeout(REST if self._coarse is not None else None):
                    await self._arrived.wait()
            except TimeoutError:
                if not (self.resting and not self._sent):
                    continue
                with self._lock:
                    picture, fineness, self._coarse = self._coarse, BEST, None
            else:
                self._arrived.clear()
                if self._failed is not None:
                    raise SettingsError(self._failed)
                with self._lock:
                    picture, self._picture, fineness = self._picture, None, self.pace.fineness
                    self._coarse = picture if picture is not None else self._coarse
            if picture is not None:
                self._count += 1
                self._sent[self._count] = None
                self._changed()
                return self._count, picture, fineness

    @property
    def alone(self) -> bool:
        """Whether a picture has the way to itself, so that the distance can be measured."""
        return len(self._sent) == 1

    def reached(self, pong: asyncio.Future[float]) -> None:
        """Take what a ping measured."""
        if not pong.cancelled() and not pong.exception():
            self.pace.distance = pong.result()

    def sent(self, index: int, fineness: Fineness) -> None:
        """Note that a picture is about to go out."""
        # the picture at rest is large on purpose, and says nothing on moving ones
        self._sent[index] = None if fineness == BEST else time.monotonic()
