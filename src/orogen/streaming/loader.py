"""Background loading: reads what is wanted most, drops what is no longer wanted."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")

_log = logging.getLogger("orogen")


class Loader(Generic[K, V]):
    """Threads that turn keys into values, in the order of the latest `want` call.

    A key that fails is reported once and left alone until `want` no longer names it.
    """

    def __init__(self, load: Callable[[K], V], *, threads: int, ahead: int) -> None:
        """`load` runs in the threads; at most `ahead` loaded values wait to be taken."""
        self._load = load
        self._ahead = ahead
        self._wanted: frozenset[K] = frozenset()
        self._todo: deque[K] = deque()
        self._busy: set[K] = set()
        self._ready: dict[K, V] = {}
        self._failed: dict[K, BaseException] = {}
        self._closed = False
        self._changed = threading.Condition()
        self._threads = [
            threading.Thread(target=self._run, name=f"orogen-loader-{i}", daemon=True) for i in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    def want(self, keys: Iterable[K]) -> None:
        """Replace the list of wanted keys, the most urgent first. What is being read goes on, the rest is forgotten."""
        with self._changed:
            listed = dict.fromkeys(keys)
            self._wanted = frozenset(listed)
            self._failed = {key: error for key, error in self._failed.items() if key in listed}
            self._ready = {key: value for key, value in self._ready.items() if key in listed}
            known = self._failed.keys() | self._ready.keys() | self._busy
            self._todo = deque(key for key in listed if key not in known)
            self._changed.notify_all()

    def take(self, most: int) -> list[tuple[K, V]]:
        """Up to `most` loaded values, in no particular order; each is handed out once."""
        with self._changed:
            keys = list(self._ready)[:most]
            taken = [(key, self._ready.pop(key)) for key in keys]
            if taken:
                self._changed.notify_all()
            return taken

    def wait(self, timeout: float | None = None) -> bool:
        """Block until something is ready or nothing is under way; False after `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._ready) or not self._pending(), timeout)

    @property
    def pending(self) -> int:
        """Keys that are still to be read, being read, or waiting to be taken."""
        with self._changed:
            return self._pending()

    @property
    def failed(self) -> dict[K, BaseException]:
        """Wanted keys that could not be loaded, and why."""
        with self._changed:
            return dict(self._failed)

    def close(self) -> None:
        """Stop the threads; what is being read is finished and dropped."""
        with self._changed:
            self._closed = True
            self._wanted = frozenset()
            self._todo.clear()
            self._ready.clear()
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _pending(self) -> int:
        return len(self._todo) + len(self._busy) + len(self._ready)

    def _startable(self) -> bool:
        return bool(self._todo) and len(self._ready) + len(self._busy) < self._ahead

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._startable())
                if self._closed:
                    return
                key = self._todo.popleft()
                self._busy.add(key)
            try:
                value, error = self._load(key), None
            except Exception as problem:
                value, error = None, problem
            with self._changed:
                self._busy.discard(key)
                if key not in self._wanted:
                    pass
                elif error is None:
                    self._ready[key] = value  # type: ignore[assignment]
                else:
                    self._failed[key] = error
                    _log.warning("cannot load %s: %s", key, error)
                self._changed.notify_all()
