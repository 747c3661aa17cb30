"""Questions about the terrain, answered on the CPU in float64, anywhere, resident or not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.errors import SettingsError
from orogen.grid import Grid
from orogen.pyramid.contract import Pyramid
from orogen.queries import sight, slope
from orogen.queries.field import Field, part_of
from orogen.queries.globe import Globe, Ground
from orogen.queries.march import first_hits
from orogen.queries.sight import REFRACTION, Sight

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """Heights along a line."""

    x: F64
    """(n,) in the data's CRS."""
    y: F64
    """(n,) in the data's CRS."""
    distance: F64
    """(n,) metres from the start along the geodesics from point to point."""
    height: F64
    """(n,) metres; NaN outside the data and in voids."""

    @property
    def complete(self) -> bool:
        """Whether there is data all the way."""
        return not bool(np.isnan(self.height).any())


class Queries:
    """Answers about a pyramid of heights, in the coordinates of its data; x or lon first. Safe to use from threads.

    The surface is bilinear between sample centres of level 0, with voids as in pictures: there is ground where at
    least half of the weight is valid. Straight lines are straight on the grid, as in pictures; lengths are geodesic.
    `crs=` names the CRS of the coordinates that are given; results are in that of the data. Longitudes may be given
    in any turn, lines take the shorter way around the globe, and a raster around the globe has no end at its seam.
    """

    def __init__(self, pyramid: Pyramid, memory: int = 64 << 20) -> None:
        """`memory`: bytes that are kept, half of it decoded tiles and half blocks for rays.

        As much again for what is asked about the surroundings of the seam of a raster around the globe.
        """
        self._grid = pyramid.grid
        self._globe = Globe(pyramid, memory)
        self._geodesy = self._globe.front.geodesy

    def height_at(self, x: ArrayLike, y: ArrayLike, *, crs: str | None = None) -> F64:
        """Heights (m) of the surface at x, y, of their broadcast shape.

        Of the finest level that can be read before the pyramid is built; NaN outside the hull of the sample centres
        and in voids.
        """
        return self._globe.surface(*self._texels(x, y, crs))[0]

    def normal_at(self, x: ArrayLike, y: ArrayLike, *, crs: str | None = None) -> F64:
        """(..., 3) unit normals (east, north, up) of the surface, unexaggerated; NaN where `height_at` is.

        The surface has edges between cells: on one it is the normal of the cell with the higher column or row.
        """
        _, *along = self._globe.surface(*self._texels(x, y, crs), slopes=True)
        east, north = np.moveaxis(np.stack(along, axis=-1) @ self._grid.texels, -1, 0)
        length = np.sqrt(1 + east**2 + north**2)
        return np.stack([-east / length, -north / length, 1 / length], axis=-1)

    def raycast(
        self, origin: ArrayLike, direction: ArrayLike, *,
        crs: str | None = None, curvature: bool = False, refraction: float = 0.0,
    ) -> F64:  # fmt: skip
        """(..., 3) x, y in the data's CRS and height (m) of the first points on the surface; NaN where there is none.

        origin: (..., 3) x, y and height (m). direction: (..., 3) metres east (along the grid), north and up, of any
        length. The surface is met from above and from below. With `curvature` the ground drops with the distance from
        the origin as in pictures.
        """
        origin, direction = _points("origin", origin), _points("direction", direction)
        origin, direction = np.broadcast_arrays(origin, direction)
        flat, way = self._placed(origin, crs).reshape(-1, 3), direction.reshape(-1, 3)
        usable = np.isfinite(flat).all(axis=1) & np.isfinite(way).all(axis=1) & (way != 0).any(axis=1)
        bend = sight.bend_of(curvature, refraction)
        at = np.full((len(flat), 3), np.nan)
        for ground, here in self._globe.sides(self._globe.outer(flat[:, 0])):
            use = usable & here
            start = np.stack([ground.local(flat[use, 0]), *flat[use, 1:].T])
            rays = sight.rays(ground.grid, start, way[use].T, bend)
            at[use] = self._along(ground, rays.values, first_hits(ground.blocks, rays, ground.grid.shape))
        return at.reshape(origin.shape)

    def line_of_sight(
        self, a: ArrayLike, b: ArrayLike, *,
        crs: str | None = None, curvature: bool = True, refraction: float = REFRACTION,
    ) -> Sight:  # fmt: skip
        """Whether b is seen from a: (..., 3) x, y and metres above the ground, each.

        See `orogen.queries.sight` for the drop of the ground with `curvature`.
        """
        bend = sight.bend_of(curvature, refraction)
        first, second = np.broadcast_arrays(_points("a", a), _points("b", b))
        ends = []
        for name, given in (("a", first), ("b", second)):
            if (given[..., 2] < 0).any():
                raise SettingsError(f"{name}: expected at least 0 metres above the ground, got {given[..., 2].min():g}")
            ends.append(self._placed(given, crs, above_ground=True).reshape(-1, 3))
        usable = np.asarray(np.isfinite(np.hstack(ends)).all(axis=1))
        ends[1][:, 0] = self._globe.shorter(ends[0][:, 0], ends[1][:, 0])
        obstacle, known = np.full((len(usable), 3), np.nan), usable.copy()
        for ground, here in self._globe.sides(self._globe.beyond(ends[0][:, 0]) | self._globe.beyond(ends[1][:, 0])):
            use = usable & here
            shift = np.zeros((int(use.sum()), 3))
            shift[:, 0] = ground.local(ends[0][use, 0]) - ends[0][use, 0]
            start, end = (part[use] + shift for part in ends)
            lines = sight.lines(ground.grid, start.T, end.T, bend)
            obstacle[use] = self._along(
                ground, lines.values, first_hits(ground.blocks, lines, ground.grid.shape, sight=True)
            )
            known[use] = _known(ground, start[:, :2], end[:, :2])
        places = [self._grid.to_crs(end[:, 0], end[:, 1]) for end in ends]
        distance = self._geodesy.distance(*places[0], *places[1])
        visible, shape = usable & np.isnan(obstacle[:, 0]), first.shape[:-1]
        return Sight(
            visible.reshape(shape), known.reshape(shape), distance.reshape(shape), obstacle.reshape(first.shape)
        )

    def profile(self, points: ArrayLike, step: float | None = None, *, crs: str | None = None) -> Profile:
        """Heights along straight lines on the grid through `points` (n, 2), n >= 2.

        step: metres between heights at most, the same along each line; None: one sample.
        """
        points = np.asarray(points, np.float64)
        if points.ndim != 2 or points.shape[0] < 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise SettingsError(f"points: expected two or more finite x, y, got an array of shape {points.shape}")
        step = self._grid.spacing if step is None else step
        if not step > 0:
            raise SettingsError(f"step: expected metres above 0, got {step:g}")
        x, y = self._geodesy.to_grid(points[:, 0], points[:, 1], crs)
        x = self._globe.home(x)
        for k in range(1, len(x)):
            x[k] = self._globe.nearest(x[k], x[k - 1])
        lengths = self._geodesy.distance(x[:-1], y[:-1], x[1:], y[1:])
        if not np.isfinite(lengths).all():
            raise SettingsError(f"points: expected places that {self._grid.crs} reaches, got some that it does not")
        counts = np.maximum(np.ceil(lengths / step - 1e-9), 1).astype(int)
        along = np.concatenate([k + np.arange(n) / n for k, n in enumerate(counts)] + [[float(len(counts))]])
        x, y = (np.interp(along, np.arange(len(points)), part) for part in (x, y))
        steps = self._geodesy.distance(x[:-1], y[:-1], x[1:], y[1:])
        return Profile(self._globe.home(x), y, np.append(0.0, np.cumsum(steps)), self.height_at(x, y))

    def viewshed(
        self, observer: tuple[float, float], *, height: float = 1.7, target_height: float = 0.0,
        radius: float | None = None, crs: str | None = None, curvature: bool = True, refraction: float = REFRACTION,
    ) -> Field:  # fmt: skip
        """What is seen from a place: 1 where the line of sight to a sample is clear, 0 where not, 255 unknown.

        observer: x, y. height, target_height: metres above the ground of the eye and of what is looked for. radius:
        metres (geodesic) beyond which nothing is told; None: all of the data. Every sample has its own exact line.
        Near the seam of a raster around the globe the result goes on across it, with longitudes that go on too.
        """
        bend = sight.bend_of(curvature, refraction)
        for name, value in (("height", height), ("target_height", target_height)):
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name}: expected metres of at least 0, got {value:g}")
        if radius is not None and not radius > 0:
            raise SettingsError(f"radius: expected metres above 0, got {radius:g}")
        if np.shape(observer) != (2,):
            raise SettingsError(f"observer: expected x, y, got {observer}")
        eye = self._placed(np.array([*observer, height], np.float64), crs, above_ground=True)
        if not np.isfinite(eye).all():
            raise SettingsError(f"observer: expected a place with data, got {observer[0]:.10g}, {observer[1]:.10g}")
        ground = self._globe.back if self._globe.outer(eye[0]) else self._globe.front
        column, row, up = float(ground.local(eye[0])), float(eye[1]), float(eye[2])
        x, y = (float(part) for part in ground.grid.to_crs(column, row))
        window = _around(ground, (x, y), radius)

        def compute(rows: slice, cols: slice) -> NDArray[np.uint8]:
            wanted = np.ones((rows.stop - rows.start, cols.stop - cols.start), bool)
            if radius is not None:
                wanted = ground.geodesy.within((x, y), radius, rows, cols)
            if not wanted.any():
                return np.full(wanted.shape, sight.UNKNOWN, np.uint8)
            return sight.seen_from(
                ground.grid, ground.blocks, (column, row, up), rows, cols, wanted, ground.tiles.window(0, rows, cols),
                target_height, bend,
            )  # fmt: skip

        return _field(ground.grid, "viewshed", "uint8", sight.UNKNOWN, compute, window)

    def shadow(self, sun: tuple[float, float]) -> Field:
        """Where the sun shines: 1 in its light, 0 in the shadow of terrain, 255 without data.

        sun: azimuth from grid north and elevation above the horizon, degrees.
        """
        if not (math.isfinite(sun[0]) and 0 < sun[1] <= 90):
            raise SettingsError(f"sun: expected an azimuth and an elevation above 0 to 90, got {sun[0]:g}, {sun[1]:g}")

        def compute(rows: slice, cols: slice) -> NDArray[np.uint8]:
            parts = [
                sight.sunlit(ground.grid, ground.blocks, sun, rows, part, ground.tiles.window(0, rows, part))
                for ground, part in self._globe.columns(cols)
            ]
            return np.concatenate(parts, axis=1)

        return _field(self._grid, "shadow", "uint8", sight.UNKNOWN, compute)

    def slope(self, unit: Literal["degrees", "percent"] = "degrees") -> Field:
        """How steep the terrain is at the samples (Horn's differences), with the true size of each row's samples."""
        if unit not in ("degrees", "percent"):
            raise SettingsError(f"unit: expected degrees or percent, got {unit!r}")

        def value(east: F64, north: F64) -> F64:
            steepness = np.hypot(east, north)
            return np.degrees(np.arctan(steepness)) if unit == "degrees" else 100 * steepness

        return _field(self._grid, "slope", "float32", math.nan, self._sloped(value))

    def aspect(self) -> Field:
        """Where the terrain falls to: degrees clockwise from grid north; NaN where it is level."""

        def value(east: F64, north: F64) -> F64:
            level = (east == 0) & (north == 0)
            return np.where(level, np.nan, np.degrees(np.arctan2(-east, -north)) % 360)

        return _field(self._grid, "aspect", "float32", math.nan, self._sloped(value))

    def _sloped(self, value: Callable[[F64, F64], F64]) -> Callable[[slice, slice], NDArray[np.float32]]:
        scale = slope.RowScale.of(self._grid)

        def compute(rows: slice, cols: slice) -> NDArray[np.float32]:
            parts = [
                value(*slope.to_metres(self._grid, scale, rows, *slope.gradients(_surrounded(ground, rows, part))))
                for ground, part in self._globe.columns(cols)
            ]
            return np.concatenate(parts, axis=1).astype(np.float32)

        return compute

    def _texels(self, x: ArrayLike, y: ArrayLike, crs: str | None) -> tuple[F64, F64]:
        return self._globe.texels(*self._geodesy.to_grid(x, y, crs))

    def _placed(self, points: F64, crs: str | None, above_ground: bool = False) -> F64:
        """(..., 3) x, y, height as texel coordinates and height over zero."""
        tx, ty = self._texels(points[..., 0], points[..., 1], crs)
        height = points[..., 2]
        if above_ground:
            height = height + self._globe.surface(tx, ty)[0]
        return np.stack([tx, ty, height], axis=-1)

    def _along(self, ground: Ground, values: F64, t: F64) -> F64:
        """(n, 3) x, y and height of rays at t."""
        u, v, du, dv, c0, c1, c2 = values
        x, y = ground.grid.to_crs(u + t * du + 0.5, v + t * dv + 0.5)
        return np.column_stack([self._globe.home(x), y, c0 + t * (c1 + t * c2)])


