"""Background loading: reads what is wanted most, drops what is no longer wanted, tries again what failed."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from typing import Generic, TypeVar

from orogen.streaming.faults import Faults
from orogen.streaming.retry import Failures

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Loader(Generic[K, V]):
    """Threads that turn keys into values, in the order of the latest `want` call.

    A key that fails is tried again after a while, and ever more rarely, until `want` no longer names it.
    """

    def __init__(
        self,
        load: Callable[[K], V],
        *,
        threads: int,
        ahead: int,
        name: str = "data",
        faults: Faults | None = None,
        stand_in: Callable[[K], V | None] = lambda key: None,
    ) -> None:
        """`load` runs in the threads; at most `ahead` loaded values wait to be taken.

        `name`: what messages call the data, such as their file. `faults`: where failures are noted. `stand_in`: what to
        hand out when a key fails for the first time, until it comes after all; None for nothing.
        """
        self._load = load
        self._ahead = ahead
        self._name = name
        self._faults = faults or Faults()
        self._stand_in = stand_in
        self._wanted: frozenset[K] = frozenset()
        self._todo: deque[K] = deque()
        self._busy: set[K] = set()
        self._ready: dict[K, V] = {}
        self._failures: Failures[K] = Failures()
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
            for key in [key for key in self._failures if key not in listed]:
                self._forget(key)
            self._ready = {key: value for key, value in self._ready.items() if key in listed}
            known = self._failures.keys() | self._ready.keys() | self._busy
            self._todo = deque(key for key in listed if key not in known)
            self._changed.notify_all()

    def take(self, most: int) -> list[tuple[K, V]]:
        """Up to `most` loaded values, in no particular order; each is handed out once.

        Name each to `fail` where it cannot be used after all.
        """
        with self._changed:
            keys = list(self._ready)[:most]
            taken = [(key, self._ready.pop(key)) for key in keys]
            if taken:
                self._changed.notify_all()
            return taken

    def done(self, key: K) -> None:
        """Note that a value taken is in its place; what failed before is forgotten."""
        if self._failures:
            with self._changed:
                self._forget(key)

    def fail(self, key: K, error: BaseException) -> None:
        """Note that a value taken could not be used: it is loaded again after a while."""
        with self._changed:
            self._failed(key, error)
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Block until something is ready or nothing is under way; False after `timeout` seconds."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._ready) or not self._pending(), timeout)

    @property
    def pending(self) -> int:
        """Keys that are still to be read, being read, or waiting to be taken.

        What failed counts once more: passing faults are waited for, lasting ones are not.
        """
        with self._changed:
            return self._pending()

    @property
    def failed(self) -> dict[K, BaseException]:
        """Wanted keys that could not be loaded so far, and why."""
        with self._changed:
            return {key: failure.error for key, failure in self._failures.items()}

    @property
    def retry_in(self) -> float | None:
        """Seconds until a key that failed is tried again, 0 while that goes on; None where there is none."""
        with self._changed:
            due = min((failure.due for failure in self._failures.values()), default=math.inf)
            return None if due == math.inf else max(0.0, due - time.monotonic())

    def close(self) -> None:
        """Stop the threads; what is being read is finished and dropped."""
        with self._changed:
            self._closed = True
            self._wanted = frozenset()
            self._todo.clear()
            self._ready.clear()
            for key in list(self._failures):
                self._forget(key)
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _pending(self) -> int:
        count = len(self._todo) + len(self._busy) + len(self._ready)
        for key, failure in self._failures.items():
            if failure.times == 1:
                count += key not in self._busy and key not in self._ready
            else:
                count -= key in self._busy
        return count

    def _forget(self, key: K) -> None:
        self._failures.remove(key)
        self._faults.clear((self, key))

    def _failed(self, key: K, error: BaseException) -> None:
        if key in self._wanted:
            self._failures.add(key, error)
            self._faults.add(f"loading {key}", error, place=self._name, key=(self, key))

    def _next(self) -> K | None:
        """Wait for a key to load, those that have not failed first; None when closed."""
        while not self._closed:
            timeout = None
            if len(self._ready) + len(self._busy) < self._ahead:
                if self._todo:
                    return self._todo.popleft()
                due = {key: failure.due for key, failure in self._failures.items() if failure.due < math.inf}
                idle = due.keys() - self._busy - self._ready.keys()
                if idle:
                    key = min(idle, key=due.__getitem__)
                    timeout = due[key] - time.monotonic()
                    if timeout <= 0:
                        return key
            self._changed.wait(timeout)
        return None

    def _run(self) -> None:
        while True:
            with self._changed:
                key = self._next()
                if self._closed:
                    return
                assert key is not None
                first = key not in self._failures
                self._busy.add(key)
            value, error = None, None
            try:
                value = self._load(key)
            except Exception as problem:
                error = problem
                if first:
                    value = self._stood_in(key)
            with self._changed:
                self._busy.discard(key)
                if error is None:
                    self._failures.hold(key)
                else:
                    self._failed(key, error)
                if value is not None and key in self._wanted:
                    self._ready[key] = value
                self._changed.notify_all()

    def _stood_in(self, key: K) -> V | None:
        try:
            return self._stand_in(key)
        except Exception:
            # what `load` raised is told
            return None
