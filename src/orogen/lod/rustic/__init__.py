"""ROAM Using Surface Triangle Clusters; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.gpu import Buffer
from orogen.lod.bintree import BintreeView
from orogen.lod.contract import Algorithm, Detail, Draw, Module, Patches, Statistics
from orogen.lod.mesh import Mesh
from orogen.lod.wedgies import measure
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.samples import Samples

FOLDER = Path(__file__).parent
CLUSTERS = (4, 16, 64, 256)


@dataclass(frozen=True)
class Settings:
    """How exact the mesh is, what its clusters are, and what it may cost."""

    tau: float = 1.0
    """Pixels that the ground may be from where it is drawn, above 0."""
    cluster: int = 64
    """Triangles of a cluster: 4, 16, 64 or 256."""
    triangles: int = 1 << 22
    """Triangles at most, at least 512; where they are too few the greatest distortions are made as small as can be."""
    milliseconds: float | None = None
    """CPU time a frame for splits and merges, above 0, after which the mesh is drawn as it is and the next frame goes
    on; None: as long as it takes."""
    samples: int = 20_000_000
    """Samples that heights and wedgies are kept of, 24 bytes each, at least 4096; of larger terrains every second,
    fourth ... sample is kept, with bounds for what lies between."""

    def __post_init__(self) -> None:
        if not self.tau > 0:
            raise SettingsError(f"tau: expected a number of pixels above 0, got {self.tau}")
        if self.cluster not in CLUSTERS:
            raise SettingsError(f"cluster: expected 4, 16, 64 or 256 triangles, got {self.cluster}")
        if self.triangles < 512:
            raise SettingsError(f"triangles: expected at least 512, got {self.triangles}")
        if self.milliseconds is not None and not self.milliseconds > 0:
            raise SettingsError(f"milliseconds: expected a number above 0, got {self.milliseconds}")
        if self.samples < 4096:
            raise SettingsError(f"samples: expected at least 4096, got {self.samples}")

    @property
    def halvings(self) -> int:
        """How often every edge of a bintree triangle is halved."""
        return CLUSTERS.index(self.cluster) + 1


class View(BintreeView):
    """The clusters of one view."""

    def __init__(self, algorithm: Rustic) -> None:
        settings = algorithm.settings
        super().__init__(
            algorithm.clipmap.gpu, "rustic", algorithm.wedgies, tau=settings.tau,
            most=settings.triangles // settings.cluster, milliseconds=settings.milliseconds,
        )  # fmt: skip
        self._algorithm = algorithm

    def arguments(self, count: int) -> list[int]:
        """Of the cluster, for every triangle of the bintree."""
        return [3 * self._algorithm.settings.cluster, count, 0, 0, 0]

    def draw(self, buffers: Sequence[Buffer], arguments: Buffer) -> Draw:
        """All clusters; those over the raster's edge reach beyond it."""
        algorithm = self._algorithm
        group = self._gpu.bind("rustic", algorithm.module.layout, {0: buffers[0]})
        return Patches(algorithm.module, group, arguments, "triangle-list", algorithm.mesh)

    def statistics(self) -> Statistics:
        """Clusters as patches; outside the frustum there are few, and large ones."""
        count = self.bintree.count
        return Statistics(triangles=count * self._algorithm.settings.cluster, patches=count, draws=1)


class Rustic(Algorithm):
    """A bintree of triangles, split and merged by two queues, each drawn as a cluster of triangles."""

    name = "rustic"
    Settings = Settings
    detail = Detail("tau", finest=0.125, coarsest=64.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        self.wedgies = measure(Samples(clipmap.heights), clipmap.grid, settings.samples, settings.halvings)
        segments = 1 << settings.halvings
        self.mesh = Mesh(clipmap.gpu, [cluster_triangles(segments)], "rustic")
        layout = clipmap.gpu.layout("rustic", {0: ("VERTEX|COMPUTE", "read")})
        constants = {"UNIT": self.wedgies.unit, "SEGMENTS": segments}
        self.module = Module(FOLDER / "vertex.wgsl", layout, constants)

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def cluster_triangles(segments: int) -> NDArray[np.int64]:
    """(segments^2, 3) vertices of a triangle that is split as the bintree's are until its edges have so many segments.

    Vertices are numbered row by row, `segments` + 1 in a row: i + j * (segments + 1) is i steps from the apex to one
    end of the longest side, and j to the other.
    """
    # apex, one end, other end
    corners = np.array([[[0, 0], [segments, 0], [0, segments]]])
    while len(corners) < segments**2:
        apex, one, other = corners.swapaxes(0, 1)
        middle = (one + other) // 2
        corners = np.stack([np.stack([middle, apex, one], 1), np.stack([middle, other, apex], 1)], 1).reshape(-1, 3, 2)
    return corners @ np.array([1, segments + 1])
