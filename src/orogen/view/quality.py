"""Keeps a frame time: pictures get coarser while the camera moves, as far as the hardware needs it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from orogen.errors import SettingsError

STEPS = (1.0, 0.84, 0.71, 0.59, 0.5, 0.42, 0.35, 0.3, 0.25)
"""Parts of the window's width and height that a picture may have: each costs about 0.7 times the one before it."""
SPARE = 0.6
"""A finer step is taken where the frame time is below this part of the target: it must not be over it then."""
HASTE, CALM = 3, 12
"""Frames after which a coarser and a finer step is taken at the earliest: the GPU's times become known frames later."""


@dataclass(frozen=True)
class QualitySettings:
    """What is more important in a moving picture: that it is fine, or that it is quick."""

    adaptive: bool = True
    """Draw coarser pictures while the camera moves, where the frame time asks for it. At rest all are fine."""
    frame_time: float = 33.0
    """Frame time that is kept while the camera moves in milliseconds, from 4 to 200."""
    coarsest: float = 0.25
    """Least part of the window's width and height, from 0.25 to 1."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.frame_time) and 4 <= self.frame_time <= 200):
            raise SettingsError(f"frame_time: expected 4 to 200 milliseconds, got {self.frame_time:g}")
        if not STEPS[-1] <= self.coarsest <= 1:
            raise SettingsError(f"coarsest: expected {STEPS[-1]:g} to 1, got {self.coarsest:g}")


class Quality:
    """The scale of a moving picture, from the times that frames took."""

    def __init__(self, settings: QualitySettings | None = None) -> None:
        self.settings = settings or QualitySettings()
        self._step = 0
        self._frames = 0

    @property
    def scale(self) -> float:
        """Part of the window's width and height that the next moving picture is to have."""
        return max(STEPS[self._step], self.settings.coarsest) if self.settings.adaptive else 1.0

    def size(self, window: tuple[int, int], moving: bool) -> tuple[int, int]:
        """Width and height in pixels of the next picture in a window of so many."""
        scale = self.scale if moving else 1.0
        return max(1, round(window[0] * scale)), max(1, round(window[1] * scale))

    def took(self, interval: float, work: float) -> None:
        """Learn from a moving frame.

        `interval`: milliseconds since the frame before it, which the screen's rate bounds from below; `work`: what CPU
        or GPU, whichever was longer, spent on it.
        """
        wanted = self.settings.frame_time
        self._frames += 1
        if interval > 1.1 * wanted and self._frames >= HASTE and STEPS[self._step] > self.settings.coarsest:
            # as many steps as the cost per pixel says at once: one by one would stutter for a second
            steps = math.ceil(math.log(interval / wanted) / math.log(1.41))
            self._step = min(self._step + steps, len(STEPS) - 1)
            self._frames = 0
        elif work < SPARE * wanted and interval <= 1.1 * wanted and self._frames >= CALM and self._step:
            self._step -= 1
            self._frames = 0
