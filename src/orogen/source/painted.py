"""Rasters of one band as colours: slopes, temperatures or classes of land through a colour ramp."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.source import arrays, files
from orogen.source.colours import ColourSource, drape
from orogen.source.contract import Overview, Source, attribution_of, overviews_of
from orogen.source.georeference import same_place
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.raster import open_raster
from orogen.source.scale import parse_crs
from orogen.source.turn import full_turn, turned
from orogen.source.warp import WarpedSource, warped_grid

if TYPE_CHECKING:
    from orogen.source.open import Opener

LOOKED = 512
"""Rows and columns of the overview that the range of a ramp is taken from."""
ENDS = 2.0, 98.0
"""Per cent of the values that lie below the ends of a ramp without a range of its own: strays do not spoil it."""


@dataclass(frozen=True)
class Stops:
    """A colour ramp."""

    values: NDArray[np.float64]
    """(n,) ascending; two that are alike make a step. In the raster's units, or 0 to 1 where relative."""
    colors: NDArray[np.float64]
    """(n, 3) sRGB, 0 to 1, mixed in between as they are."""
    relative: bool
    """Whether values are parts of the raster's range."""

    def over(self, low: float, high: float) -> Stops:
        """The ramp over a range, if it has none of its own."""
        return replace(self, values=low + (high - low) * self.values, relative=False) if self.relative else self

    def paint(self, values: NDArray[np.float32]) -> NDArray[np.uint8]:
        """(..., 4) sRGB and alpha of values: beyond the ends their colours, NaN transparent."""
        out = np.empty((*values.shape, 4), np.uint8)
        known = np.isfinite(values)
        at = np.where(known, values, self.values[0])
        for band in range(3):
            out[..., band] = np.rint(255 * np.interp(at, self.values, self.colors[:, band]))
        out[..., 3] = np.where(known, 255, 0)
        return out


@dataclass(frozen=True)
class PaintedPixels:
    """Values of a raster as colours; `orogen.source.colours.Pixels`."""

    source: Source | Overview
    """The values: a source of heights, or an overview of one."""
    ramp: Stops
    """Their colours; not relative."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of an overview."""
        return self.source.shape  # type: ignore[union-attr]

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) worth reading at once."""
        return self.source.block  # type: ignore[union-attr]

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return self.source.direct  # type: ignore[union-attr]

    @property
    def overviews(self) -> tuple[PaintedPixels, ...]:
        """The raster's own overviews, painted, the finest first."""
        return tuple(PaintedPixels(overview, self.ramp) for overview in overviews_of(self.source))  # type: ignore[arg-type]

    def read(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """(rows, columns, 4) of a window."""
        return self.ramp.paint(self.source.read(rows, cols))  # type: ignore[arg-type]

    def overview(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """(rows, columns, 4) of all, decimated."""
        return self.ramp.paint(self.source.overview(shape))  # type: ignore[arg-type, union-attr]

    def close(self) -> None:
        """Release open files."""
        self.source.close()  # type: ignore[union-attr]


def open_painted(opener: Opener, data: Any, heights: Source, options: ColourOptions, ramp: Stops) -> Source:
    """The values of a raster of one band as colours over heights.

    A ramp without a range of its own spans 2 to 98 per cent of the values, as an overview of the raster has them.
    Values are painted first and warped then, so that classes are never mixed into others.
    """
    lies = _lies(opener, data)
    source = opener.open_height(data, HeightOptions(spacing=None if lies else 1.0, vertical_units="metre"))
    ramp = ramp.over(*_range(source)) if ramp.relative else ramp
    own = source.grid.crs or options.crs or heights.grid.crs
    grid = replace(source.grid, crs=own)
    if not lies:
        grid = drape(grid.width, grid.height, heights.grid, options.color_extent)
    mark = hashlib.sha256(ramp.values.tobytes() + ramp.colors.tobytes()).hexdigest()
    painted = ColourSource(
        pixels=PaintedPixels(source, ramp), grid=grid, name=source.name, dtype=source.dtype, units="",
        fingerprint=source.fingerprint and f"{source.fingerprint}|painted|{mark}|{grid.transform}",
        attribution=attribution_of(source),
    )  # fmt: skip
    target = heights.grid.crs
    if not lies or own is None or target is None:
        return painted
    if same_place(parse_crs(own), parse_crs(target)):
        return turned(replace(painted, grid=replace(grid, crs=target)), heights.grid, full_turn(parse_crs(target)))
    return WarpedSource(painted, warped_grid(grid, target, source.name))


def _lies(opener: Any, data: Any) -> bool:
    """Whether a raster says where it lies; else it is laid over the heights."""
    if opener is arrays:
        return False
    if opener is not files:
        return True
    with open_raster(data).handle() as dataset:
        return not dataset.transform.is_identity


def _range(source: Source) -> tuple[float, float]:
    """The ends of a ramp for a raster."""
    height, width = source.grid.shape
    values = source.overview((min(LOOKED, height), min(LOOKED, width)))
    valid = values[np.isfinite(values)]
    if not valid.size:
        raise SourceError(f"{source.name}: has no valid value, expected some to colour by; check nodata")
    low, high = (float(value) for value in np.percentile(valid, ENDS))
    return (low, high) if low < high else (low - 0.5, low + 0.5)
