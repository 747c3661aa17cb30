"""The part of the ground plane that the grid has to cover, and the auxiliary camera that looks at it.

The ground plane has two axes: `s`, metres along the view direction, and `l`, metres to its right, both from the foot of
the LOD camera's eye. The auxiliary camera's x axis is level, so a row of the grid is a line of constant s, and what the
camera sees of a row lies between two bounds on l: the outline is a left and a right chain of points, by growing s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame

Floats = NDArray[np.float64]

_LEAST_HEIGHT = 0.05
"""Of the auxiliary camera over the ground plane, as a share of the relief ("a small positive value", section 3.2.2)."""
_BEHIND = math.radians(5.0)
"""Angle that the auxiliary camera keeps between its view plane and the rearmost ground that it must cover."""


@dataclass(frozen=True)
class Outline:
    """What the grid covers, and how the auxiliary camera sees it."""

    left: Floats
    """(n, 2) s and l of the left border, n at least 2, strictly growing in s; convex."""
    right: Floats
    """(m, 2) likewise of the right border, from the same first to the same last s; concave."""
    left_data: int
    """Bit k: piece k of the left border is a side of the data."""
    right_data: int
    """Likewise of the right border."""
    rows: tuple[float, float]
    """s of the grid's first and last row, where these are not beyond the borders' ends."""
    depths: tuple[float, float]
    """Depths of those rows in front of the auxiliary camera: what rows are even in is s / depth."""
    columns: tuple[float, float]
    """l / depth of the grid's first and last column, where they are even in that: without tailoring to the hull."""


def directions(frame: Frame) -> tuple[Floats, Floats]:
    """Unit vectors (east, north) of the axes s and l.

    s is the view direction, and the picture's upward one where the camera looks straight down (section 3.2.2).
    """
    camera = frame.lod
    heading, pitch = math.radians(camera.heading), math.radians(camera.pitch)
    ahead = np.array([math.sin(heading), math.cos(heading)])
    # without a jump in between, so that the grid of a tilting camera does not turn at once
    along = ahead * max(math.cos(pitch), 1e-6) + camera.basis[1, :2] * max(-math.sin(pitch), 0.0) ** 4
    along /= np.linalg.norm(along)
    return along, np.array([along[1], -along[0]])


def find_outline(frame: Frame, tailoring: str) -> Outline | None:
    """What the grid has to cover with tailoring "off", "box" or "hull"; None where no terrain can be seen."""
    visible = ground_points(frame, visible_volume(frame))
    if len(visible) < 3:
        return None
    eye = Projector.over(frame, visible)
    corners = ground_points(frame, data_corners(frame))
    slopes = visible[:, 1] / [eye.depth(s) for s in visible[:, 0]]
    near, far = float(visible[:, 0].min()), float(visible[:, 0].max())
    left, right = float(slopes.min()), float(slopes.max())
    if tailoring == "off" and eye.fov:
        first, last = eye.rows(float(corners[:, 0].min()), float(corners[:, 0].max()))
        near, far = min(near, first), max(far, last)
        half = math.tan(eye.fov / 2) * frame.size[0] / frame.size[1]
        left, right = min(left, -half), max(right, half)
    area = visible
    if tailoring != "hull":
        # what the view plane's rectangle shows of the data
        tilt, base = math.cos(eye.pitch), eye.height * math.sin(eye.pitch)
        sides = np.array(
            [(1, 0, -near), (-1, 0, far), (-left * tilt, 1, -left * base), (right * tilt, -1, right * base)]
        )
        area = _corners(np.concatenate([sides, _sides(corners)]))
    borders = chain(area, -1), chain(area, 1)
    if min(map(len, borders)) < 2:
        return None
    return Outline(
        *borders,
        _along(borders[0], corners),
        _along(borders[1], corners),
        rows=(near, far),
        depths=(eye.depth(near), eye.depth(far)),
        columns=(left, right),
    )


def visible_volume(frame: Frame) -> Floats:
    """(n, 3) corners, camera-relative metres, of the LOD camera's frustum within the terrain volume (section 3.3)."""
    low, high = (height * frame.exaggeration - frame.camera.z for height in frame.height_range)
    corners = data_corners(frame)
    low -= frame.curvature_factor * float((corners**2).sum(axis=1).max())
    # a flat terrain, too, is a volume
    margin = 1e-3 * frame.grid.spacing + 1e-6 * max(abs(low), abs(high))
    floor_and_ceiling = np.array([(0, 0, 1, margin - low), (0, 0, -1, margin + high)])
    walls = np.insert(_sides(corners), 2, 0.0, axis=1)
    return _corners(np.concatenate([frame.planes(), floor_and_ceiling, walls]))


