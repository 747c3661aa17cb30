"""HQTerrain; see README.md in this folder."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer
from orogen.keys import NodeKey
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.hqterrain.choose import Seams, TileFrame, seams, strip
from orogen.lod.hqterrain.ground import Ground
from orogen.lod.hqterrain.settings import Settings
from orogen.lod.hqterrain.tiles import FINEST, VERTEX, Shape, Tile, TileKey, TileMaker
from orogen.lod.quadtree import Ints, Leaves, PatchTree
from orogen.lod.resident import Residents, drawable, number_of, with_ancestors
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.pages import PageStore
from orogen.streaming.samples import Samples

FOLDER = Path(__file__).parent
CLUSTER = 64
"""Triangles that are drawn together."""
NUMBER_BITS = 13
"""Bits of a vertex number in a seam."""

_log = logging.getLogger("orogen")

_TILE = np.dtype(
    [
        ("morphs", "f4", 4),
        ("corner", "i4", 2),
        ("quad", "i4"),
        ("page", "u4"),
        ("id", "u4"),
        ("level", "u4"),
        ("tile_level", "u4"),
        ("side", "f4"),
        ("detail", "i4"),
        ("padding", "u4", 3),
    ]
)


class View(AlgorithmView):
    """One view's lists of triangles."""

    def __init__(self, algorithm: HqTerrain) -> None:
        self._algorithm = algorithm
        self._gpu = algorithm.clipmap.gpu
        usage = "INDIRECT|STORAGE|COPY_SRC|COPY_DST"
        self._arguments = self._gpu.buffer("hqterrain draws", 32, usage, "hqterrain")
        self._buffers: dict[str, Buffer] = {}
        self._group: tuple[Any, ...] = ()
        self._statistics = Statistics()
        self._between = lru_cache(maxsize=2048)(_between)
        self._residents = Residents(algorithm.store, lambda key: int(number_of(*key)))
        self._tiles: list[Tile] = []
        self._finest = np.zeros(0, np.int64)
        self._corners = np.zeros((0, 4))
        self._listed: Any = None

    def wants(self, frame: Frame) -> Sequence[NodeKey]:
        """Asks for tiles, not for nodes."""
        algorithm = self._algorithm
        wanted = with_ancestors(self._seen(frame).leaves(restricted=True), algorithm.maker.tree.level_count - 1)
        algorithm.store.want([TileKey(*key) for key in wanted], self)
        algorithm.maker.keep({*algorithm.store.wanted, *algorithm.store.resident})
        return ()

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Choose resident tiles, send what they lack, and list their triangles and those between them."""
        algorithm, seen = self._algorithm, self._seen(frame)
        if self._residents.update():
            self._tiles = [algorithm.maker.tiles[key] for key in self._residents.keys]
            self._finest = np.array([tile.finest for tile in self._tiles], np.int64)
            self._corners = np.array([tile.corners for tile in self._tiles]).reshape(-1, 4)
        chosen, places = drawable(seen.leaves(restricted=True), self._residents)
        nearest = seen.details(chosen)
        details = np.maximum(np.floor(nearest).astype(np.int64), self._finest[places])
        rows = self._described(frame, chosen, places)
        rows["morphs"] = seen.corner_morphs(chosen, self._corners[places], nearest, details)
        rows["detail"] = details
        self._write("tiles", rows)
        self._list(chosen, places, details)
        group = self._bound()
        return [
            Patches(module, group, self._arguments, "triangle-list", offset=16 * i)
            for i, module in enumerate(algorithm.modules)
        ]

    def _list(self, chosen: Leaves, places: Ints, details: Ints) -> None:
        """Write the lists of triangles, unless they are those of the frame before."""
        algorithm = self._algorithm
        # lists may be written anew for the sake of other views, too
        key = self._residents.version, algorithm.bytes_sent, places.tobytes(), details.tobytes()
        if key == self._listed:
            return
        meetings = seams(chosen)
        halved = np.zeros(places.size, np.int64)
        finer = chosen.level[meetings.beyond[meetings.starts[:-1]]] < chosen.level[meetings.tile]
        np.bitwise_or.at(halved, meetings.tile, finer.astype(np.int64) << meetings.side)
        meshes = [
            (self._tiles[place], Shape(*shape))
            for place, *shape in zip(places.tolist(), details.tolist(), halved.tolist(), strict=True)
        ]
        clusters = _clusters(np.array([algorithm.send(*mesh) for mesh in meshes], np.int64).reshape(-1, 2))
        numbers = self._seam_triangles(meetings, meshes)
        # to whole clusters; the rest has no area
        filled = np.zeros((-(-len(numbers) // CLUSTER) * CLUSTER, 3), np.uint32)
        filled[: len(numbers)] = numbers
        self._write("clusters", clusters)
        self._write("seams", filled)
        counts = np.array([[3 * CLUSTER, count, 0, 0] for count in (len(clusters), len(filled) // CLUSTER)], np.uint32)
        self._gpu.write(self._arguments, counts)
        self._statistics = Statistics(int(counts[:, 1].sum()) * CLUSTER, places.size, 2)
        self._listed = self._residents.version, algorithm.bytes_sent, *key[2:]

    def _seam_triangles(self, meetings: Seams, meshes: list[tuple[Tile, Shape]]) -> NDArray[np.int64]:
        """(m, 3) vertices of the triangles between tiles, with the numbers of these."""
        tiles, starts, beyond = meetings.tile.tolist(), meetings.starts.tolist(), meetings.beyond.tolist()
        parts = [
            self._between(meshes[tile], side, tuple(meshes[k] for k in beyond[first:last]))
            for tile, side, first, last in zip(tiles, meetings.side.tolist(), starts, starts[1:], strict=False)
        ]
        sizes = [len(part) for part in parts]
        numbers = np.concatenate([np.zeros((0, 3), np.int64), *parts])
        # every seam's own numbers of tiles start with the one, which those beyond follow
        listed = np.insert(meetings.beyond, meetings.starts[:-1], meetings.tile)
        own = np.repeat(meetings.starts[:-1] + np.arange(len(parts)), sizes)[:, None]
        return numbers & (1 << NUMBER_BITS) - 1 | listed[own + (numbers >> NUMBER_BITS)] << NUMBER_BITS

    def statistics(self) -> Statistics:
        """Tiles as patches; triangles between tiles, and those that fill up clusters, count."""
        return self._statistics

    def _seen(self, frame: Frame) -> TileFrame:
        return TileFrame(self._algorithm.maker, frame, self._algorithm.settings)

    def _described(self, frame: Frame, chosen: Leaves, places: Ints) -> NDArray[Any]:
        maker, pages = self._algorithm.maker, self._algorithm.store
        level, x, y = chosen
        rows = np.zeros(x.size, _TILE)
        bits, k = frame.subtexel_bits, maker.k
        # from the first sample's centre, half a texel from the corner
        rows["corner"] = (np.stack([x, y], axis=1) << (level + bits)[:, None]) + (1 << bits - 1)
        rows["quad"], rows["side"] = 1 << level + bits - k, maker.n
        rows["page"] = self._residents.slots[places] * (pages.page_bytes // 4)
        rows["id"] = (level << 26 ^ y << 13 ^ x) & 0xFFFFFFFF
        rows["level"], rows["tile_level"] = np.maximum(level - k, 0), level
        return rows

    def _write(self, name: str, rows: NDArray[Any]) -> None:
        """Write a buffer, a larger one where the rows do not fit."""
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < rows.nbytes:
            size = 1 << max(12, rows.nbytes.bit_length())
            buffer = self._gpu.buffer(f"hqterrain {name}", size, "STORAGE|COPY_DST", "hqterrain")
            self._buffers[name] = buffer
        if rows.size:
            self._gpu.write(buffer, rows)

    def _bound(self) -> Any:
        """Bind group 1, made anew where a buffer has grown."""
        buffers = (*(self._buffers[name] for name in ("tiles", "clusters")), self._algorithm.store.buffer)
        buffers = (*buffers, self._buffers["seams"])
        if self._group[:-1] != buffers:
            group = self._gpu.bind("hqterrain", self._algorithm.layout, dict(enumerate(buffers)))
            self._group = (*buffers, group)
        return self._group[-1]


class HqTerrain(Algorithm):
    """Tiles whose vertices are nested from level to level of detail, and sent as they are needed."""

    name = "hqterrain"
    Settings = Settings
    detail = Detail("tau", finest=0.25, coarsest=32.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        tree = PatchTree(clipmap.grid, 1)
        self.maker = TileMaker(Ground(Samples(clipmap.heights), tree), tree, settings.tile_size)
        self.pages = self.store = PageStore(
            clipmap.gpu, "hqterrain", self.maker.page_bytes, self.maker, memory=settings.memory, faults=clipmap.faults
        )
        self.bytes_sent = 0
        """Bytes of vertices and lists of triangles sent to the GPU so far, beside tiles' coarsest meshes."""
        self.layout = clipmap.gpu.layout("hqterrain", dict.fromkeys(range(4), ("VERTEX|COMPUTE", "read")))
        constants = {"CLUSTER": CLUSTER, "FINEST": FINEST}
        self.modules = [
            Module(FOLDER / "vertex.wgsl", self.layout, {**constants, "SEAMS": between}) for between in (False, True)
        ]

    def view(self) -> View:
        """State for one more view."""
        return View(self)

    def send(self, tile: Tile, shape: Shape) -> tuple[int, int]:
        """Send what the GPU lacks of a mesh of a tile; gives the first word and the number of its triangles.

        Vertices are added to those of coarser meshes; every mesh has a list of its own (Schneider and Westermann 2006).
        """
        gpu, pages, maker = self.clipmap.gpu, self.store, self.maker
        page = pages.resident[tile.key] * pages.page_bytes
        needed = int(tile.counts[shape.detail - FINEST])
        before = self.bytes_sent
        if needed > tile.sent:
            added = tile.vertices[tile.sent : needed]
            gpu.write(pages.buffer, added, page + VERTEX.itemsize * tile.sent)
            self.bytes_sent += added.nbytes
            tile.sent = needed
        if shape not in tile.lists:
            triangles = tile.triangles(shape).astype(np.uint16).ravel()
            words = -(-triangles.size // 2)
            if 4 * (tile.list_end + words) > maker.list_bytes:
                tile.lists.clear()
                tile.list_end = 0
            gpu.write(pages.buffer, triangles, page + maker.list_start + 4 * tile.list_end)
            self.bytes_sent += triangles.nbytes
            tile.lists[shape] = tile.list_end, triangles.size // 3
            tile.list_end += words
        if self.bytes_sent > before:
            _log.debug("hqterrain: %d bytes sent for %s, %s", self.bytes_sent - before, tile.key, shape)
        first, count = tile.lists[shape]
        return (page + maker.list_start) // 4 + first, count


def _clusters(places: NDArray[np.int64]) -> NDArray[np.uint32]:
    """(m, 3) tile, first word, triangles left, from (n, 2) first words and numbers of triangles of tiles."""
    parts = -(-places[:, 1] // CLUSTER)
    tile = np.repeat(np.arange(len(places)), parts)
    done = CLUSTER * (np.arange(tile.size) - np.repeat(np.cumsum(parts) - parts, parts))
    # a cluster is an even number of triangles: it starts with a word
    return np.stack([tile, places[tile, 0] + 3 * done // 2, places[tile, 1] - done], axis=1).astype(np.uint32)


def _between(one: tuple[Tile, Shape], side: int, others: tuple[tuple[Tile, Shape], ...]) -> NDArray[np.int64]:
    """(m, 3) vertices of the triangles between a tile's side and those of the tiles beyond, which it counts from 1."""
    vertices, places = one[0].border(side, one[1])
    parts = [tile.border(side ^ 1, shape) for tile, shape in others]
    beyond = np.concatenate([part | i << NUMBER_BITS for i, (part, _) in enumerate(parts, 1)])
    along = np.concatenate([part for _, part in parts])
    # where tiles beyond are out of the picture: no further than to the next vertex
    first, last = np.searchsorted(places, along[0], "right") - 1, np.searchsorted(places, along[-1], "left")
    near = slice(max(int(first), 0), int(last) + 1)
    return strip((vertices[near], places[near]), (beyond, along))
