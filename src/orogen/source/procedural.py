"""The endless terrain as a source: worked out for the window and the level that are asked for, nothing is stored."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.keys import NODE_SIZE, level_count, level_shape
from orogen.source.contract import Source
from orogen.source.heights import check_window
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.relief import TOP, ground, level_error, octaves_bound
from orogen.values import from_values

VERSION = 1
"""Changes with the heights that are made."""
LARGEST = 2**22
"""Rows and columns at most: positions on the GPU have no bits for more."""
NAME = "procedural"
PART = 512
"""Rows and columns that are worked out at once: those of a line as long as the raster would need many more around."""
NODE_STEPS = 6
"""Bounds of a node come from the level of which 4 samples lie along its side."""

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class ProceduralSettings:
    """Which terrain, and how much of it."""

    size: int = LARGEST
    """Rows and columns, 2 to 2^22, counted from the same upper left corner."""
    seed: int = 7
    """Each number is another terrain: 0 to 2^32 - 1."""

    def __post_init__(self) -> None:
        if not 2 <= self.size <= LARGEST:
            raise SourceError(f"procedural size: expected 2 to {LARGEST}, got {self.size}")
        if not 0 <= self.seed < 2**32:
            raise SourceError(f"procedural seed: expected 0 to {2**32 - 1}, got {self.seed}")


def recognises(data: Any) -> bool:
    """Whether the endless terrain is asked for: "procedural", or "procedural:seed=3,size=65536"."""
    return isinstance(data, str) and data.partition(":")[0] == NAME


def open_height(data: Any, options: HeightOptions) -> Source:
    """The endless terrain; no option changes it."""
    values = {}
    for item in filter(None, data.partition(":")[2].split(",")):
        key, found, value = item.partition("=")
        if not found:
            raise SourceError(f"{data}: expected settings such as seed=3, got {item!r}")
        values[key] = value
    return ProceduralSource(from_values(ProceduralSettings, NAME, values))


def open_colour(data: Any, heights: Source, options: ColourOptions) -> Source:
    """There is no such image."""
    raise SourceError(f"{NAME}: holds heights only, expected an image; leave color= out to colour it by height")


@dataclass(frozen=True)
class ProceduralLevels:
    """The levels of the endless terrain; `orogen.source.contract.Levels`.

    A level holds the octaves whose waves span at least 4 of its samples. Its surface is nowhere further than
    `relief.level_error` from that of level 0, so that its samples are as close to the means of those below.
    """

    shape: tuple[int, int]
    """(rows, columns) of level 0."""
    seed: int
    """Which terrain."""
    exact: bool = field(default=True, init=False)
    """Bounds are certain."""
    chunked: bool = field(default=False, init=False)
    """Only what is asked for is worked out."""

    def read(self, level: int, rows: slice, cols: slice) -> F32:
        """float32 metres (rows, columns) of a window of a level."""
        check_window(rows, cols, level_shape(self.shape, level), NAME)
        out = np.empty((rows.stop - rows.start, cols.stop - cols.start), np.float32)
        for top in range(rows.start, rows.stop, PART):
            for left in range(cols.start, cols.stop, PART):
                heights = ground(self.seed, level, top, min(top + PART, rows.stop), left, min(left + PART, cols.stop))
                row, col = top - rows.start, left - cols.start
                out[row : row + heights.shape[0], col : col + heights.shape[1]] = heights
        return out

    def read_coverage(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """255 everywhere."""
        return np.full((rows.stop - rows.start, cols.stop - cols.start), 255, np.uint8)

    def node_bounds(self, level: int, rows: slice, cols: slice) -> F32:
        """(node rows, node columns, 3) minimum, maximum and error (m) of a window of nodes: a little wide."""
        low, high = self._ranges(level, rows, cols)
        lowest, highest = self.height_range
        error = np.full(low.shape, level_error(level), np.float32)
        return np.stack([np.maximum(low, np.float32(lowest)), np.minimum(high, np.float32(highest)), error], axis=-1)

    @cached_property
    def height_range(self) -> tuple[float, float]:
        """Heights (m) that no sample of any level is outside of."""
        # from nodes that are 4 samples of a level of at most 1024 x 1024
        level = max(0, level_count(self.shape) - 9)
        low, high = self._ranges(level, *(slice(0, -(-n // NODE_SIZE)) for n in level_shape(self.shape, level)))
        ends = [(low.min(), high.max())]
        # levels that are coarser still may reach further than what becomes of them
        for coarser in range(min(level + NODE_STEPS, TOP), level_count(self.shape)):
            rows, cols = level_shape(self.shape, coarser)
            heights = ground(self.seed, coarser, 0, rows, 0, cols).astype(np.float32)
            ends.append((heights.min(), heights.max()))
        return float(min(end[0] for end in ends)), float(max(end[1] for end in ends))

    def _ranges(self, level: int, rows: slice, cols: slice) -> tuple[F32, F32]:
        """Heights (m) that no level-0 sample of a window of nodes is outside of: lowest, highest."""
        steps = max(0, min(NODE_STEPS, TOP - level))
        side, coarse = NODE_SIZE >> steps, level + steps
        # finer heights lie between those of the samples around them, give or take their octaves
        around = (rows.start * side - 1, rows.stop * side + 1, cols.start * side - 1, cols.stop * side + 1)
        heights = ground(self.seed, coarse, *around)
        low, high = _over_nodes(heights, side, np.minimum), _over_nodes(heights, side, np.maximum)
        slack = octaves_bound(coarse, high)
        slack += 1e-6 * np.maximum(np.abs(low), np.abs(high))  # float32 rounds
        return (low - slack).astype(np.float32), (high + slack).astype(np.float32)


def _over_nodes(heights: NDArray[np.float64], side: int, extreme: np.ufunc) -> NDArray[np.float64]:
    """Lowest or highest of each node's side x side samples and the ring around them."""
    for _ in range(2):
        lines = extreme(heights[:-2], extreme(heights[1:-1], heights[2:]))
        heights = extreme.reduceat(lines, np.arange(0, len(lines), side)).T
    return heights


