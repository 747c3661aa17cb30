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
from orogen.lod.bdam.patches import Patches
from orogen.lod.bdam.settings import Settings
from orogen.lod.contract import AlgorithmView, Draw, Module, Statistics
from orogen.lod.contract import Patches as PatchesDraw
from orogen.streaming.clipmap import Clipmap, ClipmapView
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
        self._module = draws
        self._arguments = self._gpu.buffer("bdam draw", 16, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "bdam")
        self._list: Buffer | None = None
        self._clusters: Buffer | None = None
        self._group: tuple[Any, ...] = ()
        self._statistics = Statistics()

    def wants(self, frame: Frame) -> Sequence[NodeKey]:
        """Asks for patches, not for nodes."""
        self._pages.want(self._seen(frame).choose().wanted, self)
        return ()

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose resident patches, and list them for the GPU."""
        choice = self._seen(frame).choose(self._pages.resident)
        counts = np.array([self._patches.triangle_counts[code] for code in choice.codes], np.int64)
        parts = -(-counts // CLUSTER)
        clusters = np.empty((int(parts.sum()), 2), np.uint32)
        clusters[:, 0] = np.repeat(np.arange(counts.size), parts)
        clusters[:, 1] = CLUSTER * (np.arange(len(clusters)) - np.repeat(np.cumsum(parts) - parts, parts))
        self._list = self._written(self._list, "bdam patches", self._described(choice))
        self._clusters = self._written(self._clusters, "bdam clusters", clusters)
        self._gpu.write(self._arguments, np.array([3 * CLUSTER, len(clusters), 0, 0], np.uint32))
        self._statistics = Statistics(triangles=CLUSTER * len(clusters), patches=counts.size, draws=1)
        return [PatchesDraw(self._module, self._bound(), self._arguments, "triangle-list")]

    def statistics(self) -> Statistics:
        """Triangles of all clusters, those that only fill them up included."""
        return self._statistics

    def _seen(self, frame: Frame) -> DiamondFrame:
        return DiamondFrame(self._patches, frame, self._settings.pixels)

    def _described(self, choice: Choice) -> NDArray[Any]:
        diamonds = self._patches.diamonds
        rows = np.zeros(len(choice.codes), _PATCH)
        start = 0
        for level, cx, cy, side in choice.drawn:
            some = rows[start : start + cx.size]
            start += cx.size
            # from the first sample's centre, half a texel from the corner
            some["corner"] = diamonds.corners(level, cx, cy, side).min(axis=1) + (1 << diamonds.bits - 1)
            some["unit"] = diamonds.unit(level)
            some["id"] = ((level - diamonds.lowest) << 26 ^ cy << 14 ^ cx << 1 ^ side) & 0xFFFFFFFF
            some["level"], some["tile_level"] = max(0, level // 2), level - diamonds.lowest
        slots = [self._pages.resident[code] for code in choice.codes]
        rows["page"] = np.array(slots, np.int64) * (self._pages.page_bytes // 4)
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
