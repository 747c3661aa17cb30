"""Build a pyramid: each region of a level once, three levels at a time, in parallel, in bounded memory."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import OrogenError
from orogen.keys import NODE_SIZE, level_count, level_shape
from orogen.pyramid.reduce import F32, colour_means
from orogen.pyramid.region import BAND, Edges, HeightRegion, Strips, seam_errors
from orogen.pyramid.store import Store
from orogen.source.contract import Source

REGION = 2048
"""Rows and columns of a region in its finest level: its means are whole shards of the next levels."""
LEVELS = 3
"""Levels made from one reading of a region."""
READ_ROWS = 512
"""Rows read at once."""
LEAST = 1 << LEVELS
"""Regions of no more rows or columns than this join the one before, so that every level has two of them."""

Progress = Callable[[float], None]


class Cancelled(OrogenError):
    """The build was told to stop."""


@dataclass(frozen=True)
class Region:
    """A part of a level, in its rows and columns."""

    rows: slice
    cols: slice
    edges: Edges

    def at(self, steps: int) -> Region:
        """The same part of the level `steps` coarser."""

        def halved(part: slice) -> slice:
            return slice(part.start >> steps, -(-part.stop >> steps))

        return Region(halved(self.rows), halved(self.cols), self.edges)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows.stop - self.rows.start, self.cols.stop - self.cols.start


@dataclass
class Builder:
    """Fills a store with the pyramid of a source."""

    source: Source
    store: Store
    progress: Progress = lambda fraction: None
    """Called with 0 to 1 from any thread."""
    stop: threading.Event = field(default_factory=threading.Event)
    """Set it to end the build with `Cancelled`."""

    def __post_init__(self) -> None:
        self.shape = self.source.grid.shape
        self.levels = level_count(self.shape)
        self.name = self.source.kind
        self._lock = threading.Lock()
        self._done = 0
        self._total = sum(r * c for r, c in (level_shape(self.shape, i) for i in range(0, self.levels, LEVELS)))
        self._total += 0 if self.source.direct else self.shape[0] * self.shape[1]
        self._errors = [
            np.zeros((-(-rows // NODE_SIZE), -(-cols // NODE_SIZE)), np.float32)
            for rows, cols in (level_shape(self.shape, level) for level in range(self.levels))
        ]
        self._range = np.full((*self._errors[0].shape, 2), np.nan, np.float32)
        self._complete = True

    def run(self) -> dict[str, Any]:
        """Build all levels and bounds. Returns what the store's metadata says of the values."""
        if not self.source.direct:
            self._copy()
        self._create()
        for base in range(0, max(self.levels - 1, 1), LEVELS):
            self._stage(base)
        if self.source.kind == "colour":
            return {"kind": "colour"}
        self._bounds()
        low, high = np.nanmin(self._range[..., 0]), np.nanmax(self._range[..., 1])
        return {"kind": "height", "covered": self._complete, "minimum": float(low), "maximum": float(high)}

    def _copy(self) -> None:
        """Store level 0 of a source without cheap windows, in one pass from top to bottom."""
        rows, cols = self.shape
        block = self.source.block[0]
        step = NODE_SIZE * min(4, max(1, -(-block // NODE_SIZE)))
        array = self._array(0, (step, REGION))
        writing: list[Any] = []
        try:
            for row in range(0, rows, step):
                part = slice(row, min(rows, row + step))
                strip = self.source.read(part, slice(0, cols))
                settle(writing)
                if self.stop.is_set():
                    raise Cancelled("the build of the pyramid was stopped")
                writing.append(array[part].write(strip))
                self._tick((part.stop - part.start) * cols)
        finally:
            settle(writing)

    def _create(self) -> None:
        for level in range(1, self.levels):
            side = REGION >> ((level - 1) % LEVELS + 1)
            self._array(level, (side, side))
            if self._keeps_coverage:
                shape = level_shape(self.shape, level)
                self.store.create(self.source.grid, level, "coverage", shape, "uint8", (side, side), 0)

    def _array(self, level: int, shard: tuple[int, int]) -> Any:
        shape = level_shape(self.shape, level)
        if self.name == "height":
            return self.store.create(self.source.grid, level, "height", shape, "float32", shard, "NaN")
        return self.store.create(self.source.grid, level, "colour", (*shape, 4), "uint8", shard, 0)

    @property
    def _keeps_coverage(self) -> bool:
        return self.source.kind == "height" and not self.source.covered

    def _stage(self, base: int) -> None:
        """The levels after `base`, from `base`."""
        levels = range(base + 1, min(base + LEVELS, self.levels - 1) + 1)
        grid = regions(level_shape(self.shape, base))
        task = self._heights if self.source.kind == "height" else self._colours
        above: list[list[Strips]] = []
        with ThreadPoolExecutor(threads(), "orogen-build") as pool:
            try:
                for row, results in zip(grid, _in_order(pool, task, grid, base, levels), strict=True):
                    if self.source.kind == "height":
                        self._seams(row, results, above, levels)
                        above = results
            except BaseException:
                self.stop.set()
                raise

    def _heights(self, region: Region, base: int, levels: range) -> list[Strips]:
        """The means of a region for all `levels`, written; the strips along its seams for each of them."""
        parts = [
            HeightRegion(region.at(level - base - 1).shape, region.edges, not self._keeps_coverage, level)
            for level in levels
        ]
        strips = []
        for row, heights in self._bands(region, base):
            if base == 0:
                self._keep_range(heights, row, region.cols.start)
            if parts:
                coverage = self._coverage(base, heights, row, region.cols)
                for piece in pieces(0, heights.shape[0], BAND, 4):
                    parts[0].add(heights[piece], None if coverage is None else coverage[piece])
            self._tick(heights.size)
        writing: list[Any] = []
        for i, level in enumerate(levels):
            strips.append(parts[i].finish())
            self._write(level, region.at(level - base), parts[i], writing)
            if i + 1 < len(parts):
                means, coverage = parts[i].means, parts[i].coverage
                for piece in pieces(0, len(means), BAND, 4):
                    parts[i + 1].add(means[piece], None if coverage is None else coverage[piece])
        settle(writing)
        return strips

    def _write(self, level: int, region: Region, part: HeightRegion, writing: list[Any]) -> None:
        window = region.rows, region.cols
        writing.append(self.store.array(level, "height")[window].write(part.means))
        if part.coverage is not None:
            writing.append(self.store.array(level, "coverage")[window].write(part.coverage))
        row, col = region.rows.start // NODE_SIZE, region.cols.start // NODE_SIZE
        rows, cols = part.steps.shape
        self._raise(level, slice(row, row + rows), slice(col, col + cols), part.steps)

    def _colours(self, region: Region, base: int, levels: range) -> list[Strips]:
        """The means of a region of colours for all `levels`, written."""
        if not levels:
            return []
        bands: list[NDArray[np.uint8]] = []
        for _, pixels in self._bands(region, base):
            bands.extend(colour_means(pixels[piece]) for piece in pieces(0, len(pixels), BAND, 2))
            self._tick(pixels.shape[0] * pixels.shape[1])
        means = np.concatenate(bands)
        for level in levels:
            window = region.at(level - base)
            self.store.array(level, "colour")[window.rows, window.cols].write(means).result()
            means = colour_means(means) if level < levels[-1] else means
        return []

    def _bands(self, region: Region, base: int) -> Iterator[tuple[int, NDArray[Any]]]:
        """(first row, samples) of a region, READ_ROWS rows at a time."""
        for rows in pieces(region.rows.start, region.rows.stop, READ_ROWS, 4):
            if self.stop.is_set():
                raise Cancelled("the build of the pyramid was stopped")
            if base == 0 and self.source.direct:
                yield rows.start, self.source.read(rows, region.cols)
            else:
                yield rows.start, self.store.read(base, self.name, rows, region.cols)

    def _coverage(self, base: int, heights: F32, row: int, cols: slice) -> NDArray[np.uint8] | None:
        if not self._keeps_coverage:
            return None
        if base == 0:
            return np.where(np.isnan(heights), np.uint8(0), np.uint8(255)) if np.isnan(heights.min()) else None
        return self.store.read(base, "coverage", slice(row, row + heights.shape[0]), cols)

    def _seams(self, row: list[Region], below: list[list[Strips]], above: list[list[Strips]], levels: range) -> None:
        """Errors along the seams between the regions of a row, and between them and the row above."""
        for i, level in enumerate(levels):
            steps = self._errors[level]
            first = row[0].at(i + 1).rows.start // NODE_SIZE
            for region, left, right in zip(row[1:], below, below[1:], strict=False):
                edges = region.edges
                count = -(-region.at(i + 1).shape[0] // NODE_SIZE)
                errors = seam_errors(left[i].right.T, right[i].left.T, count, edges.top, edges.bottom, level)
                col = region.at(i + 1).cols.start // NODE_SIZE
                self._raise(level, slice(first, first + count), slice(col - 1, col + 1), errors[:, None])
            if above:
                upper = np.concatenate([strips[i].bottom for strips in above], axis=1)
                lower = np.concatenate([strips[i].top for strips in below], axis=1)
                errors = seam_errors(upper, lower, steps.shape[1], True, True, level)
                self._raise(level, slice(first - 1, first + 1), slice(None), errors)

    def _raise(self, level: int, rows: slice, cols: slice, errors: F32) -> None:
        with self._lock:
            part = self._errors[level][rows, cols]
            np.fmax(part, errors, out=part)

    def _keep_range(self, heights: F32, row: int, col: int) -> None:
        """Minimum and maximum of the level-0 nodes in a band."""
        for r in range(0, heights.shape[0], NODE_SIZE):
            band = heights[r : r + NODE_SIZE]
            low, high = band.min(axis=0), band.max(axis=0)
            starts = np.arange(0, band.shape[1], NODE_SIZE)
            if np.isnan(low.min()):
                self._complete = False
                low, high = np.fmin.reduce(band), np.fmax.reduce(band)
            y, x = (row + r) // NODE_SIZE, col // NODE_SIZE
            self._range[y, x : x + len(starts), 0] = np.fmin.reduceat(low, starts)
            self._range[y, x : x + len(starts), 1] = np.fmax.reduceat(high, starts)

    def _bounds(self) -> None:
        """Store the bounds of the nodes of all levels."""
        low, high = self._range[..., 0], self._range[..., 1]
        error = self._errors[0]
        for level in range(self.levels):
            if level:
                low, high = _parents(low, np.fmin), _parents(high, np.fmax)
                error = _parents(error, np.fmax) + self._errors[level]
            self.store.write_bounds(level, np.stack([low, high, error], axis=-1))

    def _tick(self, samples: int) -> None:
        with self._lock:
            self._done += samples
            fraction = min(1.0, self._done / self._total)
        self.progress(fraction)


def settle(writing: list[Any]) -> None:
    """Wait for all writes, then raise what one raised: nothing may be written after a failed build is removed."""
    failures = [error for error in (write.exception() for write in writing) if error is not None]
    writing.clear()
    if failures:
        raise failures[0]


def threads() -> int:
    """Threads that build: one for each processor core, 2 to 8."""
    return min(8, max(2, os.cpu_count() or 2))


def pieces(start: int, stop: int, step: int, least: int) -> list[slice]:
    """start to stop in steps; a last piece of fewer than `least` joins the one before."""
    starts = list(range(start, stop, step))
    if len(starts) > 1 and stop - starts[-1] < least:
        starts.pop()
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], stop], strict=True)]


