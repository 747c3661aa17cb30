"""How finely pictures are sent: as the time from sending to showing says."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WANTED = 0.1
"""Seconds that a picture may take on its way, beyond those that the distance takes."""
SPARE = 0.4
"""Finer pictures are tried where they take less than this part of that."""
CALM = 8
"""Pictures in a row that must be quick before finer ones are tried."""


@dataclass(frozen=True)
class Fineness:
    """How a picture is encoded."""

    quality: int
    """Of the JPEG, 1 to 95."""
    scale: float
    """Part of the width and height."""


LADDER = (
    Fineness(85, 1.0), Fineness(72, 1.0), Fineness(58, 1.0), Fineness(50, 0.71), Fineness(42, 0.5), Fineness(35, 0.35),
    Fineness(30, 0.25),
)  # fmt: skip
"""From fine to coarse: each takes about 0.7 times the bytes of the one before it, or less."""
BEST = Fineness(92, 1.0)
"""Of a picture at rest."""


class Pace:
    """Chooses the fineness of one page's pictures. Used by one thread."""

    def __init__(self) -> None:
        self._step = 0
        self._quick = 0
        self.distance = 0.0
        """Seconds that the smallest message takes there and back, which no fineness changes."""

    @property
    def fineness(self) -> Fineness:
        """Of the next picture while things move."""
        return LADDER[self._step]

    def took(self, seconds: float) -> None:
        """Learn how long a moving picture was on its way, from sending to showing."""
        beyond = seconds - self.distance
        if beyond > WANTED:
            steps = 2 if beyond > 4 * WANTED else 1
            self._step, self._quick = min(self._step + steps, len(LADDER) - 1), 0
            return
        self._quick = self._quick + 1 if beyond < SPARE * WANTED else 0
        if self._quick >= CALM and self._step:
            self._step, self._quick = self._step - 1, 0


def encode(picture: NDArray[np.uint8], fineness: Fineness) -> bytes:
    """A JPEG of a (height, width, 4) picture, without its alpha."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(picture[..., :3]))
    if fineness.scale < 1:
        size = (max(1, round(v * fineness.scale)) for v in image.size)
        image = image.resize(tuple(size), Image.Resampling.BILINEAR, reducing_gap=1.0)  # type: ignore[arg-type]
    file = io.BytesIO()
    # text and lines of the panel need colour at every pixel; moving pictures do not
    image.save(file, "JPEG", quality=fineness.quality, subsampling=0 if fineness == BEST else 2)
    return file.getvalue()
