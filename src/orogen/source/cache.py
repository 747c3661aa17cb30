"""The folder of built pyramids, terrains and remote blocks: where it is, what is in it, and what has to go."""

from __future__ import annotations

import logging
import os
import re
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from orogen.errors import SettingsError

log = logging.getLogger("orogen")

DEFAULT_MAX = 20 * 10**9
"""Bytes that the cache may hold unless OROGEN_CACHE_MAX says otherwise."""
MARK = "in-use"
"""File in an entry: locked while it is used or built, its time of change is that of the last use."""
BUILDING = ".building-"
"""Part of the name of an entry that is not complete."""


@dataclass(frozen=True)
class Entry:
    """A pyramid, a terrain or the blocks of a remote file in the cache."""

    path: Path
    size: int
    """Bytes."""
    used: float
    """Seconds since the epoch of the last use."""


@dataclass(frozen=True)
class CacheInfo:
    """What the cache holds."""

    path: Path
    maximum: int
    """Bytes that it may hold."""
    entries: list[Entry]
    """Least recently used first."""

    @property
    def size(self) -> int:
        """Bytes that it holds."""
        return sum(entry.size for entry in self.entries)


def cache_dir() -> Path:
    """The cache folder: OROGEN_CACHE_DIR, else the user's cache folder of this platform. It need not exist yet."""
    if given := os.environ.get("OROGEN_CACHE_DIR"):
        return Path(given).expanduser().absolute()
    from platformdirs import user_cache_dir

    return Path(user_cache_dir("orogen", appauthor=False))


def cache_max() -> int:
    """Bytes that the cache may hold: OROGEN_CACHE_MAX, such as 500MB or 20GB, else 20 GB."""
    text = os.environ.get("OROGEN_CACHE_MAX", "").strip()
    if not text:
        return DEFAULT_MAX
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)B?", text, re.IGNORECASE)
    if not found:
        raise SettingsError(f"OROGEN_CACHE_MAX: expected a size such as 500MB or 20GB, got {text!r}")
    return int(float(found[1]) * 1000 ** " KMGT".index(found[2].upper() or " "))


def info(folder: Path | None = None) -> CacheInfo:
    """What the cache holds."""
    folder = folder or cache_dir()
    entries = [_entry(path) for path in folder.iterdir() if _is_ours(path)] if folder.is_dir() else []
    return CacheInfo(folder, cache_max(), sorted(entries, key=lambda entry: entry.used))


def clear(folder: Path | None = None) -> int:
    """Remove every entry that nobody uses; returns the bytes freed."""
    return sum(entry.size for entry in info(folder).entries if remove(entry.path))


def tidy(folder: Path, room: int = 0) -> None:
    """Remove what killed builds left, then the least recently used entries until the budget has `room` bytes left."""
    current = info(folder)
    excess = current.size + room - current.maximum
    for entry in current.entries:
        if (BUILDING in entry.path.name or excess > 0) and remove(entry.path):
            excess -= entry.size


def remove(path: Path) -> bool:
    """Remove an entry unless it is in use; whether it is gone."""
    try:
        with open(path / MARK, "r+b") as mark:
            if not lock(mark, shared=False):
                return False
            if sys.platform == "win32":
                mark.close()
            # renamed first, so that nobody opens one that is half gone
            doomed = path.with_name(f"{path.name}{BUILDING}removed-{os.getpid()}-{time.monotonic_ns()}")
            path.rename(doomed)
    except FileNotFoundError:
        # a build that was killed before it made its mark
        if BUILDING not in path.name:
            return False
        doomed = path
    except OSError as error:
        log.warning("%s: cannot be removed: %s", path, error)
        return False
    shutil.rmtree(doomed, ignore_errors=True)
    return True


def hold(path: Path) -> IO[bytes] | None:
    """Mark an entry as used now and in use until the returned file is closed; None where there is no such entry."""
    try:
        mark = open(path / MARK, "a+b")  # noqa: SIM115
    except OSError:
        return None
    if not lock(mark, shared=True) or not (path / MARK).exists():
        mark.close()
        return None
    os.utime(path / MARK)
    return mark


@contextmanager
def building(path: Path) -> Iterator[Path]:
    """A folder beside `path` to build an entry in, in use meanwhile; on success it is renamed to `path`.

    Where another process was quicker its entry stays and this one is dropped.
    """
    for _ in range(5):  # another process may tidy the folder away before it is marked
        draft = path.with_name(f"{path.name}{BUILDING}{os.getpid()}-{time.monotonic_ns()}")
        draft.mkdir(parents=True)
        if mark := hold(draft):
            break
        shutil.rmtree(draft, ignore_errors=True)
    else:
        raise OSError(f"{draft}: cannot be written or locked")
    try:
        with mark:
            yield draft
        try:
            draft.rename(path)
        except OSError:
            if not path.exists():
                raise
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _is_ours(path: Path) -> bool:
    """Whether a folder is an entry, so that nothing else is ever removed, wherever OROGEN_CACHE_DIR points."""
    return path.is_dir() and (BUILDING in path.name or (path / MARK).is_file())


def _entry(path: Path) -> Entry:
    sizes = []
    for folder, _, names in os.walk(path):
        for name in names:
            try:
                sizes.append(os.stat(os.path.join(folder, name)).st_size)
            except OSError:
                continue
    try:
        used = os.stat(path / MARK).st_mtime
    except OSError:
        used = 0.0
    return Entry(path, sum(sizes), used)


def lock(file: IO[bytes], shared: bool) -> bool:
    """Lock an open file without waiting, until it is closed; whether that succeeded."""
    if sys.platform == "win32":  # there an open file keeps its folder from being renamed or removed
        return True
    import fcntl

    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:  # as on network drives without locks
        log.debug("%s: cannot be locked: %s", file.name, error)
    return True
