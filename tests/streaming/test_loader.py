"""The background loader: order, cancellation, bounds, failures, shutdown."""

from __future__ import annotations

import logging
import random
import threading
import time
import weakref
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from orogen.streaming import retry
from orogen.streaming.faults import Faults
from orogen.streaming.loader import Loader

Make = Callable[..., Loader[int, int]]


@pytest.fixture
def loader_of() -> Iterator[Make]:
    opened: list[Loader[int, int]] = []

    def make(load: Callable[[int], int], threads: int = 2, ahead: int = 64, **options: Any) -> Loader[int, int]:
        opened.append(Loader(load, threads=threads, ahead=ahead, **options))
        return opened[-1]

    yield make
    for loader in opened:
        loader.close()


def drained(loader: Loader[int, int]) -> dict[int, int]:
    found: dict[int, int] = {}
    while loader.pending:
        assert loader.wait(10)
        found.update(loader.take(100))
    return found


def test_loads_everything_in_the_order_asked_for(loader_of: Make) -> None:
    order: list[int] = []
    loader = loader_of(lambda key: order.append(key) or -key, threads=1)
    keys = random.Random(1).sample(range(1000), 200)
    loader.want(keys)
    assert drained(loader) == {key: -key for key in keys}
    assert order == keys
    assert loader.wait(0)
    assert loader.take(1) == []


def test_the_latest_list_counts(loader_of: Make) -> None:
    busy, go = threading.Event(), threading.Event()
    order: list[int] = []

    def load(key: int) -> int:
        order.append(key)
        busy.set()
        assert go.wait(10)
        return key

    loader = loader_of(load, threads=1)
    loader.want([1, 2, 3])
    assert busy.wait(10)
    loader.want([7, 3])
    assert loader.pending == 3
    go.set()
    # 1 was being read and is dropped, 2 is never read
    assert drained(loader) == {7: 7, 3: 3}
    assert order == [1, 7, 3]


def test_what_is_read_while_it_is_named_again_is_kept(loader_of: Make) -> None:
    busy, go = threading.Event(), threading.Event()
    reads = Counter[int]()

    def load(key: int) -> int:
        reads[key] += 1
        busy.set()
        assert go.wait(10)
        return key

    loader = loader_of(load)
    loader.want([1])
    assert busy.wait(10)
    loader.want([])
    loader.want([1, 2])
    go.set()
    assert drained(loader) == {1: 1, 2: 2}
    assert reads == {1: 1, 2: 1}


def test_loaded_values_that_are_not_named_again_are_forgotten(loader_of: Make) -> None:
    loader = loader_of(lambda key: key)
    loader.want([1, 2, 3])
    while loader.pending > 3 or not loader.wait(0):
        time.sleep(0.001)
    loader.want([2])
    assert drained(loader) == {2: 2}


def test_a_key_that_is_named_twice_is_read_once(loader_of: Make) -> None:
    reads = Counter[int]()

    def load(key: int) -> int:
        reads[key] += 1
        return key

    loader = loader_of(load, ahead=1)
    loader.want([1, 2, 1, 2, 1])
    assert drained(loader) == {1: 1, 2: 2}
    assert reads == {1: 1, 2: 1}


@pytest.mark.parametrize("threads", [1, 4])
def test_no_more_than_so_many_values_wait_to_be_taken(loader_of: Make, threads: int) -> None:
    started = Counter[str]()
    lock = threading.Lock()

    def load(key: int) -> int:
        with lock:
            started["reads"] += 1
        return key

    loader = loader_of(load, threads, ahead=5)
    loader.want(range(50))
    taken = 0
    while loader.pending:
        assert loader.wait(10)
        time.sleep(0.002)
        with lock:
            assert started["reads"] <= taken + 5
        taken += len(loader.take(2))
    assert taken == 50


def test_failures_are_reported_once_and_kept_until_the_key_is_dropped(
    loader_of: Make, caplog: pytest.LogCaptureFixture
) -> None:
    def load(key: int) -> int:
        if key % 3 == 0:
            raise OSError(f"expected a file, got none for {key}")
        return key

    caplog.set_level(logging.WARNING, "orogen")
    faults = Faults()
    loader = loader_of(load, faults=faults, name="pages")
    for _ in range(5):
        loader.want(range(9))
        assert set(drained(loader)) == {1, 2, 4, 5, 7, 8}
    assert {key: str(error) for key, error in loader.failed.items()} == {
        key: f"expected a file, got none for {key}" for key in (0, 3, 6)
    }
    assert sorted(record.getMessage() for record in caplog.records) == [
        f"loading {key} failed: pages: expected a file, got none for {key}" for key in (0, 3, 6)
    ]
    assert {fault.cause: fault.missing for fault in faults.all} == {
        f"pages: expected a file, got none for {key}": 1 for key in (0, 3, 6)
    }
    loader.want([1])
    assert drained(loader) == {1: 1}
    assert loader.failed == {}
    assert loader.retry_in is None
    assert [fault.missing for fault in faults.all] == [0, 0, 0]


