"""Rasters on web servers and in object stores: GDAL reads them through the blocks of a remote file."""

from __future__ import annotations

import atexit
import contextvars
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from rasterio.abc import MultiByteRangeResourceContainer

from orogen.errors import SourceError
from orogen.source.gdal import GDAL_ERRORS
from orogen.source.raster import RasterFile
from orogen.source.remotefile import RemoteFile, acquire, release

PATIENCE = 10.0
"""Seconds that the end of the program waits for threads that read."""


class _Gate:
    """Counts the threads that read through GDAL, and lets none in while the program ends.

    A thread that Python stops in a call that came from GDAL takes the process down.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._inside = 0
        self.closed = False

    def __enter__(self) -> None:
        with self._changed:
            if self.closed:
                raise SourceError("remote data cannot be read any more: the program ends")
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._inside -= 1
            self._changed.notify_all()

    def close(self) -> None:
        """Wait for those that are inside: what they read fails from now on."""
        with self._changed:
            self.closed = True
            self._changed.wait_for(lambda: not self._inside, PATIENCE)


_gate = _Gate()
atexit.register(_gate.close)


class Reading:
    """What GDAL reads of a remote file. It never raises, as GDAL is not made for it: it keeps the fault instead."""

    def __init__(self, file: RemoteFile, faults: list[BaseException]) -> None:
        self._file, self._faults, self._position = file, faults, 0

    def read(self, size: int = -1) -> bytes:
        """At most `size` bytes from the position on; none after a fault."""
        size = self._file.size - self._position if size < 0 else size
        if size <= 0 or self._position >= self._file.size:
            return b""
        data = self._try([self._position], [size])[0]
        self._position += len(data)
        return data

    def get_byte_ranges(self, offsets: list[int], sizes: list[int]) -> list[bytes]:
        """Bytes of several ranges, fetched side by side; the caller needs as many as it asked for, so zeros stand for
        what is missing, and the fault keeps them from being used.
        """
        found = self._try(offsets, sizes)
        return [data.ljust(size, b"\0") for data, size in zip(found, sizes, strict=True)]

    def seek(self, offset: int, whence: int = 0) -> int:
        """Set the position, from the start, the position or the end."""
        self._position = max(0, offset + (0, self._position, self._file.size)[whence])
        return self._position

    def tell(self) -> int:
        """The position."""
        return self._position

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is open."""

    def _try(self, offsets: list[int], sizes: list[int]) -> list[bytes]:
        if not self._faults:
            try:
                if _gate.closed:
                    raise SourceError("remote data cannot be read any more: the program ends")
                found = self._file.read(offsets, sizes)
                short = [len(data) < size for data, size in zip(found, sizes, strict=True)]
                if len(found) > 1 and any(short):
                    raise SourceError(f"{self._file.object.name}: parts of it lie beyond its end; it is cut off")
                return found
            except SourceError as error:
                self._faults.append(error)
            except Exception as error:
                self._faults.append(SourceError(f"{self._file.object.name}: cannot be read: {error!r}"))
            except BaseException as stop:  # an interrupt may not pass through GDAL either
                self._faults.append(stop)
        return [b""] * len(offsets)


class _Folder(MultiByteRangeResourceContainer):
    """The files that GDAL may ask for while it reads one: that one, and for a VRT those that it names."""

    def __init__(self, url: str, file: RemoteFile, faults: list[BaseException]) -> None:
        self._files: dict[str, RemoteFile | None] = {url: file}
        self._faults = faults

    def _file(self, path: str) -> RemoteFile:
        if path not in self._files:
            try:
                self._files[path] = acquire(path)
            except SourceError:
                self._files[path] = None
        found = self._files[path]
        if found is None:
            raise FileNotFoundError(path)
        return found

    def open(self, path: str, mode: str = "rb", **_: Any) -> Reading:
        return Reading(self._file(path), self._faults)

    def isfile(self, path: str) -> bool:
        self._file(path)
        return True

    def isdir(self, path: str) -> bool:
        return False

    def ls(self, path: str) -> list[str]:
        return []

    def mtime(self, path: str) -> int:
        return 0

    def rm(self, path: str) -> None:
        raise FileNotFoundError(path)

    def size(self, path: str) -> int:
        return self._files[path].size if self._files.get(path) else 0  # type: ignore[union-attr]

    def close(self) -> None:
        for file in list(self._files.values())[1:]:  # the first one is the raster's
            if file is not None:
                release(file)


