"""Frames of a comparison that the workers of a Dask cluster measure."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.compare.plan import Entry, Plan
from orogen.source.mosaic import absolute

CHUNK = 8
"""Frames of a task, one after the other: the first one of each is led up to anew."""


@dataclasses.dataclass
class Collected:
    """Takes what a comparison writes down, to be sent; has the methods of `Record` that measuring calls."""

    lines: list[tuple[str, dict[str, Any]]] = dataclasses.field(default_factory=list)
    """Folder of the entry, and what was measured of a frame."""
    pictures: list[tuple[str, int, NDArray[np.uint8], str]] = dataclasses.field(default_factory=list)
    """Arguments of `Record.picture`."""

    def finished(self, name: str) -> list[int]:
        """Nothing is finished."""
        return []

    def add(self, name: str, line: dict[str, Any]) -> None:
        """Take what was measured of a frame."""
        self.lines.append((name, line))

    def picture(self, name: str, number: int, color: NDArray[np.uint8], kind: str = "") -> None:
        """Take a picture."""
        self.pictures.append((name, number, color, kind))


def chunks(numbers: Sequence[int]) -> Iterator[list[int]]:
    """The frames of each task."""
    for start in range(0, len(numbers), CHUNK):
        yield list(numbers[start : start + CHUNK])


def packed(plan: Plan) -> dict[str, Any]:
    """A plan in values that can be sent, but for its entries and what has been done for them."""
    found = {field.name: getattr(plan, field.name) for field in dataclasses.fields(plan)}
    for name in ("entries", "equal_triangles", "equal_time"):
        del found[name]
    # only what names files: a CRS in WKT looks like a pattern
    options = {name: absolute(value) if name == "color" else value for name, value in plan.options.items()}
    return found | {
        "data": absolute(plan.data),
        "options": options,
        "streaming": dict(plan.streaming),
        "flight": absolute(plan.flight),
    }


def packed_entry(entry: Entry) -> tuple[str, dict[str, Any], str, str | None]:
    """An entry in values that can be sent: the arguments of `Entry`."""
    return entry.algorithm, dict(entry.settings), entry.label, entry.sweep


def measure(
    plan: dict[str, Any], entry: tuple[str, dict[str, Any], str, str | None], numbers: list[int], kept: list[int],
    chosen: frozenset[str],
) -> Collected:  # fmt: skip
    """Measure some frames of an entry. kept: frames whose pictures are kept; chosen: metrics."""
    from orogen.compare.runner import measure_frames

    found = Entry(*entry)
    return measure_frames(Plan(entries=(found,), **plan), found, numbers, kept, chosen)
