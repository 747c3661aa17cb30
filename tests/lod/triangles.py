"""The triangles of indexed draws of patches, read back from the GPU."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lod.patches import VERTEX
from lod.scene import Scene
from orogen.frame import Frame
from orogen.gpu.wgsl import Text
from orogen.lod.contract import AlgorithmView, Patches
from orogen.raster.rasterizer import FOLDER
from orogen.streaming.clipmap import SEARCH

_COPY = """
@group(0) @binding(0) var<storage, read> source: array<u32>;
@group(0) @binding(1) var<storage, read_write> copied: array<u32>;

@compute @workgroup_size(64)
fn copy(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < arrayLength(&source)) { copied[id.x] = source[id.x]; }
}
"""


class Unculled(Frame):
    """A frame whose frustum is everywhere."""

    def planes(self, lod: bool = True) -> NDArray[np.float64]:
        return np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))


def as_unculled(frame: Frame) -> Unculled:
    return Unculled(**{field.name: getattr(frame, field.name) for field in dataclasses.fields(frame)})


def read_triangles(scene: Scene, frame: Frame, state: AlgorithmView) -> list[NDArray[Any]]:
    """Per draw of a frame, (instances, triangles, 3) corners of dtype VERTEX. The draws share a module and a group."""
    draws = scene.record(frame, state)
    if not draws:
        return []
    gpu, clipmap = scene.gpu, scene.clipmap
    first = draws[0]
    assert isinstance(first, Patches)
    shader = gpu.shader(
        "triangles", first.module.path, Path(__file__).parent / "triangles.wgsl",
        search=[FOLDER, *SEARCH], constants={**clipmap.constants, **first.module.constants},
    )  # fmt: skip
    layout = gpu.layout(
        "triangles",
        {0: ("COMPUTE", "uniform"), 1: ("COMPUTE", "read"), 2: ("COMPUTE", "read"), 3: ("COMPUTE", "storage")},
    )
    pipeline = gpu.compute("triangles", shader, "write_corners", [clipmap.layout, first.module.layout, layout])
    result = []
    for draw in draws:
        assert isinstance(draw, Patches)
        assert draw.index is not None
        assert draw.topology == "triangle-list"
        assert (draw.module, draw.group) == (first.module, first.group)
        count, instances, *_ = arguments(scene, draw)
        written = gpu.buffer("corners", VERTEX.itemsize * count * instances, "STORAGE|COPY_SRC", "test")
        place = gpu.buffer("place", np.array([draw.offset // 4, 0, 0, 0], np.uint32), "UNIFORM", "test")
        encoder = gpu.encoder("corners")
        run = encoder.begin_compute_pass(label="corners")
        run.set_pipeline(pipeline)
        run.set_bind_group(0, scene.view.bind_group)
        run.set_bind_group(1, draw.group)
        group = gpu.bind("corners", layout, {0: place, 1: draw.indirect, 2: draw.index.indices, 3: written})
        run.set_bind_group(2, group)
        run.dispatch_workgroups(1024, -(-count * instances // 65536))
        run.end()
        gpu.submit(encoder)
        corners = gpu.read_buffer(written).result().view(VERTEX)
        written.destroy()
        result.append(corners.reshape(instances, count // 3, 3).copy())
    return result


def arguments(scene: Scene, draw: Patches) -> list[int]:
    """The five arguments of an indexed draw; copied by a shader, since a draw may read what copying may not."""
    gpu = scene.gpu
    layout = gpu.layout("arguments", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")})
    pipeline = gpu.compute("arguments", gpu.shader("arguments", Text("arguments", _COPY)), "copy", [layout])
    copied = gpu.buffer("arguments", draw.indirect.size, "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("arguments")
    run = encoder.begin_compute_pass(label="arguments")
    run.set_pipeline(pipeline)
    run.set_bind_group(0, gpu.bind("arguments", layout, {0: draw.indirect, 1: copied}))
    run.dispatch_workgroups(-(-draw.indirect.size // 256))
    run.end()
    gpu.submit(encoder)
    words = gpu.read_buffer(copied).result().view(np.uint32)
    return words[draw.offset // 4 :][:5].tolist()


def with_area(draws: list[NDArray[Any]]) -> NDArray[np.float32]:
    """(n, 3, 3) camera-relative corners of all draws, those of triangles without area left out."""
    corners = np.concatenate([draw["position"].reshape(-1, 3, 3) for draw in draws])
    a, b, c = corners.swapaxes(0, 1)
    return corners[~((a == b).all(1) | (b == c).all(1) | (c == a).all(1))]
