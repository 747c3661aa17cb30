"""Which patches a frame shows: a walk down the bintree that splits diamonds, so that their meshes fit together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.bdam.diamonds import Floats, Ints, code
from orogen.lod.bdam.patches import Patches
from orogen.lod.quadtree import BoxFrame, kernels


class Choice(NamedTuple):
    """Patches of a frame."""

    level: Ints
    """(n,) of the patches to draw, from the top down."""
    cx: Ints
    """(n,)"""
    cy: Ints
    """(n,)"""
    side: Ints
    """(n,)"""
    wanted: Ints
    """Codes of all patches on the way down to them that may be seen, the coarsest first."""

    @property
    def codes(self) -> Ints:
        """(n,) codes of the patches to draw."""
        return code(self.level, self.cx, self.cy, self.side)


class DiamondFrame(BoxFrame):
    """The diamonds as the LOD camera of a frame sees them."""

    def __init__(self, patches: Patches, frame: Frame, pixels: float) -> None:
        """`pixels`: that the surface may be off."""
        super().__init__(patches.diamonds.grid, frame)
        self._patches = patches
        self._diamonds = patches.diamonds
        self._scale = frame.pixels_per_radian(frame.lod) / pixels
        # by which the longest edges that there may be pass under the bent ground
        self._sags = frame.curvature_factor * patches.chords

    def shares(self, level: int, cx: Ints, cy: Ints) -> Floats:
        """Screen-space errors of diamonds, over what they may be.

        The object-space error at the nearest point of the box, which holds the boxes of all that comes of a split, or
        at the near plane: nothing nearer is drawn. Never less than for any diamond further down.
        """
        first, last = self._diamonds.box(level, cx, cy)
        distance = self.box_distance(first, last, *self._patches.ground.range(self._mip(level, 6), first, last))
        errors = self._patches.errors(level, cx, cy) * self.frame.exaggeration
        errors += self._sags[level - self._diamonds.lowest]
        return errors * self._scale / np.maximum(distance, self.frame.lod.near)

    def choose(self, resident: Ints | None = None) -> Choice:
        """What to draw, of the patches with these codes, in order; coarser ones where finer ones are not there."""
        if compiled := kernels("orogen.lod.bdam.walk"):
            codes = _NO_CODES if resident is None else resident
            near = float(self.frame.lod.near)
            eye, facts = self.compiled_eye(compiled), self._patches.facts(compiled)
            return Choice(*compiled.choose(eye, facts, self._sags, self._scale, near, codes, resident is None))
        return self._walk(resident)

    def _walk(self, resident: Ints | None) -> Choice:
        diamonds, level = self._diamonds, self._diamonds.top
        cx, cy, side = np.ones(2, np.int64), np.ones(2, np.int64), np.arange(2)
        exist, seen = self._looked_at(level, cx, cy, side)
        cx, cy, side, seen = cx[exist], cy[exist], side[exist], seen[exist]
        drawn: list[tuple[Ints, Ints, Ints, Ints]] = [(_NO_CODES,) * 4]
        wanted = [code(level, cx, cy, side)[seen]]
        if resident is not None and not np.isin(wanted[0], resident).all():
            return Choice(*(_NO_CODES,) * 5)
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
                split &= (np.isin(numbers, resident) | ~visible).all(axis=1)
            shown = seen & ~split[diamond]
            drawn.append((np.full(int(shown.sum()), level), cx[shown], cy[shown], side[shown]))
            exist &= split[:, None]
            visible &= exist
            wanted.append(numbers[visible])
            cx, cy, side = (values[exist] for values in parts)
            seen = visible[exist]
            level -= 1
        levels, cx, cy, side = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
        return Choice(levels, cx, cy, side, np.concatenate(wanted))

    def _too_coarse(self, level: int, cx: Ints, cy: Ints) -> NDArray[np.bool_]:
        """Whether diamonds have to be split: those that anything to be seen may come of."""
        if level == self._diamonds.lowest:
            return np.zeros(cx.size, bool)
        first, last = self._diamonds.box(level, cx, cy)
        visible = self.box_visible(first, last, *self._patches.ground.range(self._mip(level, 6), first, last))
        return visible & (self.shares(level, cx, cy) > 1)

    def _looked_at(self, level: int, cx: Ints, cy: Ints, side: Ints) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether patches exist, and whether they may be in the picture."""
        flat = cx.ravel(), cy.ravel(), side.ravel()
        exist = self._diamonds.exists(level, *flat)
        first, last = self._diamonds.patch_box(level, *flat)
        visible = self.box_visible(first, last, *self._patches.ground.range(self._mip(level, 2), first, last))
        return exist.reshape(cx.shape), (exist & visible).reshape(cx.shape)

    def _mip(self, level: int, halves: int) -> int:
        """The cells of the ground that suit boxes of a level."""
        return self._patches.ground.mip(halves * self._diamonds.half(level) / (1 << self._diamonds.bits))


_NO_CODES = np.zeros(0, np.int64)
