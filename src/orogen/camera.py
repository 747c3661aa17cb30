"""The camera, in the data's own coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.values import once

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """A perspective or orthographic camera. Right-handed; x east, y north, z up in its local metric frame."""

    x: float
    """Position along x in units of the data's CRS (float64)."""
    y: float
    """Position along y in units of the data's CRS (float64)."""
    z: float
    """Height in metres of the drawn world, that is after vertical exaggeration."""
    heading: float = 0.0
    """Direction of view in degrees clockwise from grid north."""
    pitch: float = 0.0
    """Elevation of the direction of view in degrees: 0 level, -90 straight down, 90 straight up."""
    roll: float = 0.0
    """Turn about the direction of view in degrees, clockwise."""
    fov: float = 45.0
    """Vertical angle of view of a perspective camera in degrees, above 0 and below 180."""
    orthographic: float | None = None
    """Visible height of an orthographic camera in metres; None for a perspective camera."""
    near: float = 0.1
    """Distance of the near plane of a perspective camera in metres; there is no far plane."""

    def __post_init__(self) -> None:
        for name in ("x", "y", "z", "heading", "pitch", "roll", "fov", "near"):
            value = getattr(self, name)
            try:
                finite = math.isfinite(value)
            except TypeError:
                finite = False
            if not finite:
                raise SettingsError(f"camera {name}: expected a finite number, got {value}")
        if not -90 <= self.pitch <= 90:
            raise SettingsError(f"camera pitch: expected -90 to 90 degrees, got {self.pitch:g}")
        if not 0 < self.fov < 180:
            raise SettingsError(f"camera fov: expected more than 0 and less than 180 degrees, got {self.fov:g}")
        if self.near <= 0:
            raise SettingsError(f"camera near: expected more than 0 metres, got {self.near:g}")
        if self.orthographic is not None and not (math.isfinite(self.orthographic) and self.orthographic > 0):
            raise SettingsError(f"camera orthographic: expected a height above 0 metres, got {self.orthographic:g}")

    @once
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """The unit vectors right, up and forward in (east, north, up)."""
        h, p, r = (math.radians(a) for a in (self.heading, self.pitch, self.roll))
        east, north, climb, level = math.sin(h), math.cos(h), math.sin(p), math.cos(p)
        forward = (east * level, north * level, climb)
        right = (north, -east, 0.0)
        # right x forward
        up = (-east * climb, -north * climb, north * forward[1] + east * forward[0])
        cos, sin = math.cos(r), math.sin(r)
        (r0, r1, r2), (u0, u1, u2) = right, up
        tilted = (cos * r0 - sin * u0, cos * r1 - sin * u1, cos * r2 - sin * u2)
        return tilted, (sin * r0 + cos * u0, sin * r1 + cos * u1, sin * r2 + cos * u2), forward

    @once
    def basis(self) -> NDArray[np.float64]:
        """`axes` as the rows of a 3 x 3 matrix."""
        return np.array(self.axes)

    def moved(self, **changes: float | None) -> Camera:
        """A copy with some fields changed. Raises SettingsError for values out of their range."""
        return replace(self, **changes)  # type: ignore[arg-type]
