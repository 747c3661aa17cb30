"""What a window tells about the ground: places in two reference systems, slopes, distances, profiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.grid import Grid

if TYPE_CHECKING:
    from rasterio.crs import CRS

PROFILE_SAMPLES = 512
"""Heights along a profile."""
PIECES = 32
"""Parts of each straight line that is measured."""
MAJOR, ECCENTRICITY2 = 6378137.0, 0.00669437999014
"""Half the major axis (m) and squared eccentricity of the ellipsoid of WGS 84."""

GAP = "   "
"""Between the parts of a line on a place."""

HeightAt = Callable[[Any, Any], Any]
"""Heights (m) at x, y in the data's CRS, numbers or arrays; NaN where there is none."""


@dataclass(frozen=True)
class Place:
    """A point of the ground."""

    x: float
    """In the data's CRS."""
    y: float
    """In the data's CRS."""
    height: float
    """Metres, before exaggeration; NaN where there is none."""
    slope: float
    """Angle of the ground in degrees; NaN where it is unknown."""
    longitude: float | None
    """Degrees east in WGS 84; None for data without a CRS."""
    latitude: float | None
    """Degrees north in WGS 84; None for data without a CRS."""


class Ruler:
    """Measures on one data set."""

    def __init__(self, grid: Grid, height_at: HeightAt) -> None:
        self.grid = grid
        self.height_at = height_at
        self._crs = _crs_of(grid.crs)

    @property
    def geographic(self) -> bool:
        """Whether x and y are degrees."""
        return self._crs is not None and self._crs.is_geographic

    def place(self, x: float, y: float) -> Place:
        """What is known of the ground at (x, y)."""
        longitude, latitude = self.to_degrees([x], [y])
        return Place(
            x, y, float(self.height_at(x, y)), self.slope(x, y),
            None if longitude is None else float(longitude[0]), None if latitude is None else float(latitude[0]),
        )  # fmt: skip

    def to_degrees(self, x: Sequence[float], y: Sequence[float]) -> tuple[NDArray | None, NDArray | None]:
        """Longitudes and latitudes in WGS 84; None for data without a CRS."""
        from rasterio.warp import transform

        if self._crs is None:
            return None, None
        longitude, latitude = transform(self._crs, "EPSG:4326", x, y)
        return np.asarray(longitude, np.float64), np.asarray(latitude, np.float64)

    def from_degrees(self, longitude: float, latitude: float) -> tuple[float, float]:
        """x and y of a place in WGS 84; SettingsError for data without a CRS, and for what has no place in it."""
        from rasterio.errors import RasterioError
        from rasterio.warp import transform

        if self._crs is None:
            raise SettingsError("expected data with a CRS to find longitudes and latitudes, this has none")
        try:
            x, y = transform("EPSG:4326", self._crs, [longitude], [latitude])
        except RasterioError as error:
            raise SettingsError(f"{longitude:g}, {latitude:g} has no place in the data's CRS: {error}") from error
        if not (math.isfinite(x[0]) and math.isfinite(y[0])):
            raise SettingsError(f"{longitude:g}, {latitude:g} has no place in the data's CRS")
        return float(x[0]), float(y[0])

    def slope(self, x: float, y: float) -> float:
        """Angle of the ground in degrees, from the samples a spacing away on both sides."""
        step = self.grid.texels @ np.diag([self.grid.spacing] * 2)  # columns: a step east and one north, in texels
        at = np.array([float(v) for v in self.grid.to_texel(x, y)])[:, None]
        texels = np.concatenate([at + step, at - step], axis=1)
        east, north, west, south = np.asarray(self.height_at(*self.grid.to_crs(*texels)), np.float64)
        fall = math.hypot(east - west, north - south) / (2 * self.grid.spacing)
        return math.degrees(math.atan(fall)) if math.isfinite(fall) else math.nan

    def north_turn(self, x: float, y: float) -> float:
        """Degrees clockwise from grid north to true north at (x, y); 0 for data without a CRS."""
        longitude, latitude = self.to_degrees([x], [y])
        if longitude is None or latitude is None or self.geographic:
            return 0.0
        try:
            away = self.from_degrees(float(longitude[0]), min(float(latitude[0]) + 1e-3, 90.0))
        except SettingsError:
            return 0.0
        return math.degrees(math.atan2(away[0] - x, away[1] - y))

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres over the ground from the first of (n, 2) points x, y to each of them, along the drawn straight lines.

        On the ellipsoid of WGS 84, at height 0; for data without a CRS plain lengths.
        """
        points = np.asarray(points, np.float64)
        if self._crs is None:
            steps = np.hypot(*(np.diff(points, axis=0) * self.grid.ground_scale).T)
            return np.concatenate([[0.0], np.cumsum(steps)])
        # pieces so short that the ellipsoid's radii are the same all along each
        count = (len(points) - 1) * PIECES + 1
        where, ends = np.arange(count) / PIECES, np.arange(len(points))
        x, y = (np.interp(where, ends, points[:, axis]) for axis in (0, 1))
        longitude, latitude = self.to_degrees(x.tolist(), y.tolist())
        assert longitude is not None
        assert latitude is not None
        a, b = np.radians(longitude), np.radians(latitude)
        middle = (b[1:] + b[:-1]) / 2
        w = 1 - ECCENTRICITY2 * np.sin(middle) ** 2
        east = MAJOR / np.sqrt(w) * np.cos(middle) * ((np.diff(a) + np.pi) % (2 * np.pi) - np.pi)
        north = MAJOR * (1 - ECCENTRICITY2) / w**1.5 * np.diff(b)
        return np.concatenate([[0.0], np.cumsum(np.hypot(east, north))])[::PIECES]

    def profile(self, points: Sequence[tuple[float, float]], count: int = PROFILE_SAMPLES) -> Profile:
        """Heights along a line of two or more points x, y."""
        if len(points) < 2:
            raise SettingsError(f"profile: expected at least 2 points, got {len(points)}")
        line = np.asarray(points, np.float64)
        along = self.distances(line)
        if along[-1] <= 0:
            raise SettingsError("profile: expected points apart from each other")
        where = np.linspace(0, along[-1], count)
        keep = np.concatenate([[True], np.diff(along) > 0])
        xy = np.stack([np.interp(where, along[keep], line[keep, axis]) for axis in (0, 1)], axis=1)
        return Profile(where, np.asarray(self.height_at(xy[:, 0], xy[:, 1]), np.float64), xy)


@dataclass(frozen=True)
class Profile:
    """Heights along a line."""

    distance: NDArray[np.float64]
    """(n,) metres from the start."""
    height: NDArray[np.float64]
    """(n,) metres; NaN where there is none."""
    points: NDArray[np.float64]
    """(n, 2) x, y in the data's CRS."""

    @property
    def length(self) -> float:
        """Metres over the ground."""
        return float(self.distance[-1])

    @property
    def climb(self) -> tuple[float, float]:
        """Metres up and metres down on the way, missing heights left out."""
        steps = np.diff(self.height[np.isfinite(self.height)])
        return float(steps[steps > 0].sum()), float(-steps[steps < 0].sum())


