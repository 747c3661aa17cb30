"""The uniform blocks lie in memory as the shaders read them, and frame.wgsl computes what frame.py says."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import orogen.frame
from orogen.camera import Camera
from orogen.frame import Frame
from orogen.gpu import Gpu, Text
from orogen.grid import EARTH_RADIUS, Grid
from orogen.streaming import blocks
from orogen.streaming.clipmap import SEARCH
from orogen.streaming.heightformat import FLOATS
from orogen.streaming.software import SHARED

CONSTANTS = {
    "NODE_BITS": 8, "HEIGHT_BORDER": 2, "COLOR_BORDER": 8, "MAX_ANISOTROPY": 8, "COVERED": False,
    "ANY_HIT": False, "SOFTWARE": False, "TABLE_WIDTH": 256, **SHARED, **FLOATS.constants,
}  # fmt: skip
UTM = Grid(5000, 4000, (2.0, 0.3, 1e7, 0.4, -3.0, 9.3e6))


def scalars(dtype: np.dtype, name: str = "") -> Iterator[str]:
    """WGSL of every 4-byte scalar of a block, in numpy's order."""
    if dtype.fields:
        for field in dtype.names or ():
            yield from scalars(dtype.fields[field][0], f"{name}.{field}")
    elif dtype.subdtype:
        base, shape = dtype.subdtype
        # 2 x 2 matrices are vectors of four in WGSL
        for index in np.ndindex(*((4,) if shape == (2, 2) else shape)):
            yield from scalars(base, name + "".join(f"[{i}]" for i in index))
    else:
        yield name


