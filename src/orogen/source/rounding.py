"""Heights as whole numbers of a step: compression with a bound on the error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError

F32 = NDArray[np.float32]


class Overflow(Exception):
    """A height does not fit the whole numbers that were chosen."""


@dataclass(frozen=True)
class Rounding:
    """Heights are stored as the nearest multiple of `step`; the smallest number of the type stands for nodata.

    The step is a power of two, so that neither direction rounds anew: a multiple of it is exact in float32, and where
    float32 is coarser than the step no height changes at all.
    """

    step: float
    """Metres; a power of two."""
    dtype: str
    """'int16' or 'int32'."""

    @classmethod
    def within(cls, bound: float, low: float, high: float) -> Rounding:
        """The coarsest rounding that moves no height by more than `bound` metres.

        low, high: about the range of the heights; `encode` raises Overflow where the numbers chosen from it are too
        small. Raises SettingsError for a bound that is no positive number, or too small for 32 bits.
        """
        if not (math.isfinite(bound) and bound > 0):
            raise SettingsError(f"max_error: expected metres above 0, got {bound:g}; leave it out to lose nothing")
        step = 2.0 ** math.floor(math.log2(2 * bound))
        reach = 1.5 * max(abs(low), abs(high)) / step
        if reach >= np.iinfo(np.int32).max:
            raise SettingsError(f"max_error: {bound:g} m is too small for these heights; leave it out to lose nothing")
        return cls(step, "int16" if reach < np.iinfo(np.int16).max else "int32")

    @property
    def nodata(self) -> int:
        """The number that stands for nodata."""
        return int(np.iinfo(self.dtype).min)

    def encode(self, heights: F32) -> NDArray[Any]:
        """Whole numbers of float32 metres (NaN = nodata); raises Overflow where they do not fit."""
        numbers = heights * np.float32(1 / self.step)
        np.rint(numbers, out=numbers)
        void = np.isnan(numbers)
        numbers[void] = 0
        if numbers.size and max(-float(numbers.min()), float(numbers.max())) >= -self.nodata:
            raise Overflow
        raw = numbers.astype(self.dtype)
        raw[void] = self.nodata
        return raw

    def decode(self, raw: NDArray[Any]) -> F32:
        """float32 metres of whole numbers, NaN = nodata."""
        heights = raw.astype(np.float32)
        heights *= np.float32(self.step)
        heights[raw == self.nodata] = np.nan
        return heights
