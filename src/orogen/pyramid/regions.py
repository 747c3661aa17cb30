"""How a level is cut into regions that are worked on apart."""

from __future__ import annotations

from dataclasses import dataclass

from orogen.pyramid.region import Edges

REGION = 2048
"""Rows and columns of a region in its finest level: its means are whole shards of the next levels."""
LEVELS = 3
"""Levels made from one reading of a region."""
LEAST = 1 << LEVELS
"""Regions of no more rows or columns than this join the one before, so that every level has two of them."""


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
