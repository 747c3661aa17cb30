"""Folders that take each other's place at once."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import sys
import time
from pathlib import Path

_AT_FDCWD, _EXCHANGE, _SWAP = -100, 2, 2


def exchange(new: Path, old: Path) -> None:
    """Let `new` and `old`, both there and on one file system, change names in one step where the system can do that.

    Where it cannot, `old` is moved aside first: for an instant nothing is at its place, and a process killed in that
    instant leaves it beside, named `.replaced`; `recover` brings it back.
    """
    if _exchanged(new, old):
        return
    aside = _aside(old)
    old.rename(aside)
    try:
        new.rename(old)
    except OSError:
        aside.rename(old)
        raise
    aside.rename(new)


def recover(path: Path) -> None:
    """Bring back what an `exchange` that was killed has left beside."""
    aside = _aside(path)
    if aside.exists() and not path.exists():
        with contextlib.suppress(OSError):
            aside.rename(path)


def linked_copy(source: Path, target: Path) -> None:
    """A copy of a folder that shares its files with it, where the file system can do that; never write into those."""

    def link(file: str, place: str) -> str:
        try:
            os.link(file, place)
        except OSError:
            shutil.copy2(file, place)
        return place

    shutil.copytree(source, target, copy_function=link)


def remove(path: Path) -> None:
    """Remove a file or folder, if it is there; a folder is renamed first, so that nobody takes it for whole."""
    if not path.is_dir():
        path.unlink(missing_ok=True)
        return
    doomed = path.with_name(f"{path.name}.removed-{os.getpid()}-{time.monotonic_ns()}")
    path.rename(doomed)
    shutil.rmtree(doomed, ignore_errors=True)


def _aside(path: Path) -> Path:
    return path.with_name(f"{path.name}.replaced")


def _exchanged(new: Path, old: Path) -> bool:
    """Ask the system for it; whether it has done so."""
    try:
        library = ctypes.CDLL(None, use_errno=True)
        if sys.platform == "linux":
            call = library.renameat2
            code = call(_AT_FDCWD, os.fsencode(new), _AT_FDCWD, os.fsencode(old), ctypes.c_uint(_EXCHANGE))
        elif sys.platform == "darwin":
            code = library.renamex_np(os.fsencode(new), os.fsencode(old), ctypes.c_uint(_SWAP))
        else:
            return False
    except (OSError, AttributeError, TypeError):
        return False
    return bool(code == 0)
