"""How finely the edges of patches are divided (Houska 2019, equation 2.7).

An edge is named by its level, its way (1 along a column, 0 along a row), and its place: the column and row of its first
end in patches of the level. Everything here depends on the edge alone, so that the two patches beside it agree.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.quadtree import F64, Ints, Leaves, Level, PatchFrame, PatchTree, coarser, kernels
from orogen.streaming.boxes import nearest_square
from orogen.streaming.clipmap_view import ClipmapView

_SIDES = np.array([[0, 1, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]])
"""North, east, south and west side of a patch: way, and columns and rows from the patch."""
_EDGES_ORDER = [2, 1, 3, 0]
"""These sides in the order of `coarser`."""
LEAST = 4
"""Fewest segments of an edge: half of it, beside one of two smaller patches, still has the two that a mesh needs."""


class Edges(PatchFrame):
    """The patches of a tree and their edges as the LOD camera of a frame sees them."""

    def __init__(self, tree: PatchTree, frame: Frame, view: ClipmapView, precision: float, most: int) -> None:
        """`precision`: rho of equation 2.7. `most`: segments of an edge where it gives 1 (R_max)."""
        # of a row's and a column's edge of level 0
        lengths = np.linalg.norm(tree.grid.metres, axis=0) * tree.side
        self._most = most
        self._edge_reach: F64 = precision * lengths * 2.0 ** np.arange(tree.level_count)[:, None]
        """(levels, 2) metres at which the equation gives 1 for edges along rows and columns."""
        super().__init__(tree, frame, view, self._edge_reach.max(axis=1))

    def divided(self, level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
        """Whether the equation exceeds 1 on any side of patches."""
        return np.asarray((self.epsilon(level, *_sides(x, y)) > 1).any(axis=1))

    def rule(self, compiled: Any) -> Any:
        """The same for the module of compiled kernels."""
        return compiled.rule(compiled.EDGES, self._edge_reach)

    def resolutions(self, leaves: Leaves) -> NDArray[np.int64]:
        """(n, 4) segments of the north, east, south and west side of the leaves of a restricted quadtree."""
        way, x, y = _sides(leaves.x, leaves.y)
        # beside a larger patch, half of what the whole of its edge has
        shared = coarser(leaves)[:, _EDGES_ORDER]
        return self.segments(leaves.level[:, None] + shared, way, x >> shared, y >> shared) >> shared

    def segments(self, level: Level, way: Ints, x: Ints, y: Ints) -> NDArray[np.int64]:
        """(...) segments of edges: epsilon R_max, rounded up to a power of two from LEAST to R_max."""
        asked = self.epsilon(level, way, x, y) * self._most
        segments = np.full(asked.shape, LEAST)
        for power in range(LEAST.bit_length(), self._most.bit_length()):
            segments[asked > 2.0 ** (power - 1)] = 1 << power
        return segments

    def epsilon(self, level: Level, way: Ints, x: Ints, y: Ints) -> F64:
        """(...) equation 2.7 for edges."""
        with np.errstate(divide="ignore"):
            return np.asarray(self._edge_reach[level, way] / self.edge_distance(level, way, x, y))

    def edge_distance(self, level: Level, way: Ints, x: Ints, y: Ints) -> F64:
        """(...) metres from the LOD eye to the nearest point that may be drawn along edges: of upright rectangles."""
        shape = x.shape
        level, way, x, y = (part.ravel() for part in np.broadcast_arrays(level, way, x, y))
        if compiled := kernels():
            return np.asarray(compiled.edge_distances(*self.compiled(compiled), level, way, x, y)).reshape(shape)
        last = np.array([self.tree.grid.width, self.tree.grid.height]) - 1
        width = np.left_shift(self.tree.side, level)[:, None]
        first = np.stack([x, y], axis=-1) * width
        stop = first + np.stack([1 - way, way], axis=-1) * width
        square = nearest_square(
            self._metres, np.minimum(first, last) - self._lod_texel, np.minimum(stop, last) - self._lod_texel
        )
        low, high = self._heights_beside(level, way, x, y)
        return np.sqrt(square + self._above(low, high, square) ** 2).reshape(shape)

    def _heights_beside(self, level: Ints, way: Ints, x: Ints, y: Ints) -> tuple[F64, F64]:
        """Lowest and highest height (m) in the patches on both sides of edges."""
        last = np.array([self.tree.shape(one)[::-1] for one in range(self.tree.level_count)])[level].T - 1
        x, y = (np.clip([at, at - step], 0, end) for at, step, end in zip((x, y), (way, 1 - way), last, strict=True))
        low, high = self.bounds(np.tile(level, 2), x.ravel(), y.ravel())
        return low.reshape(2, -1).min(axis=0), high.reshape(2, -1).max(axis=0)


def _sides(x: Ints, y: Ints) -> tuple[Ints, Ints, Ints]:
    """(n, 4) way, column and row of the north, east, south and west edge of patches."""
    way, right, down = _SIDES
    return np.broadcast_to(way, (x.size, 4)), x[:, None] + right, y[:, None] + down
