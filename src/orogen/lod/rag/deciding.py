"""What the shaders are told: the mesh that refinement starts from, and the camera that decides."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from orogen.frame import Frame, subtexel_bits
from orogen.grid import Grid
from orogen.lod.rag.settings import Settings

BLOCK = np.dtype(
    [
        ("right", "f4", 4),
        ("up", "f4", 4),
        ("depth", "f4", 4),
        ("planes", "f4", (5, 4)),
        ("anchor", "i4", 2),
        ("offset", "f4", 2),
        ("eye", "f4", 3),
        ("eye_height", "f4"),
        ("margin", "f4", 2),
        ("far", "f4"),
        ("depth_detail", "f4"),
        ("threshold", "f4"),
        ("capacity", "u4"),
        ("finest", "i4"),
        ("cell_bits", "u4"),
        ("cells", "u4", 2),
        ("last", "u4", 2),
    ]
)
"""The uniform block of rag.wgsl."""

WITHIN = 3
"""Passes after those of equation 3: the bilinear surface between four samples is bent, and flat to a 64th of its twist
when it is halved so often."""


@dataclass(frozen=True)
class Coarse:
    """The mesh that refinement starts from."""

    cell_bits: int
    """Its cells are two to this power samples wide."""
    cells: tuple[int, int]
    """Columns and rows of cells."""
    last: tuple[int, int]
    """Column and row of the last sample."""
    finest: int
    """Subtexels that edges have to be longer than to be split."""
    passes: int
    """How often triangles are split at most."""

    @classmethod
    def over(cls, grid: Grid, settings: Settings) -> Coarse:
        """The mesh over a grid."""
        last = (grid.width - 1, grid.height - 1)
        cell_bits = max(0, round(math.log2(max(1, *last) / settings.coarse)))
        # what is left after the whole cells is cut into powers of two
        columns, rows = ((n >> cell_bits) + (n & ((1 << cell_bits) - 1)).bit_count() for n in last)
        within = 0 if settings.measured == "height_difference" else WITHIN
        sample = 1 << subtexel_bits(grid)
        # equation 3; an edge that is split elsewhere than in its middle keeps a larger part
        kept = settings.edge_samples / (settings.edge_samples + 1) if settings.move_to_worst else 0.5
        passes = math.ceil((cell_bits + within) / -math.log2(kept))
        if settings.depth is not None:
            passes = min(passes, settings.depth)
        return cls(cell_bits, (columns, rows), last, max(1, sample >> within), passes)

    @property
    def triangles(self) -> int:
        """Two a cell."""
        return 2 * self.cells[0] * self.cells[1]


def deciding_frame(frame: Frame) -> Frame:
    """The frame as the LOD camera sees it, the same for all samples of a picture and for every camera that looks."""
    return replace(frame, camera=frame.lod, lod_camera=None, jitter=(0.0, 0.0), slice=0)


def block(frame: Frame, settings: Settings, coarse: Coarse, capacity: int) -> np.ndarray:
    """The uniform block for a `deciding_frame`."""
    width, height = frame.size
    camera, matrix, eye = frame.camera, frame.view_projection, frame.lod_eye()
    pixel = camera.orthographic / height if camera.orthographic else 1 / frame.pixels_per_radian()
    result = np.zeros((), BLOCK)
    result["right"][:3], result["up"][:3] = matrix[0, :3] * width / 2, matrix[1, :3] * height / 2
    result["depth"], result["planes"] = matrix[3], frame.planes()
    result["anchor"], result["offset"] = frame.anchor, frame.eye_offset
    result["eye"], result["eye_height"] = eye, camera.z / frame.exaggeration
    result["margin"] = (0.0, pixel) if camera.orthographic else (pixel, 0.0)
    result["far"] = farthest(frame, eye)
    result["depth_detail"], result["threshold"] = settings.depth_detail, settings.threshold * frame.coarseness
    result["capacity"], result["finest"] = capacity, coarse.finest
    result["cell_bits"], result["cells"], result["last"] = coarse.cell_bits, coarse.cells, coarse.last
    return result


def farthest(frame: Frame, eye: np.ndarray) -> float:
    """Metres from a place to the farthest corner of the box around the data."""
    grid = frame.grid
    texels = np.array([(x, y) for x in (0, grid.width) for y in (0, grid.height)]) - frame.eye
    flat = texels @ grid.metres.T - eye[:2]
    heights = np.array(frame.height_range) * frame.exaggeration - frame.camera.z - eye[2]
    return max(1.0, float(np.hypot(np.linalg.norm(flat, axis=1).max(), np.abs(heights).max())))
