"""ROAM once more, without anything of it: explicit triangles, neighbours found by their edges, built from the roots."""

from __future__ import annotations

import math
from collections import defaultdict
from functools import cache

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.grid import Grid
from orogen.source.open import open_height
from orogen.streaming.samples import Positions

Point = tuple[int, int]
Triangle = tuple[Point, Point, Point]
"""Apex, and both ends of the longest side."""


class Plain:
    """Heights in the place of a layer's samples."""

    def __init__(self, heights: NDArray[np.floating]) -> None:
        self.heights = np.asarray(heights, np.float32)
        self.shape = self.heights.shape

    def wait(self) -> None:
        pass

    def window(self, rows: slice, cols: slice) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
        part = self.heights[rows, cols]
        valid = np.isfinite(part)
        return np.nan_to_num(part), None if valid.all() else valid

    def at(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> NDArray[np.float32]:
        down, right = (Positions.of(at, count) for at, count in zip((rows, cols), self.shape, strict=True))
        return down.take(right.take(np.nan_to_num(self.heights)[np.ix_(down.needed, right.needed)], 1), 0)


def grid_of(heights: NDArray[np.floating], spacing: float = 10.0) -> Grid:
    return open_height(np.asarray(heights, np.float32), spacing=spacing).grid


class Twin:
    """A mesh over samples `side` << n apart at its roots; coordinates are in 1 / 2^bits samples."""

    def __init__(self, heights: NDArray[np.floating], side: int, shape: Point, bits: int, frame: Frame) -> None:
        """`shape`: (rows, columns) of cells of all root squares."""
        self.bits, self.frame = bits, frame
        self.cells = heights.shape[0] - 1, heights.shape[1] - 1
        pad = [(0, cells - own) for cells, own in zip(shape, self.cells, strict=True)]
        self.z = np.pad(heights.astype(np.float64), pad, "reflect", reflect_type="odd")
        self.width, self.height = shape[1] << bits, shape[0] << bits
        self.leaves: set[Triangle] = set()
        self.by_edge: dict[frozenset[Point], set[Triangle]] = defaultdict(set)
        self.wedgie = cache(self._wedgie)
        self.distortion = cache(self._distortion)
        step = side << bits
        for j in range(shape[0] // side):
            for i in range(shape[1] // side):
                west, north = i * step, j * step
                a, b, c, d = (
                    (west, north), (west + step, north), (west, north + step), (west + step, north + step)
                )  # fmt: skip
                for root in [(b, a, d), (c, a, d)] if (i + j) % 2 == 0 else [(a, b, c), (d, b, c)]:
                    self._add(root)

    def _add(self, triangle: Triangle) -> None:
        self.leaves.add(triangle)
        for edge in edges(triangle):
            self.by_edge[edge].add(triangle)

    def _remove(self, triangle: Triangle) -> None:
        self.leaves.remove(triangle)
        for edge in edges(triangle):
            self.by_edge[edge].remove(triangle)

    def height_at(self, p: Point) -> float:
        x, y = p[0] / 2**self.bits, p[1] / 2**self.bits
        i, j = min(int(x), self.z.shape[1] - 2), min(int(y), self.z.shape[0] - 2)
        u, v = x - i, y - j
        z = self.z
        return float(
            z[j, i] * (1 - u) * (1 - v)
            + z[j, i + 1] * u * (1 - v)
            + z[j + 1, i] * (1 - u) * v
            + z[j + 1, i + 1] * u * v
        )

    def _wedgie(self, t: Triangle) -> float:
        """Half the thickness; -1 where the raster is not."""
        one = 1 << self.bits
        legs = abs(t[1][0] - t[0][0]) + abs(t[1][1] - t[0][1])
        if max(t[1][0], t[2][0]) - min(t[1][0], t[2][0]) <= one and legs <= one:
            # in one cell: the sum of the heights of ever smaller triangles' new vertices
            i, j = (int(sum(p[k] for p in t) / 3) >> self.bits for k in (0, 1))
            if j >= self.cells[0] or i >= self.cells[1]:
                return -1.0
            z = self.z
            twist = abs(z[j, i] + z[j + 1, i + 1] - z[j, i + 1] - z[j + 1, i])
            wide = max(abs(t[1][k] - t[2][k]) for k in (0, 1)) / one
            diagonal = t[1][0] != t[2][0] and t[1][1] != t[2][1]
            return float(twist * wide**2 / (3 if diagonal else 12))
        thicker = max(self.wedgie(part) for part in parts(t))
        if thicker < 0:
            return -1.0
        return thicker + abs(self.height_at(middle(t)) - (self.height_at(t[1]) + self.height_at(t[2])) / 2)

    def _distortion(self, t: Triangle) -> float:
        frame, half = self.frame, max(self.wedgie(t), 0.0)
        if half == 0:
            return 0.0
        place = np.array(t) / 2**self.bits + 0.5 - frame.eye
        flat = place @ frame.grid.metres.T
        up = np.array([self.height_at(p) for p in t]) * frame.exaggeration - frame.camera.z
        corners = np.column_stack([flat, up])
        half *= frame.exaggeration
        planes = frame.planes()
        slack = 1e-3 * np.linalg.norm(flat[1] - flat[2])
        inside = (corners @ planes[:, :3].T + planes[:, 3]).max(axis=0) + np.abs(planes[:, 2]) * half + slack >= 0
        if not inside.all():
            return 0.0
        seen = (corners - frame.lod_eye()) @ frame.lod.basis.T
        vertical = frame.lod.basis[:, 2]
        moves = np.linalg.norm(np.cross(vertical, seen)[:, :2], axis=1).max()
        nearest = seen[:, 2].min() - abs(vertical[2]) * half
        return float(half * moves / nearest**2 * frame.pixels_per_radian(frame.lod)) if nearest > 0 else 1e30

    def priority(self, t: Triangle) -> float:
        """Of both triangles that share the longest side."""
        if max(abs(t[1][k] - t[2][k]) for k in (0, 1)) <= 2 and t[1][0] != t[2][0] and t[1][1] != t[2][1]:
            return 0.0
        (x, y), m = t[0], middle(t)
        other = (2 * m[0] - x, 2 * m[1] - y)
        mirrored = [(other, t[1], t[2])] if 0 <= other[0] <= self.width and 0 <= other[1] <= self.height else []
        return max(self.distortion(each) for each in [t, *mirrored])

    def importance(self, t: Triangle) -> tuple[float, ...]:
        """Of equal ones the largest first, then from the first row on."""
        x, y = middle(t)
        return self.priority(t), math.dist(t[1], t[2]), -y, -x

    def split(self, t: Triangle) -> None:
        base = frozenset(t[1:])
        for neighbour in self.by_edge[base] - {t}:
            if frozenset(neighbour[1:]) != base:
                self.split(neighbour)
        for half in list(self.by_edge[base]):
            self._remove(half)
            for part in parts(half):
                self._add(part)

    def refine(self, tau: float, most: float = math.inf) -> set[Triangle]:
        """Split the most important triangle until all are within `tau` or there would be more than `most`."""
        while True:
            t = max(self.leaves, key=self.importance)
            if self.priority(t) <= tau:
                return self.leaves
            before = set(self.leaves)
            self.split(t)
            if len(self.leaves) > most:
                return before


def middle(t: Triangle) -> Point:
    return (t[1][0] + t[2][0]) // 2, (t[1][1] + t[2][1]) // 2


def parts(t: Triangle) -> list[Triangle]:
    return [(middle(t), t[0], t[1]), (middle(t), t[0], t[2])]


def edges(t: Triangle) -> list[frozenset[Point]]:
    return [frozenset(pair) for pair in ((t[0], t[1]), (t[0], t[2]), (t[1], t[2]))]


def named(triangles: set[Triangle]) -> set[tuple[int, int, int, int]]:
    """Middle and apex of each."""
    return {(*middle(t), *t[0]) for t in triangles}


def corners_of(triangles: NDArray[np.integer]) -> NDArray[np.int64]:
    """(n, 3, 2) apex and both ends of triangles given as middle and apex."""
    centre, apex = triangles[:, :2].astype(np.int64), triangles[:, 2:].astype(np.int64)
    turned = (apex - centre)[:, ::-1] * [-1, 1]
    return np.stack([apex, centre + turned, centre - turned], axis=1)
