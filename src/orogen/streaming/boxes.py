"""Upright boxes over parallelograms of the ground: how far they are, and whether a frustum touches them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame


def nearest_square(metres: NDArray[np.float64], low: NDArray, high: NDArray) -> NDArray[np.float64]:
    """Squared metres along the ground from the origin to the nearest point of rectangles of texels.

    `metres`: 2 x 2 matrix from texels to metres. `low`, `high`: (..., 2) corners in texels from the origin.
    """
    # squared metres are a quadratic form in texels, with a mixed term on sheared grids: the nearest point need not be
    # the nearest one in texels, but it lies on one of the four edges unless the origin is inside
    form = metres.T @ metres
    square = np.where(((low <= 0) & (high >= 0)).all(axis=-1), 0.0, np.inf)
    for axis, other in ((0, 1), (1, 0)):
        for edge in (low, high):
            fixed = edge[..., axis]
            free = np.clip(-fixed * form[0, 1] / form[other, other], low[..., other], high[..., other])
            there = form[axis, axis] * fixed**2 + 2 * form[0, 1] * fixed * free + form[other, other] * free**2
            square = np.minimum(square, there)
    return square


def may_be_seen(
    frame: Frame, planes: NDArray[np.float64], flat: NDArray, axes: NDArray, low: NDArray, high: NDArray
) -> NDArray[np.bool_]:
    """Whether boxes may touch the frustum of `planes` (`Frame.planes`).

    `flat`: (..., 2) centres in metres east and north of the camera. `axes`: (..., 2, 2) half sides, as columns, in
    metres. `low`, `high`: (...) heights in metres of the data.
    """
    farthest = np.linalg.norm(flat, axis=-1) + np.linalg.norm(axes, axis=-2).sum(axis=-1)
    top = high * frame.exaggeration - frame.camera.z
    bottom = low * frame.exaggeration - frame.camera.z - frame.curvature_factor * farthest**2
    inside = np.ones(flat.shape[:-1], bool)
    for plane in planes:
        reach = np.abs(plane[:2] @ axes).sum(axis=-1) + np.maximum(plane[2] * bottom, plane[2] * top)
        inside &= flat @ plane[:2] + reach + plane[3] >= 0
    return inside
