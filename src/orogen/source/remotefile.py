"""The bytes of a remote file: by blocks that are fetched once and kept in memory and on disk."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache as memoised

from orogen.source.blocks import DiskBlocks
from orogen.source.objects import RemoteObject

BLOCK = 1 << 16
"""Bytes of a block: what is fetched and kept is whole blocks. The first one holds the header of most files."""
AT_ONCE = 2 << 20
"""Bytes of one request, at most: larger windows are fetched as several requests side by side."""
GAP = 1
"""Blocks between two wanted ones that are fetched along, rather than by one more request."""
IN_MEMORY = 256
"""Blocks of a file that are kept in memory."""
THREADS = 16
"""Requests under way at once, of all files together."""


class RemoteFile:
    """The bytes of a remote file by blocks, from memory, from disk or from its server. Thread-safe."""

    def __init__(self, url: str) -> None:
        """Fetches the first block; raises SourceError where that fails."""
        self.object = RemoteObject(url)
        self._lock = threading.Lock()
        self._memory: OrderedDict[int, bytes] = OrderedDict()
        self._pending: dict[int, Future[dict[int, bytes]]] = {}
        self._memory[0] = self.object.fetch(0, BLOCK)
        self.size = self.object.size
        stamp = self.object.stamp
        self._disk = DiskBlocks(url, f"{stamp}|{self.size}") if stamp else None
        self.users = 1
        """How many hold it; see `acquire`."""

    def read(self, starts: Sequence[int], sizes: Sequence[int]) -> list[bytes]:
        """Bytes of several ranges, each cut at the end of the file. Raises SourceError."""
        ends = [min(start + size, self.size) for start, size in zip(starts, sizes, strict=True)]
        wanted = {n for a, b in zip(starts, ends, strict=True) for n in range(a // BLOCK, -(-b // BLOCK))}
        blocks = self._blocks(wanted)
        result = []
        for start, end in zip(starts, ends, strict=True):
            first = start // BLOCK
            data = b"".join(blocks[n] for n in range(first, -(-end // BLOCK)))
            result.append(data[start - first * BLOCK : end - first * BLOCK])
        return result

    def close(self) -> None:
        """Release the entry on disk."""
        if self._disk is not None:
            self._disk.close()

    def _blocks(self, wanted: set[int]) -> dict[int, bytes]:
        with self._lock:
            found = self._from_memory(wanted)
        if self._disk is not None and len(found) < len(wanted):
            kept = self._disk.read(sorted(wanted - found.keys()))
            found |= kept
            self._remember(kept)
        with self._lock:
            found |= self._from_memory(wanted - found.keys())  # what another thread has fetched meanwhile
            missing = wanted - found.keys()
            waiting = {self._pending[n] for n in missing if n in self._pending}
            for run in runs(missing - self._pending.keys()):
                future = _pool().submit(self._fetch, run)
                self._pending.update(dict.fromkeys(run, future))
                waiting.add(future)
        wait(waiting)  # of all: a fault that was over must not come back with a part that was still under way
        for future in waiting:
            found |= future.result()
        return found

    def _from_memory(self, wanted: set[int]) -> dict[int, bytes]:
        found = {n: self._memory[n] for n in wanted if n in self._memory}
        for n in found:
            self._memory.move_to_end(n)
        return found

    def _fetch(self, run: range) -> dict[int, bytes]:
        try:
            data = self.object.fetch(run.start * BLOCK, min(run.stop * BLOCK, self.size))
            blocks = {n: data[(n - run.start) * BLOCK : (n - run.start + 1) * BLOCK] for n in run}
            self._remember(blocks)
        finally:
            with self._lock:
                for n in run:
                    self._pending.pop(n, None)
        if self._disk is not None:
            self._disk.write(blocks)
        return blocks

    def _remember(self, blocks: dict[int, bytes]) -> None:
        with self._lock:
            self._memory.update(blocks)
            while len(self._memory) > IN_MEMORY:
                self._memory.popitem(last=False)


def runs(blocks: set[int]) -> list[range]:
    """Blocks as runs of neighbours, each of which is one request; small gaps are fetched along."""
    result: list[range] = []
    most = AT_ONCE // BLOCK
    for n in sorted(blocks):
        last = result[-1] if result else None
        if last is not None and n <= last.stop + GAP and n < last.start + most:
            result[-1] = range(last.start, n + 1)
        else:
            result.append(range(n, n + 1))
    return result


_files: dict[str, RemoteFile] = {}
"""The files that are open, by URL: handles, overviews and warped views of one share it."""
_guard = threading.Lock()


def acquire(url: str) -> RemoteFile:
    """The file at a URL, opened where nobody holds it. Raises SourceError."""
    with _guard:
        if (found := _files.get(url)) is not None and not found.object.changed:
            found.users += 1
            return found
    opened = RemoteFile(url)
    with _guard:
        found = _files.get(url)
        if found is None or found.object.changed:
            found = _files[url] = opened
        else:
            found.users += 1
    if found is not opened:
        opened.close()
    return found


def release(file: RemoteFile) -> None:
    """Give a file back; the last one closes it."""
    with _guard:
        file.users -= 1
        if file.users:
            return
        if _files.get(file.object.url) is file:
            del _files[file.object.url]
    file.close()


@memoised
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS, thread_name_prefix="orogen-fetch")
