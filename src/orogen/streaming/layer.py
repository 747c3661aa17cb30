"""One layer of the clipmap: a pyramid, its loader and its atlas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from orogen.errors import DeviceLostError, GpuError
from orogen.gpu import Gpu
from orogen.keys import NodeKey
from orogen.pyramid.contract import Pyramid
from orogen.streaming.atlas import MaximaBuilder, NodeAtlas, color_attachments, height_attachments
from orogen.streaming.bc7 import FEATURE
from orogen.streaming.faults import Faults
from orogen.streaming.heightformat import FLOATS, height_format
from orogen.streaming.loader import Loader
from orogen.streaming.ranges import NodeRanges
from orogen.streaming.requests import LayerGrid
from orogen.streaming.settings import ClipmapSettings
from orogen.streaming.tiles import (
    BLOCK,
    ColorNode,
    DecodedTiles,
    EstimatedTiles,
    HeightNode,
    Tiles,
    color_node,
    height_node,
)

_AHEAD = 64
"""Loaded nodes, at most, that wait to be uploaded."""
BLOCK_MIPS = 4
"""Sizes of blocks whose ranges are kept: 16 to 128 texels."""


class Layer:
    """Resident nodes of one pyramid."""

    def __init__(
        self,
        gpu: Gpu,
        pyramid: Pyramid,
        settings: ClipmapSettings,
        memory: int,
        host_memory: int,
        faults: Faults | None = None,
    ) -> None:
        """`memory`, `host_memory`: this layer's share in bytes. `faults`: where failures are noted.

        Raises BudgetError where the memory is too little.
        """
        self.pyramid = pyramid
        self.grid = LayerGrid(pyramid.grid, pyramid.level_count, settings.node_size)
        self.is_height = pyramid.kind == "height"
        self.covered = pyramid.covered
        """Whether every texel is valid, so that no coverage is kept."""
        self.format = height_format(pyramid, settings.height_bits) if self.is_height else FLOATS
        """How heights are stored in the atlas."""
        attachments = (
            height_attachments(settings.node_size, self.covered, self.format)
            if self.is_height
            else color_attachments(settings.node_size, settings.color_compression == "auto" and FEATURE in gpu.features)
        )
        self.atlas = NodeAtlas(gpu, pyramid.kind, attachments, self.grid.node_count, memory, pyramid.level_count + 1)
        self.maxima = MaximaBuilder(gpu, self.atlas, settings.node_bits, self.format) if self.is_height else None
        self.slots = np.zeros((self.atlas.capacity, 4), np.float32)
        """Per slot: lowest and highest texel, bound on the error (m), level."""
        side = settings.node_size // BLOCK if self.is_height else 0
        self.blocks = [np.zeros((self.atlas.capacity, side >> k, side >> k, 2), np.float32) for k in range(BLOCK_MIPS)]
        """Per slot: lowest and highest height of blocks of texels, then of 2 x 2 of these, and so on."""
        self.version = 0
        """Counts changes of `current` and of what is in its slots."""
        self.refilled: set[int] = set()
        """Slots of heights that were filled since `Ceilings` last took them out."""
        self._estimates: set[NodeKey] = set()
        self._wanted: frozenset[NodeKey] = frozenset()
        self._seen = (np.inf, -np.inf)
        self._known_ranges: NodeRanges | None = None
        # a quarter for loaded nodes, the rest for the tiles that they are made of
        ahead = max(1, min(_AHEAD, host_memory // 4 // self.atlas.upload_bytes))
        self.tiles = DecodedTiles(pyramid, max(0, host_memory - ahead * self.atlas.upload_bytes))
        self._loader: Loader[NodeKey, tuple[HeightNode | ColorNode, bool]] = Loader(
            self._load,
            threads=settings.threads,
            ahead=ahead,
            name=pyramid.source.name,
            faults=faults,
            stand_in=self._estimate,
        )

    def _load(self, key: NodeKey) -> tuple[HeightNode | ColorNode, bool]:
        exact = self.pyramid.available(key.level)
        return self._node(key, self.tiles), exact

    def _estimate(self, key: NodeKey) -> tuple[HeightNode | ColorNode, bool] | None:
        """What stands in for the coarsest node, which has no ancestor, while it cannot be read."""
        if key.level < self.pyramid.level_count - 1 or not self.pyramid.available(key.level):
            return None
        return self._node(key, EstimatedTiles(self.pyramid)), False

    def _node(self, key: NodeKey, tiles: Tiles) -> HeightNode | ColorNode:
        size = self.grid.node_size
        if self.is_height:
            return height_node(tiles, self.pyramid, key, size, self.covered, self.format)
        return color_node(tiles, self.pyramid, key, size)

    def want(self, keys: Sequence[NodeKey]) -> None:
        """Ask for nodes, the most important first; what does not fit the atlas is left out."""
        readable = [self.tiles.readable(level) for level in range(self.pyramid.level_count)]
        keys = [key for key in keys if readable[key.level]][: self.atlas.capacity]
        named = frozenset(keys)
        if named != self._wanted:
            self._wanted = named
            self.version += 1
        self.atlas.touch(keys)
        resident = self.atlas.resident
        self._loader.want(
            [
                key
                for key in keys
                if key not in resident or (key in self._estimates and self.pyramid.available(key.level))
            ]
        )

    def pump(self, budget: int) -> int:
        """Upload loaded nodes of at most `budget` bytes (one at least); returns the bytes uploaded.

        A node whose upload fails is loaded again later. Raises DeviceLostError where all of them would.
        """
        size = self.atlas.upload_bytes
        fresh: dict[NodeKey, int] = {}
        while not fresh or (len(fresh) + 1) * size <= budget:
            taken = self._loader.take(1)
            if not taken:
                break
            key, (node, exact) = taken[0]
            slot = self.atlas.place(key, self._wanted)
            # no more nodes are wanted than there are slots
            assert slot is not None
            try:
                self.atlas.upload(slot, node)
            except GpuError as error:
                self._drop(key, error)
                continue
            fresh[key] = slot
            if exact:
                self._estimates.discard(key)
                self._loader.done(key)
            else:
                self._estimates.add(key)
            if isinstance(node, HeightNode):
                self.refilled.add(slot)
                self._keep_ranges(slot, node.blocks)
                self.slots[slot] = node.low, node.high, self._error(key) + node.loss, key.level
                self._seen = min(self._seen[0], node.low), max(self._seen[1], node.high)
        if fresh:
            self.version += 1
            try:
                if self.maxima:
                    self.maxima.build(list(fresh.values()))
            except GpuError as error:
                for key in fresh:
                    self._drop(key, error)
        return len(fresh) * size

    def _drop(self, key: NodeKey, error: GpuError) -> None:
        if isinstance(error, DeviceLostError):
            raise error
        self.atlas.remove(key)
        self._loader.fail(key, error)
        self.version += 1

    def _keep_ranges(self, slot: int, ranges: NDArray[np.float32]) -> None:
        for mip in self.blocks:
            mip[slot] = ranges
            side = len(ranges) // 2
            four = ranges.reshape(side, 2, side, 2, 2)
            ranges = np.stack([four[..., 0].min(axis=(1, 3)), four[..., 1].max(axis=(1, 3))], axis=-1)

    @property
    def current(self) -> dict[NodeKey, int]:
        """Slot of every wanted node that is resident.

        What merely lies in the atlas still is not: a picture depends on the camera and not on the way there.
        """
        return {key: slot for key, slot in self.atlas.resident.items() if key in self._wanted}

    @property
    def present(self) -> bool:
        """Whether there is something to draw everywhere: the coarsest node, unless it cannot be read."""
        top = NodeKey(self.pyramid.level_count - 1, 0, 0)
        return top in self.atlas.resident or top in self._loader.failed

    @property
    def pending(self) -> int:
        """Wanted nodes that are not resident yet and have not failed."""
        return self._loader.pending

    @property
    def failed(self) -> Mapping[NodeKey, BaseException]:
        """Wanted nodes that could not be read or uploaded so far, and why."""
        return self._loader.failed

    @property
    def retry_in(self) -> float | None:
        """Seconds until a node that failed is tried again; None where none has failed."""
        return self._loader.retry_in

    @property
    def estimates(self) -> int:
        """Nodes of `current` whose texels are estimates until the pyramid is built."""
        return len(self._estimates & self.current.keys())

    def wait(self, timeout: float | None = None) -> None:
        """Block until a node is loaded or nothing is left to load."""
        self._loader.wait(timeout)

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest valid height (m); until the pyramid is built an estimate that covers all nodes seen."""
        low, high = self.pyramid.height_range
        if self.pyramid.exact:
            return self.format.around(low, high)
        return min(low, self._seen[0]), max(high, self._seen[1])

    @property
    def _ranges(self) -> NodeRanges | None:
        """What the nodes' bounds say, once there are any."""
        if self._known_ranges is None and self.pyramid.exact:
            self._known_ranges = NodeRanges(self.pyramid, self.grid)
        return self._known_ranges

    def bounds(self, level: int, rows: NDArray, cols: NDArray) -> tuple[NDArray, NDArray]:
        """Lowest and highest height (m) that nodes of heights may draw: of their samples and of those around them."""
        if self._ranges is None:
            low, high = self.height_range
            return np.full(rows.shape, low), np.full(rows.shape, high)
        found = self._ranges.over(level, rows, cols)
        return self.format.around(found[..., 0], found[..., 1])

    def _error(self, key: NodeKey) -> float:
        if self._ranges is None:
            return 0.0
        return float(self._ranges.over(key.level, np.array([key.y]), np.array([key.x]))[0, 2])

    def close(self) -> None:
        """Stop loading and give the memory back."""
        self._loader.close()
        self.atlas.destroy()
