"""`orogen bench`: speed, memory and exactness, each against its target."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from orogen.cli import console
from orogen.cli.parameters import Json
from orogen.errors import SettingsError

if TYPE_CHECKING:
    from orogen.cli.measure import Figure

DATA_VARIABLE = "OROGEN_TEST_DATA"
"""Environment variable that names the folder of test data."""
DATA_SIDE = ("pyramid", "large", "endless", "queries")
"""What `--data` measures."""


def bench(
    data: Path | None = None,
    /,
    *,
    data_side: Annotated[bool, Parameter(name="--data", negative="", show_default=False)] = False,
    only: Annotated[list[str] | None, Parameter(negative="", metavar="NAME")] = None,
    json: Json = False,
) -> None:
    """Measure speed, memory and exactness, each against its target.

    Parameters
    ----------
    data
        Folder with the test data. [default: OROGEN_TEST_DATA, else ../shared/data]
    data_side
        Measure what building, opening and asking take: pyramid, large, endless and queries.
    only
        Measure just this: speed, pyramid, record, passes, accuracy, rays, queries, large, endless or
        views; repeat for several.
    """
    from orogen.cli.measure import MEASUREMENTS

    folder = data or Path(os.environ.get(DATA_VARIABLE) or "../shared/data")
    if not folder.is_dir():
        raise SettingsError(f"{folder}: expected a folder with test data; give one or set {DATA_VARIABLE}")
    for name in only or ():
        if name not in MEASUREMENTS:
            raise SettingsError(f"--only: expected one of {', '.join(MEASUREMENTS)}, got {name!r}")
    figures: list[Figure] = []
    chosen = [*(only or ()), *(DATA_SIDE if data_side else ())]
    with console.progress() as report:
        for name in dict.fromkeys(chosen or MEASUREMENTS):
            figures += MEASUREMENTS[name](folder, report)
    result: dict[str, Any] = {"figures": [{**asdict(figure), "met": figure.met} for figure in figures]}
    console.show(result, json, table(figures))


def table(figures: Sequence[Figure]) -> list[str]:
    """A line for each figure, in columns."""
    header = ("what", "value", "target", "")
    rows = [header]
    for figure in figures:
        target = "" if figure.target is None else f"<= {_number(figure.target)} {figure.unit}".rstrip()
        value = "-" if figure.value is None else f"{_number(figure.value)} {figure.unit}".rstrip()
        verdict = {True: "met", False: "MISSED", None: figure.note}[figure.met]
        rows.append((f"{figure.group}: {figure.name}", value, target, verdict))
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    return ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _number(value: float) -> str:
    return f"{value:.0f}" if float(value).is_integer() else f"{value:.3g}"
