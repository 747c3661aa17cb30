"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter, Token

from orogen.errors import SettingsError

if TYPE_CHECKING:
    from orogen.shading.style import Style

DATA, CAMERA, STYLE, DRAWING = (
    Group(name, sort_key=key)
    for key, name in enumerate(("Data options", "Camera options", "Style options", "Drawing options"), start=1)
)


def numbers(count: int | None, separator: str = ",", kind: type = float) -> Callable[[Any, Sequence[Token]], Any]:
    """Reads `count` numbers (None: one or more) that `separator` parts, as one word."""
    words = {None: "one or more", 2: "two", 4: "four"}

    def convert(_: Any, tokens: Sequence[Token]) -> tuple[Any, ...]:
        text = tokens[0].value
        try:
            values = tuple(kind(part) for part in text.lower().split(separator))
        except ValueError:
            values = ()
        if not values or (count is not None and len(values) != count):
            what = "whole numbers" if kind is int else "numbers"
            raise ValueError(f"expected {words[count]} {what} separated by {separator!r}, got {text!r}")
        return values

    return convert


def word(convert: Callable[[Any, Sequence[Token]], Any], metavar: str) -> Parameter:
    """An option of one word that `convert` reads."""
    return Parameter(
        converter=convert, n_tokens=1, accepts_keys=False, allow_leading_hyphen=True, metavar=metavar, negative=""
    )


Pair = tuple[float, float]
Size = Annotated[tuple[int, int], word(numbers(2, "x", int), "WxH")]
Flag = Annotated[bool, Parameter(negative="", show_default=False)]
Json = Annotated[bool, Parameter(negative="", show_default=False, group=DRAWING)]


@Parameter(name="*", group=DATA)
@dataclass(frozen=True)
class DataOptions:
    """How the data is read."""

    color: str | None = None
    """Image that is draped over the terrain."""
    color_extent: str = "pixels"
    """Where an image without georeference lies: over the "pixels" of the heights or the hull of their "samples"."""
    spacing: float | None = None
    """Metres between samples, for rasters without georeference."""
    height_scale: float | None = None
    """Factor on stored values; replaces what the file says."""
    height_offset: float | None = None
    """Added to stored values after the factor; replaces what the file says."""
    nodata: float | None = None
    """Stored value that means nodata; replaces what the file says."""
    vertical_units: str | None = None
    """Unit of stored heights, such as metre or foot; replaces what the file says."""
    crs: str | None = None
    """CRS of data that names none, such as EPSG:32611; data of another one is warped to it."""
    encoding: str | None = None
    """How colours hold heights, terrain-rgb or terrarium, where that is not recognised."""
    zoom: int | None = None
    """Zoom of map tiles. [default: the finest in the folder]"""
    area: Annotated[tuple[float, float, float, float] | None, word(numbers(4), "W,S,E,N")] = None
    """West, south, east, north in degrees of the part to take of map tiles."""


@Parameter(name="*", group=DATA)
@dataclass(frozen=True)
class DrapedOptions(DataOptions):
    """How the data is read, and what is laid over it."""

    color_ramp: str | None = None
    """Ramp, or file of one (.cpt, .qml, .txt), that colours the values of --color, a raster of one band then."""
    overlay: Annotated[list[str] | None, Parameter(name="--vector", negative="", metavar="FILE[,KEY=VALUE...]")] = None
    """Vector file drawn on the ground; repeat for several. Keys: layer, color, width (metres), fill_opacity."""
    attribution: str | None = None
    """Who is to be named where the terrain is shown. [default: as the data say]"""


@Parameter(name="*", group=CAMERA)
@dataclass(frozen=True)
class CameraOptions:
    """Where the camera is; by default it shows all of the data."""

    look_at: Annotated[Pair | None, word(numbers(2), "X,Y")] = None
    """Point on the ground in the middle of the picture, in the data's CRS."""
    distance: float | None = None
    """Metres from the camera to that point."""
    heading: float = 330.0
    """Direction of view in degrees clockwise from grid north."""
    pitch: float = -35.0
    """Direction of view in degrees above the horizon; -90 is straight down."""
    fov: float = 45.0
    """Vertical angle of view in degrees."""
    orthographic: Flag = False
    """Parallel projection, at the scale of the looked-at point."""
    bounds: Annotated[tuple[float, float, float, float] | None, word(numbers(4), "L,B,R,T")] = None
    """Left, bottom, right, top of the part to show, in the data's CRS."""


