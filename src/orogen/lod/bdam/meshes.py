"""One view's draws of patches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer
from orogen.keys import NodeKey
from orogen.lod.bdam.choose import Choice, DiamondFrame
from orogen.lod.bdam.diamonds import Ints
from orogen.lod.bdam.patches import Patches
from orogen.lod.bdam.settings import Settings
from orogen.lod.contract import AlgorithmView, Draw, Module, Statistics
from orogen.lod.contract import Patches as PatchesDraw
from orogen.lod.resident import Residents, rows_of
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.pages import PageStore

FOLDER = Path(__file__).parent
CLUSTER = 32
"""Triangles that are drawn together."""

_PATCH = np.dtype(
    [
        ("corner", "i4", 2),
        ("unit", "i4"),
        ("page", "u4"),
        ("id", "u4"),
        ("level", "u4"),
        ("tile_level", "u4"),
        ("padding", "u4"),
    ]
)


def module(clipmap: Clipmap) -> Module:
    """The vertex function."""
    layout = clipmap.gpu.layout("bdam", dict.fromkeys(range(3), ("VERTEX|COMPUTE", "read")))
    return Module(FOLDER / "vertex.wgsl", layout)


class View(AlgorithmView):
    """Patches as clusters of triangles in a single draw."""

    def __init__(
        self, clipmap: Clipmap, settings: Settings, patches: Patches, pages: PageStore[int], draws: Module
    ) -> None:
        self._gpu = clipmap.gpu
        self._settings = settings
        self._patches = patches
        self._pages = pages
        self._residents = Residents(pages, int)
        self._parts = np.zeros(0, np.int64)
        self._module = draws
        self._arguments = self._gpu.buffer("bdam draw", 16, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "bdam")
        self._list: Buffer | None = None
        self._clusters: Buffer | None = None
        self._group: tuple[Any, ...] = ()
        self._statistics = Statistics()

    def wants(self, frame: Frame) -> Sequence[NodeKey]:
        """Asks for patches, not for nodes."""
        self._pages.want(self._seen(frame).choose().wanted.tolist(), self)
        return ()

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose resident patches, and list them for the GPU."""
        if self._residents.update():
            counts = [self._patches.triangle_counts[code] for code in self._residents.keys]
            self._parts = -(-np.array(counts, np.int64) // CLUSTER)
        choice = self._seen(frame).choose(self._residents.numbers)
        places = self._residents.places(choice.codes)
        patch, number = rows_of(self._parts[places])
        clusters = np.stack([patch, CLUSTER * number], axis=1).astype(np.uint32)
        self._list = self._written(self._list, "bdam patches", self._described(choice, self._residents.slots[places]))
        self._clusters = self._written(self._clusters, "bdam clusters", clusters)
        self._gpu.write(self._arguments, np.array([3 * CLUSTER, len(clusters), 0, 0], np.uint32))
        self._statistics = Statistics(triangles=CLUSTER * len(clusters), patches=places.size, draws=1)
        return [PatchesDraw(self._module, self._bound(), self._arguments, "triangle-list")]

    def statistics(self) -> Statistics:
        """Triangles of all clusters, those that only fill them up included."""
        return self._statistics

    def _seen(self, frame: Frame) -> DiamondFrame:
        return DiamondFrame(self._patches, frame, self._settings.pixels)

    def _described(self, choice: Choice, slots: Ints) -> NDArray[Any]:
        diamonds = self._patches.diamonds
        level, cx, cy, side = choice[:4]
        rows = np.zeros(level.size, _PATCH)
        # level by level: the rule for corners differs between odd and even ones
        ends = np.searchsorted(-level, -np.unique(level)[::-1], "right").tolist()
        for start, end in zip([0, *ends], ends, strict=False):
            some, one, at = rows[start:end], int(level[start]), slice(start, end)
            # from the first sample's centre, half a texel from the corner
            corners = diamonds.corners(one, cx[at], cy[at], side[at])
            some["corner"] = corners.min(axis=1) + (1 << diamonds.bits - 1)
            some["unit"], some["level"] = diamonds.unit(one), max(0, one // 2)
        rows["tile_level"] = level - diamonds.lowest
        rows["id"] = ((level - diamonds.lowest) << 26 ^ cy << 14 ^ cx << 1 ^ side) & 0xFFFFFFFF
        rows["page"] = slots * (self._pages.page_bytes // 4)
        return rows

    def _written(self, buffer: Buffer | None, label: str, rows: NDArray[Any]) -> Buffer:
        """The buffer with these rows, a larger one where they do not fit."""
        if buffer is None or buffer.size < rows.nbytes:
            size = 1 << max(12, rows.nbytes.bit_length())
            buffer = self._gpu.buffer(label, size, "STORAGE|COPY_DST", "bdam")
        if rows.size:
            self._gpu.write(buffer, rows)
        return buffer

    def _bound(self) -> Any:
        """Bind group 1, made anew where a buffer has grown."""
        buffers = self._list, self._clusters, self._pages.buffer
        if self._group[:-1] != buffers:
            group = self._gpu.bind("bdam", self._module.layout, dict(enumerate(buffers)))
            self._group = (*buffers, group)
        return self._group[-1]
