"""The report of a comparison: one self-contained page, and the results as JSON and CSV."""

from __future__ import annotations

import os
from pathlib import Path

from orogen.compare.report.export import frames_csv, results_json, summary_csv
from orogen.compare.report.page import page
from orogen.compare.report.results import read
from orogen.view.output import publish


def write(folder: str | os.PathLike[str]) -> Path:
    """Write report.html, results.json, summary.csv and frames.csv into a comparison's folder; gives the page's path.

    The folder may be of an unfinished comparison: the page then says what is missing. Earlier files of these names are
    replaced. Raises SettingsError where the folder holds no comparison or a damaged one, OutputError where it cannot be
    written.
    """
    comparison = read(Path(folder))
    files = {
        "results.json": results_json(comparison),
        "summary.csv": summary_csv(comparison),
        "frames.csv": frames_csv(comparison),
        "report.html": page(comparison),
    }
    for name, text in files.items():
        path = comparison.folder / name
        with publish(path, (path.suffix,), overwrite=True) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    return comparison.folder / "report.html"
