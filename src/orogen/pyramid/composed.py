"""Two pyramids of colours as one: what is drawn over an image, level by level."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.pyramid.contract import Pyramid
from orogen.pyramid.derived import DerivedPyramid
from orogen.pyramid.reduce import srgb_tables
from orogen.source.warp import sampled

Read = Callable[[int, slice, slice], NDArray[Any]]


class ComposedPyramid(DerivedPyramid):
    """An image and a source with levels of its own over it, whose texels are those of the image or halves of them.

    Levels as fine as the image's are read from its pyramid, finer ones are interpolated: nothing is built for the layer
    above. As built, and as exact, as the pyramid of the image is.
    """

    def __init__(self, below: Pyramid, above: Pyramid) -> None:
        super().__init__(below, above.source)
        self._above = above
        # texels of the layer above along one of the image: a power of two
        self._finer = (above.grid.width // below.grid.width).bit_length() - 1

    def available(self, level: int) -> bool:
        """Whether the image's level that is needed is there."""
        return 0 <= level < self.level_count and self._below.available(max(0, level - self._finer))

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """uint8 (rows, columns, 4) of a window of a level."""
        self._checked(level, rows, cols)
        return self._composed(self._below.read, level, rows, cols)

    def read_estimate(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """Like `read`, of an estimate of the image."""
        self._checked(level, rows, cols)
        return self._composed(self._below.read_estimate, level, rows, cols)

    def close(self) -> None:
        """Close both."""
        self._above.close()
        self._below.close()

    def _composed(self, read: Read, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        if level >= self._finer:
            below = read(level - self._finer, rows, cols)
        else:
            below = _interpolated(read, self._below.grid.shape, 2 ** (self._finer - level), rows, cols)
        return over(self._above.read(level, rows, cols), below)


def over(above: NDArray[np.uint8], below: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """One image over another, both (rows, columns, 4) of sRGB and straight alpha; mixed in linear light."""
    drawn = above[..., 3] > 0
    if not drawn.any():
        return below
    to_linear, to_srgb = srgb_tables()
    out = below.copy()
    front, back = above[drawn], below[drawn]
    share = front[:, 3:].astype(np.float32) / 255
    rest = back[:, 3:].astype(np.float32) / 255 * (1 - share)
    alpha = share + rest
    light = (to_linear[front[:, :3]] * share + to_linear[back[:, :3]] * rest) / alpha
    out[drawn, :3] = to_srgb[np.rint(np.minimum(light, 1) * np.float32(len(to_srgb) - 1)).astype(np.intp)]
    out[drawn, 3] = np.rint(255 * alpha[:, 0])
    return out


def _interpolated(read: Read, shape: tuple[int, int], factor: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
    """A window of level 0 with texels divided by `factor`, bilinearly; the image's edge goes on beyond it."""
    places, parts = [], []
    for part, size in zip((rows, cols), shape, strict=True):
        at = np.clip((np.arange(part.start, part.stop) + 0.5) / factor, 0.5, size - 0.5)
        low, high = int(at[0] - 0.5), min(size, int(at[-1] - 0.5) + 2)
        places.append(at - low)
        parts.append(slice(low, high))
    samples = read(0, parts[0], parts[1])
    return sampled(samples, *np.meshgrid(places[1], places[0]), "colour").astype(np.uint8)
