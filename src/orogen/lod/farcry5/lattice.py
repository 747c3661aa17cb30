"""Where the nodes lie and which of them may be drawn: the uniform block of farcry5.wgsl."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import BudgetError
from orogen.frame import Frame
from orogen.streaming.clipmap import Clipmap

PATCHES = 8
"""Patches along a node's side (Kuehnert 2022, figure 3.12)."""
FINEST_QUAD = 64
"""A texel is split into at most this many quads a side: below that the bilinear surface is flat to a thousandth."""
MAX_LEVELS = 32
"""Levels of nodes that the block has room for: more than int32 subtexels allow."""

_MAX_MAP_BITS = 8

BLOCK = np.dtype(
    [
        ("leaf", "u4"),
        ("root_level", "u4"),
        ("floor_level", "u4"),
        ("map_bits", "u4"),
        ("capacity", "u4"),
        ("drop_undersides", "u4"),
        ("history", "u4"),
        ("split_distance", "f4"),
        ("near_reach", "f4"),
        ("padding", "u4", 3),
        ("to_history", "f4", (4, 4)),
        ("origins", "i4", (MAX_LEVELS, 4)),
    ]
)


def lattice(frame: Frame, clipmap: Clipmap, patch_quads: int, pixels_per_quad: float) -> NDArray[Any]:
    """The block (0-dimensional, dtype `BLOCK`) of a frame, without capacity and history.

    Raises BudgetError where `pixels_per_quad` asks for more nodes than the LOD map can hold.
    """
    bits = frame.subtexel_bits
    leaf = max(1, (1 << bits) // FINEST_QUAD)
    node = PATCHES * patch_quads * leaf
    extent = np.array([frame.grid.width - 1, frame.grid.height - 1]) << bits
    root_level = max(0, math.ceil(math.log2(max(int(extent.max()), 1) / node)))
    # quads are measured along their longer side, where texels are not square
    texel_metres = float(np.linalg.norm(frame.grid.metres, axis=0).max())
    reach = frame.pixels_per_radian(frame.lod) / pixels_per_quad
    block = np.zeros((), BLOCK)
    block["leaf"], block["root_level"] = leaf, root_level
    block["split_distance"] = split = 2 * reach * texel_metres * leaf / (1 << bits)
    block["floor_level"] = _floor_level(frame, root_level, split)
    block["drop_undersides"] = clipmap.heights.covered and _is_over_the_data(frame)
    block["near_reach"] = _near_reach(frame)
    # nodes lie within a child's range of splitting and a parent's width around the eye
    stretch = float(np.linalg.norm(frame.grid.texels, axis=1).max()) * texel_metres
    nodes = -(-extent // node)
    needed = 2 * math.ceil(2 * reach / (PATCHES * patch_quads) * stretch + 2) + 2
    map_bits = math.ceil(math.log2(max(1, min(needed, int(nodes.max())))))
    if map_bits > _MAX_MAP_BITS:
        raise BudgetError(
            f"farcry5: expected at most {1 << _MAX_MAP_BITS} nodes a side around the eye, got {needed}; "
            "raise pixels_per_quad or patch_quads"
        )
    block["map_bits"] = map_bits
    block["origins"][: root_level + 1, :2] = _origins(frame, node / (1 << bits), nodes, root_level, 1 << map_bits)
    return block


def _floor_level(frame: Frame, root_level: int, split_distance: float) -> int:
    """The finest level that can be reached, since the eye is that high over everything."""
    highest = frame.height_range[1] * frame.exaggeration
    above = float(frame.lod_eye()[2]) + frame.camera.z - highest
    level = root_level
    # give or take rounding
    while level > 0 and above < 1.001 * split_distance * 2.0 ** (level - 1):
        level -= 1
    return level


def _lod_texel(frame: Frame) -> NDArray[np.float64]:
    """The LOD eye's position (column, row) in texels from the first sample."""
    return frame.eye + frame.grid.texels @ frame.lod_eye()[:2] - 0.5


def _is_over_the_data(frame: Frame) -> bool:
    """Whether all that the LOD camera sees is seen from a point over the data: not past its border from aside."""
    at = _lod_texel(frame)
    return frame.lod.orthographic is None and bool(
        (at >= 0).all() and (at[0] <= frame.grid.width - 1) and (at[1] <= frame.grid.height - 1)
    )


def _near_reach(frame: Frame) -> float:
    """Metres from the LOD eye to the corners of its near plane, and a little more."""
    half = math.tan(math.radians(frame.lod_fov) / 2)
    return 1.01 * frame.lod.near * math.hypot(1.0, half, half * frame.size[0] / frame.size[1])


def _origins(frame: Frame, node_texels: float, nodes: NDArray[Any], root_level: int, side: int) -> NDArray[np.int64]:
    """(levels, 2): first node column and row of each level's window, kept over the data."""
    widths = node_texels * 2.0 ** np.arange(root_level + 1)[:, None]
    middle = np.floor(np.clip(_lod_texel(frame) / widths, -1e9, 1e9)).astype(np.int64)
    counts = -(-nodes[None] // (1 << np.arange(root_level + 1)[:, None]))
    return np.clip(middle - side // 2, 0, np.maximum(counts - side, 0))
