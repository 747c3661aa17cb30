"""Flights: timed keyframes of a camera, kept as JSON, flown smoothly over any data.

A flight file holds one object:

    {"name": "valley", "crs": "EPSG:3857", "relative": false, "keyframes": [{"t": 0, ...}, {"t": 4.5, ...}]}

`name` is optional, as are `crs` (of x and y; default: the data's) and `relative` (default: false). The first `t` is 0;
times are in seconds and increase. Every keyframe gives the camera in the same one of two ways:

* by its position: `x`, `y` and the height `z` (metres, before exaggeration), or
* by its target: `look_at` [x, y] on the ground and the `distance` to it in metres;

then `heading` (degrees clockwise from grid north), `pitch` (degrees above the horizon), `roll` and `fov` (the vertical
angle of view); these are optional, and so is `sun` [azimuth, elevation] in degrees, on all keyframes or none. At a
keyframe with `cut` true the camera jumps: until then it stays where the keyframe before has it.

In a relative flight x and y are fractions of the data's extent (0, 0 lower left, 1, 1 upper right), `distance` counts
in halves of its diagonal, and so does `z`, which starts at the highest point; its camera is lifted where it would come
too close to the ground (to the lowest height where there is none). Such flights suit any data.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import os
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.grid import Grid
from orogen.view.framing import displaced
from orogen.view.output import publish
from orogen.view.spline import Spline

FLIGHT_SUFFIXES = (".json",)

CLEARANCE = 3.0
"""Least height of a relative flight over the ground, in sample spacings."""
LIFT_RATE = 8
"""Heights of the ground under a relative flight are looked up this many times a second."""
LIFT_TIME = 1.5
"""Seconds over which a relative flight rises before an obstacle and sinks behind it."""


@dataclass(frozen=True)
class Keyframe:
    """The camera at one time; see the module's text for units."""

    t: float
    """Seconds from the start."""
    x: float | None = None
    y: float | None = None
    z: float | None = None
    look_at: tuple[float, float] | None = None
    distance: float | None = None
    heading: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    fov: float = 45.0
    sun: tuple[float, float] | None = None
    cut: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.cut, bool):
            raise SettingsError(f"cut: expected true or false, got {self.cut!r}")
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "cut":
                continue
            pair = field.name in ("look_at", "sun")
            if value is None and field.default is None:
                continue
            numbers = value if pair else [value]
            if pair and not (isinstance(value, list | tuple) and len(value) == 2):
                raise SettingsError(f"{field.name}: expected two numbers, got {value!r}")
            if not all(isinstance(v, float | int) and not isinstance(v, bool) and math.isfinite(v) for v in numbers):
                raise SettingsError(f"{field.name}: expected {'finite numbers' if pair else 'a number'}, got {value!r}")
            if pair:
                object.__setattr__(self, field.name, tuple(value))
        by_position = [v is not None for v in (self.x, self.y, self.z)]
        by_target = [self.look_at is not None, self.distance is not None]
        if not (all(by_position) and not any(by_target)) and not (all(by_target) and not any(by_position)):
            raise SettingsError("expected either x, y and z or look_at and distance")
        if self.distance is not None and self.distance <= 0:
            raise SettingsError(f"distance: expected more than 0, got {self.distance:g}")
        if self.sun and not 0 <= self.sun[1] <= 90:
            raise SettingsError(f"sun: expected an elevation of 0 to 90 degrees, got {self.sun[1]:g}")
        Camera(0.0, 0.0, 0.0, heading=self.heading, pitch=self.pitch, roll=self.roll, fov=self.fov)


