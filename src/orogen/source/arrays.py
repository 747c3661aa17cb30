"""Arrays: numpy's, masked or big-endian ones too, and whatever else has a shape and a type and can be sliced."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.source.colours import ArrayColours, ColourSource, drape
from orogen.source.contract import Source
from orogen.source.georeference import make_grid
from orogen.source.heights import MASKED, ArraySamples, Facts, Samples
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.scale import parse_crs
from orogen.source.survey import survey
from orogen.source.values import METRES, Values, unit_name


def recognises(data: Any) -> bool:
    """Whether `data` is an array: of numpy, or like one of dask, zarr or h5py."""
    return isinstance(data, np.ndarray) or all(hasattr(data, name) for name in ("shape", "dtype", "__getitem__"))


def open_height(data: Any, options: HeightOptions) -> Source:
    """Heights of an array (rows, columns) of numbers."""
    samples, (height, width) = array_samples(data, "array")
    unit = unit_name(options.vertical_units or "metre")
    crs = parse_crs(options.crs) if options.crs else None
    grid = make_grid(width, height, None, crs, options.spacing, "array")
    facts = Facts(grid=grid, name="array", dtype=str(data.dtype), units=unit)
    values = Values(options.nodata).converted(options.height_scale, options.height_offset, METRES[unit])
    return survey(samples, values, facts, doubt=options.nodata is None)


def open_colour(data: Any, heights: Source, options: ColourOptions) -> Source:
    """Colours of an array (rows, columns[, 1 to 4 bands]) of uint8 or uint16."""
    pixels = ArrayColours.of(np.asarray(data))
    grid = drape(pixels.data.shape[1], pixels.data.shape[0], heights.grid, options.color_extent)
    return ColourSource(pixels=pixels, grid=grid, name="array", dtype=str(data.dtype), units="")


@dataclass(frozen=True)
class SlicedSamples:
    """Stored samples of an array that is not in memory: each window is computed or read when it is asked for."""

    data: Any
    """What can be sliced as (rows, columns)."""
    block: tuple[int, int] = (512, 512)
    """(rows, columns) worth reading at once."""
    direct: bool = field(default=False, init=False)
    """Nothing is known of the cost of small windows."""
    sequential: bool = field(default=False, init=False)
    """They can be read from anywhere."""
    masked: bool = field(default=False, init=False)
    """There is no mask."""

    def read(self, rows: slice, cols: slice) -> MASKED:
        """The stored samples of a window."""
        return np.asarray(self.data[rows, cols]), None

    def overview(self, shape: tuple[int, int]) -> MASKED:
        """Every n-th sample, row by row of blocks, so that never more than these is in memory."""
        height, width = self.data.shape
        rows = ((np.arange(shape[0]) + 0.5) * height / shape[0]).astype(int)
        cols = ((np.arange(shape[1]) + 0.5) * width / shape[1]).astype(int)
        parts: list[NDArray[Any]] = []
        for start in range(0, height, self.block[0]):
            wanted = rows[(rows >= start) & (rows < start + self.block[0])] - start
            if wanted.size:
                strip = np.asarray(self.data[start : min(height, start + self.block[0]), :])
                parts.append(strip[np.ix_(wanted, cols)])
        return np.concatenate(parts), None

    def close(self) -> None:
        """The array is the user's."""


def array_samples(data: Any, name: str) -> tuple[Samples, tuple[int, int]]:
    """The samples of an array and its (rows, columns); SourceError where they are no heights."""
    try:
        kind = np.dtype(data.dtype).kind
    except TypeError:
        kind = "?"
    if kind not in "iuf":
        raise SourceError(f"{name}: expected numbers as heights, got {data.dtype}")
    shape = tuple(data.shape)
    if len(shape) == 3 and shape[0] == 1:
        data, shape = data[0], shape[1:]
    if len(shape) != 2 or min(shape) < 1:
        raise SourceError(f"{name}: expected heights of shape (rows, columns), got {tuple(data.shape)}")
    if isinstance(data, np.ma.MaskedArray):
        return ArraySamples(data.data, ~np.ma.getmaskarray(data)), shape
    if isinstance(data, np.ndarray):
        return ArraySamples(data), shape
    chunks = getattr(data, "chunks", None)  # of dask all sizes along each axis, of zarr and h5py one
    block = tuple(c if isinstance(c, int) else max(c) for c in chunks) if chunks else (512, 512)
    return SlicedSamples(data, (block[-2], block[-1])), shape
