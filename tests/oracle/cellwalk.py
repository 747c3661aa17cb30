"""The true surface seen through a camera, by walking every ray cell by cell in float64 numpy.

Independent of the renderer: a cell is a bilinear patch, a ray's height above it is a quadratic in the ray's parameter
(with earth curvature too), and the first root inside the cell where at least half is covered is the hit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame

CHUNK = 1 << 15


def depth_picture(frame: Frame, heights: NDArray[np.floating]) -> NDArray[np.float64]:
    """(height, width) reverse-z depth of the true surface of `heights` (rows, columns; NaN: none) through `frame`."""
    camera, (width, height) = frame.camera, frame.size
    t = first_hits(frame, heights, *(np.reshape(part, (-1, 3)) for part in _rays(frame))).reshape(height, width)
    if camera.orthographic:
        near, far = frame.depth_range
        return np.nan_to_num((far - t) / (far - near))
    t = np.where(t >= camera.near, t, np.nan)
    return np.nan_to_num(camera.near / t)


def first_hits(
    frame: Frame, heights: NDArray[np.floating], origin: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) parameters t of the first hits of rays origin + t direction (camera-relative metres, n x 3); NaN: none."""
    values, valid = _fill(np.asarray(heights, np.float64))
    hits = [
        _walk(frame, values, valid, origin[k : k + CHUNK], direction[k : k + CHUNK])
        for k in range(0, len(origin), CHUNK)
    ]
    return np.concatenate(hits)


