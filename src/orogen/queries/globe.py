"""Longitudes: rasters that lie across 180 degrees, and those around the globe, which have no end at their seam."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.grid import Grid
from orogen.keys import NODE_SIZE, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.derived import DerivedPyramid
from orogen.queries.blocks import Blocks
from orogen.queries.geodesy import Geodesy
from orogen.queries.points import surface_at
from orogen.source.scale import parse_crs
from orogen.source.turn import full_turn
from orogen.streaming.tiles import DecodedTiles

F64 = NDArray[np.float64]


class Ground:
    """A pyramid as questions see it: decoded tiles for points, blocks for rays, distances."""

    def __init__(self, pyramid: Pyramid, memory: int, first: int = 0, period: float = np.inf) -> None:
        """`memory`: bytes that are kept. `first`, `period`: of a pyramid that begins at another column, see `Globe`."""
        self.pyramid, self.grid = pyramid, pyramid.grid
        self.tiles = DecodedTiles(pyramid, memory // 2)
        self.blocks = Blocks(pyramid, self.tiles, memory // 2)
        self.geodesy = Geodesy(pyramid.grid)
        self._first, self._period = first, period

    def local(self, tx: F64) -> F64:
        """Columns of the raster as columns of this pyramid."""
        return (tx - self._first) % self._period if self._first else tx

    def surface(self, tx: F64, ty: F64, slopes: bool = False) -> list[F64]:
        """`surface_at` texel coordinates of this pyramid."""
        return surface_at(self.pyramid, self.tiles, tx, ty, slopes)


class Globe:
    """A raster as it is, and, where it goes around the globe, once more with its seam in the middle.

    What lies near the seam, or reaches across it, is asked of the second one.
    """

    def __init__(self, pyramid: Pyramid, memory: int) -> None:
        """`memory`: bytes that each of the two keeps."""
        self._pyramid, self._memory = pyramid, memory
        self.front = Ground(pyramid, memory)
        self.grid: Grid = pyramid.grid
        a, b, _, d, _, _ = self.grid.transform
        crs = parse_crs(self.grid.crs) if self.grid.crs is not None else None
        self._turn = None if b or d else full_turn(crs)
        columns = self._turn / abs(a) if self._turn else np.inf
        around = self.grid.width >= columns - 0.01 and abs(columns - np.rint(columns)) < 0.01
        self.period: int | None = round(columns) if around else None
        """Columns once around the globe; None where the raster does not go around it."""

    @cached_property
    def back(self) -> Ground:
        """The raster around the globe, begun about half a turn later."""
        assert self.period is not None, "asked for of rasters around the globe only"
        step = 1 << (self._pyramid.level_count - 1)
        first = max(1, self.period // 2 // step * step)
        return Ground(TurnedPyramid(self._pyramid, first, self.period), self._memory, first, self.period)

    def texels(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Texel coordinates of CRS coordinates; longitudes beside the raster may be whole turns away from it."""
        return self.grid.to_texel(self.home(x), y)

    def home(self, x: F64) -> F64:
        """x moved by whole turns to where the raster is, if it is beside it."""
        if self._turn is None:
            return x
        left, _, right, _ = self.grid.bounds
        beside = (x < left) | (x > right)
        return np.where(beside, self.nearest(x, np.array((left + right) / 2)), x)

    def nearest(self, x: F64, to: F64) -> F64:
        """x moved by whole turns to within half a turn of others."""
        if self._turn is None:
            return x
        with np.errstate(invalid="ignore"):  # infinite ones stay unknown
            return x - self._turn * np.rint((x - to) / self._turn)

    def shorter(self, a: F64, b: F64) -> F64:
        """Columns b moved by whole turns to within half a turn of columns a, where the raster goes around the globe."""
        return b if self.period is None else b - self.period * np.rint((b - a) / self.period)

    def beyond(self, tx: F64) -> NDArray[np.bool_]:
        """Which columns lie outside the hull of the raster's sample centres, but not of the globe."""
        if self.period is None:
            return np.zeros(tx.shape, bool)
        return np.isfinite(tx) & ((tx < 0.5) | (tx > self.grid.width - 0.5))

    def outer(self, tx: F64) -> NDArray[np.bool_]:
        """Which columns are nearer to the seam than to the middle of a raster around the globe."""
        if self.period is None:
            return np.zeros(tx.shape, bool)
        return np.abs(tx - self.grid.width / 2) > self.period / 4

    def sides(self, on_back: NDArray[np.bool_]) -> list[tuple[Ground, NDArray[np.bool_]]]:
        """Front and back, each with what is asked of it; one that nothing is asked of is left out."""
        parts = [(self.front, ~on_back)] if not on_back.all() else []
        return [*parts, (self.back, on_back)] if on_back.any() else parts

    def surface(self, tx: F64, ty: F64, slopes: bool = False) -> list[F64]:
        """`surface_at` texel coordinates of the raster, across the seam too."""
        found = self.front.surface(tx, ty, slopes)
        seam = self.beyond(tx)
        if seam.any():
            there = self.back.surface(self.back.local(tx[seam]), ty[seam], slopes)
            for values, across in zip(found, there, strict=True):
                values[seam] = across
        return found

    def columns(self, cols: slice) -> list[tuple[Ground, slice]]:
        """A window of columns cut where `outer` changes: the parts from left to right, in columns of their ground."""
        if self.period is None:
            return [(self.front, cols)]
        quarter, parts = self.period // 4, []
        edges = [0, quarter, self.grid.width - quarter, self.grid.width]
        for low, high in pairwise(edges):
            start, stop = max(cols.start, low), min(cols.stop, high)
            if start < stop:
                ground = self.front if low == quarter else self.back
                first = int(ground.local(np.array(float(start))))
                parts.append((ground, slice(first, first + stop - start)))
        return parts


