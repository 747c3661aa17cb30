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
    -9999.0, -32768.0, -32767.0, 32767.0, 65535.0, -99999.0, -999999.0, 99999.0, 999999.0, -9999999.0, 9999999.0,
    -2147483648.0, -2147483647.0, 2147483647.0, 4294967295.0, 1e20, -1e20,
)  # fmt: skip
"""Values that data use for nodata without saying so."""
LIMIT = 1e9
"""Metres beyond which, either way, a sample is no height: the largest floats and integers that stand for nodata."""


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
    """Stored value that stands for nodata; NaN, infinities and what lies beyond `LIMIT` always do."""
    scale: float = 1.0
    """Metres per stored unit."""
    offset: float = 0.0
    """Metres of the stored value 0."""
    sentinels: tuple[float, ...] = ()
    """Further stored values that stand for nodata."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale != 0):
            raise SourceError(f"height_scale: expected a finite number other than 0, got {self.scale:g}")
        if not math.isfinite(self.offset):
            raise SourceError(f"height_offset: expected a finite number, got {self.offset:g}")

    @classmethod
    def told(
        cls, name: str, nodata: float | None, told: tuple[float, float], given: tuple[float | None, float | None]
    ) -> Values:
        """Of a raster that tells its (scale, offset); those that the user gives replace them."""
        scale, offset = (theirs if mine is None else mine for theirs, mine in zip(told, given, strict=True))
        try:
            return cls(nodata, scale, offset)
        except SourceError as error:
            raise SourceError(
                f"{name}: tells a scale of {told[0]:g} and an offset of {told[1]:g}, expected finite numbers and "
                "a scale other than 0; give height_scale= and height_offset="
            ) from error

    def converted(self, scale: float | None, offset: float | None, unit: float) -> Values:
        """These with a scale and offset of the user's, where given, and in units of `unit` metres."""
        scale = self.scale if scale is None else scale
        offset = self.offset if offset is None else offset
        return replace(self, scale=scale * unit, offset=offset * unit)

    def possible(self, dtype: np.dtype[Any]) -> bool:
        """Whether samples of a type can be nodata by their value."""
        return dtype.kind == "f" or not self._bounded(dtype) or any(fits(v, dtype) for v in self.marks())

    def invalid(self, raw: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Where stored samples are nodata by their value, or None where none is."""
        mask = None
        for mark in self.marks():
            found = None
            if raw.dtype.kind == "f":
                with np.errstate(over="ignore"):  # a float64 nodata value of float32 samples
                    found = raw == raw.dtype.type(mark)
            elif fits(mark, raw.dtype):
                found = raw == raw.dtype.type(int(mark))
            if found is not None:
                mask = found if mask is None else mask | found
        return mask

    def metres(self, raw: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """float32 metres of stored samples, NaN where they are nodata or not `valid`."""
        mask = self.invalid(raw)
        with np.errstate(invalid="ignore", over="ignore"):
            if self.scale == 1.0 and self.offset == 0.0:
                heights = raw.astype(np.float32)
            else:  # in float64, so that 0.1 m steps round once
                heights = (raw.astype(np.float64) * self.scale + self.offset).astype(np.float32)
            if not self._bounded(raw.dtype):
                heights[~(np.abs(heights) <= LIMIT)] = np.nan
        if mask is not None:
            heights[mask] = np.nan
        if valid is not None:
            heights[~valid] = np.nan
        return heights

    def marks(self) -> tuple[float, ...]:
        """All stored values that stand for nodata."""
        return self.sentinels if self.nodata is None else (self.nodata, *self.sentinels)

    def _bounded(self, dtype: np.dtype[Any]) -> bool:
        """Whether no sample of a type lies beyond `LIMIT`."""
        if dtype.kind == "f":
            return False
        info = np.iinfo(dtype)
        return max(abs(info.min * self.scale + self.offset), abs(info.max * self.scale + self.offset)) <= LIMIT


def fits(value: float, dtype: np.dtype[Any]) -> bool:
    """Whether an integer type holds `value` exactly."""
    info = np.iinfo(dtype)
    return math.isfinite(value) and value == int(value) and info.min <= value <= info.max


def value_range(raw: NDArray[Any], usable: NDArray[np.bool_]) -> tuple[float, float] | None:
    """Least and greatest of the stored samples that are usable; None without any."""
    if not usable.any():
        return None
    lowest, highest = (-np.inf, np.inf) if raw.dtype.kind == "f" else (np.iinfo(raw.dtype).min, np.iinfo(raw.dtype).max)
    low = raw.min(where=usable, initial=highest)
    high = raw.max(where=usable, initial=lowest)
    return float(low), float(high)


def hidden_sentinels(raw: NDArray[Any], usable: NDArray[np.bool_]) -> tuple[float, ...]:
    """The undeclared nodata values among usable samples: usual sentinels far away from all other samples, or alone."""
    found: list[float] = []
    usable = usable.copy()
    while span := value_range(raw, usable):
        for end in span:
            others = usable & (raw != raw.dtype.type(end))
            rest = value_range(raw, others)
            if stands_apart(end, *(rest or (math.inf, -math.inf)), raw.dtype):
                found.append(end)
                usable = others
                break
        else:
            break
    return tuple(found)


def possible_sentinels(low: float, high: float, dtype: np.dtype[Any]) -> tuple[float, ...]:
    """Usual sentinels far from the range of the samples seen: where they turn up among the others they are nodata.

    None for unsigned integers, which would no longer be known to have no gaps.
    """
    if dtype.kind == "u":
        return ()
    held = (value for value in SENTINELS if dtype.kind == "f" or fits(value, dtype))
    return tuple(value for value in held if stands_apart(value, low, high, dtype))


def stands_apart(value: float, low: float, high: float, dtype: np.dtype[Any]) -> bool:
    """Whether `value` is a usual sentinel far outside the range low to high."""
    known: tuple[float, ...] = SENTINELS
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            known = tuple(float(dtype.type(sentinel)) for sentinel in SENTINELS)
    gap = low - value if value < low else value - high
    return value in known and gap > max(100.0, 0.5 * (high - low))
