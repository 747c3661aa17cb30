"""Commands written down first: they do what wgpu's own encoders do, and say what is wrong."""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orogen.errors import GpuError
from orogen.gpu import Gpu, Text
from orogen.gpu.commands import Commands
from orogen.gpu.driver import open_driver
from orogen.terrain import open_terrain

ADD = """
@group(0) @binding(0) var<storage, read_write> values: array<u32>;
@group(1) @binding(0) var<uniform> step: vec4<u32>;
@compute @workgroup_size(4) fn add(@builtin(global_invocation_id) id: vec3<u32>) { values[id.x] += step.x; }
@compute @workgroup_size(4) fn double(@builtin(global_invocation_id) id: vec3<u32>) { values[id.x] *= 2u; }
"""


@pytest.fixture(scope="module")
def kernels(gpu: Gpu) -> SimpleNamespace:
    """Pipelines `add` and `double` over a buffer, which group 1 says what to add to, at a dynamic offset."""
    layout = gpu.layout("values", {0: ("COMPUTE", "storage")})
    steps = gpu.layout("step", {0: ("COMPUTE", "uniform dynamic")})
    shader = gpu.shader("add", Text("add.wgsl", ADD))
    numbers = np.zeros((3, 64), np.uint32)
    numbers[:, 0] = 1, 10, 100
    buffer = gpu.buffer("steps", numbers, "UNIFORM", "test")
    return SimpleNamespace(
        layout=layout,
        step=gpu.bind("step", steps, {0: (buffer, 0, 16)}),
        add=gpu.compute("add", shader, "add", [layout, steps]),
        double=gpu.compute("double", shader, "double", [layout]),
    )


