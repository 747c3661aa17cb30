"""Data back from the GPU without waiting for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import GpuError
from orogen.gpu.checked import checked
from orogen.gpu.interrupts import uninterrupted
from orogen.gpu.resources import Buffer

ROW_ALIGNMENT = 256
"""Bytes that the rows of a texture copy are aligned to (WebGPU)."""

_PATIENCE = 1.0
"""Seconds between looks at whether the device that is waited for is still there."""
_STEP = 1 << 16
_IDLE_LIMIT = 32 << 20


class StagingPool:
    """Mappable buffers for reuse: creating one costs more than copying through it."""

    def __init__(self, create: Callable[[int], Buffer]) -> None:
        """`create`: makes a mappable buffer of so many bytes, counted in the memory account."""
        self._create = create
        self._idle: list[Buffer] = []
        self._lock = threading.Lock()

    def take(self, size: int) -> Buffer:
        """A buffer of at least `size` bytes."""
        size = -(-size // _STEP) * _STEP
        with self._lock:
            fitting = [buffer for buffer in self._idle if size <= buffer.size <= 4 * size]
            if fitting:
                best = min(fitting, key=lambda buffer: buffer.size)
                self._idle.remove(best)
                return best
        return self._create(size)

    def give_back(self, buffer: Buffer) -> None:
        """Keep an unmapped buffer for later."""
        with self._lock:
            self._idle.append(buffer)
            while sum(idle.size for idle in self._idle) > _IDLE_LIMIT:
                self._idle.pop(0).destroy()

    def trim(self) -> None:
        """Destroy the buffers that nobody uses."""
        with self._lock:
            while self._idle:
                self._idle.pop().destroy()


class Readback:
    """A copy on its way from the GPU, from the moment its commands are submitted."""

    def __init__(
        self,
        label: str,
        pool: StagingPool,
        staging: Buffer,
        unpack: Callable[[NDArray[np.uint8]], NDArray[Any]],
        check: Callable[[], None],
    ) -> None:
        """`unpack`: makes the result, in memory of its own, from the mapped bytes of `staging`.

        `check`: raises DeviceLostError where the device is gone.
        """
        self._label = label
        self._check = check
        self._pool = pool
        self._staging: Buffer | None = staging
        self._unpack = unpack
        self._data: NDArray[Any] | None = None
        self._mapping: Any = None
        self._lock = threading.Lock()

    def begin(self) -> None:
        """Ask for the data; the copy into the staging buffer has been submitted."""
        assert self._staging is not None
        with checked(self._label), uninterrupted():
            # "READ" would submit an empty command buffer first
            self._mapping = self._staging.raw.map_async("READ_NOSYNC")
            # nobody awaits it, and the event loop of this moment may have ended when the data comes
            self._mapping._call_soon_threadsafe = None

    def ready(self) -> bool:
        """Whether `result` would return without waiting."""
        # a promise tells its state only to event loops in public
        return self._mapping is not None and self._mapping._thread_event.is_set()

    def result(self) -> NDArray[Any]:
        """The data; waits for the GPU where it is not ready. The same array each time.

        Raises DeviceLostError where it will never come.
        """
        with self._lock:
            if self._data is None:
                if self._mapping is None or self._staging is None:
                    raise GpuError(f"reading {self._label!r}: expected its encoder to be submitted before its result")
                # what was asked of a device that is lost meanwhile may never be answered
                while not self._mapping._thread_event.wait(_PATIENCE):
                    self._check()
                with checked(self._label):
                    self._mapping.sync_wait()
                    # wgpu ends the process where the memory went with the device
                    self._check()
                    mapped = np.frombuffer(self._staging.raw.read_mapped(copy=False), np.uint8)
                    self._data = self._unpack(mapped)
                    del mapped
                    self._staging.raw.unmap()
                self._pool.give_back(self._staging)
                self._staging = None
            return self._data
