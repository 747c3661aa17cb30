"""`orogen cache`: the folder of built pyramids."""

from __future__ import annotations

import time

from cyclopts import App

from orogen.cli import console
from orogen.cli.options import Flag

app = App(name="cache", help="Look at the cache of built pyramids, or clear it.")


@app.command
def info(*, json: Flag = False) -> None:
    """Tell where the cache is and what it holds.

    Parameters
    ----------
    json
        Write JSON.
    """
    from orogen.source.cache import info as cache_info

    found = cache_info()
    result = {
        "path": found.path,
        "size": found.size,
        "maximum": found.maximum,
        "entries": [{"name": e.path.name, "size": e.size, "used": e.used} for e in found.entries],
    }
    lines = console.table(
        {"path": found.path, "size": console.size_text(found.size), "maximum": console.size_text(found.maximum)}
    )
    for entry in found.entries:
        day = time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.used))
        lines.append(f"{console.size_text(entry.size):>10}  {day}  {entry.path.name}")
    console.show(result, json, lines)


@app.command
def clear(*, json: Flag = False) -> None:
    """Remove everything from the cache that is not in use.

    Parameters
    ----------
    json
        Write JSON.
    """
    from orogen.source import cache

    folder = cache.cache_dir()
    freed = cache.clear()
    console.show({"path": folder, "freed": freed}, json, [f"freed {console.size_text(freed)} in {folder}"])