@Parameter(name="*", group=CAMERA)
@dataclass(frozen=True)
class SceneOptions:
    """How the terrain is put before the camera."""

    exaggeration: float = 1.0
    """Factor on all heights."""
    curvature: Flag = False
    """Let the ground drop with the distance as on the globe."""


@Parameter(name="*", group=STYLE)
@dataclass(frozen=True)
class StyleOptions:
    """What the picture looks like; by default the draped image if there is one, else colours by height."""

    ramp: str | None = None
    """Colour the ground by height with this ramp or file of one (.cpt, .qml, .txt), even where there is an image."""
    range: Annotated[Pair | None, word(numbers(2), "LOW,HIGH")] = None
    """Heights in metres of the ramp's ends. [default: those of its file, else of the data]"""
    plain: Flag = False
    """One grey for all of the ground."""
    sun: Annotated[Pair | None, word(numbers(2), "AZ,EL")] = None
    """Azimuth and elevation of the sun in degrees. [default: 315,35]"""
    no_shadows: Flag = False
    """No cast shadows."""
    visibility: float | None = None
    """Metres over which haze lets 1/e of the light through; inf: clear. [default: twice the diagonal of the data]"""
    exposure: float | None = None
    """Factor on all light. [default: 1]"""
    background: str | None = None
    """"sky", "transparent" or a colour #rrggbb. [default: sky]"""
    overlay: Annotated[list[str] | None, Parameter(negative="", metavar="NAME")] = None
    """Draw over the picture: wireframe, levels, nodes, contours or error; repeat for several."""
    contour_interval: float | None = None
    """Metres between contours. [default: a round number]"""
    error_limit: float | None = None
    """Screen-space error in pixels that the error overlay shows red. [default: 10]"""

    def style(self) -> Style:
        """The style that the options ask for."""
        from orogen.shading.style import Style

        if self.plain and self.ramp:
            raise SettingsError("--plain and --ramp: expected one of them, got both")
        values = {
            "color": "plain" if self.plain else "ramp" if self.ramp else None,
            "ramp": self.ramp,
            "ramp_range": self.range,
            "sun": self.sun,
            "shadows": False if self.no_shadows else None,
            "visibility": self.visibility,
            "exposure": self.exposure,
            "background": self.background,
            "overlays": tuple(self.overlay) if self.overlay else None,
            "contour_interval": self.contour_interval,
            "error_limit_px": self.error_limit,
        }
        return Style(**{key: value for key, value in values.items() if value is not None})  # type: ignore[arg-type]


@Parameter(name="*", group=DRAWING)
@dataclass(frozen=True)
class DrawingOptions:
    """How the picture is drawn."""

    algorithm: str = "raycast"
    """Terrain algorithm."""
    set: Annotated[list[str] | None, Parameter(negative="", metavar="KEY=VALUE")] = None
    """Setting of the algorithm or of the streaming, such as pixels_per_quad=2; repeat for several."""
    adapter: str | None = None
    """GPU to use: index, kind (discrete, integrated, cpu ...) or part of its name; see orogen info --gpu."""
    rasterizer: Literal["auto", "hardware", "compute"] = "auto"
    """What draws triangles: the hardware pipeline, compute passes, or what suits the GPU."""

    def settings(self) -> dict[str, str]:
        """The settings by name."""
        return settings_of(self.set)


def one_or_all(data: tuple[str, ...]) -> str | list[str]:
    """What the words of DATA name: a raster, or several that make a mosaic."""
    if not data:
        raise SettingsError("expected a raster (a path, URL or GDAL name), got none")
    return data[0] if len(data) == 1 else list(data)


def settings_of(items: Sequence[str] | None) -> dict[str, str]:
    """Values by name from the words of --set."""
    result = {}
    for item in items or ():
        key, found, value = item.partition("=")
        if not found or not key:
            raise SettingsError(f"--set: expected KEY=VALUE, got {item!r}")
        result[key] = value
    return result
