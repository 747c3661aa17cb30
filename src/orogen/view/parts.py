"""Pictures larger than the GPU can hold, drawn in parts: every part of the same geometry, so that no seam shows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.frame import Frame, check_size
from orogen.gpu import Gpu

LARGEST, MOST_PIXELS = 65535, 1 << 29
"""Pixels of a side and of a whole picture at most: 8 bytes of each are held in the machine's memory."""
PIXEL_BYTES = 52
"""GPU memory that a pixel takes while it is drawn: surface, visibility, sums of samples, picture and what is read."""
LIGHT_BYTES = 16
"""The largest buffer's share of it."""
SMALLEST = 256
"""Pixels of the longer side of a part at least."""


@dataclass(frozen=True)
class Part:
    """A part of a picture; those at the right and lower edge may reach beyond it."""

    frame: Frame
    """What is drawn: geometry is chosen for the whole picture."""
    seen: Frame
    """The same as a picture of its own: it needs no data but those that it shows."""
    column: int
    """Column of the whole picture at which it begins."""
    row: int
    """Row of the whole picture at which it begins."""


def check_picture_size(size: tuple[int, int]) -> None:
    """Raise SettingsError unless a picture can have so many pixels (width, height)."""
    check_size(size)
    width, height = size
    if max(size) > LARGEST or width * height > MOST_PIXELS:
        raise SettingsError(
            f"size: expected at most {LARGEST} pixels on each side and {MOST_PIXELS // 10**6} million in all, "
            f"got {width}x{height}"
        )


def divisions(size: tuple[int, int], gpu: Gpu, held: int = 0) -> int:
    """Into how many columns, and as many rows, a picture of (width, height) pixels is to be divided.

    `held`: bytes of GPU memory that are given back before it is drawn.
    """
    longest = max(size)
    limits, free = gpu.limits, gpu.memory.free
    most = min(limits["max-storage-buffer-binding-size"], limits["max-buffer-size"]) // LIGHT_BYTES
    if free is not None:
        most = min(most, (free + held) // PIXEL_BYTES)
    count = math.ceil(longest / limits["max-texture-dimension-2d"])
    while math.prod(part_size(size, count)) > most and longest / (count + 1) >= SMALLEST:
        count += 1
    return count


def part_size(size: tuple[int, int], count: int) -> tuple[int, int]:
    """Width and height in pixels of the parts of a picture."""
    return math.ceil(size[0] / count), math.ceil(size[1] / count)


def parts(whole: Frame, count: int) -> Iterator[Part]:
    """The parts of a picture, row by row, `count` by `count` of them and all of one size."""
    width, height = part_size(whole.size, count)
    # the whole with what the last parts reach beyond it: geometry is chosen and culled for it
    chosen = whole.lod_camera or _of_height(whole.camera, height * count / whole.size[1])
    camera = _of_height(whole.camera, height / whole.size[1])
    for row in range(0, height * count, height):
        for column in range(0, width * count, width):
            away = column + (width - whole.size[0]) / 2, row + (height - whole.size[1]) / 2
            seen = replace(whole, camera=camera, size=(width, height), jitter=away)
            yield Part(replace(seen, lod_camera=chosen, coarseness=whole.coarseness / count), seen, column, row)


def _of_height(camera: Camera, factor: float) -> Camera:
    """The camera of a picture so many times as high, with pixels of the same size."""
    if camera.orthographic:
        return camera.moved(orthographic=camera.orthographic * factor)
    half = math.tan(math.radians(camera.fov) / 2) * factor
    return camera.moved(fov=math.degrees(2 * math.atan(half)))
