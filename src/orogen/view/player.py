"""Flights in a window: played as time goes on, or written as a video one frame after the other."""

from __future__ import annotations

import math
import os
from collections.abc import Generator
from dataclasses import dataclass, replace

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.shading.style import Style
from orogen.view.flight import FlightPath
from orogen.view.renderer import Renderer, Scene
from orogen.view.video import QUALITIES, VideoWriter

MOST_FPS = 240.0
"""Frames a second of a video, at most."""


class Player:
    """Plays a flight in real time."""

    def __init__(self, path: FlightPath, now: float) -> None:
        """`now`: seconds of the clock that `camera` is asked with."""
        self._path, self._start = path, now

    def camera(self, now: float) -> Camera | None:
        """The camera at a time of the clock; None when the flight is over."""
        t = now - self._start
        return self._path.camera_at(t) if t <= self._path.duration else None


@dataclass(frozen=True)
class VideoSettings:
    """What a flight's video is like."""

    size: tuple[int, int] = (1280, 720)
    """Width and height in pixels."""
    fps: float = 30.0
    """Frames a second, from 1 to 240."""
    quality: str = "high"
    """high: as good as what is drawn; medium, low: files of about a half and a quarter of that size."""
    samples: int = 4
    """Samples per pixel, which smooth edges, from 1 to 64."""

    def __post_init__(self) -> None:
        if min(self.size) < 1:
            raise SettingsError(f"size: expected at least 1x1 pixels, got {self.size[0]}x{self.size[1]}")
        if not (math.isfinite(self.fps) and 1 <= self.fps <= MOST_FPS):
            raise SettingsError(f"fps: expected 1 to {MOST_FPS:g} frames a second, got {self.fps:g}")
        if self.quality not in QUALITIES:
            raise SettingsError(f"quality: expected one of {', '.join(QUALITIES)}, got {self.quality!r}")
        if not 1 <= self.samples <= 64:
            raise SettingsError(f"samples: expected 1 to 64 per pixel, got {self.samples}")


class Exporter:
    """Writes a flight as a video, a frame at each `step`, so that a window goes on meanwhile."""

    def __init__(
        self,
        renderer: Renderer,
        path: FlightPath,
        output: str | os.PathLike[str],
        video: VideoSettings,
        style: Style,
        scene: Scene,
    ) -> None:
        """Checks everything before the first frame; raises SettingsError and OutputError as `VideoWriter` does."""
        self.done = 0.0
        """Part of the frames that is written."""
        self.camera: Camera | None = None
        """The latest frame's."""
        count = path.frame_count(video.fps)
        writer = VideoWriter(output, video.size, video.fps, quality=video.quality)

        def work() -> Generator[None, None, None]:
            with writer:
                for number, (t, camera) in enumerate(path.frames(video.fps), start=1):
                    sun = path.sun_at(t)
                    look = style if sun is None else replace(style, sun=sun)
                    writer.write(renderer.render(camera, video.size, look, scene, samples=video.samples).color)
                    self.done, self.camera = number / count, camera
                    yield

        self._work = work()

    def step(self) -> bool:
        """Write the next frame; says whether there are more."""
        return next(self._work, self) is None  # else the end stands there

    def cancel(self) -> None:
        """Stop, and leave no file."""
        self._work.close()