@pytest.fixture(params=["written down", "wgpu's own"])
def encoders(request: pytest.FixtureRequest, gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways of recording."""
    if request.param == "wgpu's own":
        monkeypatch.setattr(gpu, "_driver", None)
        monkeypatch.setattr(gpu, "_write_buffer", gpu.device.queue.write_buffer)


@pytest.fixture
def begun(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The passes that the library is told to begin."""
    assert gpu._driver is not None
    seen: list[str] = []
    for kind in ("Compute", "Render"):
        functions = gpu._driver.functions[f"{kind}PassEncoder"]
        original = functions.Begin

        def begin(*arguments: Any, kind: str = kind, original: Any = original) -> Any:
            seen.append(kind)
            return original(*arguments)

        monkeypatch.setattr(functions, "Begin", begin)
    return seen


def dispatch(run: Any, pipeline: Any, groups: dict[int, tuple[Any, ...]]) -> None:
    run.set_pipeline(pipeline)
    for index, given in groups.items():
        run.set_bind_group(index, *given)
    run.dispatch_workgroups(1)


def test_dispatches_copies_and_clears_come_in_order(gpu: Gpu, kernels: Any, encoders: None) -> None:
    values = gpu.buffer("values", np.arange(4, dtype=np.uint32), "STORAGE|COPY_SRC", "test")
    other = gpu.buffer("other", np.full(8, 7, np.uint32), "STORAGE|COPY_SRC", "test")
    arguments = gpu.buffer("arguments", np.array([9, 1, 1, 1], np.uint32), "INDIRECT", "test")
    group = gpu.bind("values", kernels.layout, {0: values})
    encoder = gpu.encoder("work")
    run = encoder.begin_compute_pass(label="first")
    dispatch(run, kernels.add, {0: (group,), 1: (kernels.step, [512])})
    dispatch(run, kernels.add, {1: (kernels.step, [256])})
    run.end()
    run = encoder.begin_compute_pass(label="second")
    run.set_pipeline(kernels.double)
    run.set_bind_group(0, group)
    run.dispatch_workgroups_indirect(arguments.raw, 4)
    run.end()
    encoder.clear_buffer(other.raw, 0, 8)
    encoder.copy_buffer_to_buffer(values.raw, 4, other.raw, 16, 8)
    run = encoder.begin_compute_pass(label="third")
    dispatch(run, kernels.add, {0: (group,), 1: (kernels.step, [0])})
    run.end()
    gpu.submit(encoder)
    np.testing.assert_array_equal(gpu.read_buffer(values, dtype=np.uint32).result(), 2 * (np.arange(4) + 110) + 1)
    np.testing.assert_array_equal(
        gpu.read_buffer(other, dtype=np.uint32).result(), [0, 0, 7, 7, 2 * 111, 2 * 112, 7, 7]
    )


def test_what_is_written_arrives(gpu: Gpu, encoders: None) -> None:
    buffer = gpu.buffer("data", np.zeros(6, np.uint32), "COPY_SRC", "test")
    gpu.write(buffer, b"\1\0\0\0\2\0\0\0", 4)
    gpu.write(buffer, np.array([3.5], np.float32), 16)
    gpu.write(buffer, b"\5\6", 20)
    found = gpu.read_buffer(buffer, dtype=np.uint32).result()
    np.testing.assert_array_equal(found, [0, 1, 2, 0, np.float32(3.5).view(np.uint32), 0x605])


@pytest.mark.parametrize("algorithm", ["udlod", "raycast", "cdlod"])
def test_pictures_are_those_of_wgpus_encoders(algorithm: str) -> None:
    x, y = np.meshgrid(np.linspace(0, 9, 70), np.linspace(0, 7, 60))
    heights = (80 * np.sin(x) * np.cos(1.3 * y)).astype(np.float32)
    pictures = []
    with open_terrain(heights, spacing=30.0, algorithm=algorithm) as terrain:
        gpu = terrain.renderer.gpu
        for driver in (gpu._driver, None):
            gpu._driver = driver
            picture = terrain.render(terrain.camera(), (80, 60), samples=2)
            pictures.append((picture.color, picture.reverse_depth))
    for ours, wgpus in zip(*pictures, strict=True):
        np.testing.assert_array_equal(ours, wgpus)
    assert np.ptp(pictures[0][1]) > 0


def test_passes_that_follow_each_other_become_one(gpu: Gpu, kernels: Any, begun: list[str]) -> None:
    values = gpu.buffer("values", np.zeros(4, np.uint32), "STORAGE|COPY_SRC", "test")
    group = gpu.bind("values", kernels.layout, {0: values})
    timer, encoder = gpu.timer(), gpu.encoder("work")

    def work(timed: bool) -> None:
        timer.enabled = timed
        run = timer.compute_pass(encoder, "add")
        dispatch(run, kernels.add, {0: (group,), 1: (kernels.step, [0])})
        run.end()

    work(False)
    work(False)
    encoder.clear_buffer(gpu.buffer("other", 4, "COPY_DST", "test").raw)
    work(False)
    work(False)
    timestamps = "timestamp-query" in gpu.features
    if timestamps:
        work(True)
        work(True)
        work(False)
    timer.resolve(encoder)
    gpu.submit(encoder)
    assert len(begun) == (5 if timestamps else 2)
    assert list(timer.results(wait=True)) == (["add"] if timestamps else [])
    count = 7 if timestamps else 4
    np.testing.assert_array_equal(gpu.read_buffer(values, dtype=np.uint32).result(), np.full(4, count))


def test_what_is_bound_lives_until_it_is_used(gpu: Gpu, kernels: Any, encoders: None) -> None:
    values = gpu.buffer("values", np.zeros(4, np.uint32), "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("work")
    run = encoder.begin_compute_pass()
    groups = {0: (gpu.bind("values", kernels.layout, {0: values}),), 1: (kernels.step, [0])}
    dispatch(run, kernels.add, groups)
    run.end()
    del groups
    gc.collect()
    gpu.submit(encoder)
    np.testing.assert_array_equal(gpu.read_buffer(values, dtype=np.uint32).result(), np.ones(4))


def test_what_the_driver_finds_wrong_is_raised(
    gpu: Gpu, kernels: Any, encoders: None, caplog: pytest.LogCaptureFixture
) -> None:
    values = gpu.buffer("values", np.zeros(4, np.uint32), "STORAGE|COPY_SRC", "test")
    group = gpu.bind("values", kernels.layout, {0: values})
    encoder = gpu.encoder("half bound")
    run = encoder.begin_compute_pass(label="add")
    dispatch(run, kernels.add, {0: (group,)})
    run.end()
    with pytest.raises(GpuError, match=r"commands 'half bound'.*"):
        gpu.submit(encoder)
    # a buffer that was not made to be copied to
    encoder = gpu.encoder("a copy")
    encoder.copy_buffer_to_buffer(values.raw, 0, gpu.buffer("source", 16, "COPY_SRC", "test").raw, 0, 16)
    with pytest.raises(GpuError, match="commands 'a copy'"):
        gpu.submit(encoder)
    with pytest.raises(GpuError, match="buffer 'source'"):
        gpu.write(gpu.buffer("source", 16, "STORAGE", "test"), bytes(16))
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]
    # and what follows is drawn
    encoder = gpu.encoder("right")
    run = encoder.begin_compute_pass(label="add")
    dispatch(run, kernels.add, {0: (group,), 1: (kernels.step, [256])})
    run.end()
    gpu.submit(encoder)
    np.testing.assert_array_equal(gpu.read_buffer(values, dtype=np.uint32).result(), np.full(4, 10))


def test_passes_end_before_other_commands(gpu: Gpu, kernels: Any) -> None:
    buffer = gpu.buffer("values", 16, "STORAGE|COPY_DST", "test")
    encoder = gpu.encoder("frame")
    run = encoder.begin_compute_pass(label="refine")
    for call in (
        lambda: encoder.clear_buffer(buffer.raw),
        lambda: encoder.begin_compute_pass(label="another"),
        lambda: gpu.submit(encoder),
    ):
        with pytest.raises(GpuError, match="'frame': expected the end of pass 'refine'"):
            call()
    run.end()
    with pytest.raises(GpuError, match="after its end"):
        run.set_pipeline(kernels.double)
    gpu.submit(encoder)
    with pytest.raises(GpuError, match="'frame': expected to be submitted once"):
        gpu.submit(encoder)


def test_where_wgpu_looks_different_its_own_encoders_are_used(
    gpu: Gpu, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from wgpu.backends.wgpu_native import _api

    assert isinstance(gpu.encoder("frame"), Commands)
    monkeypatch.delattr(_api, "error_handler")
    with caplog.at_level(logging.DEBUG, "orogen"):
        assert open_driver(gpu.device) is None
    assert "recorded by wgpu" in caplog.text
    monkeypatch.setattr(gpu, "_driver", None)
    assert not isinstance(gpu.encoder("frame"), Commands)
