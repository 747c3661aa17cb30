"""The full-resolution mesh without levels of detail; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame, subtexel_bits
from orogen.gpu import FrameTimer
from orogen.keys import NodeKey
from orogen.lod.contract import Algorithm, AlgorithmView, Draw, Module, Patches, Statistics
from orogen.lod.mesh import Mesh
from orogen.lod.quadtree import PatchFrame, PatchTree
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.requests import wanted

FOLDER = Path(__file__).parent

TILE = 32
"""Samples along a tile's side."""
NEAR = 1 << 24
"""Flag in the vertex numbers of tiles whose quads are split: more than a tile has vertices."""
_NO_SLOT = 0xFFFF
_EVERYWHERE = 1e15


@dataclass(frozen=True)
class Settings:
    """Where the mesh follows the bilinear surface between the samples, and what is too large."""

    split: int = 8
    """Quads that the way from one sample to the next is split into where samples are far apart on screen: 1, 2, 4 or
    8; 1: two triangles between four samples everywhere."""
    split_pixels: float = 32.0
    """Pixels between samples, seen face on, from which tiles are split; above 0."""
    most_triangles: int = 1 << 26
    """Triangles of the whole mesh, unsplit, that are accepted, at least 2; larger terrains are refused."""

    def __post_init__(self) -> None:
        if self.split not in (1, 2, 4, 8):
            raise SettingsError(f"split: expected 1, 2, 4 or 8 quads between samples, got {self.split}")
        if not self.split_pixels > 0:
            raise SettingsError(f"split_pixels: expected a number above 0, got {self.split_pixels}")
        if self.most_triangles < 2:
            raise SettingsError(f"most_triangles: expected at least 2, got {self.most_triangles}")


