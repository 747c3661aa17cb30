"""One view's draws of preprocessed chunks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer
from orogen.keys import NodeKey
from orogen.lod.chunked_lod.choose import Choice, ChunkFrame
from orogen.lod.chunked_lod.chunks import CLUSTER, SIDES, ChunkKey, ChunkMaker
from orogen.lod.chunked_lod.settings import Settings
from orogen.lod.contract import AlgorithmView, Draw, Module, Patches, Statistics
from orogen.lod.resident import Residents, number_of, rows_of
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.pages import PageStore

FOLDER = Path(__file__).parent

_CHUNK = np.dtype(
    [
        ("drops", "f4", 4),
        ("corner", "i4", 2),
        ("unit", "i4"),
        ("page", "u4"),
        ("morph", "f4"),
        ("id", "u4"),
        ("level", "u4"),
        ("tile_level", "u4"),
    ]
)


def module(clipmap: Clipmap) -> Module:
    """The vertex function of meshes."""
    stages = "VERTEX|COMPUTE"
    layout = clipmap.gpu.layout("chunked_lod meshes", dict.fromkeys(range(3), (stages, "read")))
    return Module(FOLDER / "vertex.wgsl", layout, {"NUMBER_BITS": 16 - SIDES})


class MeshView(AlgorithmView):
    """Chunks that were made beforehand, as clusters of triangles in a single draw."""

    def __init__(
        self, clipmap: Clipmap, settings: Settings, maker: ChunkMaker, pages: PageStore[ChunkKey], draws: Module
    ) -> None:
        self._gpu = clipmap.gpu
        self._settings = settings
        self._maker = maker
        self._pages = pages
        self._residents = Residents(pages, lambda key: int(number_of(*key)))
        self._parts = np.zeros(0, np.int64)
        self._module = draws
        self._arguments = self._gpu.buffer("chunked_lod draw", 16, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", "chunked_lod")
        self._chunks: Buffer | None = None
        self._clusters: Buffer | None = None
        self._group: tuple[Any, ...] = ()
        self._statistics = Statistics()

    def wants(self, frame: Frame) -> Sequence[NodeKey]:
        """Asks for chunks, not for nodes."""
        self._pages.want(self._seen(frame).wanted(), self)
        return ()

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose resident chunks, and list them for the GPU."""
        if self._residents.update():
            counts = [self._maker.triangle_counts[key] for key in self._residents.keys]
            self._parts = -(-np.array(counts, np.int64) // CLUSTER)
        choice = self._seen(frame).choose(self._residents, self._settings.morph_range)
        chunk, number = rows_of(self._parts[choice.places])
        clusters = np.stack([chunk, CLUSTER * number], axis=1).astype(np.uint32)
        self._chunks = self._written(self._chunks, "chunked_lod chunks", self._described(frame, choice))
        self._clusters = self._written(self._clusters, "chunked_lod clusters", clusters)
        self._gpu.write(self._arguments, np.array([3 * CLUSTER, len(clusters), 0, 0], np.uint32))
        self._statistics = Statistics(triangles=CLUSTER * len(clusters), patches=choice.places.size, draws=1)
        # skirts lean out a little
        return [Patches(self._module, self._bound(), self._arguments, "triangle-list")]

    def statistics(self) -> Statistics:
        """Chunks as patches; triangles of all clusters, those that only fill them up included."""
        return self._statistics

    def _seen(self, frame: Frame) -> ChunkFrame:
        # a quad is at least a subtexel wide
        return ChunkFrame(self._maker, frame, self._settings.tau, max(0, self._maker.k - frame.subtexel_bits))

    def _described(self, frame: Frame, choice: Choice) -> NDArray[Any]:
        level, x, y = choice.chunks
        rows = np.zeros(x.size, _CHUNK)
        bits, k = frame.subtexel_bits, self._maker.k
        rows["drops"], rows["morph"] = choice.drops, choice.morph
        # from the first sample's centre, half a texel from the corner
        rows["corner"] = (np.stack([x, y], axis=1) << (level + bits)[:, None]) + (1 << bits - 1)
        rows["unit"] = 1 << bits + np.minimum(level - k, 0)
        rows["page"] = self._residents.slots[choice.places] * (self._pages.page_bytes // 4)
        rows["id"] = (level << 26 ^ y << 13 ^ x) & 0xFFFFFFFF
        rows["level"], rows["tile_level"] = np.maximum(level - k, 0), level
        return rows

    def _written(self, buffer: Buffer | None, label: str, rows: NDArray[Any]) -> Buffer:
        """The buffer with these rows, a larger one where they do not fit."""
        if buffer is None or buffer.size < rows.nbytes:
            size = 1 << max(12, rows.nbytes.bit_length())
            buffer = self._gpu.buffer(label, size, "STORAGE|COPY_DST", "chunked_lod")
        if rows.size:
            self._gpu.write(buffer, rows)
        return buffer

    def _bound(self) -> Any:
        """Bind group 1, made anew where a buffer has grown."""
        buffers = self._chunks, self._clusters, self._pages.buffer
        if self._group[:-1] != buffers:
            group = self._gpu.bind("chunked_lod meshes", self._module.layout, dict(enumerate(buffers)))
            self._group = (*buffers, group)
        return self._group[-1]
