"""Colours from an array in memory or from an image file."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.heights import Facts, check_window, split
from orogen.source.raster import RasterFile


@dataclass(frozen=True)
class Bands:
    """How the bands of a file become red, green, blue and alpha."""

    colour: list[int]
    """One band (grey, or an index into the palette) or three."""
    palette: NDArray[np.uint8] | None = None
    """(256 or 65536, 4) RGBA of a palette image."""


class Pixels(Protocol):
    """Where pixels come from."""

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) worth reading at once."""

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""

    def read(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """(rows, columns, 4) of a window."""

    def overview(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """(rows, columns, 4) of all at `shape`, decimated."""

    def close(self) -> None:
        """Release open files."""


@dataclass(frozen=True)
class ArrayColours:
    """Pixels in memory."""

    data: NDArray[np.uint8]
    """(rows, columns, 4) RGBA."""
    block: tuple[int, int] = (512, 512)
    """(rows, columns) worth reading at once."""
    direct: bool = True
    """Small windows are cheap."""

    @classmethod
    def of(cls, data: NDArray[Any]) -> ArrayColours:
        """Pixels of an array (rows, columns[, 1 to 4 bands]) of uint8 or uint16."""
        pixels = data[..., None] if data.ndim == 2 else data
        if pixels.ndim != 3 or not 1 <= pixels.shape[2] <= 4 or min(pixels.shape) < 1:
            raise SourceError(f"array: expected colours of shape (rows, columns, 1 to 4), got {data.shape}")
        bands = list(eight_bits(np.moveaxis(pixels, 2, 0), "array"))
        alpha = bands.pop() if len(bands) in (2, 4) else np.full(bands[0].shape, 255, np.uint8)
        return cls(rgba(bands, alpha))

    def read(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """(rows, columns, 4) of a window."""
        return self.data[rows, cols]

    def overview(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """Every n-th pixel."""
        height, width = self.data.shape[:2]
        rows = ((np.arange(shape[0]) + 0.5) * height / shape[0]).astype(int)
        cols = ((np.arange(shape[1]) + 0.5) * width / shape[1]).astype(int)
        return self.data[np.ix_(rows, cols)]

    def close(self) -> None:
        """Nothing is open."""


@dataclass(frozen=True)
class FileColours:
    """Pixels of an image file."""

    file: RasterFile
    """The file."""
    shape: tuple[int, int]
    """(rows, columns)."""
    block: tuple[int, int]
    """(rows, columns) that GDAL reads at once."""
    direct: bool
    """Whether small windows are cheap."""
    bands: Bands
    """What its bands mean."""

    def read(self, rows: slice, cols: slice, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """(rows, columns, 4) of a window, decimated to `shape` where given."""
        raw = self.file.read(self.bands.colour, rows, cols, shape)
        valid = self.file.alpha(rows, cols, shape)
        if self.bands.palette is not None:
            pixels = self.bands.palette[raw[0]]
            pixels[..., 3] = np.minimum(pixels[..., 3], valid)
            return pixels
        return rgba(list(eight_bits(raw, self.file.path)), valid)

    def overview(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """A decimated read, or the file's own overviews; two strips at once."""
        cols = slice(0, self.shape[1])
        strips = split(self.shape[0], self.block[0], shape[0])
        with ThreadPoolExecutor(2) as pool:
            return np.concatenate(list(pool.map(lambda s: self.read(s[0], cols, (s[1], shape[1])), strips)))

    @cached_property
    def overviews(self) -> tuple[FileColours, ...]:
        """The file's own overviews, the finest first."""
        return tuple(replace(self, file=file, shape=shape, block=block) for file, shape, block in self.file.overviews())

    def close(self) -> None:
        """Close idle file handles."""
        self.file.close()
        for overview in self.__dict__.get("overviews", ()):
            overview.close()


@dataclass(frozen=True, kw_only=True)
class ColourSource(Facts):
    """sRGB colours with straight alpha; a `Source`."""

    pixels: Pixels
    """Where the pixels come from."""
    nodata: float | None = field(default=None, init=False)
    """Nodata pixels have alpha 0."""
    kind: Literal["colour"] = field(default="colour", init=False)
    """Colours."""

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) that are cheapest to read."""
        return self.pixels.block

    @property
    def direct(self) -> bool:
        """Whether small windows are cheap."""
        return self.pixels.direct

    def read(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """uint8 (rows, columns, 4) of a window inside the raster."""
        check_window(rows, cols, self.grid.shape, self.name)
        return self.pixels.read(rows, cols)

    def overview(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """uint8 (rows, columns, 4) of the whole raster at `shape` (rows, columns), or its own where that is smaller."""
        height, width = self.grid.shape
        return self.pixels.overview((min(shape[0], height), min(shape[1], width)))

    @property
    def overviews(self) -> tuple[FileColours, ...]:
        """Overviews of the pixels, the finest first."""
        return getattr(self.pixels, "overviews", ())

    def close(self) -> None:
        """Release open files."""
        self.pixels.close()


def drape(width: int, height: int, heights: Grid, extent: str) -> Grid:
    """The grid of an image without georeference over the pixel area or the hull of the samples of `heights`."""
    a, b, _, d, e, _ = heights.transform
    inset = 0.5 if extent == "samples" else 0.0
    if extent == "samples" and min(heights.shape) < 2:
        raise SourceError(f"color_extent='samples': expected at least 2 x 2 heights, got {heights.shape}")
    sx, sy = (heights.width - 2 * inset) / width, (heights.height - 2 * inset) / height
    x, y = heights.to_crs(inset, inset)
    return Grid(width, height, (a * sx, b * sy, float(x), d * sx, e * sy, float(y)), heights.crs, heights.ground_scale)


def picture_bands(dataset: Any, path: str) -> tuple[Bands, str]:
    """Which bands of a dataset make the picture, and their type."""
    dtype = dataset.dtypes[0]
    if dtype not in ("uint8", "uint16"):
        raise SourceError(
            f"{path}: expected colours of type uint8 or uint16, got {dtype}; convert it (gdal_translate -ot Byte)"
        )
    names = [interpretation.name for interpretation in dataset.colorinterp]
    if {"red", "green", "blue"} <= set(names):
        return Bands([names.index(name) + 1 for name in ("red", "green", "blue")]), dtype
    if names[0] == "palette":
        palette = np.zeros((256 if dtype == "uint8" else 65536, 4), np.uint8)
        for index, entry in dataset.colormap(1).items():
            palette[index] = entry
        return Bands([1], palette), dtype
    colours = [i + 1 for i, name in enumerate(names) if name != "alpha"]
    return Bands(colours[:3] if len(colours) >= 3 else colours[:1]), dtype


def eight_bits(raw: NDArray[Any], name: str) -> NDArray[np.uint8]:
    """uint8 of uint8 or uint16 samples (65535 becomes 255)."""
    if raw.dtype == np.uint8:
        return raw
    if raw.dtype == np.uint16:
        return ((raw.astype(np.uint32) + 128) // 257).astype(np.uint8)
    raise SourceError(f"{name}: expected colours of type uint8 or uint16, got {raw.dtype}")


def rgba(bands: list[NDArray[np.uint8]], alpha: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(rows, columns, 4) of one (grey) or three bands (rows, columns) and alpha."""
    pixels = np.empty((*alpha.shape, 4), np.uint8)
    for i in range(3):
        pixels[..., i] = bands[i if len(bands) > 1 else 0]
    pixels[..., 3] = alpha
    return pixels
