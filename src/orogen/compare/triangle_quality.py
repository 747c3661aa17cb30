"""How well shaped the triangles of a frame are: degenerate ones, slivers, and all by their smallest angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.lod.contract import Draw, Patches
from orogen.raster.rasterizer import FOLDER as RASTER
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

SHADER = Path(__file__).with_suffix(".wgsl")

BIN = 5
"""Degrees that are counted together."""
BINS = 60 // BIN
"""The smallest angle of a triangle is at most 60 degrees."""
SLIVER = 10
"""Degrees below which a triangle is a sliver: it is at least 1 / sin(10), 5.8 times, as long as it is high. Level
grids have 45 degrees, and still 35 where a slope of 1 : 1 stretches them: steepness alone hardly makes any."""

_KINDS = {"mesh": 0, "triangle-list": 1, "triangle-strip": 2}
"""In the order of triangle_quality.wgsl."""
_ROW = 1024
_GROUP = 64


@dataclass(frozen=True)
class TriangleQuality:
    """The triangles of a frame."""

    degenerate: int
    """Without area in space: two corners in the same place, or all three on a line."""
    angles: tuple[int, ...]
    """The others, by their smallest angle in steps of BIN degrees."""
    mean_angle: float
    """Mean of their smallest angles in degrees; NaN where there are none."""

    @property
    def triangles(self) -> int:
        """All of them."""
        return self.degenerate + sum(self.angles)

    @property
    def slivers(self) -> int:
        """With a smallest angle below SLIVER degrees, but some area."""
        return sum(self.angles[: SLIVER // BIN])

    def record(self) -> dict[str, Any]:
        """For the record of a frame: shares (0 to 1) of all triangles, counts by angle; None without triangles."""
        total = self.triangles
        if not total:
            return {"shapes": None, "angles": None}
        shapes = {
            "degenerate": self.degenerate,
            "slivers": self.slivers,
            "degenerate_share": self.degenerate / total,
            "sliver_share": self.slivers / total,
            "smallest_angle": None if math.isnan(self.mean_angle) else self.mean_angle,
        }
        return {"shapes": shapes, "angles": {f"{BIN * n:02d}": count for n, count in enumerate(self.angles)}}


class TriangleMeter:
    """Measures draws by evaluating their vertex functions once more, in a compute pass."""

    def __init__(self, clipmap: Clipmap) -> None:
        self._clipmap = clipmap
        gpu = clipmap.gpu
        read, storage = ("COMPUTE", "read"), ("COMPUTE", "storage")
        self._layout = gpu.layout("triangle quality", {0: read, 1: read, 2: storage})
        self._no_layout = gpu.layout("nothing", {})
        self._no_group = gpu.bind("nothing", self._no_layout, {})
        self._no_list = gpu.buffer("no list", 4, "STORAGE", "compare")
        self._totals = gpu.buffer("triangle quality", 4 * (3 + BINS), "STORAGE|COPY_DST|COPY_SRC", "compare")
        self._pipelines: dict[tuple[Any, ...], Any] = {}

    def measure(self, draws: Sequence[Draw], view: ClipmapView) -> TriangleQuality:
        """The triangles of a frame's draws, which must not have been followed by another frame; waits for the GPU."""
        gpu = self._clipmap.gpu
        patches = [draw for draw in draws if isinstance(draw, Patches)]
        batches: dict[tuple[Any, ...], list[int]] = {}
        for number, draw in enumerate(patches):
            key = (draw.module, id(draw.group), id(draw.index), draw.topology)
            batches.setdefault(key, []).append(number)
        rows = self._rows(patches)
        encoder = gpu.encoder("triangle quality")
        encoder.clear_buffer(self._totals.raw)
        for numbers in batches.values():
            if (table := rows[numbers])[:, 0].any():
                self._count(encoder, patches[numbers[0]], table, view)
        counted = gpu.read_buffer(self._totals, dtype=np.uint32, encoder=encoder)
        gpu.submit(encoder)
        degenerate, low, high, *angles = counted.result().tolist()
        total = sum(angles)
        mean = (low + (high << 32)) / 1000 / total if total else math.nan
        return TriangleQuality(degenerate, tuple(angles), mean)

    def _rows(self, patches: Sequence[Patches]) -> NDArray[np.int64]:
        """(draws, 4): triangles, first index or vertex, number added to indices, triangles of an instance."""
        gpu = self._clipmap.gpu
        encoder = gpu.encoder("arguments")
        readbacks = [
            gpu.read_buffer(draw.indirect, draw.offset, 20 if draw.index else 16, np.uint32, encoder=encoder)
            for draw in patches
        ]
        gpu.submit(encoder)
        rows = np.zeros((len(patches), 4), np.int64)
        for row, draw, readback in zip(rows, patches, readbacks, strict=True):
            count, instances, first, base_vertex, *_ = readback.result().tolist()
            each = max(count, 2) - 2 if _kind(draw) == "triangle-strip" else count // 3
            row[:] = each * instances, first, base_vertex if draw.index else 0, each
        return rows

    def _count(self, encoder: Any, draw: Patches, rows: NDArray[np.int64], view: ClipmapView) -> None:
        """Record the work for draws that differ from `draw` only in their arguments."""
        gpu = self._clipmap.gpu
        rows = rows[rows[:, 0] > 0]
        rows[:, 0] = np.cumsum(rows[:, 0])
        table = gpu.buffer("draws", rows.astype(np.uint32), "STORAGE", "compare")
        indices = draw.index.indices if draw.index else self._no_list
        groups = -(-int(rows[-1, 0]) // _GROUP)
        run = encoder.begin_compute_pass(label="triangle quality")
        run.set_pipeline(self._pipeline(draw))
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, draw.group or self._no_group)
        run.set_bind_group(2, gpu.bind("triangle quality", self._layout, {0: table, 1: indices, 2: self._totals}))
        run.dispatch_workgroups(_ROW, -(-groups // _ROW))
        run.end()

    def _pipeline(self, draw: Patches) -> Any:
        module, gpu, kind = draw.module, self._clipmap.gpu, _kind(draw)
        key = (module.path, tuple(module.constants.items()), kind)
        if key not in self._pipelines:
            constants = {"QUALITY_KIND": _KINDS[kind], "QUALITY_BIN": float(BIN), "QUALITY_BINS": BINS}
            shader = gpu.shader(
                f"{module.path.parent.name} triangle quality",
                module.path,
                SHADER,
                search=[RASTER, *SEARCH],
                constants={**self._clipmap.constants, **module.constants, **constants},
            )
            layouts = [self._clipmap.layout, module.layout or self._no_layout, self._layout]
            self._pipelines[key] = gpu.compute("triangle quality", shader, "measure_triangles", layouts)
        return self._pipelines[key]


def _kind(draw: Patches) -> str:
    return "mesh" if draw.index else draw.topology