@dataclass(frozen=True)
class ProceduralSource:
    """Mountains, valleys and plains, 1 m between samples; a `Source` that has its own levels.

    No CRS: x and y are metres from the lower left corner.
    """

    settings: ProceduralSettings = field(default_factory=ProceduralSettings)
    """Which terrain."""
    kind: Literal["height"] = field(default="height", init=False)
    name: str = field(default=NAME, init=False)
    dtype: str = field(default="float32", init=False)
    nodata: None = field(default=None, init=False)
    units: str = field(default="metre", init=False)
    vertical_crs: None = field(default=None, init=False)
    block: tuple[int, int] = field(default=(PART, PART), init=False)
    direct: bool = field(default=True, init=False)
    covered: bool = field(default=True, init=False)

    @cached_property
    def grid(self) -> Grid:
        """1 m between samples, no CRS."""
        size = self.settings.size
        return Grid(size, size, (1.0, 0.0, 0.0, 0.0, -1.0, float(size)))

    @cached_property
    def levels(self) -> ProceduralLevels:
        """Its own levels."""
        return ProceduralLevels(self.grid.shape, self.settings.seed)

    @property
    def fingerprint(self) -> str:
        """The version of the terrain and its settings."""
        return f"{NAME}-{VERSION}|{asdict(self.settings)}"

    def read(self, rows: slice, cols: slice) -> F32:
        """float32 metres (rows, columns) of a window of level 0."""
        return self.levels.read(0, rows, cols)

    def overview(self, shape: tuple[int, int]) -> F32:
        """The whole terrain at `shape` (rows, columns), from the coarsest level that has as many samples."""
        level = 0
        while all(n >= wanted for n, wanted in zip(level_shape(self.grid.shape, level + 1), shape, strict=True)):
            level += 1
        rows, cols = level_shape(self.grid.shape, level)
        index = [((np.arange(n) + 0.5) * m / n).astype(int) for n, m in zip(shape, (rows, cols), strict=True)]
        return self.levels.read(level, slice(0, rows), slice(0, cols))[np.ix_(*index)]

    def close(self) -> None:
        """Nothing is open."""
