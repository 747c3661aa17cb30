"""JPEG 2000 files, checked before GDAL reads them.

On a box of no length it would never end, and it works through all tiles that a header claims, there or not.
"""

from __future__ import annotations

import os
import struct
from typing import BinaryIO

from orogen.errors import SourceError

SIGNATURE = bytes.fromhex("0000000c6a5020200d0a870a")
"""How a file in boxes begins; a bare codestream has none."""
NESTED = {b"jp2h", b"res ", b"asoc", b"uinf", b"jpch", b"jplh"}
"""Boxes that hold boxes."""
MOST = 100_000
"""Boxes that are looked at."""
SIZES = struct.Struct(">4sHH8I")
"""How a codestream begins: markers, two numbers, right and lower end, upper left corner, and the same of the tiles."""
BEGUN = bytes.fromhex("ff4fff51")
"""The first two markers of a codestream."""
TILE = 14
"""Bytes that a tile takes at least: its markers."""


def check_jpeg2000(path: str) -> None:
    """SourceError where a box of a JPEG 2000 file is shorter than its own header or longer than what it lies in, or
    where more tiles are claimed than the file has room for.
    """
    with open(path, "rb") as file:
        if file.read(len(SIGNATURE)) != SIGNATURE:
            return
        pending = [(0, os.path.getsize(path))]
        for _ in range(MOST):
            if not pending:
                return
            start, end = pending.pop()
            length, kind, header = _box(file, start, end)
            if not header <= length <= end - start:
                raise SourceError(
                    f"{path}: cannot be read as a raster: damaged JPEG 2000, a box {kind!r} of {length} bytes where "
                    f"{end - start} are left"
                )
            if kind == b"jp2c":
                _check_tiles(file, start + header, length - header, path)
            if end - start - length >= 8:
                pending.append((start + length, end))
            if kind in NESTED and length > header:
                pending.append((start + header, start + length))
    raise SourceError(f"{path}: cannot be read as a raster: damaged JPEG 2000, of more than {MOST} boxes")


def _check_tiles(file: BinaryIO, start: int, length: int, path: str) -> None:
    file.seek(start)
    head = file.read(SIZES.size)
    if len(head) < SIZES.size or not head.startswith(BEGUN):
        return  # GDAL says what is wrong
    *_, right, bottom, _, _, wide, high, left, top = SIZES.unpack(head)
    if wide and high and -(-(right - left) // wide) * -(-(bottom - top) // high) * TILE > length:
        raise SourceError(
            f"{path}: cannot be read as a raster: damaged JPEG 2000, {right} x {bottom} samples in tiles of {wide} x "
            f"{high} do not fit {length} bytes"
        )


def _box(file: BinaryIO, start: int, end: int) -> tuple[int, bytes, int]:
    """Length, kind and bytes of the header of a box."""
    file.seek(start)
    head = file.read(16)
    length, kind = int.from_bytes(head[:4], "big"), head[4:8]
    if length == 1:  # its length follows
        return int.from_bytes(head[8:16], "big"), kind, 16
    if length == 0 and end == os.fstat(file.fileno()).st_size:  # the rest of the file
        return end - start, kind, 8
    return length, kind, 8
