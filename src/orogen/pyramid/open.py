"""Open the pyramid of a source: from the cache, or built now or in the background."""

from __future__ import annotations

import hashlib
import logging
import re
import shutil
import tempfile
import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

from orogen.errors import OrogenError, OutputError, SettingsError, StoreError
from orogen.pyramid.build import Builder, Cancelled
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.overviews import overview_levels
from orogen.pyramid.store import FORMAT, Store
from orogen.source import cache as shelf
from orogen.source.contract import Source, levels_of
from orogen.source.stored import StoredSource

log = logging.getLogger("orogen")

Progress = Callable[[float, str], None]
Build = Literal["auto", "wait", "background", "never"]
SPARING = 16
"""How many times smaller than its samples a pyramid is at best: more is believed only of who asks for it by name."""


def open_pyramid(
    source: Source,
    *,
    cache: Path | None = None,
    build: Build = "wait",
    progress: Progress | None = None,
) -> Pyramid:
    """The pyramid of a source.

    cache: the folder of built pyramids; None: `cache_dir()`. Data without a fingerprint, such as arrays, get a
    temporary store that goes with the process.
    build: what to do where the pyramid is not built: build it and "wait", build it in the "background" (see
    `Pyramid.wait`), or "never" build it. "auto" waits too, unless the source has overviews from which all levels can
    be read at once; "background" and "never" use them as well. A source that makes its own levels is never built.
    progress: called with the part done (0 to 1) and what is done, from any thread.

    Raises SourceError where the source cannot be read, StoreError where the store is damaged.
    """
    if build not in get_args(Build):
        raise SettingsError(f"build: expected one of {', '.join(get_args(Build))}, got {build!r}")
    pyramid = Pyramid(source)
    if isinstance(source, StoredSource):
        pyramid._use(Store(source.arrays.path, source.arrays.remedy, source.arrays.watch), source.facts)
        return pyramid
    own = levels_of(source)
    if own is not None:
        pyramid._use_levels(own)
        return pyramid
    folder = cache or shelf.cache_dir()
    target = folder / _entry_name(source) if source.fingerprint else None
    if target is not None and _open_built(pyramid, target):
        return pyramid
    if build != "wait" and (own := overview_levels(source)) is not None:
        pyramid._use_levels(own)
        return pyramid
    if build == "never":
        pyramid._done.set()
        return pyramid
    stop = threading.Event()
    pyramid._closing.append(stop.set)
    report = progress or (lambda fraction, text: None)
    if build != "background":
        _build(pyramid, target, stop, report)
    else:
        # a daemon: a build that is not finished must not keep the process
        threading.Thread(target=_build_behind, args=(pyramid, target, stop, report), daemon=True).start()
    return pyramid


def _require_room(source: Source, folder: Path) -> None:
    """OutputError where a pyramid can never fit beside what is there: filling the disk with it would take days."""
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    total, _, free = shutil.disk_usage(there)
    # a third of the samples again in all coarser levels, of two bytes each at least
    least = source.grid.height * source.grid.width * 2 // 3 // SPARING
    if total and least > free:
        raise OutputError(
            f"{source.name}: expected a pyramid that fits into the {free / 1e9:.3g} GB free in {folder}, got "
            f"{source.grid.width} x {source.grid.height} samples, {least / 1e9:.3g} GB or more; add overviews "
            '(gdaladdo), open a part of it, set OROGEN_CACHE_DIR to a larger disk, or give build="never"'
        )


def _build_behind(pyramid: Pyramid, target: Path | None, stop: threading.Event, report: Progress) -> None:
    try:
        _build(pyramid, target, stop, report)
    except Cancelled:
        log.debug("%s: the build of its pyramid was stopped", pyramid.source.name)
    except Exception as error:
        pyramid._failure = error
        log.error("%s: its pyramid could not be built: %s", pyramid.source.name, error)
    finally:
        pyramid._done.set()


def _build(pyramid: Pyramid, target: Path | None, stop: threading.Event, report: Progress) -> None:
    """Build into `target`, or into a temporary folder without one, and use it."""
    source = pyramid.source
    name = Path(source.name).name
    _require_room(source, target.parent if target else Path(tempfile.gettempdir()))

    def progress(fraction: float) -> None:
        pyramid._progress = fraction
        report(fraction, f"building the pyramid of {name}")

    try:
        if target is None:
            folder = Path(tempfile.mkdtemp(prefix="orogen-"))
            pyramid._closing.append(weakref.finalize(pyramid, shutil.rmtree, folder, True))
            pyramid._use(Store(folder), _fill(source, folder, stop, progress))
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        shelf.tidy(target.parent)
        if target.exists():  # not complete or of other data: `_open_built` refused it
            shelf.remove(target)
        with shelf.building(target) as draft:
            _fill(source, draft, stop, progress)
    except OrogenError:
        raise
    except (OSError, ValueError) as error:  # ValueError: how tensorstore says that it cannot write
        where = target.parent if target else tempfile.gettempdir()
        raise OutputError(
            f"{where}: the pyramid of {name} cannot be written there ({error}); "
            f"free some space or set {'OROGEN_CACHE_DIR' if target else 'TMPDIR'} to another folder"
        ) from error
    if not _open_built(pyramid, target):
        raise StoreError(f"{target}: vanished while it was opened; open it again")
    shelf.tidy(target.parent)


def _fill(source: Source, folder: Path, stop: threading.Event, progress: Callable[[float], None]) -> dict[str, Any]:
    store = Store(folder)
    facts = Builder(source, store, progress, stop).run()
    facts |= {"name": source.name, "fingerprint": source.fingerprint}
    store.finish(source.grid, facts)
    return facts


def _open_built(pyramid: Pyramid, target: Path) -> bool:
    """Use the store at `target` if it is complete and of this source."""
    mark = shelf.hold(target)
    if mark is None:
        return False
    store = Store(target)
    facts = store.facts()
    if facts is None or facts.get("format") != FORMAT or facts.get("fingerprint") != pyramid.source.fingerprint:
        mark.close()
        return False
    pyramid._closing.append(mark.close)
    weakref.finalize(pyramid, mark.close)
    pyramid._use(store, facts)
    return True


def _entry_name(source: Source) -> str:
    """The name of a source's entry in the cache: readable, and unique by its fingerprint."""
    digest = hashlib.sha256(f"{FORMAT}\n{source.fingerprint}".encode()).hexdigest()[:20]
    stem = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(source.name).stem)[:40].strip("-") or "data"
    return f"{stem}-{source.kind}-{digest}"
