"""Real-time Optimally Adapting Meshes; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orogen.errors import SettingsError
from orogen.gpu import Buffer
from orogen.lod.bintree import BintreeView
from orogen.lod.contract import Algorithm, Detail, Draw, Module, Patches, Statistics
from orogen.lod.wedgies import measure
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.samples import Samples

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Settings:
    """How exact the mesh is, and what it may cost."""

    tau: float = 1.0
    """Pixels that the ground may be from where it is drawn, above 0."""
    morph: float = 0.0
    """Part by which the distortion that split a triangle has to grow until the new vertex has risen from the old
    surface into its place, from 0 to 1; with 0 it is there at once."""
    triangles: int = 1 << 20
    """Triangles at most, at least 2; where they are too few the greatest distortions are made as small as can be."""
    milliseconds: float | None = None
    """CPU time a frame for splits and merges, above 0, after which the mesh is drawn as it is and the next frame goes
    on; None: as long as it takes."""
    samples: int = 20_000_000
    """Samples that heights and wedgies are kept of, 16 bytes each, at least 4096; of larger terrains every second,
    fourth ... sample is kept, with bounds for what lies between."""

    def __post_init__(self) -> None:
        if not self.tau > 0:
            raise SettingsError(f"tau: expected a number of pixels above 0, got {self.tau}")
        if not 0 <= self.morph <= 1:
            raise SettingsError(f"morph: expected 0 to 1, got {self.morph}")
        if self.triangles < 2:
            raise SettingsError(f"triangles: expected at least 2, got {self.triangles}")
        if self.milliseconds is not None and not self.milliseconds > 0:
            raise SettingsError(f"milliseconds: expected a number above 0, got {self.milliseconds}")
        if self.samples < 4096:
            raise SettingsError(f"samples: expected at least 4096, got {self.samples}")


class View(BintreeView):
    """The mesh of one view."""

    def __init__(self, algorithm: Roam) -> None:
        settings = algorithm.settings
        super().__init__(
            algorithm.clipmap.gpu, "roam", algorithm.wedgies,
            tau=settings.tau / (1 + settings.morph), most=settings.triangles, milliseconds=settings.milliseconds,
            morph=settings.morph,
        )  # fmt: skip
        self._module = algorithm.module

    def arguments(self, count: int) -> list[int]:
        """Of a list of triangles."""
        return [3 * count, 1, 0, 0]

    def draw(self, buffers: Sequence[Buffer], arguments: Buffer) -> Draw:
        """The whole mesh; triangles over the raster's edge reach beyond it."""
        group = self._gpu.bind("roam", self._module.layout, dict(enumerate(buffers)))
        return Patches(self._module, group, arguments, "triangle-list")

    def statistics(self) -> Statistics:
        """All triangles of the mesh; outside the frustum there are few, and large ones."""
        return Statistics(triangles=self.bintree.count, draws=1)


class Roam(Algorithm):
    """A bintree of triangles, split and merged by two queues in the order of their distortion on screen."""

    name = "roam"
    Settings = Settings
    detail = Detail("tau", finest=0.125, coarsest=64.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        self.wedgies = measure(Samples(clipmap.heights), clipmap.grid, settings.samples)
        lists = ["triangles", *(["shifts"] if settings.morph else [])]
        layout = clipmap.gpu.layout("roam", dict.fromkeys(range(len(lists)), ("VERTEX|COMPUTE", "read")))
        path = FOLDER / ("morph.wgsl" if settings.morph else "vertex.wgsl")
        self.module = Module(path, layout, {"UNIT": self.wedgies.unit})

    def view(self) -> View:
        """State for one more view."""
        return View(self)
