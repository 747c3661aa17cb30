"""How far the nodes of a level are from the level below: inside regions, and along the seams between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orogen.keys import NODE_SIZE, level_shape
from orogen.pyramid.reduce import F32
from orogen.pyramid.region import seam_errors
from orogen.pyramid.regions import Region
from orogen.pyramid.store import Store

TABLES = {"inside": ["node_y", "node_x"], "above": ["region_y", "node_x"], "beside": ["node_y", "region_x"]}
"""Names and axes of the parts."""


@dataclass(frozen=True)
class Errors:
    """Of one level; the parts are kept apart, so that an update can replace some of them."""

    inside: F32
    """(node rows, node columns)."""
    above: F32
    """(region rows, node columns): along the seam above each row of regions; the first is zero."""
    beside: F32
    """(node rows, region columns): along the seam left of each column of regions; the first is zero."""

    @classmethod
    def none(cls, shape: tuple[int, int], level: int, grid: list[list[Region]]) -> Errors:
        """All zero; grid: the regions that the level is made from."""
        rows, cols = (-(-n // NODE_SIZE) for n in level_shape(shape, level))
        return cls(*(np.zeros(s, np.float32) for s in ((rows, cols), (len(grid), cols), (rows, len(grid[0])))))

    @classmethod
    def load(cls, store: Store, level: int) -> Errors:
        """As `save` wrote them."""
        everything = slice(None)
        return cls(*(store.read(level, name, everything, everything) for name in TABLES))

    def save(self, store: Store, level: int) -> None:
        """Store them."""
        for name, axes in TABLES.items():
            store.write_table(level, name, getattr(self, name), axes, {"units": "m"})

    def total(self, grid: list[list[Region]], steps: int) -> F32:
        """(node rows, node columns); steps: how many levels this one is coarser than its regions."""
        total = self.inside.copy()
        for index, row in enumerate(grid[1:], start=1):
            first = row[0].at(steps).rows.start // NODE_SIZE
            np.fmax(total[first - 1 : first + 1], self.above[index], out=total[first - 1 : first + 1])
        for index, region in enumerate(grid[0][1:], start=1):
            first = region.at(steps).cols.start // NODE_SIZE
            part = total[:, first - 1 : first + 1]
            np.fmax(part, self.beside[:, index : index + 1], out=part)
        return total


def put_inside(errors: Errors, region: Region, steps: int, values: F32) -> None:
    """Note the errors inside a region."""
    part = region.at(steps)
    row, col = part.rows.start // NODE_SIZE, part.cols.start // NODE_SIZE
    errors.inside[row : row + values.shape[0], col : col + values.shape[1]] = values


def sew_beside(errors: Errors, region: Region, column: int, left: F32, right: F32, level: int, steps: int) -> None:
    """Note the errors along the seam left of a region; left, right: the (rows, 2) finer heights on its two sides."""
    part = region.at(steps)
    first, count = part.rows.start // NODE_SIZE, -(-part.shape[0] // NODE_SIZE)
    edges = region.edges
    errors.beside[first : first + count, column] = seam_errors(left.T, right.T, count, edges.top, edges.bottom, level)


def sew_above(errors: Errors, row: int, upper: F32, lower: F32, level: int) -> None:
    """Note the errors along the seam above a row of regions, from the whole rows of finer heights beside it."""
    errors.above[row] = seam_errors(upper, lower, errors.above.shape[1], True, True, level)
