"""Texture formats: bytes, numpy types and block sizes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

import numpy as np

from orogen.errors import GpuError

_PLAIN = re.compile(r"(r|rg|rgba|bgra)(8|16|32)(unorm|snorm|uint|sint|float)(-srgb)?")
_ASTC = re.compile(r"astc-(\d+)x(\d+)-unorm(-srgb)?")
_KIND = {"unorm": "u", "uint": "u", "snorm": "i", "sint": "i", "float": "f"}

_PACKED = {
    "rgb10a2unorm": "u4",
    "rgb10a2uint": "u4",
    "rg11b10ufloat": "u4",
    "rgb9e5ufloat": "u4",
    "depth16unorm": "u2",
    "depth24plus": "u4",
    "depth32float": "f4",
    "depth24plus-stencil8": "u4",
    "depth32float-stencil8": "u8",
    "stencil8": "u1",
}
_BLOCK_BYTES = {"bc1": 8, "bc4": 8, "etc2-rgb8": 8, "etc2-rgb8a1": 8, "eac-r11": 8}


@dataclass(frozen=True)
class Format:
    """How the texels of a texture format lie in memory."""

    dtype: np.dtype
    """Type of a channel; bytes for block-compressed formats."""
    channels: int
    """Channels per texel, or bytes per block."""
    block: tuple[int, int] = (1, 1)
    """Texels that a block covers, along x and y."""

    @property
    def itemsize(self) -> int:
        """Bytes per texel or block."""
        return self.dtype.itemsize * self.channels

    def blocks(self, width: int, height: int) -> tuple[int, int]:
        """Columns and rows of blocks that cover `width` x `height` texels."""
        return -(-width // self.block[0]), -(-height // self.block[1])

    def shape(self, width: int, height: int) -> tuple[int, ...]:
        """Shape of the array of `width` x `height` texels: (rows, columns), then channels where more than one."""
        columns, rows = self.blocks(width, height)
        return (rows, columns) if self.channels == 1 else (rows, columns, self.channels)


@cache
def format_of(name: str) -> Format:
    """The layout of a WebGPU texture format."""
    if name in _PACKED:
        return Format(np.dtype(_PACKED[name]), 1)
    if match := _PLAIN.fullmatch(name):
        channels, bits, kind, _ = match.groups()
        return Format(np.dtype(f"{_KIND[kind]}{int(bits) // 8}"), len(channels))
    if match := _ASTC.fullmatch(name):
        return Format(np.dtype("u1"), 16, (int(match[1]), int(match[2])))
    if name.startswith(("bc", "etc2-", "eac-")):
        family = name.split("-")[0] if name.startswith("bc") else re.sub(r"(unorm|snorm).*", "", name)
        return Format(np.dtype("u1"), _BLOCK_BYTES.get(family, 16), (4, 4))
    raise GpuError(f"expected a WebGPU texture format such as 'rgba8unorm', got {name!r}")


def mip_size(size: tuple[int, int], mip: int) -> tuple[int, int]:
    """Width and height of a mip level."""
    return max(1, size[0] >> mip), max(1, size[1] >> mip)


def texture_bytes(
    name: str, size: tuple[int, int], *, mips: int = 1, layers: int = 1, depth: int = 1, samples: int = 1
) -> int:
    """Bytes of all texels of a texture: every mip level, layer, slice and sample, without the driver's padding."""
    layout, total = format_of(name), 0
    for mip in range(mips):
        columns, rows = layout.blocks(*mip_size(size, mip))
        total += columns * rows * max(1, depth >> mip)
    return total * layout.itemsize * layers * samples
