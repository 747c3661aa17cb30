"""The results as files for other programs: results.json, summary.csv, frames.csv."""

from __future__ import annotations

import csv
import io
import json
import math
from typing import Any

from orogen.compare.report import targets
from orogen.compare.report.results import Comparison

STATISTICS = ("count", "min", "mean", "max", "p50", "p95", "p99")


def results_json(comparison: Comparison) -> str:
    """Plan, tables at equal triangles, statistics, records. Strict JSON: null: no value; "inf": infinite."""
    entries = [
        {"label": entry.label, "algorithm": entry.algorithm, "summary": entry.summary, "frames": list(entry.frames)}
        for entry in comparison.entries
    ]
    document = _strict({"plan": comparison.plan, "targets": targets.rows(comparison), "entries": entries})
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def summary_csv(comparison: Comparison) -> str:
    """One line per entry and metric: its statistics over the flight; names as in frames.csv."""
    lines: list[list[Any]] = [["label", "algorithm", "metric", *STATISTICS]]
    for entry in comparison.entries:
        for metric, statistics in entry.summary.items():
            lines.append([entry.label, entry.algorithm, metric, *(statistics[name] for name in STATISTICS)])
    return _csv(lines)


def frames_csv(comparison: Comparison) -> str:
    """One line per entry and frame; a field is empty where there is no value, "inf" for an infinite one."""
    rows = [(entry, row) for entry in comparison.entries for row in entry.rows]
    names = list(dict.fromkeys(["frame", "time", *(name for _, row in rows for name in row)]))
    lines: list[list[Any]] = [["label", "algorithm", *names]]
    lines += [[entry.label, entry.algorithm, *(row.get(name) for name in names)] for entry, row in rows]
    return _csv(lines)


def _csv(lines: list[list[Any]]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows([_whole(value) for value in line] for line in lines)
    return file.getvalue()


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _strict(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _strict(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value
