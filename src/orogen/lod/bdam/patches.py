"""From a patch's code to its page: out of the library, or made of samples where it has all its vertices."""

from __future__ import annotations

from typing import Any

import numpy as np

from orogen.lod.bdam.diamonds import Diamonds, Floats, Ints, place
from orogen.lod.bdam.ground import Ground
from orogen.lod.bdam.pages import Words, full_page, full_page_words, window_around
from orogen.lod.bdam.store import Library
from orogen.streaming.samples import Samples


class Patches:
    """All patches of a terrain. Safe to use from several threads at once."""

    def __init__(self, samples: Samples, diamonds: Diamonds, library: Library) -> None:
        self.diamonds = diamonds
        self.ground = Ground(diamonds, library.cells)
        self._samples = samples
        self._library = library
        self.chords = np.array([self._chord(level) for level in range(diamonds.lowest, diamonds.top + 1)])
        """Per level from the lowest: a quarter of the squared metres of the longest edge that there may be."""
        self._facts: Any = None
        self.page_bytes = 4 * max(library.page_words, full_page_words(diamonds.n))
        """Bytes of the largest page."""
        self.triangle_counts: dict[int, int] = {}
        """Triangles of every patch that has been asked for, by its code."""

    def __call__(self, code: int) -> Words:
        """The page of a patch."""
        level, cx, cy, side = place(code)
        if level > 0:
            page = self._library.levels[level - 1].page(cx, cy, side)
        else:
            corners = self.diamonds.corners(level, np.array([cx]), np.array([cy]), np.array([side]))[0]
            page = full_page(self.diamonds, level, corners, *window_around(self._samples, self.diamonds, corners))
        self.triangle_counts[code] = int(page[0])
        return page

    def facts(self, compiled: Any) -> Any:
        """All that does not change, for the compiled walk."""
        if self._facts is None:
            self._facts = compiled.facts(self.diamonds, self.ground, [level.errors for level in self._library.levels])
        return self._facts

    def _chord(self, level: int) -> float:
        diamonds = self.diamonds
        longest = np.array([[1.0, 1.0], [1.0, -1.0]] if level % 2 == 0 else [[1.0, 0.0], [0.0, 1.0]])
        longest *= 2 * diamonds.half(level) / (1 << diamonds.bits) / (1 if level > 0 else diamonds.n)
        return float(((diamonds.grid.metres @ longest) ** 2).sum(axis=0).max()) / 4

    def errors(self, level: int, cx: Ints, cy: Ints) -> Floats:
        """Metres that diamonds and all that they may be split into are off the true surface, at most."""
        if level > 0:
            return self._library.levels[level - 1].errors[cy, cx].astype(np.float64)
        return self.ground.errors(level, cx, cy)
