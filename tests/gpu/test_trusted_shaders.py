"""Modules without counters in their loops: made by the library itself, or by wgpu where its inside looks different."""

from __future__ import annotations

import numpy as np
import pytest

from orogen.errors import ShaderError
from orogen.gpu import Text
from orogen.gpu.shader import compile_shader
from orogen.gpu.wgsl import compose

SUM = """
@group(0) @binding(0) var<storage, read_write> values: array<u32>;
@compute @workgroup_size(1)
fn add() {
    var sum = 0u;
    for (var i = 1u; i < arrayLength(&values); i += 1u) { sum += values[i]; }
    values[0] = sum;
}
"""


@pytest.fixture(params=["inside", "wrappers"])
def create(request, monkeypatch):
    """Which way modules are made, told by the calls of wgpu's own function."""
    from wgpu.backends.wgpu_native import _api

    if request.param == "wrappers":
        monkeypatch.delattr(_api.libf, "wgpuDeviceCreateShaderModuleTrusted")
    calls = []
    original = _api.GPUDevice.create_shader_module
    monkeypatch.setattr(
        _api.GPUDevice, "create_shader_module", lambda *a, **k: calls.append(k["label"]) or original(*a, **k)
    )
    yield
    assert bool(calls) == (request.param == "wrappers")


def test_loops_run_to_their_end(gpu, create):
    shader = compile_shader(gpu.device, "sum", compose(Text("sum", SUM)), trusted=True)
    pipeline = gpu.compute("sum", shader, "add")
    numbers = np.arange(1000, dtype=np.uint32)
    buffer = gpu.buffer("numbers", numbers.nbytes, "STORAGE|COPY_DST|COPY_SRC", "test")
    gpu.write(buffer, numbers)
    encoder = gpu.device.create_command_encoder()
    run = encoder.begin_compute_pass()
    run.set_pipeline(pipeline)
    entries = [{"binding": 0, "resource": {"buffer": buffer.raw, "offset": 0, "size": numbers.nbytes}}]
    run.set_bind_group(0, gpu.device.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=entries))
    run.dispatch_workgroups(1)
    run.end()
    gpu.device.queue.submit([encoder.finish()])
    assert gpu.device.queue.read_buffer(buffer.raw, 0, 4).cast("I")[0] == numbers.sum()
    buffer.destroy()


def test_faults_name_their_line(gpu, create):
    with pytest.raises(ShaderError, match="undefined_name"):
        compile_shader(gpu.device, "bad", compose(Text("bad", "fn f() { let x = undefined_name; }")), trusted=True)
