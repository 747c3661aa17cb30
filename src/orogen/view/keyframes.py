"""Flights made in a window: recorded from what was flown, or of keyframes that are set one by one."""

from __future__ import annotations

from dataclasses import dataclass, field

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.grid import Grid
from orogen.view.flight import Flight, FlightPath

INTERVAL = 0.5
"""Seconds between the keyframes of a recording."""
STEP = 3.0
"""Seconds from the last keyframe to one that is added."""


@dataclass
class Keyframes:
    """An editable flight: cameras at increasing times, the first at 0 seconds."""

    times: list[float] = field(default_factory=list)
    """Seconds."""
    cameras: list[Camera] = field(default_factory=list)
    """The drawn world's, as they were seen."""
    exaggeration: float = 1.0
    """Factor on all heights under which they were seen."""
    recording: bool = False
    """Whether `record` keeps cameras."""
    _start: float = 0.0
    _last: tuple[float, Camera] | None = None

    @property
    def duration(self) -> float:
        """Seconds of the whole flight."""
        return self.times[-1] if self.times else 0.0

    def start(self, now: float) -> None:
        """Forget what there is and record from now (seconds of any clock)."""
        self.times, self.cameras, self._last = [], [], None
        self.recording, self._start = True, now

    def record(self, now: float, camera: Camera) -> None:
        """Keep a camera while recording: every half second, and before and after a rest."""
        if not self.recording or camera.orthographic:
            return
        t = now - self._start if self.times else 0.0
        if not self.times:
            self._start = now
        rested = self._last is not None and t - self._last[0] > INTERVAL
        if rested and self._last and self._last[0] > self.times[-1]:
            self._keep(*self._last)
        if not self.times or t - self.times[-1] >= INTERVAL:
            self._keep(t, camera)
        self._last = t, camera

    def stop(self) -> None:
        """End the recording with the last camera."""
        if self.recording and self._last and self.times and self._last[0] > self.times[-1]:
            self._keep(*self._last)
        self.recording = False

    def add(self, camera: Camera) -> None:
        """A keyframe at the end."""
        if camera.orthographic:
            raise SettingsError("keyframe: expected a perspective camera, got an orthographic one")
        self._keep(self.times[-1] + STEP if self.times else 0.0, camera)

    def replace(self, number: int, camera: Camera) -> None:
        """Another camera for a keyframe."""
        if camera.orthographic:
            raise SettingsError("keyframe: expected a perspective camera, got an orthographic one")
        self.cameras[number] = camera

    def set_time(self, number: int, t: float) -> None:
        """Move a keyframe in time; those after it keep their distance to it."""
        if number == 0:
            raise SettingsError("keyframe 1: expected 0 seconds, the flight starts with it")
        if not t > self.times[number - 1]:
            raise SettingsError(f"keyframe {number + 1}: expected more than {self.times[number - 1]:g} s, got {t:g}")
        shift = t - self.times[number]
        self.times = [time + shift if i >= number else time for i, time in enumerate(self.times)]

    def remove(self, number: int) -> None:
        """Take a keyframe out; the first of the rest is at 0."""
        del self.times[number], self.cameras[number]
        if self.times:
            self.times = [time - self.times[0] for time in self.times]

    def flight(self, name: str = "") -> Flight:
        """The flight. Raises SettingsError with fewer than two keyframes."""
        if len(self.times) < 2:
            raise SettingsError(f"flight: expected at least 2 keyframes, got {len(self.times)}; add or record some")
        return Flight.from_cameras(self.times, self.cameras, name, self.exaggeration)

    def path(self, grid: Grid, height_range: tuple[float, float], exaggeration: float) -> FlightPath:
        """The flight over the data it was made on."""
        return self.flight().over(grid, height_range, exaggeration=exaggeration)

    def load(self, path: FlightPath, exaggeration: float) -> None:
        """Take the keyframes of a flight over the data; cuts become quick moves."""
        self.recording = False
        self.times = [key.t for key in path.flight.keyframes]
        self.cameras = [path.camera_at(t) for t in self.times]
        self.exaggeration = exaggeration

    def _keep(self, t: float, camera: Camera) -> None:
        self.times.append(t)
        self.cameras.append(camera)
