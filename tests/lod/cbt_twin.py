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
        self.factor = max(frame.pixels_per_radian(frame.lod) / settings.pixels, 4.0)
        self.closest = np.inf
        """How near to the verge a decision was, as a part of the distance."""

    def metres(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Camera-relative (east, north) of subtexels from the first sample."""
        return self.frame.grid.metres @ (place / self.unit + 0.5 - self.frame.eye)

    def __call__(self, triangle: Triangle) -> bool:
        low = np.min(triangle.corners, axis=0)
        if triangle.depth >= self.shape.depth or (low >= self.last).any():
            return False
        middle = np.minimum(triangle.middle, self.last).astype(np.float64)
        frame = self.frame
        ground = frame.ground_height * frame.exaggeration - frame.camera.z
        away = np.linalg.norm(np.append(self.metres(middle), ground) - frame.lod_eye())
        reach = self.factor * self.longest * 2 ** (-(triangle.depth - 1) / 2)
        self.closest = min(self.closest, abs(away / reach - 1))
        return bool(away < reach)
