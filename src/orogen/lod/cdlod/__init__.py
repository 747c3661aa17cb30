"""Continuous distance-dependent level of detail; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.frame import Frame, subtexel_bits
from orogen.gpu import FrameTimer
from orogen.lod.cdlod.ground import Ground
from orogen.lod.cdlod.ranges import Ranges
from orogen.lod.cdlod.seams import COARSER_BIT
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.mesh import Mesh
from orogen.lod.quadtree import PatchTree
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent
THINNED_BIT = 20
"""Bit of a vertex number that marks the index list of every second vertex."""

_PIECE = np.dtype([("x", "u4"), ("y", "u4"), ("level", "u4"), ("edges", "u4")])
_BLOCK = np.dtype(
    [
        ("grid_size", "u4"),
        ("leaf", "u4"),
        ("top", "u4"),
        ("thinned", "u4"),
        ("range", "f4"),
        ("morph_range", "f4"),
        ("ground_bits", "u4"),
        ("ground_columns", "u4"),
        ("eye_cell", "i4", 2),
        ("eye_frac", "f4", 2),
        ("eye_height", "f4"),
        ("padding", "f4", 3),
    ]
)
_ARGUMENTS = 20
"""Bytes of the arguments of an indexed draw."""


@dataclass(frozen=True)
class Settings:
    """The grid of a node, and the ranges of the levels of detail."""

    grid_size: int = 16
    """Rows and columns of quads in a node: a power of two from 8 to 128."""
    quads_per_sample: int = 16
    """Quads along a sample's side at the finest level: a power of two from 1 to grid_size."""
    pixels_per_quad: float = 3.0
    """Greatest width of a quad in pixels where it is seen face on, above 0; quads are drawn down to half of it."""
    morph_range: float = 0.2
    """Last share of a level's range in which its vertices move to those of the next, above 0 and below 0.5."""

    def __post_init__(self) -> None:
        if self.grid_size not in (8, 16, 32, 64, 128):
            raise SettingsError(f"grid_size: expected a power of two from 8 to 128, got {self.grid_size}")
        if self.quads_per_sample not in (1 << np.arange(8)) or self.quads_per_sample > self.grid_size:
            raise SettingsError(
                f"quads_per_sample: expected a power of two from 1 to {self.grid_size}, got {self.quads_per_sample}"
            )
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if not 0 < self.morph_range < 0.5:
            raise SettingsError(f"morph_range: expected above 0 and below 0.5, got {self.morph_range}")


