"""Files that appear whole or not at all: checked before the work, written beside their place, renamed when complete."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from orogen.errors import OutputError


def check_output(path: str | os.PathLike[str], suffixes: Sequence[str], overwrite: bool = False) -> Path:
    """`path` as a Path that can be written; called before a long computation, so that it is not done in vain.

    `suffixes` are the accepted file name endings in lower case, with their dot. Raises OutputError where the suffix is
    another one, the folder is missing or not writable, or the file exists and `overwrite` is false.
    """
    path = Path(path)
    if "\0" in str(path):
        raise OutputError(f"{str(path)!r}: expected a file name, got one with a zero character")
    if path.suffix.lower() not in suffixes:
        got = repr(path.suffix) if path.suffix else "none"
        raise OutputError(f"{path}: expected the suffix {' or '.join(suffixes)}, got {got}")
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(f"{path}: the folder {folder} does not exist; create it first")
    if path.is_dir():
        raise OutputError(f"{path}: expected a file name, got a folder")
    if not os.access(folder, os.W_OK):
        raise OutputError(f"{path}: the folder {folder} is not writable")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: exists already; choose another name or overwrite it (overwrite=True, --overwrite)")
    return path


@contextlib.contextmanager
def publish(path: str | os.PathLike[str], suffixes: Sequence[str], overwrite: bool = False) -> Iterator[Path]:
    """Gives the name of a temporary file in the same folder; renames it to `path` at the end, removes it on failure.

    Raises OutputError as `check_output` does, and where the file cannot be written.
    """
    path = check_output(path, suffixes, overwrite)
    # the suffix stays last: writers choose the format by it
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        check_output(path, suffixes, overwrite)
        os.replace(temporary, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
