"""Build a pyramid: each region of a level once, three levels at a time, in parallel, in bounded memory."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orogen.keys import NODE_SIZE, level_count, level_shape
from orogen.pyramid.journal import Journal
from orogen.pyramid.reduce import F32
from orogen.pyramid.region import Strips
from orogen.pyramid.regions import LEVELS, REGION, Region, regions
from orogen.pyramid.seams import Errors, put_inside, sew_above, sew_beside
from orogen.pyramid.store import Store
from orogen.pyramid.task import READ_ROWS, Cancelled, Job, Part, Recipe, make_region, node_facts, settle, write_level_0
from orogen.pyramid.workers import Workers, hired, threads
from orogen.source.contract import Source
from orogen.source.rounding import Rounding

__all__ = ["Builder", "Cancelled", "Estimate", "threads"]

SAMPLED = 3
"""Regions, at least, that an estimate is made from."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Estimate:
    """What is left of a build, extrapolated from the regions that are done."""

    seconds: float
    """Time still to go; NaN where nothing was left to measure it with."""
    size: int
    """Bytes of the whole pyramid."""


@dataclass
class Builder:
    """Fills a store with the pyramid of a source."""

    source: Source
    store: Store
    progress: Progress = lambda fraction: None
    """Called with 0 to 1 from any thread."""
    stop: threading.Event = field(default_factory=threading.Event)
    """Set it to end the build with `Cancelled`."""
    keep: bool = False
    """Whether to store level 0 even where the source gives small windows cheaply, and what an update needs."""
    rounding: Rounding | None = None
    """How heights are rounded; None: not at all."""
    recipe: Recipe | None = None
    """How workers in other processes open the source."""
    journal: Journal | None = None
    """Where to note what is done, so that a killed build goes on there; None: nowhere."""

    def __post_init__(self) -> None:
        self.shape = self.source.grid.shape
        self.levels = level_count(self.shape)
        self.job = Job(
            self.source, self.store, self.keep, self.rounding, self.recipe, tick=self._tick, stopped=self._stopped
        )
        self._lock = threading.Lock()
        self._failed = threading.Event()
        self._done = 0
        self._total = sum(r * c for r, c in (level_shape(self.shape, i) for i in range(0, self.levels, LEVELS)))
        self._total += 0 if self.source.direct else self.shape[0] * self.shape[1]
        self.grids = {base: regions(level_shape(self.shape, base)) for base in self.bases}
        """The regions of the levels that others are made from."""

    @property
    def bases(self) -> range:
        """The levels that others are made from."""
        return range(0, max(self.levels - 1, 1), LEVELS)

    def run(self, workers: Workers | None = None) -> dict[str, Any]:
        """Build all levels and bounds. Returns what the store's metadata says of the values.

        workers: who does it; None: threads. Raises `rounding.Overflow` where heights do not fit the rounding.
        """
        if workers is None:
            with hired() as hands:
                return self.run(hands)
        try:
            self.create()
            if not self.source.direct:
                self._copy(self.shape[0])
            nodes = np.zeros((*(-(-n // NODE_SIZE) for n in self.shape), 4), np.float32)
            errors: dict[int, Errors] = {}
            for base in self.bases:
                errors |= self._stage(base, nodes, workers)
        except BaseException:
            self._failed.set()  # for the tasks that still run
            raise
        return self.conclude(nodes, errors)

    def sample(self, workers: Workers) -> Estimate:
        """Do some regions first, spread over the raster, and extrapolate what is left. Needs a journal."""
        assert self.journal is not None
        self.create()
        start = time.perf_counter()
        before, progress = self._done, self.progress
        # what is done here counts as progress when the build goes through it
        self.progress = lambda fraction: None
        if not self.source.direct:
            self._copy(self.grids[0][0][0].rows.stop)
            rows = self.grids[0][:1]
        else:
            rows = self.grids[0]
        every = [(row, col) for row in range(len(rows)) for col in range(len(rows[0]))]
        wanted = min(len(every), max(SAMPLED, workers.count))
        chosen = [every[i] for i in sorted({int((n + 0.5) * len(every) / wanted) for n in range(wanted)})]
        left = [(row, col) for row, col in chosen if not self.journal.done(_name(0, row, col))]
        for _ in self._parts(0, left, workers):
            pass
        seconds, worked = time.perf_counter() - start, self._done - before
        done = sum(
            math.prod(region.shape)
            for row, line in enumerate(self.grids[0])
            for col, region in enumerate(line)
            if self.journal.done(_name(0, row, col))
        )
        written = sum(path.stat().st_size for path in self.store.path.rglob("*") if path.is_file())
        self._done, self.progress = before, progress
        rest = max(0, self._total - done - (0 if self.source.direct else done))
        return Estimate(
            seconds * rest / worked if worked else float("nan"),
            int(written * self.shape[0] * self.shape[1] / max(done, 1)),
        )

    def create(self) -> None:
        """Create the arrays; those that are there are kept."""
        if self.keep or not self.source.direct:
            self._array(0, (READ_ROWS if self.source.direct else self._copied_rows, REGION))
        for level in range(1, self.levels):
            side = REGION >> ((level - 1) % LEVELS + 1)
            self._array(level, (side, side))
            if self.job.keeps_coverage:
                shape = level_shape(self.shape, level)
                self.store.create(self.source.grid, level, "coverage", shape, "uint8", (side, side), 0)

    def conclude(self, nodes: F32, errors: dict[int, Errors]) -> dict[str, Any]:
        """Store the bounds of the nodes of all levels; returns what the store's metadata says of the values."""
        if self.source.kind == "colour":
            return {"kind": "colour"}
        low, high = nodes[..., 0], nodes[..., 1]
        error = np.zeros(low.shape, np.float32)
        for level in range(self.levels):
            if level:
                base = (level - 1) // LEVELS * LEVELS
                low, high = _parents(low, np.fmin), _parents(high, np.fmax)
                error = _parents(error, np.fmax) + errors[level].total(self.grids[base], level - base)
                if self.rounding is not None:  # the means that were compared have been rounded since
                    error += np.float32(self.rounding.step / 2)
            self.store.write_bounds(level, np.stack([low, high, error], axis=-1))
        if self.keep:
            fields = {"fields": ["minimum", "maximum", "valid", "rounded_by"], "units": "m"}
            self.store.write_table(0, "nodes", nodes, ["node_y", "node_x", "fact"], fields)
            for level, found in errors.items():
                found.save(self.store, level)
        facts = {
            "kind": "height",
            "covered": bool(nodes[..., 2].all()),
            "minimum": float(np.nanmin(nodes[..., 0])),
            "maximum": float(np.nanmax(nodes[..., 1])),
        }
        return facts if self.rounding is None else {**facts, "rounded_by": float(nodes[..., 3].max())}

    @property
    def _copied_rows(self) -> int:
        """Rows of the strips in which level 0 is copied."""
        return next(NODE_SIZE * n for n in (1, 2, 4) if n == 4 or NODE_SIZE * n >= self.source.block[0])

    def copy(self, rows: slice, cols: slice) -> F32:
        """Store a window of level 0; gives the facts of its nodes, nothing of colours."""
        samples = self.source.read(rows, cols)
        self.job.check()
        writing: list[Any] = []
        kept = write_level_0(self.job, rows, cols, samples, writing)
        settle(writing)
        if self.source.kind == "colour":
            return np.zeros((0, 0, 4), np.float32)
        return node_facts(kept, np.asarray(samples, np.float32))

    def _copy(self, stop: int) -> None:
        """Store level 0 of a source without cheap windows, in one pass from top to bottom, up to row `stop`."""
        rows, cols = self.shape
        for row in range(0, stop, self._copied_rows):
            part = slice(row, min(rows, row + self._copied_rows))
            if self.journal is None:
                self.copy(part, slice(0, cols))
            elif not self.journal.done(f"copy-{row}"):
                self.journal.save(f"copy-{row}", Part([], [], self.copy(part, slice(0, cols))))
            self._tick((part.stop - part.start) * cols)

    def _array(self, level: int, shard: tuple[int, int]) -> None:
        shape = level_shape(self.shape, level)
        if self.source.kind == "height":
            self.store.create(self.source.grid, level, "height", shape, "float32", shard, "NaN", self.rounding)
        else:
            self.store.create(self.source.grid, level, "colour", (*shape, 4), "uint8", shard, 0)

    def _stage(self, base: int, nodes: F32, workers: Workers) -> dict[int, Errors]:
        """Make the levels after `base`; fills `nodes` from the first stage."""
        grid, levels = self.grids[base], self.job.levels(base)
        heights = self.source.kind == "height"
        errors = {level: Errors.none(self.shape, level, grid) for level in levels}
        every = [(row, col) for row in range(len(grid)) for col in range(len(grid[0]))]
        above: list[F32] = []
        tops: list[list[F32]] = [[] for _ in levels]
        bottoms: list[list[F32]] = [[] for _ in levels]
        before: list[Strips] = []
        for (row, col), part in zip(every, self._parts(base, every, workers), strict=True):
            region = grid[row][col]
            if not heights:
                continue
            self.put(base, region, part, nodes, errors)
            for i, level in enumerate(levels):
                if col:
                    sew_beside(errors[level], region, col, before[i].right, part.strips[i].left, level, i + 1)
                tops[i].append(part.strips[i].top)
                bottoms[i].append(part.strips[i].bottom)
            before = part.strips
            if col == len(grid[0]) - 1:
                for i, level in enumerate(levels if row else ()):
                    sew_above(errors[level], row, above[i], np.concatenate(tops[i], axis=1), level)
                above = [np.concatenate(parts, axis=1) for parts in bottoms]
                tops, bottoms = [[] for _ in levels], [[] for _ in levels]
        if base == 0 and heights and self.journal is not None and not self.source.direct:
            self._recall_rounding(nodes)
        return errors

    def put(self, base: int, region: Region, part: Part, nodes: F32, errors: dict[int, Errors]) -> None:
        """Note what a task has handed back, but for the seams of its region."""
        if part.nodes is not None:
            top, left = region.rows.start // NODE_SIZE, region.cols.start // NODE_SIZE
            nodes[top : top + part.nodes.shape[0], left : left + part.nodes.shape[1]] = part.nodes
        for i, level in enumerate(self.job.levels(base)):
            put_inside(errors[level], region, i + 1, part.steps[i])

    def _recall_rounding(self, nodes: F32) -> None:
        """How far level 0 was rounded where it was copied: the regions have only seen the rounded heights."""
        assert self.journal is not None
        for row in range(0, self.shape[0], self._copied_rows):
            part = self.journal.load(f"copy-{row}")
            if part is not None and part.nodes is not None:
                nodes[row // NODE_SIZE :][: len(part.nodes), :, 3] = part.nodes[..., 3]

    def _parts(self, base: int, places: list[tuple[int, int]], workers: Workers) -> Iterator[Part]:
        """What the tasks of some regions hand back, in order: from the journal where they are done."""
        noted = {place for place in places if self.journal is not None and self.journal.done(_name(base, *place))}
        made = self._made(base, [place for place in places if place not in noted], workers)
        for place in places:
            if place not in noted:
                yield next(made)
                continue
            assert self.journal is not None
            part = self.journal.load(_name(base, *place))
            if part is None:  # a note that cannot be read
                yield next(self._made(base, [place], workers))
            else:
                self._tick(math.prod(self.grids[base][place[0]][place[1]].shape))
                yield part

    def _made(self, base: int, places: list[tuple[int, int]], workers: Workers) -> Iterator[Part]:
        """What the tasks of some regions hand back, in order; noted in the journal."""
        grid = self.grids[base]
        arguments: Iterable[tuple[Any, ...]] = ((self.job, grid[row][col], base) for row, col in places)
        for (row, col), part in zip(places, workers.in_order(make_region, arguments), strict=True):
            if self.journal is not None:
                self.journal.save(_name(base, row, col), part)
            if workers.remote:
                self.job.check()
                self._tick(math.prod(grid[row][col].shape))
            yield part

    def _stopped(self) -> bool:
        return self.stop.is_set() or self._failed.is_set()

    def _tick(self, samples: int) -> None:
        with self._lock:
            self._done += samples
            fraction = min(1.0, self._done / self._total)
        self.progress(fraction)


def _name(base: int, row: int, col: int) -> str:
    """What the journal calls a task."""
    return f"{base}-{row}-{col}"


def _parents(values: F32, reduce: np.ufunc) -> F32:
    """The minimum or maximum of 2 x 2 nodes."""
    rows, cols = values.shape
    padded = np.pad(values, ((0, rows % 2), (0, cols % 2)), constant_values=np.nan)
    quads = padded.reshape(-(-rows // 2), 2, -(-cols // 2), 2)
    return np.asarray(reduce.reduce(reduce.reduce(quads, axis=3), axis=1))
