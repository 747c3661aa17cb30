"""Ground and views for algorithms whose mesh is laid out anew for every camera."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lod.scene import Scene
from orogen.frame import Frame

ROWS, COLUMNS = 180, 220
SIZE = (96, 64)
METRES = np.array([[10.0, 5.0], [3.0, -9.0]])
"""A sheared georeference: sides of the data are not at right angles."""


def slope() -> NDArray[np.float32]:
    """A plane."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    # multiples of 1/4 are exact
    return (1.25 * columns - 0.75 * rows + 200).astype(np.float32)


def some_frames(scene: Scene, count: int, seed: int, ground: float = 300.0) -> Iterator[Frame]:
    """Over, beside, below and far above the terrain; straight down, up, rolled, wide, narrow, orthographic, bent."""
    random = np.random.default_rng(seed)
    rows, columns = scene.pyramid.grid.shape
    for k in range(count):
        angles = {
            "heading": random.uniform(0, 360),
            "pitch": [random.uniform(-90, 20), -90.0, random.uniform(-90, -5), random.uniform(30, 89)][k % 4],
            "roll": [0.0, random.uniform(-180, 180)][k % 2],
            "fov": float(random.choice([20, 45, 90, 150])),
        }
        if k % 4 == 2:
            angles["orthographic"] = 10 ** random.uniform(2, 3.7)
        at = random.uniform(-0.4, 1.4, 2) * [columns, rows]
        z = ground * random.uniform(0, 1) if k % 5 == 4 else ground + 10 ** random.uniform(0.3, 3.5)
        camera = scene.camera(*at.tolist(), float(z), **angles)
        yield scene.frame(camera, SIZE, curvature=k % 3 == 1, exaggeration=(1.0, 3.0, 0.3)[k % 3])
