"""What a picture looks like: colours, light, haze, overlays."""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass

from orogen.errors import SettingsError
from orogen.shading.color import parse_hex
from orogen.shading.ramp import check_ramp

COLOR_MODES = ("auto", "image", "ramp", "plain")
"""Where the colour of the ground may come from."""
OVERLAYS = ("wireframe", "levels", "nodes", "contours", "error")
"""What may be drawn over the picture."""


@dataclass(frozen=True)
class Style:
    """How a surface is shaded. It knows nothing of how the surface was drawn."""

    color: str = "auto"
    """Colour of the ground: "image" (draped; plain where there is none), "ramp" (by height), "plain" (one grey), or
    "auto": the image where there is one, the ramp elsewhere."""
    ramp: str = "terrain"
    """Name of the colour ramp, one of `ramps()`, or a file of one: GMT's .cpt, QGIS's .qml, gdaldem's .txt or .clr."""
    ramp_range: tuple[float, float] | None = None
    """Heights (metres of the data) of the ramp's ends, lowest first; None: those of its file, else the lowest and
    highest of the data."""
    lit: bool = True
    """False: the colour of the ground alone, without light, haze, exposure and tone curve, to compare pictures."""
    sun: tuple[float, float] = (315.0, 35.0)
    """Azimuth (degrees clockwise from grid north) and elevation (0 to 90 degrees above the horizon) of the sun."""
    sun_intensity: float = 1.4
    """Light of the sun, 0 or more; 1 gives white ground that faces a high sun the brightness 1."""
    shadows: bool = True
    """Whether the terrain casts shadows."""
    ambient: float = 0.3
    """Light of a clear sky on level ground, 0 or more, in the same unit."""
    visibility: float | None = None
    """Metres over which the haze at the lowest ground lets 1/e of the light through; math.inf: clear air; None: twice
    the diagonal of the data. Orthographic pictures have no haze."""
    background: str = "sky"
    """Behind the terrain: "sky", "transparent", or one colour as '#rrggbb'."""
    exposure: float = 1.0
    """Factor on all light before the tone curve, above 0."""
    overlays: tuple[str, ...] = ()
    """Any of "wireframe" (triangle edges), "levels" (a colour per level of detail), "nodes" (chequered nodes of the
    clipmap and their borders), "contours" (every fifth is thicker) and "error" (bound of the screen-space error)."""
    contour_interval: float = 0.0
    """Metres of height between contours; 0: a round number, about a twentieth of the data's range."""
    error_limit_px: float = 10.0
    """Screen-space error in pixels that the error overlay shows red; 0 is green."""
    wireframe_width: float = 1.0
    """Width of triangle edges in pixels, above 0 to 16."""

    def __post_init__(self) -> None:
        _one_of("color", self.color, COLOR_MODES)
        check_ramp(self.ramp)
        overlays: object = self.overlays
        if isinstance(overlays, str):
            raise SettingsError(f"overlays: expected a tuple of names, such as ('contours',), got {overlays!r}")
        for overlay in self.overlays:
            _one_of("overlays", overlay, OVERLAYS)
        if self.ramp_range is not None:
            _pair("ramp_range", self.ramp_range)
            if not self.ramp_range[0] < self.ramp_range[1]:
                raise SettingsError(f"ramp_range: expected the lowest height first, got {self.ramp_range}")
        _pair("sun", self.sun)
        if not 0 <= self.sun[1] <= 90:
            raise SettingsError(f"sun: expected an elevation of 0 to 90 degrees, got {self.sun[1]:g}")
        _number("sun_intensity", self.sun_intensity, zero=True)
        _number("ambient", self.ambient, zero=True)
        _number("exposure", self.exposure)
        _number("contour_interval", self.contour_interval, zero=True)
        _number("error_limit_px", self.error_limit_px)
        _number("wireframe_width", self.wireframe_width, most=16)
        if self.visibility is not None and not self.visibility > 0:
            raise SettingsError(f"visibility: expected more than 0 metres, got {self.visibility:g}")
        if self.background not in ("sky", "transparent"):
            if not self.background.startswith("#"):
                raise SettingsError(f"background: expected 'sky', 'transparent' or '#rrggbb', got {self.background!r}")
            parse_hex(self.background)


def _one_of(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        close = difflib.get_close_matches(value, choices, 1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise SettingsError(f"{name}: expected one of {', '.join(choices)}, got {value!r}{hint}")


def _pair(name: str, value: tuple[float, float]) -> None:
    try:
        good = len(value) == 2 and all(math.isfinite(v) for v in value)
    except TypeError:
        good = False
    if not good:
        raise SettingsError(f"{name}: expected two finite numbers, got {value}")


def _number(name: str, value: float, *, zero: bool = False, most: float = math.inf) -> None:
    if not (math.isfinite(value) and (value > 0 or (zero and value == 0)) and value <= most):
        least = "0 or more" if zero else "more than 0"
        limit = "" if math.isinf(most) else f" and at most {most:g}"
        raise SettingsError(f"{name}: expected a finite number, {least}{limit}, got {value:g}")
