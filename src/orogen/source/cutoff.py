"""Files that end too early: GDAL shows zeros, or no mask, where their ends are missing."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from orogen.errors import SourceError

BARE: dict[str, int | re.Pattern[bytes]] = {
    "ENVI": 0, "EHdr": 0, "ERS": 0, "PAux": 0, "PDS4": 0, "GTX": 40, "PCRaster": 256,
    "VICAR": re.compile(rb"LBLSIZE=(\d+)"), "ISIS3": re.compile(rb"StartByte\s*=\s*(\d+)"),
}  # fmt: skip
"""Formats of bare samples, and how many bytes stand before them at least, or what tells it."""
BESIDE = (".ovr", ".msk", ".xml", ".aux", ".hdr", ".ers", ".prj", ".stx")
"""How the names of files beside that of the samples end."""
LABEL = 1 << 16
"""Bytes in which a format tells where its samples begin."""
DIRECTORIES = 1000
"""Directories of a TIFF file that are looked at."""


def check_length(dataset: Any) -> None:
    """SourceError where an open dataset of bare samples has a file that is shorter than they are."""
    before = BARE.get(dataset.driver)
    if before is None:
        return
    sizes = {path: os.path.getsize(path) for path in dataset.files if os.path.isfile(path)}
    sizes = {path: size for path, size in sizes.items() if not path.endswith(BESIDE)}
    if not sizes or dataset.tags(ns="ENVI").get("file_compression", "0") != "0":
        return
    path, size = max(sizes.items(), key=lambda item: item[1])
    if isinstance(before, re.Pattern):
        with open(path, "rb") as file:
            found = before.search(file.read(LABEL))
        before = int(found[1]) - 1 if found else 0
    size_of = np.dtype(dataset.dtypes[0].removeprefix("complex_")).itemsize
    bits = int(dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", 8 * size_of))
    expected = before + dataset.width * dataset.height * dataset.count * bits // 8
    if size < expected:
        raise _cut_off(path, size, expected)


def check_tiff(path: str) -> None:
    """SourceError where the chain of directories of a TIFF file leads beyond its end: GDAL forgets a mask there."""
    end = os.path.getsize(path)
    with open(path, "rb") as file:
        order = {b"II": "<", b"MM": ">"}[file.read(2)]
        version = _number(file.read(2), order)
        if version == 42:
            place, count, entry = 4, 2, 12
        elif version == 43:
            place, count, entry = 8, 8, 20
            file.read(4)
        else:
            return
        at = _number(file.read(place), order)
        for number in range(DIRECTORIES):
            if at == 0:
                return
            file.seek(at)
            entries = _number(file.read(count), order) if at + count <= end else 0
            after = at + count + entries * entry
            if after + place > end:
                if number == 0:
                    return  # GDAL says it
                raise _cut_off(path, end, max(at, after) + place)
            file.seek(after)
            at = _number(file.read(place), order)


def check_sqlite(path: str) -> None:
    """SourceError where a GeoPackage or another SQLite file is shorter than its own count of pages."""
    if os.path.exists(f"{path}-wal"):
        return  # pages may be there
    with open(path, "rb") as file:
        head = file.read(100)
    if len(head) < 100 or head[24:28] != head[92:96]:
        return  # written by a library that does not count
    page = _number(head[16:18], ">")
    expected = (65536 if page == 1 else page) * _number(head[28:32], ">")
    if os.path.getsize(path) < expected:
        raise _cut_off(path, os.path.getsize(path), expected)


def check_pcidsk(path: str) -> None:
    """SourceError where a PCIDSK file is shorter than its own count of blocks of 512 bytes."""
    with open(path, "rb") as file:
        told = file.read(32)[16:].strip()
    if told.isdigit() and os.path.getsize(path) < 512 * int(told):
        raise _cut_off(path, os.path.getsize(path), 512 * int(told))


def _number(data: bytes, order: str) -> int:
    return int.from_bytes(data, "little" if order == "<" else "big")


def _cut_off(path: str, size: int, expected: int) -> SourceError:
    return SourceError(
        f"{path}: cannot be read as a raster: it is cut off, {size} bytes where at least {expected} are expected; copy "
        "it anew from where it came"
    )
