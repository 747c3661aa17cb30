"""The recursion of rag in float64, triangle by triangle, written from Schmiade 2008 and not from the shaders."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.rag import Settings

Cell = tuple[int, int]
"""Subtexels from the first sample."""
Triangle = tuple[Cell, Cell, Cell]
"""The longest edge of a right-angled one lies between the last two."""

VERGE = 3e-4
"""Decisions that are as close as this, relative to the threshold, may fall either way."""


def edge(a: Cell, b: Cell) -> tuple[Cell, Cell]:
    return (a, b) if a < b else (b, a)


def middle(a: Cell, b: Cell) -> Cell:
    return (a[0] + b[0]) >> 1, (a[1] + b[1]) >> 1


def edges(triangle: Triangle) -> list[tuple[Cell, Cell]]:
    """Across from the first, the second and the third corner."""
    a, b, c = triangle
    return [edge(b, c), edge(c, a), edge(a, b)]


class Twin:
    """One frame, nothing culled. `seen`: vertices of what is compared, which settle decisions on the verge."""

    def __init__(self, frame: Frame, settings: Settings, heights: NDArray[np.floating], seen: set[Cell]) -> None:
        self.frame = Frame(
            frame.lod, frame.grid, frame.size, height_range=frame.height_range, exaggeration=frame.exaggeration,
            curvature=frame.curvature, ground_height=frame.ground_height,
        )  # fmt: skip
        self.settings, self.heights, self.seen = settings, np.asarray(heights, np.float64), seen
        self.known: dict[Cell, NDArray[np.float64]] = {}
        self.bits = frame.subtexel_bits
        self.last = (frame.grid.width - 1, frame.grid.height - 1)
        self.whole: set[tuple[Cell, Cell]] = set()
        self.invisible: dict[Cell, float] = {}
        self.asked = self.close = 0
        bare = settings.measured == "height_difference"
        self.finest = (1 << self.bits) >> (0 if bare else 3)
        self.cell = max(0, round(np.log2(max(self.last) / settings.coarse)))
        keeps = settings.edge_samples / (settings.edge_samples + 1) if settings.move_to_worst else 0.5
        self.passes = int(np.ceil((self.cell + (0 if bare else 3)) / np.log2(1 / keeps)))
        if settings.depth is not None:
            self.passes = min(self.passes, settings.depth)

    def height(self, cell: Cell) -> float:
        """Of the bilinear surface, or where an invisible vertex was put."""
        if cell in self.invisible:
            return self.invisible[cell]
        x, y = (v / 2**self.bits for v in cell)
        i, j = min(int(x), self.last[0] - 1), min(int(y), self.last[1] - 1)
        (a, b), (c, d) = self.heights[j : j + 2, i : i + 2].tolist()
        x, y = x - i, y - j
        return (a * (1 - x) + b * x) * (1 - y) + (c * (1 - x) + d * x) * y

    def lifted(self, cell: Cell) -> NDArray[np.float64]:
        if cell not in self.known:
            self.known[cell] = self.lift(cell)
        return self.known[cell]

    def lift(self, cell: Cell) -> NDArray[np.float64]:
        flat = self.frame.grid.metres @ (np.array(cell) / 2**self.bits + 0.5 - self.frame.eye)
        up = self.height(cell) * self.frame.exaggeration - self.frame.camera.z
        return np.array([*flat, up - self.frame.curvature_factor * (flat @ flat)])

    def pixel(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, _, w = self.frame.view_projection @ [*p, 1.0]
        if not self.frame.camera.orthographic:
            w = max(w, 0.2 * np.linalg.norm(p))
        return np.array([x, y]) / w * np.array(self.frame.size) / 2

    def weight(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
        eye = self.frame.lod_eye()
        way = np.clip((eye - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        grid = self.frame.grid
        corners = [
            [*(grid.metres @ (np.array([x, y]) - self.frame.eye)), z * self.frame.exaggeration - self.frame.camera.z]
            for x in (0, grid.width) for y in (0, grid.height) for z in self.frame.height_range
        ]  # fmt: skip
        far = max(1.0, float(np.linalg.norm(np.array(corners) - eye, axis=1).max()))
        nearest = np.linalg.norm(a + way * (b - a) - eye)
        return float(1 - (1 - self.settings.depth_detail) * min(nearest / far, 1))

    def samples(self, a: Cell, b: Cell) -> list[Cell]:
        """Samples of an edge whose ends are in order, rounded towards its first end."""
        n = self.settings.edge_samples + 1
        steps = np.array(b) - a
        return [
            (int(a[0] + np.fix(steps[0] * k / n)), int(a[1] + np.fix(steps[1] * k / n))) for k in range(1, n)
        ]  # fmt: skip

    def measure(self, a: Cell, b: Cell) -> tuple[float, Cell]:
        """What the metric says about an edge, and the sample that is worst."""
        p, q = self.lifted(a), self.lifted(b)
        metric = self.settings.measured
        if metric == "height_difference":
            difference = abs(self.height(a) - self.height(b)) * self.frame.exaggeration
            return difference * self.weight(p, q), middle(a, b)
        samples = self.samples(a, b)
        off = []
        for k, sample in enumerate(samples, 1):
            true, flat = self.lifted(sample), p + (q - p) * k / (len(samples) + 1)
            if metric == "object_error":
                off.append(float(np.linalg.norm(true - flat)) * self.weight(p, q))
            else:
                off.append(float(np.linalg.norm(self.pixel(true) - self.pixel(flat))))
        worst = samples[int(np.argmax(off))]
        if metric == "area":
            m = (p + q) / 2
            w = (self.frame.view_projection @ [*m, 1.0])[3]
            per_metre = self.frame.size[1] / 2 * float(np.linalg.norm(self.frame.view_projection[1, :3]))
            if not self.frame.camera.orthographic:
                w = max(w, 0.2 * np.linalg.norm(m))
            return float(np.sqrt(sum(off) / (len(off) + 1) * np.linalg.norm(q - p) * per_metre / w)), worst
        return max(off), worst

    def vertex_of(self, at: tuple[Cell, Cell]) -> Cell | None:
        """The vertex that an edge asks for."""
        a, b = at
        if at in self.whole:
            return None
        if max(abs(b[0] - a[0]), abs(b[1] - a[1])) > self.finest:
            size, worst = self.measure(a, b)
            vertex = worst if self.settings.move_to_worst else middle(a, b)
            split = size >= self.settings.threshold
            self.asked += 1
            if abs(size / self.settings.threshold - 1) < VERGE:
                self.close += 1
                split = vertex in self.seen
            if split:
                return vertex
        self.whole.add(at)
        return None

    def lines(self, last: int) -> list[int]:
        """Lines of the coarse mesh along an axis, in samples: whole cells, then powers of two."""
        at, result = 0, [0]
        for power in range(self.cell, -1, -1):
            while at + (1 << power) <= last and (power == self.cell or last - at >= 1 << power):
                at += 1 << power
                result.append(at)
        return result

    def coarse(self) -> list[Triangle]:
        columns, rows = ([v << self.bits for v in self.lines(last)] for last in self.last)
        result: list[Triangle] = []
        for x, right in pairwise(columns):
            for y, below in pairwise(rows):
                result.append(((x, y), (x, below), (right, y)))
                result.append(((right, below), (right, y), (x, below)))
        return result

    def refine(self) -> list[Triangle]:
        mesh = self.coarse()
        for _ in range(self.passes):
            splits = {at: self.vertex_of(at) for triangle in mesh for at in edges(triangle)}
            if self.settings.variant == "conforming":
                self.force(mesh, splits)
            mesh = [part for triangle in mesh for part in self.parts(triangle, splits)]
        return mesh

    def force(self, mesh: list[Triangle], splits: dict[tuple[Cell, Cell], Cell | None]) -> None:
        """Split the longest edges of triangles whose legs are split, wherever that leads."""
        sharing = defaultdict(list)
        for triangle in mesh:
            for at in edges(triangle):
                sharing[at].append(triangle)
        work = [triangle for triangle in mesh if any(splits[at] for at in edges(triangle))]
        while work:
            longest = edges(work.pop())[0]
            if not splits[longest]:
                splits[longest] = middle(*longest)
                self.whole.discard(longest)
                work += sharing[longest]

    def parts(self, triangle: Triangle, splits: dict[tuple[Cell, Cell], Cell | None]) -> list[Triangle]:
        a, b, c = triangle
        longest, right, left = (splits[at] for at in edges(triangle))
        if (left or right) and not longest and self.settings.variant == "right_angled":
            longest = middle(b, c)
            self.invisible[longest] = (self.height(b) + self.height(c)) / 2
            self.known.pop(longest, None)
            self.whole |= {edge(b, longest), edge(longest, c)}
        if longest:
            first = [(left, longest, a), (left, b, longest)] if left else [(longest, a, b)]
            second = [(right, longest, c), (right, a, longest)] if right else [(longest, c, a)]
            return first + second
        if left and right:
            return [(a, left, right), (left, b, c), (right, left, c)]
        if left:
            return [(a, left, c), (left, b, c)]
        return [(a, b, right), (right, b, c)] if right else [triangle]


def vertices(mesh: list[Triangle]) -> set[Cell]:
    return {corner for triangle in mesh for corner in triangle}


def area(triangle: Triangle) -> float:
    (ax, ay), (bx, by), (cx, cy) = triangle
    return abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / 2


def holds_vertex(a: Cell, b: Cell, found: set[Cell]) -> bool:
    """Whether another vertex lies on an edge."""
    return max(abs(b[0] - a[0]), abs(b[1] - a[1])) > 1 and middle(a, b) in found
