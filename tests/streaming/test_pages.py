"""Pages of an algorithm's own: what is resident, in which order, and that slots hold what was made for them."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.errors import BudgetError, SourceError
from orogen.gpu import Gpu
from orogen.streaming.pages import PageStore

PAGE = 64

Make = Callable[..., PageStore[int]]


def page_of(key: int, words: int = PAGE // 4) -> NDArray[np.uint32]:
    return np.random.default_rng(key).integers(0, 2**32, words, np.uint32)


@pytest.fixture
def store_of(gpu: Gpu) -> Iterator[Make]:
    opened: list[PageStore[int]] = []

    def make(create: Callable[[int], Any] = page_of, **options: Any) -> PageStore[int]:
        opened.append(PageStore(gpu, "test", PAGE, create, **options))
        return opened[-1]

    yield make
    for store in opened:
        store.close()


def assert_slots_hold_their_pages(gpu: Gpu, store: PageStore[int]) -> None:
    words = gpu.read_buffer(store.buffer).result().view(np.uint32).reshape(-1, PAGE // 4)
    assert len(set(store.resident.values())) == len(store.resident)
    for key, slot in store.resident.items():
        np.testing.assert_array_equal(words[slot], page_of(key))


def test_slots_hold_what_was_made_also_after_the_buffer_has_grown(gpu: Gpu, store_of: Make) -> None:
    store = store_of(memory=1000 * PAGE)
    first = store.buffer
    for last in (20, 300, 1000):
        store.want(range(last))
        store.settle()
        assert set(store.resident) == set(range(last))
        assert_slots_hold_their_pages(gpu, store)
    assert store.buffer is not first
    assert store.pending == 0


def test_what_is_wanted_least_recently_makes_room(gpu: Gpu, store_of: Make) -> None:
    store = store_of(memory=8 * PAGE)
    assert store.capacity == 8
    store.want(range(8))
    store.settle()
    # as a frame does that is drawn again: now it counts in which order they are wanted
    store.want(range(8))
    store.want([3, 5, 20])
    store.settle()
    # of those that were wanted together the least important one goes
    assert set(store.resident) == {0, 1, 2, 3, 4, 5, 6, 20}
    assert_slots_hold_their_pages(gpu, store)
    store.want([30, 31, 32, 33, 34])
    store.settle()
    assert {3, 5, 20, 30, 31, 32, 33, 34} == set(store.resident)
    assert_slots_hold_their_pages(gpu, store)


def test_what_does_not_fit_is_left_out_from_the_end(store_of: Make) -> None:
    store = store_of(memory=5 * PAGE + 3)
    store.want([7, 3, 9, 7, 1, 2, 8, 4])
    store.settle()
    assert set(store.resident) == {7, 3, 9, 1, 2}


def test_several_owners_take_turns_and_may_go(store_of: Make) -> None:
    class Owner:
        pass

    one, other = Owner(), Owner()
    store = store_of(memory=4 * PAGE)
    store.want([1, 2, 3, 4], one)
    store.want([10, 2, 20, 30], other)
    store.settle()
    assert set(store.resident) == {1, 10, 2, 3}
    del other
    gc.collect()
    store.want([1, 2, 3, 4], one)
    store.settle()
    assert set(store.resident) == {1, 2, 3, 4}


def test_a_pump_keeps_to_its_budget_but_uploads_one_page_at_least(store_of: Make) -> None:
    store = store_of(memory=100 * PAGE)
    store.want(range(20))
    done = 0
    while len(store._loader._ready) < 20:
        store._loader.wait(0.01)
    assert store.pump(1) == PAGE
    assert store.pump(5 * PAGE + 1) == 5 * PAGE
    assert len(store.resident) == 6
    assert store.pending == 14
    while store.pending:
        done += store.pump(10 * PAGE)
    assert done == 14 * PAGE
    assert store.pump(10 * PAGE) == 0


def test_shorter_pages_and_bytes_will_do(gpu: Gpu, store_of: Make) -> None:
    store = store_of(lambda key: page_of(key, 3).tobytes() if key % 2 else page_of(key, 5), memory=10 * PAGE)
    store.want([1, 2])
    store.settle()
    words = gpu.read_buffer(store.buffer).result().view(np.uint32).reshape(-1, PAGE // 4)
    np.testing.assert_array_equal(words[store.resident[1], :3], page_of(1, 3))
    np.testing.assert_array_equal(words[store.resident[2], :5], page_of(2, 5))


def test_a_page_that_cannot_be_made_holds_nothing_up(store_of: Make) -> None:
    def create(key: int) -> NDArray[np.uint32]:
        if key == 2:
            raise SourceError("expected a page, got none")
        return page_of(key)

    store = store_of(create, memory=10 * PAGE)
    store.want([1, 2, 3])
    store.settle()
    assert set(store.resident) == {1, 3}
    assert set(store.failed) == {2}


def test_what_is_no_longer_wanted_is_not_made(store_of: Make) -> None:
    gate, made = threading.Event(), []

    def create(key: int) -> NDArray[np.uint32]:
        gate.wait(20)
        made.append(key)
        return page_of(key)

    store = store_of(create, memory=100 * PAGE, threads=1)
    store.want(range(50))
    store.want([60])
    gate.set()
    store.settle()
    assert 60 in store.resident
    assert len(made) <= 2


def test_memory_for_less_than_a_page_is_refused(store_of: Make) -> None:
    with pytest.raises(BudgetError, match="at least one page of 64 bytes, got 63"):
        store_of(memory=63)
