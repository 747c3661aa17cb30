"""Level-0 samples for meshes of an algorithm's own: voids are filled in, and the ground goes on beyond the raster.

Meshes over lattices that do not end where the raster does need heights out there. Every axis is continued by reflection
in its last sample, z(last + k) = 2 z(last) - z(last - k), over and over: planes stay planes, and nothing grows steep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.streaming.layer import Layer
from orogen.streaming.retry import steadily
from orogen.streaming.tiles import without_holes

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Positions:
    """Positions along an axis of the raster, from 0 up, as weighted samples inside it."""

    needed: Ints
    """(m,) the samples to read, in order."""
    sample: Ints
    """(n,) which of them is the reflected position."""
    sign: NDArray[np.float32]
    """(n,) its weight, 1 or -1."""
    first: NDArray[np.float32]
    """(n,) weight of the first of the samples needed."""
    last: NDArray[np.float32]
    """(n,) weight of the last of them."""

    @classmethod
    def of(cls, positions: Ints, count: int) -> Positions:
        """`count`: samples along the axis."""
        last = count - 1
        turns, rest = np.divmod(positions, max(2 * last, 1))
        folded = rest > last
        sample = np.minimum(rest, 2 * last - rest) if last else np.zeros_like(positions)
        ends = [[last]] if folded.any() else []
        if turns.any():
            ends = [[0, last]]
        needed = np.unique(np.concatenate([sample, *np.array(ends, np.int64)]))
        f32 = np.float32
        sign = np.where(folded, f32(-1), f32(1))
        # a second reflection adds twice the rise from the first to the last sample
        return cls(
            needed, np.searchsorted(needed, sample), sign, (-2 * turns).astype(f32), (2 * (turns + folded)).astype(f32)
        )

    def take(self, values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
        """Values at the positions, from those at the samples `needed` along an axis."""
        lines = np.moveaxis(values, axis, -1)
        out = lines[..., self.sample]
        if self.last.any():
            out = self.sign * out + self.first * lines[..., :1] + self.last * lines[..., -1:]
        return np.moveaxis(out, -1, axis)


class Samples:
    """The samples of a layer of heights. Safe to use from several threads at once."""

    def __init__(self, layer: Layer) -> None:
        self._tiles = layer.tiles
        self._pyramid = layer.pyramid
        self.shape = layer.pyramid.grid.shape
        """(rows, columns)."""
        self.covered = layer.covered
        """Whether every sample is valid."""

    def wait(self) -> None:
        """Wait until samples can be read. Raises what the build of the pyramid raised."""
        while not self._pyramid.available(0):
            self._pyramid.wait()

    def window(self, rows: slice, cols: slice) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
        """(rows, columns) metres of a window inside the raster, and where they are valid: None for everywhere.

        Voids are filled as in the node atlas. Raises what the pyramid raises, where it does so time and again.
        """
        return steadily(lambda: self._window(rows, cols))

    def _window(self, rows: slice, cols: slice) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
        if self.covered:
            return self._tiles.window(0, rows, cols), None
        # voids are filled from their neighbours
        wide_rows, wide_cols = (
            slice(max(0, part.start - 1), min(part.stop + 1, count))
            for part, count in zip((rows, cols), self.shape, strict=True)
        )
        heights = self._tiles.window(0, wide_rows, wide_cols)
        top, left = rows.start - wide_rows.start, cols.start - wide_cols.start
        inner = np.s_[top : top + rows.stop - rows.start, left : left + cols.stop - cols.start]
        valid = np.isfinite(heights[inner])
        if valid.all():
            return heights[inner], None
        return without_holes(self._tiles, self._pyramid, 0, wide_rows, wide_cols, heights)[inner], valid

    def at(self, rows: Ints, cols: Ints) -> NDArray[np.float32]:
        """(rows, columns) metres at positions in samples, from 0 up, which may lie beyond the raster."""
        down, right = (Positions.of(at, count) for at, count in zip((rows, cols), self.shape, strict=True))
        r, c = down.needed, right.needed
        window, _ = self.window(slice(int(r[0]), int(r[-1]) + 1), slice(int(c[0]), int(c[-1]) + 1))
        return down.take(right.take(window[np.ix_(r - r[0], c - c[0])], 1), 0)
