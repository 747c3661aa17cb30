"""What a comparison left in its folder: the plan, and a record per entry and frame."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from orogen.errors import SettingsError

Row = dict[str, float | None]
"""A frame's numbers by flat names ("forward.p99"); None where something was not or could not be measured."""

PERCENTILES = (50, 95, 99)
FORMAT = 1
"""Version of the folder's files."""


@dataclass(frozen=True)
class Entry:
    """An algorithm with its settings, and what was measured of it."""

    label: str
    """Name of the entry, unique in a comparison."""
    algorithm: str
    """Name of the algorithm."""
    settings: Mapping[str, Any]
    """All settings with their values."""
    given: Mapping[str, Any]
    """The settings that were asked for."""
    calibrated: Mapping[str, Any] | None
    """"setting", "value", "target" and "reached" where a setting was found by calibration."""
    sweep: Mapping[str, Any] | None
    """"setting" and "value" where the entry belongs to a sweep."""
    folder: str
    """Name that its files go by."""
    frames: tuple[Mapping[str, Any], ...]
    """Records as they were measured, in the order of the flight."""
    target: Mapping[str, Any] | None = None
    """"triangles" and "label" where the entry is measured at one of several numbers of triangles."""

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The records, flat; "memory.own" is what the algorithm itself allocates on the GPU."""
        rows = tuple(flatten(frame) for frame in self.frames)
        for row in rows:
            if row.get("memory.gpu") is not None:
                row["memory.own"] = row.get(f"memory.gpu.{self.algorithm}", 0.0)
        return rows

    @cached_property
    def summary(self) -> dict[str, dict[str, float]]:
        """Statistics over the flight by flat name; names without any value are left out."""
        names = dict.fromkeys(name for row in self.rows for name in row if name not in ("frame", "time"))
        found = {name: summarise(self.column(name)) for name in names}
        summary = {name: statistics for name, statistics in found.items() if statistics is not None}
        if "mse" in summary and "psnr" in summary:
            summary["psnr"] |= _over_all(summary["mse"]["mean"], self.column("psnr"))
        return summary

    def column(self, name: str) -> list[float | None]:
        """The values of all frames by flat name."""
        return [row.get(name) for row in self.rows]

    def value(self, name: str, statistic: str = "mean") -> float | None:
        """A statistic over the flight; None where there is none."""
        return self.summary.get(name, {}).get(statistic)


@dataclass(frozen=True)
class Comparison:
    """Everything that a report tells."""

    folder: Path
    """Where it lies."""
    plan: Mapping[str, Any]
    """What was compared, how and on which machine."""
    entries: tuple[Entry, ...]
    """In the plan's order."""

    @property
    def frame_count(self) -> int:
        """Frames that the plan asks for, per entry."""
        return int(self.plan.get("flight", {}).get("frames", 0))

    @property
    def finished(self) -> bool:
        """Whether every frame of every entry was measured."""
        return all(len(entry.frames) >= self.frame_count for entry in self.entries)

    @property
    def software(self) -> bool:
        """Whether a software driver drew: its timestamps can leave out work, so that GPU times must not be compared."""
        return (self.plan.get("adapter") or {}).get("kind") == "cpu"

    @property
    def time(self) -> str:
        """Flat name of the time that entries are compared by: the GPU's, or the wall clock where that is no good."""
        known = any(entry.value("gpu") is not None for entry in self.entries)
        return "gpu" if known and not self.software else "wall"

    @property
    def shown(self) -> tuple[Entry, ...]:
        """Entries for graphs over the flight and pictures: of several numbers of triangles only the first; those of
        sweeps only where there are no others.
        """
        first = next((entry.target["triangles"] for entry in self.entries if entry.target), None)
        entries = tuple(entry for entry in self.entries if not entry.target or entry.target["triangles"] == first)
        return tuple(entry for entry in entries if entry.sweep is None) or entries

    @cached_property
    def styles(self) -> dict[str, int]:
        """Number of the line style by label; the entries of a sweep share one, as does an entry at several numbers of
        triangles.
        """
        keys = {
            entry.label: sweep_key(entry) or (str(entry.target["label"]) if entry.target else entry.label,)
            for entry in self.entries
        }
        numbers = {key: number for number, key in enumerate(dict.fromkeys(keys.values()))}
        return {label: numbers[key] for label, key in keys.items()}

    @property
    def sweeps(self) -> dict[tuple[str, str], list[Entry]]:
        """Entries by algorithm and swept setting, in the order of the setting's values."""
        found: dict[tuple[str, str], list[Entry]] = {}
        for entry in self.entries:
            if key := sweep_key(entry):
                found.setdefault(key, []).append(entry)
        return {key: sorted(entries, key=_swept_value) for key, entries in found.items()}


