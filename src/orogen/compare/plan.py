"""What is to be compared: data, flight, pictures, and the algorithms with their settings."""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from orogen.errors import SettingsError
from orogen.lod import algorithm, algorithms, make_settings
from orogen.lod.contract import Detail
from orogen.shading.style import Style
from orogen.source.mosaic import absolute
from orogen.streaming.settings import ClipmapSettings
from orogen.values import expected_name, field_names, from_values


@dataclass(frozen=True)
class Target:
    """A number of triangles, one of several that an entry is measured at."""

    triangles: int
    """A frame, on average."""
    label: str
    """Of the entry that all numbers belong to."""


@dataclass(frozen=True)
class Entry:
    """One competitor: an algorithm and its settings."""

    algorithm: str
    """Name of the algorithm."""
    settings: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """Values of its settings by name, as values or as text; what is not named has its default."""
    label: str = ""
    """What the report calls it; empty: the algorithm and the settings that were given."""
    sweep: str | None = None
    """Setting that a sweep varies; None where the entry belongs to none."""
    target: Target | None = None
    """Triangles that its detail is set to, where the plan has several numbers."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))
        make_settings(self.algorithm, self.settings)
        if not self.label:
            given = " ".join(f"{name}={_text(value)}" for name, value in self.settings.items())
            object.__setattr__(self, "label", f"{self.algorithm} {given}".strip())

    @property
    def folder(self) -> str:
        """The label as the name of a file."""
        return re.sub(r"[^A-Za-z0-9._+=-]+", "_", self.label)

    def values(self) -> dict[str, Any]:
        """All settings by name, defaults included."""
        return dataclasses.asdict(make_settings(self.algorithm, self.settings))

    @property
    def detail(self) -> Detail | None:
        """The setting that calibration may change; None where there is none, or a sweep varies it."""
        detail = algorithm(self.algorithm).detail
        return None if detail is None or detail.setting == self.sweep else detail

    def with_setting(self, name: str, value: Any) -> Entry:
        """The same entry, under its own label, with another value of one setting."""
        return dataclasses.replace(self, settings={**self.settings, name: value})


@dataclass(frozen=True)
class Plan:
    """A comparison. Everything that its results depend on, except the machine."""

    data: Any
    """Raster: a path, URL or GDAL name, "synthetic", or an array of heights (rows, columns)."""
    entries: tuple[Entry, ...] = ()
    """Who takes part; none: every algorithm with its defaults."""
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """How the data is read: the arguments of `orogen.open` from `color` to `crs`."""
    crop: tuple[int, int, int, int] | None = None
    """Part of the data: first column and row, columns and rows, in samples; None: all of it."""
    flight: str = "descent"
    """Flight file, or a built-in flight."""
    size: tuple[int, int] = (1600, 900)
    """Width and height of the pictures in pixels."""
    fps: float = 30.0
    """Frames of the flight per second."""
    frames: int | None = 60
    """How many frames are measured, evenly over the flight; None: as `every` says."""
    every: int | None = None
    """Measure every so many frames of the flight; 1: all of them. Only where `frames` is None."""
    style: Style = field(default_factory=Style)
    """What the pictures look like."""
    prelit: bool = False
    """Drape an image of the terrain, lit once from level 0, and leave out all other light: then pictures differ by
    geometry alone."""
    exaggeration: float = 1.0
    """Factor on all heights."""
    curvature: bool = False
    """Whether the ground drops with the distance as on the globe."""
    metrics: tuple[str, ...] | None = None
    """What is measured, names out of `metrics.METRICS`; None: all that can be with what is installed."""
    repeats: int = 3
    """How often a frame is timed; medians count."""
    pictures: int = 3
    """Of how many frames the pictures are kept."""
    freeze: bool = False
    """Also keep pictures from a second camera, while the flight's camera decides on the geometry."""
    equal_triangles: int | tuple[int, ...] | None = None
    """Triangles a frame, on average, that every algorithm's detail is set to; with several numbers an entry is measured
    at each of them, under the label "LABEL NUMBER"."""
    equal_time: float | None = None
    """Milliseconds of GPU time a frame, on average, that every algorithm's detail is set to."""
    streaming: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """Values of `ClipmapSettings` by name, the same for all entries."""
    adapter: str | None = None
    """GPU: index, kind or part of its name."""

    def __post_init__(self) -> None:
        entries = self.entries or tuple(Entry(name) for name in algorithms())
        if isinstance(self.equal_triangles, tuple):
            entries = tuple(part for entry in entries for part in _at_targets(entry, self.equal_triangles))
        object.__setattr__(self, "entries", entries)
        folders = [entry.folder.lower() for entry in self.entries]
        for entry in self.entries:
            if folders.count(entry.folder.lower()) > 1:
                raise SettingsError(f"entries: expected different labels, got {entry.label!r} twice; name one of them")
            if entry.folder.lower() == "reference":
                raise SettingsError("entries: expected labels other than 'reference', which the true pictures have")
        if min(self.size) < 1:
            raise SettingsError(f"size: expected at least 1x1 pixels, got {self.size[0]}x{self.size[1]}")
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise SettingsError(f"fps: expected more than 0 frames per second, got {self.fps:g}")
        if (self.frames is None) == (self.every is None):
            raise SettingsError("expected either a number of frames or every so many, got both or neither")
        for name, least in (("frames", 1), ("every", 1), ("repeats", 1), ("pictures", 0), ("equal_triangles", 1)):
            value = getattr(self, name)
            for number in value if isinstance(value, tuple) else (value,):
                if number is not None and (not isinstance(number, int) or number < least):
                    raise SettingsError(f"{name}: expected a whole number, at least {least}, got {number}")
        if self.equal_time is not None and not (math.isfinite(self.equal_time) and self.equal_time > 0):
            raise SettingsError(f"equal_time: expected more than 0 milliseconds, got {self.equal_time:g}")
        if self.equal_time is not None and self.equal_triangles is not None:
            raise SettingsError("equal_time and equal_triangles: expected one of them, got both")
        if self.crop is not None and (len(self.crop) != 4 or min(self.crop[:2]) < 0 or min(self.crop[2:]) < 2):
            raise SettingsError(f"crop: expected a column and a row from 0 and at least 2x2 samples, got {self.crop}")
        if self.prelit and self.options.get("color") is not None:
            raise SettingsError("prelit and color: expected one image to drape, got both")
        if self.metrics is not None:
            from orogen.compare.metrics import METRICS

            for name in self.metrics:
                if name not in METRICS:
                    raise expected_name("metric", name, METRICS)
        self.clipmap_settings()

    @property
    def shown(self) -> Style:
        """The style of the pictures that are measured: without overlays, and unlit where the light is in the image."""
        style = dataclasses.replace(self.style, overlays=())
        return dataclasses.replace(style, lit=False, color="image") if self.prelit else style

    def clipmap_settings(self) -> ClipmapSettings:
        """How the entries stream."""
        return from_values(ClipmapSettings, "streaming", self.streaming)

    def request(self) -> dict[str, Any]:
        """The plan in types of JSON; for paths the same from whatever folder the command is called."""
        found = {name: getattr(self, name) for name in field_names(Plan)}
        found["data"] = _place(self.data)
        options = {name: value for name, value in self.options.items() if value is not None}
        if "color" in options:
            options["color"] = _place(options["color"])
        found["options"] = options
        found["entries"] = [
            {"label": e.label, "algorithm": e.algorithm, "settings": e.values(), "sweep": e.sweep} for e in self.entries
        ]
        found["style"] = dataclasses.asdict(self.shown)
        found["streaming"] = dataclasses.asdict(self.clipmap_settings())
        del found["adapter"], found["flight"]
        return plain(found)


