"""The vertices of strips of triangles, read back from the GPU."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lod.patches import VERTEX
from lod.scene import Scene
from lod.triangles import arguments
from orogen.lod.contract import Draw, Patches
from orogen.raster.rasterizer import FOLDER
from orogen.streaming.clipmap import SEARCH


def read_strips(scene: Scene, draw: Draw) -> NDArray[Any]:
    """(instances, vertices of a strip) of dtype VERTEX."""
    assert isinstance(draw, Patches)
    gpu = scene.gpu
    each, rows = arguments(gpu, draw)[:2]
    shader = gpu.shader(
        "vertices", draw.module.path, Path(__file__).parent / "vertices.wgsl",
        search=[FOLDER, *SEARCH], constants={**scene.clipmap.constants, **draw.module.constants},
    )  # fmt: skip
    layout = gpu.layout("vertices", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")})
    pipeline = gpu.compute("vertices", shader, "write_vertices", [scene.clipmap.layout, draw.module.layout, layout])
    facts = gpu.buffer("arguments", np.array([each, rows, 0, 0], np.uint32), "STORAGE", "test")
    written = gpu.buffer("vertices", VERTEX.itemsize * each * rows, "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("vertices")
    run = encoder.begin_compute_pass(label="vertices")
    run.set_pipeline(pipeline)
    run.set_bind_group(0, scene.view.bind_group)
    run.set_bind_group(1, draw.group)
    run.set_bind_group(2, gpu.bind("vertices", layout, {0: facts, 1: written}))
    run.dispatch_workgroups(1024, -(-each * rows // 65536))
    run.end()
    gpu.submit(encoder)
    strips = gpu.read_buffer(written).result().view(VERTEX).reshape(rows, each).copy()
    written.destroy()
    return strips
