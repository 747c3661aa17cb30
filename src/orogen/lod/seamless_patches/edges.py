"""How finely the edges of patches are divided (Houska 2019, equation 2.7).

An edge is named by its level, its direction, and its place: the column and row of its first end in patches of the
level. Everything here depends on the edge alone, so that the two patches beside it agree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.quadtree import Ints, Leaves, PatchFrame, PatchTree, neighbour_steps
from orogen.streaming.boxes import nearest_square
from orogen.streaming.clipmap import ClipmapView

SIDES = np.array([[0, 0, 0], [1, 1, 0], [0, 0, 1], [1, 0, 0]])
"""North, east, south and west side of a patch: 1 along a column and 0 along a row, and the place from the patch's."""
_STEPS_ORDER = [2, 1, 3, 0]
"""These sides in the order of `neighbour_steps`."""
LEAST = 4
"""Fewest segments of an edge: half of it, beside one of two smaller patches, still has the two that a mesh needs."""


class Edges:
    """The edges of a tree's patches as the LOD camera of a frame sees them.

    Arrays of edges hold direction (1 along a column, 0 along a row), column and row.
    """

    def __init__(self, tree: PatchTree, frame: Frame, view: ClipmapView, precision: float, most: int) -> None:
        """`precision`: rho of equation 2.7. `most`: segments of an edge where it gives 1 (R_max)."""
        self._tree = tree
        self._patches = PatchFrame(tree, frame, view)
        self._frame = frame
        # of a row's and a column's edge of level 0
        self._lengths = np.linalg.norm(tree.grid.metres, axis=0) * tree.side
        self._precision = precision
        self._most = most
        self._eye = frame.lod_eye()
        # sample centres lie half a texel from the texels' corners
        self._texel = frame.eye - 0.5 + tree.grid.texels @ self._eye[:2]

    def leaves(self) -> Leaves:
        """The restricted quadtree in which a patch is divided while the equation exceeds 1 on any of its sides."""

        def exceeded(level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
            return np.asarray((self.epsilon(level, _sides(x, y)) > 1).any(axis=1))

        return self._patches.select(exceeded, restricted=True)

    def resolutions(self, leaves: Leaves) -> NDArray[np.int64]:
        """(n, 4) segments of the north, east, south and west side of all leaves."""
        found = []
        for level, ((x, y), steps) in enumerate(zip(leaves, neighbour_steps(leaves, 1), strict=True)):
            sides = _sides(x, y)
            segments = self.segments(level, sides)
            # beside a larger patch, half of what the whole of its edge has
            shared = steps[:, _STEPS_ORDER] > 0
            segments[shared] = self.segments(level + 1, sides[shared] >> [0, 1, 1]) // 2
            found.append(segments)
        return np.concatenate(found)

    def segments(self, level: int, edges: Ints) -> NDArray[np.int64]:
        """(...) segments of edges (..., 3): epsilon R_max, rounded up to a power of two from LEAST to R_max."""
        asked = self.epsilon(level, edges) * self._most
        segments = np.full(asked.shape, LEAST)
        for power in range(LEAST.bit_length(), self._most.bit_length()):
            segments[asked > 2.0 ** (power - 1)] = 1 << power
        return segments

    def epsilon(self, level: int, edges: Ints) -> NDArray[np.float64]:
        """(...) equation 2.7 for edges (..., 3)."""
        with np.errstate(divide="ignore"):
            return np.asarray(self._precision * self._lengths[edges[..., 0]] * 2.0**level / self.distance(level, edges))

    def distance(self, level: int, edges: Ints) -> NDArray[np.float64]:
        """(...) metres from the LOD eye to the nearest point that may be drawn along edges: of upright rectangles."""
        last = np.array([self._tree.grid.width, self._tree.grid.height]) - 1
        width = self._tree.side << level
        first = edges[..., 1:] * width
        stop = first + np.stack([1 - edges[..., 0], edges[..., 0]], axis=-1) * width
        square = nearest_square(
            self._tree.grid.metres, np.minimum(first, last) - self._texel, np.minimum(stop, last) - self._texel
        )
        low, high = self._heights(level, edges)
        exaggeration = self._frame.exaggeration
        eye = self._eye[2] + self._frame.camera.z + self._frame.curvature_factor * square
        above = np.maximum(np.maximum(low * exaggeration - eye, eye - high * exaggeration), 0.0)
        return np.sqrt(square + above**2)

    def _heights(self, level: int, edges: Ints) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest height (m) in the patches on both sides of edges (..., 3)."""
        rows, columns = self._tree.shape(level)
        before = edges[..., 1:] - np.stack([edges[..., 0], 1 - edges[..., 0]], axis=-1)
        both = np.clip(np.stack([edges[..., 1:], before]), 0, [columns - 1, rows - 1])
        low, high = self._patches.bounds(level, both[..., 0].ravel(), both[..., 1].ravel())
        shape = both.shape[:-1]
        return low.reshape(shape).min(axis=0), high.reshape(shape).max(axis=0)


def _sides(x: Ints, y: Ints) -> Ints:
    """(n, 4, 3) north, east, south and west edge of patches."""
    return np.stack([np.zeros_like(x), x, y], axis=-1)[:, None] + SIDES
