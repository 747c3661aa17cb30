from __future__ import annotations

import numpy as np
import pytest

from orogen.errors import GpuError, ShaderError
from orogen.gpu import Text

GOOD = """
@group(0) @binding(0) var<storage, read_write> values: array<f32>;
// @compute fn not_this() {}
@compute @workgroup_size(1)
fn double() { values[0] *= 2.0; }
@compute @workgroup_size(1) fn triple() { values[0] *= 3.0; }
"""


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("  let x: u32 = 1.5;", "the type of `x` is expected to be `u32`|cannot convert"),
        ("  let x = undefined_name + 1;", "undefined_name"),
        ("  let x = vec3f(1.0) * vec2f(2.0);", "Multiply"),
        ("  let x = ;", "expected expression"),
    ],
)
def test_fault_in_an_include_names_its_file_and_line(gpu, tmp_path, fault, says):
    (tmp_path / "helper.wgsl").write_text(f"// a helper\nfn help() {{\n{fault}\n}}\n")
    (tmp_path / "first.wgsl").write_text("fn first() {}\n")
    main = Text("main", "#include first.wgsl\n#include helper.wgsl\n@compute @workgroup_size(1) fn main() { help(); }")
    with pytest.raises(ShaderError) as caught:
        gpu.shader("terrain", main, search=[tmp_path])
    message = str(caught.value)
    assert message.startswith(f"{tmp_path.name}/helper.wgsl:3: ")
    assert "(shader 'terrain')" in message
    assert fault.strip() in message
    assert any(part in message for part in says.split("|"))


def test_message_without_a_place_still_names_the_shader(gpu):
    code = "@fragment fn main() -> @location(0) vec4f { workgroupBarrier(); return vec4f(); }"
    with pytest.raises(ShaderError, match=r"^terrain: (.|\n)*forbidden at this stage"):
        gpu.shader("terrain", Text("main", code))


def test_entries(gpu):
    assert gpu.shader("maths", Text("maths.wgsl", GOOD)).entries == ["double", "triple"]


def test_missing_entry_lists_the_entries(gpu):
    shader = gpu.shader("maths", Text("maths.wgsl", GOOD))
    with pytest.raises(ShaderError, match=r"maths: .*maths.wgsl \(double, triple\), got 'halve'"):
        gpu.compute("halving", shader, "halve")


def test_pipeline_that_does_not_fit_its_layout_names_shader_and_line(gpu):
    shader = gpu.shader("maths", Text("maths.wgsl", GOOD))
    layout = gpu.layout("wrong", {0: ("COMPUTE", "uniform")})
    with pytest.raises(ShaderError, match=r"^maths.wgsl:5: pipeline 'doubling', entry 'double': "):
        gpu.compute("doubling", shader, "double", [layout])


def test_render_pipeline_names_the_missing_entry(gpu):
    code = "@vertex fn corners(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f { return vec4f(f32(i)); }"
    shader = gpu.shader("triangle", Text("triangle.wgsl", code))
    with pytest.raises(ShaderError, match=r"\(corners\), got 'colours'"):
        gpu.render("triangle", shader, "corners", "colours", [{"format": "rgba8unorm"}])


def test_wrong_bind_group_names_its_label(gpu):
    layout = gpu.layout("values", {0: ("COMPUTE", "storage")})
    plain = gpu.buffer("plain", 16, "COPY_SRC", "test")
    with pytest.raises(GpuError, match=r"bind group 'inputs': .*STORAGE"):
        gpu.bind("inputs", layout, {0: plain})


def test_wrong_dispatch_names_the_commands(gpu):
    shader = gpu.shader("maths", Text("maths.wgsl", GOOD))
    pipeline = gpu.compute("doubling", shader, "double")
    encoder = gpu.encoder("frame 7")
    compute = encoder.begin_compute_pass()
    compute.set_pipeline(pipeline)
    compute.dispatch_workgroups(1)
    compute.end()
    with pytest.raises(GpuError, match=r"(?s)commands 'frame 7': .*'doubling' label expects a BindGroup"):
        gpu.submit(encoder)


def test_lost_device_says_so(gpu):
    from orogen.gpu import open_gpu

    lost = open_gpu(str(gpu.info.index))
    buffer = lost.buffer("b", 16, "COPY_DST", "test")
    lost.device.destroy()
    with pytest.raises(GpuError, match="'b': the GPU device was lost"):
        lost.write(buffer, np.zeros(4, np.float32))


@pytest.mark.parametrize(
    "kind", ["", "unifrom", "texture", "texture f32", "image r32uint", "sampler", "texture float 4d"]
)
def test_unknown_binding_lists_the_kinds(gpu, kind):
    with pytest.raises(GpuError, match=r"expected a kind of binding .*got"):
        gpu.layout("l", {0: ("COMPUTE", kind)})


def test_every_kind_of_binding_makes_a_layout(gpu):
    kinds = ["uniform", "uniform dynamic", "storage", "read", "sampler filtering", "sampler non-filtering"]
    kinds += ["texture float", "texture unfilterable 2d-array", "texture uint 2d", "texture depth", "texture sint 3d"]
    kinds += ["image r32uint readwrite", "image rgba8unorm write 2d-array", "image r32float readonly"]
    assert gpu.layout("all", {n: ("COMPUTE", kind) for n, kind in enumerate(kinds)}).label == "all"
