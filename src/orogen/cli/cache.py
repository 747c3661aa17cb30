"""`orogen cache`: the folder of built pyramids."""

from __future__ import annotations

import time

from cyclopts import App, Group

from orogen.cli import console
from orogen.cli.parameters import Json

app = App(
    name="cache", help="Look at the cache of built pyramids, or clear it.", group_commands=Group("Commands", sort_key=1)
)


@app.command
def info(*, json: Json = False) -> None:
    """Tell where the cache is and what it holds."""
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
def clear(*, json: Json = False) -> None:
    """Remove everything from the cache that is not in use."""
    from orogen.source import cache

    folder = cache.cache_dir()
    freed = cache.clear()
    console.show({"path": folder, "freed": freed}, json, [f"freed {console.size_text(freed)} in {folder}"])
