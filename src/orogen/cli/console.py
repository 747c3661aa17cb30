"""What the command says: results on stdout, log, progress and errors on stderr."""

from __future__ import annotations

import contextlib
import json
import logging
import math
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

Report = Callable[[float, str], None]
"""Called with the part done (0 to 1) and what is being done, from any thread."""

LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)

_verbose = 0
_quiet = False


def start(verbose: int, quiet: bool) -> None:
    """Send the log of orogen, and with -v that of the libraries, to stderr."""
    global _verbose, _quiet
    _verbose, _quiet = verbose, quiet
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Format())
    log = logging.getLogger("orogen")
    log.handlers[:] = [handler]
    log.propagate = False
    log.setLevel(logging.ERROR if quiet else LEVELS[min(verbose, 2)])
    # libraries explain in their own words what orogen says in one line
    logging.captureWarnings(True)
    others = logging.getLogger()
    others.handlers[:] = [handler if verbose else logging.NullHandler()]
    others.setLevel(logging.DEBUG if verbose > 2 else logging.WARNING)


def error(message: str) -> None:
    """Say in one go what went wrong; with -vv also where."""
    if _verbose > 1 and sys.exc_info()[1]:
        traceback.print_exc()
    sys.stderr.write(f"orogen: error: {message}\n")


def note(message: str) -> None:
    """Say something in advance, unless told to be quiet."""
    if not _quiet:
        sys.stderr.write(f"orogen: {message}\n")


@contextlib.contextmanager
def progress() -> Iterator[Report]:
    """Bars on stderr, one for each thing that is done; nothing without a terminal or with -q."""
    if _quiet or not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(fraction: float, text: str) -> None:
            if text not in tasks:
                tasks[text] = bars.add_task(text, total=1.0)
            bars.update(tasks[text], completed=fraction)

        yield report


def show(result: Mapping[str, Any], as_json: bool, lines: Sequence[str] | None = None) -> None:
    """Write a result to stdout: as JSON, or as `lines`, by default "key  value" for each entry."""
    if as_json:
        text = json.dumps(plain(result), indent=2, ensure_ascii=False)
    else:
        text = "\n".join(table(result) if lines is None else lines)
    sys.stdout.write(text + "\n")
    # a pipe would keep it until the end, which a server only reaches when it is told to
    sys.stdout.flush()


def table(result: Mapping[str, Any]) -> list[str]:
    """A line for each entry that is not None, the values below each other."""
    shown = {key.replace("_", " "): value for key, value in result.items() if value is not None}
    width = max((len(key) for key in shown), default=0)
    return [f"{key:<{width}}  {_text(value)}" for key, value in shown.items()]


def plain(value: Any) -> Any:
    """The value in the types of JSON; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return plain(value.item()) if hasattr(value, "item") else str(value)


def size_text(size: float) -> str:
    """Bytes for people."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000
    raise AssertionError("unreachable")


def time_text(seconds: float) -> str:
    """Seconds for people."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    return str(value)


class _Format(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        level = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        return f"orogen: {level}{super().format(record)}"
