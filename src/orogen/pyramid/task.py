"""What is done with one region of a level: a task that any thread, process or machine can run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.errors import OrogenError, SourceError
from orogen.keys import NODE_SIZE, level_count
from orogen.pyramid.reduce import F32, colour_means
from orogen.pyramid.region import BAND, HeightRegion, Strips
from orogen.pyramid.regions import LEVELS, Region, pieces
from orogen.pyramid.store import Store
from orogen.source.contract import Source
from orogen.source.open import open_colour, open_height
from orogen.source.rounding import Rounding
from orogen.source.sparse import certainly_empty

READ_ROWS = 512
"""Rows read at once, and rows of a shard of level 0."""


class Cancelled(OrogenError):
    """The build was told to stop."""


class Part(NamedTuple):
    """What a task hands back of its region; its means are written then."""

    steps: list[F32]
    """For each level that it made, (node rows, node columns): how far each node is from the level below."""
    strips: list[Strips]
    """For each level that it made, what the seams of the region need."""
    nodes: F32 | None = None
    """(node rows, node columns, 4) of level 0, where it was read: see `node_facts`."""


@dataclass(frozen=True)
class Recipe:
    """How data is opened, for other processes."""

    data: Any
    """What `open_height` or `open_colour` takes."""
    options: dict[str, Any]
    """Its options."""
    heights: Recipe | None = None
    """Of an image: the heights that it is draped over."""

    def open(self) -> Source:
        """Open it."""
        return open_height(self.data, **self.options) if self.heights is None else self.over(self.heights.open())

    def over(self, heights: Source) -> Source:
        """Open an image over heights that are open."""
        return open_colour(self.data, heights, **self.options)


@dataclass(frozen=True)
class Job:
    """What all tasks of a build share. In other processes the source is opened anew, once."""

    source: Source
    """What is built."""
    store: Store
    """Where it goes."""
    keep: bool = False
    """Whether level 0 is stored even where the source gives small windows cheaply."""
    rounding: Rounding | None = None
    """How heights are rounded; None: not at all."""
    recipe: Recipe | None = None
    """How other processes open the source; None: they cannot."""
    tick: Callable[[int], None] = field(default=lambda samples: None)
    """Called with the number of samples that have been worked on; not in other processes."""
    stopped: Callable[[], bool] = field(default=lambda: False)
    """Whether the tasks are to end with `Cancelled`; not in other processes."""

    def __reduce__(self) -> tuple[Any, ...]:
        assert self.recipe is not None
        assert self.source.fingerprint is not None
        return _reopened, (_Sealed(self.recipe, self.source.fingerprint), self.store.path, self.keep, self.rounding)

    @property
    def keeps_coverage(self) -> bool:
        """Whether nodata can occur."""
        return self.source.kind == "height" and not self.source.covered

    @property
    def copies(self) -> bool:
        """Whether the tasks of the first stage store level 0."""
        return self.keep and self.source.direct

    def levels(self, base: int) -> range:
        """The levels that are made from `base`."""
        return range(base + 1, min(base + LEVELS, level_count(self.source.grid.shape) - 1) + 1)

    def read(self, base: int, rows: slice, cols: slice) -> NDArray[Any]:
        """Samples of the level that tasks start from."""
        if base == 0 and self.source.direct:
            return self.source.read(rows, cols)
        return self.store.read(base, self.source.kind, rows, cols)

    def rounded(self, heights: F32) -> tuple[NDArray[Any], F32]:
        """Heights as they are stored, and as they will be read."""
        if self.rounding is None:
            return heights, heights
        raw = self.rounding.encode(heights)
        return raw, self.rounding.decode(raw)

    def check(self) -> None:
        """Raise Cancelled where the build was told to stop."""
        if self.stopped():
            raise Cancelled("the build of the pyramid was stopped")


class _Sealed:
    """A recipe with the fingerprint of what it must open; hashable, whatever the options are."""

    def __init__(self, recipe: Recipe, fingerprint: str) -> None:
        self.recipe, self.fingerprint = recipe, fingerprint

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Sealed) and (self.recipe, self.fingerprint) == (other.recipe, other.fingerprint)

    def __hash__(self) -> int:
        return hash(self.fingerprint)


@lru_cache(maxsize=4)
def _reopened(sealed: _Sealed, path: Path, keep: bool, rounding: Rounding | None) -> Job:
    source = sealed.recipe.open()
    if source.fingerprint != sealed.fingerprint:
        raise SourceError(
            f"{source.name}: is not the same on this worker as where the build was started; share the file, unchanged"
        )
    return Job(source, Store(path), keep, rounding, sealed.recipe)


def make_region(job: Job, region: Region, base: int) -> Part:
    """Make and write the levels after `base` in a region of it, and level 0 too where the job copies it."""
    if job.source.kind == "colour":
        return _colours(job, region, base)
    if base == 0 and certainly_empty(job.source, region.rows, region.cols):
        return _void(job, region)
    return _heights(job, region, base)


def differs(job: Job, region: Region) -> bool:
    """Whether level 0 of the source is not what is stored in a region."""
    for rows in pieces(region.rows.start, region.rows.stop, READ_ROWS, 4):
        job.check()
        stored = job.store.read(0, job.source.kind, rows, region.cols)
        new = job.source.read(rows, region.cols)
        job.tick(new.shape[0] * new.shape[1])
        if job.source.kind == "height":
            new = job.rounded(new)[1]  # type: ignore[arg-type]
        if not np.array_equal(new, stored, equal_nan=job.source.kind == "height"):
            return True
    return False


def write_level_0(job: Job, rows: slice, cols: slice, samples: NDArray[Any], writing: list[Any]) -> NDArray[Any]:
    """Begin to store samples of level 0; gives them as they will be read."""
    array = job.store.array(0, job.source.kind)
    if job.source.kind == "height":
        raw, samples = job.rounded(samples)
        writing.append(array[rows, cols].write(raw))
    else:
        writing.append(array[rows, cols].write(samples))
    return samples


def _heights(job: Job, region: Region, base: int) -> Part:
    levels = job.levels(base)
    parts = [
        HeightRegion(region.at(level - base - 1).shape, region.edges, not job.keeps_coverage, level) for level in levels
    ]
    nodes: list[F32] = []
    writing: list[Any] = []
    for rows, samples in _bands(job, region, base):
        heights = samples
        if base == 0:
            settle(writing)
            if job.copies:
                heights = write_level_0(job, rows, region.cols, samples, writing)
            nodes.append(node_facts(heights, samples))
        if parts:
            coverage = _coverage(job, base, heights, rows, region.cols)
            for piece in pieces(0, heights.shape[0], BAND, 4):
                parts[0].add(heights[piece], None if coverage is None else coverage[piece])
        job.tick(heights.size)
    strips = []
    for i, level in enumerate(levels):
        strips.append(parts[i].finish())
        means, coverage = _write(job, level, region.at(level - base), parts[i].means, parts[i].coverage, writing)
        if i + 1 < len(parts):
            for piece in pieces(0, len(means), BAND, 4):
                parts[i + 1].add(means[piece], None if coverage is None else coverage[piece])
    settle(writing)
    return Part([part.steps for part in parts], strips, np.concatenate(nodes) if nodes else None)


def _write(
    job: Job, level: int, region: Region, means: F32, coverage: NDArray[np.uint8] | None, writing: list[Any]
) -> tuple[F32, NDArray[np.uint8] | None]:
    """Begin to store the means of a region; gives them as they will be read: the next level is made of those."""
    raw, means = job.rounded(means)
    writing.append(job.store.array(level, "height")[region.rows, region.cols].write(raw))
    if coverage is not None:
        writing.append(job.store.array(level, "coverage")[region.rows, region.cols].write(coverage))
    return means, coverage


def _void(job: Job, region: Region) -> Part:
    """The same for a region of nodata alone."""
    steps, strips = [], []
    void = np.full((1, 1), np.nan, np.float32)
    raw, _ = job.rounded(void)
    if job.copies:
        job.store.write_void(0, "height", region.rows, region.cols, raw)
    for level in job.levels(0):
        part = region.at(level)
        rows, cols = region.at(level - 1).shape
        strips.append(Strips(*(np.broadcast_to(void, s) for s in ((2, cols), (2, cols), (rows, 2), (rows, 2)))))
        steps.append(np.zeros([-(-n // NODE_SIZE) for n in part.shape], np.float32))
        job.store.write_void(level, "height", part.rows, part.cols, raw)
        job.store.write_void(level, "coverage", part.rows, part.cols, np.zeros((1, 1), np.uint8))
    job.check()
    job.tick(region.shape[0] * region.shape[1])
    nodes = np.zeros([*(-(-n // NODE_SIZE) for n in region.shape), 4], np.float32)
    nodes[..., :2] = np.nan
    return Part(steps, strips, nodes)


def _colours(job: Job, region: Region, base: int) -> Part:
    levels = job.levels(base)
    bands: list[NDArray[np.uint8]] = []
    writing: list[Any] = []
    for rows, pixels in _bands(job, region, base):
        settle(writing)
        if base == 0 and job.copies:
            write_level_0(job, rows, region.cols, pixels, writing)
        if levels:
            bands.extend(colour_means(pixels[piece]) for piece in pieces(0, len(pixels), BAND, 2))
        job.tick(pixels.shape[0] * pixels.shape[1])
    settle(writing)
    if not levels:
        return Part([], [])
    means = np.concatenate(bands)
    for level in levels:
        window = region.at(level - base)
        job.store.array(level, "colour")[window.rows, window.cols].write(means).result()
        means = colour_means(means) if level < levels[-1] else means
    return Part([], [])


def _bands(job: Job, region: Region, base: int) -> Iterator[tuple[slice, NDArray[Any]]]:
    """(rows, samples) of a region, READ_ROWS rows at a time."""
    for rows in pieces(region.rows.start, region.rows.stop, READ_ROWS, 4):
        job.check()
        yield rows, job.read(base, rows, region.cols)


def _coverage(job: Job, base: int, heights: F32, rows: slice, cols: slice) -> NDArray[np.uint8] | None:
    if not job.keeps_coverage:
        return None
    if base == 0:
        return np.where(np.isnan(heights), np.uint8(0), np.uint8(255)) if np.isnan(heights.min()) else None
    return job.store.read(base, "coverage", rows, cols)


def node_facts(heights: F32, given: F32) -> F32:
    """(node rows, node columns, 4) of heights of level 0 as stored, from the first row of a node on.

    Minimum and maximum without nodata, 1 where every sample is valid, and how far `given`, the heights before they
    were rounded, are from them at most.
    """
    starts = np.arange(0, heights.shape[1], NODE_SIZE)
    found = np.zeros((-(-heights.shape[0] // NODE_SIZE), len(starts), 4), np.float32)
    for row, facts in enumerate(found):
        part = slice(row * NODE_SIZE, (row + 1) * NODE_SIZE)
        band = heights[part]
        low, high = band.min(axis=0), band.max(axis=0)
        valid = ~np.isnan(low)
        if not valid.all():
            low, high = np.fmin.reduce(band), np.fmax.reduce(band)
        facts[:, 0] = np.fmin.reduceat(low, starts)
        facts[:, 1] = np.fmax.reduceat(high, starts)
        facts[:, 2] = np.logical_and.reduceat(valid, starts)
        if given is not heights:
            facts[:, 3] = np.fmax.reduceat(np.fmax.reduce(np.abs(given[part] - band)), starts)
    np.nan_to_num(found[..., 3], copy=False)
    return found


def settle(writing: list[Any]) -> None:
    """Wait for all writes, then raise what one raised: nothing may be written after a failed build is removed."""
    failures = [error for error in (write.exception() for write in writing) if error is not None]
    writing.clear()
    if failures:
        raise failures[0]
