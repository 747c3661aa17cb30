"""Quadtree patches whose data are pages: which are on the GPU, and what is drawn where some are not there yet."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from orogen.lod.quadtree import Ints, Leaves
from orogen.streaming.pages import PageStore

K = TypeVar("K", bound=Hashable)


class Residents(Generic[K]):
    """The resident pages of a store as arrays, in the order of numbers that stand for their keys."""

    def __init__(self, pages: PageStore[K], number: Callable[[K], int]) -> None:
        """`number`: of a key, below 2^63; other keys have others."""
        self._pages = pages
        self._number = number
        self.version = -1
        """Of the store, as it was followed."""
        self.keys: list[K] = []
        """Of all resident pages."""
        self.numbers: Ints = np.zeros(0, np.int64)
        """(n,) of these, in order."""
        self.slots: Ints = np.zeros(0, np.int64)
        """(n,) where these are."""

    def update(self) -> bool:
        """Follow the store; whether anything has come or gone. Before anything else, in every frame."""
        if self.version == self._pages.version:
            return False
        self.version = self._pages.version
        resident = self._pages.resident
        found = sorted((self._number(key), key) for key in resident)
        self.keys = [key for _, key in found]
        self.numbers = np.array([number for number, _ in found], np.int64)
        self.slots = np.array([resident[key] for key in self.keys], np.int64)
        return True

    def places(self, numbers: Ints) -> Ints:
        """Where pages are in these arrays; -1: not there."""
        if not self.numbers.size:
            return np.full(numbers.shape, -1, np.int64)
        place = np.minimum(np.searchsorted(self.numbers, numbers), self.numbers.size - 1)
        return np.where(self.numbers[place] == numbers, place, -1)


def number_of(level: Any, x: Any, y: Any) -> Any:
    """A number for every patch (numbers or arrays), in the order of level, column and row."""
    return level << 58 | x << 29 | y


def drawable(leaves: Leaves, residents: Residents[K]) -> tuple[Leaves, Ints]:
    """The leaves, or the nearest resident patches that they are parts of, none below another; and their places."""
    numbers = number_of(*leaves)
    places = residents.places(numbers)
    if not numbers.size or places.min() >= 0:
        return leaves, places
    top = int(leaves.level.max()) if not residents.numbers.size else int(residents.numbers[-1] >> 58)
    level, x, y = leaves
    while (lacking := (places < 0) & (level < top)).any():
        level, x, y = level + lacking, x >> lacking, y >> lacking
        places = residents.places(number_of(level, x, y))
    found = np.unique(number_of(level, x, y)[places >= 0])
    level, x, y = _places_of(found)
    below = np.zeros(found.size, bool)
    for step in range(1, top + 1):
        above = number_of(level + step, x >> step, y >> step)
        below |= np.isin(above, found) & (level + step <= top)
    found = found[~below]
    return Leaves(*_places_of(found)), residents.places(found)


def with_ancestors(leaves: Leaves, top: int) -> list[tuple[int, int, int]]:
    """(level, x, y) of patches and of all that they are parts of up to level `top`, the coarsest first."""
    level, x, y = leaves
    found: set[tuple[int, int, int]] = set()
    for step in range(top + 1):
        here = level + step <= top
        level, x, y = level[here], x[here], y[here]
        found.update(zip((level + step).tolist(), (x >> step).tolist(), (y >> step).tolist(), strict=True))
    return sorted(found, reverse=True)


def _places_of(numbers: Ints) -> tuple[Ints, Ints, Ints]:
    low = (1 << 29) - 1
    return numbers >> 58, numbers >> 29 & low, numbers & low


def rows_of(clusters: NDArray[np.int64]) -> tuple[Ints, Ints]:
    """For patches that are drawn in so many clusters each: of every cluster the patch, and its number there."""
    patch = np.repeat(np.arange(clusters.size), clusters)
    return patch, np.arange(patch.size) - np.repeat(np.cumsum(clusters) - clusters, clusters)