def _rays(frame: Frame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # derived here from the angles alone, not through Frame.rays
    camera, (width, height) = frame.camera, frame.size
    heading, pitch, roll = np.radians([camera.heading, camera.pitch, camera.roll])
    x = (np.arange(width) + 0.5 + frame.jitter[0] - width / 2) / (height / 2)
    y = -(np.arange(height) + 0.5 + frame.jitter[1] - height / 2) / (height / 2)
    x, y = np.broadcast_arrays(x[None, :], y[:, None])
    scale = camera.orthographic / 2 if camera.orthographic else np.tan(np.radians(camera.fov) / 2)
    # picture axes turned back by the roll, then tilted by the pitch, then turned to the heading
    right = (x * np.cos(roll) + y * np.sin(roll)) * scale
    up = (y * np.cos(roll) - x * np.sin(roll)) * scale

    def world(a: NDArray, b: NDArray, ahead: float) -> NDArray[np.float64]:
        level = ahead * np.cos(pitch) - b * np.sin(pitch)
        z = ahead * np.sin(pitch) + b * np.cos(pitch)
        return np.stack(
            [a * np.cos(heading) + level * np.sin(heading), level * np.cos(heading) - a * np.sin(heading), z], axis=-1
        )

    if camera.orthographic:
        return world(right, up, 0.0), world(0 * right, 0 * up, 1.0)
    return np.zeros((height, width, 3)), world(right, up, 1.0)


def _fill(heights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    valid = np.isfinite(heights)
    filled = np.where(valid, heights, 0.0)
    for j, i in np.argwhere(~valid):
        window = np.s_[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2]
        if valid[window].any():
            filled[j, i] = heights[window][valid[window]].mean()
    return filled, valid.astype(np.float64)


def _walk(
    frame: Frame,
    values: NDArray[np.float64],
    valid: NDArray[np.float64],
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
) -> NDArray[np.float64]:
    rows, columns = values.shape
    to_texel = np.linalg.inv(frame.grid.metres)
    eye = np.array([float(v) for v in frame.grid.to_texel(frame.camera.x, frame.camera.y)])
    # sample coordinates: sample (i, j) lies at (i, j)
    start = origin[:, :2] @ to_texel.T + eye - 0.5
    step = direction[:, :2] @ to_texel.T
    bend = 0.5 / 6371008.8 if frame.curvature else 0.0
    # height of the ray in data metres: c0 + c1 t + c2 t^2
    c0 = (origin[:, 2] + frame.camera.z + bend * (origin[:, :2] ** 2).sum(1)) / frame.exaggeration
    c1 = (direction[:, 2] + 2 * bend * (origin[:, :2] * direction[:, :2]).sum(1)) / frame.exaggeration
    c2 = bend * (direction[:, :2] ** 2).sum(1) / frame.exaggeration

    with np.errstate(divide="ignore", invalid="ignore"):
        bounds = np.stack(
            [(np.array([0.0, 0.0]) - start) / step, (np.array([columns - 1.0, rows - 1.0]) - start) / step]
        )
    still = step == 0
    within = (start >= 0) & (start <= [columns - 1, rows - 1])
    low = np.where(still, np.where(within, -np.inf, np.inf), bounds.min(0)).max(1)
    high = np.where(still, np.where(within, np.inf, -np.inf), bounds.max(0)).min(1)
    t = low if frame.camera.orthographic else np.maximum(low, 0.0)
    if not frame.curvature:
        # nothing is above the highest sample: start where the ray comes down to it, end where it rises past it
        with np.errstate(divide="ignore", invalid="ignore"):
            top = (values.max() + 1.0 - c0) / c1
        t = np.where((c1 < 0) & np.isfinite(top), np.fmax(t, top), t)
        high = np.where(c1 > 0, np.fmin(high, top), high)
        high = np.where((c1 == 0) & (c0 > values.max() + 1.0), -np.inf, high)
    alive = np.nonzero(high >= t)[0]
    hit = np.full(len(origin), np.nan)
    # a ray straight down in an orthographic picture stays in one cell for ever
    t = np.where(np.isfinite(t), t, 0.0)
    at = start + step * t[:, None]
    cell = np.clip(np.floor(at), 0, [columns - 2, rows - 2]).astype(np.int64)
    forward = np.where(step > 0, 1, -1)
    for _ in range(2 * (rows + columns)):
        if not alive.size:
            return hit
        c, s, d = cell[alive], start[alive], step[alive]
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = np.where(d == 0, np.inf, (c + (d > 0) - s) / d)
        leave = walls.min(1)
        inside = _patch(values, valid, c, s, d, c0[alive], c1[alive], c2[alive], t[alive], leave)
        hit[alive] = inside
        axis = walls.argmin(1)
        cell[alive, axis] += forward[alive, axis]
        t[alive] = np.maximum(t[alive], np.where(np.isfinite(leave), leave, t[alive]))
        c = cell[alive]
        on = (c >= 0).all(1) & (c[:, 0] <= columns - 2) & (c[:, 1] <= rows - 2) & np.isnan(inside) & np.isfinite(leave)
        alive = alive[on]
    raise AssertionError("a ray did not leave the raster")


def _patch(values, valid, cell, start, step, c0, c1, c2, enter, leave):  # type: ignore[no-untyped-def]
    i, j = cell[:, 0], cell[:, 1]
    corners = [(v[j, i], v[j, i + 1], v[j + 1, i], v[j + 1, i + 1]) for v in (values, valid)]
    (a, b, c, d), mask = corners
    x, y, dx, dy = start[:, 0] - i, start[:, 1] - j, step[:, 0], step[:, 1]
    sx, sy, twist = b - a, c - a, a - b - c + d
    # ray height minus patch height, from the cell's own entry so that large t cost no digits
    base = np.where(np.isfinite(enter), enter, 0.0)
    x, y = x + dx * base, y + dy * base
    q0 = c0 + c1 * base + c2 * base**2 - (a + sx * x + sy * y + twist * x * y)
    q1 = c1 + 2 * c2 * base - (sx * dx + sy * dy + twist * (x * dy + y * dx))
    q2 = c2 - twist * dx * dy
    span = leave - base
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(q1 * q1 - 4 * q2 * q0)
        q = -0.5 * (q1 + np.where(q1 < 0, -root, root))
        roots = np.sort(np.stack([q / q2, q0 / q]), axis=0)
    result = np.full(len(i), np.nan)
    endless = ~np.isfinite(enter) | ((dx == 0) & (dy == 0))
    slack = np.where(np.isfinite(span), 1e-12 * (np.abs(base) + np.abs(span)), 0.0)
    for t in np.where(np.isfinite(roots), roots, np.nan)[::-1]:
        u, w = np.clip(x + dx * t, 0, 1), np.clip(y + dy * t, 0, 1)
        covered = (mask[0] * (1 - u) + mask[1] * u) * (1 - w) + (mask[2] * (1 - u) + mask[3] * u) * w >= 0.5
        good = np.isfinite(t) & covered & (endless | ((t >= -slack) & (t <= span + slack)))
        result = np.where(good, base + t, result)
    return result