class View(AlgorithmView):
    """The tiles that one view sees."""

    def __init__(self, algorithm: Brute) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        tiles = gpu.buffer("brute tiles", 16 * algorithm.tile_count, "STORAGE|COPY_DST", "brute")
        self._tiles = tiles
        self._draws = gpu.buffer("brute draws", 40, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "brute")
        self._slots = gpu.buffer("brute slots", algorithm.slots(), "STORAGE", "brute")
        self._slots_version = algorithm.clipmap.heights.version
        self._group = gpu.bind("brute", algorithm.module.layout, {0: tiles, 1: self._slots})
        self._written: bytes | None = None
        self._counts = (0, 0)

    def wants(self, frame: Frame) -> Sequence[NodeKey]:
        """All nodes of level 0 in the frustum, however far."""
        layer = self._algorithm.clipmap.heights
        return wanted(frame, layer.grid, layer.bounds, _EVERYWHERE, 0.0)

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Cull the tiles; the mesh itself is the same in every frame."""
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        heights = algorithm.clipmap.heights
        if self._slots_version != heights.version:
            self._slots_version = heights.version
            gpu.write(self._slots, algorithm.slots())
        far, near = algorithm.tiles(frame, view)
        if (written := far.tobytes() + b"|" + near.tobytes()) != self._written:
            self._written, self._counts = written, (len(far), len(near))
            gpu.write(self._tiles, far)
            gpu.write(self._tiles, near, 8 * algorithm.tile_count)
            plain, fine = algorithm.index_counts
            arguments = [plain, len(far), 0, 0, 0, fine, len(near), plain, 0, 0]
            gpu.write(self._draws, np.array(arguments, np.uint32))
        return [
            Patches(algorithm.module, self._group, self._draws, "triangle-list", algorithm.index, offset)
            for offset in (0, 20)
        ]

    def statistics(self) -> Statistics:
        """Tiles as patches."""
        indices = sum(np.multiply(self._counts, self._algorithm.index_counts).tolist())
        return Statistics(triangles=indices // 3, patches=sum(self._counts), draws=2)


class Brute(Algorithm):
    """Every sample a vertex, everywhere."""

    name = "brute"
    Settings = Settings

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        """Raises SettingsError where the terrain has too many triangles, BudgetError where its nodes do not fit."""
        super().__init__(clipmap, settings)
        grid, heights = clipmap.grid, clipmap.heights
        triangles = 2 * (grid.width - 1) * (grid.height - 1)
        if triangles > settings.most_triangles:
            raise SettingsError(
                f"brute: expected a terrain of at most {settings.most_triangles} triangles, got {grid.width} x "
                f"{grid.height} samples, {triangles} triangles; open a part of it, raise most_triangles or choose "
                "another algorithm"
            )
        if heights.atlas.capacity < heights.grid.node_count:
            raise BudgetError(
                f"brute: expected room for all {heights.grid.node_count} nodes of heights, got "
                f"{heights.atlas.capacity}; raise memory=, choose a larger node_size= or another algorithm"
            )
        self.tree = PatchTree(grid, TILE)
        rows, columns = self.tree.shape(0)
        self.tile_count = rows * columns
        bits = subtexel_bits(grid)
        split = min(settings.split, 1 << bits)
        lists = index_list(split, split), index_list(split, 1) | NEAR
        self.index_counts = lists[0].size, lists[1].size
        """Numbers of vertices listed for a plain tile and for a split one, which follow each other in `index`."""
        gpu, read = clipmap.gpu, ("VERTEX|COMPUTE", "read")
        self.index = Mesh(gpu, lists, "brute")
        constants = {
            "TILE": TILE, "SPLIT": split, "STEP": (1 << bits) // split, "NODE_COLUMNS": heights.grid.nodes(0)[1],
            "NEAR_TILES": self.tile_count, "NEAR": NEAR,
        }  # fmt: skip
        self.module = Module(FOLDER / "vertex.wgsl", gpu.layout("brute", {0: read, 1: read}), constants)

    def slots(self) -> NDArray[np.uint32]:
        """(node rows, node columns) of level 0: the slot of each node in the atlas, 0xFFFF where it is not resident."""
        heights = self.clipmap.heights
        table = np.full(heights.grid.nodes(0), _NO_SLOT, np.uint32)
        for key, slot in heights.current.items():
            if key.level == 0:
                table[key.y, key.x] = slot
        return table

    def tiles(self, frame: Frame, view: ClipmapView) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """(n, 2) columns and rows of the tiles in the frustum: those drawn plain, and those near enough to be split."""
        if not self.clipmap.heights.present:
            return np.zeros((0, 2), np.uint32), np.zeros((0, 2), np.uint32)
        seen = PatchFrame(self.tree, frame, view)
        _, x, y = seen.leaves()
        spacing = float(np.linalg.norm(frame.grid.metres, axis=0).max())
        reach = spacing * frame.pixels_per_radian(frame.lod) / self.settings.split_pixels
        near = seen.distance(0, x, y) < reach
        tiles = np.stack([x, y], axis=1).astype(np.uint32)
        return tiles[~near], tiles[near]

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def index_list(split: int, step: int) -> NDArray[np.uint32]:
    """(n, 3) vertices of the triangles of a tile, `split` x `split` vertices a sample, quads of `step` a side.

    Vertices are counted row by row. A finer tile has no vertices on its border but those of its samples, so that it
    fits its neighbours: others move to the sample before them, which is exact, because a bilinear surface is straight
    between two samples.
    """
    last = TILE * split
    row, column = np.meshgrid(*2 * [np.arange(0, last + 1, step)], indexing="ij")
    on_side, on_end = np.isin(column, (0, last)), np.isin(row, (0, last))
    row, column = np.where(on_side, row - row % split, row), np.where(on_end, column - column % split, column)
    vertex = row * (last + 1) + column
    a, b, c, d = vertex[:-1, :-1], vertex[:-1, 1:], vertex[1:, :-1], vertex[1:, 1:]
    return np.stack([a, c, b, b, c, d], axis=-1).reshape(-1, 3).astype(np.uint32)