@pytest.mark.parametrize(("variable", "dtype"), [("frame", blocks.FRAME), ("clipmap", blocks.CLIPMAP)])
def test_shaders_read_every_field_where_python_writes_it(gpu: Gpu, variable: str, dtype: np.dtype) -> None:
    names = list(scalars(dtype, variable))
    assert 4 * len(names) == dtype.itemsize
    stores = "\n".join(f"    echo[{i}] = bitcast<u32>({name});" for i, name in enumerate(names))
    code = f"""#include clipmap.wgsl
    @group(1) @binding(0) var<storage, read_write> echo: array<u32>;
    @compute @workgroup_size(1) fn echo_all() {{\n{stores}\n}}"""
    shader = gpu.shader("echo", Text("echo", code), search=SEARCH, constants=CONSTANTS)
    words = np.random.default_rng(1).integers(1, 1 << 30, len(names), np.uint32)
    layouts = [
        gpu.layout("block", dict.fromkeys((0, 1), ("COMPUTE", "uniform"))),
        gpu.layout("echo", {0: ("COMPUTE", "storage")}),
    ]
    pipeline = gpu.compute("echo", shader, "echo_all", layouts)
    block = gpu.buffer("block", words, "UNIFORM", "test")
    other = gpu.buffer("other", max(blocks.FRAME.itemsize, blocks.CLIPMAP.itemsize), "UNIFORM", "test")
    echo = gpu.buffer("echo", words.nbytes, "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("echo")
    run = encoder.begin_compute_pass(label="echo")
    run.set_pipeline(pipeline)
    run.set_bind_group(
        0, gpu.bind("block", layouts[0], {0: block, 1: other} if variable == "frame" else {0: other, 1: block})
    )
    run.set_bind_group(1, gpu.bind("echo", layouts[1], {0: echo}))
    run.dispatch_workgroups(1)
    run.end()
    gpu.submit(encoder)
    np.testing.assert_array_equal(gpu.read_buffer(echo, dtype=np.uint32).result(), words)


def test_levels_of_the_block_are_those_of_the_shader() -> None:
    code = (Path(blocks.__file__).parent / "clipmap.wgsl").read_text(encoding="utf-8")
    assert re.findall(r"origins: array<vec4<i32>, (\d+)>", code) == [str(blocks.MAX_LEVELS)]


class FrameProbe:
    """Evaluates expressions of frame.wgsl at vec4 inputs."""

    def __init__(self, gpu: Gpu) -> None:
        self.gpu = gpu
        self.layout = gpu.layout(
            "frame probe", {0: ("COMPUTE", "uniform"), 1: ("COMPUTE", "read"), 2: ("COMPUTE", "storage")}
        )

    def __call__(self, frame: Frame, expression: str, values: Any) -> NDArray[np.float32]:
        gpu, values = self.gpu, np.ascontiguousarray(np.broadcast_to(values, (len(values), 4)), np.float32)
        code = f"""#include frame.wgsl
        @group(0) @binding(1) var<storage, read> given: array<vec4<f32>>;
        @group(0) @binding(2) var<storage, read_write> answers: array<vec4<f32>>;
        @compute @workgroup_size(64) fn probe(@builtin(global_invocation_id) id: vec3<u32>) {{
            if (id.x >= arrayLength(&answers)) {{ return; }}
            let v = given[id.x];
            answers[id.x] = {expression};
        }}"""
        folder = Path(orogen.frame.__file__).parent
        pipeline = gpu.compute(
            "probe", gpu.shader("probe", Text("probe", code), search=[folder], constants=SHARED), "probe", [self.layout]
        )
        target = gpu.buffer("answers", values.nbytes, "STORAGE|COPY_SRC", "test")
        group = {
            0: gpu.buffer("frame", blocks.frame_block(frame), "UNIFORM", "test"),
            1: gpu.buffer("given", values, "STORAGE", "test"),
            2: target,
        }
        encoder = gpu.encoder("probe")
        run = encoder.begin_compute_pass(label="probe")
        run.set_pipeline(pipeline)
        run.set_bind_group(0, gpu.bind("probe", self.layout, group))
        run.dispatch_workgroups(-(-len(values) // 64))
        run.end()
        gpu.submit(encoder)
        return gpu.read_buffer(target, dtype=np.float32).result().reshape(-1, 4)


@pytest.fixture(scope="module")
def ask(gpu: Gpu) -> FrameProbe:
    return FrameProbe(gpu)


def camera_at(tx: float, ty: float, **settings: Any) -> Camera:
    x, y = (float(v) for v in UTM.to_crs(tx, ty))
    return Camera(x, y, **{"z": 1500.0, "heading": 30.0, "pitch": -40.0, "roll": 5.0, **settings})


CAMERAS = [
    camera_at(2345.6, 1234.5),
    camera_at(100.25, 3999.75, orthographic=3000.0),
    camera_at(-50_000, 60_000, fov=20),
]


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("jitter", [(0.0, 0.0), (0.25, -0.4)])
def test_rays_of_pixels(ask: FrameProbe, camera: Camera, jitter: tuple[float, float]) -> None:
    frame = Frame(camera, UTM, (37, 23), jitter=jitter, height_range=(0.0, 2000.0))
    origin, direction = frame.rays()
    y, x = np.indices((23, 37)).reshape(2, -1)
    pixels = np.stack([x, y, 0 * x, 0 * x], axis=-1)
    for expression, expected in (("origin", origin), ("direction", direction)):
        found = ask(frame, f"vec4<f32>(pixel_ray(vec2<u32>(v.xy)).{expression}, 0.0)", pixels)[:, :3]
        np.testing.assert_allclose(found, expected.reshape(-1, 3), rtol=0, atol=1e-6 * max(1, np.abs(expected).max()))


@pytest.mark.parametrize("camera", CAMERAS[:2])
def test_depths_there_and_back(ask: FrameProbe, camera: Camera) -> None:
    frame = Frame(camera, UTM, (37, 23), height_range=(0.0, 2000.0))
    low, high = frame.depth_range if camera.orthographic else (camera.near, 1e5)
    metres = np.linspace(low, high, 100)[1:-1, None]
    found = ask(frame, "vec4<f32>(depth_of(v.x), view_depth(depth_of(v.x)), 0.0, 0.0)", metres)
    back = frame.view_depth(found[:, 0])
    np.testing.assert_allclose(back, metres[:, 0], rtol=1e-5, atol=1e-6 * (high - low))
    np.testing.assert_allclose(found[:, 1], metres[:, 0], rtol=1e-5, atol=1e-6 * (high - low))


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("curvature", [False, True])
def test_points_of_the_data_to_camera_metres_and_back(ask: FrameProbe, camera: Camera, curvature: bool) -> None:
    frame = Frame(camera, UTM, (37, 23), exaggeration=1.5, curvature=curvature)
    rng = np.random.default_rng(2)
    texel = np.floor(rng.uniform(0, 4000, (200, 2)) * 256) / 256
    height = rng.uniform(0, 2000, 200).astype(np.float32)
    cells = (texel * 256 - frame.anchor).astype(np.float32)
    values = np.column_stack([cells, height, height])
    point = "Point(frame.anchor + vec2<i32>(v.xy), vec2<f32>(0.0))"
    found = ask(frame, f"vec4<f32>(lift(flat_position({point}), v.z), 1.0)", values)[:, :3]
    metres = (np.stack(UTM.to_crs(*texel.T), axis=-1) - [camera.x, camera.y]).astype(np.float64)
    drop = (metres**2).sum(axis=-1) / (2 * EARTH_RADIUS) if curvature else 0.0
    expected = np.column_stack([metres, height * 1.5 - camera.z - drop])
    away = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(found - expected) <= 4e-7 * away + 1e-4).all()
    back = ask(
        frame,
        "vec4<f32>(vec2<f32>(ground_point(v.xyz).cell - frame.anchor) + ground_point(v.xyz).frac,"
        " world_height(v.xyz), 0.0)",
        np.column_stack([expected, height]),
    )
    assert (np.abs(back[:, :2] / 256 - cells / 256) <= 4e-7 * away + 1e-3).all()
    np.testing.assert_allclose(back[:, 2], height, atol=1e-3 + 2e-6 * away.max())


def test_distances_of_the_level_of_detail(ask: FrameProbe) -> None:
    watched = camera_at(2000, 2000, z=2500.0)
    frame = Frame(CAMERAS[0], UTM, (37, 23), lod_camera=watched, ground_height=400.0, exaggeration=2.0)
    flat = np.random.default_rng(3).uniform(-1e4, 1e4, (100, 2))
    found = ask(frame, "vec4<f32>(lod_distance(v.xy))", np.column_stack([flat, flat]))[:, 0]
    eye = np.array([watched.x - CAMERAS[0].x, watched.y - CAMERAS[0].y])
    np.testing.assert_allclose(found, np.hypot(np.linalg.norm(flat - eye, axis=1), 2500 - 800), rtol=1e-6)


def test_an_orthographic_camera_counts_distances_from_the_perspective_one_of_the_same_scale(ask: FrameProbe) -> None:
    camera = camera_at(2000, 2000, orthographic=1000.0, pitch=-90.0, roll=0.0)
    frame = Frame(camera, UTM, (40, 40), ground_height=100.0)
    found = ask(frame, "vec4<f32>(lod_distance(v.xy))", np.zeros((1, 4)))[0, 0]
    half_angle = np.radians(orogen.frame.REFERENCE_FOV / 2)
    assert found == pytest.approx(500 / np.tan(half_angle), rel=1e-6)


@pytest.mark.parametrize("width", [3, 1000, 1 << 18, (1 << 19) + 5, 1 << 22, 1 << 26])
@pytest.mark.parametrize("node_size", [256, 1024])
def test_subtexels_of_the_largest_node_fit_32_bits(width: int, node_size: int) -> None:
    from orogen.keys import level_count

    bits = orogen.frame.subtexel_bits(Grid(width, 3, (1.0, 0, 0, 0, -1.0, 0)))
    assert 1 <= bits <= 8
    assert (node_size << level_count((3, width)) - 1) << bits <= 1 << 30
    assert bits == 8 or width > 1 << 19


def test_colours_lie_where_both_georeferences_say(north_up: Callable[..., Grid]) -> None:
    colors = Grid(700, 900, (1.5, -0.2, 1e7 + 40, 0.1, -2.5, 9.3e6 - 30))
    frame = Frame(CAMERAS[0], UTM, (37, 23))
    matrix, anchor, offset = (np.array(part) for part in blocks.color_mapping(frame, colors, 8))
    assert ((offset >= 0) & (offset < 1)).all()
    texel = np.random.default_rng(4).uniform(0, 4000, (50, 2))
    found = matrix.reshape(2, 2) @ (texel * 256 - frame.anchor).T + (anchor + offset)[:, None]
    expected = np.array(colors.to_texel(*UTM.to_crs(*texel.T))) * 256
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)
