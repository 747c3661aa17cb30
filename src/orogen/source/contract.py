"""What a source of heights or colours offers to the rooms below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from orogen.grid import Grid

Kind = Literal["height", "colour"]


class Levels(Protocol):
    """Coarser levels that need no building, in the sizes of `keys.level_shape`. Safe to use from several threads."""

    @property
    def exact(self) -> bool:
        """Whether the bounds of nodes are certain; else levels and bounds are estimates of what building would give."""

    @property
    def chunked(self) -> bool:
        """Whether a window costs as much to read as all chunks (nodes) that it touches; else it costs what it holds."""

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest height (m); of heights only."""

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[np.float32] | NDArray[np.uint8]:
        """The samples of a window of a level, as `Source.read` gives those of level 0."""

    def read_coverage(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """The valid part, 0 to 255, of each sample of a window; of heights only."""

    def node_bounds(self, level: int, rows: slice, cols: slice) -> NDArray[np.float32] | None:
        """(node rows, node columns, 3) of a window of nodes: see `Pyramid.node_bounds`; None where unknown."""


class Overview(Protocol):
    """The whole of a source with fewer samples, evenly spread over the same area. Safe to use from several threads."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns): of any ratio to those of the source."""

    def read(self, rows: slice, cols: slice) -> NDArray[np.float32] | NDArray[np.uint8]:
        """The samples of a window, as `Source.read` gives those of the source."""


def levels_of(source: Source) -> Levels | None:
    """Levels that a source has itself (its attribute `levels`), or None."""
    return getattr(source, "levels", None)


def overviews_of(source: Source) -> Sequence[Overview]:
    """Overviews that a source has (its attribute `overviews`), the finest first; most have none."""
    return getattr(source, "overviews", ())


@dataclass(frozen=True)
class Quantum:
    """Heights that are whole numbers of a step above an offset, as stored integers are."""

    step: float
    """Metres, above 0."""
    offset: float = 0.0
    """Metres."""


def quantum_of(source: Source) -> Quantum | None:
    """What all heights of level 0 are whole numbers of (a source's attribute `quantum`), or None where unknown."""
    return getattr(source, "quantum", None)


def attribution_of(source: Source) -> str:
    """Who is to be named where a source is shown (its attribute `attribution`), or ""."""
    return str(getattr(source, "attribution", ""))


class Source(Protocol):
    """A raster of heights or colours, read by window. Safe to use from several threads at once."""

    @property
    def kind(self) -> Kind:
        """Whether `read` gives heights or colours."""

    @property
    def grid(self) -> Grid:
        """Where the raster lies. A colour source's transform is in the CRS of the heights that it is draped over."""

    @property
    def name(self) -> str:
        """What messages call it: a path, "array" or "synthetic"."""

    @property
    def dtype(self) -> str:
        """The type of the samples as stored, such as 'int16'."""

    @property
    def nodata(self) -> float | None:
        """The stored value that stands for nodata (before scale and offset), or None."""

    @property
    def units(self) -> str:
        """The vertical unit as stored, such as 'metre' or 'foot'; `read` gives metres whatever it is."""

    @property
    def vertical_crs(self) -> str | None:
        """Name of the vertical reference of a compound CRS, or None."""

    @property
    def block(self) -> tuple[int, int]:
        """(rows, columns) of the window that is cheapest to read."""

    @property
    def direct(self) -> bool:
        """Whether small windows anywhere are cheap to read; if not, the pyramid stores level 0 too."""

    @property
    def fingerprint(self) -> str | None:
        """Changes with every change of the samples that `read` gives; None where that cannot be known."""

    @property
    def covered(self) -> bool:
        """True where every sample is certainly valid."""

    def read(self, rows: slice, cols: slice) -> NDArray[np.float32] | NDArray[np.uint8]:
        """The samples of a window that lies inside the raster.

        Heights: float32 metres (rows, columns), NaN = nodata. Colours: uint8 (rows, columns, 4), sRGB red, green,
        blue and straight alpha, alpha 0 = nodata. Raises SourceError where the data cannot be read.
        """

    def overview(self, shape: tuple[int, int]) -> NDArray[np.float32] | NDArray[np.uint8]:
        """The whole raster at about `shape` (rows, columns), quickly: an estimate, of the same types as `read`."""

    def close(self) -> None:
        """Release open files. Reading afterwards opens them again."""
