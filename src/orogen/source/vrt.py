"""Virtual rasters (VRT), checked before GDAL reads them: of halves of windows it shows whatever is in memory."""

from __future__ import annotations

import html
import math
import re
from dataclasses import dataclass

from orogen.errors import SourceError

BEGIN = b"<VRTDataset"
HEAD = 1024
"""Bytes in which a VRT must begin, for GDAL to know it as one."""
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
WINDOW = re.compile(r"<(SrcRect|DstRect)\b([^>]*)>", re.IGNORECASE)
"""The window of a source, or of the raster, that a source fills."""
SHOWS = re.compile(r"<SourceFilename|<SourceDataset|<SourceArray|subClass", re.IGNORECASE)
"""What tells where samples come from."""
BAND = re.compile(r"(?=<VRTRasterBand\b)", re.IGNORECASE)
"""Where a band begins."""
SOURCE = re.compile(r"<(SourceFilename|SourceDataset)\b([^>]*)>(.*?)</\1\s*>", re.IGNORECASE | re.DOTALL)
"""What a band, or a warped raster, shows."""
TEXT = re.compile(r"<!\[CDATA\[(.*?)\]\]>", re.DOTALL)
ATTRIBUTES = re.compile(r"""(?:\s+\w+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*\s*/?""")
ATTRIBUTE = re.compile(r"""(\w+)\s*=\s*["']([^"']*)""")
NAMES = ("xoff", "yoff", "xsize", "ysize")
SIZES = {
    "byte": 1, "int8": 1, "uint16": 2, "int16": 2, "uint32": 4, "int32": 4, "float32": 4, "uint64": 8, "int64": 8,
    "float64": 8, "cint16": 4, "cint32": 8, "cfloat32": 8, "cfloat64": 16,
}  # fmt: skip
"""Bytes of a sample by its type."""


@dataclass(frozen=True)
class Shown:
    """What a band of a VRT shows."""

    name: str
    """Its name for GDAL: a path, the name of a part, or the text of a VRT."""
    relative: bool
    """Whether paths begin in the folder of the VRT."""
    band: int
    """Number of the band in the VRT, masks counted too."""
    warped: bool
    """Whether it is warped."""
    raw: int | None
    """Bytes that it has at least, if it is a file of bare samples."""


def check_vrt(text: str, path: str) -> list[Shown]:
    """What a VRT shows; SourceError where it is nothing, or where a window lacks a number or its counterpart.

    GDAL takes a missing number for -1 and a window with such a side for one that is not there, but halfway; of a pair
    that lacks one it shows nothing but zeros, as it does where no source is left.
    """
    text = COMMENT.sub("", text)
    if "<VRTRasterBand" in text and not SHOWS.search(text):
        raise _damaged(path, "a raster that its bands show, got none")
    windows = list(WINDOW.finditer(text))
    for window in windows:
        if not _whole(window[2]):
            shown = " ".join(window[0].split())[:200]
            raise _damaged(path, f"xOff, yOff, xSize and ySize, the latter above 0, got {shown}")
    names = [window[1].lower() for window in windows]
    if len(names) % 2 or any(one == other for one, other in zip(names[::2], names[1::2], strict=True)):
        raise _damaged(path, "a SrcRect for each DstRect, got one without the other")
    head, *bands = BAND.split(text)
    return [found for number, band in enumerate(bands) for found in _shown(head, band, number)]


def _shown(head: str, band: str, number: int) -> list[Shown]:
    attributes = _attributes(band.partition(">")[0])
    raw = _raw_size(_attributes(head), attributes, band) if "raw" in attributes.get("subclass", "").lower() else None
    found = []
    for kind, told, content in SOURCE.findall(band):
        name = html.unescape(TEXT.sub(lambda found: html.escape(found[1]), content)).strip()
        relative = _attributes(told).get("relativetovrt", "0").strip() not in ("", "0")
        found.append(Shown(name, relative, number, kind.lower() == "sourcedataset", raw))
    return found


def _raw_size(raster: dict[str, str], band: dict[str, str], text: str) -> int | None:
    """Bytes up to the last of a band's samples; None where the VRT does not say it."""

    def number(name: str, default: int) -> int:
        found = re.search(rf"<{name}>\s*(-?\d+)\s*<", text, re.IGNORECASE)
        return int(found[1]) if found else default

    try:
        width, height = int(raster["rasterxsize"]), int(raster["rasterysize"])
        size = SIZES[band.get("datatype", "Byte").lower()]
    except (KeyError, ValueError):
        return None
    step = number("PixelOffset", size)
    line = number("LineOffset", step * width)
    return number("ImageOffset", 0) + max(0, step * (width - 1)) + max(0, line * (height - 1)) + size


def _damaged(path: str, what: str) -> SourceError:
    return SourceError(f"{path}: cannot be read as a raster: damaged VRT, expected {what}; make it anew (gdalbuildvrt)")


def _attributes(text: str) -> dict[str, str]:
    return {name.lower(): value for name, value in ATTRIBUTE.findall(text)}


def _whole(attributes: str) -> bool:
    """Whether a window has all its numbers."""
    if not ATTRIBUTES.fullmatch(attributes):
        return False
    found = _attributes(attributes)
    try:
        numbers = [float(found[name]) for name in NAMES]
    except (KeyError, ValueError):
        return False
    return all(map(math.isfinite, numbers)) and min(numbers[2:]) > 0
