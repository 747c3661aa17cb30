"""What the ground is like in cells of a few samples: its range, and how far its cells are from triangles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orogen.lod.bdam.diamonds import Diamonds, Floats, Ints
from orogen.streaming.samples import Samples

CELL = 8
"""Samples along a cell."""
TILE = 512
"""Samples along what is measured at once."""

F32 = NDArray[np.float32]


class Ground:
    """Ranges and twists in boxes of samples."""

    def __init__(self, diamonds: Diamonds, cells: F32) -> None:
        """`cells`: (rows, columns, 3) as of `measure`."""
        self._diamonds = diamonds
        low, high, twist = (cells[..., i] for i in range(3))
        # where all is void any height will do
        void, lowest = high < low, low.min()
        self.mips = [np.stack([-np.where(void, lowest, low), np.where(void, lowest, high), twist], axis=-1)]
        """(rows, columns, 3) negated lowest and highest height and a quarter of the twist (m) of cells, then of two by
        two of these, and so on."""
        while max(self.mips[-1].shape[:2]) > 1:
            self.mips.append(_halved(self.mips[-1]))

    def mip(self, samples: float) -> int:
        """Which cells suit boxes that are so wide: they touch four in a row at most."""
        return min(len(self.mips) - 1, max(0, math.ceil(math.log2(samples / (3 * CELL)))))

    def range(self, mip: int, first: Floats, last: Floats) -> tuple[Floats, Floats]:
        """Lowest and highest true height (m) in boxes from first to last column and row."""
        found = self._most(mip, first, last)
        return -found[:, 0], found[:, 1]

    def errors(self, level: int, cx: Ints, cy: Ints) -> Floats:
        """Metres that the surface over all vertices of diamonds may be off, for levels up to 0.

        A bilinear cell is a quarter of its twist from its two triangles, and a quarter of that from the four around its
        middle, and from those of its quarters.
        """
        first, last = self._diamonds.box(level, cx, cy)
        mip = self.mip(6 * self._diamonds.half(level) / (1 << self._diamonds.bits))
        return self._most(mip, first, last)[:, 2] * 4.0 ** (level // 2)

    def _most(self, mip: int, first: Floats, last: Floats) -> Floats:
        """(n, 3) highest values of the cells that boxes touch."""
        table, side = self.mips[mip], CELL << mip
        low = np.floor(first / side).astype(np.int64)
        high = np.maximum(np.ceil(last / side).astype(np.int64) - 1, low)
        limit = np.array(table.shape[1::-1]) - 1
        low, high = np.minimum(low, limit), np.minimum(high, limit)
        steps = np.arange(int((high - low).max(initial=0)) + 1)
        x, y = np.minimum(low[..., None] + steps, high[..., None]).swapaxes(0, 1)
        return table[y[:, :, None], x[:, None, :]].max(axis=(1, 2)).astype(np.float64)


def cell_shape(samples: Samples) -> tuple[int, int]:
    """(rows, columns) of cells."""
    rows, columns = (max(1, -(-(size - 1) // CELL)) for size in samples.shape)
    return rows, columns


def measure(samples: Samples, cells: F32, top: int, left: int) -> None:
    """Fill in the cells of a tile: lowest and highest height, and a quarter of the largest twist (m).

    top, left: its first sample. Cells without true surface have a lowest height above the highest.
    """
    rows, columns = (
        slice(at, min(at + TILE, size - 1) + 1) for at, size in zip((top, left), samples.shape, strict=True)
    )
    z, valid = samples.window(rows, columns)
    counts = corners_of_surface(valid, z.shape)
    low, high = (z, z) if counts is None else (np.where(counts, z, np.inf), np.where(counts, z, -np.inf))
    twist = np.abs(z[:-1, :-1] + z[1:, 1:] - z[:-1, 1:] - z[1:, :-1]) * np.float32(0.25)
    if counts is not None:
        twist[~(counts[:-1, :-1] & counts[1:, :-1] & counts[:-1, 1:] & counts[1:, 1:])] = 0
    for i in range(max(1, -(-twist.shape[0] // CELL))):
        for_rows = slice(i * CELL, (i + 1) * CELL + 1)
        place = cells[top // CELL + i, left // CELL :]
        for j in range(max(1, -(-twist.shape[1] // CELL))):
            part = np.s_[for_rows, j * CELL : (j + 1) * CELL + 1]
            quads = np.s_[i * CELL : (i + 1) * CELL, j * CELL : (j + 1) * CELL]
            place[j] = low[part].min(), high[part].max(), twist[quads].max(initial=0)


def corners_of_surface(valid: NDArray[np.bool_] | None, shape: tuple[int, ...]) -> NDArray[np.bool_] | None:
    """Which samples of a window are corners of true surface, given the valid ones; None: all."""
    if valid is None:
        return None
    rows, columns = shape
    # cells with a valid corner are drawn in part
    near = np.zeros((rows + 2, columns + 2), bool)
    for dy in range(3):
        for dx in range(3):
            near[dy : dy + rows, dx : dx + columns] |= valid
    return near[1:-1, 1:-1]


def _halved(table: F32) -> F32:
    rows, columns, _ = table.shape
    padded = np.pad(table, ((0, rows % 2), (0, columns % 2), (0, 0)), mode="edge")
    return padded.reshape(-(-rows // 2), 2, -(-columns // 2), 2, 3).max(axis=(1, 3))
