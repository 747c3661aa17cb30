"""A quadtree of square patches of samples, for algorithms that choose their patches on the CPU.

A patch of level l spans `side` << l samples along each side, counted from the first sample's centre; those at the far
sides may reach past the data. What walks the tree is compiled where numba is installed (quadtree_kernels.py), else it
is numpy, which chooses the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import Grid
from orogen.streaming.boxes import may_be_seen, nearest_square
from orogen.streaming.clipmap_view import ClipmapView

Ints = NDArray[np.int64]
F64 = NDArray[np.float64]
Level = int | Ints
"""A level of all patches, or one for each of them."""
Split = Callable[[int, Ints, Ints], NDArray[np.bool_]]
"""(level, x, y) -> whether each patch gives way to its four children."""

EDGES = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""Steps in x and y to the neighbours in the west, east, north (the row before) and south; edge e is opposite e ^ 1."""


class Leaves(NamedTuple):
    """Patches of several levels, the finest first."""

    level: Ints
    """(n,)"""
    x: Ints
    """(n,) columns in their levels."""
    y: Ints
    """(n,) rows in their levels."""


class Table(NamedTuple):
    """Numbers for every patch, level after level and row after row."""

    values: NDArray[np.float32]
    """(patches, numbers)"""
    layout: Ints
    """(levels, 3) where a level starts, its columns, and by how many levels coarser the patches are that it has."""

    @classmethod
    def of(cls, levels: Sequence[NDArray[np.float32]], shared: int = 0) -> Table:
        """From (rows, columns, numbers) per level. `shared`: the level whose patches those before it have numbers of.

        Levels that have the same array share their numbers.
        """
        starts: dict[int, int] = {}
        kept: list[NDArray[np.float32]] = [np.zeros((0, 1 if not levels else levels[0].shape[2]), np.float32)]
        layout = np.zeros((len(levels), 3), np.int64)
        size = 0
        for number, level in enumerate(levels):
            if id(level) not in starts:
                starts[id(level)] = size
                kept.append(level.reshape(-1, level.shape[2]))
                size += len(kept[-1])
            layout[number] = starts[id(level)], level.shape[1], max(0, shared - number)
        return cls(np.concatenate(kept), layout)

    def at(self, level: Level, x: Ints, y: Ints) -> F64:
        """(n, numbers) of patches."""
        first, columns, shift = np.moveaxis(self.layout[level], -1, 0)
        return self.values[first + (y >> shift) * columns + (x >> shift)].astype(np.float64)


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

    def samples(self, level: Level, x: Ints, y: Ints) -> tuple[Ints, Ints]:
        """(n, 2) columns and rows of the first and the last sample of patches, within the data."""
        width = np.expand_dims(np.left_shift(self.side, level), -1)
        low = np.stack([x, y], axis=-1) * width
        last = np.array([self.grid.width, self.grid.height]) - 1
        return np.minimum(low, last), np.minimum(low + width, last)


