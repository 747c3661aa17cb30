"""What a pointer and keys do to the camera: state machines without a window.

Controls take the event dictionaries of rendercanvas (`event_type`, `x`, `y` in logical pixels from the upper left ...)
and the time that passes, and hold the camera. They know the terrain only through `Ground`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.grid import Grid
from orogen.view.framing import displaced

Event = dict[str, Any]
Vector = NDArray[np.float64]

LEFT, SHIFTING = 1, ("Shift", "Control")
SETTLING = 0.15
"""Time constant (s) of everything that goes on by itself: inertia, zooming, turning north."""
LONGEST_STEP = 0.1
"""Seconds of one step at most: after a stall the camera goes on where it was."""
DEGREES_PER_HEIGHT = 120.0
"""Degrees turned by a drag over the window's height."""
DEGREES_PER_NOTCH = 10.0
"""Degrees turned by a notch (100 units) of the wheel sideways."""
ZOOM_STEP = math.log(1.25)
"""Natural logarithm of the factor on the distance for one notch of the wheel (100 units)."""
REACH = 20.0
"""How far from the data the camera may go, in half diagonals of its extent."""


@dataclass(frozen=True)
class Ground:
    """The terrain as controls see it."""

    grid: Grid
    """The grid of the heights."""
    height_at: Callable[[float, float], float]
    """Height in metres, before exaggeration, at (x, y) in the data's CRS; NaN where there is none. Asked every step."""
    pick: Callable[[int, int], tuple[float, float, float] | None]
    """x, y and height in metres, before exaggeration, of what the last picture shows at a physical pixel
    (column, row); None for the sky."""
    exaggeration: float = 1.0
    """Factor on all heights."""

    @property
    def clearance(self) -> float:
        """Least height of a camera over the ground (m)."""
        return max(2.0, 0.05 * self.grid.spacing)

    @property
    def reach(self) -> float:
        """Largest distance of a camera from the middle of the data (m)."""
        return REACH * float((np.abs(self.grid.metres) @ [self.grid.width, self.grid.height]).sum()) / 2

    def drawn_height(self, x: float, y: float) -> float:
        """Height of the drawn world at (x, y) (m), NaN where there is none."""
        return self.height_at(x, y) * self.exaggeration


