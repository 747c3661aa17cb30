"""Patches as pages: words that the GPU reads as they are.

A page holds the number of triangles, the word of the first of them, vertices (column, row, height) and triangles, each
three vertex numbers of ten bits in a word. Columns and rows count from the upper left corner of the box around the
patch, in units of its level (`Diamonds.unit`); heights are metres, bits of a float.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from orogen.lod.bdam.diamonds import Diamonds, Ints
from orogen.streaming.samples import Samples

Words = NDArray[np.uint32]
F32 = NDArray[np.float32]


@lru_cache
def template(n: int) -> tuple[Ints, Words]:
    """Vertices and triangles of a patch that has all its vertices, n quads along every side.

    Shares of its three corners in n-ths (vertices, 3), and vertex numbers as in a page. It is bisected as the patches
    themselves are, so that its smallest triangles never reach across a bilinear cell's edge.
    """
    triangles = n * np.eye(3, dtype=np.int64)[None]
    while len(triangles) < n * n:
        a, b, c = triangles.swapaxes(0, 1)
        middle = (a + b) // 2
        triangles = np.stack([np.stack([c, a, middle], 1), np.stack([b, c, middle], 1)], 1).reshape(-1, 3, 3)
    vertices, numbers = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, packed(numbers.reshape(-1, 3))


def packed(triangles: Ints) -> Words:
    """(n,) words of (n, 3) vertex numbers."""
    return (triangles[:, 0] | triangles[:, 1] << 10 | triangles[:, 2] << 20).astype(np.uint32)


def triangles_of(words: Words) -> Ints:
    """(n, 3) vertex numbers of (n,) words."""
    return np.stack([words & 1023, words >> 10 & 1023, words >> 20], axis=1).astype(np.int64)


def full_page_words(n: int) -> int:
    """Words of the page of a patch that has all its vertices."""
    vertices, triangles = template(n)
    return 2 + 3 * len(vertices) + len(triangles)


def full_page(diamonds: Diamonds, level: int, corners: Ints, window: F32, left: int, top: int) -> Words:
    """The page of a patch of level 0 or below, which has all its vertices.

    corners: (3, 2) subtexels. window: heights of all samples around it, the first of which is (left, top).
    """
    weights, words = template(diamonds.n)
    at = weights @ corners // diamonds.n
    inside: NDArray[np.bool_] = np.less_equal(at, diamonds.last << diamonds.bits).all(axis=1)
    if not inside.all():
        # its triangles end where the raster does
        numbers = triangles_of(words)
        numbers = numbers[inside[numbers].all(axis=1)]
        used, numbers = np.unique(numbers, return_inverse=True)
        at, words = at[used], packed(numbers.reshape(-1, 3))
    page = np.empty(2 + 3 * len(at) + len(words), np.uint32)
    page[0], page[1] = len(words), 2 + 3 * len(at)
    vertices = page[2 : page[1]].reshape(-1, 3)
    vertices[:, :2] = (at - corners.min(axis=0)) // diamonds.unit(level)
    vertices[:, 2] = _heights(at, diamonds.bits, window, left, top).view(np.uint32)
    page[page[1] :] = words
    return page


def window_around(samples: Samples, diamonds: Diamonds, corners: Ints) -> tuple[F32, int, int]:
    """Heights of all samples in the box around corners (..., 2) in subtexels; its first column and row."""
    places = corners.reshape(-1, 2)
    low = places.min(axis=0) >> diamonds.bits
    high = np.minimum(-(-places.max(axis=0) >> diamonds.bits), diamonds.last)
    window, _ = samples.window(slice(int(low[1]), int(high[1]) + 1), slice(int(low[0]), int(high[0]) + 1))
    return window, int(low[0]), int(low[1])


def _heights(at: Ints, bits: int, window: F32, left: int, top: int) -> F32:
    """(n,) bilinear heights at (n, 2) subtexels: the same for the same place, whatever the window."""
    x, y = (at >> bits).T - np.array([[left], [top]])
    fx, fy = ((at & (1 << bits) - 1) / (1 << bits)).astype(np.float32).T
    next_x, next_y = np.minimum(x + 1, window.shape[1] - 1), np.minimum(y + 1, window.shape[0] - 1)
    upper = window[y, x] + (window[y, next_x] - window[y, x]) * fx
    lower = window[next_y, x] + (window[next_y, next_x] - window[next_y, x]) * fx
    return upper + (lower - upper) * fy