def _field(
    grid: Grid, name: str, dtype: str, nodata: float, compute: Callable[[slice, slice], NDArray[Any]],
    window: tuple[slice, slice] | None = None,
) -> Field:  # fmt: skip
    rows, cols = window or (slice(0, grid.height), slice(0, grid.width))

    def shifted(inner_rows: slice, inner_cols: slice) -> NDArray[Any]:
        return compute(
            slice(inner_rows.start + rows.start, inner_rows.stop + rows.start),
            slice(inner_cols.start + cols.start, inner_cols.stop + cols.start),
        )

    return Field(name, part_of(grid, rows, cols), dtype, nodata, shifted)


def _surrounded(ground: Ground, rows: slice, cols: slice) -> NDArray[np.float32]:
    """Heights of a window and of one sample all around it; NaN past the data."""
    height, width = ground.grid.shape
    inner = slice(max(rows.start - 1, 0), min(rows.stop + 1, height))
    across = slice(max(cols.start - 1, 0), min(cols.stop + 1, width))
    margins = tuple(
        (part.start - (whole.start - 1), whole.stop + 1 - part.stop) for part, whole in ((inner, rows), (across, cols))
    )
    return np.pad(ground.tiles.window(0, inner, across), margins, constant_values=np.nan)


def _around(ground: Ground, place: tuple[float, float], radius: float | None) -> tuple[slice, slice]:
    """The window of samples that may lie within a radius."""
    height, width = ground.grid.shape
    around = ground.geodesy.circle(place, radius) if radius is not None else None
    if around is None:
        return slice(0, height), slice(0, width)
    tx, ty = ground.grid.to_texel(*around)
    parts = [
        slice(max(math.floor(at.min() - 0.5), 0), min(math.ceil(at.max() + 0.5), size))
        for at, size in ((ty, height), (tx, width))
    ]
    return parts[0], parts[1]


