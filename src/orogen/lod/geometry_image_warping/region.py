"""The part of the data that the sketch map is made of: the smallest rectangle of samples around what can be seen."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame

Floats = NDArray[np.float64]

_SLACK = 1e-4
"""Share of the data's longer side by which the rectangle is wider than needed, for rounding."""


def seen_region(frame: Frame, relief: float = 0.0) -> Floats | None:
    """(2, 2) first and last column and row, level-0 texels, of a rectangle around all terrain that can be seen.

    It is cut off at the outermost samples' centres. `relief`: metres by which heights may leave the data's range. None
    where the LOD camera can see no terrain.
    """
    seen = _visible_volume(frame, relief)
    if not len(seen):
        return None
    texels = frame.eye + seen[:, :2] @ frame.grid.texels.T
    slack = _SLACK * max(frame.grid.shape)
    low, high = _outermost(frame)
    return np.array([texels.min(axis=0) - slack, texels.max(axis=0) + slack]).clip(low, high)


def sketch_lattice(frame: Frame, region: Floats, count: int, *, even: bool = False) -> NDArray[np.float32]:
    """(count, 2) x of the sketch map's columns and y of its rows, subtexels from the anchor, from side to side.

    Lines are as far apart as they are from the eye, so that nothing is too small for the sketch map; or `even`.
    """
    corners = region * (1 << frame.subtexel_bits) - frame.anchor
    inverse = np.linalg.inv(frame.metres)
    eye = frame.lod_eye()
    foot = inverse @ eye[:2] + frame.eye_offset
    ground = frame.ground_height * frame.exaggeration - frame.camera.z
    altitude = max(abs(float(eye[2]) - ground), nearest(frame)) * np.linalg.norm(inverse, axis=1)
    ways = np.linspace(0.0, 1.0, count)[:, None]
    lines = corners[0] + ways * (corners[1] - corners[0])
    if not even:
        # the integral of 1 / distance from the eye is an arsinh
        ends = np.arcsinh((corners - foot) / altitude)
        lines = foot + altitude * np.sinh(ends[0] + ways * (ends[1] - ends[0]))
    lines = lines.clip(*corners)
    # outwards by what float32 rounds off; shaders move points back onto the data
    away = 2.0**-22 * np.abs(corners)
    lines[0], lines[-1] = corners[0] - away[0], corners[1] + away[1]
    return lines.astype(np.float32)


def nearest(frame: Frame) -> float:
    """Metres to the LOD eye below which a distance makes no difference: cells are small enough there."""
    return frame.grid.spacing / 64


def rows_run_along_x(frame: Frame) -> bool:
    """Whether x, not y of the data, lies more across the LOD camera's view: rows of the images run along it."""
    heading = np.radians(frame.lod.heading)
    x, y = frame.grid.texels @ [np.cos(heading), -np.sin(heading)]
    return bool(abs(x) >= abs(y))


def _outermost(frame: Frame) -> tuple[Floats, Floats]:
    """First and last sample centre (column, row)."""
    return np.full(2, 0.5), np.array([frame.grid.width, frame.grid.height]) - 0.5


def _visible_volume(frame: Frame, relief: float) -> Floats:
    """(n, 3) corners, camera-relative metres, of what the LOD camera's frustum and the terrain's box share."""
    low, high = frame.height_range
    low, high = ((h + side * relief) * frame.exaggeration - frame.camera.z for h, side in ((low, -1), (high, 1)))
    (left, top), (right, bottom) = _outermost(frame)
    texels = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    corners = (texels - frame.eye) @ frame.grid.metres.T
    low -= frame.curvature_factor * float((corners**2).sum(axis=1).max())
    # a flat terrain, and one of a single row of samples, is a volume too
    margin = 1e-3 * frame.grid.spacing + 1e-6 * (max(abs(low), abs(high)) + float(np.abs(corners).max()))
    steps = frame.grid.texels
    axes = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    reach = corners @ axes.T
    sides = [(*axis, 0.0, margin - reach[:, k].min()) for k, axis in enumerate(axes)]
    sides += [(*-axis, 0.0, margin + reach[:, k].max()) for k, axis in enumerate(axes)]
    box = [*sides, (0.0, 0.0, 1.0, margin - low), (0.0, 0.0, -1.0, margin + high)]
    return _corners(np.concatenate([frame.planes(), box]))


def _corners(planes: Floats) -> Floats:
    """(n, 3) corners of the convex body within (m, 4) planes of unit normals, positive inside."""
    meeting = planes[_triples(len(planes))]
    meeting = meeting[np.abs(np.linalg.det(meeting[..., :3])) > 1e-12]
    points = np.linalg.solve(meeting[..., :3], -meeting[..., 3:])[..., 0]
    slack = 1e-6 + 1e-9 * np.linalg.norm(points, axis=1, keepdims=True)
    return points[(points @ planes[:, :3].T + planes[:, 3] >= -slack).all(axis=1)]


@cache
def _triples(count: int) -> NDArray[np.intp]:
    return np.array(list(combinations(range(count), 3)))
