"""Cracks: places where a drawn surface is torn, in a depth picture and in a list of triangles.

A pixel is a crack where the drawn picture shows background below its skyline, or a surface behind both its neighbours,
and the true surface is in front. To tell tears from outlines that are merely a fraction of a pixel off, the true
surface has to be in front in the whole neighbourhood of the pixel, and background that is connected to true background
(above the skyline, before the data's near edge, in a void) is a loss at the outline, which is counted apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.compare import screen
from orogen.errors import SettingsError
from orogen.frame import Frame

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

JUMP = 4.0
"""A surface is behind another where it is this many pixel sizes deeper, per pixel of distance: no slope up to 76
degrees, seen face on, does that."""
WIDTH = 2
"""Pixels on either side of a crack within which its neighbours are looked for."""
AXES = ((0, 1), (1, 0), (1, 1), (1, -1))
"""(rows, columns) from a pixel to one of two opposite neighbours."""


@dataclass(frozen=True)
class Cracks:
    """What is torn and what is lost at the outlines in a drawn picture."""

    count: int
    """Crack pixels."""
    mask: Bools
    """(height, width): the crack pixels."""
    lost: int
    """Other pixels where the true surface is in front of nothing drawn: outlines that are drawn too small."""
    gained: int
    """Pixels where something is drawn and no true surface: outlines that are drawn too large."""
    skyline_mean: float
    """Mean distance of the drawn from the true skyline (pixels, along columns that have both); NaN without one."""
    skyline_max: float
    """Largest distance of the drawn from the true skyline (pixels); NaN without one."""


def find_cracks(
    drawn: NDArray[np.floating], reference: NDArray[np.floating], frame: Frame, *, tolerance: int = 1
) -> Cracks:
    """Count the cracks of a drawn picture.

    `drawn`, `reference`: (height, width) reverse-z depths, 0 for the sky, both seen through `frame`; `reference` shows
    the true surface. `tolerance`: pixels by which an outline may be off without being a crack; at least the largest
    screen-space error that the algorithm is set to. Raises SettingsError for shapes that do not fit.
    """
    width, height = frame.size
    for name, picture in (("drawn", drawn), ("reference", reference)):
        if picture.shape != (height, width):
            raise SettingsError(f"{name}: expected a depth picture of shape {(height, width)}, got {picture.shape}")
    # up on the screen, to the nearest quarter turn
    turn = -round(frame.camera.roll / 90)
    drawn, reference = np.rot90(drawn, turn), np.rot90(reference, turn)
    shown, margin = _distances(drawn, frame)
    true, true_margin = _distances(reference, frame)
    covered = shown > _largest(true + JUMP * true_margin, tolerance)
    nothing, no_truth = drawn == 0, reference == 0
    torn = covered & ((nothing & ~_reaches(nothing, no_truth)) | _behind_both(shown, margin))
    apart = _skyline(drawn) - _skyline(reference)
    apart = np.abs(apart[~np.isnan(apart)])
    return Cracks(
        int(torn.sum()),
        np.ascontiguousarray(np.rot90(torn, -turn)),
        int((nothing & ~no_truth & ~torn).sum()),
        int((no_truth & ~nothing).sum()),
        float(apart.mean()) if apart.size else math.nan,
        float(apart.max()) if apart.size else math.nan,
    )


def _distances(depth: NDArray[np.floating], frame: Frame) -> tuple[Floats, Floats]:
    """View depth in metres, infinite for the sky, and metres that a pixel covers there."""
    distance = frame.view_depth(depth)
    return np.where(depth > 0, distance, np.inf), np.nan_to_num(screen.pixel_size(frame, depth))


def _shifted(values: Floats, rows: int, columns: int, outside: float) -> Floats:
    """The values of the pixels so many rows below and columns to the right."""
    reach = max(abs(rows), abs(columns))
    padded = np.pad(values, reach, constant_values=outside)
    height, width = values.shape
    return padded[reach + rows : reach + rows + height, reach + columns : reach + columns + width]


def _largest(values: Floats, reach: int) -> Floats:
    """The largest value within `reach` rows and columns of every pixel; infinite where those leave the picture."""
    for axis in ((1, 0), (0, 1)):
        steps = range(-reach, reach + 1)
        values = np.maximum.reduce([_shifted(values, n * axis[0], n * axis[1], np.inf) for n in steps])
    return values


def _behind_both(shown: Floats, margin: Floats) -> Bools:
    result = np.zeros(shown.shape, bool)
    for row, column in AXES:
        sides = [
            np.minimum.reduce(
                [
                    _shifted(shown + JUMP * n * margin, sign * n * row, sign * n * column, np.inf)
                    for n in range(1, WIDTH + 1)
                ]
            )
            for sign in (1, -1)
        ]
        result |= shown > np.maximum(*sides)
    return result


def _reaches(nothing: Bools, no_truth: Bools) -> Bools:
    """Where background is in one vertical run with true background."""
    starts = nothing & ~np.vstack([np.zeros((1, nothing.shape[1]), bool), nothing[:-1]])
    # numbered down the columns, one after the other
    run = np.cumsum(starts.T.ravel()) * nothing.T.ravel()
    true = np.bincount(run, weights=(nothing & no_truth).T.ravel()) > 0
    return true[run].reshape(nothing.shape[::-1]).T & nothing


def _skyline(depth: NDArray[np.floating]) -> Floats:
    """Row of the highest drawn pixel of every column; NaN where there is no sky above it."""
    drawn = depth > 0
    row = drawn.argmax(axis=0).astype(np.float64)
    return np.where(drawn.any(axis=0) & ~drawn[0], row, np.nan)


def open_edges(
    triangles: NDArray[np.floating], border: tuple[float, float, float, float] | None = None
) -> NDArray[np.floating]:
    """Edges that break a surface apart: those that are not shared by exactly two triangles.

    `triangles`: (n, 3, 3) corners x, y, z; corners are the same only if they are equal bit for bit. `border`: (left,
    bottom, right, top) of the surface; edges that lie on one of its sides may be open. Triangles of which two corners
    coincide are left out: they cover nothing. Returns (m, 2, 3); none for a watertight surface.
    """
    if triangles.ndim != 3 or triangles.shape[1:] != (3, 3):
        raise SettingsError(f"triangles: expected corners of shape (n, 3, 3), got {triangles.shape}")
    # -0 and 0 are the same place
    corners, index = np.unique(triangles.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    index = index.reshape(-1, 3)
    a, b, c = index.T
    index = index[(a != b) & (b != c) & (c != a)]
    edges = np.sort(np.concatenate([index[:, [0, 1]], index[:, [1, 2]], index[:, [2, 0]]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    ends = corners[edges]
    wrong = count != 2
    if border is not None:
        left, bottom, right, top = border
        x, y = ends[..., 0], ends[..., 1]
        sides = np.stack([x == left, x == right, y == bottom, y == top])
        wrong &= ~((count == 1) & sides.all(axis=2).any(axis=0))
    return ends[wrong]
