"""Decoded tiles: the chunks of a pyramid that were read lately, and the node textures made from them.

A node's border is cut from neighbouring chunks through this cache, so it is neither stored twice nor read from resident
neighbours.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orogen.keys import NODE_SIZE as CHUNK
from orogen.keys import NodeKey, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.reduce import colour_means, filled
from orogen.streaming.heightformat import FLOATS, HeightFormat
from orogen.streaming.settings import COLOR_BORDER, COLOR_MIPS, HEIGHT_BORDER

BLOCK = 16
"""Texels along a side of the blocks whose lowest and highest height are known."""

_Chunk = tuple[int, int, int, str]
"""Level, row and column of a chunk, and what is in it: "exact" samples, an "estimate" of them, or their "coverage"."""


class Tiles(Protocol):
    """What nodes are made from."""

    def readable(self, level: int) -> bool:
        """Whether a level can be read now, exactly or as an estimate."""

    def window(self, level: int, rows: slice, cols: slice) -> NDArray:
        """Texels of a readable level; the window must lie inside it."""

    def coverage(self, level: int, rows: slice, cols: slice, heights: NDArray[np.float32]) -> NDArray[np.uint8]:
        """The valid part, 0 to 255, of the texels of a window whose heights have been read."""


@dataclass(frozen=True)
class EstimatedTiles:
    """The coarse levels of a pyramid as estimates, whether or not they are built: for when the store fails."""

    pyramid: Pyramid

    def readable(self, level: int) -> bool:
        """Whether there is an estimate of a level."""
        return level >= self.pyramid.estimate_level

    def window(self, level: int, rows: slice, cols: slice) -> NDArray:
        """Texels of an estimated level. Raises what the pyramid raises."""
        return self.pyramid.read_estimate(level, rows, cols)

    def coverage(self, level: int, rows: slice, cols: slice, heights: NDArray[np.float32]) -> NDArray[np.uint8]:
        """The valid part, 0 or 255, of texels."""
        return np.isfinite(heights) * np.uint8(255)


class DecodedTiles:
    """Chunks of a pyramid, the least recently used ones dropped beyond a number of bytes. Thread-safe."""

    def __init__(self, pyramid: Pyramid, budget: int) -> None:
        """`budget`: bytes held between calls."""
        self._pyramid = pyramid
        self._budget = budget
        self._bytes = 0
        self._tiles: OrderedDict[_Chunk, Future[NDArray]] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def size(self) -> int:
        """Bytes held."""
        return self._bytes

    def readable(self, level: int) -> bool:
        """Whether a level can be read now, exactly or as an estimate."""
        return self._pyramid.available(level) or level >= self._pyramid.estimate_level

    def window(self, level: int, rows: slice, cols: slice) -> NDArray:
        """Texels of a readable level; the window must lie inside it. Estimates where the level is not built yet.

        Raises what the pyramid raises.
        """
        size = (rows.stop - rows.start) * (cols.stop - cols.start)
        if size >= CHUNK * CHUNK and not self._pyramid.chunked:
            # a node: what it has of the chunks around is little. Small windows are asked for again and again
            return self._pyramid.read(level, rows, cols)
        return self._gathered(level, rows, cols, "exact" if self._pyramid.available(level) else "estimate")

    def coverage(self, level: int, rows: slice, cols: slice, heights: NDArray[np.float32]) -> NDArray[np.uint8]:
        """The valid part, 0 to 255, of the texels of a window whose heights have been read."""
        if level and self._pyramid.available(level):
            return self._gathered(level, rows, cols, "coverage")
        # samples are valid or not; estimates say no more
        return np.isfinite(heights) * np.uint8(255)

    def _gathered(self, level: int, rows: slice, cols: slice, content: str) -> NDArray:
        out: NDArray | None = None
        for cy in range(rows.start // CHUNK, (rows.stop - 1) // CHUNK + 1):
            for cx in range(cols.start // CHUNK, (cols.stop - 1) // CHUNK + 1):
                chunk = self._chunk((level, cy, cx, content))
                if out is None:
                    out = np.empty((rows.stop - rows.start, cols.stop - cols.start, *chunk.shape[2:]), chunk.dtype)
                r0, r1 = max(rows.start, cy * CHUNK), min(rows.stop, (cy + 1) * CHUNK)
                c0, c1 = max(cols.start, cx * CHUNK), min(cols.stop, (cx + 1) * CHUNK)
                out[r0 - rows.start : r1 - rows.start, c0 - cols.start : c1 - cols.start] = chunk[
                    r0 - cy * CHUNK : r1 - cy * CHUNK, c0 - cx * CHUNK : c1 - cx * CHUNK
                ]
        assert out is not None, "a window has at least one texel"
        return out

    def _chunk(self, key: _Chunk) -> NDArray:
        with self._lock:
            future = self._tiles.get(key)
            if future is not None:
                self._tiles.move_to_end(key)
            else:
                mine = self._tiles[key] = Future()
        if future is not None:
            return future.result()
        try:
            tile = self._read(key)
        except BaseException as error:
            with self._lock:
                del self._tiles[key]
            mine.set_exception(error)
            raise
        with self._lock:
            mine.set_result(tile)
            self._bytes += tile.nbytes
            self._trim(key)
        return tile

    def _read(self, key: _Chunk) -> NDArray:
        level, cy, cx, content = key
        height, width = level_shape(self._pyramid.grid.shape, level)
        rows = slice(cy * CHUNK, min((cy + 1) * CHUNK, height))
        cols = slice(cx * CHUNK, min((cx + 1) * CHUNK, width))
        pyramid = self._pyramid
        read = {"exact": pyramid.read, "estimate": pyramid.read_estimate, "coverage": pyramid.read_coverage}[content]
        return read(level, rows, cols)

    def _trim(self, keep: _Chunk) -> None:
        for key in list(self._tiles):
            if self._bytes <= self._budget:
                return
            if key != keep and self._tiles[key].done():
                self._bytes -= self._tiles.pop(key).result().nbytes


@dataclass(frozen=True)
class HeightNode:
    """What the atlas stores of a node of the height layer."""

    heights: NDArray[np.float32] | NDArray[np.uint16]
    """(side, side) texels, side = node_size + 2 border, as the layer's `HeightFormat` stores heights; invalid ones are
    filled in."""
    coverage: NDArray[np.uint8] | None
    """(side, side) the valid part of each texel, 0 to 255; None where the layer has no invalid texel."""
    low: float
    """Lowest height (m) of the texels, border included."""
    high: float
    """Highest height (m) of the texels, border included."""
    blocks: NDArray[np.float32]
    """(size / 16, size / 16, 2) lowest and highest height (m) of blocks of texels and those around them."""
    loss: float = 0.0
    """How far texels are from their heights at most (m)."""


@dataclass(frozen=True)
class ColorNode:
    """What the atlas stores of a node of the colour layer."""

    mips: tuple[NDArray[np.uint8], ...]
    """(side, side, 4) sRGB with the alpha multiplied in (in linear light) and alpha, then its halves."""


def height_node(
    tiles: Tiles, pyramid: Pyramid, key: NodeKey, size: int, covered: bool, form: HeightFormat = FLOATS
) -> HeightNode:
    """Read a node of `size` texels with its border; no coverage where the layer is `covered` everywhere.

    Raises what the pyramid raises.
    """
    shape = level_shape(pyramid.grid.shape, key.level)
    # one texel more than the border: invalid border texels are filled from their neighbours
    rows, cols = _window(key, size, HEIGHT_BORDER + 1, shape)
    heights = tiles.window(key.level, rows, cols)
    coverage = None
    if not covered:
        share = tiles.coverage(key.level, rows, cols, heights)
        coverage = _placed(share, key, size, HEIGHT_BORDER, rows, cols, linear=False)
        heights = without_holes(tiles, pyramid, key.level, rows, cols, heights)
    heights = _placed(heights, key, size, HEIGHT_BORDER, rows, cols, linear=True)
    texels = form.encode(heights)
    # bounds are those of what is drawn
    drawn = form.decode(texels)
    loss = 0.0 if form.bits == 32 else float(np.abs(drawn - heights).max())
    return HeightNode(texels, coverage, float(drawn.min()), float(drawn.max()), _block_ranges(drawn), loss)


def _block_ranges(heights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Lowest and highest height of every block and one texel around it, from a node with its border."""
    around = heights[HEIGHT_BORDER - 1 : 1 - HEIGHT_BORDER, HEIGHT_BORDER - 1 : 1 - HEIGHT_BORDER]
    ranges = []
    for extreme in (np.minimum, np.maximum):
        values = around
        for _ in range(2):
            # rows, then columns: the blocks, then the texel before and the texel after each
            inner = extreme.reduceat(values[1:-1], np.arange(0, len(values) - 2, BLOCK))
            count = len(inner)
            before, after = values[:-BLOCK:BLOCK][:count], values[BLOCK + 1 :: BLOCK][:count]
            values = extreme(inner, extreme(before, after)).T
        ranges.append(values)
    return np.stack(ranges, axis=-1)


