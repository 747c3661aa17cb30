"""The tiles of a tree as one raster of pixels."""

from __future__ import annotations

import io
import threading
from collections import OrderedDict
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.source.tiletree import LocalTiles, RemoteTiles, Tile

DECODED = 64
"""Decoded tiles that are kept in memory."""
LEVELS = 8
"""Coarser zooms that begin and end where the tiles of the finest do."""
THREADS = 8
"""Tiles of a server that are asked for at once by one reader."""
LARGEST = 4096
"""Rows and columns of a tile, at most."""


@dataclass(frozen=True)
class TilePixels:
    """The pixels of the tiles of one zoom as one raster; a tile that is missing is transparent. Thread-safe."""

    tiles: LocalTiles | RemoteTiles
    """Where the tiles come from."""
    zoom: int
    """The zoom."""
    size: int
    """Rows and columns of a tile."""
    origin: tuple[int, int]
    """(row, column) in pixels of the zoom where the raster begins."""
    shape: tuple[int, int]
    """(rows, columns)."""
    zooms: tuple[int, ...]
    """Coarser zooms that there are, the finest first."""
    lossless: bool = False
    """Whether JPEG and the like are refused, as heights must be exact."""
    sequential: bool = field(default=False, init=False)
    """Tiles can be read from anywhere."""
    _decoded: OrderedDict[Tile, NDArray[np.uint8] | None] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) of a tile."""
        return self.size, self.size

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return not self.tiles.remote

    def read(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """(rows, columns, 4) RGBA of a window."""
        result = np.zeros((rows.stop - rows.start, cols.stop - cols.start, 4), np.uint8)
        top, left = self.origin[0] + rows.start, self.origin[1] + cols.start
        down = range(top // self.size, -(-(top + result.shape[0]) // self.size))
        across = range(left // self.size, -(-(left + result.shape[1]) // self.size))
        for (_, x, y), pixels in self._tiles([(self.zoom, x, y) for y in down for x in across]):
            into, of = zip(_overlap(y, self.size, top, result.shape[0]), _overlap(x, self.size, left, result.shape[1]),
                           strict=True)  # fmt: skip
            result[into] = pixels[of]
        return result

    def overview(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """(rows, columns, 4) of the whole: nearest pixels of the coarsest zoom that has as many."""
        drop = 0
        while (
            self.zoom - drop - 1 in self.zooms and min(self.shape[i] / 2 ** (drop + 1) / shape[i] for i in (0, 1)) >= 1
        ):
            drop += 1
        pixel = [
            ((self.origin[i] + (np.arange(shape[i]) + 0.5) * self.shape[i] / shape[i]) / 2**drop).astype(np.int64)
            for i in (0, 1)
        ]
        result = np.zeros((*shape, 4), np.uint8)
        rows, cols = pixel[0] // self.size, pixel[1] // self.size
        wanted = [(self.zoom - drop, int(x), int(y)) for y in np.unique(rows) for x in np.unique(cols)]
        for (_, x, y), found in self._tiles(wanted):
            i, j = np.nonzero(rows == y)[0], np.nonzero(cols == x)[0]
            result[np.ix_(i, j)] = found[np.ix_(pixel[0][i] - y * self.size, pixel[1][j] - x * self.size)]
        return result

    @cached_property
    def overviews(self) -> tuple[TilePixels, ...]:
        """The coarser zooms, the finest first, as far as they follow each other."""
        result: list[TilePixels] = []
        for drop in range(1, LEVELS + 1):
            zoom, step = self.zoom - drop, 2**drop
            if zoom not in self.zooms or self.size % step:
                break
            result.append(
                TilePixels(
                    self.tiles, zoom, self.size, (self.origin[0] // step, self.origin[1] // step),
                    (self.shape[0] // step, self.shape[1] // step), (), self.lossless,
                )
            )  # fmt: skip
        return tuple(result)

    def first(self, tiles: Iterable[Tile]) -> NDArray[np.uint8] | None:
        """The first of some tiles that there is."""
        return next((found for tile in tiles if (found := self._tile(tile)) is not None), None)

    def close(self) -> None:
        """Release what is open."""
        self.tiles.close()
        with self._lock:
            self._decoded.clear()

    def _tiles(self, wanted: list[Tile]) -> Iterable[tuple[Tile, NDArray[np.uint8]]]:
        """Those of some tiles that there are."""
        if self.tiles.remote and len(wanted) > 1:
            with ThreadPoolExecutor(THREADS) as pool:
                found = list(pool.map(self._tile, wanted))
        else:
            found = [self._tile(tile) for tile in wanted]
        return [(tile, pixels) for tile, pixels in zip(wanted, found, strict=True) if pixels is not None]

    def _tile(self, tile: Tile) -> NDArray[np.uint8] | None:
        with self._lock:
            if tile in self._decoded:
                self._decoded.move_to_end(tile)
                return self._decoded[tile]
        data = self.tiles.get(tile)
        pixels = None if data is None else decoded(data, self.tiles.template.path(tile), self.lossless)
        if pixels is not None and self.size and pixels.shape[:2] != (self.size, self.size):
            raise SourceError(
                f"{self.tiles.template.name}: expected tiles of {self.size} x {self.size} pixels, got "
                f"{pixels.shape[1]} x {pixels.shape[0]} at zoom {tile[0]}, x {tile[1]}, y {tile[2]}"
            )
        with self._lock:
            self._decoded[tile] = pixels
            while len(self._decoded) > DECODED:
                self._decoded.popitem(last=False)
        return pixels


def decoded(data: bytes, name: str, lossless: bool) -> NDArray[np.uint8]:
    """(rows, columns, 4) RGBA of an image; SourceError where it is none, or is not exact although it must be."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(data)) as image:
            lossy = image.format == "JPEG" or (image.format == "WEBP" and data[12:16] == b"VP8 ")
            if lossless and (lossy or image.format not in ("PNG", "WEBP")):
                raise SourceError(
                    f"{name}: {image.format} does not keep heights exactly; expected PNG or lossless WebP"
                )
            if max(image.size) > LARGEST:
                raise SourceError(f"{name}: expected a tile of at most {LARGEST} x {LARGEST} pixels, got {image.size}")
            if image.mode.startswith(("I", "F")):
                raise SourceError(f"{name}: expected a tile of 8 bits a band, got one of mode {image.mode}")
            return np.asarray(image.convert("RGBA"))
    except SourceError:
        raise
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, EOFError) as error:
        raise SourceError(f"{name}: cannot be read as an image ({error})") from error


def _overlap(number: int, size: int, start: int, length: int) -> tuple[slice, slice]:
    """Where tile `number` lies in a window of `length` pixels from `start` on, and the part of the tile that does."""
    low, high = max(start, number * size), min(start + length, (number + 1) * size)
    return slice(low - start, high - start), slice(low - number * size, high - number * size)
