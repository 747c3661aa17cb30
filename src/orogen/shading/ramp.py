"""Colour ramps for heights: perceptually even, readable with every kind of colour vision.

Lightness grows along each ramp, so it orders heights even without hue, in grey print and for the colour-blind.
"""

from __future__ import annotations

import difflib
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.errors import SettingsError
from orogen.shading.color import linear_of_oklab, srgb_decode, srgb_encode
from orogen.shading.ramp_file import SUFFIXES, FileRamp, read_ramp

if TYPE_CHECKING:
    from orogen.source.painted import Stops

RAMP_SIZE = 256
"""Entries of a ramp's table."""

# (position 0 to 1, OKLab lightness, chroma, hue in degrees)
_POINTS: dict[str, tuple[tuple[float, float, float, float], ...]] = {
    "terrain": (
        (0.00, 0.510, 0.085, 152), (0.20, 0.610, 0.095, 130), (0.42, 0.720, 0.085, 100),
        (0.62, 0.780, 0.060, 68), (0.82, 0.870, 0.020, 55), (1.00, 0.985, 0.003, 240),
    ),
    "hypso": (
        (0.00, 0.460, 0.090, 165), (0.25, 0.640, 0.115, 132), (0.50, 0.790, 0.110, 100),
        (0.75, 0.880, 0.060, 75), (1.00, 0.985, 0.004, 60),
    ),
    "viridis": (
        (0.00, 0.285, 0.137, 318.1), (0.11, 0.363, 0.130, 298.0), (0.22, 0.431, 0.105, 273.1),
        (0.33, 0.497, 0.084, 241.4), (0.44, 0.559, 0.085, 207.5), (0.56, 0.629, 0.109, 178.2),
        (0.67, 0.694, 0.145, 157.8), (0.78, 0.767, 0.178, 140.0), (0.89, 0.842, 0.188, 122.6),
        (1.00, 0.930, 0.165, 104.0),
    ),
    "ember": (
        (0.00, 0.160, 0.050, 285), (0.25, 0.340, 0.150, 310), (0.50, 0.530, 0.190, 10),
        (0.75, 0.730, 0.160, 50), (1.00, 0.960, 0.080, 105),
    ),
    "ice": ((0.00, 0.220, 0.060, 265), (0.35, 0.450, 0.110, 250), (0.70, 0.720, 0.090, 215), (1.00, 0.970, 0.020, 195)),
    "grey": ((0.00, 0.250, 0.000, 0), (1.00, 0.980, 0.000, 0)),
}  # fmt: skip


def ramps() -> tuple[str, ...]:
    """Names of the colour ramps."""
    return tuple(_POINTS)


def check_ramp(name: str) -> None:
    """Raise SettingsError, naming the ramps there are, unless `name` is one of them or a file of one."""
    if name in _POINTS:
        return
    if Path(name).suffix.lower() in SUFFIXES:
        _from_file(name)
        return
    close = difflib.get_close_matches(name, _POINTS, 1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise SettingsError(
        f"ramp: expected one of {', '.join(_POINTS)} or a file ({', '.join(SUFFIXES)}), got {name!r}{hint}"
    )


def ramp_range(name: str) -> tuple[float, float] | None:
    """Heights (m) of the ends of a ramp that has its own, from a file; None: those of the data."""
    return None if name in _POINTS else _from_file(name).range


@cache
def _from_file(name: str) -> FileRamp:
    return read_ramp(name)


def ramp_stops(name: str) -> Stops:
    """A ramp as what rasters are painted with: exactly as its file says, steps included.

    Raises SettingsError where there is no ramp of that name, or no ramp in that file.
    """
    from orogen.source.painted import Stops

    check_ramp(name)
    if name in _POINTS:
        return Stops(np.linspace(0, 1, RAMP_SIZE), srgb_encode(ramp_table(name)), relative=True)
    ramp = _from_file(name)
    values = ramp.heights
    if Path(name).suffix.lower() == ".qml":
        # classes of QGIS hold up to their values and with them, those of GMT from theirs on
        step = np.flatnonzero(np.diff(values) == 0) + 1
        values = values.copy()
        values[step] += np.spacing(np.abs(values[step]).astype(np.float32))
    return Stops(values, ramp.colors, ramp.relative)


@cache
def ramp_table(name: str) -> NDArray[np.float32]:
    """(256, 3) linear RGB from the lowest to the highest height; read-only.

    Raises:
        SettingsError: there is no ramp of that name, or no ramp in that file.
    """
    check_ramp(name)
    if name in _POINTS:
        points = np.array(_POINTS[name])
        hue = np.radians(points[:, 3])
        lab = np.stack([points[:, 1], points[:, 2] * np.cos(hue), points[:, 2] * np.sin(hue)], axis=1)
        position = np.linspace(0, 1, RAMP_SIZE)
        linear = linear_of_oklab(np.stack([np.interp(position, points[:, 0], lab[:, i]) for i in range(3)], axis=1))
    else:
        linear = srgb_decode(_from_file(name).table(RAMP_SIZE))
    table: NDArray[np.float32] = np.clip(linear, 0, 1).astype(np.float32)
    table.flags.writeable = False
    return table


def ramp_color(table: ArrayLike, position: ArrayLike) -> NDArray[np.float64]:
    """Linear RGB (..., 3) at positions 0 (lowest) to 1 (highest), clamped; twin of `ramp_color` in ramp.wgsl."""
    rows = np.asarray(table, np.float64)
    x = np.clip(np.asarray(position, np.float64), 0, 1) * (len(rows) - 1)
    low = np.minimum(x.astype(int), len(rows) - 2)
    return rows[low] + (rows[low + 1] - rows[low]) * (x - low)[..., None]
