"""The folder of a comparison: what was asked for, a line per finished frame, pictures.

It is written so that an interruption at any time loses at most the frame in work.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import OutputError
from orogen.view.image import write_color
from orogen.view.output import publish

FORMAT = 1
PLAN = "plan.json"
OURS = (PLAN, "frames", "pictures", "results.json", "summary.csv", "frames.csv", "report.html")
"""Names of what a comparison writes; nothing else in its folder is ever touched."""


class Record:
    """An open folder."""

    def __init__(self, folder: Path) -> None:
        """Use `Record.open`."""
        self.folder = folder

    @staticmethod
    def check(folder: Path, request: Mapping[str, Any]) -> None:
        """Raise OutputError where the folder holds something else than a comparison that may go on.

        `request`: what the results depend on, in types of JSON, as far as it is known.
        """
        found = _plan(folder)
        if found is None:
            if folder.is_dir() and any(folder.iterdir()):
                raise OutputError(f"{folder}: expected a new folder or a comparison to go on with, got other files")
        elif different := _differences(found.get("request"), request):
            raise OutputError(
                f"{folder}: holds a comparison of another plan ({different}); choose another folder, or replace it "
                "(--force)"
            )

    @classmethod
    def open(
        cls, folder: Path, request: Mapping[str, Any], force: bool = False
    ) -> tuple[Record, dict[str, Any] | None]:
        """The folder for a comparison, and the plan that is in it where it is the same one and goes on.

        `force`: replace a comparison of another plan. Raises OutputError as `check` does, and where the folder cannot
        be written.
        """
        found = _plan(folder)
        if found is not None and found.get("request") == request:
            return cls(folder), found
        if not force:
            cls.check(folder, request)
        record = cls(folder)
        try:
            for name in OURS:
                path = folder / name
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error
        return record, None

    def write_plan(self, plan: Mapping[str, Any]) -> None:
        """Write plan.json."""
        with publish(self.folder / PLAN, (".json",), overwrite=True) as path:
            path.write_text(json.dumps(plan, indent=1) + "\n", encoding="utf-8")

    def finished(self, name: str) -> list[int]:
        """Numbers of an entry's finished frames in their order; a line that was cut off is removed."""
        path = self._lines(name)
        try:
            text = path.read_bytes()
        except FileNotFoundError:
            return []
        whole = text.rfind(b"\n") + 1
        if whole < len(text):
            os.truncate(path, whole)
        return [json.loads(line)["frame"] for line in text[:whole].splitlines()]

    def add(self, name: str, line: Mapping[str, Any]) -> None:
        """Append a finished frame of an entry."""
        path = self._lines(name)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with open(path, "ab", buffering=0) as file:
                file.write(json.dumps(line).encode() + b"\n")
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error

    def picture(self, name: str, number: int, color: NDArray[np.uint8], kind: str = "") -> None:
        """Keep a picture of a frame: pictures/NAME/NNNN.png, or NNNN_KIND.png."""
        path = self.picture_path(name, number, kind)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
        write_color(path, color[..., :3], overwrite=True)

    def picture_path(self, name: str, number: int, kind: str = "") -> Path:
        """Where a picture of a frame is kept."""
        return self.folder / "pictures" / name / f"{number:04d}{kind and '_' + kind}.png"

    def _lines(self, name: str) -> Path:
        return self.folder / "frames" / f"{name}.jsonl"


def _plan(folder: Path) -> dict[str, Any] | None:
    try:
        found = json.loads((folder / PLAN).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _differences(old: Any, new: Mapping[str, Any]) -> str:
    """What two plans differ in, of what the new one says; empty where in nothing."""
    if not isinstance(old, Mapping):
        return "its plan cannot be read"
    names = [key for key in new if old.get(key) != new[key]]
    return f"another {', '.join(names)}" if names else ""
