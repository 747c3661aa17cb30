"""Which nodes a picture needs: a pure function of camera, grid and settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.grid import Grid
from orogen.keys import NodeKey
from orogen.streaming.boxes import may_be_seen, nearest_square

_MARGIN = 16
"""Texels of a node's level by which its box is widened for the frustum test: triangles reach that far over the rim of
the picture."""


@dataclass(frozen=True)
class LayerGrid:
    """The nodes of one layer of the clipmap."""

    grid: Grid
    """Grid of the layer's texels."""
    level_count: int
    """Number of levels."""
    node_size: int
    """Texels along a node's side."""

    def nodes(self, level: int) -> tuple[int, int]:
        """(rows, columns) of nodes in a level."""
        side = self.node_size << level
        return -(-self.grid.height // side), -(-self.grid.width // side)

    @property
    def node_count(self) -> int:
        """Nodes of all levels."""
        return sum(int(np.prod(self.nodes(level))) for level in range(self.level_count))

    @cached_property
    def stretch(self) -> float:
        """Nodes along a row or column, whichever is more, that the mean side of a node spans: 1 for square texels."""
        to_texels = self.grid.texels
        return float(np.linalg.norm(to_texels, axis=1).max()) * self.grid.spacing


Bounds = Callable[[int, NDArray, NDArray], tuple[NDArray, NDArray]]
"""(level, node rows, node columns) -> lowest and highest height (m) that may be drawn there."""


def wanted(frame: Frame, layer: LayerGrid, bounds: Bounds, load_distance: float, behind: float) -> list[NodeKey]:
    """Nodes to be resident for a frame, coarse first, then near: the tree is split wherever level L - 1 may be used.

    `load_distance` in nodes of level 0. Nodes outside the LOD camera's frustum are split within `behind` times that.
    Nodes come in groups of four children, so that no node is used without siblings.
    """
    nodes = _Nodes(frame, layer)
    planes = frame.planes()
    unit = layer.node_size * layer.grid.spacing
    top = layer.level_count - 1
    rows, cols = (a.ravel() for a in np.indices(layer.nodes(top)))
    keys = [NodeKey(top, x, y) for y, x in zip(rows.tolist(), cols.tolist(), strict=True)]
    distance = nodes.distance(top, rows, cols)
    for level in range(top, 0, -1):
        seen = nodes.in_frustum(level, rows, cols, *bounds(level, rows, cols), planes)
        split = distance < unit * 2.0 ** (level - 1) * np.where(seen, load_distance, load_distance * behind)
        rows = np.add.outer(2 * rows[split], [0, 0, 1, 1]).ravel()
        cols = np.add.outer(2 * cols[split], [0, 1, 0, 1]).ravel()
        last_row, last_col = layer.nodes(level - 1)
        inside = (rows < last_row) & (cols < last_col)
        rows, cols = rows[inside], cols[inside]
        distance = nodes.distance(level - 1, rows, cols)
        order = np.argsort(distance, kind="stable")
        rows, cols, distance = rows[order], cols[order], distance[order]
        keys += [NodeKey(level - 1, x, y) for y, x in zip(rows.tolist(), cols.tolist(), strict=True)]
    return keys


class _Nodes:
    """Distances and frustum tests of nodes, in metres relative to the frame's camera."""

    def __init__(self, frame: Frame, layer: LayerGrid) -> None:
        self._frame = frame
        self._layer = layer
        self._metres = layer.grid.metres
        self._eye = np.array([float(v) for v in layer.grid.to_texel(frame.camera.x, frame.camera.y)])
        lod_eye = frame.lod_eye()
        self._lod_texel = self._eye + np.linalg.inv(self._metres) @ lod_eye[:2]
        self._above = frame.ground_height * frame.exaggeration - frame.camera.z - lod_eye[2]

    def distance(self, level: int, rows: NDArray, cols: NDArray) -> NDArray[np.float64]:
        """Distance of the LOD eye to the nearest point of the nodes, on the approximate ground."""
        side = float(self._layer.node_size << level)
        low = np.stack([cols, rows], axis=-1) * side - self._lod_texel
        return np.sqrt(nearest_square(self._metres, low, low + side) + self._above**2)

    def in_frustum(
        self, level: int, rows: NDArray, cols: NDArray, low: NDArray, high: NDArray, planes: NDArray
    ) -> NDArray[np.bool_]:
        """Whether the boxes of the nodes, a little wider, may touch the frustum."""
        side = self._layer.node_size << level
        frame = self._frame
        centre = (np.stack([cols, rows], axis=-1) + 0.5) * side
        flat = (centre - self._eye) @ self._metres.T
        axes = self._metres * (0.5 * side + (_MARGIN << level))
        return may_be_seen(frame, planes, flat, axes, low, high)
