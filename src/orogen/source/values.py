"""Stored samples to metres: nodata, scale, offset, vertical units, undeclared sentinels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError

UNITS = {
    "metre": ("", "m", "metre", "metres", "meter", "meters", "1"),
    "foot": ("ft", "foot", "feet", "international foot", "international feet", "ifeet", "ift"),
    "us-foot": ("us-ft", "us-foot", "us_foot", "us foot", "us feet", "us survey foot", "us survey feet", "ftus",
                "us_survey_foot", "foot_us", "sfoot", "ussurveyfoot", "ussft"),
    "kilometre": ("km", "kilometre", "kilometres", "kilometer", "kilometers"),
    "decimetre": ("dm", "decimetre", "decimetres", "decimeter", "decimeters"),
    "centimetre": ("cm", "centimetre", "centimetres", "centimeter", "centimeters"),
    "millimetre": ("mm", "millimetre", "millimetres", "millimeter", "millimeters"),
}  # fmt: skip
METRES = {
    "metre": 1.0,
    "foot": 0.3048,
    "us-foot": 1200 / 3937,
    "kilometre": 1000.0,
    "decimetre": 0.1,
    "centimetre": 0.01,
    "millimetre": 0.001,
}
"""Metres per unit."""

SENTINELS = (
    -9999.0, -32768.0, -32767.0, 32767.0, 65535.0, -99999.0, -999999.0, 99999.0, -2147483648.0, -2147483647.0,
    float(np.finfo(np.float32).min), float(np.finfo(np.float32).max), 1e20, -1e20, 1e38, -1e38,
)  # fmt: skip
"""Values that data use for nodata without saying so."""


def unit_name(text: str) -> str:
    """The name in `METRES` of a vertical unit; SourceError lists what is known."""
    key = text.strip().lower().replace("u.s.", "us")
    for name, aliases in UNITS.items():
        if key in aliases or key == name:
            return name
    raise SourceError(f"vertical units: expected one of {', '.join(METRES)}, got {text!r}")


@dataclass(frozen=True)
class Values:
    """How stored samples become metres."""

    nodata: float | None = None
    """Stored value that stands for nodata; NaN and infinities always do."""
    scale: float = 1.0
    """Metres per stored unit."""
    offset: float = 0.0
    """Metres of the stored value 0."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale != 0):
            raise SourceError(f"height_scale: expected a finite number other than 0, got {self.scale:g}")
        if not math.isfinite(self.offset):
            raise SourceError(f"height_offset: expected a finite number, got {self.offset:g}")

    def converted(self, scale: float | None, offset: float | None, unit: float) -> Values:
        """These with a scale and offset of the user's, where given, and in units of `unit` metres."""
        scale = self.scale if scale is None else scale
        offset = self.offset if offset is None else offset
        return replace(self, scale=scale * unit, offset=offset * unit)

    def possible(self, dtype: np.dtype[Any]) -> bool:
        """Whether samples of a type can be nodata by their value."""
        return dtype.kind == "f" or (self.nodata is not None and fits(self.nodata, dtype))

    def invalid(self, raw: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Where stored samples are nodata by their value, or None where none is."""
        mask = None
        if raw.dtype.kind == "f":
            mask = ~np.isfinite(raw)
            if self.nodata is not None:
                with np.errstate(over="ignore"):  # a float64 nodata value of float32 samples
                    mask |= raw == raw.dtype.type(self.nodata)
        elif self.nodata is not None and fits(self.nodata, raw.dtype):
            mask = raw == raw.dtype.type(int(self.nodata))
        return mask if mask is not None and mask.any() else None

    def metres(self, raw: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """float32 metres of stored samples, NaN where they are nodata or not `valid`."""
        mask = self.invalid(raw)
        with np.errstate(invalid="ignore", over="ignore"):
            if self.scale == 1.0 and self.offset == 0.0:
                heights = raw.astype(np.float32)
            else:  # in float64, so that 0.1 m steps round once
                heights = (raw.astype(np.float64) * self.scale + self.offset).astype(np.float32)
        if mask is not None:
            heights[mask] = np.nan
        if raw.dtype == np.float64:  # beyond float32
            heights[np.isinf(heights)] = np.nan
        if valid is not None:
            heights[~valid] = np.nan
        return heights


def fits(value: float, dtype: np.dtype[Any]) -> bool:
    """Whether an integer type holds `value` exactly."""
    info = np.iinfo(dtype)
    return math.isfinite(value) and value == int(value) and info.min <= value <= info.max


def hidden_sentinel(raw: NDArray[Any]) -> float | None:
    """The undeclared nodata value of samples: a usual sentinel far away from all other samples; None without one."""
    values = raw[np.isfinite(raw)] if raw.dtype.kind == "f" else raw
    for end in (values.min(), values.max()) if values.size else ():
        rest = values[values != end]
        if rest.size and stands_apart(float(end), float(rest.min()), float(rest.max()), raw.dtype):
            return float(end)
    return None


def possible_sentinel(raw: NDArray[Any]) -> float | None:
    """-9999 where no sample of `raw` is near it: one that turns up among the samples not seen is nodata."""
    if raw.dtype.kind == "u" or (raw.dtype.kind == "i" and not fits(-9999, raw.dtype)):
        return None
    values = raw[np.isfinite(raw)] if raw.dtype.kind == "f" else raw
    if values.size and stands_apart(-9999.0, float(values.min()), float(values.max()), raw.dtype):
        return -9999.0
    return None


def stands_apart(value: float, low: float, high: float, dtype: np.dtype[Any]) -> bool:
    """Whether `value` is a usual sentinel far outside the range low to high."""
    known = SENTINELS if dtype != np.float32 else tuple(float(np.float32(s)) for s in SENTINELS)
    gap = low - value if value < low else value - high
    return value in known and gap > max(100.0, 0.5 * (high - low))