def sweep_key(entry: Entry) -> tuple[str, str] | None:
    """Algorithm (at a number of triangles, if there are several) and setting of the sweep that an entry belongs to;
    None where it belongs to none.
    """
    at = f" at {entry.target['triangles']:,} triangles" if entry.target else ""
    return (entry.algorithm + at, str(entry.sweep["setting"])) if entry.sweep else None


def _swept_value(entry: Entry) -> tuple[bool, float, str]:
    value = entry.sweep["value"] if entry.sweep else None
    number = isinstance(value, int | float)
    return not number, float(value) if number and value is not None else 0.0, str(value)


def read(folder: Path) -> Comparison:
    """Read a comparison's folder, finished or not.

    Raises SettingsError where it holds no comparison, one of another format, or a file that cannot be read.
    """
    path = folder / "plan.json"
    if not path.is_file():
        raise SettingsError(f"{folder}: expected the folder of a comparison, got one without plan.json")
    plan = _parse(path.read_text(encoding="utf-8"), f"{path}")
    if plan.get("format") != FORMAT:
        raise SettingsError(f"{path}: expected format {FORMAT}, got {plan.get('format')!r}; compare anew")
    return Comparison(folder, plan, tuple(_entry(folder, entry) for entry in plan.get("entries", ())))


def _entry(folder: Path, entry: Mapping[str, Any]) -> Entry:
    name = entry.get("folder") or entry["label"]
    path = folder / "frames" / f"{name}.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    frames = [_parse(line, f"{path}, line {n}") for n, line in enumerate(lines, start=1) if line.strip()]
    frames.sort(key=lambda frame: frame["frame"])
    settings = entry.get("settings", {})
    return Entry(
        entry["label"], entry["algorithm"], settings, entry.get("given", {}),
        entry.get("calibrated"), entry.get("sweep"), name, tuple(frames), entry.get("target"),
    )  # fmt: skip


def _parse(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise SettingsError(f"{where}: expected JSON, got something else: {error}") from error


def flatten(frame: Mapping[str, Any]) -> Row:
    """A record's numbers by flat names: "forward.p99", "gpu" (total ms) and "gpu.PASS", "memory.gpu.CATEGORY" ...

    "error.mean", "error.p99" and "error.max" are the larger of the two directions of the screen-space error.
    """
    row: Row = {}
    for name, value in frame.items():
        if name == "memory":
            categories = (value or {}).get("gpu") or {}
            row["memory.gpu"] = _total(categories)
            row |= {f"memory.gpu.{category}": _number(size) for category, size in categories.items()}
            row["memory.host"] = _number((value or {}).get("host"))
        elif name == "gpu":
            row["gpu"] = _total(value or {})
            row |= {f"gpu.{part}": _number(time) for part, time in (value or {}).items()}
        elif isinstance(value, Mapping):
            row |= {f"{name}.{part}": _number(number) for part, number in value.items()}
        else:
            row[name] = _number(value)
    for part in ("mean", "p99", "max"):
        both = [row.get(f"forward.{part}"), row.get(f"backward.{part}")]
        known = [value for value in both if value is not None]
        if known:
            row[f"error.{part}"] = max(known)
    return row


def _total(parts: Mapping[str, Any]) -> float | None:
    known = [value for value in map(_number, parts.values()) if value is not None]
    return math.fsum(known) if known else None


def _number(value: Any) -> float | None:
    """Records write an infinite number as the text "inf"."""
    if value is None or isinstance(value, bool):
        return None
    number = float(value)
    return None if math.isnan(number) else number


def summarise(values: Sequence[float | None]) -> dict[str, float] | None:
    """Count, minimum, average, maximum and percentiles of the values that there are; None where there is none.

    The average is that of the finite values (equal pictures have an infinite PSNR), and infinite only without any.
    A percentile is the smallest value that so many per cent of the values do not exceed.
    """
    known = np.array([value for value in values if value is not None], np.float64)
    if not known.size:
        return None
    finite = known[np.isfinite(known)]
    statistics = {
        "count": known.size,
        "min": float(known.min()),
        "mean": float(finite.mean()) if finite.size else float(known[0]),
        "max": float(known.max()),
    }
    parts = np.percentile(known, PERCENTILES, method="inverted_cdf")
    return statistics | {f"p{share}": float(part) for share, part in zip(PERCENTILES, parts, strict=True)}


def _over_all(mse: float, values: Sequence[float | None]) -> dict[str, float]:
    """PSNR of all frames as one picture, which is defined with equal frames too, and how many frames are equal."""
    from orogen.compare.metrics import psnr_of

    return {"pooled": psnr_of(mse), "equal": sum(value == math.inf for value in values)}
