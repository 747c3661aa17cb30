"""What triangles and rays cost: the numbers that choose.wgsl decides by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame

BLOCK = np.dtype(
    [
        ("view_projection", "f4", (4, 4)),
        ("half", "f4", 2),
        ("cost_triangle", "f4"),
        ("cost_step", "f4"),
    ]
)


LEAST = 1000
"""Triangles, or steps, that a frame must have for its time to say what one of them costs."""
_SHARE = 0.1
"""Weight of a frame's time against what earlier ones have taught."""


@dataclass
class Costs:
    """What a triangle and a step of a ray cost, in the same unit."""

    triangle: float
    """Of a triangle."""
    step: float
    """Of a step, as choose.wgsl counts them."""

    def learn(self, times: Mapping[str, float], triangles: int, steps: float) -> None:
        """Move towards the nanoseconds of a frame; `times`: milliseconds of its passes, by name."""
        if triangles >= LEAST and times.get("raster"):
            self.triangle += _SHARE * (1e6 * times["raster"] / triangles - self.triangle)
        if steps >= LEAST and times.get("rays"):
            self.step += _SHARE * (1e6 * times["rays"] / steps - self.step)


def choice_block(frame: Frame, costs: Costs) -> NDArray[np.void]:
    """The uniform block of choose.wgsl (0-dimensional)."""
    block = np.zeros((), BLOCK)
    # WGSL's matrices have columns first
    block["view_projection"] = lod_projection(frame).T
    block["half"] = np.array([np.sign(np.linalg.det(frame.grid.metres)), 1.0]) * frame.texel_size / 2
    block["cost_triangle"], block["cost_step"] = costs.triangle, costs.step
    return block


def lod_projection(frame: Frame) -> NDArray[np.float64]:
    """4 x 4 (rows first) from metres relative to the frame's camera to the clip space of its LOD camera."""
    if frame.lod_camera is None:
        return frame.view_projection
    lod = Frame(
        frame.lod, frame.grid, frame.size, height_range=frame.height_range,
        exaggeration=frame.exaggeration, curvature=frame.curvature,
    )  # fmt: skip
    moved = np.eye(4)
    moved[:2, 3] = -(frame.grid.metres @ (lod.eye - frame.eye))
    moved[2, 3] = frame.camera.z - lod.camera.z
    return lod.view_projection @ moved
