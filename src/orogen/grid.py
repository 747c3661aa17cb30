"""Where a raster lies: texels, CRS coordinates and true metres.

Texel coordinates (tx, ty) count columns to the right and rows downwards; sample (column i, row j) has its centre at
(i + 0.5, j + 0.5), the area convention of GDAL. The surface is drawn over the hull of the sample centres,
[0.5, width - 0.5] x [0.5, height - 0.5], so that no height is ever extrapolated at level 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.errors import SourceError

EARTH_RADIUS = 6371008.8
"""Mean radius of the earth (m)."""


@dataclass(frozen=True)
class Grid:
    """The georeference of a raster."""

    width: int
    """Columns."""
    height: int
    """Rows."""
    transform: tuple[float, float, float, float, float, float]
    """(a, b, c, d, e, f): x = a tx + b ty + c, y = d tx + e ty + f in CRS units, as in rasterio's `Affine`."""
    crs: str | None = None
    """Coordinate reference system as 'EPSG:n' or WKT; None where the raster has none (units are metres then)."""
    ground_scale: tuple[float, float] = (1.0, 1.0)
    """True metres per CRS unit along x and y at the raster's centre."""

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise SourceError(f"expected a raster of at least 1 x 1 samples, got {self.width} x {self.height}")
        a, b, _, d, e, _ = self.transform
        if not np.all(np.isfinite(self.transform)) or a * e - b * d == 0:
            raise SourceError(f"expected an invertible geotransform, got {self.transform}; give spacing= to replace it")

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.height, self.width

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(left, bottom, right, top) of the pixel area in CRS units."""
        x, y = self.to_crs([0, self.width, 0, self.width], [0, 0, self.height, self.height])
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    @cached_property
    def metres(self) -> NDArray[np.float64]:
        """2 x 2 matrix that turns a step in texels (columns, rows) into metres (east, north); read-only."""
        a, b, _, d, e, _ = self.transform
        sx, sy = self.ground_scale
        result = np.array([[a * sx, b * sx], [d * sy, e * sy]])
        result.flags.writeable = False
        return result

    @cached_property
    def texels(self) -> NDArray[np.float64]:
        """2 x 2 matrix that turns a step in metres (east, north) into texels (columns, rows); read-only."""
        result: NDArray[np.float64] = np.linalg.inv(self.metres).astype(np.float64)
        result.flags.writeable = False
        return result

    @cached_property
    def spacing(self) -> float:
        """Mean distance of neighbouring samples (m)."""
        return float(np.sqrt(abs(np.linalg.det(self.metres))))

    def to_texel(self, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Texel coordinates (tx, ty) of CRS coordinates."""
        a, b, c, d, e, f = self.transform
        dx, dy = np.asarray(x, np.float64) - c, np.asarray(y, np.float64) - f
        det = a * e - b * d
        return (e * dx - b * dy) / det, (a * dy - d * dx) / det

    def texel_of(self, x: float, y: float) -> tuple[float, float]:
        """`to_texel` of one place."""
        a, b, c, d, e, f = self.transform
        dx, dy, det = x - c, y - f, a * e - b * d
        return (e * dx - b * dy) / det, (a * dy - d * dx) / det

    def to_crs(self, tx: ArrayLike, ty: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """CRS coordinates of texel coordinates."""
        a, b, c, d, e, f = self.transform
        tx, ty = np.asarray(tx, np.float64), np.asarray(ty, np.float64)
        return a * tx + b * ty + c, d * tx + e * ty + f