class View(AlgorithmView):
    """The pieces that one view sees: whole nodes, then those with every second vertex."""

    def __init__(self, algorithm: Cdlod) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        self._block = gpu.buffer("cdlod", _BLOCK.itemsize, "UNIFORM|COPY_DST", "cdlod")
        self._draws = gpu.buffer("cdlod draws", 2 * _ARGUMENTS, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "cdlod")
        self._counts = np.zeros(2, np.int64)
        self._grow(256)

    def _grow(self, count: int) -> None:
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        self._pieces = gpu.buffer("cdlod pieces", _PIECE.itemsize * count, "STORAGE|COPY_DST", "cdlod")
        self._group = gpu.bind(
            "cdlod", algorithm.module.layout, {0: self._block, 1: self._pieces, 2: algorithm.ground_buffer}
        )

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose the nodes on the CPU; a draw for each of the two index lists that occurs."""
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        self._counts = np.zeros(2, np.int64)
        if not algorithm.clipmap.heights.present:
            return []
        ranges = Ranges(frame, view, algorithm.ground, algorithm.quad_metres, algorithm.settings)
        chosen = ranges.choose()
        self._counts = np.bincount(chosen.thinned, minlength=2)
        pieces = np.zeros(chosen.level.size, _PIECE)
        for name in ("x", "y", "level", "edges"):
            pieces[name] = getattr(chosen, name)
        if pieces.nbytes > self._pieces.size:
            self._grow(2 * len(pieces))
        gpu.write(self._pieces, pieces)
        gpu.write(self._block, algorithm.block(frame, ranges, int(self._counts[0])))
        gpu.write(self._draws, algorithm.arguments(self._counts))
        return [
            Patches(algorithm.module, self._group, self._draws, "triangle-list", algorithm.index, _ARGUMENTS * int(n))
            for n in np.flatnonzero(self._counts)
        ]

    def statistics(self) -> Statistics:
        """Whole nodes and quadrants as patches."""
        triangles = int(self._counts @ self._algorithm.triangles)
        return Statistics(triangles, int(self._counts.sum()), draws=int(np.count_nonzero(self._counts)))


class Cdlod(Algorithm):
    """A quadtree of equal grids, chosen by 3D distance and morphed vertex by vertex."""

    name = "cdlod"
    Settings = Settings
    detail = Detail("pixels_per_quad", 0.5, 256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        # a quad is no smaller than a subtexel, of which huge rasters have few
        finest = min(settings.quads_per_sample, 1 << subtexel_bits(clipmap.grid))
        self.tree = PatchTree(clipmap.grid, settings.grid_size // finest)
        # the longer side, where texels are not square
        self.quad_metres = float(np.linalg.norm(clipmap.grid.metres, axis=0).max()) / finest
        self.ground = Ground(clipmap, self.tree)
        self.ground_buffer = gpu.buffer("cdlod ground", self.ground.heights, "STORAGE", "cdlod")
        lists = [grid_triangles(settings.grid_size, step) for step in (1, 2)]
        self.triangles = np.array([len(triangles) for triangles in lists])
        self.index = Mesh(gpu, [lists[0], lists[1] | 1 << THINNED_BIT], "cdlod")
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "cdlod.wgsl",
            gpu.layout("cdlod", {0: (stages, "uniform"), 1: (stages, "read"), 2: (stages, "read")}),
            {"THINNED_BIT": THINNED_BIT, "COARSER_BIT": COARSER_BIT},
        )

    def view(self) -> View:
        """State for one more view."""
        return View(self)

    def block(self, frame: Frame, ranges: Ranges, whole: int) -> NDArray[np.void]:
        """The uniform block of cdlod.wgsl; `whole`: pieces drawn with all vertices."""
        block = np.zeros((), _BLOCK)
        bits = frame.subtexel_bits
        block["grid_size"] = self.settings.grid_size
        block["leaf"] = (self.tree.side << bits) // self.settings.grid_size
        block["top"], block["thinned"] = self.tree.level_count - 1, whole
        block["range"], block["morph_range"] = ranges.ends[0], self.settings.morph_range
        block["ground_bits"], block["ground_columns"] = self.ground.bits, self.ground.heights.shape[1]
        eye = (ranges.eye_texel + 0.5) * (1 << bits)
        block["eye_cell"] = cell = np.clip(np.floor(eye), -(2.0**29), 2.0**29)
        block["eye_frac"], block["eye_height"] = eye - cell, ranges.eye_height
        return block

    def arguments(self, counts: NDArray[np.int64]) -> NDArray[np.uint32]:
        """(2, 5) arguments of the indexed draws of so many pieces with all vertices and with every second one."""
        indices = 3 * self.triangles
        arguments = np.zeros((2, 5), np.uint32)
        arguments[:, 0], arguments[:, 1], arguments[:, 2] = indices, counts, np.cumsum(indices) - indices
        return arguments


def grid_triangles(grid_size: int, step: int) -> NDArray[np.uint32]:
    """(n, 3) vertex numbers of a grid's triangles with every `step`-th vertex, row by row."""
    row, column = (part.ravel() for part in np.mgrid[0:grid_size:step, 0:grid_size:step])
    a = row * (grid_size + 1) + column
    b, c = a + step, a + step * (grid_size + 1)
    # diagonals fall, so that fully morphed quads make those of the next level, diagonals included
    corners = np.stack([a, c, b, b, c, c + step], axis=-1)
    return corners.reshape(-1, 3).astype(np.uint32)
