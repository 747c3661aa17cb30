"""What lies over the picture: scale bar, north arrow, place under the pointer, lines on the ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.frame import Frame

SCALE_WIDTH = 160.0
"""Greatest length of the scale bar in logical pixels."""
WHITE, BLACK, YELLOW, CYAN = 0xFFFFFFFF, 0xB0000000, 0xFF35D9FF, 0xFFFFD84A
"""Colours as imgui packs them: alpha, blue, green, red."""
SHADE = 0xE814100C
"""Behind text."""


def nice_length(longest: float) -> float:
    """The greatest of 1, 2, 5, 10, 20 ... (of any power of ten) that is not above `longest`."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= longest * (1 + 1e-9))


def nice_text(metres: float) -> str:
    """What a nice length is called, without zeros that say nothing."""
    return f"{metres / 1000:,g} km" if metres >= 1000 else f"{metres:g} m"


def metres_per_pixel(frame: Frame, camera: Camera, depth: float) -> float:
    """Metres across that a picture's pixel shows at a view depth in metres."""
    if camera.orthographic:
        return camera.orthographic / frame.size[1]
    return 2 * depth * math.tan(math.radians(camera.fov) / 2) / frame.size[1]


def projected(frame: Frame, points: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.float64]:
    """(n, 3): logical pixels (x right, y down) and view depth of (n, 3) points x, y in the data's CRS and height (m).

    `size`: width and height of the picture in logical pixels. Behind the camera the depth is below 0.
    """
    camera, scale = frame.camera, frame.grid.ground_scale
    offset = np.stack(
        [
            (points[:, 0] - camera.x) * scale[0],
            (points[:, 1] - camera.y) * scale[1],
            points[:, 2] * frame.exaggeration - camera.z,
        ],
        axis=1,
    )  # fmt: skip
    right, up, forward = camera.basis
    depth = offset @ forward
    half_x, half_y = frame.half_extent
    away = np.ones_like(depth) if camera.orthographic else np.where(np.abs(depth) > 1e-9, depth, 1e-9)
    x = (offset @ right / away / half_x + 1) / 2 * size[0]
    y = (1 - offset @ up / away / half_y) / 2 * size[1]
    return np.stack([x, y, depth], axis=1)


def draw_line(
    painter: Any, frame: Frame, points: NDArray[np.float64], size: tuple[float, float], color: int, width: float = 2.0
) -> None:
    """A line on the ground through (n, 3) points x, y, height, with a dark rim so that it shows on any colour."""
    at = projected(frame, points, size)
    ahead = at[:, 2] > 0 if not frame.camera.orthographic else np.ones(len(at), bool)
    near = (np.abs(at[:, :2]) < 1e5).all(axis=1) & ahead
    for rim, shade in ((width + 2, BLACK), (width, color)):
        for i in range(len(at) - 1):
            if near[i] and near[i + 1]:
                painter.add_line(tuple(at[i, :2]), tuple(at[i + 1, :2]), shade, rim)


def draw_points(painter: Any, frame: Frame, points: NDArray[np.float64], size: tuple[float, float], color: int) -> None:
    """Dots at (n, 3) points x, y, height."""
    for x, y, depth in projected(frame, points, size).tolist():
        if (depth > 0 or frame.camera.orthographic) and abs(x) < 1e5 and abs(y) < 1e5:
            painter.add_circle_filled((x, y), 6.0, BLACK)
            painter.add_circle_filled((x, y), 4.5, color)


def draw_text(painter: Any, imgui: Any, x: float, y: float, text: str, align: float = 0.0) -> None:
    """Text on a dark ground; `align`: 0 begins at x, 1 ends there."""
    size = imgui.calc_text_size(text)
    x -= align * size.x
    painter.add_rect_filled((x - 6, y - 3), (x + size.x + 6, y + size.y + 3), SHADE, 4.0)
    painter.add_text((x, y), WHITE, text)


def draw_scale(painter: Any, imgui: Any, x: float, y: float, text: str, width: float) -> None:
    """A bar of `width` logical pixels, from x to the right, that stands for a length."""
    painter.add_rect_filled((x - 6, y - 24), (x + max(width, 40) + 6, y + 7), SHADE, 4.0)
    for start, end in (((x, y), (x + width, y)), ((x, y - 5), (x, y + 1)), ((x + width, y - 5), (x + width, y + 1))):
        painter.add_line(start, end, WHITE, 2.0)
    painter.add_text((x + 2, y - 21), WHITE, text)


def draw_north(painter: Any, imgui: Any, x: float, y: float, angle: float, radius: float = 22.0) -> None:
    """An arrow to the north; `angle`: degrees clockwise from up."""
    a = math.radians(angle)
    ahead, aside = np.array([math.sin(a), -math.cos(a)]), np.array([math.cos(a), math.sin(a)])
    middle = np.array([x, y])
    painter.add_circle_filled((x, y), radius + 4, SHADE)
    tip, notch = middle + ahead * radius * 0.45, middle - ahead * radius * 0.35
    for side, color in ((1.0, 0xFF4A4AF0), (-1.0, 0xFFE0E0E8)):
        wing = middle - ahead * radius * 0.7 + side * aside * radius * 0.42
        painter.add_triangle_filled(tuple(tip), tuple(wing), tuple(notch), color)
    size = imgui.calc_text_size("N")
    at = middle + ahead * (radius * 0.45 + 8)
    painter.add_text((at[0] - size.x / 2, at[1] - size.y / 2), WHITE, "N")


def frustum_lines(camera: Camera, frame: Frame, far: float) -> list[NDArray[np.float64]]:
    """Lines (2, 3) of x, y, height (m of the data) along the edges of what a perspective camera sees up to `far` m."""
    right, up, forward = camera.basis
    half_x, half_y = frame.size[0] / frame.size[1], 1.0
    tangent = math.tan(math.radians(camera.fov) / 2)
    corners = [
        far * (forward + tangent * (sx * half_x * right + sy * half_y * up))
        for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    eye = _placed(camera, frame, np.zeros(3))
    ends = [_placed(camera, frame, corner) for corner in corners]
    return [np.array([eye, end]) for end in ends] + [np.array([ends[i], ends[(i + 1) % 4]]) for i in range(4)]


def _placed(camera: Camera, frame: Frame, step: NDArray[np.float64]) -> tuple[float, float, float]:
    scale = frame.grid.ground_scale
    return (
        camera.x + float(step[0]) / scale[0],
        camera.y + float(step[1]) / scale[1],
        (camera.z + float(step[2])) / frame.exaggeration,
    )


def subdivided(line: NDArray[np.float64], count: int = 48) -> NDArray[np.float64]:
    """A polyline with `count` times as many pieces, so that those behind the eye can be left out."""
    where = np.linspace(0, len(line) - 1, count * (len(line) - 1) + 1)
    return np.stack([np.interp(where, np.arange(len(line)), line[:, axis]) for axis in range(line.shape[1])], axis=1)


def legend_colors(count: int = 32) -> Sequence[int]:
    """Colours of the difference from the lowest to the highest, as split.wgsl has them, packed for imgui."""
    cold, warm, middle = np.array([0.02, 0.19, 0.59]), np.array([0.62, 0.05, 0.04]), np.full(3, 0.9)
    result = []
    for t in np.linspace(-1, 1, count):
        linear = middle + ((warm if t >= 0 else cold) - middle) * abs(t)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        r, g, b = (int(v) for v in np.round(255 * encoded))
        result.append(0xFF000000 | b << 16 | g << 8 | r)
    return result
