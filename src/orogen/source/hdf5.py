"""HDF5 files (netCDF-4 among them), checked before the HDF5 library reads them: on a damaged heap it never returns."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from struct import Struct

from orogen.errors import SourceError

SIGNATURE = b"\x89HDF\r\n\x1a\n"
STARTS = (0, 512, 1024, 2048, 4096)
"""Where the signature may stand; bytes of the user's may come first."""
COLLECTION = b"GCOL\1\0\0\0"
"""How a collection of the global heap begins: its signature, version 1 and three bytes of zero."""
LENGTH = Struct("<Q")
OBJECT = Struct("<HHIQ")
"""What stands before an object: its number, uses, four bytes of zero, and its size."""
SMALLEST = 4096
"""Bytes of a collection, at least."""
SEARCHED = 32 << 20
"""Bytes at the start, and at the end, of a file that are searched: libraries write what describes the data there."""
MOST = 200_000
"""Objects that are looked at."""


def check_hdf5(path: str) -> None:
    """SourceError where a collection of an HDF5 file's global heap holds an object of impossible size.

    The library steps from object to object: over one of size 0 it stays where it is. Eight bytes and a size that fits
    the file must agree before anything counts as a collection, so that data are not taken for one.
    """
    with open(path, "rb") as file:
        head = file.read(STARTS[-1] + len(SIGNATURE))
        if not any(head.startswith(SIGNATURE, start) for start in STARTS):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            looked_at = 0
            for start in _collections(data):
                end = start + LENGTH.unpack_from(data, start + len(COLLECTION))[0]
                at = start + len(COLLECTION) + LENGTH.size
                while end - at >= OBJECT.size and looked_at < MOST:
                    number, _, _, size = OBJECT.unpack_from(data, at)
                    # number 0 is what is free, counted with these bytes
                    step = OBJECT.size + (size + -size % 8) if number else size
                    if step < OBJECT.size or at + step > end:
                        raise SourceError(
                            f"{path}: cannot be read as a raster: damaged HDF5, an object of {size} bytes in a heap "
                            f"that has {end - at} left; copy the file anew from where it came"
                        )
                    at += step
                    looked_at += 1


def _collections(data: mmap.mmap) -> Iterator[int]:
    """Where collections begin that end within the file, near its start and end."""
    parts = [(0, min(len(data), SEARCHED)), (max(SEARCHED, len(data) - SEARCHED), len(data))]
    for first, last in parts:
        at = data.find(COLLECTION, first, last)
        while at >= 0:
            if at + SMALLEST <= len(data):
                size = LENGTH.unpack_from(data, at + len(COLLECTION))[0]
                if SMALLEST <= size <= len(data) - at:
                    yield at
            at = data.find(COLLECTION, at + 1, last)
