"""The vertices and triangles of a draw of patches, read back from the GPU."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lod.scene import Scene
from orogen.frame import Frame
from orogen.lod.contract import AlgorithmView, Patches
from orogen.raster.rasterizer import FOLDER
from orogen.streaming.clipmap import SEARCH

VERTEX = np.dtype(
    [
        ("position", "f4", 3),
        ("height", "f4"),
        ("offset", "f4", 2),
        ("grid", "f4", 2),
        ("id", "u4"),
        ("level", "u4"),
        ("tile_level", "u4"),
        ("instance", "u4"),
    ]
)


@dataclass(frozen=True)
class Drawn:
    vertices: NDArray[Any]
    """(patches, vertices per patch) of dtype VERTEX."""
    index: NDArray[np.integer]
    """(triangles, 3) vertex numbers of a patch."""

    @property
    def tiles(self) -> NDArray[np.int64]:
        """(patches, 3): level, column, row; the ids of small terrains hold them apart."""
        level = self.vertices["tile_level"][:, 0].astype(np.int64)
        rest = self.vertices["id"][:, 0].astype(np.int64) ^ (level << 26)
        return np.stack([level, rest & 0x1FFF, rest >> 13], axis=1)

    @property
    def triangles(self) -> NDArray[np.float32]:
        """(n, 3, 3) camera-relative corners, those without area left out."""
        p = self.vertices["position"]
        corners = p[:, self.index].reshape(-1, 3, 3)
        a, b, c = corners.swapaxes(0, 1)
        same = (a == b).all(1) | (b == c).all(1) | (c == a).all(1)
        return corners[~same]


def read_patches(scene: Scene, frame: Frame, state: AlgorithmView, *, grow: bool = True) -> Drawn:
    """What `state` would draw for a frame, with as much room as it needs unless `grow` is off."""
    (draw,) = scene.record(frame, state)
    while grow and state.incomplete():
        (draw,) = scene.record(frame, state)
    assert isinstance(draw, Patches)
    gpu, clipmap = scene.gpu, scene.clipmap
    grid_size = state._algorithm.settings.grid_size  # type: ignore[attr-defined]
    shader = gpu.shader(
        "vertices", draw.module.path, Path(__file__).parent / "patch_vertices.wgsl",
        search=[FOLDER, *SEARCH],
        constants={**clipmap.constants, **draw.module.constants, "EACH": (grid_size + 1) ** 2},
    )  # fmt: skip
    layout = gpu.layout("vertices", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")})
    pipeline = gpu.compute("vertices", shader, "write_vertices", [clipmap.layout, draw.module.layout, layout])
    patches = state.statistics().patches
    each = (grid_size + 1) ** 2
    written = gpu.buffer("vertices", VERTEX.itemsize * max(1, patches * each), "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("vertices")
    run = encoder.begin_compute_pass(label="vertices")
    run.set_pipeline(pipeline)
    run.set_bind_group(0, scene.view.bind_group)
    run.set_bind_group(1, draw.group)
    run.set_bind_group(2, gpu.bind("vertices", layout, {0: draw.indirect, 1: written}))
    run.dispatch_workgroups(1024, -(-patches * each // 65536))
    run.end()
    gpu.submit(encoder)
    vertices = gpu.read_buffer(written).result().view(VERTEX)
    written.destroy()
    assert draw.index is not None
    index = gpu.read_buffer(draw.index.indices).result().view(np.uint32).reshape(-1, 3)
    return Drawn(vertices[: patches * each].reshape(patches, each).copy(), index)


def torn_edges(triangles: NDArray[np.float32], outline: tuple[float, float, float, float]) -> NDArray[np.float32]:
    """(n, 2, 3): edges where a surface of triangles ends; none where it is watertight within its outline.

    Corners are the same only if they are equal bit for bit. An edge ends the surface where an odd number of triangles
    meets (a fold that is just closing has four). `outline`: west, south, east, north of the surface.
    """
    corners, index = np.unique(triangles.reshape(-1, 3) + np.float32(0), axis=0, return_inverse=True)
    index = index.reshape(-1, 3)
    edges = np.sort(np.concatenate([index[:, [0, 1]], index[:, [1, 2]], index[:, [2, 0]]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    ends = corners[edges]
    west, south, east, north = outline
    x, y = ends[..., 0], ends[..., 1]
    on_outline = np.stack([x == west, x == east, y == south, y == north]).all(axis=2).any(axis=0)
    return ends[(count % 2 == 1) & ~on_outline]
