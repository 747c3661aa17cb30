"""Generic adaptive mesh refinement (GAMeR); see README.md in this folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import FrameTimer
from orogen.grid import Grid
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.gamer.patterns import WAYS, Bits, index_lists
from orogen.lod.mesh import Mesh
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.values import expected_name

FOLDER = Path(__file__).parent

TAGS = ("distance", "curvature", "error")
"""What depth tags may come from, in the order of tags.wgsl."""

_ARGUMENTS = 20
"""Bytes of the arguments of an indexed draw."""
_GROUP = 128
"""Triangles of a workgroup that chooses patterns or places triangles."""
_BLOCK = np.dtype(
    [("cells", "u4", 2), ("side", "u4"), ("groups", "u4"), ("width", "f4"), ("pixels", "f4"), ("padding", "f4", 2)]
)


@dataclass(frozen=True)
class Settings:
    """The coarse mesh, its refinement, and the pool of patterns."""

    coarse: int = 128
    """Cells of the coarse mesh along the data's longer side at most, 1 to 1024; each is two triangles. They are a power
    of two of samples wide, and no narrower than a sample."""
    max_depth: int = 6
    """How often a coarse triangle's edges may be halved, 1 to 7."""
    tag: str = "distance"
    """What depths come from: distance, curvature (the distance and how much the ground bends) or error (the distance
    and how far the ground lies off coarser edges)."""
    pixels: float = 3.0
    """Above 0: the greatest width of a quad of two triangles, seen face on, in pixels, where tags come from the
    distance; the greatest error in pixels otherwise."""
    patterns: str = "graded"
    """How patterns are filled between their edges: graded (evenly shaped triangles, more of them) or uniform (as the
    coarsest edge, fewer and more oblique triangles)."""

    def __post_init__(self) -> None:
        if not 1 <= self.coarse <= 1024:
            raise SettingsError(f"coarse: expected 1 to 1024 cells, got {self.coarse}")
        if not 1 <= self.max_depth <= 7:
            raise SettingsError(f"max_depth: expected 1 to 7, got {self.max_depth}")
        if self.tag not in TAGS:
            raise expected_name("tag", self.tag, TAGS)
        if not self.pixels > 0:
            raise SettingsError(f"pixels: expected a number above 0, got {self.pixels}")
        if self.patterns not in WAYS:
            raise expected_name("patterns", self.patterns, WAYS)


