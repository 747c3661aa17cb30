"""The uniform blocks of frame.wgsl and clipmap.wgsl, field by field."""

from __future__ import annotations

import math
import struct
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame, subtexel_bits
from orogen.grid import Grid

MAX_LEVELS = 28
"""Levels that a clipped quadtree can have."""

FRAME = np.dtype(
    [
        ("view_projection", "f4", (4, 4)),
        ("right", "f4", 4),
        ("up", "f4", 4),
        ("forward", "f4", 4),
        ("metres", "f4", (2, 2)),
        ("subtexels", "f4", (2, 2)),
        ("anchor", "i4", 2),
        ("eye_offset", "f4", 2),
        ("size", "u4", 2),
        ("jitter", "f4", 2),
        ("lod_eye", "f4", 3),
        ("pixels_per_radian", "f4"),
        ("eye_height", "f4"),
        ("exaggeration", "f4"),
        ("curvature", "f4"),
        ("near", "f4"),
        ("depth_near", "f4"),
        ("depth_far", "f4"),
        ("height_min", "f4"),
        ("height_max", "f4"),
        ("ground", "f4"),
        ("spacing", "f4"),
        ("subtexel_bits", "u4"),
        ("slice", "u4"),
        ("extent", "i4", 4),
        ("planes", "f4", (5, 4)),
        ("lod_pixels_per_radian", "f4"),
        ("pixel_metres", "f4"),
        ("eye_rest", "f4"),
        ("padding", "f4"),
    ]
)


def _packing(block: np.dtype[Any]) -> struct.Struct:
    """How the scalars of a block are packed; what its field "padding" holds is zero."""
    code = "<"
    for name in block.names or ():
        field = block[name]
        count = math.prod(field.shape)
        code += f"{4 * count}x" if name == "padding" else f"{count}{_CODES[field.base.kind]}"
    return struct.Struct(code)


_CODES = {"f": "f", "i": "i", "u": "I"}
_PACKED = _packing(FRAME)
_PACKED_COLORS = struct.Struct("<4f2i2f")
_PACKED_SUN = struct.Struct("<3fI")

LAYER = np.dtype(
    [
        ("level_count", "u4"),
        ("table_bits", "u4"),
        ("table_start", "u4"),
        ("present", "u4"),
        ("reach", "f4"),
        ("blend_range", "f4"),
        ("subtexel_bits", "u4"),
        ("covered", "u4"),
        ("extent", "i4", 4),
        ("origins", "i4", (MAX_LEVELS, 4)),
    ]
)

CLIPMAP = np.dtype(
    [
        ("layers", LAYER, 2),
        ("color_matrix", "f4", (2, 2)),
        ("color_anchor", "i4", 2),
        ("color_offset", "f4", 2),
        ("sun_slope", "f4", 2),
        ("sun_rise", "f4"),
        ("sun_ready", "u4"),
    ]
)


class _Fixed(NamedTuple):
    """What frame blocks tell of a grid."""

    metres: tuple[float, ...]
    texels: tuple[float, ...]
    extent: tuple[int, ...]
    spacing: float


@lru_cache(maxsize=16)
def _fixed(grid: Grid) -> _Fixed:
    bits = subtexel_bits(grid)
    metres, texels = (grid.metres / (1 << bits)).ravel(), (grid.texels * (1 << bits)).ravel()
    return _Fixed(tuple(metres.tolist()), tuple(texels.tolist()), tuple(extent(grid, bits).tolist()), grid.spacing)


def frame_block(frame: Frame) -> bytes:
    """The frame's uniform block, a value of dtype `FRAME`.

    All in plain numbers, as this is done in every frame: for so few numpy takes several times as long.
    """
    camera, fixed = frame.camera, _fixed(frame.grid)
    right, up, forward = camera.axes
    half_x, half_y = frame.half_extent
    (x0, x1, x2, x3), (y0, y1, y2, y3), (z0, z1, z2, z3), (w0, w1, w2, w3) = frame.clip_rows
    sides = frame.plane_rows
    eye_height, eye_rest = frame.eye_height
    return _PACKED.pack(
        x0, y0, z0, w0, x1, y1, z1, w1, x2, y2, z2, w2, x3, y3, z3, w3,
        half_x * right[0], half_x * right[1], half_x * right[2], 0.0,
        half_y * up[0], half_y * up[1], half_y * up[2], 0.0,
        *forward, camera.orthographic is not None,
        *fixed.metres, *fixed.texels,
        *frame.anchor_subtexel, *frame.eye_fraction,
        *frame.size, *frame.jitter,
        *frame.lod_place, frame.pixels_per_radian(),
        eye_height, frame.exaggeration, frame.curvature_factor, camera.near,
        *(frame.depth_range if camera.orthographic else (0.0, 0.0)), *frame.height_range,
        frame.ground_height * frame.exaggeration - camera.z, fixed.spacing, frame.subtexel_bits, frame.slice,
        *fixed.extent,
        *sides[0], *sides[1], *sides[2], *sides[3], *sides[4],
        frame.pixels_per_radian(frame.lod),
        camera.orthographic / frame.size[1] if camera.orthographic else 0.0,
        eye_rest,
    )  # fmt: skip


def extent(grid: Grid, bits: int) -> NDArray[np.int64]:
    """Left, top, right and bottom of the drawn area, the hull of the sample centres, in subtexels."""
    half = 1 << bits >> 1
    return np.array([half, half, (grid.width << bits) - half, (grid.height << bits) - half])


def color_mapping(
    frame: Frame, colors: Grid, bits: int
) -> tuple[tuple[float, ...], tuple[int, ...], tuple[float, ...]]:
    """2 x 2 matrix, row by row, from height subtexels to colour subtexels; colour subtexel of the frame's anchor, and
    its fraction.
    """
    x, y = (at / (1 << frame.subtexel_bits) for at in frame.anchor_subtexel)
    a, b, c, d, e, f = frame.grid.transform
    at = [v * (1 << bits) for v in colors.texel_of(a * x + b * y + c, d * x + e * y + f)]
    whole = [math.floor(min(max(v, -(2.0**30)), 2.0**30)) for v in at]
    scale = 2.0 ** (bits - frame.subtexel_bits)
    return (
        tuple(scale * v for v in _to_colors(frame.grid, colors)),
        tuple(whole),
        tuple(v - w for v, w in zip(at, whole, strict=True)),
    )


def color_block(mapping: tuple[tuple[float, ...], tuple[int, ...], tuple[float, ...]] | None) -> bytes:
    """What follows the layers in a clipmap's uniform block; zeros without colours."""
    matrix, whole, rest = mapping or ((0.0,) * 4, (0, 0), (0.0, 0.0))
    return _PACKED_COLORS.pack(*matrix, *whole, *rest)


def sun_block(slope: tuple[float, float], rise: float) -> bytes:
    """The end of a clipmap's uniform block, where sun ceilings are to be used: metres of the data that rays towards the
    sun rise, per subtexel along columns and rows, and per metre of their length.
    """
    return _PACKED_SUN.pack(*slope, rise, 1)


NO_SUN_BLOCK = bytes(_PACKED_SUN.size)
"""The same where they are not."""


@lru_cache(maxsize=16)
def _to_colors(grid: Grid, colors: Grid) -> tuple[float, ...]:
    """From steps in texels of heights to steps in texels of colours."""
    return tuple((np.linalg.inv(_linear(colors)) @ _linear(grid)).ravel().tolist())


def _linear(grid: Grid) -> NDArray[np.float64]:
    a, b, _, d, e, _ = grid.transform
    return np.array([[a, b], [d, e]])
