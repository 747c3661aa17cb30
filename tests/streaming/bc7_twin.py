"""BC7 blocks of mode 6 in numpy: what bc7.wgsl computes, step by step, for many blocks at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
WEIGHTS = np.array([0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64])
"""Sixty-fourths of the second end point, by index."""


def blocks_of(image: NDArray[np.uint8]) -> F32:
    """(rows, columns, 16, 4) texels of the blocks of 4 x 4 of an image (height, width, 4), the last ones repeated."""
    height, width = image.shape[:2]
    image = np.pad(image, ((0, -height % 4), (0, -width % 4), (0, 0)), mode="edge")
    rows, cols = image.shape[0] // 4, image.shape[1] // 4
    return image.reshape(rows, 4, cols, 4, 4).transpose(0, 2, 1, 3, 4).reshape(rows, cols, 16, 4).astype(np.float32)


def line_through(texels: F32) -> tuple[F32, F32]:
    """(n, 4) ends of the texels along their principal axis."""
    middle = texels.mean(axis=1)
    off = texels - middle[:, None]
    spread = np.einsum("nti,ntj->nij", off, off)
    axis = np.take_along_axis(spread, spread.diagonal(0, 1, 2).argmax(1)[:, None, None], 1)[:, 0]
    for _ in range(6):
        longest = np.maximum(np.abs(axis).max(axis=1, keepdims=True), np.float32(1e-12))
        axis = np.einsum("nij,nj->ni", spread, axis / longest)
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), np.float32(1e-12))
    along = np.einsum("nti,ni->nt", off, axis)
    return middle + axis * along.min(1)[:, None], middle + axis * along.max(1)[:, None]


def quantized(end: F32, texels: F32) -> NDArray[np.int64]:
    """(n, 4) end points of 8 bits whose lowest bits agree: the nearer ones, and alpha of 255 and of 0 as it is."""
    alpha = texels[..., 3]
    forced = np.where((alpha == 255).all(1), 1, np.where((alpha == 0).all(1), 0, -1))
    choices, errors = [], []
    for bit in (0, 1):
        value = 2 * np.clip(np.floor((end - bit) / 2 + 0.5), 0, 127) + bit
        choices.append(value.astype(np.int64))
        errors.append(((value - end) ** 2).sum(1))
    odd = np.where(forced >= 0, forced == 1, errors[1] < errors[0])
    return np.where(odd[:, None], choices[1], choices[0])


def indices_of(texels: F32, a: NDArray[np.int64], b: NDArray[np.int64]) -> tuple[NDArray[np.int64], F32]:
    """(n, 16) nearest of the sixteen colours between two end points, and (n,) the sum of the squared errors."""
    along = (b - a).astype(np.float32)
    length = np.maximum((along**2).sum(1), np.float32(1e-12))
    way = np.einsum("nti,ni->nt", texels - a[:, None].astype(np.float32), along) / length[:, None]
    guess = np.clip(np.floor(way * 15 + 0.5), 0, 15).astype(np.int64)
    best, least = guess, np.full(guess.shape, np.inf, np.float32)
    for step in (0, -1, 1):
        index = np.clip(guess + step, 0, 15)
        error = ((colors_at(a, b, index) - texels) ** 2).sum(2)
        best, least = np.where(error < least, index, best), np.minimum(error, least)
    return best, least.sum(1)


def colors_at(a: NDArray[np.int64], b: NDArray[np.int64], index: NDArray[np.int64]) -> F32:
    """(n, 16, 4) what a decoder makes of indices."""
    w = WEIGHTS[index][..., None]
    return ((64 - w) * a[:, None] + w * b[:, None] + 32 >> 6).astype(np.float32)


def fitted(texels: F32, index: NDArray[np.int64]) -> tuple[F32, F32, NDArray[np.bool_]]:
    """(n, 4) end points with the least squared error for given indices, and whether these determine them."""
    w = (WEIGHTS[index] / 64).astype(np.float32)
    aa, ab, bb = ((1 - w) ** 2).sum(1), ((1 - w) * w).sum(1), (w**2).sum(1)
    ac, bc = np.einsum("nt,nti->ni", 1 - w, texels), np.einsum("nt,nti->ni", w, texels)
    det = aa * bb - ab * ab
    sure = det > 1e-3
    by = np.where(sure, det, 1)[:, None]
    a = (bb[:, None] * ac - ab[:, None] * bc) / by
    b = (aa[:, None] * bc - ab[:, None] * ac) / by
    return np.clip(a, 0, 255), np.clip(b, 0, 255), sure


def encode(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(rows, columns, 16) bytes of the blocks of an image (height, width, 4)."""
    blocks = blocks_of(image)
    texels = blocks.reshape(-1, 16, 4)
    start, end = line_through(texels)
    a, b = quantized(np.clip(start, 0, 255), texels), quantized(np.clip(end, 0, 255), texels)
    index, error = indices_of(texels, a, b)
    start, end, sure = fitted(texels, index)
    a2, b2 = quantized(start, texels), quantized(end, texels)
    index2, error2 = indices_of(texels, a2, b2)
    better = sure & (error2 < error)
    a, b = np.where(better[:, None], a2, a), np.where(better[:, None], b2, b)
    index = np.where(better[:, None], index2, index)
    # the first index has three bits
    turn = (index[:, 0] >= 8)[:, None]
    a, b, index = np.where(turn, b, a), np.where(turn, a, b), np.where(turn, 15 - index, index)
    return packed(a, b, index).reshape(*blocks.shape[:2], 16)


def packed(a: NDArray[np.int64], b: NDArray[np.int64], index: NDArray[np.int64]) -> NDArray[np.uint8]:
    """(n, 16) bytes."""
    fields = [(np.full(len(a), 64), 7)]
    for channel in range(4):
        fields += [(a[:, channel] >> 1, 7), (b[:, channel] >> 1, 7)]
    fields += [(a[:, 0] & 1, 1), (b[:, 0] & 1, 1), (index[:, 0], 3)] + [(index[:, t], 4) for t in range(1, 16)]
    bits = np.concatenate([value[:, None] >> np.arange(width) & 1 for value, width in fields], axis=1)
    return np.packbits(bits.astype(np.uint8), axis=1, bitorder="little")


def decode(blocks: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """(height, width, 4) of blocks (rows, columns, 16), as Pillow reads them; size: (width, height)."""
    import io
    import struct

    from PIL import Image

    width, height = size
    header = struct.pack(
        "<4s7I44x2I4s5I5I", b"DDS ", 124, 0x81007, height, width, blocks.nbytes, 0, 1, 32, 4, b"DX10", 0, 0, 0, 0, 0,
        0x1000, 0, 0, 0, 0,
    ) + struct.pack("<5I", 98, 3, 0, 1, 0)  # fmt: skip
    with Image.open(io.BytesIO(header + np.ascontiguousarray(blocks).tobytes())) as image:
        return np.asarray(image.convert("RGBA"))
