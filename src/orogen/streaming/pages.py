"""Pages: data of an algorithm's own (chunks, meshes), made in the background and kept in one storage buffer."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping
from itertools import chain, zip_longest
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary

from numpy.typing import NDArray

from orogen.errors import BudgetError, DeviceLostError, GpuError
from orogen.gpu import Buffer, Gpu
from orogen.streaming.faults import Faults
from orogen.streaming.loader import Loader

K = TypeVar("K", bound=Hashable)

_FIRST = 64
"""Slots at first; their number doubles up to what the memory holds."""
_AHEAD = 64
"""Pages that are made, at most, and wait to be uploaded."""


class PageStore(Generic[K]):
    """Slots of equal size in a buffer that grows; the least recently wanted page makes room for a new one."""

    def __init__(
        self,
        gpu: Gpu,
        name: str,
        page_bytes: int,
        make: Callable[[K], bytes | NDArray[Any]],
        *,
        memory: int = 64 << 20,
        threads: int = 2,
        faults: Faults | None = None,
    ) -> None:
        """`make` turns a key into at most `page_bytes` bytes (a multiple of 4), in `threads` threads.

        `memory`: bytes of the buffer at most. `faults`: where failures are noted. Raises BudgetError where the memory
        is less than a page.
        """
        self._gpu = gpu
        self._name = name
        self.page_bytes = page_bytes
        """Bytes from one slot to the next."""
        self.capacity = min(memory, gpu.limits["max-storage-buffer-binding-size"]) // page_bytes
        """Pages that may be resident at once."""
        if self.capacity < 1:
            raise BudgetError(f"{name}: expected room for at least one page of {page_bytes} bytes, got {memory}")
        self._slots: OrderedDict[K, int] = OrderedDict()
        self.version = 0
        """Counts what has come to be resident or is so no longer."""
        self._wishes: WeakKeyDictionary[object, list[K]] = WeakKeyDictionary()
        self._wanted: frozenset[K] = frozenset()
        self._count = min(_FIRST, self.capacity)
        self._free = list(range(self._count))[::-1]
        self._buffer = self._allocated(self._count)
        self._loader: Loader[K, bytes | NDArray[Any]] = Loader(
            make, threads=threads, ahead=_AHEAD, name=name, faults=faults
        )

    @property
    def buffer(self) -> Buffer:
        """Slot after slot; another buffer once it has grown, so bind groups have to follow."""
        return self._buffer

    @property
    def resident(self) -> Mapping[K, int]:
        """Slot of every page that is in the buffer."""
        return self._slots

    @property
    def wanted(self) -> frozenset[K]:
        """Pages that any owner wants and that there is room for."""
        return self._wanted

    @property
    def pending(self) -> int:
        """Wanted pages that are still to come."""
        return self._loader.pending

    @property
    def failed(self) -> Mapping[K, BaseException]:
        """Wanted pages that could not be made or uploaded so far, and why."""
        return self._loader.failed

    @property
    def retry_in(self) -> float | None:
        """Seconds until a page that failed is made again; None where none has failed."""
        return self._loader.retry_in

    def want(self, keys: Iterable[K], owner: object | None = None) -> None:
        """Replace the pages that `owner` (a view) wants, the most important first; those without room are left out.

        Several owners' wishes take turns. Those of an owner that is gone are forgotten.
        """
        self._wishes[self if owner is None else owner] = list(keys)
        turns = chain.from_iterable(zip_longest(*self._wishes.values()))
        listed = list(dict.fromkeys(key for key in turns if key is not None))[: self.capacity]
        self._wanted = frozenset(listed)
        for key in reversed(listed):
            if key in self._slots:
                self._slots.move_to_end(key)
        self._loader.want([key for key in listed if key not in self._slots])

    def pump(self, budget: int) -> int:
        """Upload pages of at most `budget` bytes (one at least); returns the bytes uploaded.

        A page that finds no memory or whose upload fails is made again later.
        """
        done = 0
        while not done or done + self.page_bytes <= budget:
            taken = self._loader.take(1)
            if not taken:
                break
            ((key, page),) = taken
            try:
                buffer = self._buffer_for(key)
                self._gpu.write(buffer, page, self._slots[key] * self.page_bytes)
            except DeviceLostError:
                raise
            except GpuError as error:
                if key in self._slots:
                    self._free.append(self._slots.pop(key))
                    self.version += 1
                self._loader.fail(key, error)
                continue
            self._loader.done(key)
            done += len(page) if isinstance(page, bytes) else page.nbytes
        return done

    def settle(self) -> None:
        """Load until every wanted page that can be made and fits is resident."""
        while self.pending:
            if self.pump(self.page_bytes * _AHEAD):
                # staging memory is given back when the GPU is done with it
                self._gpu.wait()
            else:
                self._loader.wait(1.0)

    def close(self) -> None:
        """Stop loading and give the memory back."""
        self._loader.close()
        self._buffer.destroy()

    def _buffer_for(self, key: K) -> Buffer:
        """The buffer, with a slot for the page."""
        if key not in self._slots:
            self.version += 1
            victim = None if self._free else next((old for old in self._slots if old not in self._wanted), None)
            if not self._free and self._count < self.capacity:
                try:
                    self._grow(min(2 * self._count, self.capacity))
                except GpuError as error:
                    # what is not wanted goes sooner then
                    if victim is None or isinstance(error, DeviceLostError):
                        raise
            if not self._free:
                # no more pages are wanted than there are slots
                assert victim is not None
                self._free.append(self._slots.pop(victim))
            self._slots[key] = self._free.pop()
        return self._buffer

    def _grow(self, count: int) -> None:
        old, kept = self._buffer, self._count * self.page_bytes
        buffer = self._allocated(count)
        encoder = self._gpu.encoder(f"{self._name} grows")
        encoder.copy_buffer_to_buffer(old.raw, 0, buffer.raw, 0, kept)
        self._gpu.submit(encoder)
        self._free += range(count - 1, self._count - 1, -1)
        self._count, self._buffer = count, buffer

    def _allocated(self, count: int) -> Buffer:
        size = count * self.page_bytes
        return self._gpu.buffer(self._name, size, "STORAGE|COPY_SRC|COPY_DST", f"{self._name} pages")