class BoxFrame:
    """Boxes over the ground as the LOD camera of a frame sees them."""

    def __init__(self, grid: Grid, frame: Frame) -> None:
        self.frame = frame
        self._metres = grid.metres
        # sample centres lie half a texel from the texels' corners
        self._eye = frame.eye - 0.5
        self._lod = frame.lod_eye()
        self._lod_texel = self._eye + grid.texels @ self._lod[:2]

    def box_visible(self, first: NDArray, last: NDArray, low: F64, high: F64) -> NDArray[np.bool_]:
        """(n,) whether boxes may be in the picture of the LOD camera.

        `first`, `last`: (n, 2) columns and rows of samples; `low`, `high`: (n,) metres of the data.
        """
        flat = ((first + last) / 2 - self._eye) @ self._metres.T
        axes = self._metres * ((last - first) / 2)[:, None, :]
        # rounding of what is far away must not cull what touches a plane
        slack = 1e-6 * (np.linalg.norm(flat, axis=-1) + np.abs(low) + np.abs(high)) + 1e-3
        return may_be_seen(self.frame, self.frame.planes(), flat, axes, low - slack, high + slack)

    def box_distance(self, first: NDArray, last: NDArray, low: F64, high: F64) -> F64:
        """(n,) metres from the LOD eye to the nearest point of boxes."""
        square = nearest_square(self._metres, first - self._lod_texel, last - self._lod_texel)
        return np.sqrt(square + self._above(low, high, square) ** 2)

    def distance_to(self, column: NDArray, row: NDArray, height: NDArray) -> F64:
        """Metres from the LOD eye to points at samples' columns and rows (may be fractions) and heights of the data."""
        flat = (np.stack([column, row], axis=-1) - self._lod_texel) @ self._metres.T
        square = (flat**2).sum(axis=-1)
        return np.sqrt(square + self._above(height, height, square) ** 2)

    def _above(self, low: NDArray, high: NDArray, square: NDArray) -> F64:
        """Metres from the LOD eye up or down to the nearest height of an interval; `square`: along the ground."""
        frame = self.frame
        # curvature lowers the ground by its distance from the viewing camera: the LOD eye is close to that, or frozen
        eye = self._lod[2] + frame.camera.z + frame.curvature_factor * square
        return np.maximum(np.maximum(low * frame.exaggeration - eye, eye - high * frame.exaggeration), 0.0)

    def compiled_eye(self, compiled: Any) -> Any:
        """The frame for compiled kernels."""
        frame = self.frame
        return compiled.Eye(
            np.array(frame.plane_rows), *self._metres.ravel().tolist(), *self._eye.tolist(), *self._lod_texel.tolist(),
            float(self._lod[2]) + frame.camera.z, float(frame.camera.z), float(frame.exaggeration),
            float(frame.curvature_factor),
        )  # fmt: skip


