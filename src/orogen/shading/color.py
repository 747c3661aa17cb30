"""Colours as numbers: the sRGB transfer function and OKLab (B. Ottosson, A perceptual color space, 2020).

Linear RGB has the primaries of sRGB; arrays have the three channels along their last axis.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.errors import SettingsError

_TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_OKLAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def srgb_encode(linear: ArrayLike) -> NDArray[np.float64]:
    """sRGB values (0 to 1) of linear intensities, which are clipped to 0 to 1; any shape."""
    x = np.clip(np.asarray(linear, np.float64), 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.float64]:
    """Linear intensities of sRGB values (0 to 1); any shape."""
    x = np.asarray(encoded, np.float64)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def oklab(linear: ArrayLike) -> NDArray[np.float64]:
    """OKLab (lightness 0 to 1, a, b) of linear RGB, (..., 3) each."""
    return np.cbrt(np.asarray(linear, np.float64) @ _TO_CONES.T) @ _TO_OKLAB.T


def linear_of_oklab(lab: ArrayLike) -> NDArray[np.float64]:
    """Linear RGB of OKLab, (..., 3) each; outside 0 to 1 where sRGB cannot show the colour."""
    return (np.asarray(lab, np.float64) @ np.linalg.inv(_TO_OKLAB).T) ** 3 @ np.linalg.inv(_TO_CONES).T


def parse_hex(text: str) -> tuple[float, float, float]:
    """Linear RGB of a colour written as '#rrggbb' in sRGB.

    Raises:
        SettingsError: the text is not of that form.
    """
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        raise SettingsError(f"colour: expected '#rrggbb' with hexadecimal digits, got {text!r}")
    r, g, b = (float(srgb_decode(int(text[i : i + 2], 16) / 255)) for i in (1, 3, 5))
    return r, g, b
