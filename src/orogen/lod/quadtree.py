"""A quadtree of square patches of samples, for algorithms that choose their patches on the CPU.

A patch of level l spans `side` << l samples along each side, counted from the first sample's centre; those at the far
sides may reach past the data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.grid import Grid
from orogen.streaming.boxes import may_be_seen, nearest_square
from orogen.streaming.clipmap import ClipmapView

Ints = NDArray[np.int64]
Leaves = list[tuple[Ints, Ints]]
"""Columns and rows (x, y) of the chosen patches, per level from 0 up."""
Split = Callable[[int, Ints, Ints], NDArray[np.bool_]]
"""(level, x, y) -> whether each patch gives way to its four children."""

_EDGES = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""Steps in x and y to the neighbours in the west, east, north (the row before) and south."""


class PatchTree:
    """The patches of a grid."""

    def __init__(self, grid: Grid, side: int) -> None:
        """`side`: samples along a patch of level 0 (quads, not vertices)."""
        self.grid = grid
        self.side = side
        longest = max(grid.width, grid.height) - 1
        self.level_count = max(0, int(np.ceil(np.log2(max(longest, 1) / side)))) + 1
        """Levels; the single patch of the last one covers the data."""

    def shape(self, level: int) -> tuple[int, int]:
        """(rows, columns) of patches in a level."""
        width = self.side << level
        return max(1, -(-(self.grid.height - 1) // width)), max(1, -(-(self.grid.width - 1) // width))

    def samples(self, level: int, x: Ints, y: Ints) -> tuple[Ints, Ints]:
        """(n, 2) columns and rows of the first and the last sample of patches, within the data."""
        low = np.stack([x, y], axis=-1) * (self.side << level)
        last = np.array([self.grid.width, self.grid.height]) - 1
        return np.minimum(low, last), np.minimum(low + (self.side << level), last)


class PatchFrame:
    """The patches of a tree as the LOD camera of a frame sees them."""

    def __init__(self, tree: PatchTree, frame: Frame, view: ClipmapView) -> None:
        """`view` has been updated for the frame."""
        self.tree = tree
        self.frame = frame
        self._view = view
        self._metres = tree.grid.metres
        # sample centres lie half a texel from the texels' corners
        self._eye = frame.eye - 0.5
        self._lod = frame.lod_eye()
        self._lod_texel = self._eye + np.linalg.inv(self._metres) @ self._lod[:2]

    @cached_property
    def _planes(self) -> NDArray[np.float64]:
        return self.frame.planes()

    def bounds(self, level: int, x: Ints, y: Ints) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest height (metres of the data) that may be drawn in patches."""
        found = self._view.drawn_bounds(*self.tree.samples(level, x, y)).astype(np.float64)
        return found[:, 0], found[:, 1]

    def visible(self, level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
        """Whether patches may be in the picture of the LOD camera."""
        first, last = self.tree.samples(level, x, y)
        flat = ((first + last) / 2 - self._eye) @ self._metres.T
        axes = self._metres * ((last - first) / 2)[:, None, :]
        low, high = self.bounds(level, x, y)
        # rounding of what is far away must not cull what touches a plane
        slack = 1e-6 * (np.linalg.norm(flat, axis=-1) + np.abs(low) + np.abs(high)) + 1e-3
        return may_be_seen(self.frame, self._planes, flat, axes, low - slack, high + slack)

    def distance(self, level: int, x: Ints, y: Ints) -> NDArray[np.float64]:
        """Metres from the LOD eye to the nearest point of the patches' boxes."""
        first, last = self.tree.samples(level, x, y)
        square = nearest_square(self._metres, first - self._lod_texel, last - self._lod_texel)
        return np.sqrt(square + self._above(*self.bounds(level, x, y), square) ** 2)

    def distance_to(self, column: NDArray, row: NDArray, height: NDArray) -> NDArray[np.float64]:
        """Metres from the LOD eye to points at samples' columns and rows (may be fractions) and heights of the data."""
        flat = (np.stack([column, row], axis=-1) - self._lod_texel) @ self._metres.T
        square = (flat**2).sum(axis=-1)
        return np.sqrt(square + self._above(height, height, square) ** 2)

    def _above(self, low: NDArray, high: NDArray, square: NDArray) -> NDArray[np.float64]:
        """Metres from the LOD eye up or down to the nearest height of an interval; `square`: along the ground."""
        frame = self.frame
        # curvature lowers the ground by its distance from the viewing camera: the LOD eye is close to that, or frozen
        eye = self._lod[2] + frame.camera.z + frame.curvature_factor * square
        return np.maximum(np.maximum(low * frame.exaggeration - eye, eye - high * frame.exaggeration), 0.0)

    def select(self, split: Split, *, restricted: bool = False) -> Leaves:
        """The leaves in the LOD camera's frustum after splitting from the top down.

        `restricted`: adjacent leaves differ by one level at most; patches are split that `split` would leave whole.
        """
        top = self.tree.level_count - 1
        x = y = np.zeros(1, np.int64)
        visible: Leaves = [(x, y)] * (top + 1)
        divided: list[NDArray[np.bool_]] = [np.zeros(0, bool)] * (top + 1)
        for level in range(top, -1, -1):
            seen = self.visible(level, x, y)
            x, y = x[seen], y[seen]
            visible[level] = x, y
            divided[level] = split(level, x, y) if level and x.size else np.zeros(x.size, bool)
            x, y = self._children(level, x[divided[level]], y[divided[level]])
        leaves = [(x[~cut], y[~cut]) for (x, y), cut in zip(visible, divided, strict=True)]
        if not restricted:
            return leaves
        return self._restricted(leaves, [_key(x[cut], y[cut]) for (x, y), cut in zip(visible, divided, strict=True)])

    def _restricted(self, leaves: Leaves, divided: list[Ints]) -> Leaves:
        """The leaves after those have been split too that must be for their neighbours' sake; `divided`: keys."""
        top = len(leaves) - 1
        keys = list(divided)
        for level in range(1, top):
            # where a patch is split its neighbours must exist, so their parents are split too
            x, y = _place(keys[level])
            rows, columns = self.tree.shape(level)
            around = [(x + dx, y + dy) for dx, dy in _EDGES]
            inside = [(px >= 0) & (py >= 0) & (px < columns) & (py < rows) for px, py in around]
            parents = [_key(px[ok] >> 1, py[ok] >> 1) for (px, py), ok in zip(around, inside, strict=True)]
            keys[level + 1] = np.unique(np.concatenate([keys[level + 1], _key(x >> 1, y >> 1), *parents]))
        for level in range(top, 0, -1):
            x, y = leaves[level]
            cut = np.isin(_key(x, y), keys[level])
            if cut.any():
                children = self._children(level, x[cut], y[cut])
                seen = self.visible(level - 1, *children)
                finer = leaves[level - 1]
                leaves[level] = x[~cut], y[~cut]
                leaves[level - 1] = np.append(finer[0], children[0][seen]), np.append(finer[1], children[1][seen])
        return leaves

    def _children(self, level: int, x: Ints, y: Ints) -> tuple[Ints, Ints]:
        rows, columns = self.tree.shape(max(level - 1, 0))
        x, y = np.add.outer(2 * x, [0, 1, 0, 1]).ravel(), np.add.outer(2 * y, [0, 0, 1, 1]).ravel()
        inside = (x < columns) & (y < rows)
        return x[inside], y[inside]


def neighbour_steps(leaves: Sequence[tuple[Ints, Ints]], most: int | None = None) -> list[Ints]:
    """Per level (n, 4): by how many levels the leaf beyond the west, east, north and south edge is coarser.

    0 where it is of the same level or finer, and where there is none. `most`: the greatest difference there can be (1
    in a restricted tree).
    """
    known = [_key(x, y) for x, y in leaves]
    result = []
    for level, (x, y) in enumerate(leaves):
        steps = np.zeros((x.size, 4), np.int64)
        for edge, (dx, dy) in enumerate(_EDGES):
            last = len(leaves) - 1 if most is None else min(level + most, len(leaves) - 1)
            for step in range(1, last - level + 1):
                px, py = (x + dx) >> step, (y + dy) >> step
                other = ((px != x >> step) | (py != y >> step)) & (px >= 0) & (py >= 0)
                steps[other & np.isin(_key(px, py), known[level + step]), edge] = step
        result.append(steps)
    return result


def _key(x: Ints, y: Ints) -> Ints:
    return (y << 32) | (x & 0xFFFFFFFF)


def _place(key: Ints) -> tuple[Ints, Ints]:
    return key & 0xFFFFFFFF, key >> 32
