"""Geometries drawn as pixels of any level: antialiased, as wide as they are on the ground, the same in every window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from orogen.grid import Grid

if TYPE_CHECKING:
    from shapely import STRtree

OVER = 4
"""Places along a texel, and across, at which it is decided whether it is covered."""
SEGMENTS = 6
"""Straight pieces of a quarter of a round end."""
THIN = 1.0
"""Texels below which strokes have a length and areas a place, but no shape."""
STEPS = 8
"""Parts of a texel that the length of a stroke without shape is told by."""


@dataclass(frozen=True)
class Paint:
    """How a geometry is drawn."""

    what: Literal["area", "line", "point"]
    """The area inside, or a stroke with round ends around a line or a point."""
    color: tuple[int, int, int]
    """sRGB, 0 to 255."""
    opacity: float
    """0 to 1."""
    width: float = 0.0
    """Metres of the stroke."""


@dataclass(frozen=True)
class Shapes:
    """Geometries and their paints in the order of painting."""

    geometries: NDArray[Any]
    """(n,) of shapely, in level-0 texels (columns, rows)."""
    paints: tuple[Paint, ...]
    """Unlike ones, in the order in which they are painted."""
    painted: NDArray[np.intp]
    """(n,) ascending numbers of paints."""

    @classmethod
    def of(cls, items: Sequence[tuple[Any, Paint]]) -> Shapes:
        """Geometries of one paint are drawn at once, where the first of them is: they do not cover each other."""
        paints = tuple(dict.fromkeys(paint for _, paint in items))
        number = {paint: i for i, paint in enumerate(paints)}
        painted = np.array([number[paint] for _, paint in items], np.intp)
        order = np.argsort(painted, kind="stable")
        geometries = np.empty(len(items), object)
        geometries[:] = [geometry for geometry, _ in items]
        return cls(geometries[order], paints, painted[order])


@dataclass(frozen=True)
class Drawing:
    """Draws windows of shapes. Safe to use from several threads at once."""

    grid: Grid
    """Of level 0."""
    shapes: Shapes
    """What is drawn."""

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """uint8 (rows, columns, 4) of a window of a level: sRGB and straight alpha, 0 where nothing is drawn.

        What is narrower than a texel of the level is as much fainter.
        """
        shape = rows.stop - rows.start, cols.stop - cols.start
        window = _Window(self.grid, 2**level, rows.start, cols.start, shape)
        # colours with alpha multiplied in, in linear light, as the GPU mixes them
        canvas = np.zeros((*shape, 4), np.float32)
        found = np.sort(self._tree.query(window.box(self._widest)))
        numbers = self.shapes.painted[found]
        for number in np.unique(numbers):
            paint = self.shapes.paints[number]
            geometries = self.shapes.geometries[found[numbers == number]]
            part = window.around(geometries, paint)
            if part is None:
                continue
            top, left = part.top - window.top, part.left - window.left
            under = canvas[top : top + part.shape[0], left : left + part.shape[1]]
            color = np.array([*_linear(np.array(paint.color) / 255), 1.0], np.float32)
            under += (part.coverage(geometries, paint) * np.float32(paint.opacity))[..., None] * (color - under)
        return _finished(canvas)

    @cached_property
    def _tree(self) -> STRtree:
        from shapely import STRtree

        return STRtree(self.shapes.geometries)

    @cached_property
    def _widest(self) -> float:
        """Metres of the widest stroke."""
        return max((paint.width for paint in self.shapes.paints), default=0.0)


@dataclass(frozen=True)
class _Window:
    """A window of a level."""

    grid: Grid
    step: int
    """Level-0 texels along one of the level's."""
    top: int
    left: int
    """First row and column."""
    shape: tuple[int, int]
    """(rows, columns)."""

    def box(self, stroke: float) -> Any:
        """In level-0 texels, larger by half a stroke (metres) and a little."""
        import shapely

        return shapely.box(*self._bounds(stroke))

    def around(self, geometries: NDArray[Any], paint: Paint) -> _Window | None:
        """The part of the window that some geometries may touch."""
        import shapely

        bounds = shapely.total_bounds(geometries)
        margin = self._margin(paint.width)
        left, top = (int(v) for v in np.floor((bounds[:2] - margin) / self.step))
        right, bottom = (int(v) for v in np.ceil((bounds[2:] + margin) / self.step))
        top, left = max(top, self.top), max(left, self.left)
        shape = min(bottom, self.top + self.shape[0]) - top, min(right, self.left + self.shape[1]) - left
        return _Window(self.grid, self.step, top, left, shape) if min(shape) > 0 else None

    def coverage(self, geometries: NDArray[Any], paint: Paint) -> NDArray[np.float32]:
        """The part of each texel that a paint covers."""
        import shapely

        texel = self.grid.spacing * self.step
        if paint.what == "area":
            left, top, right, bottom = shapely.bounds(geometries).T
            small = np.maximum(right - left, bottom - top) < THIN * self.step
            middle = np.stack([left + right, top + bottom], axis=1)[small] / 2
            cover = self._splat(middle, shapely.area(geometries[small]) / self.step**2)
            return self._filled(shapely.clip_by_rect(geometries[~small], *self._bounds(0.0)), cover)
        if paint.width >= THIN * texel:
            metres, texels = self.grid.metres, self.grid.texels
            if paint.what == "line":
                # before they are cut, so that it is the same in every window
                slack = min(self.step / 4, paint.width / self.grid.spacing / 10)
                geometries = shapely.simplify(geometries, slack, preserve_topology=False)
                geometries = shapely.clip_by_rect(geometries, *self._bounds(paint.width))
            geometries = shapely.transform(geometries, lambda points: points @ metres.T)
            geometries = shapely.buffer(geometries, paint.width / 2, quad_segs=SEGMENTS)
            geometries = shapely.transform(geometries, lambda points: points @ texels.T)
            return self._filled(geometries, np.zeros(self.shape, np.float32))
        if paint.what == "point":
            points = shapely.get_coordinates(geometries)
            area = np.pi / 4 * (paint.width / texel) ** 2
            return np.minimum(self._splat(points, np.full(len(points), area)), 1)
        return np.minimum(self._hairs(geometries, paint.width), 1)

    def _filled(self, geometries: NDArray[Any], cover: NDArray[np.float32]) -> NDArray[np.float32]:
        """Coverage by areas in level-0 texels, together with what is covered besides."""
        import shapely

        areas = shapely.get_parts(shapely.get_parts(geometries))
        areas = areas[(shapely.get_type_id(areas) == 3) & ~shapely.is_empty(areas)]
        if not len(areas):
            return np.minimum(cover, 1)
        areas = shapely.transform(areas, lambda points: points / self.step - (self.left, self.top))
        return np.minimum(cover + _covered(areas, self.shape), 1)

    def _hairs(self, lines: NDArray[Any], width: float) -> NDArray[np.float32]:
        """Coverage by strokes that are much narrower than a texel: their length in each, by even steps along them."""
        import shapely

        places, line = shapely.get_coordinates(shapely.get_parts(lines), return_index=True)
        same = line[1:] == line[:-1]
        start = places[:-1][same]
        along = places[1:][same] - start
        east, north = self.grid.metres @ along.T
        metres = np.hypot(east, north)
        count = np.maximum(np.ceil(np.hypot(*along.T) / self.step * STEPS), 1)
        # of each piece only the steps from first to last lie about the window
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = np.reshape(self._bounds(0.0), (2, 2))
            ends = np.sort([(low - start) / along, (high - start) / along], axis=0)
        beside = (along == 0) & ((start < low) | (start > high))
        ends = np.where(np.isnan(ends) | (along == 0), [[[-np.inf]], [[np.inf]]], ends)
        first = np.clip(np.floor(ends[0].max(axis=1) * count), 0, count).astype(np.int64)
        last = np.clip(np.ceil(ends[1].min(axis=1) * count), 0, count).astype(np.int64)
        number = np.where(beside.any(axis=1), 0, np.maximum(last - first, 0))
        piece = np.repeat(np.arange(len(start)), number)
        step = np.arange(len(piece)) - np.repeat(np.cumsum(number) - number, number) + first[piece]
        middle = start[piece] + along[piece] * ((step + 0.5) / count[piece])[:, None]
        area = metres * width / count / (abs(np.linalg.det(self.grid.metres)) * self.step**2)
        # a strand in the middle of each half of the stroke
        aside = (self.grid.texels @ (np.stack([-north, east]) / np.maximum(metres, 1e-30) * width / 4)).T[piece]
        return self._splat(np.concatenate([middle + aside, middle - aside]), np.tile(area[piece] / 2, 2))

    def _splat(self, points: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float32]:
        """Sums of weights over the texels that points (level-0 texels) lie in."""
        col, row = (np.floor(points / self.step) - (self.left, self.top)).astype(np.int64).T
        inside = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
        index = row[inside] * self.shape[1] + col[inside]
        sums = np.bincount(index, weights[inside], self.shape[0] * self.shape[1])
        return sums.reshape(self.shape).astype(np.float32)

    def _margin(self, stroke: float) -> float:
        """Level-0 texels that half a stroke (metres) may span, and a little."""
        return stroke / 2 * float(np.linalg.norm(self.grid.texels, 2)) + 2 * self.step

    def _bounds(self, stroke: float) -> tuple[float, float, float, float]:
        """Left, upper, right and lower edge in level-0 texels, larger by half a stroke (metres) and a little."""
        margin = self._margin(stroke)
        height, width = self.shape
        return (
            self.left * self.step - margin,
            self.top * self.step - margin,
            (self.left + width) * self.step + margin,
            (self.top + height) * self.step + margin,
        )


