"""The ranges of CDLOD's levels, and the nodes that they choose (Houska 2019, section 2.3.8)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.cdlod.ground import Ground
from orogen.lod.cdlod.seams import Pieces, joined, thin
from orogen.lod.quadtree import Ints, PatchFrame, kernels
from orogen.streaming.boxes import nearest_square
from orogen.streaming.clipmap_view import ClipmapView


class Ranges(PatchFrame):
    """Distances at which levels end, around the LOD eye of a frame, and the nodes within them.

    Distances are to boxes around the ground's heights, while nodes are seen or not by the heights that are drawn.
    """

    def __init__(self, frame: Frame, view: ClipmapView, ground: Ground, quad_metres: float, settings: Any) -> None:
        """`view` has been updated for the frame. `quad_metres`: width of a quad of level 0. `settings`: of CDLOD."""
        tree, metres = ground.tree, frame.grid.metres
        # equation 2.3: at the end of its range a quad is half as wide as asked for, and becomes twice as wide
        asked = 2 * quad_metres * frame.pixels_per_radian(frame.lod) / settings.pixels_per_quad
        diagonals = tree.side * np.linalg.norm(metres @ np.array([[1.0, 1.0], [1.0, -1.0]]), axis=0)
        # a node that is cut by the end of a range must not reach into the morph area of the next range, which begins
        # at twice that distance but for the morph's share: else levels would meet where both are morphing
        first = max(asked, 1.01 * float(diagonals.max()) / (1 - 2 * settings.morph_range))
        self.ends: NDArray[np.float64] = first * 2.0 ** np.arange(tree.level_count)
        """(levels,) metres at which a level's nodes are fully morphed into the next level."""
        # a node is divided where its box comes into the range of the next finer level
        super().__init__(tree, frame, view, first * 2.0 ** np.arange(-1, tree.level_count - 1))
        self._ground = ground
        self.eye_texel: NDArray[np.float64] = self._lod_texel
        """Column and row of the LOD eye in samples."""
        self.eye_height: float = float(self._lod[2] + frame.camera.z) / frame.exaggeration
        """Its height in metres of the data."""

    def to_ground(self, level: int, x: Ints, y: Ints) -> NDArray[np.float64]:
        """Metres from the LOD eye to the nearest point of nodes' boxes around the ground."""
        first, last = self.tree.samples(level, x, y)
        square = nearest_square(self._metres, first - self._lod_texel, last - self._lod_texel)
        low, high = self._ground.bounds(level, x, y)
        above = np.maximum(np.maximum(low - self.eye_height, self.eye_height - high), 0) * self.frame.exaggeration
        return np.sqrt(square + above**2)

    def divided(self, level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
        """Whether nodes are in the range of the next finer level."""
        return self.to_ground(level, x, y) < self.reach[level]

    def rule(self, compiled: Any) -> Any:
        """The same for the module of compiled kernels."""
        return compiled.rule(compiled.CELLS, self.reach, cells=self._cells(compiled))

    def choose(self) -> Pieces:
        """What is to be drawn: leaves of the quadtree, and beside them quadrants that they leave of their parents.

        Children beyond the range of their level are quadrants of their parent.
        """
        leaves = self.leaves(restricted=True)
        inside = self._distances(*leaves) < self.ends[leaves.level]
        inside[leaves.level == self.tree.level_count - 1] = True
        return joined(leaves, *thin(leaves, inside))

    def _distances(self, level: Ints, x: Ints, y: Ints) -> NDArray[np.float64]:
        """`to_ground` of nodes of several levels."""
        if compiled := kernels():
            eye, tree, _ = self.compiled(compiled)
            return np.asarray(compiled.cell_distances(eye, tree, self._cells(compiled), level, x, y))
        distance = np.zeros(x.size)
        for one in np.unique(level).tolist():
            at = level == one
            distance[at] = self.to_ground(one, x[at], y[at])
        return distance

    def _cells(self, compiled: Any) -> Any:
        ground = self._ground
        return compiled.Cells(ground.heights, ground.bits, ground.table, ground.first)
