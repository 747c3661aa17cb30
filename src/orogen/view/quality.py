"""Keeps a frame time: moving pictures get coarser where the hardware needs it, and smoother where it has time left."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from orogen.errors import SettingsError
from orogen.lod.contract import Algorithm

STEPS = (1.0, 0.84, 0.71, 0.59, 0.5, 0.42, 0.35, 0.3, 0.25)
"""Parts of the window's width and height that a picture may have: each costs about 0.7 times the one before it."""
DETAILS = (*STEPS, 0.21, 0.18, 0.15, 0.125)
"""Parts of what is set that the detail of geometry may have: triangles of so much longer edges, 0.7 times as many."""
SAMPLES = (1, 2, 4, 8)
"""Samples per pixel that a moving picture may have: what is thinner than a pixel shimmers less. Each costs twice."""
SPARE = 0.6
"""A finer step is taken where the frame time is below this part of the target: it must not be over it then."""
HASTE, CALM = 3, 12
"""Frames after which a coarser and a finer step is taken at the earliest: the GPU's times become known frames later."""
PIXEL_PASSES = ("shade", "resolve", "rays")
"""Passes of the GPU whose time goes with the number of pixels; that of all others goes with the triangles."""


@dataclass(frozen=True)
class QualitySettings:
    """What is more important in a moving picture: that it is fine, or that it is quick."""

    adaptive: bool = True
    """Draw coarser pictures while the camera moves, where the frame time asks for it. At rest all are fine."""
    frame_time: float = 33.0
    """Frame time that is kept while the camera moves in milliseconds, from 4 to 200."""
    coarsest: float = 0.25
    """Least part of the window's width and height, from 0.25 to 1."""
    coarsest_detail: float = 0.25
    """Least part of the algorithm's detail, from 0.125 to 1: half of it are triangles with edges twice as long."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.frame_time) and 4 <= self.frame_time <= 200):
            raise SettingsError(f"frame_time: expected 4 to 200 milliseconds, got {self.frame_time:g}")
        for name, least in (("coarsest", STEPS[-1]), ("coarsest_detail", DETAILS[-1])):
            if not least <= getattr(self, name) <= 1:
                raise SettingsError(f"{name}: expected {least:g} to 1, got {getattr(self, name):g}")


class Quality:
    """The scale of a moving picture and the detail of its geometry, from the times that frames took."""

    def __init__(self, settings: QualitySettings | None = None) -> None:
        self.settings = settings or QualitySettings()
        self._step = self._detail = self._smooth = 0
        self._frames = 0

    @property
    def scale(self) -> float:
        """Part of the window's width and height that the next moving picture is to have."""
        return max(STEPS[self._step], self.settings.coarsest) if self.settings.adaptive else 1.0

    @property
    def detail(self) -> float:
        """Part of the algorithm's detail that the next moving picture is to have."""
        return max(DETAILS[self._detail], self.settings.coarsest_detail) if self.settings.adaptive else 1.0

    @property
    def samples(self) -> int:
        """Samples per pixel that the next moving picture is to have."""
        return SAMPLES[self._smooth] if self.settings.adaptive else 1

    def size(self, window: tuple[int, int], moving: bool) -> tuple[int, int]:
        """Width and height in pixels of the next picture in a window of so many."""
        scale = self.scale if moving else 1.0
        return max(1, round(window[0] * scale)), max(1, round(window[1] * scale))

    def took(self, interval: float, work: float, geometry: float = 0.0, least_detail: float = 1.0) -> None:
        """Learn from a moving frame.

        `interval`: milliseconds since the frame before it, which the screen's rate bounds from below; `work`: what CPU
        or GPU, whichever was longer, spent on it. `geometry`: part of the work, from 0 to 1, that goes with the number
        of triangles. `least_detail`: part of the detail that the algorithm can do with; 1: it has no such setting.
        """
        wanted = self.settings.frame_time
        self._frames += 1
        if interval > 1.1 * wanted and self._frames >= HASTE:
            # as many steps as the cost per pixel says at once: one by one would stutter for a second
            steps = math.ceil(math.log(interval / wanted) / math.log(1.41))
            if self._smooth:
                self._smooth, self._frames = max(0, self._smooth - math.ceil(steps / 2)), 0
                return
            self._coarser(steps, geometry, max(least_detail, self.settings.coarsest_detail))
        elif work < SPARE * wanted and interval <= 1.1 * wanted and self._frames >= CALM:
            self._finer(work, geometry)

    def _coarser(self, steps: int, geometry: float, least_detail: float) -> None:
        """Save where more time goes, as long as there is something to save."""
        fewer_triangles = DETAILS[self._detail] > least_detail
        fewer_pixels = STEPS[self._step] > self.settings.coarsest
        if fewer_triangles and (geometry > 0.5 or not fewer_pixels):
            self._detail = min(self._detail + steps, len(DETAILS) - 1)
        elif fewer_pixels:
            self._step = min(self._step + steps, len(STEPS) - 1)
        else:
            return
        self._frames = 0

    def _finer(self, work: float, geometry: float) -> None:
        """Spend where less time goes; what is left then makes pictures smooth."""
        if self._detail and (geometry <= 0.5 or not self._step):
            self._detail -= 1
        elif self._step:
            self._step -= 1
        elif work < SPARE / 1.41 * self.settings.frame_time and self._smooth < len(SAMPLES) - 1:
            self._smooth += 1
        else:
            return
        self._frames = 0


def least_detail(algorithm: Algorithm) -> float:
    """Part of its detail with which an algorithm, set as it is, is at the coarse end of what makes sense; at most 1."""
    found = algorithm.detail
    value = getattr(algorithm.settings, found.setting) if found else None
    if found is None or value is None:
        return 1.0
    upwards = found.coarsest > found.finest
    return min(1.0, value / found.coarsest if upwards else found.coarsest / value)


def geometry_share(passes: Mapping[str, float], work: float) -> float:
    """Part of a frame's milliseconds of work, from 0 to 1, that does not go with the number of pixels.

    `passes`: GPU milliseconds by pass. Half where they are unknown.
    """
    if not passes or not work > 0:
        return 0.5
    return min(max(1 - sum(passes.get(name, 0.0) for name in PIXEL_PASSES) / work, 0.0), 1.0)