@dataclass(frozen=True)
class Flight:
    """Timed keyframes; `over` lays them over data."""

    keyframes: tuple[Keyframe, ...]
    """At least two, in the order of their times, the first at 0."""
    name: str = ""
    """What the flight is called."""
    crs: str | None = None
    """CRS of x and y; None: that of the data."""
    relative: bool = False
    """Whether coordinates are parts of the data's extent."""

    def __post_init__(self) -> None:
        if len(self.keyframes) < 2:
            raise SettingsError(f"keyframes: expected at least 2, got {len(self.keyframes)}")
        times = [k.t for k in self.keyframes]
        if self.keyframes[0].cut:
            raise SettingsError("keyframe 1: cut: expected a keyframe to jump from, the first has none before it")
        if times[0] != 0:
            raise SettingsError(f"keyframe 1: t: expected the first keyframe at 0 seconds, got {times[0]:g}")
        for i in range(1, len(times)):
            if times[i] <= times[i - 1]:
                raise SettingsError(f"keyframe {i + 1}: t: expected more than {times[i - 1]:g}, got {times[i]:g}")
        for key in ("look_at", "sun"):
            given = [getattr(k, key) is not None for k in self.keyframes]
            if len(set(given)) > 1:
                first = given.index(not given[0]) + 1
                raise SettingsError(f"keyframe {first}: {key}: expected on all keyframes or on none")
        if self.relative and self.crs:
            raise SettingsError("crs: a relative flight has none; leave out crs or relative")

    @property
    def duration(self) -> float:
        """Seconds from the first keyframe to the last."""
        return self.keyframes[-1].t

    def lasting(self, duration: float) -> Flight:
        """The same flight, faster or slower, so that it lasts for `duration` seconds."""
        if not (math.isfinite(duration) and duration > 0):
            raise SettingsError(f"duration: expected more than 0 seconds, got {duration:g}")
        factor = duration / self.duration
        return dataclasses.replace(
            self, keyframes=tuple(dataclasses.replace(k, t=k.t * factor) for k in self.keyframes)
        )

    @classmethod
    def load(cls, flight: str | os.PathLike[str]) -> Flight:
        """Read a flight file, or a built-in flight by its name (see `builtin_flights`).

        Raises SettingsError, naming the file, the keyframe and the key, for what is missing, unknown or out of range.
        """
        name = os.fspath(flight)
        if name in builtin_flights():
            text = files("orogen.view").joinpath("flights", f"{name}.json").read_text(encoding="utf-8")
        else:
            try:
                text = Path(name).read_text(encoding="utf-8")
            except (OSError, ValueError) as error:
                known = ", ".join(builtin_flights())
                reason = error.strerror if isinstance(error, OSError) else "not a text file"
                raise SettingsError(
                    f"flight {name}: {reason}; expected a flight file or one of the built-in flights {known}"
                ) from error
        try:
            return cls._parse(json.loads(text, parse_int=float))  # an integer may be beyond every float
        except json.JSONDecodeError as error:
            raise SettingsError(f"flight {name}: line {error.lineno}: not JSON: {error.msg}") from error
        except SettingsError as error:
            raise SettingsError(f"flight {name}: {error}") from error

    @classmethod
    def from_cameras(
        cls, times: Sequence[float], cameras: Sequence[Camera], name: str = "", exaggeration: float = 1.0
    ) -> Flight:
        """A recording: perspective cameras at increasing times in seconds (the first one becomes 0).

        `exaggeration` is the one under which they were seen. Raises SettingsError as the constructor does.
        """
        if len(times) != len(cameras):
            raise SettingsError(f"expected as many times as cameras, got {len(times)} and {len(cameras)}")
        if any(camera.orthographic for camera in cameras):
            raise SettingsError("a flight holds perspective cameras only, got an orthographic one")
        return cls(
            tuple(
                Keyframe(
                    t - times[0], c.x, c.y, c.z / exaggeration,
                    heading=c.heading, pitch=c.pitch, roll=c.roll, fov=c.fov,
                )
                for t, c in zip(times, cameras, strict=True)
            ),
            name,
        )  # fmt: skip

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the flight as JSON (.json), whole or not at all. Raises OutputError where it cannot be written."""
        with publish(path, FLIGHT_SUFFIXES, overwrite) as temporary:
            temporary.write_text(json.dumps(_without_defaults(self), indent=1) + "\n", encoding="utf-8")

    def over(
        self,
        grid: Grid,
        height_range: tuple[float, float],
        *,
        exaggeration: float = 1.0,
        height_at: Callable[[float, float], float] | None = None,
    ) -> FlightPath:
        """The flight over data of `grid` with heights within `height_range` (metres, before exaggeration).

        `height_at` gives the height of the ground in metres at (x, y) in the data's CRS, NaN where there is none;
        without it targets lie at the middle of the range, and relative flights are not lifted over obstacles.
        Raises SettingsError where the flight's CRS cannot be turned into the data's.
        """
        xy = self._positions(grid)
        unit = _half_diagonal(grid) if self.relative else 1.0
        keys = self.keyframes
        if keys[0].look_at is None:
            top = height_range[1] if self.relative else 0.0
            z = np.array([top + k.z * unit for k in keys if k.z is not None]) * exaggeration
            distance = None
        else:
            found = np.array([height_at(x, y) if height_at else math.nan for x, y in xy.tolist()])
            z = np.where(np.isfinite(found), found, sum(height_range) / 2) * exaggeration
            distance = np.array([k.distance * unit for k in keys if k.distance is not None])
        path = FlightPath(self, grid, xy, z, distance)
        if self.relative and height_at:

            def ground(x: float, y: float) -> float:
                height = height_at(x, y)
                return (height if math.isfinite(height) else height_range[0]) * exaggeration

            path.lift(ground, CLEARANCE * grid.spacing)
        return path

    def _positions(self, grid: Grid) -> NDArray[np.float64]:
        """(n, 2): x, y of the cameras or the targets in the data's CRS."""
        xy = np.array([k.look_at or (k.x, k.y) for k in self.keyframes], np.float64)
        if self.relative:
            left, bottom, right, top = grid.bounds
            return np.array([left, bottom]) + xy * [right - left, top - bottom]
        if self.crs is None:
            return xy
        return _transformed(xy, self.crs, grid.crs)

    @classmethod
    def _parse(cls, data: Any) -> Flight:
        _check_keys(data, [f.name for f in dataclasses.fields(cls)], "")
        keyframes = data.get("keyframes")
        if not isinstance(keyframes, list):
            raise SettingsError(f"keyframes: expected a list, got {keyframes!r}")
        for key, kind in (("name", str), ("crs", str), ("relative", bool)):
            if key in data and not isinstance(data[key], kind):
                raise SettingsError(f"{key}: expected a {kind.__name__}, got {data[key]!r}")
        return cls(**{**data, "keyframes": tuple(_parse_keyframe(k, i + 1) for i, k in enumerate(keyframes))})


