"""Work that keeps a GPU's clock up while the CPU prepares what is to be timed."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from orogen.gpu.device import Gpu

_GROUPS = 4096
_FIRST_TURNS = 16
_LONGEST = 200.0


class Load:
    """A GPU that rested between two frames runs at a fraction of its clock for the next one: give it this meanwhile."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        shader = gpu.shader("load", Path(__file__).with_name("load.wgsl"))
        layout = gpu.layout("load", {0: ("COMPUTE", "uniform"), 1: ("COMPUTE", "storage")})
        self._pipeline = gpu.compute("load", shader, "main", [layout])
        self._turns = gpu.buffer("load turns", 16, "UNIFORM|COPY_DST", "timer")
        sink = gpu.buffer("load", 16, "STORAGE", "timer")
        self._bind = gpu.bind("load", layout, {0: self._turns, 1: sink})
        self._rate = self._turns_per_millisecond()

    def submit(self, milliseconds: float) -> None:
        """Work for about so long, 200 ms at most; does not wait for it."""
        self._submit(int(min(milliseconds, _LONGEST) * self._rate))

    def _submit(self, turns: int) -> None:
        self._gpu.write(self._turns, np.array([turns, 0, 0, 0], np.uint32))
        encoder = self._gpu.encoder("load")
        work = encoder.begin_compute_pass(label="load")
        work.set_pipeline(self._pipeline)
        work.set_bind_group(0, self._bind)
        work.dispatch_workgroups(_GROUPS)
        work.end()
        self._gpu.submit(encoder)

    def _turns_per_millisecond(self) -> float:
        """Found by giving more, until it takes long enough to be measured; by then the clock is up."""
        turns, spent = _FIRST_TURNS, 0.0
        while spent < 20.0:
            turns *= 2
            start = time.perf_counter()
            self._submit(turns)
            self._gpu.wait()
            spent = 1000 * (time.perf_counter() - start)
        return turns / spent
