"""Controls that go through the air or on foot."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from orogen.camera import Camera
from orogen.view.controls import (
    DEGREES_PER_HEIGHT,
    LONGEST_STEP,
    ZOOM_STEP,
    Controls,
    Event,
    Ground,
    Vector,
    part_of,
)  # fmt: skip

WALKER = 1.7
"""Height of a walker's eyes over the ground (m)."""


class FlyControls(Controls):
    """Through the air: W, A, S, D forwards, left, back and right, E up and Q down, faster with Shift and the higher
    above the ground; drag to look around, wheel to change the speed, N for north, Home to go back to the start.
    """

    AXES: ClassVar[dict[str, tuple[int, int]]] = {
        "d": (0, 1), "a": (0, -1), "e": (1, 1), "q": (1, -1), "w": (2, 1), "s": (2, -1)
    }  # fmt: skip
    """Axis (right, up, forward) and sign of the movement keys."""

    def __init__(self, camera: Camera, ground: Ground, size: tuple[float, float], pixel_ratio: float = 1.0) -> None:
        super().__init__(camera, ground, size, pixel_ratio)
        self.speed = 1.0
        """Speed in heights over the ground a second."""
        self._keys: set[str] = set()
        self._last: tuple[float, float] | None = None
        self._velocity = np.zeros(3)  # in heights over the ground a second: right, up, forward

    @property
    def moving(self) -> bool:
        """Whether a key is held or the camera still glides."""
        return super().moving or bool(self._keys & self.AXES.keys()) or bool(self._velocity.any())

    def handle(self, event: Event) -> bool:
        """Take an event; says whether it meant something."""
        if super().handle(event):
            return True
        kind = event["event_type"]
        if kind in ("key_down", "key_up"):
            key = event["key"] if event["key"] == "Shift" else event["key"].lower()
            if key != "Shift" and key not in self.AXES:
                return False
            (self._keys.add if kind == "key_down" else self._keys.discard)(key)
        elif kind == "pointer_down":
            self._last = event["x"], event["y"]
            self._to_north = False
        elif kind == "pointer_move" and self._last:
            per_pixel = DEGREES_PER_HEIGHT / max(self.size[1], 1.0)
            dx, dy = event["x"] - self._last[0], event["y"] - self._last[1]
            self._last = event["x"], event["y"]
            self._turn(dx * per_pixel, -dy * per_pixel, np.zeros(3))
        elif kind == "pointer_up":
            self._last = None
        elif kind == "wheel":
            self.speed = min(max(self.speed * math.exp(-event["dy"] / 100 * ZOOM_STEP), 0.05), 20.0)
        else:
            return False
        return True

    def advance(self, dt: float) -> Camera:
        """Let `dt` seconds pass: fly on."""
        super().advance(dt)
        dt = min(dt, LONGEST_STEP)
        wanted = np.zeros(3)
        for key in self._keys & self.AXES.keys():
            axis, sign = self.AXES[key]
            wanted[axis] += sign * self.speed * (4 if "Shift" in self._keys else 1)
        self._velocity += (wanted - self._velocity) * part_of(dt)
        if not wanted.any() and np.abs(self._velocity).max() < 1e-3:
            self._velocity[:] = 0
        if self._velocity.any():
            self._goal = None
            self._move(self._velocity * self._unit() * dt)
        return self.camera

    def _move(self, steps: Vector) -> None:
        """Go so many metres to the right, up and forward."""
        right, _, forward = self.camera.basis
        self._step(steps[0] * right + steps[2] * forward + np.array([0.0, 0.0, steps[1]]))

    def _unit(self) -> float:
        """Metres that speeds count in: the height over the ground."""
        return max(self.camera.z - self._level(self.camera), 5 * self.ground.clearance)


class WalkControls(FlyControls):
    """On foot: as `FlyControls`, but the eyes stay at a walker's height over the ground; Shift runs."""

    def __init__(self, camera: Camera, ground: Ground, size: tuple[float, float], pixel_ratio: float = 1.0) -> None:
        super().__init__(camera, ground, size, pixel_ratio)
        self._land()

    def _move(self, steps: Vector) -> None:
        right, _, _ = self.camera.basis
        ahead = np.array([-right[1], right[0], 0.0])  # level, wherever the walker looks
        self._step(steps[0] * right + steps[2] * ahead)

    def _unit(self) -> float:
        """A brisk five metres a second, more where samples are far apart."""
        return max(5.0, 0.5 * self.ground.grid.spacing)

    def _place(self, camera: Camera) -> None:
        super()._place(camera)
        self._land()

    def _land(self) -> None:
        ground = self.ground.drawn_height(self.camera.x, self.camera.y)
        if math.isfinite(ground):
            self.camera = self.camera.moved(z=ground + WALKER)
