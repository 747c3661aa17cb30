"""Cameras with names, kept for each data set in the user's configuration folder."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from orogen.camera import Camera
from orogen.errors import OutputError, SettingsError
from orogen.view.output import publish

log = logging.getLogger("orogen")


def bookmark_folder() -> Path:
    """The folder of bookmarks: the environment variable OROGEN_CONFIG_DIR, else the user's configuration folder."""
    from platformdirs import user_config_path

    given = os.environ.get("OROGEN_CONFIG_DIR")
    return (Path(given) if given else user_config_path("orogen", appauthor=False)) / "bookmarks"


LONGEST = 60
"""Letters of a name."""


class Bookmarks:
    """The bookmarks of one data set; every change is written at once."""

    def __init__(self, data: str, folder: Path | None = None, *, kept: bool = True) -> None:
        """`data`: what names the data set, such as its path. `kept`: whether there is a file."""
        self._data = data
        name = hashlib.sha256(data.encode()).hexdigest()[:24]
        self._path = (folder or bookmark_folder()) / f"{name}.json"
        self._kept = kept
        self._cameras = self._read() if kept else {}

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """Cameras by name, in the order in which they were added."""
        return self._cameras

    def add(self, name: str, camera: Camera) -> None:
        """Keep a camera. Raises SettingsError for a name that cannot be, OutputError where it cannot be written."""
        name = name.strip()
        if not 0 < len(name) <= LONGEST:
            raise SettingsError(f"bookmark: expected a name of 1 to {LONGEST} letters, got {len(name)}")
        self._write({**self._cameras, name: camera})

    def remove(self, name: str) -> None:
        """Forget a camera."""
        self._write({key: camera for key, camera in self._cameras.items() if key != name})

    def _read(self) -> dict[str, Camera]:
        try:
            stored = json.loads(self._path.read_text(encoding="utf-8"))
            return {str(name): Camera(**values) for name, values in stored["cameras"].items()}
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            # kept beside: a file that cannot be read is never written over
            log.warning("bookmarks: %s cannot be read (%s); a new file is begun and this one kept", self._path, error)
            self._path = self._path.with_suffix(".new.json")
            return {}

    def _write(self, cameras: dict[str, Camera]) -> None:
        if not self._kept:
            self._cameras = cameras
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self._path.parent}: cannot be written: {error.strerror or error}") from error
        content = {"data": self._data, "cameras": {name: asdict(camera) for name, camera in cameras.items()}}
        with publish(self._path, (".json",), overwrite=True) as temporary:
            temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        self._cameras = cameras
