"""Geometrical mipmapping; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame, subtexel_bits
from orogen.gpu import Buffer, FrameTimer
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.geomipmap.errors import drawn_samples, measured
from orogen.lod.geomipmap.levels import Levels
from orogen.lod.geomipmap.patterns import LIST_BIT, LISTS, NO_COLUMNS_BIT, NO_ROWS_BIT, index_lists
from orogen.lod.mesh import Mesh
from orogen.lod.quadtree import PatchFrame, PatchTree
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent
MOST_SAMPLES = 1 << 28
"""Samples of a raster, at most: all of them are read, and held in memory while they are measured."""

_BLOCK = np.dtype([("x", "u4"), ("y", "u4"), ("thinned", "u4"), ("morph", "f4"), ("edges", "f4", 4)])
_ARGUMENTS = 20
"""Bytes of the arguments of an indexed draw."""


@dataclass(frozen=True)
class Settings:
    """The blocks, and the error that they may have."""

    block_size: int = 16
    """Samples along a block's side: a power of two from 4 to 64."""
    quads_per_sample: int = 8
    """Quads along a sample's side at the finest level: 1, as published, 2, 4 or 8."""
    max_error: float = 1.0
    """Pixels that a block may be off on screen (tau), above 0."""
    morph: bool = True
    """Whether blocks morph from level to level; without, they jump, and are a little more exact before they do."""

    def __post_init__(self) -> None:
        if self.block_size not in (4, 8, 16, 32, 64):
            raise SettingsError(f"block_size: expected a power of two from 4 to 64, got {self.block_size}")
        if self.quads_per_sample not in (1, 2, 4, 8):
            raise SettingsError(f"quads_per_sample: expected 1, 2, 4 or 8, got {self.quads_per_sample}")
        if not self.max_error > 0:
            raise SettingsError(f"max_error: expected a number of pixels above 0, got {self.max_error}")


