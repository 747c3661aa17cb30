"""A view of the clipmap: its clipped quadtree, its uniform blocks and what it wants to be loaded."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame, subtexel_bits
from orogen.gpu import Buffer
from orogen.keys import NodeKey
from orogen.streaming import blocks
from orogen.streaming.requests import wanted
from orogen.streaming.software import SampledTables, is_software
from orogen.streaming.tables import NO_SLOT, build_tables, half_nodes, lod_texel, origins_around, table_bits
from orogen.streaming.tiles import BLOCK

if TYPE_CHECKING:
    from orogen.streaming.clipmap import Clipmap

_PATIENCE = 4
"""Frames of a moving camera for which the same nodes will do."""
_FRAME_ROOM = -(-blocks.FRAME.itemsize // 256) * 256
"""Bytes of the frame's block in its buffer, of which the clipmap's follows, where WebGPU lets one begin."""


class DrawnTables(NamedTuple):
    """What `ClipmapView.drawn_bounds` looks heights up in, for a compiled twin of it."""

    entries: NDArray[np.uint32]
    """(side, side) of level 0: slot | level << 16 of the node that is used, by wrapped row and column."""
    nodes: NDArray[np.float32]
    """(levels, side, side, 2) lowest and highest height (m) that may be drawn in nodes."""
    origins: NDArray[np.int64]
    """(levels, 2) column and row of each level's first node."""
    blocks: tuple[NDArray[np.float32], ...]
    """Per slot: ranges of blocks of 16 texels along a side, then of blocks twice as wide, and so on."""
    bits: int
    """A node is 2^bits texels wide."""
    eye: tuple[float, float]
    """Column and row of the sample that levels of data are chosen around."""
    spacing: tuple[float, float]
    """Metres from sample to sample in rows and in columns."""
    above: float
    """Metres of the LOD eye above or below the approximate ground."""
    reach: float
    """Metres around it in which level 0 is used."""