def regions(shape: tuple[int, int]) -> list[list[Region]]:
    """Rows of regions that cover a level of `shape`; no two share a shard of a coarser level."""
    rows = pieces(0, shape[0], REGION, LEAST + 1)
    cols = pieces(0, shape[1], REGION, LEAST + 1)
    return [
        [Region(r, c, Edges(r.start == 0, r.stop == shape[0], c.start == 0, c.stop == shape[1])) for c in cols]
        for r in rows
    ]


def _in_order(
    pool: ThreadPoolExecutor,
    task: Callable[[Region, int, range], list[Strips]],
    grid: list[list[Region]],
    base: int,
    levels: range,
) -> Iterator[list[list[Strips]]]:
    """The results of each row of regions; only a few tasks wait in the pool."""
    waiting: deque[Future[list[Strips]]] = deque()
    queue = deque(region for row in grid for region in row)
    for row in grid:
        results = []
        for _ in row:
            while queue and len(waiting) <= threads():
                waiting.append(pool.submit(task, queue.popleft(), base, levels))
            results.append(waiting.popleft().result())
        yield results


def _parents(values: F32, reduce: np.ufunc) -> F32:
    """The minimum or maximum of 2 x 2 nodes."""
    rows, cols = values.shape
    padded = np.pad(values, ((0, rows % 2), (0, cols % 2)), constant_values=np.nan)
    quads = padded.reshape(-(-rows // 2), 2, -(-cols // 2), 2)
    return np.asarray(reduce.reduce(reduce.reduce(quads, axis=3), axis=1))
