"""The frames of a flight that are measured, checked against the data that is flown over."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import Grid
from orogen.view.flight import FlightPath

UNDERGROUND = 0.01
"""Metres that a camera may be under the ground: rounding."""


@dataclass(frozen=True)
class Shot:
    """One frame of a flight."""

    number: int
    """Counts all frames of the flight, from 0."""
    time: float
    """Seconds from the start."""
    camera: Camera
    """Where it is seen from."""
    sun: tuple[float, float] | None = None
    """Azimuth and elevation of the sun, where the flight gives them."""


@dataclass(frozen=True)
class Reel:
    """A flight over data, frame by frame."""

    path: FlightPath
    """The flight."""
    fps: float
    """Frames per second."""

    @property
    def count(self) -> int:
        """Number of frames."""
        return self.path.frame_count(self.fps)

    def shot(self, number: int) -> Shot:
        """A frame of the flight, from 0."""
        time = number / self.fps
        return Shot(number, time, self.path.camera_at(time), self.path.sun_at(time))

    def numbers(self, frames: int | None, every: int | None) -> list[int]:
        """The frames that are measured: so many evenly from the first to the last, or every so many."""
        if every is not None:
            return list(range(0, self.count, every))
        count = min(frames or 1, self.count)
        return np.unique(np.rint(np.linspace(0, self.count - 1, count)).astype(int)).tolist()

    def before(self, number: int, count: int) -> list[int]:
        """The up to `count` frames right before one, none of them on the other side of a cut."""
        cuts = [math.ceil(cut * self.fps - 1e-9) for cut in self.path.cuts]
        start = max([cut for cut in cuts if cut <= number], default=0)
        return list(range(max(start, number - count), number))

    def check(
        self,
        size: tuple[int, int],
        height_range: tuple[float, float],
        height_at: Callable[[float, float], float],
        exaggeration: float = 1.0,
        curvature: bool = False,
    ) -> None:
        """Raise SettingsError, naming the flight and the time, where it shows nothing of the data or is underground.

        `height_range` and `height_at`: of the data in metres, before exaggeration; NaN where there is none.
        """
        grid = self.path.grid
        name = self.path.flight.name or "the flight"
        for shot in map(self.shot, range(self.count)):
            camera = shot.camera
            frame = Frame(camera, grid, size, height_range=height_range, exaggeration=exaggeration, curvature=curvature)
            if not _shows(frame):
                x, y = camera.x, camera.y
                raise SettingsError(
                    f"{name}: outside the data: at {shot.time:g} s the camera at ({x:.10g}, {y:.10g}) shows nothing of "
                    f"it; the data spans {_span(grid)}, the flight {_flown(self)}"
                )
            ground = height_at(camera.x, camera.y) * exaggeration
            if camera.z < ground - UNDERGROUND:
                raise SettingsError(
                    f"{name}: expected a camera above the ground, got one {ground - camera.z:.1f} m below it at "
                    f"{shot.time:g} s; was it made for other data, or another exaggeration?"
                )


def _shows(frame: Frame) -> bool:
    """Whether the data's box may be in the picture, the camera being no farther from it than it is wide."""
    grid = frame.grid
    corners = np.array([(0, 0), (grid.width, 0), (0, grid.height), (grid.width, grid.height)], np.float64)
    flat = (corners - frame.eye) @ grid.metres.T
    wide = np.ptp(flat, axis=0)
    if np.any(flat.min(axis=0) > wide) or np.any(flat.max(axis=0) < -wide):
        return False
    low, high = (height * frame.exaggeration - frame.camera.z for height in frame.height_range)
    low -= frame.curvature_factor * float((flat**2).sum(axis=1).max())
    box = np.array([(e, n, up, 1.0) for e, n in flat for up in (low, high)])
    return not np.any((box @ frame.planes().T < 0).all(axis=0))


def _span(grid: Grid) -> str:
    left, bottom, right, top = grid.bounds
    return f"x {left:.10g} to {right:.10g}, y {bottom:.10g} to {top:.10g}"


def _flown(reel: Reel) -> str:
    cameras = [reel.shot(number).camera for number in range(reel.count)]
    x, y = [camera.x for camera in cameras], [camera.y for camera in cameras]
    return f"x {min(x):.10g} to {max(x):.10g}, y {min(y):.10g} to {max(y):.10g}"
