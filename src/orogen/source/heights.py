"""Heights from an array in memory or from a raster file."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.contract import Quantum
from orogen.source.raster import RasterFile
from orogen.source.values import Values

MASKED = tuple[NDArray[Any], NDArray[np.bool_] | None]
"""Stored samples and where they are valid (None: everywhere)."""


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What is known of a raster besides its samples; see `Source`."""

    grid: Grid
    """Where it lies."""
    name: str
    """What messages call it."""
    dtype: str
    """Type of the stored samples."""
    units: str = "metre"
    """Vertical unit of the stored samples."""
    vertical_crs: str | None = None
    """Name of the vertical reference."""
    fingerprint: str | None = None
    """Changes with the samples."""
    covered: bool = False
    """Whether every sample is certainly valid."""
    attribution: str = ""
    """Who is to be named where the raster is shown."""


class Samples(Protocol):
    """Where stored samples come from."""

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) worth reading at once."""

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""

    @property
    def sequential(self) -> bool:
        """Whether it can only be read from its start."""

    @property
    def masked(self) -> bool:
        """Whether a mask says which samples are valid."""

    def read(self, rows: slice, cols: slice) -> MASKED:
        """The stored samples of a window."""

    def overview(self, shape: tuple[int, int]) -> MASKED:
        """The whole raster at `shape` (rows, columns), decimated."""

    def close(self) -> None:
        """Release open files."""


@dataclass(frozen=True)
class ArraySamples:
    """Stored samples in memory."""

    data: NDArray[Any]
    """(rows, columns)."""
    valid: NDArray[np.bool_] | None = None
    """(rows, columns), or None where all are valid."""
    block: tuple[int, int] = (512, 512)
    """(rows, columns) worth reading at once."""
    direct: bool = True
    """Small windows are cheap."""
    sequential: bool = False
    """They can be read from anywhere."""

    @property
    def masked(self) -> bool:
        """Whether a mask says which samples are valid."""
        return self.valid is not None

    def read(self, rows: slice, cols: slice) -> MASKED:
        """The stored samples of a window."""
        return self.data[rows, cols], None if self.valid is None else self.valid[rows, cols]

    def overview(self, shape: tuple[int, int]) -> MASKED:
        """Every n-th sample."""
        height, width = self.data.shape
        rows = ((np.arange(shape[0]) + 0.5) * height / shape[0]).astype(int)
        cols = ((np.arange(shape[1]) + 0.5) * width / shape[1]).astype(int)
        index = np.ix_(rows, cols)
        return self.data[index], None if self.valid is None else self.valid[index]

    def close(self) -> None:
        """Nothing is open."""


@dataclass(frozen=True)
class FileSamples:
    """Stored samples of a raster file."""

    file: RasterFile
    """The file."""
    shape: tuple[int, int]
    """(rows, columns)."""
    block: tuple[int, int]
    """(rows, columns) that GDAL reads at once."""
    direct: bool
    """Whether small windows are cheap."""
    masked: bool
    """Whether a mask or alpha band says which samples are valid."""
    sequential: bool = False
    """Whether it can only be read from its start."""
    packed: bool = False
    """Whether a sample is 65536 R + 256 G + B of the first three bands, not the first band."""

    def read(self, rows: slice, cols: slice, shape: tuple[int, int] | None = None) -> MASKED:
        """The stored samples of a window, decimated to `shape` where given."""
        valid = self.file.mask(rows, cols, shape) > 0 if self.masked else None
        if not self.packed:
            return self.file.read(1, rows, cols, shape), valid
        red, green, blue = self.file.read([1, 2, 3], rows, cols, shape).astype(np.int32)
        return (red << 16) + (green << 8) + blue, valid

    def overview(self, shape: tuple[int, int]) -> MASKED:
        """A decimated read, or the file's own overviews; two strips at once."""
        cols = slice(0, self.shape[1])
        strips = split(self.shape[0], self.block[0], shape[0])
        with ThreadPoolExecutor(2) as pool:
            parts = list(pool.map(lambda strip: self.read(strip[0], cols, (strip[1], shape[1])), strips))
        masks = [part[1] for part in parts if part[1] is not None]
        return np.concatenate([part[0] for part in parts]), np.concatenate(masks) if masks else None

    @cached_property
    def overviews(self) -> tuple[FileSamples, ...]:
        """The file's own overviews, the finest first."""
        return tuple(replace(self, file=file, shape=shape, block=block) for file, shape, block in self.file.overviews())

    def close(self) -> None:
        """Close idle file handles."""
        self.file.close()
        for overview in self.__dict__.get("overviews", ()):
            overview.close()


def split(size: int, block: int, count: int) -> list[tuple[slice, int]]:
    """Two strips of `size` rows that meet at a block edge, each with its share of `count` decimated rows."""
    middle = round(size / 2 / block) * block
    upper = round(count * middle / size)
    if not 0 < middle < size or not 0 < upper < count:
        return [(slice(0, size), count)]
    return [(slice(0, middle), upper), (slice(middle, size), count - upper)]


@dataclass(frozen=True, kw_only=True)
class HeightSource(Facts):
    """Heights in metres; a `Source`."""

    samples: Samples
    """Where the stored samples come from."""
    values: Values
    """How they become metres."""
    kind: Literal["height"] = field(default="height", init=False)
    """Heights."""

    @property
    def nodata(self) -> float | None:
        """The stored value that stands for nodata."""
        return self.values.nodata

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) that are cheapest to read."""
        return self.samples.block

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return self.samples.direct

    @property
    def quantum(self) -> Quantum | None:
        """What heights are whole numbers of, where integers are stored."""
        whole = np.dtype(self.dtype).kind in "iu"
        return Quantum(abs(self.values.scale), self.values.offset) if whole else None

    def read(self, rows: slice, cols: slice) -> NDArray[np.float32]:
        """float32 metres (rows, columns) of a window inside the raster, NaN = nodata."""
        check_window(rows, cols, self.grid.shape, self.name)
        return self.values.metres(*self.samples.read(rows, cols))

    def overview(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """float32 metres of the whole raster at `shape` (rows, columns), or its own shape where that is smaller."""
        height, width = self.grid.shape
        return self.values.metres(*self.samples.overview((min(shape[0], height), min(shape[1], width))))

    @property
    def overviews(self) -> tuple[HeightOverview, ...]:
        """Overviews of the samples, the finest first."""
        return tuple(HeightOverview(samples, self.values) for samples in getattr(self.samples, "overviews", ()))

    def close(self) -> None:
        """Release open files."""
        self.samples.close()


@dataclass(frozen=True)
class HeightOverview:
    """An overview of heights; `orogen.source.contract.Overview`."""

    samples: Any
    """Where the stored samples come from: with a shape."""
    values: Values
    """How they become metres."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.samples.shape

    def read(self, rows: slice, cols: slice) -> NDArray[np.float32]:
        """float32 metres (rows, columns) of a window, NaN = nodata."""
        return self.values.metres(*self.samples.read(rows, cols))


def check_window(rows: slice, cols: slice, shape: tuple[int, int], name: str) -> None:
    """SourceError where a window is empty, strided or reaches outside `shape`."""
    for axis, part, size in (("rows", rows, shape[0]), ("columns", cols, shape[1])):
        if part.step not in (None, 1) or not 0 <= part.start < part.stop <= size:
            raise SourceError(f"{name}: expected {axis} within 0 to {size}, got {part.start} to {part.stop}")
