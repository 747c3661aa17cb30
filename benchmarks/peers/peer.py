"""What all peers share: the scene, the flight, the clock.

A peer is run as `python NAME_peer.py SCENE.npz RESULT.npz`.
"""

import math
import sys
import time
from dataclasses import dataclass

import numpy as np

ROUNDS = 3
"""Times that the flight is flown; the first round is not counted."""


@dataclass
class View:
    """A camera: metres east, north and up of the data's upper left corner, degrees."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float
    aspect: float
    near: float
    far: float

    @property
    def horizontal_fov(self) -> float:
        """Degrees from side to side."""
        return math.degrees(2 * math.atan(math.tan(math.radians(self.fov) / 2) * self.aspect))


class Scene:
    """Heights in metres (rows, columns), their spacing, a picture to drape, and the views."""

    def __init__(self, path: str) -> None:
        with np.load(path) as data:
            self.heights, self.texture = data["heights"], data["texture"]
            self.spacing = float(data["spacing"])
            self.size = tuple(int(n) for n in data["size"])
            eyes, targets, self.fov = data["eyes"], data["targets"], float(data["fov"])
            near, far = (float(v) for v in data["range"])
        aspect = self.size[0] / self.size[1]
        self.views = [
            View(tuple(eye.tolist()), tuple(target.tolist()), self.fov, aspect, near, far)
            for eye, target in zip(eyes, targets, strict=True)
        ]

    def positions(self):
        """(samples, 3), row by row from the upper left."""
        rows, columns = np.mgrid[: self.heights.shape[0], : self.heights.shape[1]]
        x, y = (columns + 0.5) * self.spacing, -(rows + 0.5) * self.spacing
        return np.stack([x, y, self.heights], axis=-1).reshape(-1, 3)

    def places(self):
        """(samples, 2) texture coordinates from the lower left, 0 to 1: texels have their centres on samples."""
        height, width = self.heights.shape
        rows, columns = np.mgrid[:height, :width]
        return np.stack([(columns + 0.5) / width, 1 - (rows + 0.5) / height], axis=-1).reshape(-1, 2)

    def triangles(self):
        """(triangles, 3) numbers of samples."""
        rows, columns = self.heights.shape
        a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        first = np.stack([a, a + columns, a + 1], axis=1)
        second = np.stack([a + 1, a + columns, a + columns + 1], axis=1)
        return np.concatenate([first, second]).astype(np.uint32)


def run(drawer) -> None:
    """Fly, and write the times of complete frames with read-back (seconds) and the pictures of the last round."""
    scene = Scene(sys.argv[1])
    made = drawer(scene)
    times, pictures = [], []
    for number in range(ROUNDS):
        pictures = []
        for view in scene.views:
            start = time.perf_counter()
            picture = made.draw(view)
            if number:
                times.append(time.perf_counter() - start)
            pictures.append(np.asarray(picture, np.uint8))
    np.savez_compressed(sys.argv[2], times=times, pictures=np.stack(pictures))
