"""The triangles of draws of patches, read back from the GPU."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lod.patches import VERTEX
from lod.scene import Scene
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod.contract import AlgorithmView, Draw, Patches
from orogen.raster.rasterizer import FOLDER
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView


class Unculled(Frame):
    """A frame whose frustum is everywhere."""

    plane_rows = ((0.0, 0.0, 0.0, 1.0),) * 5


def as_unculled(frame: Frame) -> Unculled:
    return Unculled(**{field.name: getattr(frame, field.name) for field in dataclasses.fields(frame)})


def read_triangles(scene: Scene, frame: Frame, state: AlgorithmView) -> list[NDArray[Any]]:
    """Per draw of a frame, (instances, triangles, 3) corners of dtype VERTEX."""
    return [read_draw(scene.gpu, scene.clipmap, scene.view, draw) for draw in scene.record(frame, state)]


def read_draw(gpu: Gpu, clipmap: Clipmap, view: ClipmapView, draw: Draw) -> NDArray[Any]:
    """(instances, triangles, 3) corners of dtype VERTEX of a draw of the frame that `view` was updated for."""
    assert isinstance(draw, Patches)
    strip = draw.topology == "triangle-strip"
    module, layouts = draw.module, [("COMPUTE", "read"), ("COMPUTE", "read"), ("COMPUTE", "storage")]
    shader = gpu.shader(
        "triangles", module.path, Path(__file__).parent / "triangles.wgsl", search=[FOLDER, *SEARCH],
        constants={**clipmap.constants, **module.constants, "INDEXED": draw.index is not None, "STRIP": strip},
    )  # fmt: skip
    layout = gpu.layout("triangles", dict(enumerate(layouts)))
    own = module.layout or gpu.layout("nothing", {})
    pipeline = gpu.compute("triangles", shader, "write_corners", [clipmap.layout, own, layout])
    count, instances, first, base_vertex = arguments(gpu, draw)[:4]
    triangles = max(0, count - 2) if strip else count // 3
    if triangles * instances == 0:
        return np.zeros((0, triangles, 3), VERTEX)
    corners = 3 * triangles * instances
    written = gpu.buffer("corners", VERTEX.itemsize * corners, "STORAGE|COPY_SRC", "test")
    facts = np.array([first, base_vertex if draw.index else 0, triangles, instances], np.uint32)
    place = gpu.buffer("draw", facts, "STORAGE", "test")
    indices = draw.index.indices if draw.index else gpu.buffer("no indices", 4, "STORAGE", "test")
    encoder = gpu.encoder("corners")
    run = encoder.begin_compute_pass(label="corners")
    run.set_pipeline(pipeline)
    run.set_bind_group(0, view.bind_group)
    run.set_bind_group(1, draw.group or gpu.bind("nothing", own, {}))
    run.set_bind_group(2, gpu.bind("corners", layout, {0: place, 1: indices, 2: written}))
    run.dispatch_workgroups(1024, -(-corners // 65536))
    run.end()
    gpu.submit(encoder)
    result = gpu.read_buffer(written).result().view(VERTEX).reshape(instances, triangles, 3).copy()
    written.destroy()
    return result


def arguments(gpu: Gpu, draw: Patches) -> list[int]:
    """The arguments of a draw: five with an index list, else four."""
    size = 20 if draw.index else 16
    return gpu.read_buffer(draw.indirect, draw.offset, size, np.uint32).result().tolist()


def with_area(draws: list[NDArray[Any]]) -> NDArray[np.float32]:
    """(n, 3, 3) camera-relative corners of all draws, those of triangles without area left out."""
    corners = np.concatenate([draw["position"].reshape(-1, 3, 3) for draw in draws])
    a, b, c = corners.swapaxes(0, 1)
    return corners[~((a == b).all(1) | (b == c).all(1) | (c == a).all(1))]
