from __future__ import annotations

import math
import time
from functools import cache

import pytest

from orogen.gpu import Text

SPIN = """
@group(0) @binding(0) var<storage, read_write> count: atomic<u32>;
@compute @workgroup_size(1) fn spin() {
    for (var i = 0u; i < #{ROUNDS}u; i++) { atomicAdd(&count, i); }
}
"""


@pytest.fixture(scope="module")
def spin(gpu):
    """Records a pass of so many rounds."""
    values = gpu.buffer("values", 4, "STORAGE", "test")
    layout = gpu.layout("values", {0: ("COMPUTE", "storage")})
    group = gpu.bind("values", layout, {0: values})

    @cache
    def pipeline(rounds):
        shader = gpu.shader("spin", Text("spin.wgsl", SPIN), constants={"ROUNDS": rounds})
        return gpu.compute("spin", shader, "spin", [layout])

    def record(compute_pass, rounds):
        compute_pass.set_pipeline(pipeline(rounds))
        compute_pass.set_bind_group(0, group)
        compute_pass.dispatch_workgroups(1)
        compute_pass.end()

    return record


@pytest.fixture
def target(gpu):
    texture = gpu.texture("target", (8, 8), "rgba8unorm", "RENDER_ATTACHMENT", "test")
    return {"color_attachments": [{"view": texture.view(), "load_op": "clear", "store_op": "store"}]}


def test_times_by_name_add_up(gpu, spin):
    if "timestamp-query" not in gpu.features:
        pytest.skip("the adapter has no timestamps")
    timer = gpu.timer()
    # threads of a software driver write the timestamps: on busy cores a late one stretches or shrinks a pass
    longest, shortest = 0.0, math.inf
    for _ in range(8):
        encoder = gpu.encoder("frame")
        spin(timer.compute_pass(encoder, "long"), 1_000_000)
        spin(timer.compute_pass(encoder, "short"), 10)
        spin(timer.compute_pass(encoder, "long"), 1_000_000)
        timer.resolve(encoder)
        before = timer.results()
        start = time.perf_counter()
        gpu.submit(encoder)
        times = timer.results(wait=True)
        elapsed = 1000 * (time.perf_counter() - start)
        longest, shortest = max(longest, times["long"]), min(shortest, times["short"])
    assert list(before) == list(times) == ["long", "short"]
    assert before != times
    assert longest > shortest >= 0
    # a software driver's timestamps and the clock differ by some hundredths of a millisecond
    assert 0 <= sum(times.values()) <= elapsed + 0.1


def test_render_passes_are_timed(gpu, spin, target):
    if "timestamp-query" not in gpu.features:
        pytest.skip("the adapter has no timestamps")
    timer = gpu.timer()
    encoder = gpu.encoder("frame")
    timer.render_pass(encoder, "clear", **target).end()
    spin(timer.compute_pass(encoder, "spin"), 10)
    timer.resolve(encoder)
    gpu.submit(encoder)
    times = timer.results(wait=True)
    assert list(times) == ["clear", "spin"]
    assert 0 < sum(times.values()) < 10_000


def test_latest_frame_is_told(gpu, spin):
    if "timestamp-query" not in gpu.features:
        pytest.skip("the adapter has no timestamps")
    timer = gpu.timer()
    seen = []
    for frame in range(7):
        encoder = gpu.encoder("frame")
        spin(timer.compute_pass(encoder, f"pass {frame}"), 100)
        timer.resolve(encoder)
        gpu.submit(encoder)
        seen += [list(timer.results())] if frame != 3 else []
    assert list(timer.results(wait=True)) == ["pass 6"]
    assert all(names in ([], *([f"pass {k}"] for k in range(7))) for names in seen)


def test_without_timestamps_the_same_calls_draw(gpu, spin, target, monkeypatch):
    monkeypatch.setattr(gpu, "features", gpu.features - {"timestamp-query"})
    timer = gpu.timer()
    encoder = gpu.encoder("frame")
    spin(timer.compute_pass(encoder, "a"), 10)
    timer.render_pass(encoder, "b", **target).end()
    timer.resolve(encoder)
    gpu.submit(encoder)
    assert timer.results(wait=True) == {}


def test_too_many_passes_are_drawn_untimed(gpu, caplog, monkeypatch):
    from orogen.gpu import timer as timer_module

    if "timestamp-query" not in gpu.features:
        pytest.skip("the adapter has no timestamps")
    monkeypatch.setattr(timer_module, "_PASSES", 2)
    timer = gpu.timer()
    encoder = gpu.encoder("frame")
    for name in "abc":
        timer.compute_pass(encoder, name).end()
    timer.resolve(encoder)
    gpu.submit(encoder)
    assert set(timer.results(wait=True)) == {"a", "b"}
    assert "more than 2 passes" in caplog.text
