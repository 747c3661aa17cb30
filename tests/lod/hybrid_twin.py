"""What a tile costs as triangles and as rays, in float64 numpy, written from the formulas of the README."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.compare.truth import TrueSurface
from orogen.frame import Frame
from orogen.lod.hybrid import Settings

BLOCK = 8
"""Pixels along the blocks in which rays are cast."""


class Twin:
    """Costs of tiles over level-0 data. Positions are in texels from the first sample's centre."""

    def __init__(self, frame: Frame, settings: Settings, surface: TrueSurface) -> None:
        self.frame = frame
        self.settings = settings
        self.surface = surface
        self.last = np.array([frame.grid.width, frame.grid.height]) - 1.0
        self.leaf = 2.0 ** max(-6, -frame.subtexel_bits)
        lod = frame.lod
        # the LOD camera's picture, as if it were the camera
        self.seen_by = Frame(
            lod, frame.grid, frame.size, height_range=frame.height_range,
            exaggeration=frame.exaggeration, curvature=frame.curvature,
        )  # fmt: skip

    def position(self, at: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres from the viewing camera."""
        flat = (at + 0.5 - self.frame.eye) @ self.frame.grid.metres.T
        drop = self.frame.curvature_factor * (flat**2).sum(-1)
        return np.concatenate(
            [flat, (height * self.frame.exaggeration - self.frame.camera.z - drop)[..., None]], axis=-1
        )

    def costs(self, tile: tuple[int, int, int]) -> tuple[float, float]:
        """Of triangles and of rays; `tile`: level, column, row."""
        level, x, y = tile
        side = self.settings.grid_size * self.leaf * 2.0**level
        rows, columns = np.mgrid[:3, :3] / 2
        at = np.minimum((np.array([x, y]) + np.stack([columns, rows], axis=-1)) * side, self.last)
        height = self.surface.height(*(at + 0.5).reshape(-1, 2).T).reshape(3, 3)
        position = self.position(at, height)
        pixels = (np.sqrt(self._facing(position)) + BLOCK) ** 2
        toward = self.position(at[1, 1], np.array((height.min() + height.max()) / 2)) - self.frame.lod_eye()
        corners = position[[0, -1], [0, -1], :2]
        width = np.linalg.norm(corners[1] - corners[0]) / np.sqrt(2)
        fall = width * abs(toward[2]) / np.linalg.norm(toward[:2])
        relief = np.ptp(height) * self.frame.exaggeration
        cells = max(side, 1.0)
        steps = 2 + np.log2(cells) + np.log2(1 + relief / fall)
        return 2 * self.settings.grid_size**2 * self.settings.cost_triangle, pixels * steps * self.settings.cost_step

    def _facing(self, position: NDArray[np.float64]) -> float:
        """Pixels of the 2 x 2 quads between 3 x 3 points that face the LOD camera, points drawn into its picture."""
        eye = self.seen_by.eye - self.frame.eye
        moved = np.append(self.frame.grid.metres @ eye, self.frame.lod.z - self.frame.camera.z)
        relative = np.concatenate([position - moved, np.ones((3, 3, 1))], axis=-1)
        clip = relative @ self.seen_by.view_projection.T
        seen = np.clip(clip[..., :2] / np.maximum(clip[..., 3:], 1e-6), -1, 1) * np.array(self.frame.size) / 2
        total = 0.0
        for row, column in np.ndindex(2, 2):
            # east and north of a step in rows may turn either way
            ring = seen[[row, row, row + 1, row + 1], [column, column + 1, column + 1, column]]
            px, py = ring.T
            area = 0.5 * float((px * np.roll(py, -1) - py * np.roll(px, -1)).sum())
            total += max(area * np.sign(np.linalg.det(self.frame.grid.metres)), 0.0)
        return total
