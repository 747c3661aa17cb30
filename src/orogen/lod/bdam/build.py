"""Building all levels of patches from the bottom up, in parallel."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.lod.bdam.diamonds import Diamonds, Ints
from orogen.lod.bdam.ground import TILE as CELLS_TILE
from orogen.lod.bdam.ground import Ground, cell_shape, corners_of_surface, measure
from orogen.lod.bdam.pages import full_page
from orogen.lod.bdam.store import Draft, Level
from orogen.pyramid.build import threads
from orogen.streaming.samples import Samples

log = logging.getLogger("orogen")

BLOCK = 512
"""Samples along the blocks whose diamonds are made by one task, unless diamonds themselves are larger."""
_TILE = 1024
"""Samples along the windows in which diamonds are measured."""
_WAITING = 8
"""Tasks for each thread that are handed to it at once; their results are kept in memory until they are written."""

Words = NDArray[np.uint32]
Batch = tuple[Ints, Ints]
"""cx, cy of diamonds."""
Made = tuple[Batch, list[tuple[Words, Words]], NDArray[np.float64]]
"""A batch, pages of both sides, errors in metres."""


class Builder:
    """Makes the patches of a terrain."""

    def __init__(self, samples: Samples, diamonds: Diamonds, draft: Draft) -> None:
        self._samples = samples
        self._diamonds = diamonds
        self._draft = draft
        self._started = self._said = time.monotonic()

    def run(self) -> None:
        """Fill the draft. Raises SettingsError where a package is missing, and what reading samples raises."""
        try:
            import dask
            import numba  # noqa: F401
        except ImportError as error:
            raise SettingsError(
                f'bdam: expected the packages dask and numba, {error}; run: pip install "orogen[compiled]"'
            ) from error
        self._samples.wait()
        log.info("bdam: making the patches of %d samples", np.prod(self._samples.shape))
        self._dask: Any = dask
        rows, columns = self._samples.shape
        if min(rows, columns) < 2:
            # no triangle is on it
            self._draft.finish(np.zeros((1, 1, 3), np.float32), [])
            return
        cells = np.zeros((*cell_shape(self._samples), 3), np.float32)
        places = [(y, x) for y in range(0, rows - 1, CELLS_TILE) for x in range(0, columns - 1, CELLS_TILE)]
        for _ in self._in_parallel(lambda place: measure(self._samples, cells, *place), places):
            pass
        ground = Ground(self._diamonds, cells)
        levels: list[Level] = []
        shares = [0.5**level for level in range(self._diamonds.top)]
        for level in range(1, self._diamonds.top + 1):
            before, here = sum(shares[: level - 1]) / sum(shares), shares[level - 1] / sum(shares)
            levels.append(self._level(level, levels, ground, before, here))
        self._draft.finish(cells, levels)
        log.info("bdam: %d samples made into patches in %.1f s", rows * columns, time.monotonic() - self._started)

    def _level(self, level: int, below: list[Level], ground: Ground, before: float, here: float) -> Level:
        """One level from the one below. `before`, `here`: parts of all work, for the log."""
        diamonds = self._diamonds
        rows, columns = diamonds.shape(level)
        starts, errors = np.full((rows, columns, 2), -1, np.int64), np.zeros((rows, columns), np.float32)
        written = self._draft.level(level)
        batches = list(self._batches(level))
        tasks = self._in_parallel(lambda batch: self._make(level, batch, below[-1] if below else None), batches)
        for done, ((cx, cy), pages, found) in enumerate(tasks):
            for x, y, both in zip(cx.tolist(), cy.tolist(), pages, strict=True):
                for side, page in enumerate(both):
                    if page[0]:
                        starts[y, x, side] = written.add(page)
            # saturated: no less than in any part, so that nothing is split before what it is a part of
            found = np.maximum(found, self._errors_of_parts(level, (cx, cy), below, ground))
            # rounded up: a bound it must stay
            errors[cy, cx] = np.nextafter(found.astype(np.float32), np.float32(np.inf))
            if time.monotonic() > self._said + 2:
                self._said = time.monotonic()
                log.info("bdam: %d %% of the patches made", 100 * (before + here * (done + 1) / len(batches)))
        return Level(written.finish(), starts, errors)

    def _errors_of_parts(self, level: int, batch: Batch, below: list[Level], ground: Ground) -> NDArray[np.float64]:
        """Largest error of the diamonds that each diamond is split into parts of."""
        x, y, side = self._diamonds.children(level, *batch)
        there = self._diamonds.exists(level - 1, x.ravel(), y.ravel(), side.ravel()).reshape(x.shape)
        parts = np.zeros(x.shape)
        place = x[there], y[there]
        parts[there] = below[-1].errors[place[::-1]] if below else ground.errors(0, *place)
        return parts.max(axis=1)

    def _batches(self, level: int) -> Iterator[Batch]:
        """A level's diamonds, block by block."""
        cx, cy = self._diamonds.over_raster(level)
        half = self._diamonds.half(level) >> self._diamonds.bits
        side = max(1, BLOCK // half)
        blocks = (cy // side) << 32 | cx // side
        order = np.argsort(blocks, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(blocks[order])) + 1):
            yield cx[part], cy[part]

    def _make(self, level: int, batch: Batch, below: Level | None) -> Made:
        """Simplify the diamonds of a batch, and measure them against all samples."""
        from orogen.lod.bdam.kernels import deviation

        bits = self._diamonds.bits
        half = self._diamonds.half(level) >> bits
        centres = np.stack(batch, axis=1) * half
        low = np.maximum(centres.min(axis=0) - half, 0)
        high = np.minimum(centres.max(axis=0) + half, self._diamonds.last)
        halves = *np.repeat(batch, 2, axis=1), np.tile([0, 1], len(centres))
        # columns and rows of the samples that the places of a page count from
        corners = (self._diamonds.corners(level, *halves).min(axis=1) >> bits).reshape(-1, 2, 2)
        apexes = np.stack(self._diamonds.apex(level, *halves), axis=1)[1::2]
        pages: list[tuple[Words, Words]] = []
        errors = np.zeros(len(centres))
        for top in range(low[1], high[1], _TILE):
            for left in range(low[0], high[0], _TILE):
                rows = slice(top, min(top + _TILE, int(high[1])) + 1)
                columns = slice(left, min(left + _TILE, int(high[0])) + 1)
                window, valid = self._samples.window(rows, columns)
                window = np.ascontiguousarray(window)
                if not pages:
                    # made of samples only where the first window holds the whole batch
                    parts = self._parts(level, batch, below, (window, left, top))
                    pages = [self._halved(level, *each) for each in zip(parts, centres, apexes, corners, strict=True)]
                counts = corners_of_surface(valid, window.shape)
                counts = np.zeros((0, 0), bool) if counts is None else counts
                for i, both in enumerate(pages):
                    for page, (column, row) in zip(both, corners[i].tolist(), strict=True):
                        errors[i] = max(float(errors[i]), deviation(page, column, row, window, counts, left, top))
        return batch, pages, errors

    def _parts(
        self, level: int, batch: Batch, below: Level | None, window: tuple[NDArray[np.float32], int, int]
    ) -> Iterator[tuple[list[Words], Ints]]:
        """What each diamond of a batch is split into: pages of the level below, and their places in samples."""
        diamonds = self._diamonds
        x, y, side = (values.ravel() for values in diamonds.children(level, *batch))
        there = diamonds.exists(level - 1, x, y, side).reshape(-1, 4)
        corners = diamonds.corners(level - 1, x, y, side)
        places = corners.min(axis=1) >> diamonds.bits
        for i, exist in enumerate(there):
            chosen = 4 * i + np.flatnonzero(exist)
            if below is None:
                pages = [full_page(diamonds, 0, patch, *window) for patch in corners[chosen]]
            else:
                pages = [below.page(x[k], y[k], side[k]) for k in chosen]
            yield pages, places[chosen]

    def _halved(
        self, level: int, parts: tuple[list[Words], Ints], centre: Ints, apex: Ints, corners: Ints
    ) -> tuple[Words, Words]:
        """The two pages of a diamond from those that it is split into."""
        from orogen.lod.bdam.kernels import halve

        diamonds, (pages, places) = self._diamonds, parts
        n, half = diamonds.n, diamonds.half(level) >> diamonds.bits
        starts = np.cumsum([0, *(len(page) for page in pages[:-1])])
        edges = np.array([0, diamonds.last[0], 0, diamonds.last[1]]) - centre.repeat(2)
        return halve(
            np.concatenate(pages), starts, places - centre, half, bool(level % 2), int(apex[0]), int(apex[1]), edges,
            n * n, 2 * n, corners - centre,
        )  # fmt: skip

    def _in_parallel(self, function: Callable[[Any], Any], arguments: list[Any]) -> Iterator[Any]:
        """Results in order; only some tasks are under way or waiting to be taken."""
        rest = iter(arguments)
        while some := list(islice(rest, _WAITING * threads())):
            tasks = [self._dask.delayed(function, pure=False)(argument) for argument in some]
            yield from self._dask.compute(*tasks, scheduler="threads", num_workers=threads())