def test_what_failed_is_tried_again_ever_more_rarely(loader_of: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "FIRST", 0.02)
    monkeypatch.setattr(retry, "LONGEST", 0.16)
    times: list[float] = []

    def load(key: int) -> int:
        if key == 1:
            times.append(time.monotonic())
            if len(times) < 7:
                raise OSError("expected a file, got none")
        return key

    loader = loader_of(load)
    loader.want([1, 2])
    assert drained(loader) == {2: 2}
    assert len(times) == 2, "a passing fault is waited for, a lasting one is not"
    assert loader.retry_in is not None
    assert loader.retry_in < 0.2
    loader.want([1, 2, 3])
    deadline = time.monotonic() + 60
    found: dict[int, int] = {}
    while 1 not in found:
        assert time.monotonic() < deadline
        found.update(loader.take(10))
        time.sleep(0.005)
    assert set(loader.failed) == {1}, "it has still to prove useful"
    loader.done(1)
    assert loader.failed == {}
    assert loader.pending == 0
    gaps = [after - before for before, after in pairwise(times)]
    for gap, least in zip(gaps, (0.02, 0.04, 0.08, 0.16, 0.16, 0.16), strict=True):
        assert gap >= least


def test_a_value_that_could_not_be_used_is_loaded_again(loader_of: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "FIRST", 0.02)
    reads = Counter[int]()

    def load(key: int) -> int:
        reads[key] += 1
        return reads[key]

    loader = loader_of(load)
    loader.want([7])
    for times in (1, 2, 3):
        assert loader.failed.keys() == ({7} if times > 1 else set())
        while not (taken := loader.take(1)):
            time.sleep(0.005)
        assert taken == [(7, times)]
        if times < 3:
            loader.fail(7, OSError("no room for it"))
    loader.done(7)
    assert loader.failed == {}
    assert loader.pending == 0


def test_something_may_stand_in_until_a_key_comes(loader_of: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retry, "FIRST", 0.02)
    broken = {5, 6}

    def load(key: int) -> int:
        if key in broken:
            raise OSError("no")
        return key

    loader = loader_of(load, stand_in=lambda key: -key if key == 5 else 1 // 0)
    loader.want([5, 6])
    assert drained(loader) == {5: -5}
    assert set(loader.failed) == {5, 6}
    broken.clear()
    found: dict[int, int] = {}
    while found.keys() != {5, 6}:
        found.update(loader.take(2))
        time.sleep(0.005)
    assert found == {5: 5, 6: 6}


def test_failures_hold_no_data(loader_of: Make) -> None:
    """What the calls that failed had at hand is let go."""
    gone: list[weakref.ref[np.ndarray]] = []

    def load(key: int) -> int:
        data = np.zeros(1000)
        gone.append(weakref.ref(data))
        try:
            return int("x")
        except ValueError as error:
            raise OSError("no") from error

    loader = loader_of(load)
    loader.want([1])
    drained(loader)
    assert set(loader.failed) == {1}
    assert [there() for there in gone] == [None] * len(gone)


def test_waiting_ends_with_the_time_given(loader_of: Make) -> None:
    go = threading.Event()
    loader = loader_of(lambda key: go.wait(10) and key)
    loader.want([1])
    start = time.monotonic()
    assert not loader.wait(0.05)
    assert time.monotonic() - start >= 0.05
    go.set()
    assert loader.wait(10)


def test_can_be_closed_at_any_time() -> None:
    chance = random.Random(3)
    before = threading.active_count()
    for _ in range(30):
        loader = Loader[int, int](lambda key: time.sleep(0.001) or key, threads=3, ahead=4)
        loader.want(range(100))
        time.sleep(chance.random() * 0.005)
        loader.take(chance.randrange(3))
        loader.close()
        assert threading.active_count() == before
        loader.close()


def test_no_wakeup_is_lost_between_lists_that_change_and_values_that_are_taken(loader_of: Make) -> None:
    """The consumer renames, takes and waits at random; at the end all that is named must come."""
    chance = random.Random(4)
    for _ in range(60):
        loader = loader_of(lambda key: -key, threads=3, ahead=2)
        kept: set[int] = set()
        for _ in range(10):
            loader.want([key for key in chance.sample(range(30), 12) if key not in kept])
            kept.update(key for key, _ in loader.take(chance.randrange(3)))
            if chance.random() < 0.3:
                assert loader.wait(10)
        last = chance.sample(range(30), 12)
        loader.want([key for key in last if key not in kept])
        kept.update(drained(loader))
        assert set(last) <= kept
        loader.close()
