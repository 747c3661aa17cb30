"""From points in data coordinates to pixels, in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.frame import Frame

Floats = NDArray[np.float64]


def clip(frame: Frame, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Floats:
    """(..., 4) clip coordinates of points: x, y in the data's CRS, z in metres before exaggeration."""
    texel = np.stack(np.broadcast_arrays(*frame.grid.to_texel(x, y)), axis=-1)
    flat = (texel - frame.eye) @ frame.grid.metres.T
    drop = frame.curvature_factor * (flat**2).sum(axis=-1)
    up = np.asarray(z, np.float64) * frame.exaggeration - frame.camera.z - drop
    point = np.concatenate([flat, up[..., None], np.ones_like(up)[..., None]], axis=-1)
    return point @ frame.view_projection.T


def pixels(frame: Frame, clipped: Floats) -> tuple[Floats, Floats]:
    """(column, row) of clip coordinates in pixels, centres at whole numbers + 0.5; NaN behind the camera."""
    width, height = frame.size
    w = np.where(clipped[..., 3] > 0, clipped[..., 3], np.nan)
    return (clipped[..., 0] / w + 1) / 2 * width, (1 - clipped[..., 1] / w) / 2 * height


def pixel_size(frame: Frame, depth: NDArray[np.floating]) -> Floats:
    """Metres that a pixel covers, facing the camera, at reverse-z depths; NaN for the sky."""
    metres = 2 * frame.half_extent[1] / frame.size[1]
    distance = frame.view_depth(depth)
    return np.where(np.isnan(distance), np.nan, metres) if frame.camera.orthographic else distance * metres


def vertical(frame: Frame, clipped: Floats) -> tuple[Floats, Floats, Floats]:
    """How points move when they rise: pixels to the right, pixels down and reverse-z depth, per metre of height."""
    width, height = frame.size
    rise = frame.view_projection[:, 2] * frame.exaggeration
    w = clipped[..., 3]
    x, y, depth = ((rise[i] * w - clipped[..., i] * rise[3]) / w**2 for i in range(3))
    return x * width / 2, -y * height / 2, depth
