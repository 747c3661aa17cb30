"""Virtual rasters (VRT), checked before GDAL reads them: of halves of windows it shows whatever is in memory."""

from __future__ import annotations

import math
import re

from orogen.errors import SourceError

BEGIN = b"<VRTDataset"
HEAD = 1024
"""Bytes in which a VRT must begin, for GDAL to know it as one."""
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
WINDOW = re.compile(r"<(SrcRect|DstRect)\b([^>]*)>", re.IGNORECASE)
"""The window of a source, or of the raster, that a source fills."""
SHOWS = re.compile(r"<SourceFilename|<SourceDataset|<SourceArray|subClass", re.IGNORECASE)
"""What tells where samples come from."""
ATTRIBUTES = re.compile(r"""(?:\s+\w+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*\s*/?""")
ATTRIBUTE = re.compile(r"""(\w+)\s*=\s*["']([^"']*)""")
NAMES = ("xoff", "yoff", "xsize", "ysize")


def check_vrt(path: str) -> None:
    """SourceError where a local VRT shows no raster, or only one window of a pair, or one without all its numbers.

    GDAL takes a missing number for -1 and a window with such a side for one that is not there, but halfway; of a pair
    that lacks one it shows nothing but zeros, as it does where no source is left.
    """
    with open(path, "rb") as file:
        head = file.read(HEAD)
        if BEGIN not in head:
            return
        text = COMMENT.sub("", (head + file.read()).decode("utf-8", "replace"))
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


def _damaged(path: str, what: str) -> SourceError:
    return SourceError(f"{path}: cannot be read as a raster: damaged VRT, expected {what}; make it anew (gdalbuildvrt)")


def _whole(attributes: str) -> bool:
    """Whether a window has all its numbers."""
    if not ATTRIBUTES.fullmatch(attributes):
        return False
    found = {name.lower(): value for name, value in ATTRIBUTE.findall(attributes)}
    try:
        numbers = [float(found[name]) for name in NAMES]
    except (KeyError, ValueError):
        return False
    return all(map(math.isfinite, numbers)) and min(numbers[2:]) > 0
