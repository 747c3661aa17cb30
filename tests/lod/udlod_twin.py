"""The refinement and the vertices of udlod in float64 numpy, written from the equations."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.udlod import Settings

Tile = tuple[int, int, int]
"""Level, column, row."""


class Twin:
    """A frame's lattice of tiles. Positions are in texels from the first sample's centre."""

    def __init__(self, frame: Frame, settings: Settings) -> None:
        self.frame = frame
        self.settings = settings
        self.size = np.array([frame.grid.width, frame.grid.height]) - 1.0
        self.leaf = 2.0 ** max(-6, -frame.subtexel_bits)
        self.root = 0
        while settings.grid_size * self.leaf * 2.0**self.root < max(self.size.max(), 1 / 2**frame.subtexel_bits):
            self.root += 1
        sides = np.linalg.norm(frame.grid.metres, axis=0)
        self.quad_metres = sides.max() * self.leaf
        diagonal = settings.grid_size * max(
            np.linalg.norm(frame.grid.metres @ [1, 1]), np.linalg.norm(frame.grid.metres @ [1, -1])
        )
        # pixels_per_quad at the near end of a level; a tile's diagonal always fits between two morphs
        self.reach = max(
            frame.pixels_per_radian(frame.lod) / settings.quad_pixels,
            1.01 * diagonal / sides.max() / (1 - 2 * settings.morph_range),
        )
        self.eye = frame.lod_eye()
        self.ground = frame.ground_height * frame.exaggeration - frame.camera.z

    def metres(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Camera-relative (east, north) of positions."""
        return (at + 0.5 - self.frame.eye) @ self.frame.grid.metres.T

    def distance(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        flat = self.metres(at)
        return np.sqrt(((flat - self.eye[:2]) ** 2).sum(-1) + (self.ground - self.eye[2]) ** 2)

    def range_end(self, level: int) -> float:
        """Distance at which tiles of a level give way to those of the next."""
        return 2 * self.quad_metres * 2.0**level * self.reach

    def corners(self, tile: Tile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        level, x, y = tile
        side = self.settings.grid_size * self.leaf * 2.0**level
        low = np.array([x, y]) * side
        return low, np.minimum(low + side, self.size)

    def nearest(self, tile: Tile) -> float:
        """Distance of the eye to the tile: over it, or at the nearest point of its four sides."""
        low, high = self.corners(tile)
        eye = (self.eye[:2] @ np.linalg.inv(self.frame.grid.metres).T) + self.frame.eye - 0.5
        if (eye >= low).all() and (eye <= high).all():
            return float(self.distance(eye))
        a, c = low, high
        b, d = np.array([high[0], low[1]]), np.array([low[0], high[1]])
        best = np.inf
        for start, end in ((a, b), (b, c), (c, d), (d, a)):
            p, q = self.metres(start), self.metres(end)
            length = max(((q - p) ** 2).sum(), 1e-30)
            way = np.clip((self.eye[:2] - p) @ (q - p) / length, 0, 1)
            best = min(best, float(self.distance(start + way * (end - start))))
        return best

    def refine(self) -> tuple[set[Tile], set[Tile]]:
        """All final tiles, nothing culled; and those where the decision to split them or their parent was close."""
        finals, close = set(), set()
        stack: list[tuple[Tile, bool]] = [((self.root, 0, 0), False)]
        while stack:
            tile, doubtful = stack.pop()
            level, x, y = tile
            low = self.corners(tile)[0]
            if (low >= self.size).any():
                continue
            if level > 0:
                ratio = self.nearest(tile) / self.range_end(level - 1)
                doubtful |= abs(ratio - 1) < 1e-4
                if ratio < 1:
                    stack += [
                        ((level - 1, 2 * x + i, 2 * y + j), doubtful) for i, j in itertools.product((0, 1), repeat=2)
                    ]
                    if not doubtful:
                        continue
            finals.add(tile)
            if doubtful:
                close.add(tile)
        return finals - close, close

    def vertices(self, tile: Tile) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Positions, morphs and grid places of a tile's vertices row by row."""
        n = self.settings.grid_size
        places = np.array([(column, row) for row in range(n + 1) for column in range(n + 1)])
        level, x, y = tile
        quad = self.leaf * 2.0**level
        whole = np.array([x, y]) * quad * n + places * quad
        morph = np.zeros(len(whole))
        if level < self.root:
            way = self.distance(np.clip(whole, 0, self.size)) / self.range_end(level)
            morph = np.clip(1 - (1 - way) / self.settings.morph_range, 0, 1)
        moved = whole - (places & 1) * quad * morph[:, None]
        return np.clip(moved, 0, self.size), morph, places
