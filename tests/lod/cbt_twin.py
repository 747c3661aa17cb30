"""Longest edge bisection by geometry alone: the smallest conforming tree in which all wishes are met."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.cbt import Settings
from orogen.lod.cbt.field import Shape

Place = tuple[int, int]


@dataclass(frozen=True)
class Triangle:
    node: int
    apex: Place
    first: Place
    last: Place

    @property
    def middle(self) -> Place:
        return (self.first[0] + self.last[0]) // 2, (self.first[1] + self.last[1]) // 2

    @property
    def depth(self) -> int:
        return self.node.bit_length() - 1

    @property
    def corners(self) -> tuple[Place, Place, Place]:
        return self.apex, self.first, self.last

    def halves(self) -> tuple[Triangle, Triangle]:
        return (
            Triangle(2 * self.node, self.middle, self.apex, self.first),
            Triangle(2 * self.node + 1, self.middle, self.last, self.apex),
        )


def roots(side: int) -> list[Triangle]:
    return [
        Triangle(2, (0, 0), (0, side), (side, 0)),
        Triangle(3, (side, side), (side, 0), (0, side)),
    ]


def smallest_tree(side: int, is_wanted: Callable[[Triangle], bool]) -> dict[int, Triangle]:
    """Leaves by node, once all wishes are met and no corner lies inside another triangle's edge."""
    leaves: list[Triangle] = []
    rest = roots(side)
    while rest:
        triangle = rest.pop()
        if is_wanted(triangle):
            rest.extend(triangle.halves())
        else:
            leaves.append(triangle)
    while True:
        corners = {corner for leaf in leaves for corner in leaf.corners}
        hanging = [any(middle in corners for middle in middles(leaf)) for leaf in leaves]
        if not any(hanging):
            return {leaf.node: leaf for leaf in leaves}
        leaves = [
            part
            for leaf, divided in zip(leaves, hanging, strict=True)
            for part in (leaf.halves() if divided else (leaf,))
        ]


def middles(triangle: Triangle) -> Iterator[tuple[float, float]]:
    a, b, c = triangle.corners
    for p, q in ((a, b), (b, c), (c, a)):
        yield (p[0] + q[0]) / 2, (p[1] + q[1]) / 2


class Wishes:
    """The criterion in float64, for a frustum that is everywhere."""

    def __init__(self, frame: Frame, settings: Settings, shape: Shape) -> None:
        self.frame, self.shape = frame, shape
        self.unit = 1 << frame.subtexel_bits
        self.last = (np.array([frame.grid.width, frame.grid.height]) - 1) * self.unit
        stretch = np.linalg.svd(frame.grid.metres / self.unit)[1].max()
        self.longest = np.sqrt(2) * shape.side * stretch
        self.scale = frame.pixels_per_radian(frame.lod)
        self.factor = max(self.scale / settings.length, 4.0)
        self.closest = np.inf
        """How near to the verge a decision was, as a part of the distance."""

    def metres(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Camera-relative (east, north) of subtexels from the first sample."""
        return self.frame.grid.metres @ (place / self.unit + 0.5 - self.frame.eye)

    def is_hidden(self, triangle: Triangle) -> bool:
        low = np.min(triangle.corners, axis=0)
        return bool(triangle.depth >= self.shape.depth or (low >= self.last).any())

    def away(self, triangle: Triangle) -> float:
        middle = np.minimum(triangle.middle, self.last).astype(np.float64)
        ground = self.frame.ground_height * self.frame.exaggeration - self.frame.camera.z
        return float(np.linalg.norm(np.append(self.metres(middle), ground) - self.frame.lod_eye()))

    def is_long(self, triangle: Triangle) -> bool:
        return self.decide(self.factor * self.longest * 2 ** (-(triangle.depth - 1) / 2), self.away(triangle))

    def decide(self, reach: float, away: float) -> bool:
        self.closest = min(self.closest, abs(reach / away - 1))
        return away < reach

    def __call__(self, triangle: Triangle) -> bool:
        return not self.is_hidden(triangle) and self.is_long(triangle)


class RoughWishes(Wishes):
    """Errors against bilinear float64 heights, from the finest level everywhere.

    `smallest_tree` asks only for halves of what was wanted divided, so that what a node is a part of needs no look.
    """

    def __init__(self, frame: Frame, settings: Settings, shape: Shape, heights: NDArray[np.floating]) -> None:
        super().__init__(frame, settings, shape)
        assert settings.error is not None
        self.error, self.heights = settings.error, heights.astype(np.float64)
        self.decided_by_error = 0

    def ground(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Drawn heights (n) of subtexels (n, 2) from the first sample, less the camera's and the globe's drop."""
        x, y = (place / self.unit).T
        column = np.clip(x.astype(int), 0, self.heights.shape[1] - 2)
        row = np.clip(y.astype(int), 0, self.heights.shape[0] - 2)
        x, y, z = x - column, y - row, self.heights
        top = z[row, column] * (1 - x) + z[row, column + 1] * x
        bottom = z[row + 1, column] * (1 - x) + z[row + 1, column + 1] * x
        flat = (place / self.unit + 0.5 - self.frame.eye) @ self.frame.grid.metres.T
        drop = self.frame.curvature_factor * (flat**2).sum(axis=1)
        return (top * (1 - y) + bottom * y) * self.frame.exaggeration - drop

    def __call__(self, triangle: Triangle) -> bool:
        if self.is_hidden(triangle):
            return False
        if self.is_long(triangle):
            return True
        self.decided_by_error += 1
        apex, first, last = np.minimum(triangle.corners, self.last).astype(np.float64)
        middle, near, far = (first + last) / 2, (3 * first + last) / 4, (first + 3 * last) / 4
        samples = [middle, near, far, (apex + first) / 2, (apex + last) / 2, (apex + near) / 2, (apex + far) / 2]
        (a, b, c), ground = np.split(self.ground(np.array([apex, first, last, *samples])), [3])
        on_edge = [(b + c) / 2, (3 * b + c) / 4, (b + 3 * c) / 4]
        drawn = [*on_edge, (a + b) / 2, (a + c) / 2, (a + on_edge[1]) / 2, (a + on_edge[2]) / 2]
        return self.decide(np.abs(ground - drawn).max() * self.scale / self.error, self.away(triangle))
