"""Measuring instruments and the comparison that uses them on every algorithm.

The instruments (true surface, screen-space errors, cracks, standard views) read depth pictures and height arrays and
share no code with what draws them. `run` flies a `Plan` with every entry and writes a report.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orogen.compare.plan import Entry, Plan
    from orogen.compare.runner import run

__all__ = ["Entry", "Plan", "run"]

_HOMES = {"Entry": "orogen.compare.plan", "Plan": "orogen.compare.plan", "run": "orogen.compare.runner"}


def __getattr__(name: str) -> Any:
    # each name is imported when it is first asked for: the instruments need neither GPU nor files
    if name not in _HOMES:
        raise AttributeError(f"module 'orogen.compare' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
