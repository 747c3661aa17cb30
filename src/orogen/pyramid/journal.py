"""What the tasks of a build have handed back, kept beside the levels so that a killed build can go on."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orogen.pyramid.region import Strips
from orogen.pyramid.store import write_whole
from orogen.pyramid.task import Part

SIDES = ("top", "bottom", "left", "right")


@dataclass(frozen=True)
class Journal:
    """A folder with a file for each task that is done. A file is there in whole or not at all."""

    folder: Path

    def load(self, name: str) -> Part | None:
        """What the task handed back; None where it is not done."""
        try:
            with np.load(self.folder / f"{name}.npz", allow_pickle=False) as found:
                count = int(found["levels"])
                return Part(
                    [found[f"steps{i}"] for i in range(count)],
                    [Strips(*(found[f"{side}{i}"] for side in SIDES)) for i in range(count)],
                    found.get("nodes"),
                )
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def save(self, name: str, part: Part) -> None:
        """Note that a task is done; all that it wrote must be on the disk."""
        values: dict[str, Any] = {f"steps{i}": steps for i, steps in enumerate(part.steps)}
        for i, strips in enumerate(part.strips):
            values |= {f"{side}{i}": getattr(strips, side) for side in SIDES}
        if part.nodes is not None:
            values["nodes"] = part.nodes
        content = io.BytesIO()
        np.savez(content, levels=len(part.steps), **values)
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(self.folder / f"{name}.npz", content.getvalue())

    def done(self, name: str) -> bool:
        """Whether the task is noted."""
        return (self.folder / f"{name}.npz").exists()
