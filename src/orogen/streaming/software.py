"""What spares a software driver work in shaders that run for every pixel.

Such a driver runs a shader for several invocations at once, but reads storage buffers for one after another, and
uniforms too where they stand in a branch or a loop. So it finds the quadtree in a texture, which it samples for all at
once, and copies the uniform blocks before the first branch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.gpu import Gpu

TABLE_WIDTH = 4096
"""Entries of the quadtree in a row of the texture, so many that it takes all that a buffer may hold."""

SHARED = {"FRAME_BLOCK": "frame", "CLIPMAP_BLOCK": "clipmap"}
"""Constants of shaders that read the uniform blocks as they are."""
COPIED = {"FRAME_BLOCK": "frame_block", "CLIPMAP_BLOCK": "clipmap_block"}
"""Constants of shaders that copy them."""

_PARTS = 3


def is_software(gpu: Gpu) -> bool:
    """Whether shaders run on a CPU."""
    return gpu.info.kind == "cpu"


def block_copies(gpu: Gpu) -> tuple[str, dict[str, str]]:
    """Name of the file that gives a shader `take_blocks`, to be called first of all, and its constants."""
    return ("copied_blocks.wgsl", COPIED) if is_software(gpu) else ("shared_blocks.wgsl", SHARED)


class SampledTables:
    """A view's quadtree as a texture of three layers: entries, and lowest and highest texel (m) of their slots."""

    def __init__(self, gpu: Gpu, count: int) -> None:
        """`count`: entries of all layers of the clipmap together."""
        self._gpu = gpu
        rows = -(-count // TABLE_WIDTH)
        self._texture = gpu.texture(
            "sampled quadtree", (TABLE_WIDTH, rows), "r32float", "TEXTURE_BINDING|COPY_DST", "clipmap", layers=_PARTS
        )
        self._parts = np.zeros((_PARTS, rows * TABLE_WIDTH), np.float32)
        self.view = self._texture.view(dimension="2d-array")
        """What shaders read."""

    def fill(self, start: int, entries: NDArray[np.uint32], ranges: NDArray[np.float32]) -> None:
        """Take over the entries of a layer, of any shape, from number `start` on, and (lowest, highest) of each.

        An entry is a slot of 16 bits and a level of 8: a float32 holds it exactly.
        """
        part = slice(start, start + entries.size)
        self._parts[0, part] = entries.ravel()
        self._parts[1:, part] = ranges.reshape(-1, 2).T

    def write(self) -> None:
        """Bring what was taken over to the texture."""
        for number, values in enumerate(self._parts):
            self._gpu.write_texture(self._texture, values.reshape(-1, TABLE_WIDTH), layer=number)

    def destroy(self) -> None:
        """Give the memory back."""
        self._texture.destroy()
