"""The uniform blocks of frame.wgsl and clipmap.wgsl, field by field."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
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
        ("padding", "f4", 2),
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
    [("layers", LAYER, 2), ("color_matrix", "f4", (2, 2)), ("color_anchor", "i4", 2), ("color_offset", "f4", 2)]
)


def frame_block(frame: Frame) -> NDArray[np.void]:
    """The frame's uniform block (0-dimensional, dtype `FRAME`)."""
    camera, bits = frame.camera, frame.subtexel_bits
    right, up, forward = camera.basis.tolist()
    half_x, half_y = frame.half_extent
    values = (
        *frame.view_projection.T.ravel().tolist(),
        *(half_x * v for v in right), 0.0,
        *(half_y * v for v in up), 0.0,
        *forward, camera.orthographic is not None,
        *frame.metres.ravel().tolist(),
        *(v * (1 << bits) for v in frame.grid.texels.ravel().tolist()),
        *frame.anchor.tolist(), *frame.eye_offset.tolist(),
        *frame.size, *frame.jitter,
        *frame.lod_eye().tolist(), frame.pixels_per_radian(),
        camera.z / frame.exaggeration, frame.exaggeration, frame.curvature_factor, camera.near,
        *(frame.depth_range if camera.orthographic else (0.0, 0.0)), *frame.height_range,
        frame.ground_height * frame.exaggeration - camera.z, frame.grid.spacing, bits, frame.slice,
        *extent(frame.grid, bits).tolist(),
        *frame.planes().ravel().tolist(),
        frame.pixels_per_radian(frame.lod),
        camera.orthographic / frame.size[1] if camera.orthographic else 0.0,
    )  # fmt: skip
    # at once: numpy would take two microseconds for each of the fields
    return np.frombuffer(_PACKED.pack(*values), FRAME)[0:1].reshape(())


def extent(grid: Grid, bits: int) -> NDArray[np.int64]:
    """Left, top, right and bottom of the drawn area, the hull of the sample centres, in subtexels."""
    half = 1 << bits >> 1
    return np.array([half, half, (grid.width << bits) - half, (grid.height << bits) - half])


def color_mapping(frame: Frame, colors: Grid, bits: int) -> tuple[NDArray, NDArray, NDArray]:
    """Matrix from height subtexels to colour subtexels; colour subtexel of the frame's anchor, and its fraction."""
    anchor = frame.anchor.astype(np.float64) / (1 << frame.subtexel_bits)
    at = np.array([float(v) for v in colors.to_texel(*frame.grid.to_crs(*anchor))]) * (1 << bits)
    to_colors = np.linalg.inv(_linear(colors)) @ _linear(frame.grid)
    whole = np.floor(np.clip(at, -(2.0**30), 2.0**30))
    return to_colors * 2.0 ** (bits - frame.subtexel_bits), whole.astype(np.int32), at - whole


def _linear(grid: Grid) -> NDArray[np.float64]:
    a, b, _, d, e, _ = grid.transform
    return np.array([[a, b], [d, e]])
