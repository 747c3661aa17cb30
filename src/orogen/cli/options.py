"""Groups of options that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from orogen.cli.parameters import Adapter, Algorithm, Bounds, Flag, Pair, Place, Sun, numbers, word
from orogen.errors import SettingsError

if TYPE_CHECKING:
    from orogen.shading.style import Style

DATA, CAMERA, STYLE, DRAWING = (
    Group(name, sort_key=key)
    for key, name in enumerate(("Data options", "Camera options", "Style options", "Drawing options"), start=1)
)


@Parameter(name="*", group=DATA)
@dataclass(frozen=True)
class HeightOptions:
    """How heights are read."""

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
    encoding: Literal["terrain-rgb", "terrarium"] | None = None
    """How colours hold heights, where that is not recognised."""
    zoom: int | None = None
    """Zoom of map tiles. [default: the finest in the folder]"""
    area: Annotated[tuple[float, float, float, float] | None, word(numbers(4), "W,S,E,N")] = None
    """West, south, east, north in degrees of the part to take of map tiles."""

    def heights(self) -> dict[str, Any]:
        """The arguments of `orogen.source.open_height`."""
        return {field.name: getattr(self, field.name) for field in fields(HeightOptions)}


@Parameter(name="*", group=DATA)
@dataclass(frozen=True)
class DataOptions(HeightOptions):
    """How heights and an image over them are read."""

    color: str | None = None
    """Image that is draped over the terrain."""
    color_extent: Literal["pixels", "samples"] = "pixels"
    """Where an image without georeference lies: over the "pixels" of the heights or the hull of their "samples"."""


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

    look_at: Place | None = None
    """Point on the ground in the middle of the picture, in the data's CRS. [default: the middle of the data]"""
    distance: float | None = None
    """Metres from the camera to that point. [default: so far that all of the data is seen]"""
    heading: float = 330.0
    """Direction of view in degrees clockwise from grid north."""
    pitch: float = -35.0
    """Direction of view in degrees above the horizon; -90 is straight down."""
    fov: float = 45.0
    """Vertical angle of view in degrees."""
    orthographic: Flag = False
    """Parallel projection, at the scale of the looked-at point."""
    bounds: Bounds | None = None
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
    sun: Sun | None = None
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

    algorithm: Algorithm = "raycast"
    """How the surface is drawn."""
    set: Annotated[list[str] | None, Parameter(negative="", metavar="KEY=VALUE")] = None
    """Setting of the algorithm or of the streaming, such as pixels_per_quad=2; repeat for several."""
    adapter: Adapter = None
    """GPU to use, as in `orogen.open`."""
    rasterizer: Literal["auto", "hardware", "compute"] = "auto"
    """What draws triangles: the hardware pipeline, compute passes, or what suits the GPU."""

    def settings(self) -> dict[str, str]:
        """The settings by name."""
        return settings_of(self.set)


def one_or_all(data: tuple[str, ...]) -> str | list[str]:
    """What the words of DATA name: a raster, or several that make a mosaic."""
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
