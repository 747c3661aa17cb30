"""Points, lines and polygons of vector files as a layer of colours over heights, drawn where they are asked for."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.keys import level_count, level_shape
from orogen.source.contract import Source, attribution_of
from orogen.source.drawing import Drawing, Paint, Shapes
from orogen.source.georeference import same_place
from orogen.source.heights import check_window
from orogen.source.scale import parse_crs
from orogen.source.vectorstyle import VectorLayer, VectorStyle, parse_color, parse_layer

if TYPE_CHECKING:
    from rasterio.crs import CRS

log = logging.getLogger("orogen")

COLORS = ("#d55e00", "#0072b2", "#cc79a7", "#f0e442", "#009e73")
"""Of files that name none, one after the other: told apart with every kind of colour vision."""
FILL_OPACITY = 0.25
"""Of polygons that name none."""
PARTS = 500
"""Lines are this part of the terrain's longer side wide unless a style says otherwise, but at least a sample."""
POINT = 6.0
"""Diameter of a point in widths of a line."""
MARKERS = {"small": 0.6, "medium": 1.0, "large": 1.6}
"""Factors on the diameter, as simplestyle names them."""
KNOTS = 192
"""Lines of another CRS get points so closely that so many lie along thrice the terrain's longer side."""
FINER = 4
"""Texels of drawn features along a sample of the heights, so that lines are crisp."""
LARGEST = 2**21
"""Rows and columns of drawn features, at most."""
PIECE = 200
"""Straight parts of a line that are kept together."""
PROPERTIES = (
    "stroke", "stroke-width", "stroke-opacity", "fill", "fill-opacity", "marker-color", "marker-size"
)  # fmt: skip
"""What features say of their looks in the terms of the simplestyle specification (version 1.1)."""

Transform = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def open_vectors(layers: Sequence[Any], heights: Grid, image: Source | None) -> VectorSource:
    """The features of vector files that lie over heights, as one source of colours; the last file is on top.

    layers: `VectorLayer`, or words as for `parse_layer`. image: what lies below, whose grid the source's refines; None:
    nothing does.

    Raises SourceError where a file cannot be read, or where the libraries that read it are missing.
    """
    grid = fine_grid(heights, image.grid if image else None)
    found: list[tuple[Any, Paint]] = []
    names = []
    for number, item in enumerate(layers):
        layer = item if isinstance(item, VectorLayer) else _layer(item)
        names.append(layer.name)
        found += _features(layer, grid, heights, COLORS[number % len(COLORS)])
    credit = attribution_of(image) if image else ""
    return VectorSource(grid, ", ".join(names), Drawing(grid, Shapes.of(found)), credit)


def fine_grid(heights: Grid, image: Grid | None) -> Grid:
    """The grid of an image (else of the heights) with texels halved until `FINER` lie along a sample of the heights."""
    base = image or heights
    factor = 1
    while base.spacing / factor > 1.01 * heights.spacing / FINER and 2 * factor * max(base.shape) <= LARGEST:
        factor *= 2
    a, b, c, d, e, f = base.transform
    transform = a / factor, b / factor, c, d / factor, e / factor, f
    return Grid(base.width * factor, base.height * factor, transform, base.crs, base.ground_scale)