def _corners(planes: Floats) -> Floats:
    """(n, d) corners of the convex body within (m, d + 1) planes, positive inside; d is 2 or 3."""
    dimension = planes.shape[1] - 1
    meeting = planes[_meetings(len(planes), dimension)]
    meeting = meeting[np.abs(np.linalg.det(meeting[..., :-1])) > 1e-12]
    points = np.linalg.solve(meeting[..., :-1], -meeting[..., -1:])[..., 0]
    slack = 1e-6 + 1e-9 * np.linalg.norm(points, axis=1, keepdims=True)
    lengths = np.linalg.norm(planes[:, :-1], axis=1).clip(1.0)
    return points[(points @ planes[:, :-1].T + planes[:, -1] >= -slack * lengths).all(axis=1)]


@cache
def _meetings(planes: int, count: int) -> NDArray[np.intp]:
    """All choices of `count` of the planes."""
    return np.array(list(combinations(range(planes), count)))


def _sides(corners: Floats) -> Floats:
    """(4, 3) lines, positive inside, through the corners of a parallelogram in turn."""
    steps = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([-steps[:, 1], steps[:, 0]], axis=1) / np.linalg.norm(steps, axis=1, keepdims=True).clip(1e-30)
    normals *= np.sign(((corners.mean(axis=0) - corners) * normals).sum(axis=1, keepdims=True))
    return np.column_stack([normals, -(normals * corners).sum(axis=1)])


def _along(border: Floats, corners: Floats) -> int:
    """Bits: which pieces of a border lie on a side of the data, given by its corners in turn."""
    sides = _sides(corners)
    on_side = np.abs(border @ sides[:, :2].T + sides[:, 2]) <= 1e-6 * (1 + np.abs(border).max())
    pieces = (on_side[:-1] & on_side[1:]).any(axis=1)
    return int((pieces << np.arange(len(pieces))).sum())


def ground_points(frame: Frame, points: Floats) -> Floats:
    """(n, 2) s and l of camera-relative points (n, 2 or 3)."""
    return (points[:, :2] - frame.lod_eye()[:2]) @ np.stack(directions(frame), axis=1)


def data_corners(frame: Frame) -> Floats:
    """(4, 2) corners of the drawn area in camera-relative metres (east, north), in turn."""
    columns, rows = frame.grid.width - 0.5, frame.grid.height - 0.5
    texels = np.array([(0.5, 0.5), (columns, 0.5), (columns, rows), (0.5, rows)])
    return (texels - frame.eye) @ frame.grid.metres.T


def chain(points: Floats, side: int) -> Floats:
    """The left (-1) or right (+1) border of the convex hull of points (s, l), by growing s."""
    points = points[np.lexsort((side * points[:, 1], points[:, 0]))]
    # of points on one row the outermost; rows closer than float32 can tell are one
    apart = 1e-6 * max(float(np.abs(points[:, 0]).max()), 1e-3)
    hull: list[Floats] = []
    for point in points:
        if hull and point[0] - hull[-1][0] < apart:
            outer = max(side * point[1], side * hull[-1][1]) * side
            point = np.array([hull.pop()[0], outer])
        while len(hull) > 1 and side * _turn(hull[-2], hull[-1], point) >= 0:
            hull.pop()
        hull.append(point)
    return np.array(hull)


def _turn(a: Floats, b: Floats, c: Floats) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


@dataclass(frozen=True)
class Projector:
    """The auxiliary camera: over the LOD camera's foot, level from left to right (section 3.2.2)."""

    height: float
    """Metres over the ground plane."""
    pitch: float
    """Radians that it looks down; phi_aux of equation 3.1."""
    fov: float
    """Vertical angle of view in radians; 0 for an orthographic one."""

    @classmethod
    def over(cls, frame: Frame, visible: Floats) -> Projector:
        """The auxiliary camera that has all of `visible` (s, l) before it."""
        if frame.lod.orthographic:
            return cls(1.0, math.pi / 2, 0.0)
        low, high = (height * frame.exaggeration for height in frame.height_range)
        over_plane = float(frame.lod_eye()[2]) + frame.camera.z - low
        height = max(over_plane, _LEAST_HEIGHT * (high - low), frame.grid.spacing)
        # equation 3.1; its epsilon is left to the end of the data, beyond which there is nothing to sample
        fov = math.radians(max(frame.lod.fov, 90.0))
        pitch = max(-math.radians(frame.lod.pitch), fov / 2)
        # beyond the document: ground behind the eye can be seen by cameras that are very wide or look up from a valley
        rear = math.atan2(-float(visible[:, 0].min()), height) + _BEHIND
        return cls(height, min(max(pitch, rear), math.pi / 2), fov)

    def depth(self, s: float) -> float:
        """Depth in front of the camera of the ground at s."""
        return max(s * math.cos(self.pitch) + self.height * math.sin(self.pitch), 1e-6 * self.height)

    def rows(self, first: float, last: float) -> tuple[float, float]:
        """Nearest and farthest s on the view plane, within the data's `first` and `last`."""
        nearest, farthest = self.pitch + self.fov / 2, self.pitch - self.fov / 2
        near = self.height / math.tan(nearest)
        far = self.height / math.tan(farthest) if farthest > 1e-9 else math.inf
        return max(near, first), min(far, last)