class View(AlgorithmView):
    """The blocks that one view sees, sorted by index list."""

    def __init__(self, algorithm: Geomipmap) -> None:
        self._algorithm = algorithm
        gpu, lists = algorithm.clipmap.gpu, len(algorithm.triangles)
        self._starts = gpu.buffer("geomipmap", 16 * lists, "UNIFORM|COPY_DST", "geomipmap")
        self._draws = gpu.buffer(
            "geomipmap draws", _ARGUMENTS * lists, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "geomipmap"
        )
        self._counts = np.zeros(lists, np.int64)
        self._seen = 0
        self._grow(256)

    def _grow(self, count: int) -> None:
        gpu = self._algorithm.clipmap.gpu
        self._blocks: Buffer = gpu.buffer("geomipmap blocks", _BLOCK.itemsize * count, "STORAGE|COPY_DST", "geomipmap")
        self._group = gpu.bind("geomipmap", self._algorithm.module.layout, {0: self._starts, 1: self._blocks})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose the blocks' levels on the CPU; one instanced draw for each index list that occurs."""
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        blocks, level = algorithm.choose(frame, view)
        self._seen = blocks.size
        entry, number = entries(level, blocks["thinned"], algorithm.triangles)
        self._counts = np.bincount(number, minlength=len(algorithm.triangles))
        starts = np.zeros((self._counts.size, 4), np.uint32)
        starts[:, 0] = np.cumsum(self._counts) - self._counts
        # few numbers of few bits are sorted faster, and rows of words copied faster than records
        order = entry[np.argsort(number.astype(np.uint16), kind="stable")]
        listed = blocks.view(np.uint64).reshape(-1, _BLOCK.itemsize // 8)[order]
        if listed.nbytes > self._blocks.size:
            self._grow(2 * len(listed))
        gpu.write(self._blocks, listed)
        gpu.write(self._starts, starts)
        gpu.write(self._draws, algorithm.arguments(self._counts))
        return [
            Patches(
                algorithm.module,
                self._group,
                self._draws,
                "triangle-list",
                algorithm.index,
                _ARGUMENTS * int(n),
            )
            for n in np.flatnonzero(self._counts)
        ]

    def statistics(self) -> Statistics:
        """Blocks as patches."""
        triangles = int(self._counts @ self._algorithm.triangles)
        return Statistics(triangles, self._seen, draws=int(np.count_nonzero(self._counts)))


class Geomipmap(Algorithm):
    """Blocks of equal size, each at the level that its measured error allows at its distance."""

    name = "geomipmap"
    Settings = Settings
    detail = Detail("max_error", 0.25, 32.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        """Reads and measures all samples. Raises BudgetError where there are too many of them."""
        super().__init__(clipmap, settings)
        grid, gpu = clipmap.grid, clipmap.gpu
        if grid.width * grid.height > MOST_SAMPLES:
            raise BudgetError(
                f"geomipmap measures every sample: expected at most {MOST_SAMPLES} of them, got {grid.width} x "
                f"{grid.height}; cut the data or choose another algorithm"
            )
        bits = subtexel_bits(grid)
        # a quad is no smaller than a subtexel, of which huge rasters have few
        finer = min(settings.quads_per_sample.bit_length() - 1, bits)
        self.tree = PatchTree(grid, settings.block_size)
        errors = measured(drawn_samples(clipmap), settings.block_size, finer)
        self.levels = Levels(self.tree, errors)
        quads = settings.block_size << finer
        lists = index_lists(quads)
        self.triangles = np.array([len(triangles) for triangles in lists])
        self.index = Mesh(gpu, lists, "geomipmap")
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "geomipmap.wgsl",
            gpu.layout("geomipmap", {0: (stages, "uniform"), 1: (stages, "read")}),
            {
                "SIDE": quads, "UNIT_BITS": bits - finer, "LISTS": LISTS, "COUNT": len(lists), "LIST_BIT": LIST_BIT,
                "NO_ROWS_BIT": NO_ROWS_BIT, "NO_COLUMNS_BIT": NO_COLUMNS_BIT,
            },
        )  # fmt: skip

    def view(self) -> View:
        """State for one more view."""
        return View(self)

    def choose(self, frame: Frame, view: ClipmapView) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """The blocks in the LOD camera's frustum (dtype _BLOCK), and the level of each."""
        if not self.clipmap.heights.present:
            return np.zeros(0, _BLOCK), np.zeros(0, np.int64)
        # the quadtree is for culling alone
        _, x, y = PatchFrame(self.tree, frame, view).leaves()
        allowed = self.levels.allowed_error(frame, self.settings.max_error)
        level = self.levels.at(allowed, morph=self.settings.morph)
        own, edges = level[y, x], self.levels.edges(level)[:, y, x]
        whole = np.floor(own).astype(np.int64)
        blocks = np.zeros(x.size, _BLOCK)
        blocks["x"], blocks["y"] = x, y
        blocks["thinned"] = ((np.floor(edges) > whole) << np.arange(4)[:, None]).sum(axis=0)
        blocks["morph"], blocks["edges"] = own - whole, (edges - np.floor(edges)).T
        return blocks, whole

    def arguments(self, counts: NDArray[np.int64]) -> NDArray[np.uint32]:
        """(lists, 5) arguments of indexed draws of so many blocks per list."""
        indices = 3 * self.triangles
        arguments = np.zeros((counts.size, 5), np.uint32)
        arguments[:, 0], arguments[:, 1], arguments[:, 2] = indices, counts, np.cumsum(indices) - indices
        return arguments


def entries(
    level: NDArray[np.int64], thinned: NDArray[np.uint32], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which blocks are drawn by which index lists of so many triangles: numbers of blocks and of lists, in pairs."""
    number = np.stack([LISTS * level, *(LISTS * level + 1 + 2 * edge + (thinned >> edge & 1) for edge in range(4))])
    # the last level has no lists for edges, the one before it nothing inside
    part, block = np.nonzero(np.append(triangles, np.zeros(LISTS, np.int64))[number])
    return block, number[part, block]
