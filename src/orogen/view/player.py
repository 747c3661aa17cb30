"""Flights in a window: played as time goes on, or written as a video one frame after the other."""

from __future__ import annotations

import os
from collections.abc import Generator
from dataclasses import replace

from orogen.camera import Camera
from orogen.shading.style import Style
from orogen.view.flight import FlightPath
from orogen.view.renderer import Renderer, Scene
from orogen.view.video import VideoWriter


class Player:
    """Plays a flight in real time."""

    def __init__(self, path: FlightPath, now: float) -> None:
        """`now`: seconds of the clock that `camera` is asked with."""
        self._path, self._start = path, now

    def camera(self, now: float) -> Camera | None:
        """The camera at a time of the clock; None when the flight is over."""
        t = now - self._start
        return self._path.camera_at(t) if t <= self._path.duration else None


class Exporter:
    """Writes a flight as a video, a frame at each `step`, so that a window goes on meanwhile."""

    def __init__(
        self,
        renderer: Renderer,
        path: FlightPath,
        output: str | os.PathLike[str],
        size: tuple[int, int],
        fps: float,
        style: Style,
        scene: Scene,
        samples: int = 4,
    ) -> None:
        """Checks everything before the first frame; raises SettingsError and OutputError as `VideoWriter` does."""
        self.done = 0.0
        """Part of the frames that is written."""
        self.camera: Camera | None = None
        """The latest frame's."""
        count = path.frame_count(fps)
        writer = VideoWriter(output, size, fps)

        def work() -> Generator[None, None, None]:
            with writer:
                for number, (t, camera) in enumerate(path.frames(fps), start=1):
                    sun = path.sun_at(t)
                    look = style if sun is None else replace(style, sun=sun)
                    writer.write(renderer.render(camera, size, look, scene, samples=samples).color)
                    self.done, self.camera = number / count, camera
                    yield

        self._work = work()

    def step(self) -> bool:
        """Write the next frame; says whether there are more."""
        return next(self._work, self) is None  # else the end stands there

    def cancel(self) -> None:
        """Stop, and leave no file."""
        self._work.close()
