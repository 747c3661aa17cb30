"""The square that is bisected and the bit field that holds its tree."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orogen.frame import subtexel_bits
from orogen.gpu import Buffer, Gpu
from orogen.grid import Grid

FINEST_LEG = 8
"""Triangles are divided down to this part of the way between samples: the bilinear surface is flat enough there."""
SHALLOWEST_FIELD = 16
"""Depth of the smallest bit field: 8 KiB, a workgroup's share of the sums."""
USUAL_DEPTH = 28
"""Depth of the largest bit field, 40 MiB with its sums, that is made without being asked for."""
DEEPEST = 30
"""Depth of the largest bit field: node numbers have 32 bits."""


@dataclass(frozen=True)
class Shape:
    """The square that is bisected, and how often."""

    side: int
    """Subtexels along the square, which is as wide as the data or wider."""
    full_depth: int
    """Bisections down to triangles whose legs are an eighth of the way between samples, or a subtexel."""
    depth: int
    """Bisections that there are: fewer where the bit field would be too large."""

    @property
    def field_depth(self) -> int:
        """Depth of the bit field."""
        return max(self.depth, SHALLOWEST_FIELD)

    @property
    def shortest_leg(self) -> float:
        """Subtexels along the legs of the smallest triangles."""
        return self.side / 2 ** ((self.depth - 1) / 2)


def shape_of(grid: Grid, max_depth: int | None, deepest: int) -> Shape:
    """The square over a grid's samples; `deepest`: bisections that there is memory for where `max_depth` is None."""
    bits = subtexel_bits(grid)
    leg = max(1, (1 << bits) // FINEST_LEG)
    doublings = max(0, math.ceil(math.log2(max(1, (max(grid.shape) - 1) << bits) / leg)))
    full = 1 + 2 * doublings
    return Shape(leg << doublings, full, min(full, deepest if max_depth is None else max_depth))


def tree_bytes(depth: int) -> int:
    """Bytes of a tree: a bit a place, two words of sums for each 256 of them, two words for each region of 65536."""
    return (1 << depth >> 3) + (8 << depth >> 8) + (8 << depth >> 16)


def deepest_field(gpu: Gpu) -> int:
    """Depth of the bit field that the device binds and half of the free memory holds, USUAL_DEPTH at most."""
    room = min(gpu.limits["max-storage-buffer-binding-size"], gpu.limits["max-buffer-size"])
    if gpu.memory.free is not None:
        room = min(room, gpu.memory.free // 2)
    fitting = [depth for depth in range(SHALLOWEST_FIELD, USUAL_DEPTH + 1) if tree_bytes(depth) <= room]
    return max(fitting, default=SHALLOWEST_FIELD)


def plant(gpu: Gpu, tree: Buffer, depth: int) -> None:
    """Write the smallest tree, two triangles, into a buffer of zeros."""
    one = np.array([1], np.uint32)
    sums = 1 << depth >> 3
    for bit in (0, 1 << depth >> 1):
        gpu.write(tree, one, 4 * (bit >> 5))
        for above in range(8, depth):
            gpu.write(tree, one, sums + 4 * ((1 << depth | bit) >> above))
    gpu.write(tree, 2 * one, sums + 4)