class Controls:
    """A camera that reacts: the part that all controls share.

    `size` is (width, height) of the window in logical pixels, `pixel_ratio` physical per logical pixels; both follow
    `resize` events.
    """

    def __init__(self, camera: Camera, ground: Ground, size: tuple[float, float], pixel_ratio: float = 1.0) -> None:
        self.camera = camera
        self.ground = ground
        self.size = size
        self.pixel_ratio = pixel_ratio
        self._home = camera
        self._to_north = False
        self._goal: Camera | None = None

    @property
    def moving(self) -> bool:
        """Whether the camera goes on by itself, so that the next picture has to be drawn without an event."""
        return self._to_north or self._goal is not None

    def go_to(self, camera: Camera) -> None:
        """Move to another camera, smoothly; at once between perspective and parallel projection."""
        self._to_north = False
        if bool(camera.orthographic) != bool(self.camera.orthographic):
            self.camera, self._goal = camera, None
        else:
            self._goal = camera

    def stand_on(self, ground: Ground) -> None:
        """Take another ground, such as one of another exaggeration, and keep above it."""
        self.ground = ground
        self._place(self.camera)

    def handle(self, event: Event) -> bool:
        """Take an event; says whether it meant something, so that a picture has to be drawn."""
        kind = event["event_type"]
        if kind == "resize":
            self.size, self.pixel_ratio = (event["width"], event["height"]), event["pixel_ratio"]
            return True
        if kind == "key_down" and event["key"] in ("n", "N"):
            self._to_north = True
            return True
        if kind == "key_down" and event["key"] == "Home":
            self.go_to(self._home)
            return True
        if kind in ("pointer_down", "wheel", "double_click"):
            self._goal = None  # a hand on the wheel
        return False

    def advance(self, dt: float) -> Camera:
        """Let `dt` seconds pass; gives the camera to draw with."""
        if self._goal:
            self._approach(self._goal, part_of(min(dt, LONGEST_STEP)))
        if self._to_north:
            left = -((self.camera.heading + 180) % 360 - 180)
            self._turn(left if abs(left) < 0.05 else left * part_of(min(dt, LONGEST_STEP)), 0.0, self._north_pivot())
            self._to_north = self.camera.heading % 360 != 0
        return self.camera

    def ray(self, x: float, y: float) -> tuple[Vector, Vector]:
        """Origin relative to the camera and direction of the ray at a logical pixel position, in metres.

        The direction has the length that reaches a view depth of one metre.
        """
        right, up, forward = self.camera.basis
        width, height = (max(v, 1.0) for v in self.size)
        ortho = self.camera.orthographic
        half = ortho / 2 if ortho else math.tan(math.radians(self.camera.fov) / 2)
        across = (2 * x / width - 1) * half * width / height * right + (1 - 2 * y / height) * half * up
        return (across, forward) if ortho else (np.zeros(3), across + forward)

    def _approach(self, goal: Camera, part: float) -> None:
        """Go a part of the way to a camera, and arrive where what is left would not be seen."""
        now = self.camera
        way = self._from_camera(goal.x, goal.y, goal.z)
        turn = (goal.heading - now.heading + 180) % 360 - 180
        height = max(abs(now.z - self._level(now)), self.ground.clearance)
        angles = max(abs(turn), abs(goal.pitch - now.pitch), abs(goal.roll - now.roll), abs(goal.fov - now.fov))
        zoom = math.log(goal.orthographic / now.orthographic) if goal.orthographic and now.orthographic else 0.0
        if np.linalg.norm(way) < 1e-3 * height and angles < 0.02 and abs(zoom) < 1e-3:
            self._goal = None
            self._place(goal)
            return
        wide = now.orthographic * math.exp(zoom * part) if now.orthographic else None
        turned = now.moved(
            heading=(now.heading + turn * part) % 360, pitch=now.pitch + (goal.pitch - now.pitch) * part,
            roll=now.roll + (goal.roll - now.roll) * part, fov=now.fov + (goal.fov - now.fov) * part, orthographic=wide,
        )  # fmt: skip
        self._place(displaced(turned, self.ground.grid, way * part))

    def _level(self, camera: Camera) -> float:
        ground = self.ground.drawn_height(camera.x, camera.y)
        return ground if math.isfinite(ground) else 0.0

    def _north_pivot(self) -> Vector:
        return np.zeros(3)

    def _under(self, x: float, y: float) -> Vector | None:
        """What lies under a logical pixel position: metres (east, north, up) from the camera."""
        found = self.ground.pick(math.floor(x * self.pixel_ratio), math.floor(y * self.pixel_ratio))
        if found is not None and all(math.isfinite(v) for v in found):
            return self._from_camera(found[0], found[1], found[2] * self.ground.exaggeration)
        # beside the data: the plane through the ground below the camera
        origin, direction = self.ray(x, y)
        level = self.ground.drawn_height(self.camera.x, self.camera.y)
        drop = (level if math.isfinite(level) else 0.0) - self.camera.z - origin[2]
        if direction[2] * drop <= 0 or drop / direction[2] > self.ground.reach:
            return None
        return origin + drop / direction[2] * direction

    def _from_camera(self, x: float, y: float, z: float) -> Vector:
        per_x, per_y = self.ground.grid.ground_scale
        return np.array([(x - self.camera.x) * per_x, (y - self.camera.y) * per_y, z - self.camera.z])

    def _step(self, step: Vector) -> None:
        """Move by metres (east, north, up), but stay above the ground and near the data."""
        self._place(displaced(self.camera, self.ground.grid, step))

    def _turn(self, heading: float, pitch: float, pivot: Vector) -> None:
        """Turn by degrees about a point (metres from the camera), which keeps its place in the picture."""
        turned = self.camera.moved(
            heading=(self.camera.heading + heading) % 360 % 360,  # once more: of a tiny negative it is 360 itself
            pitch=min(max(self.camera.pitch + pitch, -90.0), 89.0),
        )
        step = pivot - turned.basis.T @ (self.camera.basis @ pivot)
        self._place(displaced(turned, self.ground.grid, step))

    def _place(self, camera: Camera) -> None:
        grid, reach = self.ground.grid, self.ground.reach
        x, y = (float(v) for v in grid.to_crs(grid.width / 2, grid.height / 2))
        dx, dy = reach / grid.ground_scale[0], reach / grid.ground_scale[1]
        camera = camera.moved(
            x=min(max(camera.x, x - dx), x + dx), y=min(max(camera.y, y - dy), y + dy), z=min(camera.z, reach)
        )
        if not camera.orthographic:  # whose place along the view axis means nothing
            floor = self.ground.drawn_height(camera.x, camera.y) + self.ground.clearance
            if camera.z < floor:
                camera = camera.moved(z=floor)
        self.camera = camera


