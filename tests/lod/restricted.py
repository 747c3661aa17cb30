"""Independent views of restricted quadtrees and flat meshes, for the algorithms that draw them."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lod.patches import torn_edges
from lod.scene import Scene
from orogen.camera import Camera
from orogen.frame import Frame

Leaf = tuple[int, int, int]
"""Level, column, row."""
Edge = tuple[tuple[int, int], tuple[int, int]]
SIDES = ((0, -1), (1, 0), (0, 1), (-1, 0))
"""Steps to the neighbours in the north, east, south and west."""


class Unculled(Frame):
    """A frame whose frustum is everywhere."""

    plane_rows = ((0.0, 0.0, 0.0, 1.0),) * 5


def unculled(frame: Frame) -> Unculled:
    return Unculled(**{field.name: getattr(frame, field.name) for field in dataclasses.fields(frame)})


def some_cameras(
    scene: Scene,
    count: int,
    seed: int,
    *,
    lowest: float = 60.0,
    spread: tuple[float, float] = (0.5, 3.3),
    up: float = 0.0,
    roll: float = 0.0,
) -> list[Camera]:
    """Over and beside the terrain, near and far: `lowest` + 10^`spread` metres high, looking down to `up` degrees."""
    random = np.random.default_rng(seed)
    width, height = scene.pyramid.grid.width, scene.pyramid.grid.height
    return [
        scene.camera(
            random.uniform(-0.2, 1.2) * width,
            random.uniform(-0.2, 1.2) * height,
            lowest + 10 ** random.uniform(*spread),
            heading=random.uniform(0, 360),
            pitch=random.uniform(-90, up),
            **({"roll": random.uniform(-roll, roll)} if roll else {}),
        )
        for _ in range(count)
    ]


class PlainQuadtree:
    """Patch by patch, over a grid of square texels; `side`: samples along a patch of level 0."""

    def __init__(self, scene: Scene, frame: Frame, side: float) -> None:
        self.scene, self.frame, self.side = scene, frame, side
        self.last = np.array([scene.pyramid.grid.width, scene.pyramid.grid.height]) - 1.0
        self.top = 0
        while side * 2**self.top < self.last.max():
            self.top += 1

    def exists(self, leaf: Leaf) -> bool:
        first = self.corners(leaf)[0]
        return bool((first >= 0).all() and (first < self.last).all())

    def corners(self, leaf: Leaf) -> NDArray[np.float64]:
        """(2, 2) first and last column and row of samples."""
        level, x, y = leaf
        return np.array([[x, y], [x + 1, y + 1]]) * self.side * 2.0**level

    def heights(self, leaf: Leaf) -> tuple[float, float]:
        """Lowest and highest height (m) that may be drawn in a patch."""
        low, high = self.corners(leaf)[:, None].astype(np.int64)
        bottom, top = self.scene.view.drawn_bounds(low, high)[0].tolist()
        return bottom, top

    def distance(self, first: NDArray[Any], last: NDArray[Any], heights: tuple[float, float]) -> float:
        """Metres from the LOD eye to an upright box, axis by axis.

        `first`, `last`: column and row of samples at its corners, which may lie past the data's.
        """
        eye = self.frame.lod_eye()
        corners = (np.minimum([first, last], self.last) + 0.5 - self.frame.eye) * np.diag(self.frame.grid.metres)
        upright = np.array(heights) * self.frame.exaggeration - self.frame.camera.z
        box = np.sort(np.column_stack([corners, upright]), axis=0)
        return float(np.linalg.norm(np.clip(eye, *box) - eye))

    def leaves(self, divided: Callable[[Leaf], bool]) -> set[Leaf]:
        """The restricted quadtree: what is divided, and whatever else must be for neighbours' sake."""
        leaves: set[Leaf] = set()
        stack = [(self.top, 0, 0)]
        while stack:
            leaf = stack.pop()
            if leaf[0] and divided(leaf):
                stack += self._children(leaf)
            else:
                leaves.add(leaf)
        while wrong := {larger for leaf in leaves for _, larger, steps in self.larger(leaves, leaf) if steps > 1}:
            for leaf in wrong:
                leaves.remove(leaf)
                leaves |= set(self._children(leaf))
        return leaves

    def larger(self, leaves: set[Leaf], leaf: Leaf) -> list[tuple[int, Leaf, int]]:
        """Sides of a leaf, by number, where the neighbour is coarser, with the neighbour and by how many levels."""
        level, x, y = leaf
        found = []
        for side, (dx, dy) in enumerate(SIDES):
            for steps in range(1, self.top - level + 1):
                other = level + steps, (x + dx) >> steps, (y + dy) >> steps
                if other in leaves:
                    found.append((side, other, steps))
        return found

    def _children(self, leaf: Leaf) -> list[Leaf]:
        level, x, y = leaf
        children = [(level - 1, 2 * x + i, 2 * y + j) for i in (0, 1) for j in (0, 1)]
        return [child for child in children if self.exists(child)]


def areas(corners: NDArray[Any]) -> NDArray[np.float64]:
    """Signed areas of (n, 3, 2) corners."""
    a, b, c = corners.astype(np.float64).swapaxes(0, 1)
    return ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2


def edge_counts(corners: NDArray[np.int64]) -> Counter[Edge]:
    """How many of the triangles (n, 3, 2) have each edge, whose ends are in order."""
    pairs = corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 2).tolist()
    return Counter(tuple(sorted((tuple(a), tuple(b)))) for a, b in pairs)  # type: ignore[misc]


def assert_whole(triangles: NDArray[np.float32], frame: Frame) -> None:
    """Triangles (n, 3, 3) end at the data's border alone, and cover the data once."""
    torn = torn_edges(triangles, (np.nan,) * 4)
    texel = torn[..., :2] @ np.linalg.inv(frame.grid.metres).T + frame.eye - 0.5
    last = np.array([frame.grid.width, frame.grid.height]) - 1.0
    border = np.concatenate([np.abs(texel) < 1e-3, np.abs(texel - last) < 1e-3], axis=-1)
    assert border.all(axis=1).any(axis=1).all()
    # flat areas add up: nothing lies over anything else
    flat = np.abs(areas(triangles[..., :2])).sum()
    expected = np.prod(last) * abs(np.linalg.det(frame.grid.metres))
    np.testing.assert_allclose(flat, expected, rtol=1e-4)