class PatchFrame(BoxFrame):
    """The patches of a tree as the LOD camera of a frame sees them."""

    def __init__(self, tree: PatchTree, frame: Frame, heights: ClipmapView | Table, reach: F64 | None = None) -> None:
        """`heights`: the view whose heights are drawn, updated for the frame, or lowest and highest (m) of patches.

        `reach`: (levels,) metres below which patches are divided; None: wherever they are.
        """
        super().__init__(tree.grid, frame)
        self.tree = tree
        self.reach = np.full(tree.level_count, np.inf) if reach is None else reach
        self._heights = heights
        self._compiled: tuple[Any, Any, Any] | None = None

    def bounds(self, level: Level, x: Ints, y: Ints) -> tuple[F64, F64]:
        """Lowest and highest height (metres of the data) in patches."""
        if isinstance(self._heights, Table):
            found = self._heights.at(level, x, y)
        else:
            found = self._heights.drawn_bounds(*self.tree.samples(level, x, y)).astype(np.float64)
        return found[:, 0], found[:, 1]

    def visible(self, level: Level, x: Ints, y: Ints) -> NDArray[np.bool_]:
        """Whether patches may be in the picture of the LOD camera."""
        return self.box_visible(*self.tree.samples(level, x, y), *self.bounds(level, x, y))

    def distance(self, level: Level, x: Ints, y: Ints) -> F64:
        """Metres from the LOD eye to the nearest point of the patches' boxes."""
        if compiled := kernels():
            levels = np.full(x.size, level, np.int64) if isinstance(level, int) else level
            return np.asarray(compiled.distances(*self.compiled(compiled), levels, x, y))
        return self.box_distance(*self.tree.samples(level, x, y), *self.bounds(level, x, y))

    # -- leaves --------------------------------------------------------------------------------------------------------

    def divided(self, level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
        """Whether patches are too coarse. Who has another rule has it here and in `rule`."""
        if self.reach[level] == np.inf:
            return np.ones(x.size, bool)
        return self.distance(level, x, y) < self.reach[level]

    def rule(self, compiled: Any) -> Any:
        """The same for the module of compiled kernels."""
        return compiled.rule(compiled.REACH, self.reach)

    def leaves(self, *, restricted: bool = False) -> Leaves:
        """The leaves in the LOD camera's frustum; `restricted`: as in `select`."""
        if compiled := kernels():
            return Leaves(*compiled.leaves(*self.compiled(compiled), self.rule(compiled), restricted))
        return self.select(self.divided, restricted=restricted)

    def compiled(self, compiled: Any) -> tuple[Any, Any, Any]:
        """The frame, the tree and the heights for compiled kernels."""
        if self._compiled is None:
            grid = self.tree.grid
            tree = compiled.Tree(self.tree.side, grid.width - 1, grid.height - 1, self.tree.level_count - 1)
            self._compiled = self.compiled_eye(compiled), tree, compiled.ground(self._heights)
        return self._compiled

    def select(self, split: Split, *, restricted: bool = False) -> Leaves:
        """The leaves in the LOD camera's frustum after splitting from the top down.

        `restricted`: adjacent leaves differ by one level at most; patches are split that `split` would leave whole.
        """
        top = self.tree.level_count - 1
        x = y = np.zeros(1, np.int64)
        visible: list[tuple[Ints, Ints]] = [(x, y)] * (top + 1)
        divided: list[NDArray[np.bool_]] = [np.zeros(0, bool)] * (top + 1)
        for level in range(top, -1, -1):
            seen = self.visible(level, x, y)
            x, y = x[seen], y[seen]
            visible[level] = x, y
            divided[level] = split(level, x, y) if level and x.size else np.zeros(x.size, bool)
            x, y = self._children(level, x[divided[level]], y[divided[level]])
        leaves = [(x[~cut], y[~cut]) for (x, y), cut in zip(visible, divided, strict=True)]
        if restricted:
            self._restrict(leaves, [_key(x[cut], y[cut]) for (x, y), cut in zip(visible, divided, strict=True)])
        x, y = np.concatenate(leaves, axis=1)
        return Leaves(np.repeat(np.arange(top + 1), [x.size for x, _ in leaves]), x, y)

    def _restrict(self, leaves: list[tuple[Ints, Ints]], divided: list[Ints]) -> None:
        """Split those leaves of every level, too, that must be for their neighbours' sake; `divided`: keys."""
        top = len(leaves) - 1
        keys = list(divided)
        for level in range(1, top):
            # where a patch is split its neighbours must exist, so their parents are split too
            x, y = _place(keys[level])
            rows, columns = self.tree.shape(level)
            around = [(x + dx, y + dy) for dx, dy in EDGES]
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

    def _children(self, level: int, x: Ints, y: Ints) -> tuple[Ints, Ints]:
        rows, columns = self.tree.shape(max(level - 1, 0))
        x, y = np.add.outer(2 * x, [0, 1, 0, 1]).ravel(), np.add.outer(2 * y, [0, 0, 1, 1]).ravel()
        inside = (x < columns) & (y < rows)
        return x[inside], y[inside]


def neighbours(leaves: Leaves, most: int = 1) -> Ints:
    """(n, 4): which leaf lies beyond the west, east, north and south edge, of the same level or up to `most` coarser.

    -1 where there is none, or finer ones are. In a restricted tree leaves are coarser by one level at most.
    """
    level, x, y = leaves
    if compiled := kernels():
        return np.asarray(compiled.neighbours(level, x, y, most))
    keys = level << 58 | y << 29 | x
    order = np.argsort(keys)
    known = keys[order]
    result = np.full((x.size, 4), -1, np.int64)
    if not x.size:
        return result
    for edge, (dx, dy) in enumerate(EDGES):
        px, py = x + dx, y + dy
        for step in range(most + 1):
            wanted = level + step << 58 | py >> step << 29 | px >> step
            place = np.minimum(np.searchsorted(known, wanted), x.size - 1)
            met = (known[place] == wanted) & (px >= 0) & (py >= 0)
            result[met, edge] = order[place[met]]
    return result


def coarser(leaves: Leaves) -> NDArray[np.bool_]:
    """(n, 4): whether a coarser leaf lies beyond the west, east, north and south edge, in a restricted tree."""
    beyond = neighbours(leaves)
    # what is not there has the last place, and no level above any
    return np.append(leaves.level, -1)[beyond] > leaves.level[:, None]


@cache
def kernels(module: str = "orogen.lod.quadtree_kernels") -> Any:
    """A module of compiled kernels; None where numba is not installed."""
    try:
        return import_module(module)
    except SettingsError:
        return None


def _key(x: Ints, y: Ints) -> Ints:
    return (y << 32) | (x & 0xFFFFFFFF)


def _place(key: Ints) -> tuple[Ints, Ints]:
    return key & 0xFFFFFFFF, key >> 32