@dataclass(frozen=True)
class VectorLevels:
    """Levels drawn one by one; `orogen.source.contract.Levels`."""

    drawing: Drawing
    """What draws."""
    exact: bool = field(default=True, init=False)
    """Nothing better will come."""
    chunked: bool = field(default=False, init=False)
    """Only what is asked for is drawn."""

    @property
    def height_range(self) -> tuple[float, float]:
        """Colours have none."""
        raise SourceError("colours have no range of heights")

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """uint8 (rows, columns, 4) of a window of a level."""
        check_window(rows, cols, level_shape(self.drawing.grid.shape, level), "features")
        return self.drawing.read(level, rows, cols)

    def read_coverage(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """Colours have none but their alpha."""
        return self.read(level, rows, cols)[..., 3]

    def node_bounds(self, level: int, rows: slice, cols: slice) -> None:
        """Colours have none."""


@dataclass(frozen=True)
class VectorSource:
    """Drawn features, transparent elsewhere; a `Source` of colours that has its own levels. Thread-safe."""

    grid: Grid
    """The CRS of the heights; see `fine_grid`."""
    name: str
    """The files."""
    drawing: Drawing
    """What draws."""
    attribution: str = ""
    """Of the image below."""
    kind: Literal["colour"] = field(default="colour", init=False)
    dtype: str = field(default="uint8", init=False)
    nodata: None = field(default=None, init=False)
    units: str = field(default="", init=False)
    vertical_crs: None = field(default=None, init=False)
    block: tuple[int, int] = field(default=(512, 512), init=False)
    direct: bool = field(default=True, init=False)
    covered: bool = field(default=False, init=False)
    fingerprint: None = field(default=None, init=False)

    @cached_property
    def levels(self) -> VectorLevels:
        """Every level is drawn when it is asked for."""
        return VectorLevels(self.drawing)

    def read(self, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """uint8 (rows, columns, 4) of a window, sRGB and straight alpha."""
        return self.levels.read(0, rows, cols)

    def overview(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """The coarsest level that has at least `shape` (rows, columns), or level 0."""
        sizes = [level_shape(self.grid.shape, level) for level in range(level_count(self.grid.shape))]
        level = max((i for i, (rows, cols) in enumerate(sizes) if rows >= shape[0] and cols >= shape[1]), default=0)
        return self.levels.read(level, slice(0, sizes[level][0]), slice(0, sizes[level][1]))

    def close(self) -> None:
        """Nothing is open."""


def _layer(item: Any) -> VectorLayer:
    if isinstance(item, str):
        return parse_layer(item)
    if isinstance(item, os.PathLike):
        return VectorLayer(item)
    raise SourceError(f"overlay: expected paths of vector files or VectorLayer, got {type(item).__name__}")


def _features(layer: VectorLayer, grid: Grid, heights: Grid, color: str) -> list[tuple[Any, Paint]]:
    """Geometries in texels of `grid` and how they are painted, in the order of painting."""
    try:
        import pyogrio
        import shapely  # noqa: F401
    except ImportError as error:
        raise SourceError(f"{layer.name}: vector files need the extra: pip install 'orogen[vector]'") from error
    try:
        names = [name for name, kind in pyogrio.list_layers(layer.path) if kind is not None]
    except (pyogrio.errors.DataSourceError, OSError, ValueError) as error:
        raise SourceError(f"{layer.name}: cannot be read as a vector file ({error}); check the path") from error
    if layer.layer is not None and layer.layer not in names:
        raise SourceError(f"{layer.name}: has no layer {layer.layer!r}; expected one of {', '.join(names)}")
    result: list[tuple[Any, Paint]] = []
    for name in [layer.layer] if layer.layer is not None else names:
        try:
            geometries, properties = _read(layer, name, grid)
        except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, OSError, ValueError) as error:
            raise SourceError(f"{layer.name}: layer {name!r} cannot be read ({error})") from error
        result += _painted(geometries, properties, layer.style, _width(heights), color)
    if not result:
        log.warning("%s: nothing in it lies over the terrain; check its CRS", layer.name)
    return result


def _read(layer: VectorLayer, name: str, grid: Grid) -> tuple[NDArray[Any], list[dict[str, Any]]]:
    """Valid geometries in texels of `grid`, and the properties of each."""
    import pyogrio
    import shapely

    info = pyogrio.read_info(layer.path, layer=name)
    target = parse_crs(grid.crs) if grid.crs else None
    own = parse_crs(info["crs"]) if info["crs"] else None
    if own is None and target is not None:
        log.warning("%s: names no CRS, taken as that of the terrain (%s)", layer.name, grid.crs)
    moved = own is not None and target is not None and not same_place(own, target)
    box = _box(grid, own if moved else None)
    columns = [key for key in PROPERTIES if key in info["fields"]]
    meta, _, stored, fields = pyogrio.raw.read(layer.path, layer=name, bbox=box, columns=columns, force_2d=True)
    geometries = shapely.from_wkb(stored, on_invalid="ignore")
    broken = ~shapely.is_valid(geometries) & (shapely.get_dimensions(geometries) == 2)
    geometries[broken] = shapely.make_valid(geometries[broken])
    # what lies far away may have no place in the other CRS
    geometries = shapely.clip_by_rect(geometries, *box)
    if moved:
        geometries = shapely.segmentize(geometries, max(box[2] - box[0], box[3] - box[1]) / KNOTS)
    geometries = shapely.transform(geometries, _placed(grid, own if moved else None, target))
    there = ~(shapely.is_missing(geometries) | shapely.is_empty(geometries))
    there &= np.isfinite(shapely.bounds(geometries)).all(axis=1)
    columns = list(meta["fields"])
    index = np.flatnonzero(there)
    return geometries[index], [{key: values[i] for key, values in zip(columns, fields, strict=True)} for i in index]


def _box(grid: Grid, own: CRS | None) -> tuple[float, float, float, float]:
    """The bounds of a grid in another CRS (None: its own), larger by its size to each side."""
    from rasterio.warp import transform_bounds

    from orogen.source.gdal import GDAL_ERRORS

    left, bottom, right, top = grid.bounds
    if own is not None:
        try:
            left, bottom, right, top = transform_bounds(parse_crs(grid.crs or ""), own, left, bottom, right, top)
        except GDAL_ERRORS as error:
            raise SourceError(f"features in {own} cannot be laid over {grid.crs} ({error})") from error
        if left > right:  # across 180 degrees
            left, right = -180.0, 180.0
    width, height = right - left, top - bottom
    return left - width, bottom - height, right + width, top + height


def _placed(grid: Grid, own: CRS | None, target: CRS | None) -> Transform:
    """What turns coordinates (n, 2) of a CRS (None: the grid's) into texels of a grid."""
    from rasterio.warp import transform

    def place(points: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = points[:, 0], points[:, 1]
        if own is not None and len(points):
            x, y = map(np.asarray, transform(own, target, x, y))
        with np.errstate(invalid="ignore"):
            return np.stack(grid.to_texel(x, y), axis=1)

    return place


def _width(heights: Grid) -> float:
    """Metres of lines that nothing is said of."""
    return max(heights.spacing, max(heights.shape) * heights.spacing / PARTS)


def _painted(
    geometries: NDArray[Any], properties: list[dict[str, Any]], style: VectorStyle, width: float, color: str
) -> list[tuple[Any, Paint]]:
    """Fills, then lines and outlines, then points."""
    import shapely

    groups: tuple[list[tuple[Any, Paint]], ...] = ([], [], [])
    parts, owner = shapely.get_parts(geometries, return_index=True)
    parts, inner = shapely.get_parts(parts, return_index=True)  # of collections of collections
    kinds = shapely.get_dimensions(parts).tolist()
    outlines = shapely.boundary(parts)
    for part, outline, kind, number in zip(parts, outlines, kinds, owner[inner].tolist(), strict=True):
        says = properties[number]
        if kind == 0:
            dot = _chosen(style.color, says.get("marker-color"), color)
            size = POINT * (style.width or width) * MARKERS.get(str(says.get("marker-size")), 1.0)
            groups[2].append((part, Paint("point", dot, 1.0, size)))
            continue
        if kind == 2:
            inside = style.fill_opacity
            if inside is None:
                inside = _number(says.get("fill-opacity"), FILL_OPACITY, 0.0, 1.0)
            fill = _chosen(style.color, says.get("fill"), says.get("stroke"), color)
            groups[0].append((part, Paint("area", fill, inside)))
        stroke = _chosen(style.color, says.get("stroke"), color)
        metres = style.width or width * _number(says.get("stroke-width"), 2.0, 1e-3, 1e3) / 2
        paint = Paint("line", stroke, _number(says.get("stroke-opacity"), 1.0, 0.0, 1.0), metres)
        groups[1].extend((piece, paint) for piece in _pieces(outline if kind == 2 else part))
    return [item for group in groups for item in group if item[1].opacity > 0]


def _pieces(lines: Any) -> list[Any]:
    """Lines in pieces that meet, so that little is looked at for a window; round ends make them one again."""
    import shapely

    if shapely.get_num_points(lines) in range(2, PIECE + 2):
        return [lines]
    result = []
    for line in shapely.get_parts(lines):
        places = shapely.get_coordinates(line)
        starts = range(0, max(len(places) - 1, 1), PIECE)
        result += [shapely.LineString(places[start : start + PIECE + 1]) for start in starts]
    return result


def _chosen(*names: Any) -> tuple[int, int, int]:
    """The first of some names that is a colour."""
    return next(found for name in names if isinstance(name, str) and (found := parse_color(name)) is not None)


def _number(value: Any, otherwise: float, low: float, high: float) -> float:
    """A property as a number within limits; what is missing or no number is `otherwise`."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return otherwise
    return min(max(number, low), high) if np.isfinite(number) else otherwise
