"""How long the GPU takes for each named pass."""

from __future__ import annotations

import logging
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from orogen.gpu.checked import checked
from orogen.gpu.readback import Readback

if TYPE_CHECKING:
    from orogen.gpu.device import Gpu

_log = logging.getLogger("orogen")

_PASSES = 1024
_IN_FLIGHT = 4


class FrameTimer:
    """Timestamps around passes. Without the feature "timestamp-query" it begins passes all the same, untimed.

    Each frame: begin passes, `resolve` with the last encoder, submit it; `results` whenever wanted.
    """

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self.enabled = True
        """Whether passes that begin now are timed: that costs a tenth or two of a millisecond of CPU time a frame."""
        self._on = "timestamp-query" in gpu.features
        self._names: list[str] = []
        self._under_way: deque[tuple[list[str], Readback]] = deque(maxlen=_IN_FLIGHT)
        self._latest: dict[str, float] = {}
        if self._on:
            with checked("timer"):
                self._queries = gpu.device.create_query_set(label="timer", type="timestamp", count=2 * _PASSES)
            self._ticks = gpu.buffer("timer", 16 * _PASSES, "QUERY_RESOLVE|COPY_SRC", "timer")
            self._period = _tick_nanoseconds(gpu)

    def compute_pass(self, encoder: Any, name: str) -> Any:
        """Begin a compute pass that is timed under `name`; passes of one name in a frame add up."""
        return encoder.begin_compute_pass(label=name, **self._writes(name))

    def render_pass(self, encoder: Any, name: str, **attachments: Any) -> Any:
        """Begin a render pass that is timed under `name`; `attachments` go to `begin_render_pass`."""
        return encoder.begin_render_pass(label=name, **attachments, **self._writes(name))

    def resolve(self, encoder: Any) -> None:
        """Record the end of the frame, after its last pass, into the encoder that `Gpu.submit` is given next."""
        names, self._names = self._names, []
        if names:
            encoder.resolve_query_set(self._queries, 0, 2 * len(names), self._ticks.raw, 0)
            readback = self._gpu.read_buffer(self._ticks, size=16 * len(names), dtype=np.uint64, encoder=encoder)
            self._gpu.after(encoder, lambda: self._under_way.append((names, readback)))

    def results(self, *, wait: bool = False) -> dict[str, float]:
        """Milliseconds by name of the latest frame known; empty before the first and without the feature.

        `wait`: wait for the last frame that was submitted.
        """
        while self._under_way and (wait or self._under_way[0][1].ready()):
            names, readback = self._under_way.popleft()
            self._latest = self._sums(names, readback.result())
        return dict(self._latest)

    def _writes(self, name: str) -> dict[str, Any]:
        if not (self._on and self.enabled) or len(self._names) == _PASSES:
            return {}
        first = 2 * len(self._names)
        self._names.append(name)
        if len(self._names) == _PASSES:
            _log.warning("timer: a frame has more than %d passes; the rest is not timed", _PASSES)
        writes = {
            "query_set": self._queries,
            "beginning_of_pass_write_index": first,
            "end_of_pass_write_index": first + 1,
        }
        return {"timestamp_writes": writes}

    def _sums(self, names: list[str], ticks: np.ndarray) -> dict[str, float]:
        spans = ticks.reshape(-1, 2).astype(np.int64)
        sums: dict[str, float] = {}
        for name, (begin, end) in zip(names, spans.tolist(), strict=True):
            # some drivers reset their clock: a span below zero says nothing
            sums[name] = sums.get(name, 0.0) + max(0, end - begin) * self._period / 1e6
        return sums


def _tick_nanoseconds(gpu: Gpu) -> float:
    """Length of a timestamp's tick, which the driver leaves unscaled."""
    from wgpu.backends.wgpu_native import lib

    return float(lib.wgpuQueueGetTimestampPeriod(gpu.device.queue._internal))