def _covered(areas: NDArray[Any], shape: tuple[int, int]) -> NDArray[np.float32]:
    """The part of each texel of a window of `shape` (rows, columns) that lies in one of some areas."""
    from rasterio.features import rasterize
    from rasterio.transform import Affine

    height, width = shape
    mask = rasterize(
        list(areas),
        out_shape=(height * OVER, width * OVER),
        transform=Affine(1 / OVER, 0.0, 0.0, 0.0, 1 / OVER, 0.0),
        dtype="uint8",
    )
    counts = mask.reshape(height, OVER, width, OVER).sum(axis=(1, 3), dtype=np.uint16)
    return counts.astype(np.float32) / np.float32(OVER * OVER)


def _finished(canvas: NDArray[np.float32]) -> NDArray[np.uint8]:
    """sRGB and straight alpha of linear colours with alpha multiplied in."""
    out = np.zeros(canvas.shape, np.uint8)
    drawn = canvas[..., 3] > 0
    painted = canvas[drawn]
    light = painted[:, :3] / painted[:, 3:]
    encoded = np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)
    out[drawn, :3] = np.rint(255 * np.clip(encoded, 0, 1))
    out[drawn, 3] = np.rint(255 * painted[:, 3])
    return out


def _linear(encoded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear light of sRGB values, 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
