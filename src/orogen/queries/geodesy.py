"""True distances on the ellipsoid of a CRS, and coordinates from other CRS, by PROJ."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.errors import SettingsError
from orogen.grid import Grid

if TYPE_CHECKING:
    from pyproj import CRS, Geod, Transformer

F64 = NDArray[np.float64]
LATTICE = 16
"""Cells between the points whose distances are measured first."""


class Geodesy:
    """Distances and conversions for a grid. Without a CRS, or with one that is on no ellipsoid, the ground is flat."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid

    def to_grid(self, x: ArrayLike, y: ArrayLike, crs: str | None) -> tuple[F64, F64]:
        """x, y (lon, lat) of a CRS in that of the grid; NaN where that does not reach. None: they are in it already.

        Raises SettingsError for an unknown CRS, and where the grid has none.
        """
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if crs is None or crs == self._grid.crs:
            return x, y
        if self._grid.crs is None:
            raise SettingsError(f"crs: expected none, since the data has none, got {crs!r}; open it with crs=")
        return _convert(_transformer(crs, self._grid.crs), x, y)

    def distance(self, x0: ArrayLike, y0: ArrayLike, x1: ArrayLike, y1: ArrayLike) -> F64:
        """Metres along the geodesic between points in the grid's CRS, of their broadcast shape."""
        parts = np.broadcast_arrays(*(np.asarray(part, np.float64) for part in (x0, y0, x1, y1)))
        if self._ellipsoid is None:
            scale = self._grid.ground_scale
            return np.hypot((parts[2] - parts[0]) * scale[0], (parts[3] - parts[1]) * scale[1])
        to_lonlat, geod, degrees = self._ellipsoid
        a, b = _convert(to_lonlat, *parts[:2]), _convert(to_lonlat, *parts[2:])
        known = np.isfinite(a[0]) & np.isfinite(b[0])
        lon0, lat0, lon1, lat1 = (np.where(known, part * degrees, 0.0).ravel() for part in (*a, *b))
        _, _, length = geod.inv(lon0, lat0, lon1, lat1)
        return np.where(known, np.reshape(length, known.shape), np.nan)

    def circle(self, place: tuple[float, float], radius: float) -> tuple[F64, F64] | None:
        """x, y in the grid's CRS of points around a place, a degree apart, slightly farther than `radius` metres.

        Longitudes go on across 180 degrees. None where the circle goes over a pole, or where the CRS does not reach.
        """
        azimuth = np.arange(360.0)
        wide = radius / math.cos(math.radians(0.5)) * 1.0001
        if self._ellipsoid is None:
            east, north = np.sin(np.radians(azimuth)) * wide, np.cos(np.radians(azimuth)) * wide
            return place[0] + east / self._grid.ground_scale[0], place[1] + north / self._grid.ground_scale[1]
        to_lonlat, geod, degrees = self._ellipsoid
        lon, lat = (np.full(360, float(part) * degrees) for part in to_lonlat.transform(*place))
        middle = lon[0]
        lon, lat, _ = geod.fwd(lon, lat, azimuth, np.full(360, wide))
        lon = middle + (lon - middle + 180) % 360 - 180
        if np.ptp(lon) > 180:
            return None
        x, y = to_lonlat.transform(lon / degrees, lat / degrees, direction="INVERSE")
        return (np.asarray(x), np.asarray(y)) if np.isfinite(x).all() and np.isfinite(y).all() else None

    def within(self, place: tuple[float, float], radius: float, rows: slice, cols: slice) -> NDArray[np.bool_]:
        """Which samples of a window are at most `radius` metres from a place in the grid's CRS.

        Measured on a lattice; other samples are then near enough, too far, or measured themselves.
        """
        grid = self._grid
        j, i = (np.arange(part.start, part.stop) for part in (rows, cols))
        lattice = [
            np.minimum(part // LATTICE * LATTICE + LATTICE // 2, size - 1)
            for part, size in ((j, grid.height), (i, grid.width))
        ]
        (lj, back_j), (li, back_i) = (np.unique(part, return_inverse=True) for part in lattice)
        there = grid.to_crs(li[None, :] + 0.5, lj[:, None] + 0.5)
        distance = self.distance(*place, *there)
        # the farthest that a sample lies from its point of the lattice, with room for the local scale
        corner = grid.to_crs(li[None, :] + 0.5 + LATTICE, lj[:, None] + 0.5 + LATTICE)
        other = grid.to_crs(li[None, :] + 0.5 + LATTICE, lj[:, None] + 0.5 - LATTICE)
        reach = np.fmax(self.distance(*there, *corner), self.distance(*there, *other))
        near, far = ((distance + s * reach)[np.ix_(back_j, back_i)] for s in (-1, 1))
        result = far <= radius
        row, col = np.nonzero(~result & ~(near > radius))
        x, y = grid.to_crs(i[col] + 0.5, j[row] + 0.5)
        result[row, col] = self.distance(*place, x, y) <= radius
        return result

    @functools.cached_property
    def _ellipsoid(self) -> tuple[Transformer, Geod, float] | None:
        """From the grid's CRS to longitudes and latitudes, the ellipsoid, and degrees in their unit; None without."""
        if self._grid.crs is None:
            return None
        crs = _crs(self._grid.crs)
        base, geod = crs.geodetic_crs, crs.get_geod()
        if base is None or geod is None:
            return None
        return _transformer(self._grid.crs, None), geod, math.degrees(base.axis_info[0].unit_conversion_factor)


def _crs(text: str) -> CRS:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(text).to_2d()
    except CRSError as error:
        raise SettingsError(f"crs: expected 'EPSG:n' or WKT, got {text!r} ({error})") from error


@functools.lru_cache(16)
def _transformer(source: str, target: str | None) -> Transformer:
    """Between two CRS, or to the geographic one that a CRS is based on; x or lon first."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    start = _crs(source)
    end = _crs(target) if target is not None else start.geodetic_crs
    assert end is not None, "asked for of CRS on an ellipsoid only"
    try:
        return Transformer.from_crs(start, end, always_xy=True)
    except ProjError as error:
        raise SettingsError(f"crs: no way from {source} to {target} ({error})") from error


def _convert(transformer: Transformer, x: F64, y: F64) -> tuple[F64, F64]:
    a, b = (np.asarray(part, np.float64) for part in transformer.transform(x, y))
    known = np.isfinite(a) & np.isfinite(b)
    return np.where(known, a, np.nan), np.where(known, b, np.nan)
