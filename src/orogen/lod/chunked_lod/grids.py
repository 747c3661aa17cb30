"""One view's draws of chunks that are regular grids: the variant of Vistnes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer
from orogen.lod.chunked_lod.settings import Settings
from orogen.lod.contract import AlgorithmView, Draw, Module, Patches, Statistics
from orogen.lod.mesh import Mesh
from orogen.lod.quadtree import PatchFrame, PatchTree
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

_GRID = np.dtype([("corner", "i4", 2), ("quad", "i4"), ("sides", "u4"), ("id", "u4"), ("tile_level", "u4")])


class Grids:
    """What all views share: the vertex function and the one list of triangles."""

    def __init__(self, clipmap: Clipmap, n: int) -> None:
        """`n`: quads along a chunk's side."""
        gpu = clipmap.gpu
        self.clipmap = clipmap
        self.n = n
        self.tree = PatchTree(clipmap.grid, 1)
        layout = gpu.layout("chunked_lod grids", {0: ("VERTEX|COMPUTE", "read")})
        self.module = Module(FOLDER / "grid.wgsl", layout, {"SIDE": n})
        triangles = grid_triangles(n)
        self.triangle_count = len(triangles)
        self.index = Mesh(gpu, [triangles], "chunked_lod")


class GridView(AlgorithmView):
    """One grid, drawn once per chunk."""

    def __init__(self, grids: Grids, settings: Settings) -> None:
        self._grids = grids
        self._gpu = grids.clipmap.gpu
        self._pixels = settings.pixels_per_quad
        self._arguments = self._gpu.buffer("chunked_lod draw", 20, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "chunked_lod")
        self._list: Buffer | None = None
        self._group: Any = None
        self._statistics = Statistics()

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose chunks, and list them for the GPU."""
        rows = self._described(frame, view)
        if self._list is None or self._list.size < rows.nbytes:
            size = 1 << max(12, rows.nbytes.bit_length())
            self._list = self._gpu.buffer("chunked_lod grids", size, "STORAGE|COPY_DST", "chunked_lod")
            self._group = self._gpu.bind("chunked_lod grids", self._grids.module.layout, {0: self._list})
        if rows.size:
            self._gpu.write(self._list, rows)
        count = self._grids.triangle_count
        self._gpu.write(self._arguments, np.array([3 * count, rows.size, 0, 0, 0], np.uint32))
        self._statistics = Statistics(triangles=count * rows.size, patches=rows.size, draws=1)
        return [Patches(self._grids.module, self._group, self._arguments, "triangle-list", self._grids.index)]

    def statistics(self) -> Statistics:
        """Chunks as patches; the triangles of skirts count, those without any depth too."""
        return self._statistics

    def _described(self, frame: Frame, view: ClipmapView) -> NDArray[Any]:
        if not view.clipmap.heights.present:
            return np.zeros(0, _GRID)
        tree, n = self._grids.tree, self._grids.n
        bits, k = frame.subtexel_bits, n.bit_length() - 1
        longest = float(np.linalg.norm(tree.grid.metres, axis=0).max())
        levels = np.arange(tree.level_count)
        scale = frame.pixels_per_radian(frame.lod) / self._pixels
        reach = np.array([longest / n * scale * 2.0**level for level in levels.tolist()])
        # a quad is at least a subtexel wide
        reach[levels + bits <= k] = 0.0
        # skirts reach as far as from a grid to the next finer or coarser one
        level, x, y = PatchFrame(tree, frame, view, reach).leaves(restricted=True)
        rows = np.zeros(x.size, _GRID)
        rows["corner"] = (np.stack([x, y], axis=1) << (level + bits)[:, None]) + (1 << bits - 1)
        rows["quad"] = 1 << level + bits - k
        last_row, last_column = np.array([tree.shape(one) for one in levels.tolist()])[level].T - 1
        inner = x > 0, x < last_column, y > 0, y < last_row
        rows["sides"] = sum(there.astype(np.uint32) << side for side, there in enumerate(inner))
        rows["id"], rows["tile_level"] = (level << 26 ^ y << 13 ^ x) & 0xFFFFFFFF, level
        return rows


def grid_triangles(n: int) -> NDArray[np.int64]:
    """(m, 3) vertices of a grid of n x n quads, row by row, then of its skirts: west, east, north, south."""
    row = n + 1
    a = (np.arange(n)[:, None] * row + np.arange(n)).ravel()
    parts = [np.stack([a, a + 1, a + row], axis=1), np.stack([a + 1, a + row + 1, a + row], axis=1)]
    along = np.arange(n)
    for side, (first, step) in enumerate(((0, row), (n, row), (0, 1), (n * row, 1))):
        top, low = first + along * step, row * row + side * row + along
        parts += [np.stack([top, top + step, low], axis=1), np.stack([top + step, low + 1, low], axis=1)]
    return np.concatenate(parts)
