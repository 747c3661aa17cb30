"""Who runs the tasks of a build: threads of this process, or the workers of a Dask cluster."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from orogen.errors import OrogenError, SettingsError


@dataclass(frozen=True)
class Workers:
    """Runs functions elsewhere."""

    executor: Executor
    """Where."""
    count: int
    """How many tasks run at the same time."""
    remote: bool
    """Whether in other processes: what they are given and give is pickled."""

    def in_order(self, task: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
        """The results in the order of the arguments; only a few tasks wait at a time."""
        waiting: deque[Future[Any]] = deque()
        try:
            for each in arguments:
                waiting.append(self.executor.submit(task, *each))
                if len(waiting) > self.count + 1:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except Exception as error:
            if not type(error).__module__.startswith("distributed"):
                raise
            raise OrogenError(
                f"--scheduler: the workers failed ({error}); look at their log, then run it again"
            ) from error
        finally:
            for future in waiting:
                future.cancel()
            # what runs already writes on: whoever starts anew must not meet it
            wait([future for future in waiting if not future.cancelled()])


def threads() -> int:
    """Threads that build: one for each processor core, 2 to 8."""
    return min(8, max(2, os.cpu_count() or 2))


@contextmanager
def hired(scheduler: str | None = None) -> Iterator[Workers]:
    """Threads, or the workers behind the address of a Dask scheduler such as tcp://host:8786.

    Raises SettingsError where nobody answers there, or Dask is not installed.
    """
    if scheduler is None:
        with ThreadPoolExecutor(threads(), "orogen-build") as pool:
            yield Workers(pool, threads(), remote=False)
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise SettingsError("--scheduler: needs dask.distributed; pip install 'orogen[cluster]'") from error
    try:
        client = Client(scheduler, timeout="5s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise SettingsError(f"--scheduler: nobody answers at {scheduler} ({error}); check the address") from error
    with client:
        count = sum(client.ncores().values())
        if not count:
            raise SettingsError(f"--scheduler: no worker at {scheduler}; start some with `dask worker {scheduler}`")
        # not pure: a task writes files, so that the same task of a later build must run again
        yield Workers(client.get_executor(pure=False), count, remote=True)