def distance_text(metres: float) -> str:
    """A length for people."""
    if abs(metres) >= 1000:
        return f"{metres / 1000:,.2f} km" if abs(metres) < 1e5 else f"{metres / 1000:,.0f} km"
    return f"{metres:.1f} m" if abs(metres) < 100 else f"{metres:.0f} m"


def place_text(place: Place, geographic: bool, crs: str | None) -> str:
    """One line on a place, for people."""
    parts = []
    if not geographic:
        name = f"{crs} " if crs and len(crs) <= 12 else ""
        parts.append(f"{name}{place.x:.1f}, {place.y:.1f}")
    if place.longitude is not None and place.latitude is not None:
        north, east = ("N" if place.latitude >= 0 else "S"), ("E" if place.longitude >= 0 else "W")
        parts.append(f"{abs(place.latitude):.5f}° {north}, {abs(place.longitude):.5f}° {east}")
    parts.append(f"{place.height:.1f} m" if math.isfinite(place.height) else "no height")
    if math.isfinite(place.slope):
        parts.append(f"slope {place.slope:.0f}°")
    return GAP.join(parts)


def _crs_of(name: str | None) -> CRS | None:
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    if not name:
        return None
    try:
        crs = CRS.from_user_input(name)
    except CRSError:
        return None
    # a local system has no place on the earth
    return crs if crs.is_geographic or crs.is_projected else None
