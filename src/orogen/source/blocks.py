"""Blocks of remote files on disk: an entry of the cache folder for each version of a file."""

from __future__ import annotations

import hashlib
import logging
import re
import sqlite3
import threading
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO
from urllib.parse import urlsplit

from orogen.source import cache

log = logging.getLogger("orogen")

STEP = 16 << 20
"""Bytes written between two looks at the budget, about."""


class DiskBlocks:
    """Numbered blocks of bytes that outlive the process; None of it is needed: where the disk fails, nothing is kept.

    A small database, so that several threads and processes use it at once and a kill at any point leaves it whole.
    Each block has a checksum; a damaged one counts as missing. Safe to use from several threads at once.
    """

    def __init__(self, url: str, stamp: str) -> None:
        """The blocks of the version `stamp` of the file at `url`."""
        digest = hashlib.sha256(f"{url}\n{stamp}".encode()).hexdigest()[:20]
        stem = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(urlsplit(url).path).stem)[:40].strip("-") or "data"
        self.path = cache.cache_dir() / f"{stem}-remote-{digest}"
        self._lock = threading.Lock()
        self._room = 0
        self._database: sqlite3.Connection | None = None
        self._mark: IO[bytes] | None = None
        try:
            self._open()
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def read(self, numbers: Iterable[int]) -> dict[int, bytes]:
        """Those of some blocks that are kept."""
        found: dict[int, bytes] = {}
        with self._lock:
            if self._database is None:
                return found
            try:
                for number in numbers:
                    row = self._database.execute("SELECT crc, data FROM block WHERE number = ?", (number,)).fetchone()
                    if row and zlib.crc32(row[1]) == row[0]:
                        found[number] = row[1]
            except sqlite3.Error as error:
                self._give_up(error)
        return found

    def write(self, blocks: Mapping[int, bytes]) -> None:
        """Keep blocks, within the budget of the cache folder."""
        rows = [(number, zlib.crc32(data), data) for number, data in blocks.items()]
        size, step = sum(map(len, blocks.values())), min(STEP, cache.cache_max() // 8)
        with self._lock:
            if self._database is None or size > cache.cache_max() // 4:
                return
            try:
                if self._room < size:
                    self._shrink(size + step)
                    self._room = size + step
                with self._database:
                    self._database.executemany("INSERT OR REPLACE INTO block VALUES (?, ?, ?)", rows)
                self._room -= size
            except (OSError, sqlite3.Error) as error:
                self._give_up(error)

    def close(self) -> None:
        """Release the entry."""
        with self._lock:
            self._release()

    def _open(self) -> None:
        for _ in range(5):  # another process may tidy the folder away before it is marked
            self.path.mkdir(parents=True, exist_ok=True)
            self._mark = cache.hold(self.path)
            if self._mark is not None:
                break
        else:
            raise OSError("cannot be locked")
        self._database = sqlite3.connect(self.path / "blocks.sqlite", timeout=10, check_same_thread=False)
        self._database.execute("PRAGMA auto_vacuum = INCREMENTAL")
        self._database.execute("PRAGMA journal_mode = WAL")
        self._database.execute("PRAGMA synchronous = NORMAL")
        with self._database:
            self._database.execute(
                "CREATE TABLE IF NOT EXISTS block (number INTEGER PRIMARY KEY, crc INTEGER NOT NULL, data BLOB)"
            )

    def _shrink(self, room: int) -> None:
        """Drop the entries that are used least, then blocks of this one, until `room` bytes of the budget are free."""
        assert self._database is not None
        self._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        cache.tidy(self.path.parent, room)
        found = cache.info(self.path.parent)
        excess = found.size + room - found.maximum
        if excess <= 0:
            return
        doomed = []
        # the last ones first: the header and, in a COG, the coarse levels lie before them
        for number, size in self._database.execute("SELECT number, length(data) FROM block ORDER BY number DESC"):
            if excess <= 0:
                break
            doomed.append((number,))
            excess -= size
        with self._database:
            self._database.executemany("DELETE FROM block WHERE number = ?", doomed)
        self._database.execute("PRAGMA incremental_vacuum").fetchall()
        self._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def _give_up(self, error: Exception) -> None:
        log.warning("%s: blocks of remote files are not kept there (%s)", self.path, error)
        damaged = isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.OperationalError)
        self._release()
        if damaged:  # made anew the next time
            cache.remove(self.path)

    def _release(self) -> None:
        if self._database is not None:
            self._database.close()
            self._database = None
        if self._mark is not None:
            self._mark.close()
            self._mark = None
