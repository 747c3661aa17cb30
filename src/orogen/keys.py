"""Names for the parts of a pyramid that every room shares."""

from __future__ import annotations

from typing import NamedTuple

NODE_SIZE = 256
"""Samples along a node's side, without its border; also the side of a stored chunk."""


class NodeKey(NamedTuple):
    """A square tile of the pyramid: `NODE_SIZE` x `NODE_SIZE` samples of one level.

    Node (x, y) of level L covers the level-0 texels [x, x + 1) * NODE_SIZE * 2**L along the columns and
    the same with y along the rows; it may reach past the raster's right and lower edges.
    """

    level: int
    """0 is the finest level; a sample of level L is the mean of 2**L x 2**L samples of level 0."""
    x: int
    """Column of the node in its level, from the left."""
    y: int
    """Row of the node in its level, from the top."""

    @property
    def parent(self) -> NodeKey:
        """The node of the next coarser level that covers this one."""
        return NodeKey(self.level + 1, self.x >> 1, self.y >> 1)


def level_shape(shape: tuple[int, int], level: int) -> tuple[int, int]:
    """(rows, columns) of `level` for a raster of `shape` (rows, columns): halves rounded up."""
    rows, columns = shape
    return -(-rows >> level), -(-columns >> level)


def level_count(shape: tuple[int, int]) -> int:
    """Number of levels, so that the coarsest one is a single node."""
    count = 1
    while max(level_shape(shape, count - 1)) > NODE_SIZE:
        count += 1
    return count
