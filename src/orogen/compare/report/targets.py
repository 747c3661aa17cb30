"""Entries at equal numbers of triangles: what each of them makes of as many as it was asked to take."""

from __future__ import annotations

from typing import Any

from orogen.compare.report.results import Comparison, Entry
from orogen.compare.report.svg import number
from orogen.compare.report.tables import Column, count, decibels, entry_table, milliseconds, pixels

TRIANGLES = Column("Triangles", "triangles", show=count)
COLUMNS = (
    TRIANGLES,
    Column("Error, mean (px)", "error.mean", show=pixels, best="low"),
    Column("Error, largest (px)", "error.max", "max", pixels, "low"),
    Column("PSNR (dB)", "psnr", "pooled", decibels, "high"),
    Column("GPU (ms)", "gpu", show=milliseconds, best="low"),
    Column("CPU (ms)", "cpu", show=milliseconds, best="low"),
    Column("Wall clock (ms)", "wall", show=milliseconds, best="low"),
)
KEYS = ("triangles", "error_mean", "error_max", "psnr", "gpu", "cpu", "wall")
"""Of the columns in `rows`."""


def groups(comparison: Comparison) -> dict[int | None, list[Entry]]:
    """Entries by the number of triangles that they were asked for, in its order; last, under None, those that cannot
    be set to any. Empty where the comparison asked for none.
    """
    asked = comparison.plan.get("equal_triangles")
    if not asked:
        return {}
    numbers: list[int | None] = [*(asked if isinstance(asked, list | tuple) else [asked]), None]
    found = {number: [entry for entry in comparison.entries if _asked(entry) == number] for number in numbers}
    return {number: entries for number, entries in found.items() if entries}


def rows(comparison: Comparison) -> list[dict[str, Any]]:
    """What the tables show, in the order of `groups`.

    `target`: triangles asked for, `met`: whether about as many are drawn, `setting` and `value`: what was set so; all
    four None for an entry without such a setting. The rest is measured: means over the flight, the largest error of all
    frames (the larger of both ways), the PSNR of all frames as one picture; None where there is no value.
    """
    return [
        {
            "target": target,
            "label": base_label(entry),
            "algorithm": entry.algorithm,
            "met": met(entry),
            **{name: (entry.calibrated or {}).get(name) for name in ("setting", "value")},
            **{key: column.read(entry) for key, column in zip(KEYS, COLUMNS, strict=True)},
        }
        for target, entries in groups(comparison).items()
        for entry in entries
    ]


def met(entry: Entry) -> bool | None:
    """Whether an entry takes about as many triangles as it was asked for; None where it was not."""
    return None if entry.calibrated is None else bool(entry.calibrated.get("met", True))


def base_label(entry: Entry) -> str:
    """The label that an entry has at any number of triangles."""
    return str(entry.target["label"]) if entry.target else entry.label


def text(comparison: Comparison) -> list[str]:
    """The tables as lines of text."""
    lines = []
    for target, entries in groups(comparison).items():
        cells = [[_title(target), *(column.title for column in COLUMNS)]]
        for entry in entries:
            values = [(column, column.read(entry)) for column in COLUMNS]
            shown = ["-" if value is None else column.show(value).replace("\u202f", " ") for column, value in values]
            cells.append([base_label(entry), *shown])
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for row in cells:
            first, *rest = (f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True))
            lines.append("  ".join([f"{row[0]:<{len(first)}}", *rest]))
        lines += [*_misses(target, entries), ""]
    return lines


def section(comparison: Comparison) -> str:
    """The tables as HTML."""
    parts = ""
    for target, entries in groups(comparison).items():
        notes = "".join(f'<p class="notes">{line}</p>' for line in _misses(target, entries))
        caption = f"<b>{_title(target)}.</b> Errors are the larger of the two ways; PSNR is that of all frames as one."
        parts += entry_table(comparison, caption, COLUMNS, entries=entries) + notes
    return parts


def _asked(entry: Entry) -> int | None:
    return None if entry.calibrated is None else round(entry.calibrated["target"])


def _title(target: int | None) -> str:
    return "As they are" if target is None else f"{target:,} triangles"


def _misses(target: int | None, entries: list[Entry]) -> list[str]:
    lines = []
    for entry in entries:
        if met(entry) is False and entry.calibrated:
            found = entry.calibrated
            lines.append(
                f"{base_label(entry)} does not come nearer to {target:,} triangles than {found['reached']:,.0f} "
                f"({found['setting']} = {number(found['value'])})."
            )
    return lines
