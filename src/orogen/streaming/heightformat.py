"""How the node atlas stores heights: as 32-bit floats, or as 16-bit whole numbers of a step.

All nodes share one step and one base: a texel is stored in the borders of the neighbours too, and has to be the same
height in each of them, or there would be cracks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from orogen.keys import level_shape
from orogen.pyramid.contract import Pyramid
from orogen.source.contract import Quantum, quantum_of

_H = TypeVar("_H", float, NDArray[np.float32])
LAST = 0xFFFF
"""The greatest number of 16 bits."""
_SPARE = 1 / 8
"""Share of the range of heights that is kept free below it and above it."""
_HALVINGS = 16
"""Times that the step of the data is halved at most."""
_FLOAT = 1 << 24
"""Steps from 0 up to which float32 holds every whole number of them."""


@dataclass(frozen=True)
class HeightFormat:
    """How heights become texels: height = base + step * texel."""

    bits: int = 32
    """Of a texel: 32, a float in metres, or 16, a whole number."""
    step: float = 1.0
    """Metres between one texel and the next, of 16 bits."""
    base: float = 0.0
    """Metres of texel 0, of 16 bits."""
    exact: bool = True
    """Whether the heights of level 0 are kept as they are (but for the rounding of float32)."""

    def __post_init__(self) -> None:
        if self.bits not in (16, 32):
            raise ValueError(f"expected 16 or 32 bits, got {self.bits}")
        if not (self.step > 0 and math.isfinite(self.step) and math.isfinite(self.base)):
            raise ValueError(f"expected a step above 0 and a finite base, got {self.step} and {self.base}")

    @property
    def texture(self) -> str:
        """WebGPU format of the heights' texture."""
        return "r16uint" if self.bits == 16 else "r32float"

    @property
    def binding(self) -> str:
        """How shaders bind it, see `orogen.gpu.bindings.binding_layout`."""
        return f"texture {'uint' if self.bits == 16 else 'unfilterable'} 2d-array"

    @property
    def constants(self) -> Mapping[str, int | float | str]:
        """Constants of heightformat.wgsl."""
        return {
            "HEIGHT_BITS": self.bits, "HEIGHT_TYPE": "u32" if self.bits == 16 else "f32",
            "HEIGHT_STEP": self.step, "HEIGHT_BASE": self.base,
        }  # fmt: skip

    @property
    def loss(self) -> float:
        """Metres that a height of level 0 is off at most."""
        return 0.0 if self.exact else self.step / 2

    def encode(self, heights: NDArray[np.float32]) -> NDArray[np.float32] | NDArray[np.uint16]:
        """Texels of heights (m); 16 bits are the nearest ones, cut to what there are."""
        if self.bits == 32:
            return heights
        numbers = heights.astype(np.float64)
        numbers -= self.base
        numbers /= self.step
        return np.clip(np.rint(numbers, out=numbers), 0, LAST, out=numbers).astype(np.uint16)

    def decode(self, texels: NDArray[np.float32] | NDArray[np.uint16]) -> NDArray[np.float32]:
        """Heights (m) that shaders make of texels."""
        if self.bits == 32:
            return texels.astype(np.float32, copy=False)
        return np.float32(self.base) + np.float32(self.step) * texels.astype(np.float32)

    def around(self, low: _H, high: _H) -> tuple[_H, _H]:
        """The lowest and highest height (m) that heights from `low` to `high` may become; floats or arrays."""
        return low - self.loss, high + self.loss


FLOATS = HeightFormat()
"""Heights as they are."""


def height_format(pyramid: Pyramid, bits: int | None) -> HeightFormat:
    """The format for a terrain. `bits`: see `ClipmapSettings.height_bits`.

    16 bits take a range of heights that is certain, as that of a built pyramid is: 32 where it is not.
    """
    if bits == 32 or not pyramid.exact:
        return FLOATS
    low, high = pyramid.height_range
    spare = _spare(pyramid) * (high - low)
    quantum = quantum_of(pyramid.source)
    return _exact(quantum, low, high, spare) or (FLOATS if bits is None else _rounded(low, high, spare))


def _spare(pyramid: Pyramid) -> float:
    """Share of the range to keep free, so that planes stay planes where they are continued past the edges of the data.

    Texels reach two and a half samples of their level past the outermost sample centres. A plane that falls by the
    whole range along the shorter side of the coarsest level falls by its share of that.
    """
    steps = min(level_shape(pyramid.grid.shape, pyramid.level_count - 1)) - 1
    return max(_SPARE, min(2.5, 2.5 / max(steps, 1)))


def _exact(quantum: Quantum | None, low: float, high: float, spare: float) -> HeightFormat | None:
    """The finest steps, 2^n to a quantum, that hold a range; None where not even whole quanta do."""
    if quantum is None:
        return None
    # two quanta more: the base is a whole number of them away from the middle
    step, reach = quantum.step, high - low + 2 * spare + 2 * quantum.step
    if reach > (LAST - 1) * step:
        return None
    most = max(abs(low), abs(high)) + spare
    for _ in range(_HALVINGS):
        if reach > (LAST - 1) * step / 2 or most > _FLOAT * step / 2:
            break
        step /= 2
    middle = (low + high) / 2
    # in whole quanta from the offset, so that heights are whole steps from the base
    first = math.floor((middle - quantum.offset) / quantum.step) - (LAST + 1) // 2 * (step / quantum.step)
    return HeightFormat(16, step, quantum.offset + first * quantum.step)


def _rounded(low: float, high: float, spare: float) -> HeightFormat:
    """The finest step that is a power of two and holds a range."""
    most = max(abs(low), abs(high)) + spare
    least = max((high - low + 2 * spare) / (LAST - 1), most / _FLOAT, 1e-9)
    step = 2.0 ** math.ceil(math.log2(least))
    return HeightFormat(16, step, step * math.floor((low + high) / 2 / step - LAST / 2), exact=False)