class View(AlgorithmView):
    """Tags of one view, and its coarse triangles sorted by pattern."""

    def __init__(self, algorithm: Gamer) -> None:
        self._algorithm = algorithm
        gpu, patterns = algorithm.clipmap.gpu, len(algorithm.triangles)
        rows, columns = algorithm.cells
        self._vertex_count = (rows + 1) * (columns + 1)
        self._groups = -(-2 * rows * columns // _GROUP)

        def buffer(label: str, count: int, usage: str = "STORAGE") -> Any:
            return gpu.buffer(f"gamer {label}", 4 * count, usage, "gamer")

        vertices = buffer("vertices", 2 * self._vertex_count)
        choices = buffer("choices", _GROUP * self._groups)
        counts = buffer("counts", patterns * self._groups)
        starts = buffer("starts", patterns)
        instances = buffer("instances", 2 * rows * columns)
        self._draws = gpu.buffer("gamer draws", algorithm.arguments(), "STORAGE|INDIRECT|COPY_SRC", "gamer")
        block = algorithm.block(self._groups)
        self._tag_group = gpu.bind("gamer tags", algorithm.tag_layout, {0: block, 1: vertices})
        self._choose_group = gpu.bind(
            "gamer choices", algorithm.choose_layout, {0: block, 1: vertices, 2: choices, 3: counts}
        )
        self._bins_group = gpu.bind(
            "gamer bins", algorithm.bins_layout, {0: choices, 1: counts, 2: starts, 3: self._draws, 4: instances}
        )
        group = gpu.bind("gamer", algorithm.module.layout, {0: block, 1: starts, 2: instances})
        # which patterns occur only the GPU knows: those that do not are drawn no times
        self._patches = [
            Patches(algorithm.module, group, self._draws, "triangle-list", algorithm.mesh, _ARGUMENTS * number)
            for number in range(patterns)
        ]

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Tag the coarse vertices, choose a pattern for each coarse triangle, sort triangles by pattern."""
        algorithm = self._algorithm
        run = timer.compute_pass(encoder, "tags")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._tag_group)
        for pipeline in (algorithm.measure_heights, algorithm.tag_vertices):
            run.set_pipeline(pipeline)
            run.dispatch_workgroups(-(-self._vertex_count // 64))
        run.end()
        run = timer.compute_pass(encoder, "patterns")
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, self._choose_group)
        run.set_pipeline(algorithm.choose_patterns)
        run.dispatch_workgroups(self._groups)
        run.set_bind_group(0, self._bins_group)
        for pipeline, groups in (
            (algorithm.sum_groups, len(self._patches)),
            (algorithm.sum_patterns, 1),
            (algorithm.place_triangles, self._groups),
        ):
            run.set_pipeline(pipeline)
            run.dispatch_workgroups(groups)
        run.end()
        return self._patches

    def statistics(self) -> Statistics:
        """Coarse triangles as patches; a draw for each pattern, whether it occurs or not."""
        drawn = self._algorithm.clipmap.gpu.read_buffer(self._draws, dtype=np.uint32).result().reshape(-1, 5)
        instances = drawn[:, 1].astype(np.int64)
        return Statistics(int(instances @ self._algorithm.triangles), int(instances.sum()), len(self._patches))


class Gamer(Algorithm):
    """A coarse mesh whose triangles are replaced by patterns from a pool."""

    name = "gamer"
    Settings = Settings
    detail = Detail("pixels", 0.5, 64.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu, most = clipmap.gpu, settings.max_depth
        self.side = cell_side(clipmap.grid, settings.coarse)
        """Samples along a cell of the coarse mesh."""
        self.cells = cell_rows(clipmap.grid, self.side)
        """Rows and columns of cells."""
        lists = index_lists(most, settings.patterns)
        self.triangles = np.array([len(triangles) for triangles in lists])
        """Triangles of each pattern."""
        self.mesh = Mesh(gpu, lists, "gamer")
        uniform, read, storage = ("COMPUTE", "uniform"), ("COMPUTE", "read"), ("COMPUTE", "storage")
        self.tag_layout = gpu.layout("gamer tags", {0: uniform, 1: storage})
        self.choose_layout = gpu.layout("gamer choices", {0: uniform, 1: read, 2: storage, 3: storage})
        self.bins_layout = gpu.layout("gamer bins", {0: read, 1: storage, 2: storage, 3: storage, 4: storage})
        stages = "VERTEX|COMPUTE"
        self.module = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("gamer", {0: (stages, "uniform"), 1: (stages, "read"), 2: (stages, "read")}),
            {"MOST": most, **{bits.name: bits.value for bits in Bits}},
        )
        constants = {
            **clipmap.constants, "MOST": most, "PATTERNS": len(lists), "TAG": TAGS.index(settings.tag)
        }  # fmt: skip
        search = [FOLDER, *SEARCH]

        def pipeline(file: str, entry: str, *layouts: Any) -> Any:
            shader = gpu.shader(f"gamer {file}", FOLDER / f"{file}.wgsl", search=search, constants=constants)
            return gpu.compute(f"gamer {entry}", shader, entry, layouts)

        self.measure_heights = pipeline("tags", "measure_heights", clipmap.layout, self.tag_layout)
        self.tag_vertices = pipeline("tags", "tag_vertices", clipmap.layout, self.tag_layout)
        self.choose_patterns = pipeline("choose", "choose_patterns", clipmap.layout, self.choose_layout)
        self.sum_groups = pipeline("bins", "sum_groups", self.bins_layout)
        self.sum_patterns = pipeline("bins", "sum_patterns", self.bins_layout)
        self.place_triangles = pipeline("bins", "place_triangles", self.bins_layout)

    def view(self) -> View:
        """State for one more view."""
        return View(self)

    def block(self, groups: int) -> Any:
        """The uniform block of gamer.wgsl."""
        block = np.zeros((), _BLOCK)
        block["cells"], block["side"], block["groups"] = self.cells[::-1], self.side, groups
        # the longer side, where texels are not square
        block["width"] = self.side * np.linalg.norm(self.clipmap.grid.metres, axis=0).max()
        block["pixels"] = self.settings.pixels
        return self.clipmap.gpu.buffer("gamer", block, "UNIFORM", "gamer")

    def arguments(self) -> NDArray[np.uint32]:
        """(patterns, 5) arguments of indexed draws, of no instances yet."""
        return np.array([(part.index_count, 0, part.first_index, 0, 0) for part in self.mesh.parts], np.uint32)


def cell_side(grid: Grid, coarse: int) -> int:
    """Samples along a cell: the least power of two that gives no more than `coarse` of them along the longer side."""
    side = 1
    while max(cell_rows(grid, side)) > coarse:
        side *= 2
    return side


def cell_rows(grid: Grid, side: int) -> tuple[int, int]:
    """Rows and columns of cells over a grid, one at least."""
    return max(1, math.ceil((grid.height - 1) / side)), max(1, math.ceil((grid.width - 1) / side))
