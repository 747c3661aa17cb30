"""A part of a raster, as a source of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.grid import Grid
from orogen.source.derived import DerivedSource
from orogen.source.heights import check_window
from orogen.source.scale import ground_scale, parse_crs

STRIP = 512
"""Rows that an overview reads at once."""


@dataclass(frozen=True)
class Crop(DerivedSource):
    """A window of a source of heights; a `Source` that reads nothing outside it."""

    window: tuple[int, int, int, int]
    """First column and row, columns and rows."""

    def __post_init__(self) -> None:
        column, row, columns, rows = self.window
        height, width = self.source.grid.shape
        if column < 0 or row < 0 or column + columns > width or row + rows > height:
            raise SettingsError(
                f"crop: expected a part of the {width} x {height} samples of {self.source.name}, got columns {column} "
                f"to {column + columns} and rows {row} to {row + rows}"
            )

    @cached_property
    def grid(self) -> Grid:
        """Where the window lies; a CRS unit's length is that at its own centre."""
        column, row, columns, rows = self.window
        whole = self.source.grid
        a, b, _, d, e, _ = whole.transform
        x, y = (float(v) for v in whole.to_crs(column, row))
        cut = replace(whole, width=columns, height=rows, transform=(a, b, x, d, e, y))
        middle_x, middle_y = (float(v) for v in cut.to_crs(columns / 2, rows / 2))
        crs = parse_crs(whole.crs) if whole.crs else None
        return replace(cut, ground_scale=ground_scale(crs, middle_x, middle_y, abs(a * e - b * d) ** 0.5))

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) that are cheapest to read."""
        return self.source.block

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return self.source.direct

    @property
    def fingerprint(self) -> str | None:
        """That of the source and the window."""
        return None if self.source.fingerprint is None else f"{self.source.fingerprint}|crop={self.window}"

    @property
    def covered(self) -> bool:
        """Whether every sample is certainly valid."""
        return self.source.covered

    def read(self, rows: slice, cols: slice) -> NDArray[np.float32] | NDArray[np.uint8]:
        """The samples of a part of the window."""
        check_window(rows, cols, self.grid.shape, self.name)
        column, row = self.window[:2]
        return self.source.read(
            slice(rows.start + row, rows.stop + row), slice(cols.start + column, cols.stop + column)
        )

    def overview(self, shape: tuple[int, int]) -> NDArray[np.float32] | NDArray[np.uint8]:
        """Samples evenly over the window."""
        height, width = self.grid.shape
        rows, cols = (
            ((np.arange(min(n, size)) + 0.5) * size / min(n, size)).astype(int)
            for n, size in zip(shape, (height, width), strict=True)
        )
        strips = []
        for start in range(0, height, STRIP):
            wanted = rows[(rows >= start) & (rows < start + STRIP)] - start
            if wanted.size:
                strip = self.read(slice(start, min(height, start + STRIP)), slice(0, width))
                strips.append(strip[np.ix_(wanted, cols)])
        return np.concatenate(strips)
