"""Wedgies: how far the ground may be from every triangle of a bintree (Duchaineau et al. 1997).

The ground is the bilinear surface of the level-0 samples. A triangle's wedgie is the prism that holds the ground over
it: half its thickness is that of the thicker one of its two parts, and the height of the new vertex over the triangle.
The smallest triangles in memory are halves of cells between four heights. Where that is a cell of samples the rest is
known; else the thickest wedgie of every depth in the cell stands for all of them.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.frame import subtexel_bits
from orogen.grid import Grid
from orogen.streaming.samples import Samples

_log = logging.getLogger("orogen")

F32 = NDArray[np.float32]

FINEST_BITS = 6
"""Bits that a sample's width is divided by at most: below that the bilinear surface is flat to a thousandth."""
_TILE = 1024
"""Samples along the tiles that are read at once."""


@dataclass(frozen=True, eq=False, repr=False)
class Wedgies:
    """Heights of a lattice of samples, and what triangles over them leave out."""

    heights: F32
    """(rows, columns) metres of every 2^level-th sample, beyond the raster as if it were reflected in its edge."""
    thickness: F32
    """(2, rows, columns) half the thickness (m) of the wedgies of both triangles that this vertex splits, the one that
    lies further up or left first; -1 where no ground lies over one."""
    error: F32
    """(2, rows, columns) metres that these are off where they are drawn: the same, or less where they are clusters."""
    within: F32
    """(2 level + 1, rows - 1, columns - 1) half the thickness of the thickest wedgie in a cell of heights: of its
    halves, of their parts, and so on down to the halves of cells of samples; -1 where no ground lies over one."""
    level: int
    """Samples between two heights: 2^level."""
    side: int
    """Cells along a root square: a power of two."""
    bits: int
    """Units between two heights: 2^bits."""
    unit: int
    """Subtexels of a unit."""
    ahead: int
    """Splits from a triangle to those that it is drawn as."""


def measure(samples: Samples, grid: Grid, most: int, halvings: int = 0) -> Wedgies:
    """Read all samples, once, and work out wedgies.

    `most`: heights to keep at most. `halvings`: times that every edge of a drawn triangle is halved: 0 where triangles
    are drawn as they are. Raises what reading raises, and SettingsError where a raster is too long for the halvings or
    numba is missing.
    """
    from orogen.lod import bintree_kernels as kernels

    samples.wait()
    start = time.monotonic()
    quads = np.maximum(np.array(samples.shape) - 1, 1)
    level = 0
    while (_padded(quads, level).astype(np.float64) + 1).prod() > most:
        level += 1
    side = _side(-(-quads >> level))
    cells = _padded(quads, level)
    heights = np.empty(cells + 1, np.float32)
    within = np.full((2 * level + 1, *cells), -1, np.float32)
    halves = within if level == 0 else np.full((2, *cells), -1, np.float32)
    for y in range(0, cells[0] << level, _TILE):
        for x in range(0, cells[1] << level, _TILE):
            _read(samples, y, x, level, heights, halves, within)
    nested = np.zeros((2, *heights.shape), np.float32)
    kernels.nest(heights, halves, nested, side // 2)
    thickness = nested
    if halvings:
        nested = nested.copy()
        for turn in range(2 * halvings):
            kernels.look_ahead(_part(within, turn), nested, side // 2)
    bits, unit = subdivision(grid, halvings)
    _log.info("bintree: %d samples measured in %.1f s", np.prod(samples.shape), time.monotonic() - start)
    return Wedgies(heights, thickness, nested, within, level, side, level + bits, unit, 2 * halvings)


def _part(within: F32, depth: int) -> F32:
    """(1, rows, columns) the thickest wedgies so many splits below the halves of cells; twin of `within_of`."""
    last = len(within) - 1
    if depth <= last:
        return within[depth : depth + 1]
    return within[last:] * np.float32(0.25 ** ((depth - last + 1) // 2))


def _side(cells: NDArray[np.integer]) -> int:
    """Cells along root squares: as large as the shorter side of the raster, and not much more than it in all."""
    side = 1 << (int(cells.min()).bit_length() - 1)
    while side > 1 and float((-(-cells // side) * side).prod()) > 1.5 * float(cells.prod()):
        side //= 2
    return side


def _padded(quads: NDArray[np.integer], level: int) -> NDArray[np.int64]:
    """Rows and columns of cells of all root squares."""
    cells = -(-quads >> level)
    side = _side(cells)
    return -(-cells // side) * side


def subdivision(grid: Grid, halvings: int) -> tuple[int, int]:
    """Bits of units between samples, and subtexels of a unit."""
    below = subtexel_bits(grid)
    # the middles of the smallest triangles are in the lattice too
    bits = max(1, min(below, FINEST_BITS) - halvings)
    unit = below - bits
    if unit < halvings:
        raise SettingsError(
            f"cluster: expected edges halved at most {max(unit, 0)} times for a raster of {grid.width} x {grid.height} "
            f"samples, got {halvings}"
        )
    return bits, 1 << unit


def _read(samples: Samples, y: int, x: int, level: int, heights: F32, halves: F32, within: F32) -> None:
    """Fill in the heights and wedgies of cells of one tile."""
    from orogen.lod import bintree_kernels as kernels

    cells = np.array(halves.shape[1:]) << level
    rows, cols = (
        np.arange(first, min(first + _TILE, int(last)) + 1) for first, last in zip((y, x), cells, strict=True)
    )
    last = np.array(samples.shape) - 1
    drawn = np.zeros((rows.size - 1, cols.size - 1), bool)
    inner = [slice(int(at[0]), int(min(at[-1], end)) + 1) for at, end in zip((rows, cols), last, strict=True)]
    z: F32 | None = None
    if all(part.stop - part.start > 1 for part in inner):
        z, valid = samples.window(*inner)
        part = np.s_[: z.shape[0] - 1, : z.shape[1] - 1]
        drawn[part] = True
        if valid is not None:
            # cells with a valid corner are drawn in part
            drawn[part] = valid[:-1, :-1] | valid[1:, :-1] | valid[:-1, 1:] | valid[1:, 1:]
    if z is None or z.shape != (rows.size, cols.size):
        z = samples.at(rows, cols)
    # 1/4 is the height of a cell's middle over its diagonal; the halves of cells within it follow: 1/4 + 1/16 + ...
    twist = np.abs(z[:-1, :-1] + z[1:, 1:] - z[:-1, 1:] - z[1:, :-1]) * np.float32(1.000001 / 3)
    twist[~drawn] = -1
    top, left = y >> level, x >> level
    place = np.s_[:, top : top + (rows.size - 1 >> level), left : left + (cols.size - 1 >> level)]
    if level == 0:
        within[place] = twist
    else:
        z = np.require(z, np.float32, ["C", "W"])
        nested = np.zeros((2, *z.shape), np.float32)
        kernels.nest(z, twist[None], nested, 1 << (level - 1))
        # of a tile's own: compiled code for what lies in one piece
        tile = [np.full(part[place].shape, -1, np.float32) for part in (halves, within)]
        kernels.collect(z, twist[None], nested, level, *tile)
        halves[place], within[place] = tile
    z = z[:: 1 << level, :: 1 << level]
    heights[top : top + z.shape[0], left : left + z.shape[1]] = z
