"""The header of classic netCDF files, checked before the netCDF library reads it: a damaged one ends the process."""

from __future__ import annotations

import mmap
from dataclasses import dataclass
from math import prod

from orogen.errors import SourceError

DIMENSIONS, VARIABLES, ATTRIBUTES = 10, 11, 12
"""Tags of the lists in a header."""
SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
"""Bytes of a value by its type."""
LONGEST = 2**40
"""Largest dimension, and number of values of a variable, that is believed."""
STREAMING = (2**32 - 1, 2**64 - 1)
"""Numbers of records that mean: as many as there are."""


def check_netcdf(path: str) -> None:
    """SourceError where a file begins as a classic netCDF file and its header contradicts itself; see `Header`."""
    with open(path, "rb") as file:
        magic = file.read(4)
        if magic[:3] != b"CDF" or magic[3:] not in (b"\1", b"\2", b"\5"):
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                Header(data, magic[3]).check()
            except ValueError as error:
                raise SourceError(f"{path}: cannot be read as a raster: damaged netCDF header, {error}") from error


@dataclass
class Header:
    """A header while it is read; the NetCDF Classic Format Specification says what follows what."""

    data: mmap.mmap
    """The file."""
    version: int
    """1: classic, 2: 64-bit offsets, 5: 64-bit data."""
    at: int = 4
    """Where reading goes on."""

    def check(self) -> None:
        """ValueError where a count, name, type or reference is impossible, or values lie beyond the end of the file.

        The library takes what is missing for zeros.
        """
        records = self._number(8 if self.version == 5 else 4)
        lengths = []
        for _ in range(self._count(DIMENSIONS)):
            self._name()
            lengths.append(self._number(8 if self.version == 5 else 4))
        if lengths and max(lengths) > LONGEST:
            raise ValueError(f"a dimension of {max(lengths)}")
        self._attributes()
        variables = []
        for _ in range(self._count(VARIABLES)):
            self._name()
            axes = [self._size() for _ in range(self._bounded(self._size(), 4))]
            if any(axis >= len(lengths) for axis in axes):
                raise ValueError(f"a variable along dimension {max(axes)} of {len(lengths)}")
            if prod(lengths[axis] or 1 for axis in axes) > LONGEST:
                raise ValueError("a variable of impossible size")
            self._attributes()
            size = self._type() * prod(lengths[axis] or 1 for axis in axes)
            self._size()
            start = self._number(4 if self.version == 1 else 8)
            if start > len(self.data):
                raise ValueError("a variable beyond the end of the file")
            variables.append((start, size, any(lengths[axis] == 0 for axis in axes)))
        for start, size, recorded in variables:
            count = records if recorded and records not in STREAMING else 1
            # of a record all variables have a part, filled up to four bytes unless there is but one
            parts = [size for _, size, other in variables if other]
            step = sum(size + -size % 4 for size in parts) if len(parts) > 1 else size
            if count and start + (count - 1) * step + size > len(self.data):
                raise ValueError(f"values up to byte {start + (count - 1) * step + size} of {len(self.data)}")

    def _number(self, size: int) -> int:
        if self.at + size > len(self.data):
            raise ValueError("it is cut off")
        self.at += size
        return int.from_bytes(self.data[self.at - size : self.at], "big")

    def _size(self) -> int:
        return self._number(8 if self.version == 5 else 4)

    def _bounded(self, count: int, size: int) -> int:
        """A count of things of at least `size` bytes that must fit into the rest of the file."""
        if count * size > len(self.data) - self.at:
            raise ValueError(f"{count} values where {len(self.data) - self.at} bytes are left")
        return count

    def _count(self, tag: int) -> int:
        """The number of elements of a list, 0 where it is absent."""
        found, count = self._number(4), self._size()
        if found != tag and (found, count) != (0, 0):
            raise ValueError(f"expected a list of kind {tag}, got {found}")
        return self._bounded(count, 8)

    def _skip(self, size: int) -> bytes:
        """Bytes, with those that fill them up to a multiple of four."""
        start = self.at
        self.at += self._bounded(size, 1) + -size % 4
        return self.data[start : start + min(size, 256)]

    def _name(self) -> None:
        name = self._skip(self._size())
        if not name or b"\0" in name.rstrip(b"\0"):
            raise ValueError(f"a name of {name[:40]!r}")

    def _type(self) -> int:
        kind = self._number(4)
        if kind not in SIZES:
            raise ValueError(f"a type {kind}")
        return SIZES[kind]

    def _attributes(self) -> None:
        for _ in range(self._count(ATTRIBUTES)):
            self._name()
            size = self._type()
            self._skip(self._bounded(self._size(), size) * size)
