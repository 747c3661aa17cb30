"""Bring a built pyramid up to date with data that have changed in places."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orogen.errors import StoreError
from orogen.keys import NODE_SIZE, level_shape
from orogen.pyramid import places
from orogen.pyramid.build import Builder
from orogen.pyramid.output import Layer, Report, drafted, finish_folder, layer_facts, publish, writing
from orogen.pyramid.reduce import F32
from orogen.pyramid.regions import LEVELS, Region, pieces
from orogen.pyramid.seams import Errors, sew_above, sew_beside
from orogen.pyramid.store import Store
from orogen.pyramid.task import READ_ROWS, differs, make_region
from orogen.pyramid.workers import Workers
from orogen.source.rounding import Overflow, Rounding
from orogen.source.stored import FORMAT, attributes, layers

Window = tuple[slice, slice]
"""Rows and columns of level 0."""
Place = tuple[int, int]
"""Row and column of a region among the regions of its level."""


@dataclass
class Update:
    """Replaces the changed regions of a pyramid folder, in a copy that then takes its place at once.

    Readers that have it open go on with what they have read and are told by a StoreError to open it again.
    """

    target: Path
    """The folder that was built."""
    layers: Sequence[Layer]
    """Its data as they are now, one for each layer."""
    report: Report = lambda fraction, text: None
    """Called with the part done (0 to 1) and what is done, from any thread."""
    stop: threading.Event = field(default_factory=threading.Event)
    """Set it to end the update with `Cancelled`; the folder stays as it was."""

    def run(self, workers: Workers, windows: Sequence[Window] | None = None) -> dict[str, Any]:
        """Do it. Returns the facts of each layer by name, with the number of regions that were made again.

        windows: where the first layer, and others on its grid, have changed; None: wherever level 0 is not what is
        stored, all of which is read and compared. Raises StoreError where only a new build can do it.
        """
        draft = self.target.with_name(f"{self.target.name}.building")
        places.recover(self.target)
        known = dict(layers(self.target))
        if not known:
            raise StoreError(f"{self.target}: is no pyramid that orogen has built; build it without --update")
        if known != {layer.name: layer.source.kind for layer in self.layers}:
            raise StoreError(f"{self.target}: has the layers {', '.join(known)}; give those to update")
        with writing(self.target), drafted(draft) as notes:
            # what an interrupted build or update has left is of no use here
            for path in [path for path in draft.iterdir() if path != notes]:
                places.remove(path)
            facts = {}
            for layer in self.layers:
                places.linked_copy(self.target / layer.name, draft / layer.name)
                facts[layer.name] = self._layer(layer, draft / layer.name, workers, windows)
            finish_folder(draft, self.layers, facts)
            places.remove(notes)
            publish(draft, self.target)
        return facts

    def _layer(self, layer: Layer, folder: Path, workers: Workers, windows: Sequence[Window] | None) -> dict[str, Any]:
        old = attributes(folder) or {}
        rounding = None
        if "step" in old:
            array = Store(folder).array(0, "height")
            rounding = Rounding(old["step"], str(array.dtype.name))
        new = layer_facts(layer, {}, old.get("max_error"), None)
        for name in ("grid", "coverage"):
            if old.get("format") != FORMAT or old[name] != new[name]:
                raise StoreError(f"{self.target}: its {name} is not that of the data now; build it again with --force")
        text = f"updating {layer.name} of {self.target.name}"
        builder = Builder(
            layer.source,
            Store(folder),
            lambda fraction: self.report(fraction, text),
            self.stop,
            keep=True,
            rounding=rounding,
            recipe=layer.recipe,
        )
        try:
            changed = _changed(builder, workers) if windows is None else _within(builder, windows)
            facts = remake(builder, changed, workers)
        except Overflow as error:
            raise StoreError(
                f"{self.target}: a height does not fit the numbers that it stores; build it again with --force"
            ) from error
        facts = layer_facts(layer, facts, old.get("max_error"), rounding)
        builder.store.finish(layer.source.grid, facts)
        return {**facts, "regions": len(changed)}


def _changed(builder: Builder, workers: Workers) -> set[Place]:
    """The regions where level 0 of the source is not what is stored."""
    every = [(row, col) for row, line in enumerate(builder.grids[0]) for col in range(len(line))]
    arguments = ((builder.job, builder.grids[0][row][col]) for row, col in every)
    return {place for place, other in zip(every, workers.in_order(differs, arguments), strict=True) if other}


def _within(builder: Builder, windows: Sequence[Window]) -> set[Place]:
    """The regions that windows of level 0 reach into."""
    return {place for rows, cols in windows for place in _touched(builder.grids[0], rows, cols)}


def _touched(grid: list[list[Region]], rows: slice, cols: slice) -> set[Place]:
    return {
        (i, j)
        for i, line in enumerate(grid)
        if line[0].rows.start < rows.stop and line[0].rows.stop > rows.start
        for j, region in enumerate(line)
        if region.cols.start < cols.stop and region.cols.stop > cols.start
    }


def remake(builder: Builder, changed: set[Place], workers: Workers) -> dict[str, Any]:
    """Make regions of level 0 and all that is above them again; returns the facts of the layer."""
    heights = builder.source.kind == "height"
    nodes = np.zeros((0, 0, 4), np.float32)
    errors: dict[int, Errors] = {}
    if heights:
        nodes = builder.store.read(0, "nodes", slice(None), slice(None))
        errors = {level: Errors.load(builder.store, level) for level in range(1, builder.levels)}
    builder.create()
    copied = {} if builder.source.direct else {place: _copied(builder, place) for place in sorted(changed)}
    for base in builder.bases:
        grid = builder.grids[base]
        if base:
            parts = [builder.grids[base - LEVELS][row][col].at(LEVELS) for row, col in changed]
            changed = {place for part in parts for place in _touched(grid, part.rows, part.cols)}
        order = sorted(changed)
        arguments = ((builder.job, grid[row][col], base) for row, col in order)
        for (row, col), part in zip(order, workers.in_order(make_region, arguments), strict=True):
            if heights:
                builder.put(base, grid[row][col], part, nodes, errors)
        if base == 0:
            for facts, window in copied.values():
                nodes[window][..., 3] = facts[..., 3]
        if heights:
            for level in builder.job.levels(base):
                _sew(builder, base, level, changed, errors[level])
    return builder.conclude(nodes, errors)


def _copied(builder: Builder, place: Place) -> tuple[F32, Window]:
    """Copy a region of level 0 of a source without cheap windows; facts of its nodes, and where they are."""
    region = builder.grids[0][place[0]][place[1]]
    facts = [builder.copy(rows, region.cols) for rows in pieces(region.rows.start, region.rows.stop, READ_ROWS, 1)]
    window = region.at(int(math.log2(NODE_SIZE)))
    return np.concatenate(facts), (window.rows, window.cols)


def _sew(builder: Builder, base: int, level: int, changed: set[Place], errors: Errors) -> None:
    """Compare along the seams of changed regions, with the heights as they are stored now."""
    grid, steps = builder.grids[base], level - base - 1

    def read(rows: slice, cols: slice) -> F32:
        return builder.store.read(level - 1, "height", rows, cols)

    for row, col in changed | {(i, j + 1) for i, j in changed}:
        if 0 < col < len(grid[0]):
            region = grid[row][col].at(steps)
            middle = region.cols.start
            left, right = (read(region.rows, slice(at, at + 2)) for at in (middle - 2, middle))
            sew_beside(errors, grid[row][col], col, left, right, level, steps + 1)
    width = level_shape(builder.shape, level - 1)[1]
    for row in {i for i, _ in changed} | {i + 1 for i, _ in changed}:
        if 0 < row < len(grid):
            middle = grid[row][0].at(steps).rows.start
            upper, lower = (read(slice(at, at + 2), slice(0, width)) for at in (middle - 2, middle))
            sew_above(errors, row, upper, lower, level)
