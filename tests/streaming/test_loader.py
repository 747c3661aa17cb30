"""The background loader: order, cancellation, bounds, failures, shutdown."""

from __future__ import annotations

import logging
import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator

import pytest

from orogen.streaming.loader import Loader

Make = Callable[..., Loader[int, int]]


@pytest.fixture
def loader_of() -> Iterator[Make]:
    opened: list[Loader[int, int]] = []

    def make(load: Callable[[int], int], threads: int = 2, ahead: int = 64) -> Loader[int, int]:
        opened.append(Loader(load, threads=threads, ahead=ahead))
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
    reads = Counter[int]()

    def load(key: int) -> int:
        reads[key] += 1
        if key % 3 == 0:
            raise OSError(f"expected a file, got none for {key}")
        return key

    caplog.set_level(logging.WARNING, "orogen")
    loader = loader_of(load)
    for _ in range(5):
        loader.want(range(9))
        assert set(drained(loader)) == {1, 2, 4, 5, 7, 8}
    assert {key: str(error) for key, error in loader.failed.items()} == {
        key: f"expected a file, got none for {key}" for key in (0, 3, 6)
    }
    assert [reads[key] for key in (0, 3, 6)] == [1, 1, 1]
    assert len(caplog.records) == 3
    loader.want([1])
    assert drained(loader) == {1: 1}
    assert loader.failed == {}
    loader.want([0])
    assert drained(loader) == {}
    assert reads[0] == 2


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