@dataclass
class _Handle:
    """A dataset and what belongs to it."""

    dataset: Any
    """The dataset."""
    context: contextvars.Context
    """Where rasterio keeps the files of the dataset; it must be in force whenever GDAL opens or closes one."""
    folder: _Folder
    """The files that it reads."""
    faults: list[BaseException]
    """What went wrong in reading, as GDAL cannot tell it."""

    @contextmanager
    def entered(self) -> Iterator[None]:
        """The context in force; one thread at a time."""
        tokens = [(variable, variable.set(value)) for variable, value in self.context.items()]
        try:
            yield
        finally:
            for variable, token in tokens:
                variable.reset(token)

    def close(self) -> None:
        with self.entered():
            self.dataset.close()
        self.folder.close()


@dataclass
class RemoteRaster(RasterFile):
    """A raster at a URL; else as a `RasterFile`."""

    _files: list[RemoteFile] = field(default_factory=list, repr=False)
    """The file while it is open."""
    _stamp: str | None = field(default=None, repr=False)
    """Size and version of the file when it was first opened."""

    @property
    def url(self) -> str:
        """Where it is, with what may be secret; `path` is without."""
        return self.content or self.path

    def __post_init__(self) -> None:
        weakref.finalize(self, _close_all, self._idle, self._files)

    @contextmanager
    def handle(self) -> Iterator[Any]:
        """A dataset that this thread alone uses meanwhile; a fault of the network or of GDAL is one SourceError."""
        with _gate:
            yield from self._handle()

    def _handle(self) -> Iterator[Any]:
        with self._lock:
            handle = self._idle.pop() if self._idle else None
        handle = handle or self._connected()
        good = False
        try:
            with handle.entered():
                yield handle.dataset
            good = not handle.faults and not _gate.closed
        except GDAL_ERRORS as error:
            if handle.faults:
                raise handle.faults[0] from error
            raise self.failure(error) from error
        finally:
            if good:
                with self._lock:
                    self._idle.append(handle)
            else:  # after a fault GDAL may hold blocks that are not right
                handle.close()
        if handle.faults:
            raise handle.faults[0]

    def stamp(self, dataset: Any) -> str | None:
        """What changes with the file: its version on the server, or None where the server tells none."""
        return self._stamp

    def close(self) -> None:
        """Close the idle handles and release the entry on disk."""
        with self._lock:
            _close_all(self._idle, self._files)

    def _connected(self) -> _Handle:
        with self._lock:
            if not self._files:
                self._files.append(self._open_file())
            file = self._files[0]
        faults: list[BaseException] = []
        context, folder = contextvars.Context(), _Folder(self.url, file, faults)
        try:
            dataset = context.run(self._open, folder)
        except GDAL_ERRORS as error:
            folder.close()
            if faults:
                raise faults[0] from error
            raise self.failure(error) from error
        return _Handle(dataset, context, folder, faults)

    def _open_file(self) -> RemoteFile:
        file = acquire(self.url)
        version = file.object.stamp
        stamp = f"{self.url}|{file.size}|{version}" if version else None
        if self._stamp is not None and stamp != self._stamp:
            release(file)
            raise SourceError(f"{file.object.name}: changed on the server since it was opened; open it again")
        self._stamp = stamp
        return file


def _close_all(handles: list[_Handle], files: list[RemoteFile]) -> None:
    while handles:
        handles.pop().close()
    while files:
        release(files.pop())