def color_node(tiles: Tiles, pyramid: Pyramid, key: NodeKey, size: int) -> ColorNode:
    """Read a colour node of `size` texels with its border and make its mip levels. Raises what the pyramid raises."""
    shape = level_shape(pyramid.grid.shape, key.level)
    rows, cols = _window(key, size, COLOR_BORDER, shape)
    mips = [_placed(tiles.window(key.level, rows, cols), key, size, COLOR_BORDER, rows, cols, linear=False)]
    for _ in range(COLOR_MIPS - 1):
        mips.append(colour_means(mips[-1]))
    return ColorNode(tuple(_premultiplied(mip) for mip in mips))


def _window(key: NodeKey, size: int, border: int, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a node with its border, cut to the level."""
    return (
        slice(max(0, key.y * size - border), min((key.y + 1) * size + border, shape[0])),
        slice(max(0, key.x * size - border), min((key.x + 1) * size + border, shape[1])),
    )


def _placed(
    values: NDArray, key: NodeKey, size: int, border: int, rows: slice, cols: slice, *, linear: bool
) -> NDArray:
    """Texels of a window as a node's square: cut to the border, and extended past the level's edges."""
    for axis, (start, first) in enumerate(((rows.start, key.y * size), (cols.start, key.x * size))):
        values = _extended(values, axis, np.arange(first - border, first + size + border) - start, linear)
    return np.ascontiguousarray(values)


def _extended(values: NDArray, axis: int, index: NDArray[np.int64], linear: bool) -> NDArray:
    """Values at an index along an axis, past its ends the last one, where `linear` after two steps along the edge's
    slope, so that planes stay planes.
    """
    last = values.shape[axis] - 1
    inside = np.clip(index, 0, last)
    out = np.take(values, inside, axis=axis)
    if linear and last > 0:
        steps = np.minimum(np.abs(index - inside), HEIGHT_BORDER).astype(values.dtype)
        lines = np.moveaxis(out, axis, 0)
        for past, edge, before in ((index < 0, 0, 1), (index > last, last, last - 1)):
            lines[past] += steps[past, None] * (values.take(edge, axis) - values.take(before, axis))
    return out


def without_holes(
    tiles: Tiles, pyramid: Pyramid, level: int, rows: slice, cols: slice, heights: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Heights for invalid texels: the mean of the valid ones of the 8 neighbours, else of the finest coarser level."""
    heights = filled(heights)
    for coarser in filter(tiles.readable, range(level + 1, pyramid.level_count)):
        y, x = np.nonzero(np.isnan(heights))
        if not len(y):
            return heights
        shift = coarser - level
        r = slice(rows.start >> shift, ((rows.stop - 1) >> shift) + 1)
        c = slice(cols.start >> shift, ((cols.stop - 1) >> shift) + 1)
        coarse = tiles.window(coarser, r, c)
        heights[y, x] = coarse[((y + rows.start) >> shift) - r.start, ((x + cols.start) >> shift) - c.start]
    low, high = pyramid.height_range
    return np.where(np.isnan(heights), np.float32((low + high) / 2), heights)


def _premultiplied(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Straight to multiplied alpha, in linear light."""
    partly = image[..., 3] < 255
    if not partly.any():
        return image
    out = image.copy()
    encoded = image[partly, :3] / 255
    light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    light *= image[partly, 3:] / 255
    encoded = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    out[partly, :3] = np.rint(255 * encoded)
    return out
