"""Where patches are kept: in memory, or in the cache folder beside the pyramid; complete or not there at all."""

from __future__ import annotations

import hashlib
import json
import logging
import re
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orogen.errors import OutputError
from orogen.source import cache as shelf
from orogen.source.contract import Source

log = logging.getLogger("orogen")

FORMAT = 1
"""Version of the files and of how patches are made; part of the key of every store."""
_FACTS = "patches.json"

Words = NDArray[np.uint32]


@dataclass(frozen=True)
class Level:
    """The patches of a level."""

    words: Words
    """Page after page."""
    starts: NDArray[np.int64]
    """(rows, columns, 2) first word of the page of every diamond's two patches, by cy and cx; -1: none."""
    errors: NDArray[np.float32]
    """(rows, columns) metres that diamonds are off, and all those that they are made of, at most."""

    def page(self, cx: int, cy: int, side: int) -> Words:
        """The page of a patch that exists."""
        start = int(self.starts[cy, cx, side])
        # the header tells how long it is
        triangles, first = (int(word) for word in self.words[start : start + 2])
        return np.asarray(self.words[start : start + first + triangles])


@dataclass(frozen=True)
class Library:
    """All that is worked out about a terrain."""

    cells: NDArray[np.float32]
    """(rows, columns, 3) of ground.py."""
    levels: Sequence[Level]
    """From level 1 on."""
    page_words: int
    """Words of the largest page of these levels."""


class LevelDraft:
    """A level that is being written."""

    def __init__(self, file: Path | None) -> None:
        self._path = file
        self._file = file.open("wb") if file else None
        self._pages: list[Words] = []
        self._words = 0
        self.largest = 0
        """Words of the largest page so far."""

    def add(self, page: Words) -> int:
        """Append a page; gives its first word."""
        start = self._words
        self._words += len(page)
        self.largest = max(self.largest, len(page))
        if self._file:
            self._file.write(page.tobytes())
        else:
            self._pages.append(page)
        return start

    def finish(self) -> Words:
        """All words."""
        if self._file and self._path:
            self._file.close()
            return _mapped(self._path)
        return np.concatenate(self._pages) if self._pages else np.zeros(0, np.uint32)


class Draft:
    """A library that is being written."""

    def __init__(self, folder: Path | None) -> None:
        """`folder`: where its files go; None: it stays in memory."""
        self._folder = folder
        self._drafts: list[LevelDraft] = []
        self.library: Library | None = None
        """What was made, once it is finished."""

    def level(self, level: int) -> LevelDraft:
        """Begin a level."""
        self._drafts.append(LevelDraft(self._folder / f"{level}.pages" if self._folder else None))
        return self._drafts[-1]

    def finish(self, cells: NDArray[np.float32], levels: Sequence[Level]) -> None:
        """Nothing is to be added any more."""
        largest = max((draft.largest for draft in self._drafts), default=0)
        self.library = Library(cells, levels, largest)
        if self._folder:
            np.save(self._folder / "cells.npy", cells)
            for number, level in enumerate(levels, 1):
                np.save(self._folder / f"{number}.starts.npy", level.starts)
                np.save(self._folder / f"{number}.errors.npy", level.errors)
            files = [path for path in self._folder.iterdir() if path.suffix in (".npy", ".pages")]
            sizes = {path.name: path.stat().st_size for path in files}
            facts = {"format": FORMAT, "levels": len(levels), "page_words": largest, "sizes": sizes}
            (self._folder / _FACTS).write_text(json.dumps(facts, indent=1))


def open_library(source: Source, n: int, build: Callable[[Draft], None], owner: object) -> Library:
    """The library of a source's heights: from the cache, else what `build` makes, kept there for the next time.

    `n`: quads along a patch's legs. Data without a fingerprint, such as arrays, have theirs in memory. `owner`: while
    it lives the store stays in the cache. Raises OutputError where the cache cannot be written, what `build` raises.
    """
    if source.fingerprint is None:
        draft = Draft(None)
        build(draft)
        assert draft.library is not None
        return draft.library
    folder = shelf.cache_dir()
    target = folder / _entry_name(source, n)
    if (found := _opened(target, owner)) is not None:
        return found
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shelf.tidy(folder)
        if target.exists():  # not whole: `_opened` refused it
            shelf.remove(target)
        # renamed when all is there: what a killed build leaves is never taken for a store
        with shelf.building(target) as place:
            build(Draft(place))
    except OSError as error:
        raise OutputError(
            f"{folder}: the patches of {Path(source.name).name} cannot be written there ({error}); "
            "free some space or set OROGEN_CACHE_DIR to another folder"
        ) from error
    found = _opened(target, owner)
    if found is None:
        raise OutputError(f"{target}: vanished while it was opened; open it again")
    shelf.tidy(folder)
    return found


def _opened(target: Path, owner: object) -> Library | None:
    """The library of a store, held while its owner lives; None where it is not there or not whole."""
    mark = shelf.hold(target)
    if mark is None:
        return None
    try:
        facts = json.loads((target / _FACTS).read_text())
        whole = facts["format"] == FORMAT and all(
            (target / name).stat().st_size == size for name, size in facts["sizes"].items()
        )
        if not whole:
            raise ValueError("a file has another size")
        levels = [_level(target, number) for number in range(1, facts["levels"] + 1)]
        library = Library(np.load(target / "cells.npy"), levels, facts["page_words"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        log.warning("%s: is damaged and made anew (%s)", target, error)
        mark.close()
        return None
    weakref.finalize(owner, mark.close)
    return library


def _level(folder: Path, number: int) -> Level:
    starts, errors = (np.load(folder / f"{number}.{name}.npy") for name in ("starts", "errors"))
    return Level(_mapped(folder / f"{number}.pages"), starts, errors)


def _mapped(path: Path) -> Words:
    """A file's words, read as they are looked at."""
    if path.stat().st_size == 0:
        return np.zeros(0, np.uint32)
    return np.memmap(path, np.uint32, "r")


def _entry_name(source: Source, n: int) -> str:
    digest = hashlib.sha256(f"bdam {FORMAT}\n{n}\n{source.fingerprint}".encode()).hexdigest()[:20]
    stem = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(source.name).stem)[:40].strip("-") or "data"
    return f"{stem}-bdam-{digest}"
