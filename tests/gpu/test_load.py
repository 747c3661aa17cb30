"""A GPU that is kept at work."""

import time

from orogen.gpu import Gpu
from orogen.gpu.load import Load


def test_work_takes_about_as_long_as_asked(gpu: Gpu) -> None:
    load = Load(gpu)
    gpu.wait()
    spans = []
    for milliseconds in (0.0, 60.0):
        start = time.perf_counter()
        load.submit(milliseconds)
        asked = time.perf_counter() - start
        gpu.wait()
        spans.append(1000 * (time.perf_counter() - start))
    assert asked < 0.05, "it waits"
    # cores that do something else make it longer, never much shorter
    assert spans[1] > 20.0 > 0.5 * spans[0]


def test_it_is_bounded(gpu: Gpu) -> None:
    load = Load(gpu)
    start = time.perf_counter()
    load.submit(1e9)
    gpu.wait()
    assert time.perf_counter() - start < 10.0
