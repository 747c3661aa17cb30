"""Sun and sky: the light that a style means, as the numbers that sky.wgsl reads."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from orogen.shading.style import Style

_DEPTHS = np.array([0.11, 0.16, 0.25])
"""Optical depth of clear air towards the zenith in red, green and blue, softened so that a ramp keeps its hues."""
_BLUE_ZENITH, _BLUE_HORIZON = np.array([0.13, 0.29, 0.62]), np.array([0.62, 0.74, 0.88])
_LOW_ZENITH, _LOW_HORIZON = np.array([0.10, 0.16, 0.32]), np.array([0.78, 0.56, 0.40])
_SKYLIGHT, _BOUNCE = np.array([0.86, 0.98, 1.22]), np.array([0.42, 0.38, 0.33])


@dataclass(frozen=True)
class Light:
    """Linear RGB light, (3,) each."""

    sun: NDArray[np.float64]
    """Unit vector (east, north, up) towards the sun."""
    sun_color: NDArray[np.float64]
    """Light on ground that faces the sun."""
    zenith: NDArray[np.float64]
    """Colour of the sky overhead."""
    horizon: NDArray[np.float64]
    """Colour of the sky at the horizon, and of distant haze."""
    skylight: NDArray[np.float64]
    """Light of the sky on level ground."""
    bounce: NDArray[np.float64]
    """Light from the ground on what faces straight down."""


def sun_direction(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Unit vector (east, north, up) towards the sun; degrees clockwise from north and above the horizon."""
    a, e = math.radians(azimuth), math.radians(elevation)
    return np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])


@lru_cache(maxsize=16)
def sun_of(style: Style) -> tuple[float, float, float] | None:
    """Unit vector (east, north, up) towards the sun where it casts shadows."""
    if not (style.lit and style.shadows):
        return None
    east, north, up = sun_direction(*style.sun).tolist()
    return east, north, up


@lru_cache(maxsize=16)
def light_of(style: Style) -> Light:
    """The light that a style means; kept, since frames share it."""
    elevation = style.sun[1]
    # relative air mass of F. Kasten and A. T. Young, Revised optical air mass tables, 1989
    air = 1 / (math.sin(math.radians(elevation)) + 0.50572 * (elevation + 6.07995) ** -1.6364)
    through = np.exp(-_DEPTHS * air)
    day = min(1.0, (math.sin(math.radians(elevation)) + 0.06) / 0.36)
    return Light(
        sun=sun_direction(*style.sun),
        sun_color=style.sun_intensity * through / float(np.exp(-_DEPTHS[1])),
        zenith=(_LOW_ZENITH + (_BLUE_ZENITH - _LOW_ZENITH) * day) * (0.3 + 0.7 * day),
        horizon=(_LOW_HORIZON + (_BLUE_HORIZON - _LOW_HORIZON) * day) * (0.4 + 0.6 * day),
        skylight=style.ambient * (0.35 + 0.65 * day) * _SKYLIGHT,
        bounce=style.ambient * (0.35 + 0.65 * day) * _BOUNCE,
    )
