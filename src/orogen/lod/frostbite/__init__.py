"""The terrain of the Frostbite engine: a restricted quadtree of 33 x 33 vertices; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.frame import Frame, subtexel_bits
from orogen.gpu import Buffer, FrameTimer
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.frostbite.patterns import PATTERNS, QUADS, Bits, index_lists, pattern_of
from orogen.lod.mesh import Mesh
from orogen.lod.quadtree import PatchFrame, PatchTree, coarser
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

_PATCH = np.dtype([("x", "i4"), ("y", "i4"), ("level", "u4"), ("unused", "u4")])
_BLOCK = np.dtype([("quad", "u4"), ("padding", "u4", 3), ("starts", "u4", (PATTERNS, 4))])
_ARGUMENTS = 20
"""Bytes of the arguments of an indexed draw."""


@dataclass(frozen=True)
class Settings:
    """How fine the patches are."""

    pixels_per_quad: float = 4.0
    """Greatest width of a quad in pixels at the nearest point of its patch's box, seen face on, above 0."""
    quads_per_sample: int = 32
    """Quads along a sample's side in the finest patches: a power of two from 1, as in the document, to 32."""

    def __post_init__(self) -> None:
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if self.quads_per_sample not in (1, 2, 4, 8, 16, 32):
            raise SettingsError(f"quads_per_sample: expected a power of two from 1 to 32, got {self.quads_per_sample}")


class View(AlgorithmView):
    """The patches that one view sees, sorted by index pattern."""

    def __init__(self, algorithm: Frostbite) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        self._block = gpu.buffer("frostbite", _BLOCK.itemsize, "UNIFORM|COPY_DST", "frostbite")
        self._draws = gpu.buffer(
            "frostbite draws", _ARGUMENTS * PATTERNS, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "frostbite"
        )
        self._counts = np.zeros(PATTERNS, np.int64)
        self._grow(256)

    def _grow(self, count: int) -> None:
        gpu = self._algorithm.clipmap.gpu
        self._patches: Buffer = gpu.buffer(
            "frostbite patches", _PATCH.itemsize * count, "STORAGE|COPY_DST", "frostbite"
        )
        self._group = gpu.bind("frostbite", self._algorithm.module.layout, {0: self._block, 1: self._patches})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose the patches on the CPU; one instanced draw for each pattern that occurs."""
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        patches, pattern = algorithm.choose(frame, view)
        self._counts = np.bincount(pattern, minlength=PATTERNS)
        block = np.zeros((), _BLOCK)
        block["quad"] = (algorithm.tree.side << frame.subtexel_bits) // QUADS
        block["starts"][:, 0] = np.cumsum(self._counts) - self._counts
        if patches.nbytes > self._patches.size:
            self._grow(2 * len(patches))
        gpu.write(self._patches, patches[np.argsort(pattern, kind="stable")])
        gpu.write(self._block, block)
        gpu.write(self._draws, algorithm.arguments(self._counts))
        return [
            Patches(algorithm.module, self._group, self._draws, "triangle-list", algorithm.index, _ARGUMENTS * int(n))
            for n in np.flatnonzero(self._counts)
        ]

    def statistics(self) -> Statistics:
        """Quadtree nodes as patches."""
        return Statistics(
            triangles=int(self._counts @ self._algorithm.triangles),
            patches=int(self._counts.sum()),
            draws=int(np.count_nonzero(self._counts)),
        )


class Frostbite(Algorithm):
    """A restricted quadtree of equal grids, stitched by nine index lists."""

    name = "frostbite"
    Settings = Settings
    detail = Detail("pixels_per_quad", 0.5, 256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        # a quad is no smaller than a subtexel, of which huge rasters have few
        finest = min(settings.quads_per_sample, 1 << subtexel_bits(clipmap.grid))
        self.tree = PatchTree(clipmap.grid, QUADS // finest)
        # the longer side, where texels are not square
        self.quad_metres = float(np.linalg.norm(clipmap.grid.metres, axis=0).max()) / finest
        lists = index_lists()
        self.triangles = np.array([len(triangles) for triangles in lists])
        self.index = Mesh(gpu, lists, "frostbite")
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("frostbite", {0: (stages, "uniform"), 1: (stages, "read")}),
            {"QUADS": QUADS, "PATTERNS": PATTERNS, **{bits.name: bits.value for bits in Bits}},
        )

    def view(self) -> View:
        """State for one more view."""
        return View(self)

    def choose(self, frame: Frame, view: ClipmapView) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """The leaves in the LOD camera's frustum (dtype _PATCH), and the pattern of each."""
        if not self.clipmap.heights.present:
            return np.zeros(0, _PATCH), np.zeros(0, np.int64)
        # equations 2.2 and 2.3 (Houska 2019) with the quad's width as the error
        reach = self.quad_metres * frame.pixels_per_radian(frame.lod) / self.settings.pixels_per_quad
        chosen = PatchFrame(self.tree, frame, view, reach * 2.0 ** np.arange(self.tree.level_count))
        leaves = chosen.leaves(restricted=True)
        patches = np.zeros(leaves.x.size, _PATCH)
        patches["x"], patches["y"], patches["level"] = leaves.x, leaves.y, leaves.level
        return patches, pattern_of(coarser(leaves))

    def arguments(self, counts: NDArray[np.int64]) -> NDArray[np.uint32]:
        """(patterns, 5) arguments of indexed draws of so many patches per pattern."""
        indices = 3 * self.triangles
        arguments = np.zeros((PATTERNS, 5), np.uint32)
        arguments[:, 0], arguments[:, 1], arguments[:, 2] = indices, counts, np.cumsum(indices) - indices
        return arguments
