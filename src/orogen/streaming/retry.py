"""What failed and when to try it again: soon at first, then ever more rarely."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from orogen.errors import OrogenError

K = TypeVar("K")
T = TypeVar("T")

FIRST = 0.25
"""Seconds from the first failure to the first repeat; each further one waits twice as long as the one before."""
LONGEST = 8.0
"""Seconds between repeats at most, and so the delay, at most, with which the end of a fault is noticed."""
ATTEMPTS = 3
"""How often what nothing can stand in for is tried before its error is raised."""


def steadily(call: Callable[[], T]) -> T:
    """What a call gives, for data that nothing coarser can stand in for: tried again soon where it fails."""
    for number in range(1, ATTEMPTS):
        try:
            return call()
        except OrogenError:
            time.sleep(FIRST * 2.0 ** (number - 1))
    return call()


@dataclass(frozen=True)
class Failure:
    """A key that failed."""

    error: BaseException
    """Why, the last time."""
    times: int
    """How often in a row."""
    due: float
    """When it is tried again, by `time.monotonic`."""


class Failures(Mapping[K, Failure], Generic[K]):
    """Failures by key. Not thread-safe by itself."""

    def __init__(self) -> None:
        self._failures: dict[K, Failure] = {}

    def add(self, key: K, error: BaseException) -> None:
        """Note that a key failed (again)."""
        times = self._failures[key].times + 1 if key in self._failures else 1
        delay = min(FIRST * 2.0 ** min(times - 1, 32), LONGEST)
        self._failures[key] = Failure(_without_frames(error), times, time.monotonic() + delay)

    def remove(self, key: K) -> None:
        """Forget a key."""
        self._failures.pop(key, None)

    def hold(self, key: K) -> None:
        """Put the repeat of a key off: it came, and has still to prove useful."""
        if key in self._failures:
            self._failures[key] = replace(self._failures[key], due=math.inf)

    def resting(self, key: K) -> bool:
        """Whether a key failed so lately that it should be left alone."""
        failure = self._failures.get(key)
        return failure is not None and time.monotonic() < failure.due

    def __getitem__(self, key: K) -> Failure:
        return self._failures[key]

    def __iter__(self) -> Iterator[K]:
        return iter(self._failures)

    def __len__(self) -> int:
        return len(self._failures)


def _without_frames(error: BaseException) -> BaseException:
    """The error without its tracebacks, which would keep the arrays of the calls that failed."""
    link: BaseException | None = error
    while link is not None:
        link.__traceback__ = None
        link = link.__cause__ or link.__context__
    return error
