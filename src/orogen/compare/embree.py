"""An independent CPU renderer: the true surface as triangles, intersected by Embree.

Every cell of the raster is split into 8 x 8 squares of two triangles whose corners lie on the bilinear surface, so the
triangles leave it by at most 1/256 of the cell's twist. Rays come from `Frame.rays`; everything is moved to the camera
before it becomes float32, so rounding grows with the distance from the camera, not with the coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.frame import Frame

SPLIT = 8
"""Squares along a cell's side."""
FLOOR = 0.02
"""Least relief of a cell, as a share of the spacing: flat cells would ask for more digits than float32 has."""


class EmbreeSurface:
    """The triangles of `heights` (rows, columns; no nodata) as seen from a frame's camera, without curvature.

    Needs the package embreex (`pip install orogen[bench]`), else SettingsError.
    """

    def __init__(self, frame: Frame, heights: NDArray[np.floating]) -> None:
        if frame.curvature or frame.grid.shape != heights.shape:
            raise SettingsError(
                f"expected a frame without curvature over heights of shape {frame.grid.shape}, got {heights.shape}"
            )
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise SettingsError("expected the package embreex; pip install orogen[bench]") from error
        self.frame = frame
        self.heights = np.asarray(heights, np.float64)
        rows, columns = self.heights.shape
        x = np.arange((columns - 1) * SPLIT + 1) / SPLIT
        y = np.arange((rows - 1) * SPLIT + 1) / SPLIT
        i, j = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), rows - 2)
        across = self.heights[:, i] + (self.heights[:, i + 1] - self.heights[:, i]) * (x - i)
        fine = across[j] + (across[j + 1] - across[j]) * (y - j)[:, None]
        metres, eye = frame.grid.metres, frame.eye
        tx, ty = np.meshgrid(x + 0.5 - eye[0], y + 0.5 - eye[1])
        self.vertices = np.stack(
            [
                metres[0, 0] * tx + metres[0, 1] * ty,
                metres[1, 0] * tx + metres[1, 1] * ty,
                fine * frame.exaggeration - frame.camera.z,
            ],
            axis=-1,
        ).reshape(-1, 3)
        index = np.arange(fine.size, dtype=np.int32).reshape(fine.shape)
        a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
        self.triangles = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
        self.scene = EmbreeScene(robust=True)
        TriangleMesh(self.scene, self.vertices.astype(np.float32), self.triangles)

    def cast(
        self, origin: NDArray[np.float64], direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """Parameters t of the first hits of rays origin + t direction (n, 3), NaN for none, and the triangles hit.

        The float32 hit only names the triangle; t is then solved in float64.
        """
        found = self.scene.run(origin.astype(np.float32), direction.astype(np.float32), output=True)
        triangle = np.asarray(found["primID"], np.int32)
        hit = triangle >= 0
        a, b, c = (self.vertices[self.triangles[np.where(hit, triangle, 0), k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (normal * (a - origin)).sum(1) / (normal * direction).sum(1)
        return np.where(hit, t, np.nan), np.where(hit, triangle, -1)


@dataclass(frozen=True)
class Agreement:
    """How far a picture is from Embree's."""

    share: float
    """Share of the pixels that agree: both sky, or both terrain and within 0.01 of the cell's relief."""
    outline: float
    """Share of the pixels where only one of the two shows terrain."""
    relative: NDArray[np.float64]
    """(height, width) vertical difference / relief; NaN where not both show terrain."""


def compare(drawn: NDArray[np.floating], frame: Frame, surface: EmbreeSurface, limit: float = 0.01) -> Agreement:
    """Compare a depth picture (reverse z) with Embree's.

    The vertical difference is that of the drawn point from the plane of the triangle that Embree hits, along the
    vertical. The relief is the range of the corner heights of the cell that it hits, at least FLOOR x spacing.
    """
    origin, direction = (np.reshape(part, (-1, 3)) for part in frame.rays())
    t, triangle = surface.cast(origin, direction)
    ours = frame.view_depth(drawn).ravel()
    hit = triangle >= 0
    if not frame.camera.orthographic:
        hit &= t >= frame.camera.near
    a, b, c = (surface.vertices[surface.triangles[triangle, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    point = origin + direction * ours[:, None]
    vertical = np.abs((normal * (point - a)).sum(1) / normal[:, 2]) / frame.exaggeration
    columns = surface.heights.shape[1] - 1
    square = triangle % (len(surface.triangles) // 2)
    j, i = square // (columns * SPLIT) // SPLIT, square % (columns * SPLIT) // SPLIT
    corners = np.stack([surface.heights[j + dj, i + di] for dj in (0, 1) for di in (0, 1)])
    relief = np.maximum(np.ptp(corners, axis=0), FLOOR * frame.grid.spacing)
    both = hit & ~np.isnan(ours)
    relative = np.where(both, vertical / relief, np.nan)
    agree = np.where(hit | ~np.isnan(ours), relative <= limit, True)
    return Agreement(
        float(agree.mean()), float((hit != ~np.isnan(ours)).mean()), relative.reshape(frame.size[1], frame.size[0])
    )