class ClipmapView:
    """A view's clipped quadtree: for every position the best resident node, by toroidal addressing."""

    def __init__(self, clipmap: Clipmap) -> None:
        """Use `Clipmap.view`."""
        self.clipmap = clipmap
        self.wishes: list[list[NodeKey]] = [[] for _ in clipmap.layers]
        """Nodes that the view wants, per layer, the most important first."""
        self._wanted = self.wishes
        self._asked: Any = None
        self._answered: Any = None
        self._late = 0
        gpu = clipmap.gpu
        # in one buffer, so that one write is enough
        self._uniforms = gpu.buffer("frame", _FRAME_ROOM + blocks.CLIPMAP.itemsize, "UNIFORM|COPY_DST", "clipmap")
        self._sized_for: Any = None
        self._view_distance = 0.0
        self._bits: list[int] = []
        self._starts: list[int] = []
        self._table: Buffer | None = None
        self._sampled: SampledTables | None = None
        self._bounds: Buffer | None = None
        self._entries = np.zeros((0, 1, 1), np.uint32)
        self._drawn_bounds = np.zeros((0, 1, 1, 2), np.float32)
        self._height_origins: list[tuple[int, int]] = []
        self._frame: Frame | None = None
        self._halves: list[tuple[int, int]] = []
        self._origins: list[list[tuple[int, int]]] = []
        self._written_tables: Any = None
        self._written_block: Any = None
        self._layer_blocks: tuple[Any, bytes] = None, b""
        self._sun_block = blocks.NO_SUN_BLOCK
        self.bind_group: Any = None
        """Bind group 0 of every shader that reads the frame and the clipmap."""

    def frame_for(self, frame: Frame) -> Frame:
        """The frame with what only the clipmap knows: the ground under the camera and the range of heights."""
        lod = frame.lod
        return replace(
            frame,
            ground_height=self.clipmap.height_under(lod.x, lod.y),
            height_range=self.clipmap.height_range,
        )

    @property
    def behind(self) -> bool:
        """Whether the nodes wanted are those of an earlier frame."""
        return self._asked != self._answered

    def want(self, frame: Frame, *, patient: bool = False) -> None:
        """Work out which nodes the frame wants; `Clipmap.pump` loads them.

        `patient`: only now and then while the camera moves, since that takes longer than to record a frame; `behind`
        tells. A frame that is asked for again is always answered.
        """
        asked = frame, [(layer.pyramid.built, layer.pyramid.exact) for layer in self.clipmap.layers]
        moves, self._asked = asked != self._asked, asked
        if asked != self._answered:
            self._late += 1
            if self._answered is None or not (patient and moves and self._late < _PATIENCE):
                self._wanted = self._nodes_for(frame)
                self._answered, self._late = asked, 0
        self.wishes = list(self._wanted)

    def _nodes_for(self, frame: Frame) -> list[list[NodeKey]]:
        settings = self.clipmap.settings
        load = min(settings.load_distance_for(frame.texel_size, frame.lod_fov), 1e15)
        low, high = self.clipmap.height_range

        def everywhere(_: int, rows: NDArray, __: NDArray) -> tuple[NDArray, NDArray]:
            return np.full(rows.shape, low), np.full(rows.shape, high)

        return [
            wanted(frame, layer.grid, layer.bounds if layer.is_height else everywhere, load, settings.behind)
            for layer in self.clipmap.layers
        ]

    def update(self, frame: Frame, sun: tuple[float, float, float] | None = None) -> None:
        """Write the frame's numbers and, where camera or residency changed, the quadtrees.

        `sun`: unit vector (east, north, up) towards the sun, where it is to cast shadows.
        """
        self._frame = frame
        self._sun_block = self.clipmap.ceilings.block(sun, frame) if sun else blocks.NO_SUN_BLOCK
        layers, gpu = self.clipmap.layers, self.clipmap.gpu
        self._size_for(frame)
        centres = [lod_texel(frame, layer.grid.grid) for layer in layers]
        halves = [half_nodes(layer.grid, at) for layer, at in zip(layers, centres, strict=True)]
        if halves != self._halves:
            rows = zip(layers, self._bits, centres, strict=True)
            self._origins = [origins_around(layer.grid, bits, at) for layer, bits, at in rows]
            self._halves = halves
        tables = (self._halves, [(layer.version, layer.pyramid.built) for layer in layers])
        if tables != self._written_tables:
            self._write_tables(self._origins)
            self._written_tables = tables
        data, block = blocks.frame_block(frame), self._block(frame)
        if block != self._written_block:
            gpu.write(self._uniforms, data.ljust(_FRAME_ROOM, b"\0") + block)
            self._written_block = block
        else:
            gpu.write(self._uniforms, data)

    def drawn_bounds(self, low: NDArray[np.integer], high: NDArray[np.integer]) -> NDArray[np.float32]:
        """Lowest and highest height (m) that may be drawn between samples, (n, 2), after `update`.

        `low`, `high`: (n, 2) columns and rows of the first and last level-0 sample of each of n rectangles. Narrow ones
        are looked up in the blocks of resident nodes; for wide ones this is the twin of `bounds_over` in clipmap.wgsl,
        at the level whose nodes are as wide as the wider side or the next wider.
        """
        result = self._node_ranges(low, high)
        narrow, ranges = self._block_ranges(low, high)
        result[narrow] = ranges[narrow]
        return result

    def _block_ranges(
        self, low: NDArray[np.integer], high: NDArray[np.integer]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Which rectangles are narrow enough for the blocks of the nodes that are used there, and their ranges."""
        layer = self.clipmap.heights
        bits = self.clipmap.settings.node_bits
        # coarser texels are means of samples around the rectangle: of the level used, or the next one
        pad = (2 << self._coarsest(low, high))[:, None]
        last = np.array([layer.grid.grid.width, layer.grid.grid.height]) - 1
        low, high = np.clip(low - pad, 0, last).astype(np.int64), np.clip(high + pad, 0, last).astype(np.int64)
        side = 1 << self._bits[0]
        origin = np.array(self._height_origins[0])[::-1]
        wide = (high - low).max(axis=1) + 1
        inside = ((low >> bits >= origin) & (high >> bits < origin + side)).all(axis=1)
        narrow = inside & (wide <= BLOCK << (len(layer.blocks) - 1))
        ranges = np.tile(np.array([np.inf, -np.inf], np.float32), (len(wide), 1))
        # blocks at least as wide as the rectangle: two by two of them are enough
        mips = np.ceil(np.log2(np.maximum(wide / BLOCK, 1))).astype(np.int64)
        for at in (low, np.stack([high[:, 0], low[:, 1]], 1), np.stack([low[:, 0], high[:, 1]], 1), high):
            node = (at >> bits) & (side - 1)
            entry = self._entries[0, node[:, 1], node[:, 0]].astype(np.int64)
            slot, level = entry & 0xFFFF, entry >> 16
            narrow &= slot != NO_SLOT
            for mip, table in enumerate(layer.blocks):
                chosen = np.flatnonzero(narrow & (mips == mip))
                # a node's own texels: of its level
                texel = (at[chosen] >> level[chosen, None]) & ((1 << bits) - 1)
                block = texel >> (BLOCK.bit_length() - 1 + mip)
                found = table[slot[chosen], block[:, 1], block[:, 0]]
                ranges[chosen, 0] = np.minimum(ranges[chosen, 0], found[:, 0])
                ranges[chosen, 1] = np.maximum(ranges[chosen, 1], found[:, 1])
        return narrow, ranges

    def _coarsest(self, low: NDArray[np.integer], high: NDArray[np.integer]) -> NDArray[np.int64]:
        """The coarsest level, at most, whose texels are used in rectangles of samples (equation 4.9)."""
        eye, spacing, above, reach = self._reach()
        away = np.maximum(np.abs(low - np.array(eye)), np.abs(high - np.array(eye))) @ np.array(spacing)
        level = np.floor(np.log2(np.maximum(2 * np.hypot(away, above) / reach, 1))).astype(np.int64)
        return np.minimum(level + 1, self.clipmap.heights.grid.level_count - 1) * (reach < 1e30)

    def _reach(self) -> tuple[tuple[float, float], tuple[float, float], float, float]:
        """The last four of `DrawnTables`."""
        frame, settings = self._frame, self.clipmap.settings
        assert frame is not None, "update the view first"
        grid = self.clipmap.heights.grid
        column, row = lod_texel(frame, grid.grid)
        across, down = np.linalg.norm(grid.grid.metres, axis=0).tolist()
        above = abs(float(frame.lod_eye()[2]) + frame.camera.z - frame.ground_height * frame.exaggeration)
        reach = settings.view_distance_for(frame.texel_size, frame.lod_fov) * grid.node_size * grid.grid.spacing
        return (column - 0.5, row - 0.5), (across, down), above, reach

    def drawn_tables(self) -> DrawnTables:
        """What `drawn_bounds` looks up, after `update`."""
        layer, bits = self.clipmap.heights, self.clipmap.settings.node_bits
        origins = np.array(self._height_origins, np.int64)[:, ::-1].copy()
        tables = self._entries[0], self._drawn_bounds, origins, tuple(layer.blocks), bits
        return DrawnTables(*tables, *self._reach())

    def _node_ranges(self, low: NDArray[np.integer], high: NDArray[np.integer]) -> NDArray[np.float32]:
        layer = self.clipmap.heights.grid
        last = np.array([layer.grid.width, layer.grid.height]) - 1
        low, high = np.clip(low, 0, last).astype(np.int64), np.clip(high, 0, last).astype(np.int64)
        side = 1 << self._bits[0]
        origins = np.array(self._height_origins)[:, ::-1]
        wide = np.maximum((high - low).max(axis=1), 1)
        level = np.ceil(np.log2(wide / layer.node_size)).clip(0, layer.level_count - 1).astype(np.int64)
        while True:
            first, stop = low // (layer.node_size << level)[:, None], high // (layer.node_size << level)[:, None]
            inside = ((first >= origins[level]) & (stop < origins[level] + side)).all(axis=1)
            beyond = ~inside & (level < layer.level_count - 1)
            if not beyond.any():
                break
            level = level + beyond
        result = np.tile(np.array([np.inf, -np.inf], np.float32), (len(level), 1))
        for step in ((0, 0), (1, 0), (0, 1), (1, 1)):
            node = np.minimum(first + step, stop) & (side - 1)
            found = self._drawn_bounds[level, node[:, 1], node[:, 0]]
            result = np.stack([np.minimum(result[:, 0], found[:, 0]), np.maximum(result[:, 1], found[:, 1])], axis=1)
        return result

    def close(self) -> None:
        """Use `Clipmap.drop`."""
        for buffer in (self._uniforms, self._table, self._bounds, self._sampled):
            if buffer is not None:
                buffer.destroy()

    def _size_for(self, frame: Frame) -> None:
        """Make tables of the size that pictures of this size and angle need."""
        sized_for = frame.texel_size, frame.lod_fov
        if sized_for != self._sized_for:
            settings, self._sized_for = self.clipmap.settings, None
            load = min(settings.load_distance_for(*sized_for), 1e6)
            self._size_tables([table_bits(layer.grid, load) for layer in self.clipmap.layers])
            self._view_distance = settings.view_distance_for(*sized_for)
            self._sized_for = sized_for

    def _size_tables(self, bits: list[int]) -> None:
        if bits == self._bits:
            return
        gpu, clipmap = self.clipmap.gpu, self.clipmap
        # what follows may find no memory: the next frame tries again
        self._bits, self._halves = [], []
        self._starts = [0]
        for layer, b in zip(clipmap.layers, bits, strict=True):
            self._starts.append(self._starts[-1] + (layer.grid.level_count << 2 * b))
        self._table = gpu.buffer("quadtree", 4 * self._starts[-1], "STORAGE|COPY_DST", "clipmap")
        self._bounds = gpu.buffer("quadtree bounds", 8 * self._starts[1], "STORAGE|COPY_DST", "clipmap")
        self._sampled = SampledTables(gpu, self._starts[-1]) if is_software(gpu) else None
        self._written_tables = self._written_block = None
        self.bind_group = gpu.bind(
            "clipmap",
            clipmap.layout,
            {
                0: (self._uniforms, 0, blocks.FRAME.itemsize),
                1: (self._uniforms, _FRAME_ROOM, blocks.CLIPMAP.itemsize),
                2: self._table,
                3: self._bounds,
                4: clipmap.slot_buffer,
                5: clipmap.attachment("height"),
                6: clipmap.attachment("coverage"),
                7: clipmap.attachment("maxima"),
                8: clipmap.attachment("color"),
                9: clipmap.sampler,
                10: clipmap.texel_sampler,
                11: clipmap.attachment("ceilings"),
                12: self._sampled.view if self._sampled else clipmap.attachment("sampled tables"),
            },
        )
        self._bits = bits

    def _write_tables(self, origins: list[list[tuple[int, int]]]) -> None:
        clipmap = self.clipmap
        assert self._table is not None
        assert self._bounds is not None
        for i, layer in enumerate(clipmap.layers):
            table, bounds = build_tables(layer, self._bits[i], origins[i])
            clipmap.gpu.write(self._table, table, 4 * self._starts[i])
            if self._sampled:
                # slots of colours have no range
                ranges = layer.slots[np.minimum(table & 0xFFFF, len(layer.slots) - 1)][..., :2]
                self._sampled.fill(self._starts[i], table, ranges)
            if layer.is_height:
                clipmap.gpu.write(self._bounds, bounds)
                self._entries, self._drawn_bounds, self._height_origins = table, bounds, origins[i]
        if self._sampled:
            self._sampled.write()

    def _block(self, frame: Frame) -> bytes:
        """The clipmap's uniform block."""
        clipmap = self.clipmap
        key = self._halves, self._bits, self._view_distance, [layer.present for layer in clipmap.layers]
        if key != self._layer_blocks[0]:
            self._layer_blocks = key, self._make_layer_blocks()
        mapping = None
        if clipmap.colors:
            grid = clipmap.colors.grid.grid
            mapping = blocks.color_mapping(frame, grid, subtexel_bits(grid))
        return self._layer_blocks[1] + blocks.color_block(mapping) + self._sun_block

    def _make_layer_blocks(self) -> bytes:
        result = np.zeros((), blocks.CLIPMAP["layers"])
        for i, layer in enumerate(self.clipmap.layers):
            row, grid = result[i], layer.grid.grid
            bits = subtexel_bits(grid)
            row["level_count"], row["table_bits"] = layer.grid.level_count, self._bits[i]
            row["table_start"], row["present"], row["covered"] = self._starts[i], layer.present, layer.covered
            row["reach"] = min(self._view_distance * layer.grid.node_size * grid.spacing, 1e30)
            row["blend_range"], row["subtexel_bits"] = self.clipmap.settings.blend_range, bits
            whole = (0, 0, grid.width << bits, grid.height << bits)
            row["extent"] = blocks.extent(grid, bits) if layer.is_height else whole
            row["origins"][: layer.grid.level_count, :2] = np.array(self._origins[i])[:, ::-1]
        return result.tobytes()
