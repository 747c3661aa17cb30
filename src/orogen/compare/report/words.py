"""Values of a plan in words."""

from __future__ import annotations

import json
from collections.abc import Mapping
from html import escape
from pathlib import PurePath
from typing import Any

from orogen.compare.report.results import Comparison
from orogen.compare.report.svg import number

NOTHING = "–"


def words(value: Any) -> str:
    """A value of any kind, for people; a dash for None."""
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return number(value, 6)
    if isinstance(value, int):
        return number(value, 16) if abs(value) >= 10_000 else str(value)
    if isinstance(value, list | tuple):
        return ", ".join(map(words, value)) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {words(part)}" for name, part in value.items()) or "none"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def definitions(values: Mapping[str, Any], kind: str = "") -> str:
    """A list of names and values."""
    rows = "".join(
        f"<div><dt>{escape(str(name).replace('_', ' '))}</dt><dd>{escape(words(value))}</dd></div>"
        for name, value in values.items()
    )
    return f'<dl class="{kind}">{rows}</dl>'


def data_name(comparison: Comparison) -> str:
    """The name of the data alone: where it lay says nothing to a reader."""
    data = str(comparison.plan.get("data", NOTHING))
    return PurePath(data.replace("\\", "/")).name or data


def picture_size(comparison: Comparison) -> str:
    """Width and height of the pictures."""
    width, height = comparison.plan.get("size", (NOTHING, NOTHING))
    return f"{width} × {height} pixels"


def time_of(comparison: Comparison, frame: int) -> str:
    """A comma and the time of a frame in the flight; nothing where no entry has it."""
    times = [row.get("time") for entry in comparison.entries for row in entry.rows if row.get("frame") == frame]
    known = [time for time in times if time is not None]
    return f", {number(known[0])} s" if known else ""
