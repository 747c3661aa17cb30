"""Heights packed into the colours of map tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.source.values import Values

ENCODINGS = {
    "terrain-rgb": Values(nodata=0, scale=0.1, offset=-10_000.0),
    "terrarium": Values(nodata=0, scale=1 / 256, offset=-32_768.0),
}
"""What 65536 R + 256 G + B means, in metres; black is nodata: no land lies so low."""
TERRAIN_RED = 1, 2
"""Red of Terrain-RGB at -3446 to 9661 m."""
TERRARIUM_RED = 84, 163
"""Red of terrarium at -11264 to 9215 m."""
STEEPEST = 256.0
"""Metres between most neighbours of a height map, at most, however coarse it is."""


def packed(pixels: NDArray[Any]) -> NDArray[np.int32]:
    """65536 R + 256 G + B of pixels (3 or more bands, rows, columns)."""
    red, green, blue = pixels[:3].astype(np.int32)
    return (red << 16) + (green << 8) + blue


def recognised(pixels: NDArray[Any]) -> str | None:
    """The encoding of pixels (bands, rows, columns) that are heights; None where they may be a picture.

    No picture has red 1 or 2 everywhere; one whose red is that of terrarium is no smooth surface as well.
    """
    used: NDArray[np.bool_] = np.asarray(pixels[:3].any(axis=0))
    if not used.any():
        return None
    low, high = int(pixels[0][used].min()), int(pixels[0][used].max())
    if TERRAIN_RED[0] <= low and high <= TERRAIN_RED[1]:
        return "terrain-rgb"
    if not (TERRARIUM_RED[0] <= low and high <= TERRARIUM_RED[1]):
        return None
    heights = packed(pixels) / 256
    steps = [np.abs(np.diff(heights, axis=axis))[_both(used, axis)] for axis in (0, 1)]
    steep = [np.percentile(part, 90) for part in steps if part.size]
    # in a picture blue is much like its neighbours; here it is a fraction of a metre, which is noise or zero
    return "terrarium" if steep and max(steep) < STEEPEST and not _grey(pixels, used) else None


def encoding_named(name: str) -> Values:
    """The meaning of an encoding that a user names."""
    if name not in ENCODINGS:
        raise SettingsError(f"encoding: expected {' or '.join(map(repr, ENCODINGS))}, got {name!r}")
    return ENCODINGS[name]


def _both(used: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Where two neighbours along an axis are used."""
    return used[1:] & used[:-1] if axis == 0 else used[:, 1:] & used[:, :-1]


def _grey(pixels: NDArray[Any], used: NDArray[np.bool_]) -> bool:
    """Whether the three bands rise and fall together."""
    red, green, blue = (pixels[i][used].astype(np.int32) for i in range(3))
    return bool(np.median(np.abs(green - red)) < 16 and np.median(np.abs(blue - red)) < 16)
