"""Seamless patches: four triangular tiles and the strips between them; see README.md in this folder."""

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
from orogen.lod.mesh import Mesh
from orogen.lod.quadtree import PatchTree
from orogen.lod.seamless_patches.edges import Edges
from orogen.lod.seamless_patches.meshes import Bits, index_lists, resolutions
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

_PIECE = np.dtype([("x", "i4"), ("y", "i4"), ("level", "u4"), ("turn", "u4")])
_ARGUMENTS = 20
"""Bytes of the arguments of an indexed draw."""
_LEAST_PRECISION = 1.0
"""Below this a patch may be much nearer in its middle than at its edges, which decide on its detail."""


@dataclass(frozen=True)
class Settings:
    """How fine the patches are."""

    pixels_per_quad: float = 3.0
    """Greatest length of an edge's segments in pixels, seen face on, above 0; they are drawn down to half of it."""
    resolution: int = 16
    """Most segments of a patch's edge (R_max of equation 2.7): a power of two from 8 to 64."""
    quads_per_sample: int = 16
    """Segments along a sample's side in the finest patches: a power of two from 1, as in the document, to the
    resolution."""

    def __post_init__(self) -> None:
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if self.resolution not in (8, 16, 32, 64):
            raise SettingsError(f"resolution: expected a power of two from 8 to 64, got {self.resolution}")
        if self.quads_per_sample not in (1, *resolutions(self.resolution)):
            raise SettingsError(
                f"quads_per_sample: expected a power of two from 1 to resolution ({self.resolution}), "
                f"got {self.quads_per_sample}"
            )


class View(AlgorithmView):
    """The pieces of the patches that one view sees, sorted by mesh."""

    def __init__(self, algorithm: SeamlessPatches) -> None:
        self._algorithm = algorithm
        gpu = algorithm.clipmap.gpu
        meshes = len(algorithm.triangles)
        self._block_type = np.dtype([("unit", "u4"), ("padding", "u4", 3), ("starts", "u4", (meshes, 4))])
        self._block = gpu.buffer("seamless patches", self._block_type.itemsize, "UNIFORM|COPY_DST", algorithm.name)
        self._draws = gpu.buffer(
            "seamless draws", _ARGUMENTS * meshes, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", algorithm.name
        )
        self._counts = np.zeros(meshes, np.int64)
        self._patches = 0
        self._grow(1024)

    def _grow(self, count: int) -> None:
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        self._pieces: Buffer = gpu.buffer("pieces", _PIECE.itemsize * count, "STORAGE|COPY_DST", algorithm.name)
        self._group = gpu.bind("seamless patches", algorithm.module.layout, {0: self._block, 1: self._pieces})

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose patches and edges on the CPU; one instanced draw for each mesh that occurs."""
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        pieces, self._counts = algorithm.choose(frame, view)
        # every patch has four strips, but triles only from a resolution of 4 on
        self._patches = int(self._counts[algorithm.kinds :].sum()) // 4
        block = np.zeros((), self._block_type)
        block["unit"] = (algorithm.tree.side << frame.subtexel_bits) // algorithm.settings.resolution
        block["starts"][:, 0] = np.cumsum(self._counts) - self._counts
        if pieces.nbytes > self._pieces.size:
            self._grow(2 * len(pieces))
        gpu.write(self._pieces, pieces)
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
            patches=self._patches,
            draws=int(np.count_nonzero(self._counts)),
        )


class SeamlessPatches(Algorithm):
    """Patches whose four sides each have a resolution of their own, that of the neighbour there."""

    name = "seamless_patches"
    Settings = Settings
    detail = Detail("pixels_per_quad", 0.5, 256.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu, most = clipmap.gpu, settings.resolution
        # a segment is no smaller than a subtexel, of which huge rasters have few
        finest = min(settings.quads_per_sample, 1 << subtexel_bits(clipmap.grid))
        self.tree = PatchTree(clipmap.grid, most // finest)
        self.kinds = len(resolutions(most))
        lists = index_lists(most)
        self.triangles = np.array([len(triangles) for triangles in lists])
        self.index = Mesh(gpu, lists, self.name)
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("seamless patches", {0: (stages, "uniform"), 1: (stages, "read")}),
            {
                "MOST": most,
                "MESHES": len(lists),
                "TRILES": self.kinds,
                **{bits.name: bits.value for bits in Bits},
            },
        )

    def view(self) -> View:
        """State for one more view."""
        return View(self)

    def edges(self, frame: Frame, view: ClipmapView) -> Edges:
        """What decides on the frame's patches."""
        most = self.settings.resolution
        # equations 2.2 and 2.3 (Houska 2019) with a segment's length as the error
        precision = frame.pixels_per_radian(frame.lod) / (self.settings.pixels_per_quad * most)
        return Edges(self.tree, frame, view, max(precision, _LEAST_PRECISION), most)

    def choose(self, frame: Frame, view: ClipmapView) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Pieces of the leaves in the LOD camera's frustum (dtype _PIECE), mesh by mesh, and how many each mesh has."""
        meshes = len(self.triangles)
        if not self.clipmap.heights.present:
            return np.zeros(0, _PIECE), np.zeros(meshes, np.int64)
        edges = self.edges(frame, view)
        leaves = edges.leaves(restricted=True)
        # place of a resolution among all: 2, 4 ...
        kind = np.log2(edges.resolutions(leaves)).astype(np.int64) - 1
        # turned by a quarter, the strip at the north-west corner lies between the east and the north trile
        strips = self.kinds + kind * self.kinds + kind[:, [3, 0, 1, 2]]
        mesh = np.stack([kind, strips], axis=1).ravel()
        drawn = np.flatnonzero(self.triangles[mesh] > 0)
        mesh = mesh[drawn]
        # few numbers of few bits are sorted faster
        drawn = drawn[np.argsort(mesh.astype(np.uint16), kind="stable")]
        pieces = np.empty(drawn.size, _PIECE)
        for name, values in leaves._asdict().items():
            pieces[name] = values[drawn >> 3]
        pieces["turn"] = drawn & 3
        return pieces, np.bincount(mesh, minlength=meshes)

    def arguments(self, counts: NDArray[np.int64]) -> NDArray[np.uint32]:
        """(meshes, 5) arguments of indexed draws of so many pieces per mesh."""
        indices = 3 * self.triangles
        arguments = np.zeros((len(indices), 5), np.uint32)
        arguments[:, 0], arguments[:, 1], arguments[:, 2] = indices, counts, np.cumsum(indices) - indices
        return arguments
