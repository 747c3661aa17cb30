"""How the features of vector files are to be drawn."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field

import numpy as np

from orogen.errors import SourceError


@dataclass(frozen=True)
class VectorStyle:
    """How features are drawn. What is None is as each feature says (simplestyle properties), else as told here."""

    color: str | None = None
    """Of lines, outlines, points and fills: '#rrggbb' or a name of CSS. Else a colour for each file."""
    width: float | None = None
    """Metres of lines and outlines; points are six times as wide. Else 1/500 of the terrain's longer side, but at
    least a sample."""
    fill_opacity: float | None = None
    """Of polygons, 0 (outlines only) to 1. Else 0.25."""

    def __post_init__(self) -> None:
        if self.color is not None and parse_color(self.color) is None:
            raise SourceError(f"color of a vector layer: expected '#rrggbb' or a name of CSS, got {self.color!r}")
        if self.width is not None and not 0 < self.width < np.inf:
            raise SourceError(f"width of a vector layer: expected metres above 0, got {self.width:g}")
        if self.fill_opacity is not None and not 0 <= self.fill_opacity <= 1:
            raise SourceError(f"fill_opacity of a vector layer: expected 0 to 1, got {self.fill_opacity:g}")


@dataclass(frozen=True)
class VectorLayer:
    """A vector file and its style."""

    path: str | os.PathLike[str]
    """GeoJSON, GeoPackage, Shapefile, FlatGeobuf or whatever else GDAL reads features from."""
    layer: str | None = None
    """Name of one of the file's layers; None: all of them, in their order."""
    style: VectorStyle = field(default_factory=VectorStyle)
    """How its features are drawn."""

    @property
    def name(self) -> str:
        """For messages."""
        return os.fspath(self.path)


def parse_layer(text: str) -> VectorLayer:
    """The layer that a word names: FILE[,layer=NAME][,color=C][,width=METRES][,fill_opacity=P]."""
    parts = text.split(",")
    values: dict[str, str] = {}
    while len(parts) > 1 and (found := re.fullmatch(r"(layer|color|width|fill_opacity)=(.*)", parts[-1])):
        values[found[1]] = found[2]
        parts.pop()
    layer = values.pop("layer", None)
    numbers: dict[str, float] = {}
    for key in ("width", "fill_opacity"):
        if key in values:
            try:
                numbers[key] = float(values[key])
            except ValueError:
                raise SourceError(f"{text}: expected a number as {key}, got {values[key]!r}") from None
    return VectorLayer(",".join(parts), layer, VectorStyle(values.get("color"), **numbers))


def parse_color(name: str) -> tuple[int, int, int] | None:
    """sRGB of '#rrggbb', '#rgb', either without '#', or a name of CSS; None where it is none of them."""
    from PIL import ImageColor

    text = f"#{name}" if re.fullmatch(r"[0-9a-fA-F]{3}|[0-9a-fA-F]{6}", name) else name
    try:
        red, green, blue = ImageColor.getrgb(text)[:3]
    except ValueError:
        return None
    return red, green, blue
