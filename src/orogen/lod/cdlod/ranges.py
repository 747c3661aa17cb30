"""The ranges of CDLOD's levels, and the nodes that they choose (Houska 2019, section 2.3.8)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.cdlod.ground import Ground
from orogen.lod.cdlod.seams import Pieces, joined, thin
from orogen.lod.quadtree import Ints, PatchFrame
from orogen.streaming.boxes import nearest_square


class Ranges:
    """Distances at which levels end, around the LOD eye of a frame."""

    def __init__(self, frame: Frame, ground: Ground, quad_metres: float, settings: Any) -> None:
        """`quad_metres`: width of a quad of level 0. `settings`: `cdlod.Settings`."""
        self._ground = ground
        self._tree = ground.tree
        self._exaggeration = frame.exaggeration
        metres = frame.grid.metres
        lod = frame.lod_eye()
        self.eye_texel: NDArray[np.float64] = frame.eye - 0.5 + np.linalg.inv(metres) @ lod[:2]
        """Column and row of the LOD eye in samples."""
        self.eye_height: float = float(lod[2] + frame.camera.z) / frame.exaggeration
        """Its height in metres of the data."""
        # equation 2.3: at the end of its range a quad is half as wide as asked for, and becomes twice as wide
        asked = 2 * quad_metres * frame.pixels_per_radian(frame.lod) / settings.pixels_per_quad
        diagonals = self._tree.side * np.linalg.norm(metres @ np.array([[1.0, 1.0], [1.0, -1.0]]), axis=0)
        # a node that is cut by the end of a range must not reach into the morph area of the next range, which begins
        # at twice that distance but for the morph's share: else levels would meet where both are morphing
        self._first = max(asked, 1.01 * float(diagonals.max()) / (1 - 2 * settings.morph_range))

    def end(self, level: int) -> float:
        """Metres at which a level's nodes are fully morphed into the next level."""
        return self._first * 2.0**level

    def distance(self, level: int, x: Ints, y: Ints) -> NDArray[np.float64]:
        """Metres from the LOD eye to the nearest point of nodes' boxes."""
        first, last = self._tree.samples(level, x, y)
        square = nearest_square(self._tree.grid.metres, first - self.eye_texel, last - self.eye_texel)
        low, high = self._ground.bounds(level, x, y)
        above = np.maximum(np.maximum(low - self.eye_height, self.eye_height - high), 0) * self._exaggeration
        return np.sqrt(square + above**2)

    def choose(self, nodes: PatchFrame) -> Pieces:
        """What is to be drawn: leaves of the quadtree, and beside them quadrants that they leave of their parents.

        A node is divided where its box comes into the range of the next finer level. Children beyond that range are
        quadrants of their parent.
        """
        leaves = nodes.select(lambda level, x, y: self.distance(level, x, y) < self.end(level - 1), restricted=True)
        inside = [self.distance(level, x, y) < self.end(level) for level, (x, y) in enumerate(leaves)]
        inside[-1][:] = True
        return joined(leaves, thin(leaves, inside))