def _known(ground: Ground, a: F64, b: F64) -> NDArray[np.bool_]:
    """Whether there is data under lines between texel coordinates (n, 2), looked at every half sample."""
    if ground.pyramid.covered:
        return np.ones(len(a), bool)
    counts = 2 * np.ceil(np.abs(b - a).max(axis=1, initial=0)).astype(int) + 1
    result = np.ones(len(a), bool)
    start = 0
    while start < len(a):
        # together as many lines as fit a million points
        stop = start + max(1, int(np.searchsorted(np.cumsum(counts[start:]), 1 << 20)))
        line = np.repeat(np.arange(start, stop), counts[start:stop])
        first = np.repeat(np.cumsum(counts[start:stop]) - counts[start:stop], counts[start:stop])
        share = (np.arange(len(line)) - first) / np.maximum(counts[line] - 1, 1)
        at = a[line] + (b - a)[line] * share[:, None]
        void = np.isnan(ground.surface(at[:, 0], at[:, 1])[0])
        result[np.unique(line[void])] = False
        start = stop
    return result


def _points(name: str, values: ArrayLike) -> F64:
    points = np.asarray(values, np.float64)
    if not points.ndim or points.shape[-1] != 3:
        raise SettingsError(f"{name}: expected x, y and a height, shape (..., 3), got shape {points.shape}")
    return points
