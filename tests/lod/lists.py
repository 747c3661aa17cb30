"""What is drawn as one list of triangles without an index list, read back from the GPU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lod.scene import Scene
from lod.triangles import read_draw
from orogen.frame import Frame
from orogen.lod.contract import AlgorithmView


@dataclass(frozen=True)
class Drawn:
    """The triangles of a frame."""

    corners: NDArray[Any]
    """(n, 3) of dtype VERTEX."""
    texels: NDArray[np.float64]
    """(n, 3, 2) columns and rows of the corners, from the first sample."""

    @property
    def patches(self) -> NDArray[np.int64]:
        """(n, 2): column and row of each triangle's patch."""
        word = self.corners["id"][:, 0].astype(np.int64)
        return np.stack([word & 0xFFFF, word >> 16], axis=1)


def read(scene: Scene, frame: Frame, state: AlgorithmView) -> Drawn:
    """What `state` draws for a frame, with as much room as it needs."""
    (draw,) = scene.record(frame, state)
    while state.incomplete():
        (draw,) = scene.record(frame, state)
    corners = read_draw(scene.gpu, scene.clipmap, scene.view, draw)[0]
    texels = (corners["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits - 0.5
    return Drawn(corners, texels)