class FlightPath:
    """A flight laid over data: the camera at any time."""

    def __init__(
        self,
        flight: Flight,
        grid: Grid,
        xy: NDArray[np.float64],
        z: NDArray[np.float64],
        distance: NDArray[np.float64] | None,
    ) -> None:
        self.flight = flight
        self.grid = grid
        keys = flight.keyframes
        starts = [0, *(i for i, key in enumerate(keys) if key.cut), len(keys)]
        parts = [slice(start, stop) for start, stop in pairwise(starts)]
        self._legs = [_Leg(keys[p], grid, xy[p], z[p], None if distance is None else distance[p]) for p in parts]
        self.cuts: tuple[float, ...] = tuple(keys[start].t for start in starts[1:-1])
        """Times in seconds at which the camera jumps."""

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.flight.duration

    def camera_at(self, t: float) -> Camera:
        """The camera at the time t in seconds; before the start the first one, after the end the last one."""
        if not math.isfinite(t):
            raise SettingsError(f"t: expected a finite time, got {t}")
        return self._leg(t).camera_at(t)

    def sun_at(self, t: float) -> tuple[float, float] | None:
        """Azimuth (degrees clockwise from north, 0 to 360) and elevation of the sun, if the flight gives one."""
        return self._leg(t).sun_at(t)

    def frames(self, fps: float) -> Iterator[tuple[float, Camera]]:
        """(time, camera) of a video of `fps` frames a second: as many as last for the duration, at least one."""
        for i in range(self.frame_count(fps)):
            yield i / fps, self.camera_at(i / fps)

    def frame_count(self, fps: float) -> int:
        """Number of frames that `frames` gives."""
        if not (math.isfinite(fps) and fps > 0):
            raise SettingsError(f"fps: expected more than 0 frames per second, got {fps:g}")
        return max(1, round(self.duration * fps))

    def lift(self, ground: Callable[[float, float], float], clearance: float) -> None:
        """Raise the path smoothly to at least `clearance` metres over `ground`, heights of the drawn world."""
        for leg in self._legs:
            leg.lift(ground, clearance)

    def _leg(self, t: float) -> _Leg:
        return self._legs[bisect_right(self.cuts, t)]


