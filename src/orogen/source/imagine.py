"""Compressed ERDAS IMAGINE files, checked: GDAL shows whatever was in memory where runs end early or are misread."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from orogen.errors import SourceError

SIGNATURE = b"EHFA_HEADER_TAG\0"
ENTRY = struct.Struct("<6i64s32s")
"""Next, previous, parent and first child entry, place and size of its data, name and type."""
LAYER = struct.Struct("<iihhii")
"""Width, height, two types, width and height of a block."""
BLOCK = struct.Struct("<hIihh")
"""Number of the file, place, size, whether it was written, whether it is compressed."""
PACKED = struct.Struct("<iiiB")
"""Least value, number of runs (-1: none), place of the values, bits of a value."""
LAYOUTS = {
    "Edms_VirtualBlockInfo": ["s fileCode", "l offset", "l size", "e logvalid", "e compressionType"],
    "Edms_State": ["l numvirtualblocks", "l numobjectsperblock", "l nextobjectnum", "e compressionType", "o blockinfo"],
    "Eimg_Layer": ["l width", "l height", "e layerType", "e pixelType", "l blockWidth", "l blockHeight"],
}
"""Types and names of the first fields of what is read here: every file tells them once more."""
LONGEST = 1 << 16
"""Bytes of a file's list of types that are looked at."""
MOST = 100_000
"""Entries that are looked at."""


@dataclass(frozen=True)
class _Entry:
    following: int
    child: int
    data: int
    size: int
    kind: bytes


def check_imagine(path: str) -> None:
    """SourceError where a compressed block of an IMAGINE file holds fewer samples than it has, or types are damaged.

    Reads the headers of all blocks and their runs: meant for files that are read whole. What else is damaged GDAL
    tells.
    """
    with open(path, "rb") as file:
        if file.read(len(SIGNATURE)) != SIGNATURE:
            return
        try:
            header = _unpacked(file, struct.Struct("<i"), len(SIGNATURE))[0]
            *_, root, _, types = _unpacked(file, struct.Struct("<iiihi"), header)
            file.seek(max(0, types))
            told = file.read(LONGEST).partition(b"\0")[0].decode("latin-1")
            wrong = [name for name, fields in LAYOUTS.items() if _fields(told, name)[: len(fields)] != fields]
            for samples, place, size in _blocks(file, root):
                if wrong:
                    raise SourceError(
                        f"{path}: cannot be read as a raster: damaged IMAGINE file, {wrong[0]} is not what it is in "
                        "others; copy the file anew from where it came"
                    )
                found = _samples(file, place, size, samples)
                if found < samples:
                    raise SourceError(
                        f"{path}: cannot be read as a raster: damaged IMAGINE file, a block of {samples} samples holds "
                        f"{found}; copy the file anew from where it came"
                    )
        except struct.error:  # cut off: GDAL says where
            return


def _blocks(file: BinaryIO, root: int) -> Iterator[tuple[int, int, int]]:
    """Samples, place and size of every block that is written and compressed."""
    pending, seen = [(root, 0)], set[int]()
    while pending and len(seen) < MOST:
        place, samples = pending.pop()
        if place <= 0 or place in seen:
            continue
        seen.add(place)
        entry = _entry(file, place)
        pending.append((entry.following, samples))
        if entry.kind.startswith(b"Eimg_Layer"):
            *_, width, height = _unpacked(file, LAYER, entry.data)
            pending.append((entry.child, width * height))
            continue
        pending.append((entry.child, 0))
        if entry.kind == b"Edms_State" and samples > 0:
            # the number of blocks and of their samples, the next one, the kind; then the list's length and place
            count = min(_unpacked(file, struct.Struct("<i"), entry.data)[0], entry.size // BLOCK.size)
            for number in range(count):
                _, at, size, written, compressed = _unpacked(file, BLOCK, entry.data + 22 + BLOCK.size * number)
                if written and compressed:
                    yield samples, at, size


def _samples(file: BinaryIO, place: int, size: int, enough: int) -> int:
    """How many samples the runs of a compressed block are, `enough` at most."""
    _, runs, values, _ = _unpacked(file, PACKED, place)
    if runs == -1:
        return enough
    file.seek(place + PACKED.size)
    counts = file.read(max(0, min(values, size) - PACKED.size))
    total, at = 0, 0
    for _ in range(runs):
        if at >= len(counts) or total >= enough:
            break
        more = counts[at] >> 6  # its first two bits say how many bytes follow
        part = counts[at : at + 1 + more]
        total += int.from_bytes(part, "big") & ((1 << (6 + 8 * more)) - 1)
        at += 1 + more
    return min(total, enough)


def _entry(file: BinaryIO, place: int) -> _Entry:
    following, _, _, child, data, size, _, kind = _unpacked(file, ENTRY, place)
    return _Entry(following, child, data, size, kind.partition(b"\0")[0])


def _unpacked(file: BinaryIO, form: struct.Struct, place: int) -> tuple:
    file.seek(max(0, place))
    return form.unpack(file.read(form.size))


def _fields(types: str, name: str) -> list[str]:
    """Kind and name of each field of a type, as a file's list of types tells them."""
    definition = re.search(rf"\{{([^{{}}]*)\}}{name},", types)
    words = iter(definition[1].split(",") if definition else ())
    found = []
    for word in words:
        field = re.match(r"\d+:[*p]?(?:e(\d+):|([a-zA-Z])(.*))", word)
        if field is None:
            continue
        if field[1]:  # the names of its values come first: this word was one of them
            for _ in range(min(int(field[1]), 1000)):
                word = next(words, "")
            found.append(f"e {word}")
        elif field[2] == "o":
            found.append(f"o {next(words, '')}")
        else:
            found.append(f"{field[2].lower()} {field[3]}")
    return found
