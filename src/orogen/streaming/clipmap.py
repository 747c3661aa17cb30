"""The chunked clipmap (Kuehnert 2022, section 4.5): node atlases shared by all views, a clipped quadtree per view."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import orogen
from orogen.frame import Frame, subtexel_bits
from orogen.gpu import Buffer, Gpu, Texture
from orogen.grid import Grid
from orogen.keys import NODE_SIZE as CHUNK
from orogen.keys import NodeKey, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.streaming import blocks
from orogen.streaming.atlas import CEILING_BLOCK
from orogen.streaming.ceilings import Ceilings
from orogen.streaming.faults import Faults
from orogen.streaming.layer import Layer
from orogen.streaming.requests import LayerGrid, wanted
from orogen.streaming.retry import Failures
from orogen.streaming.settings import COLOR_BORDER, HEIGHT_BORDER, MAX_ANISOTROPY, ClipmapSettings
from orogen.streaming.software import SHARED, TABLE_WIDTH, SampledTables, is_software
from orogen.streaming.tiles import BLOCK

SEARCH = (Path(orogen.__file__).parent, Path(__file__).parent)
"""Folders of the WGSL that reads a frame and the clipmap."""

_STAGES = "VERTEX|FRAGMENT|COMPUTE"
_NO_SLOT = 0xFFFF
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


class Clipmap:
    """The resident terrain, shared by all views of it."""

    def __init__(
        self,
        gpu: Gpu,
        heights: Pyramid,
        colors: Pyramid | None = None,
        settings: ClipmapSettings | None = None,
        faults: Faults | None = None,
    ) -> None:
        """`colors`: an image over the same terrain, in its CRS. `faults`: where failures are noted.

        Raises BudgetError where the memory is too little.
        """
        self.gpu = gpu
        self.faults = faults or Faults()
        """What could not be read, made or uploaded."""
        self.settings = settings or ClipmapSettings()
        s = self.settings
        self.layers: list[Layer] = []
        pyramids = [heights] if colors is None else [heights, colors]
        try:
            for pyramid in pyramids:
                share = s.memory // len(pyramids), s.host_memory // len(pyramids)
                self.layers.append(Layer(gpu, pyramid, s, *share, self.faults))
            self.slot_buffer = gpu.buffer("slots", self.layers[0].slots.nbytes, "STORAGE|COPY_DST", "clipmap")
            # stands for the attachments that this terrain does not have
            self._nothing = gpu.texture("no attachment", (1, 1), "r8unorm", "TEXTURE_BINDING", "clipmap")
        except BaseException:
            for layer in self.layers:
                layer.close()
            raise
        self.heights = self.layers[0]
        self.colors = self.layers[1] if colors is not None else None
        self.constants = {
            "NODE_BITS": s.node_bits, "HEIGHT_BORDER": HEIGHT_BORDER, "COLOR_BORDER": COLOR_BORDER,
            "MAX_ANISOTROPY": MAX_ANISOTROPY, "COVERED": self.heights.covered, "ANY_HIT": False, "WITH_LEVELS": True,
            "CEILING_BLOCK": CEILING_BLOCK, "SOFTWARE": is_software(gpu), "TABLE_WIDTH": TABLE_WIDTH,
            **SHARED, **self.heights.format.constants,
        }  # fmt: skip
        """Constants of clipmap.wgsl."""
        self._views: list[ClipmapView] = []
        array = "texture {} 2d-array"
        self.layout = gpu.layout(
            "clipmap",
            {
                0: (_STAGES, "uniform"),
                1: (_STAGES, "uniform"),
                2: (_STAGES, "read"),
                3: (_STAGES, "read"),
                4: (_STAGES, "read"),
                5: (_STAGES, self.heights.format.binding),
                6: (_STAGES, array.format("float")),
                7: (_STAGES, array.format("unfilterable")),
                8: (_STAGES, array.format("float")),
                9: (_STAGES, "sampler filtering"),
                10: (_STAGES, "sampler non-filtering"),
                11: (_STAGES, array.format("unfilterable")),
                12: (_STAGES, array.format("unfilterable")),
            },
        )
        """Layout of bind group 0, which every shader that includes frame.wgsl or clipmap.wgsl uses."""
        self.sampler = gpu.sampler("colour", mag_filter="linear", min_filter="linear", mipmap_filter="linear")
        self.texel_sampler = gpu.sampler("texels")
        self._slots_version = -1
        self._unreadable: Failures[tuple[int, ...]] = Failures()

    @cached_property
    def ceilings(self) -> Ceilings:
        """What spares rays towards the sun their way over nodes."""
        return Ceilings(self.gpu, self.heights, self.settings.node_bits)

    @property
    def grid(self) -> Grid:
        """Grid of the heights."""
        return self.heights.pyramid.grid

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest valid height (m); until the pyramid is built an estimate that covers all nodes seen."""
        return self.heights.height_range

    def view(self) -> ClipmapView:
        """A new view of the terrain."""
        view = ClipmapView(self)
        self._views.append(view)
        return view

    def drop(self, view: ClipmapView) -> None:
        """Forget a view and give its memory back."""
        self._views.remove(view)
        view.close()

    def attachment(self, name: str) -> Any:
        """View of an attachment's texture array, of a single texel where the terrain has none such."""
        texture: Texture = self._nothing
        for layer in self.layers:
            texture = layer.atlas.textures.get(name, texture)
        return texture.view(dimension="2d-array")

    def pump(self) -> int:
        """Hand the views' wishes to the loaders, and upload what is loaded within the frame's budget.

        Returns the number of bytes uploaded.
        """
        for index, layer in enumerate(self.layers):
            wishes = [view.wishes[index] for view in self._views]
            layer.want(wishes[0] if len(wishes) == 1 else _merged(wishes))
        budget = self.settings.upload_budget
        done = 0
        for layer in self.layers:
            if done == 0 or done + layer.atlas.upload_bytes <= budget:
                done += layer.pump(budget - done)
        if self._slots_version != self.heights.version:
            self.gpu.write(self.slot_buffer, self.heights.slots)
            self._slots_version = self.heights.version
        return done

    @property
    def pending(self) -> int:
        """Wanted nodes that are still to come."""
        return sum(layer.pending for layer in self.layers)

    @property
    def retry_in(self) -> float | None:
        """Seconds until a node that failed is tried again; None where none has failed."""
        return min((wait for layer in self.layers if (wait := layer.retry_in) is not None), default=None)

    def settle(self) -> None:
        """Load until every wanted node that can be read and fits is resident; what fails is tried twice."""
        while True:
            uploaded = self.pump()
            if uploaded:
                # staging memory is given back when the GPU is done with it
                self.gpu.wait()
            elif not self.pending:
                return
            else:
                for layer in self.layers:
                    if layer.pending:
                        layer.wait(1.0)
                        break

    def height_under(self, x: float, y: float) -> float:
        """Height (m) of the terrain at CRS coordinates, or nearest to them; for choosing levels of detail.

        Interpolated, so that levels do not jump while a camera moves.
        """
        layer = self.heights
        column, row = self.grid.texel_of(x, y)
        for level in filter(layer.tiles.readable, range(layer.pyramid.level_count)):
            lasts = [count - 1 for count in level_shape(self.grid.shape, level)]
            places = [
                min(max(texel / 2.0**level - 0.5, 0.0), last) for texel, last in zip((row, column), lasts, strict=True)
            ]
            firsts = [min(math.floor(at), max(last - 1, 0)) for at, last in zip(places, lasts, strict=True)]
            rows, cols = (slice(first, min(first + 1, last) + 1) for first, last in zip(firsts, lasts, strict=True))
            chunk = (level, *(first // CHUNK for first in firsts))
            if self._unreadable.resting(chunk):
                continue
            try:
                heights = layer.tiles.window(level, rows, cols)
            except Exception as error:
                # the loader reports what cannot be read; here a coarser level will do
                self._unreadable.add(chunk, error)
                continue
            self._unreadable.remove(chunk)
            down, right = (at - first for at, first in zip(places, firsts, strict=True))
            total = weights = 0.0
            for values, vertical in zip(heights.tolist(), (1 - down, down), strict=False):
                for value, horizontal in zip(values, (1 - right, right), strict=False):
                    if math.isfinite(value):
                        total += vertical * horizontal * value
                        weights += vertical * horizontal
            if weights > 0:
                return total / weights
        return sum(self.height_range) / 2

    def close(self) -> None:
        """Stop loading and give the memory back."""
        for layer in self.layers:
            layer.close()
        for view in list(self._views):
            self.drop(view)
        if "ceilings" in vars(self):
            self.ceilings.destroy()
        self.slot_buffer.destroy()
        self._nothing.destroy()


def _merged(wishes: list[list[NodeKey]]) -> list[NodeKey]:
    """One list of several views' wishes: coarse first, the views in turn."""
    ranked: dict[NodeKey, tuple[int, int]] = {}
    for keys in wishes:
        rank: dict[int, int] = {}
        for key in keys:
            rank[key.level] = rank.get(key.level, 0) + 1
            order = (-key.level, rank[key.level])
            ranked[key] = min(order, ranked.get(key, order))
    return sorted(ranked, key=lambda key: (ranked[key], key))


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
        centres = [_lod_texel(frame, layer.grid.grid) for layer in layers]
        halves = [_half_nodes(layer.grid, at) for layer, at in zip(layers, centres, strict=True)]
        if halves != self._halves:
            rows = zip(layers, self._bits, centres, strict=True)
            self._origins = [_origins(layer.grid, bits, at) for layer, bits, at in rows]
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
            narrow &= slot != _NO_SLOT
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
        column, row = _lod_texel(frame, grid.grid)
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
            self._size_tables([_table_bits(layer.grid, load) for layer in self.clipmap.layers])
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


def build_tables(
    layer: Layer, bits: int, origins: list[tuple[int, int]]
) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """The clipped quadtree of a layer: per level 2^bits x 2^bits entries by wrapped node row and column.

    First `slot | level << 16` of the best current node that covers the entry, then, for heights, the lowest and highest
    height (m) drawn there.
    """
    side, mask = 1 << bits, (1 << bits) - 1
    count = layer.grid.level_count
    nothing = _NO_SLOT | (count - 1) << 16
    table = np.empty((count, side, side), np.uint32)
    bounds = np.zeros((count if layer.is_height else 0, side, side, 2), np.float32)
    by_level: dict[int, list[tuple[int, int, int]]] = {}
    for key, slot in layer.current.items():
        by_level.setdefault(key.level, []).append((key.y, key.x, slot))
    above = np.full((side, side), nothing, np.uint32)
    for level in range(count - 1, -1, -1):
        y0, x0 = origins[level]
        rows, cols = y0 + np.arange(side), x0 + np.arange(side)
        entries = above
        if level + 1 < count:
            # a window lies within that of the next coarser level; entries past the data may be anything
            up_y, up_x = origins[level + 1]
            entries = above[np.clip((rows >> 1) - up_y, 0, mask)[:, None], np.clip((cols >> 1) - up_x, 0, mask)]
        if level in by_level:
            y, x, slots = np.array(by_level[level]).T
            inside = (y >= y0) & (y < y0 + side) & (x >= x0) & (x < x0 + side)
            entries[y[inside] - y0, x[inside] - x0] = slots[inside] | level << 16
        wrapped = np.ix_(rows & mask, cols & mask)
        table[level][wrapped] = entries
        if layer.is_height:
            low, high = layer.bounds(level, *np.meshgrid(rows, cols, indexing="ij"))
            # what is drawn comes from resident texels, whose fill and border may leave the range of the samples below
            drawn = layer.slots[np.minimum(entries & 0xFFFF, len(layer.slots) - 1)]
            bounds[level][wrapped] = np.stack(
                [np.minimum(low, drawn[..., 0]), np.maximum(high, drawn[..., 1])], axis=-1
            )
        above = entries
    return table, bounds


def _table_bits(layer: LayerGrid, load_distance: float) -> int:
    """Logarithm of the window's side: node_count >= 2 load_distance + 1, and room for whole groups of four."""
    return math.ceil(math.log2(min(max(layer.nodes(0)), 2 * load_distance * layer.stretch + 8)))


def _half_nodes(layer: LayerGrid, centre: Sequence[float]) -> tuple[int, int]:
    """Half nodes of level 0 before a place in texels (column, row): all that windows around it depend on."""
    x, y = (math.floor(min(max(at, -1e15), 1e15) * 2 / layer.node_size) for at in centre)
    return x, y


def _origins(layer: LayerGrid, bits: int, centre: Sequence[float]) -> list[tuple[int, int]]:
    """First node (row, column) of each level's window around a centre in texels (column, row), kept over the data."""
    side = 1 << bits
    origins = []
    x, y = _half_nodes(layer, centre)
    for level in range(layer.level_count):
        rows, cols = layer.nodes(level)
        # to the nearest whole node, in half nodes of level 0
        nearest_row, nearest_col = (y + (1 << level)) >> level + 1, (x + (1 << level)) >> level + 1
        first_row, first_col = nearest_row - side // 2, nearest_col - side // 2
        origins.append((max(0, min(first_row, rows - side)), max(0, min(first_col, cols - side))))
    return origins


def _lod_texel(frame: Frame, grid: Grid) -> tuple[float, float]:
    """Where distances for the level of detail start, in texels (column, row) of a grid."""
    x, y = frame.eye_texel if grid is frame.grid else grid.texel_of(frame.camera.x, frame.camera.y)
    east, north, _ = frame.lod_place
    if (east, north) == (0.0, 0.0):
        return x, y
    (a, b), (c, d) = grid.texels.tolist()
    return x + a * east + b * north, y + c * east + d * north