class _Leg:
    """What is flown between two cuts."""

    def __init__(
        self,
        keys: Sequence[Keyframe],
        grid: Grid,
        xy: NDArray[np.float64],
        z: NDArray[np.float64],
        distance: NDArray[np.float64] | None,
    ) -> None:
        self._grid = grid
        if len(keys) == 1:
            # a rest: the same key a second later
            keys = [keys[0], dataclasses.replace(keys[0], t=keys[0].t + 1)]
            xy, z = np.repeat(xy, 2, axis=0), np.repeat(z, 2)
            distance = None if distance is None else np.repeat(distance, 2)
        times = [k.t for k in keys]
        self._start, self._end = times[0], times[-1]
        self._xy = Spline(times, xy)
        # heights and angles must not swing past their keys: into the ground, or over the zenith
        self._z = Spline(times, z[:, None], bounded=True)
        heading = np.unwrap([k.heading for k in keys], period=360)
        self._angles = Spline(
            times, [(h, k.pitch, k.roll, k.fov) for h, k in zip(heading, keys, strict=True)], bounded=True
        )
        self._distance = None if distance is None else Spline(times, np.log(distance)[:, None], bounded=True)
        suns = [k.sun for k in keys if k.sun]
        self._sun = None
        if suns:
            azimuth = np.unwrap([s[0] for s in suns], period=360)
            self._sun = Spline(times, [(a, s[1]) for a, s in zip(azimuth, suns, strict=True)], bounded=True)
        self._lift: Spline | None = None

    def camera_at(self, t: float) -> Camera:
        x, y = self._xy(t).tolist()
        heading, pitch, roll, fov = self._angles(t).tolist()
        camera = Camera(x, y, float(self._z(t)[0]), heading=heading % 360, pitch=pitch, roll=roll, fov=fov)
        if self._distance is not None:
            camera = displaced(camera, self._grid, -math.exp(self._distance(t)[0]) * camera.basis[2])
        return camera if self._lift is None else camera.moved(z=camera.z + float(self._lift(t)[0]))

    def sun_at(self, t: float) -> tuple[float, float] | None:
        if self._sun is None:
            return None
        azimuth, elevation = self._sun(t).tolist()
        return azimuth % 360, elevation

    def lift(self, ground: Callable[[float, float], float], clearance: float) -> None:
        reach = round(LIFT_TIME * LIFT_RATE)
        count = math.ceil((self._end - self._start) * LIFT_RATE) + 1
        times = np.linspace(self._start, self._end, count)
        cameras = [self.camera_at(t) for t in times.tolist()]
        missing = np.array([ground(c.x, c.y) + clearance - c.z for c in cameras])
        missing = np.pad(np.where(missing > 0, missing, 0), 2 * reach, "edge")
        # the maximum over a window, smoothed with a window of the same width, is nowhere below the original
        highest = np.lib.stride_tricks.sliding_window_view(missing, 2 * reach + 1).max(axis=1)
        weights = np.hanning(2 * reach + 3)[1:-1]
        smooth = np.convolve(highest, weights / weights.sum(), "valid")
        self._lift = Spline(times, smooth[:, None], bounded=True) if smooth.any() else None


def builtin_flights() -> tuple[str, ...]:
    """Names of the flights that come with orogen.

    Those for one data set are named after it, as "descent-puget" is; the others are relative, and so suit any data.
    """
    folder = files("orogen.view").joinpath("flights")
    return tuple(sorted(f.name.removesuffix(".json") for f in folder.iterdir() if f.name.endswith(".json")))


def _parse_keyframe(data: Any, number: int) -> Keyframe:
    _check_keys(data, [f.name for f in dataclasses.fields(Keyframe)], f"keyframe {number}: ")
    if "t" not in data:
        raise SettingsError(f"keyframe {number}: t: expected a time in seconds, got none")
    try:
        return Keyframe(**data)
    except SettingsError as error:
        raise SettingsError(f"keyframe {number}: {error}") from error


def _check_keys(data: Any, known: list[str], where: str) -> None:
    if not isinstance(data, dict):
        raise SettingsError(f"{where}expected an object with keys, got {data!r}")
    for key in data:
        if key not in known:
            close = difflib.get_close_matches(key, known, 1)
            hint = f"did you mean {close[0]}?" if close else f"expected one of {', '.join(known)}"
            raise SettingsError(f"{where}{key}: unknown key; {hint}")


def _without_defaults(value: Any) -> dict[str, Any]:
    result = {}
    for field in dataclasses.fields(value):
        item = getattr(value, field.name)
        if field.name == "keyframes":
            result[field.name] = [_without_defaults(k) for k in item]
        elif item != field.default:
            result[field.name] = item
    return result


def _half_diagonal(grid: Grid) -> float:
    left, bottom, right, top = grid.bounds
    return math.hypot((right - left) * grid.ground_scale[0], (top - bottom) * grid.ground_scale[1]) / 2


def _transformed(xy: NDArray[np.float64], source: str, target: str | None) -> NDArray[np.float64]:
    from rasterio.crs import CRS
    from rasterio.errors import RasterioError
    from rasterio.warp import transform

    if target is None:
        raise SettingsError(f"crs: the flight is in {source}, but the data has no CRS; give it one (crs=)")
    try:
        source_crs, target_crs = CRS.from_user_input(source), CRS.from_user_input(target)
        x, y = (xy[:, 0], xy[:, 1]) if source_crs == target_crs else transform(source_crs, target_crs, *xy.T)
    except (RasterioError, ValueError) as error:
        raise SettingsError(f"crs: cannot go from {source} to {target}: {error}") from error
    result = np.stack([x, y], axis=-1).astype(np.float64)
    if not np.isfinite(result).all():
        raise SettingsError(f"crs: positions of the flight in {source} have no place in {target}")
    return result
