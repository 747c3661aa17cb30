"""Colours as BC7 blocks, made on the GPU: a quarter of the bytes, at the price of some exactness."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orogen.gpu import Gpu, Texture

FEATURE = "texture-compression-bc"
"""What an adapter must offer."""
FORMAT = "bc7-rgba-unorm-srgb"
"""WebGPU format of the texture."""
_BLOCK = 16
_ROW = 256
# few: the blocks of a node have to be shared out among many cores
_GROUP = 32


class BlockEncoder:
    """Encodes one image at a time, all mip levels of it, into a layer of a texture of BC7 blocks."""

    def __init__(self, gpu: Gpu, size: tuple[int, int], mips: int) -> None:
        """`size`: width and height of mip level 0."""
        self._gpu = gpu
        rows = np.zeros((mips, 8), np.uint32)
        self._places: list[tuple[int, int, int, int]] = []
        texels = blocks = offset = 0
        for mip, row in enumerate(rows):
            width, height = size[0] >> mip, size[1] >> mip
            across, down = -(-width // 4), -(-height // 4)
            # rows of blocks begin where copies may
            pitch = -(-across * _BLOCK // _ROW) * _ROW
            row[:6] = width, height, texels, blocks, offset // 4, pitch // 4
            self._places.append((across, down, pitch, offset))
            texels += width * height
            blocks += across * down
            offset += pitch * down
        self._groups = -(-blocks // _GROUP)
        self._pixels = gpu.buffer("colours to encode", 4 * texels, "STORAGE|COPY_DST", "clipmap")
        self._blocks = gpu.buffer("encoded colours", offset, "STORAGE|COPY_SRC", "clipmap")
        self._numbers = gpu.buffer("mip levels to encode", rows, "UNIFORM", "clipmap")
        layout = gpu.layout("bc7", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage"), 2: ("COMPUTE", "uniform")})
        self._group = gpu.bind("bc7", layout, {0: self._pixels, 1: self._blocks, 2: self._numbers})
        constants = {"MIPS": mips, "GROUP": _GROUP}
        shader = gpu.shader("bc7", Path(__file__).parent / "bc7.wgsl", constants=constants)
        self._pipeline = gpu.compute("bc7", shader, "compress", [layout])

    def encode(self, mips: Sequence[NDArray[np.uint8]], texture: Texture, layer: int) -> None:
        """Encode (rows, columns, 4) of each mip level into a layer."""
        gpu = self._gpu
        gpu.write(self._pixels, np.concatenate([np.ascontiguousarray(mip).reshape(-1) for mip in mips]))
        encoder = gpu.encoder("bc7")
        run = encoder.begin_compute_pass(label="bc7")
        run.set_pipeline(self._pipeline)
        run.set_bind_group(0, self._group)
        run.dispatch_workgroups(self._groups)
        run.end()
        for mip, (across, down, pitch, offset) in enumerate(self._places):
            encoder.copy_buffer_to_texture(
                {"buffer": self._blocks.raw, "offset": offset, "bytes_per_row": pitch, "rows_per_image": down},
                {"texture": texture.raw, "mip_level": mip, "origin": (0, 0, layer)},
                (4 * across, 4 * down, 1),
            )
        gpu.submit(encoder)

    def destroy(self) -> None:
        """Give the memory back."""
        for buffer in (self._pixels, self._blocks, self._numbers):
            buffer.destroy()
