"""A second camera that looks at what a frozen one has drawn (Houska 2019, figures 4.9 to 4.11)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from orogen.camera import Camera
from orogen.view.framing import displaced
from orogen.view.renderer import Picture

PLACES: Mapping[str, float] = MappingProxyType({"close": 0.1, "middle": 0.5, "far": 0.9})
"""Shares of the visible ground, by pixels' logarithmic distance, that are nearer than what is looked at."""
WIDTH = 0.35
"""Distance of the second camera to what it looks at, in distances of the first one."""
PITCH = -30.0
TURN = 40.0
"""Degrees that it is turned against the first one, so that cells stretched along the view show."""
CLEARANCE = 3.0
"""Least height over the ground in sample spacings."""


def meta_cameras(picture: Picture, height_at: Callable[[float, float], float]) -> dict[str, Camera]:
    """Cameras by name that look at visible ground at growing distances from the picture's camera.

    `picture`: the true picture of the frame. `height_at`: metres of the data at x, y in its CRS, NaN where there
    is none. Empty where the picture shows only sky.
    """
    frame, depth = picture.frame, picture.depth
    camera = frame.camera
    seen = np.isfinite(depth)
    if not seen.any():
        return {}
    rows, columns = np.nonzero(seen)
    # what is near the middle column, so that it lies in front of the camera
    middle = np.abs(columns - frame.size[0] / 2) <= max(1, frame.size[0] // 8)
    if middle.any():
        rows, columns = rows[middle], columns[middle]
    far = np.log(depth[rows, columns].astype(np.float64))
    cameras = {}
    for name, share in PLACES.items():
        wanted = far.min() + share * (far.max() - far.min())
        pick = int(np.argmin(np.abs(far - wanted)))
        column, row = int(columns[pick]), int(rows[pick])
        x, y, z = frame.position(column, row, float(picture.reverse_depth[row, column]))
        target = Camera(
            x, y, z * frame.exaggeration, heading=(camera.heading + TURN) % 360, pitch=PITCH, fov=camera.fov
        )
        distance = max(WIDTH * float(depth[row, column]), 8 * frame.grid.spacing)
        place = displaced(target, frame.grid, -distance * target.basis[2])
        ground = height_at(place.x, place.y)
        if math.isfinite(ground):
            least = ground * frame.exaggeration + CLEARANCE * frame.grid.spacing
            place = place.moved(z=max(place.z, least))
        cameras[name] = place
    return cameras