class OrbitControls(Controls):
    """Around the terrain: drag to pan along the ground, drag with the right or middle button (or Shift, Control) to
    turn about the point under the pointer, wheel or two fingers to zoom towards it and, sideways, to turn about it,
    double click to go there, N for north up, Home to go back to the start.
    """

    def __init__(self, camera: Camera, ground: Ground, size: tuple[float, float], pixel_ratio: float = 1.0) -> None:
        super().__init__(camera, ground, size, pixel_ratio)
        self._drag: str | None = None
        self._last = (0.0, 0.0)
        self._point: Vector | None = None  # what is held, in metres from the camera
        self._far = 0.0  # near the horizon a pixel is many kilometres: a held point is not dragged farther than this
        self._zoom = 0.0  # logarithm of the factor on the distance that is still to come
        self._zoom_point = np.zeros(3)
        self._swept = np.zeros(4)  # east and north in metres, heading and pitch in degrees since the last step
        self._velocity = np.zeros(4)  # the same per second

    @property
    def moving(self) -> bool:
        """Whether a drag, its inertia or a zoom goes on."""
        return super().moving or bool(self._drag) or bool(self._zoom) or bool(self._velocity.any())

    def handle(self, event: Event) -> bool:
        """Take an event; says whether it meant something."""
        if super().handle(event):
            return True
        kind = event["event_type"]
        if kind == "pointer_down":
            self._grab(event)
        elif kind == "pointer_move" and self._drag:
            self._follow(event["x"], event["y"])
        elif kind == "pointer_up":
            self._drag = None
        elif kind in ("wheel", "double_click"):
            point = self._under(event["x"], event["y"])
            if point is None:
                return False
            self._velocity[:] = 0
            if kind == "wheel" and abs(event["dx"]) > abs(event["dy"]):
                # of a swipe only its greater part counts: a hand never goes quite straight
                self._turn(event["dx"] / 100 * DEGREES_PER_NOTCH, 0.0, point)
            else:
                self._zoom_point = point
                self._zoom += ZOOM_STEP * (event["dy"] / 100 if kind == "wheel" else -4.0)
        else:
            return False
        return True

    def advance(self, dt: float) -> Camera:
        """Let `dt` seconds pass: go on with inertia, zoom and the turn to the north."""
        super().advance(dt)
        elapsed, dt = dt, min(dt, LONGEST_STEP)
        if self._drag:
            if elapsed > 0:
                self._velocity += (self._swept / elapsed - self._velocity) * part_of(elapsed, SETTLING / 3)
        elif self._velocity.any():
            # the way of a velocity that decays exponentially
            east, north, heading, pitch = (self._velocity * SETTLING * part_of(dt)).tolist()
            self._shift(np.array([east, north, 0.0]))
            self._turn_held(heading, pitch)
            self._velocity *= 1 - part_of(dt)
            if self._is_slow():
                self._velocity[:] = 0
        self._swept[:] = 0
        if self._zoom:
            self._zoom_step(self._zoom if abs(self._zoom) < 0.002 else self._zoom * part_of(dt))
        return self.camera

    def _grab(self, event: Event) -> None:
        turning = event["button"] != LEFT or any(m in event["modifiers"] for m in SHIFTING)
        self._drag = "turn" if turning else "pan"
        self._last = event["x"], event["y"]
        self._point = self._under(*self._last)
        if self._point is not None:
            self._far = 10 * float(np.linalg.norm(self._point))
        self._velocity[:] = 0
        self._zoom = 0.0
        self._to_north = False

    def _follow(self, x: float, y: float) -> None:
        dx, dy = x - self._last[0], y - self._last[1]
        self._last = x, y
        if self._drag == "turn":
            per_pixel = DEGREES_PER_HEIGHT / max(self.size[1], 1.0)
            self._turn_held(dx * per_pixel, -dy * per_pixel)
            self._swept[2:] += dx * per_pixel, -dy * per_pixel
        elif self._point is not None:
            origin, direction = self.ray(x, y)
            # where the held point's height is met now: the camera goes by what that is off
            along = (self._point[2] - origin[2]) / direction[2] if direction[2] else math.inf
            aimed = origin + along * direction
            if (along > 0 or self.camera.orthographic) and np.linalg.norm(aimed) <= self._far:
                step = (self._point - aimed) * (1, 1, 0)
                self._shift(step)
                self._swept[:2] += step[:2]

    def _shift(self, step: Vector) -> None:
        """Move, and keep what is held where it is in the world."""
        before = self.camera
        self._step(step)
        if self._point is not None:
            self._point = self._point + self._from_camera(before.x, before.y, before.z)

    def _turn_held(self, heading: float, pitch: float) -> None:
        before = self.camera
        self._turn(heading, pitch, np.zeros(3) if self._point is None else self._point)
        if self._point is not None:
            self._point = self._point + self._from_camera(before.x, before.y, before.z)

    def _zoom_step(self, log_factor: float) -> None:
        distance = float(np.linalg.norm(self._zoom_point))
        visible = self.camera.orthographic or distance
        # limits never push a camera that is beyond them already
        nearest, farthest = min(2 * self.ground.clearance, visible), max(self.ground.reach, visible)
        factor = min(max(visible * math.exp(log_factor), nearest), farthest) / max(visible, 1e-9)
        stopped = abs(factor - math.exp(log_factor)) > 1e-9
        self._zoom = 0.0 if stopped else self._zoom - log_factor
        if self.camera.orthographic:
            self.camera = self.camera.moved(orthographic=self.camera.orthographic * factor)
        before = self.camera
        self._step(self._zoom_point * (1 - factor))
        self._zoom_point = self._zoom_point + self._from_camera(before.x, before.y, before.z)

    def _is_slow(self) -> bool:
        """Whether what is left of the inertia would not be seen: a fifth of a pixel a second or less."""
        distance = self.camera.orthographic or (100.0 if self._point is None else float(np.linalg.norm(self._point)))
        pan = float(np.hypot(*self._velocity[:2])) / distance
        return max(pan, math.radians(float(np.abs(self._velocity[2:]).max()))) < 1e-3

    def _north_pivot(self) -> Vector:
        middle = self._under(self.size[0] / 2, self.size[1] / 2)
        return np.zeros(3) if middle is None else middle


def part_of(dt: float, constant: float = SETTLING) -> float:
    """The part of the way to a goal that is gone in `dt` seconds."""
    return 1 - math.exp(-dt / constant)
