"""Which patches a frame shows: a walk down the bintree that splits diamonds, so that their meshes fit together."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.bdam.diamonds import Diamonds, Floats, Ints, code
from orogen.lod.bdam.patches import Patches
from orogen.lod.quadtree import PatchFrame, PatchTree


@dataclass(frozen=True)
class Choice:
    """Patches of a frame."""

    drawn: list[tuple[int, Ints, Ints, Ints]]
    """Per level that has some: the level, cx, cy and side of the patches to draw."""
    codes: list[int]
    """Codes of these, in the same order."""
    wanted: list[int]
    """Codes of all patches on the way down to them that may be seen, the coarsest first."""


class _Boxes:
    """What PatchFrame asks a tree for, where the places are boxes themselves."""

    def __init__(self, diamonds: Diamonds) -> None:
        self.grid = diamonds.grid

    def samples(self, level: int, first: Floats, last: Floats) -> tuple[Floats, Floats]:
        return first, last


class DiamondFrame(PatchFrame):
    """The diamonds as the LOD camera of a frame sees them. Places are boxes of samples, levels cells of the ground."""

    def __init__(self, patches: Patches, frame: Frame, pixels: float) -> None:
        """`pixels`: that the surface may be off."""
        # the ranges of the ground stand for those of the clipmap's nodes
        super().__init__(cast(PatchTree, _Boxes(patches.diamonds)), frame, cast(Any, None))
        self._patches = patches
        self._diamonds = patches.diamonds
        self._scale = frame.pixels_per_radian(frame.lod) / pixels

    def bounds(self, level: int, x: NDArray[Any], y: NDArray[Any]) -> tuple[Floats, Floats]:
        """Lowest and highest true height (m) in boxes from x to y (column, row)."""
        return self._patches.ground.range(level, x, y)

    def shares(self, level: int, cx: Ints, cy: Ints) -> Floats:
        """Screen-space errors of diamonds, over what they may be.

        The object-space error at the nearest point of the box, which holds the boxes of all that comes of a split, or
        at the near plane: nothing nearer is drawn. Never less than for any diamond further down.
        """
        distance = self.distance(self._mip(level, 6), *cast(Any, self._diamonds.box(level, cx, cy)))
        errors = self._patches.errors(level, cx, cy) * self.frame.exaggeration + self._sag(level)
        return errors * self._scale / np.maximum(distance, self.frame.lod.near)

    def choose(self, resident: Container[int] | None = None) -> Choice:
        """What to draw, of the `resident` patches alone: coarser ones where finer ones are not there yet."""
        diamonds, level = self._diamonds, self._diamonds.top
        cx, cy, side = np.ones(2, np.int64), np.ones(2, np.int64), np.arange(2)
        exist, seen = self._looked_at(level, cx, cy, side)
        cx, cy, side, seen = cx[exist], cy[exist], side[exist], seen[exist]
        result = Choice([], [], code(level, cx, cy, side)[seen].tolist())
        if resident is not None and not all(number in resident for number in result.wanted):
            return Choice([], [], [])
        while cx.size:
            keys, diamond = np.unique(cy << 32 | cx, return_inverse=True)
            x, y = keys & 0xFFFFFFFF, keys >> 32
            # a diamond is split as a whole, so all of it has to be there
            halves = sum(diamonds.exists(level, x, y, np.full(x.size, half)).astype(np.int64) for half in (0, 1))
            split = (np.bincount(diamond, minlength=keys.size) == halves) & self._too_coarse(level, x, y)
            parts = diamonds.children(level, x, y)
            exist, visible = self._looked_at(level - 1, *parts)
            numbers = code(level - 1, *parts)
            if resident is not None:
                there = [[number in resident for number in four] for four in numbers[split].tolist()]
                split[split] = (np.array(there, bool).reshape(-1, 4) | ~visible[split]).all(axis=1)
            shown = seen & ~split[diamond]
            if shown.any():
                chosen = cx[shown], cy[shown], side[shown]
                result.drawn.append((level, *chosen))
                result.codes.extend(code(level, *chosen).tolist())
            exist &= split[:, None]
            visible &= exist
            result.wanted.extend(numbers[visible].tolist())
            cx, cy, side = (values[exist] for values in parts)
            seen = visible[exist]
            level -= 1
        return result

    def _too_coarse(self, level: int, cx: Ints, cy: Ints) -> NDArray[np.bool_]:
        """Whether diamonds have to be split: those that anything to be seen may come of."""
        if level == self._diamonds.lowest:
            return np.zeros(cx.size, bool)
        visible = self.visible(self._mip(level, 6), *cast(Any, self._diamonds.box(level, cx, cy)))
        return visible & (self.shares(level, cx, cy) > 1)

    def _looked_at(self, level: int, cx: Ints, cy: Ints, side: Ints) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether patches exist, and whether they may be in the picture."""
        flat = cx.ravel(), cy.ravel(), side.ravel()
        exist = self._diamonds.exists(level, *flat)
        visible = self.visible(self._mip(level, 2), *cast(Any, self._diamonds.patch_box(level, *flat)))
        return exist.reshape(cx.shape), (exist & visible).reshape(cx.shape)

    def _mip(self, level: int, halves: int) -> int:
        """The cells of the ground that suit boxes of a level."""
        return self._patches.ground.mip(halves * self._diamonds.half(level) / (1 << self._diamonds.bits))

    def _sag(self, level: int) -> float:
        """Metres by which the longest edge that there may be passes under the bent ground, with curvature."""
        diamonds = self._diamonds
        longest = np.array([[1.0, 1.0], [1.0, -1.0]] if level % 2 == 0 else [[1.0, 0.0], [0.0, 1.0]])
        longest *= 2 * diamonds.half(level) / (1 << diamonds.bits) / (1 if level > 0 else diamonds.n)
        return self.frame.curvature_factor * float(((diamonds.grid.metres @ longest) ** 2).sum(axis=0).max()) / 4
