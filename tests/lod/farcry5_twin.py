"""The nodes of farcry5 in float64 numpy, written from the rules."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from lod.scene import Scene
from orogen.frame import Frame
from orogen.keys import NodeKey
from orogen.lod.farcry5 import Settings

Node = tuple[int, int, int]
"""Level, column, row."""


class Twin:
    """The nodes of a frame in float64, written from the rules. Positions are in texels from the first sample."""

    def __init__(self, scene: Scene, frame: Frame, settings: Settings) -> None:
        self.frame, self.quads = frame, settings.patch_quads
        self.heights = scene.clipmap.heights
        self.bounds = scene.view._drawn_bounds
        self.size = np.array([frame.grid.width, frame.grid.height]) - 1.0
        self.leaf = max(2.0**-6, 2.0**-frame.subtexel_bits)
        self.root = 0
        while self.width(self.root) < self.size.max():
            self.root += 1
        self.texel = np.linalg.norm(frame.grid.metres, axis=0).max()
        self.reach = frame.pixels_per_radian(frame.lod) / settings.pixels_per_quad
        self.eye = frame.lod_eye()

    def width(self, level: int) -> float:
        return 8 * self.quads * self.leaf * 2.0**level

    def corners(self, node: Node) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        low = np.array(node[1:]) * self.width(node[0])
        return low, np.minimum(low + self.width(node[0]), self.size)

    def height_bounds(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[float, float]:
        """What may be drawn in the data's nodes under a rectangle: of a level whose nodes are wider than it."""
        top = len(self.bounds) - 1
        level = int(np.clip(np.floor(np.log2((high - low).max() / 256)) + 1, 0, top))
        first, last = (np.floor((at + 0.5) / (256 << level)).astype(int) for at in (low, high))
        part = self.bounds[level, first[1] : last[1] + 1, first[0] : last[0] + 1]
        return tuple(np.clip([part[..., 0].min(), part[..., 1].max()], *self.frame.height_range).tolist())

    def distance(self, node: Node) -> float:
        low, high = self.corners(node)
        corners = [np.array(c) for c in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))]
        flat = [self.frame.grid.metres @ (c + 0.5 - self.frame.eye) for c in corners]
        eye = self.frame.eye - 0.5 + np.linalg.inv(self.frame.grid.metres) @ self.eye[:2]
        near = np.inf
        if ((eye >= low) & (eye <= high)).all():
            near = 0.0
        for p, q in itertools.pairwise([*flat, flat[0]]):
            length = max(((q - p) ** 2).sum(), 1e-30)
            way = np.clip((self.eye[:2] - p) @ (q - p) / length, 0, 1)
            near = min(near, float(np.linalg.norm(p + way * (q - p) - self.eye[:2])))
        far = max(float(f @ f) for f in flat)
        bottom, top = self.height_bounds(low, high)
        bottom = bottom * self.frame.exaggeration - self.frame.camera.z - self.frame.curvature_factor * far
        top = top * self.frame.exaggeration - self.frame.camera.z
        return float(np.hypot(near, max(bottom - self.eye[2], self.eye[2] - top, 0.0)))

    def is_resident(self, node: Node) -> bool:
        level, x, y = node
        data = int(np.log2(self.width(level) / 256))
        finer = max(0, -data)
        top = self.heights.pyramid.level_count - 1
        return data > top or NodeKey(max(0, data), x >> finer, y >> finer) in self.heights.current

    def inside(self, node: Node) -> bool:
        return bool((np.array(node[1:]) * self.width(node[0]) < self.size).all())

    def refine(self) -> tuple[set[Node], set[Node]]:
        """All nodes drawn; and those where a decision about them or above them was close."""
        drawn: set[Node] = set()
        close: set[Node] = set()
        layer = {(self.root, 0, 0): False}
        for level in range(self.root, -1, -1):
            below: dict[Node, bool] = {}
            waiting = {}
            for node, doubtful in layer.items():
                _, x, y = node
                kids = [(level - 1, 2 * x + i, 2 * y + j) for i, j in itertools.product((0, 1), repeat=2)]
                kids = [kid for kid in kids if self.inside(kid)]
                ratio = np.inf
                if level:
                    ratio = self.distance(node) / (self.texel * self.leaf * 2.0**level * self.reach)
                doubtful = doubtful or abs(ratio - 1) < 1e-4
                far_coarser = any(
                    (level + step, (x + dx) >> step, (y + dy) >> step) in drawn
                    for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1))
                    for step in range(int(np.log2(8 * self.quads)), self.root - level + 1)
                )
                split = ratio < 1 and all(map(self.is_resident, kids)) and not far_coarser
                if split:
                    below |= dict.fromkeys(kids, doubtful)
                if not split or doubtful:
                    waiting[node] = doubtful
            drawn |= set(waiting)
            close |= {node for node, doubtful in waiting.items() if doubtful}
            layer = below
        return drawn - close, close