class TurnedPyramid(DerivedPyramid):
    """Heights around the globe that begin at another column; its longitudes go on beyond those of the raster."""

    def __init__(self, below: Pyramid, first: int, period: int) -> None:
        """`first`: the column that it begins with. `period`: columns around the globe."""
        super().__init__(below, below.source)
        a, b, c, d, e, f = below.grid.transform
        place = (a, b, c + a * first, d, e, f)
        self.grid = Grid(period, below.grid.height, place, below.grid.crs, below.grid.ground_scale)
        self.level_count, self.estimate_level = below.level_count, below.estimate_level
        self._first = first

    @property
    def height_range(self) -> tuple[float, float]:
        """That of the raster."""
        return self._below.height_range

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """As `Pyramid.read`; coarse levels of a width that they do not divide are off by less than a sample."""
        return np.concatenate([self._below.read(level, rows, part) for part in self._parts(level, cols)], axis=1)

    def read_coverage(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """As `Pyramid.read_coverage`."""
        parts = self._parts(level, cols)
        return np.concatenate([self._below.read_coverage(level, rows, part) for part in parts], axis=1)

    def read_estimate(self, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """As `Pyramid.read_estimate`."""
        parts = self._parts(level, cols)
        return np.concatenate([self._below.read_estimate(level, rows, part) for part in parts], axis=1)

    def _parts(self, level: int, cols: slice) -> list[slice]:
        """The raster's columns of a window: two parts where it lies across the seam."""
        width = level_shape(self.grid.shape, level)[1]
        start, stop = ((at + (self._first >> level)) for at in (cols.start, cols.stop))
        if start >= width:
            return [slice(start - width, stop - width)]
        return [slice(start, stop)] if stop <= width else [slice(start, width), slice(0, stop - width)]

    def node_bounds(
        self, level: int, rows: slice | None = None, cols: slice | None = None
    ) -> NDArray[np.float32] | None:
        """As `Pyramid.node_bounds`, of all the raster's nodes that a node reaches into."""
        side, width = NODE_SIZE << level, self.grid.width
        cols = cols or slice(0, -(-width // side))
        found = []
        for node in range(cols.start, cols.stop):
            texels = slice(node * side, min((node + 1) * side, width))
            below = []
            for part in self._parts(0, texels):
                bounds = self._below.node_bounds(level, rows, slice(part.start // side, -(-part.stop // side)))
                if bounds is None:
                    return None
                below.append(bounds)
            both = np.concatenate(below, axis=1)
            lows, highs, errors = (
                extreme.reduce(both[..., i], axis=1) for i, extreme in enumerate((np.fmin, np.fmax, np.fmax))
            )
            found.append(np.stack([lows, highs, errors], axis=-1))
        return np.stack(found, axis=1)