def parse_entry(text: str) -> Entry:
    """An entry as the command takes it: `[LABEL=]ALGORITHM[:KEY=VALUE,KEY=VALUE...]`."""
    head, _, rest = text.partition(":")
    label, named, name = head.rpartition("=")
    if named and not label:
        raise SettingsError(f"--entry: expected [LABEL=]ALGORITHM[:KEY=VALUE,...], got {text!r}")
    settings = {}
    for part in filter(None, rest.split(",")):
        key, found, value = part.partition("=")
        if not found or not key:
            raise SettingsError(f"--entry: expected KEY=VALUE after {head!r}, got {part!r}")
        settings[key.strip()] = value.strip()
    return Entry(name.strip(), settings, label.strip())


def parse_sweep(text: str, entries: Iterable[Entry]) -> list[Entry]:
    """The entries of a sweep: `NAME.SETTING=VALUE,VALUE...`, where NAME is an entry's label or an algorithm."""
    head, found, values = text.partition("=")
    name, dot, setting = head.rpartition(".")
    if not (found and dot and values):
        raise SettingsError(f"--sweep: expected NAME.SETTING=VALUE,VALUE..., got {text!r}")
    base = next((entry for entry in entries if entry.label == name), None)
    base = base or Entry(name)
    title = base.label
    return [
        dataclasses.replace(base.with_setting(setting, value), label=f"{title} {setting}={value}", sweep=setting)
        for value in filter(None, (value.strip() for value in values.split(",")))
    ]


def _at_targets(entry: Entry, targets: tuple[int, ...]) -> list[Entry]:
    """The entry at each number of triangles; the entry itself where it cannot be set to any, or has been."""
    if entry.detail is None or entry.target is not None:
        return [entry]
    return [
        dataclasses.replace(entry, label=f"{entry.label} {number:,}", target=Target(number, entry.label))
        for number in dict.fromkeys(targets)
    ]


def plain(value: Any) -> Any:
    """The value in the types of JSON, as it comes back from a file."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return plain(value.item()) if hasattr(value, "item") else str(value)


def _place(data: Any) -> str | list[str]:
    if isinstance(data, list | tuple) and all(isinstance(part, str | os.PathLike) for part in data):
        return [os.fspath(part) for part in absolute(data)]
    return os.fspath(absolute(data)) if isinstance(data, str | os.PathLike) else "array"


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
