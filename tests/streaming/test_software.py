"""What software drivers read in place of buffers and blocks, and that pictures are the same either way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import orogen
from orogen.gpu import Gpu, Text
from orogen.streaming import clipmap as clipmap_module
from orogen.streaming import software
from orogen.streaming.clipmap import SEARCH
from orogen.streaming.heightformat import FLOATS
from orogen.streaming.software import SHARED, TABLE_WIDTH, SampledTables

CONSTANTS = {
    "NODE_BITS": 8, "HEIGHT_BORDER": 2, "COLOR_BORDER": 8, "MAX_ANISOTROPY": 8, "COVERED": False, "SOFTWARE": True,
    "TABLE_WIDTH": TABLE_WIDTH, **SHARED, **FLOATS.constants,
}  # fmt: skip
READ = """#include clipmap.wgsl
@group(1) @binding(0) var<storage, read> indices: array<u32>;
@group(1) @binding(1) var<storage, read_write> found: array<vec4<f32>>;
@compute @workgroup_size(64) fn look(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= arrayLength(&indices)) { return; }
    let index = indices[id.x];
    let range = vec2<f32>(sampled_table(index, 1), sampled_table(index, 2));
    found[id.x] = vec4<f32>(f32(table_entry(index)), range, 0.0);
}"""


def test_every_entry_and_range_is_read_as_it_was_filled_in(gpu: Gpu) -> None:
    rng = np.random.default_rng(4)
    counts = 2 * TABLE_WIDTH + 77, TABLE_WIDTH - 5
    entries = [rng.integers(0, 1 << 24, n).astype(np.uint32) for n in counts]
    entries[0][:2] = 0, (1 << 24) - 1
    ranges = [np.sort(rng.normal(0, 1e4, (n, 2)).astype(np.float32)) for n in counts]
    tables = SampledTables(gpu, sum(counts))
    tables.fill(0, entries[0], ranges[0])
    tables.fill(counts[0], entries[1], ranges[1])
    tables.write()
    shader = gpu.shader("look", Text("look", READ), search=SEARCH, constants=CONSTANTS)
    layouts = [
        gpu.layout(
            "tables",
            {
                # what other adapters read
                **dict.fromkeys((2, 4), ("COMPUTE", "read")),
                10: ("COMPUTE", "sampler non-filtering"),
                12: ("COMPUTE", "texture unfilterable 2d-array"),
            },
        ),
        gpu.layout("answers", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")}),
    ]
    indices = np.arange(sum(counts), dtype=np.uint32)
    answers = gpu.buffer("answers", 16 * len(indices), "STORAGE|COPY_SRC", "test")
    zeros = gpu.buffer("zeros", 64, "STORAGE", "test")
    encoder = gpu.encoder("look")
    run = encoder.begin_compute_pass(label="look")
    run.set_pipeline(gpu.compute("look", shader, "look", layouts))
    run.set_bind_group(
        0, gpu.bind("tables", layouts[0], {2: zeros, 4: zeros, 10: gpu.sampler("texels"), 12: tables.view})
    )
    asked = gpu.buffer("indices", indices, "STORAGE", "test")
    run.set_bind_group(1, gpu.bind("answers", layouts[1], {0: asked, 1: answers}))
    run.dispatch_workgroups(-(-len(indices) // 64))
    run.end()
    gpu.submit(encoder)
    found = gpu.read_buffer(answers, dtype=np.float32).result().reshape(-1, 4)
    np.testing.assert_array_equal(found[:, 0].astype(np.uint32), np.concatenate(entries))
    np.testing.assert_array_equal(found[:, 1:3], np.concatenate(ranges))


def hills(seed: int, holes: bool) -> NDArray[np.float32]:
    """Hills, a cliff and noise, with missing rectangles where there are `holes`."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:330, :410].astype(np.float32)
    heights = 300 * np.sin(x / 70) * np.cos(y / 55) + rng.normal(0, 6, y.shape) + 250 * (x > 250)
    if holes:
        for row, col in rng.integers(0, 300, (9, 2)):
            heights[row : row + rng.integers(2, 60), col : col + rng.integers(2, 90)] = np.nan
    return heights.astype(np.float32)


def pictures(folder: Path, heights: NDArray[np.float32], algorithm: str) -> list[NDArray]:
    """Colours and depths of pictures from afar, across the edge, level, and straight from above."""
    result = []
    with orogen.open(heights, spacing=10.0, build="wait", cache=folder) as terrain:
        terrain.use(algorithm)
        cameras = [terrain.camera(distance=d, heading=h, pitch=p) for d, h, p in VIEWS]
        for camera in cameras:
            picture = terrain.render(camera, (83, 61))
            result += [picture.color, picture.reverse_depth]
    return result


VIEWS = [(5000.0, 20.0, -25.0), (1300.0, 140.0, -8.0), (3000.0, 255.0, -3.0), (2000.0, 0.0, -89.0)]


@pytest.mark.parametrize("algorithm", ["raycast", pytest.param("udlod", marks=pytest.mark.nightly)])
@pytest.mark.parametrize("holes", [False, True])
def test_pictures_are_those_of_other_adapters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, algorithm: str, holes: bool
) -> None:
    def drawn(is_software: Callable[[Gpu], bool]) -> list[NDArray]:
        for module in (software, clipmap_module):
            monkeypatch.setattr(module, "is_software", is_software)
        return pictures(tmp_path, hills(3, holes), algorithm)

    for one, other in zip(drawn(lambda _: True), drawn(lambda _: False), strict=True):
        assert one.any()
        np.testing.assert_array_equal(one, other)
