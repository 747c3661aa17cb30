"""The list of faults: what could not be had, told once, however many nodes miss it."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Hashable
from dataclasses import dataclass, replace

_log = logging.getLogger("orogen")

_PART = re.compile(r"[{(\[][\d\s,]*[})\]]")
"""Numbers in brackets: they name a part of a file, and one file is one cause."""
_KEPT = 256
"""Causes that are remembered."""
_AGAIN = 60.0
"""Seconds after which a cause that had gone and comes back is told again."""


@dataclass(frozen=True)
class Fault:
    """Something that went wrong while pictures went on."""

    what: str
    """What failed first, such as "loading NodeKey(level=0, x=2, y=3)"."""
    cause: str
    """Why: the file or other place, and the message of the error."""
    kind: type[BaseException]
    """Type of the error."""
    times: int
    """How often it happened, repeats included."""
    missing: int
    """How many nodes or pages lack because of it now; 0 once all came, or are no longer wanted."""
    seen: float
    """When it happened last, in seconds since the epoch."""


class Faults:
    """Faults by their cause. Thread-safe."""

    def __init__(self) -> None:
        self._faults: dict[tuple[type[BaseException], str], Fault] = {}
        self._missing: dict[Hashable, tuple[type[BaseException], str]] = {}
        self._told: dict[tuple[type[BaseException], str], float] = {}
        self._lock = threading.Lock()

    @property
    def all(self) -> tuple[Fault, ...]:
        """Every cause since the start, the oldest first; at most 256, those that are over being forgotten first."""
        with self._lock:
            return tuple(self._faults.values())

    def add(self, what: str, error: BaseException, *, place: str = "", key: Hashable = None) -> None:
        """Note a fault, with one warning per cause.

        `place`: the file or the like, told where the error does not name it; `key`: what lacks until `clear` names it.
        """
        text = str(error) or type(error).__name__
        text = text if place in text else f"{place}: {text}"
        cause = type(error), _PART.sub("", text)
        now = time.time()
        with self._lock:
            if key is not None:
                self._forget(key)
                self._missing[key] = cause
            old = self._faults.get(cause)
            fault = replace(old, times=old.times + 1, seen=now) if old else Fault(what, text, cause[0], 1, 0, now)
            back = fault.missing == 0 and now - self._told.get(cause, -_AGAIN) >= _AGAIN
            self._faults[cause] = replace(fault, missing=fault.missing + (key is not None))
            if back:
                self._told[cause] = now
            self._tidy()
        if back:
            _log.warning("%s failed: %s", what, text)

    def clear(self, key: Hashable) -> None:
        """Note that something came after all, or is no longer wanted."""
        if self._missing:
            with self._lock:
                self._forget(key)

    def _forget(self, key: Hashable) -> None:
        cause = self._missing.pop(key, None)
        if cause is not None and cause in self._faults:
            fault = self._faults[cause]
            self._faults[cause] = replace(fault, missing=fault.missing - 1)

    def _tidy(self) -> None:
        if len(self._faults) > _KEPT:
            gone = min(self._faults, key=lambda cause: (self._faults[cause].missing > 0, self._faults[cause].seen))
            del self._faults[gone]
            self._told.pop(gone, None)
