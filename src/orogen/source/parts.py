"""Rasters laid beside and over each other, opened when they are needed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import NoSampleError, SourceError
from orogen.grid import Grid
from orogen.source import files
from orogen.source.contract import Kind, Source
from orogen.source.heights import Facts, check_window
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.survey import fits_memory
from orogen.source.warp import empty, resampled_overview, warped_window

OPEN = 64
"""Rasters that are open at once, at most."""
HELD = 1 << 25
"""Samples of open rasters that are held in memory, at most."""


@dataclass(frozen=True, kw_only=True)
class Part(Facts):
    """A raster of a mosaic, known by its header alone."""

    data: Any
    """What opens it."""
    direct: bool
    """Whether small windows of it are cheap."""
    reference: str | None = None
    """CRS that it is opened with, for what it does not name itself; it lies where its own says."""
    box: tuple[int, int, int, int] = (0, 0, 0, 0)
    """First and last + 1 row, first and last + 1 column in the mosaic."""
    turn: float = 0.0
    """CRS units around the globe by which it is moved along x, to lie beside the others."""
    aligned: bool = False
    """Whether its samples are samples of the mosaic; else it is warped."""


@dataclass(frozen=True, kw_only=True)
class MosaicSource(Facts):
    """Rasters put together, opened when they are needed; a `Source`. Thread-safe."""

    parts: tuple[Part, ...]
    """In the order in which they are laid."""
    options: HeightOptions | ColourOptions
    """How each of them is read."""
    heights: Source | None = None
    """What images are draped over; None for heights."""
    nodata: None = field(default=None, init=False)
    """Each raster has its own."""
    block: tuple[int, int] = field(default=(512, 512), init=False)
    """(rows, columns) worth reading at once."""
    _open: OrderedDict[int, Source | None] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def kind(self) -> Kind:
        """Heights, or colours over heights."""
        return "height" if self.heights is None else "colour"

    @cached_property
    def _index(self) -> _Index:
        return _Index(self.parts)

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return all(part.direct and part.aligned for part in self.parts)

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        """A window inside the mosaic, as `Source.read`; nodata between the parts."""
        check_window(rows, cols, self.grid.shape, self.name)
        result = empty((rows.stop - rows.start, cols.stop - cols.start), self.kind)
        for number in self._index.meeting(rows, cols):
            part = self.parts[number]
            top, bottom, left, right = part.box
            r = slice(max(rows.start, top), min(rows.stop, bottom))
            c = slice(max(cols.start, left), min(cols.stop, right))
            source = self.part(number)
            if source is None:
                continue
            if part.aligned:
                found = source.read(slice(r.start - top, r.stop - top), slice(c.start - left, c.stop - left))
            else:
                found = warped_window(source, self._seen_by(part), r, c)
            _lay(found, result[r.start - rows.start : r.stop - rows.start, c.start - cols.start : c.stop - cols.start])
        return result

    def overview(self, shape: tuple[int, int]) -> NDArray[Any]:
        """The whole mosaic at `shape` (rows, columns), from an overview of each raster."""
        shape = min(shape[0], self.grid.height), min(shape[1], self.grid.width)
        result = empty(shape, self.kind)
        scale = shape[0] / self.grid.height, shape[1] / self.grid.width
        for number, part in enumerate(self.parts):
            top, bottom, left, right = part.box
            rows = slice(int(top * scale[0]), min(shape[0], int(np.ceil(bottom * scale[0]))))
            cols = slice(int(left * scale[1]), min(shape[1], int(np.ceil(right * scale[1]))))
            if (source := self.part(number)) is not None:
                _lay(resampled_overview(source, self._seen_by(part), shape, rows, cols), result[rows, cols])
        return result

    def _seen_by(self, part: Part) -> Grid:
        """The grid where a part lies by its own count of longitudes."""
        a, b, c, d, e, f = self.grid.transform
        return replace(self.grid, transform=(a, b, c - part.turn, d, e, f)) if part.turn else self.grid

    def close(self) -> None:
        """Release open files."""
        with self._lock:
            sources = list(self._open.values())
            self._open.clear()
        for source in sources:
            if source is not None:
                source.close()

    def part(self, number: int) -> Source | None:
        """A raster, opened if need be; None where it has no valid sample."""
        with self._lock:
            if number in self._open:
                self._open.move_to_end(number)
                return self._open[number]
        try:
            source = self._opened(self.parts[number])
        except NoSampleError:
            source = None
        surplus: list[Source | None] = []
        with self._lock:
            self._open[number] = source
            while len(self._open) > OPEN or (len(self._open) > 1 and self._held() > HELD):
                surplus.append(self._open.popitem(last=False)[1])
        for old in surplus:  # a thread that still reads it opens it again
            if old is not None:
                old.close()
        return source

    def _opened(self, part: Part) -> Source | None:
        if isinstance(self.options, HeightOptions):
            source = files.open_height(part.data, replace(self.options, crs=part.reference))
        else:
            assert self.heights is not None, "images are draped over heights"
            source = files.open_colour(part.data, self.heights, self.options)
        if part.fingerprint and not (source.fingerprint or "").startswith(part.fingerprint):
            source.close()
            raise SourceError(f"{part.name}: changed since the mosaic was opened; open it again")
        return source

    def _held(self) -> int:
        shapes = [source.grid.shape for source in self._open.values() if source is not None]
        return sum(rows * cols for rows, cols in shapes if fits_memory((rows, cols)))


def _lay(found: NDArray[Any], onto: NDArray[Any]) -> None:
    """Lay a part over others, in place: where it is valid, of images where it is no more transparent than they are."""
    if found.ndim == 2:
        np.copyto(onto, found, where=~np.isnan(found))
    else:
        np.copyto(onto, found, where=(found[..., 3] > 0)[..., None] & (found[..., 3:] >= onto[..., 3:]))


class _Index:
    """Finds the parts that meet a window: by cells of about the size of a part."""

    def __init__(self, parts: Sequence[Part]) -> None:
        sizes = [max(part.box[1] - part.box[0], part.box[3] - part.box[2], 1) for part in parts]
        self._cell = int(np.median(sizes))
        self._boxes = [part.box for part in parts]
        self._cells: dict[tuple[int, int], list[int]] = {}
        for number, (top, bottom, left, right) in enumerate(self._boxes):
            for key in self._keys(slice(top, bottom), slice(left, right)):
                self._cells.setdefault(key, []).append(number)

    def meeting(self, rows: slice, cols: slice) -> list[int]:
        """Numbers of the parts that share a sample with a window, in their order."""
        near = {number for key in self._keys(rows, cols) for number in self._cells.get(key, ())}
        found = []
        for number in sorted(near):
            top, bottom, left, right = self._boxes[number]
            if top < rows.stop and rows.start < bottom and left < cols.stop and cols.start < right:
                found.append(number)
        return found

    def _keys(self, rows: slice, cols: slice) -> list[tuple[int, int]]:
        size = self._cell
        down = range(rows.start // size, (rows.stop - 1) // size + 1)
        across = range(cols.start // size, (cols.stop - 1) // size + 1)
        return [(i, j) for i in down for j in across]
