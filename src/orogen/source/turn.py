"""Longitudes that differ by whole turns: images around 180 degrees lie over heights that count otherwise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orogen.grid import Grid
from orogen.source.colours import ColourSource, Pixels

if TYPE_CHECKING:
    from rasterio.crs import CRS


def full_turn(crs: CRS | None) -> float | None:
    """Units of a geographic CRS around the globe, such as 360 (degrees); None of other CRSs."""
    return 2 * math.pi / float(crs.units_factor[1]) if crs is not None and crs.is_geographic else None


def turned(source: ColourSource, heights: Grid, turn: float | None) -> ColourSource:
    """An image moved by whole turns to where the heights are; one around the globe begins where they begin."""
    a, b, c, d, e, f = source.grid.transform
    if turn is None or b or d:
        return source
    left, _, right, _ = source.grid.bounds
    low, _, high, _ = heights.bounds
    c += turn * round((low + high - left - right) / 2 / turn)
    width = source.grid.width
    grid = replace(source.grid, transform=(a, b, c, d, e, f))
    left, _, right, _ = grid.bounds
    columns = round((low - left) / a) if a > 0 else 0
    if abs(width * a - turn) > 0.01 * abs(a) or (left <= low and high <= right) or not columns % width:
        return replace(source, grid=grid)
    grid = replace(source.grid, transform=(a, b, c + a * columns, d, e, f))
    mark = source.fingerprint and f"{source.fingerprint}|{grid.transform}"
    return replace(source, grid=grid, pixels=TurnedPixels(source.pixels, width, columns % width), fingerprint=mark)


@dataclass(frozen=True)
class TurnedPixels:
    """Pixels around the globe that begin at another column."""

    pixels: Pixels
    """The pixels."""
    width: int
    """Columns around the globe."""
    first: int
    """Column that comes first, from 1."""

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) worth reading at once."""
        return self.pixels.block

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return self.pixels.direct

    def read(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """(rows, columns, 4) of a window, of two where it lies across the seam."""
        start, stop = cols.start + self.first, cols.stop + self.first
        if start >= self.width:
            return self.pixels.read(rows, slice(start - self.width, stop - self.width))
        if stop <= self.width:
            return self.pixels.read(rows, slice(start, stop))
        parts = slice(start, self.width), slice(0, stop - self.width)
        return np.concatenate([self.pixels.read(rows, part) for part in parts], axis=1)

    def overview(self, shape: tuple[int, int]) -> NDArray[Any]:
        """Every n-th pixel, rolled to the nearest column."""
        small = self.pixels.overview(shape)
        return np.roll(small, -round(self.first * small.shape[1] / self.width), axis=1)

    def close(self) -> None:
        """Release open files."""
        self.pixels.close()
