"""A data set of heights: where it lies, and what can be asked of it."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from orogen.grid import Grid
from orogen.pyramid.contract import Pyramid
from orogen.queries.field import Field
from orogen.queries.queries import Profile, Queries
from orogen.queries.sight import Sight


class Dataset:
    """Heights of any size, with what is known of them and the questions that are asked most. Safe to use from threads.

    Attributes as in rasterio: `crs`, `bounds`, `transform`, `shape`, `res`, `nodata`, `units`, `vertical_crs`.
    """

    def __init__(self, heights: Pyramid) -> None:
        self.heights = heights
        """The pyramid of heights."""
        self._queries = Queries(heights)

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.heights.source.name

    @property
    def grid(self) -> Grid:
        """Georeference of the heights."""
        return self.heights.grid

    @property
    def crs(self) -> str | None:
        """Coordinate reference system as 'EPSG:n' or WKT, or None; units are metres then."""
        return self.grid.crs

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(left, bottom, right, top) in CRS units."""
        return self.grid.bounds

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """(a, b, c, d, e, f): x = a column + b row + c, y = d column + e row + f, of the samples' corners."""
        return self.grid.transform

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.grid.shape

    @property
    def res(self) -> tuple[float, float]:
        """Width and height of a texel in CRS units."""
        a, b, _, d, e, _ = self.grid.transform
        return (a * a + d * d) ** 0.5, (b * b + e * e) ** 0.5

    @property
    def nodata(self) -> float | None:
        """Stored value that stands for nodata, or None."""
        return self.heights.source.nodata

    @property
    def units(self) -> str:
        """Vertical unit as stored, such as 'metre' or 'foot'; heights are given in metres all the same."""
        return self.heights.source.units

    @property
    def vertical_crs(self) -> str | None:
        """Name of the vertical reference, or None."""
        return self.heights.source.vertical_crs

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest valid height (m); an estimate until the pyramid is built."""
        return self.heights.height_range

    @property
    def queries(self) -> Queries:
        """What answers questions about the surface on the CPU; those below, and shadow, slope and aspect."""
        return self._queries

    def height_at(self, x: ArrayLike, y: ArrayLike, *, crs: str | None = None) -> Any:
        """Height (m) of the surface at x, y in the data's CRS, or in `crs`; NaN outside and at nodata.

        A float for plain numbers, else float64 of the broadcast shape. See `orogen.queries.Queries.height_at`. This
        and the questions below raise SettingsError for what they cannot use, such as an unknown CRS, and SourceError or
        StoreError where the data cannot be read.
        """
        heights = self._queries.height_at(x, y, crs=crs)
        return heights if heights.ndim else float(heights)

    def normal_at(self, x: ArrayLike, y: ArrayLike, *, crs: str | None = None) -> Any:
        """(..., 3) unit normals (east, north, up) of the surface at x, y; NaN where `height_at` is.

        See `orogen.queries.Queries.normal_at`.
        """
        return self._queries.normal_at(x, y, crs=crs)

    def raycast(self, origin: ArrayLike, direction: ArrayLike, **options: Any) -> Any:
        """(..., 3) x, y in the data's CRS and height (m) where rays first meet the surface; NaN where they do not.

        `origin`: (..., 3) x, y and height (m). `direction`: (..., 3) metres east, north and up, of any length. Options:
        crs of the origin, curvature and refraction, see `orogen.queries.Queries.raycast`.
        """
        return self._queries.raycast(origin, direction, **options)

    def line_of_sight(self, a: ArrayLike, b: ArrayLike, **options: Any) -> Sight:
        """Whether b is seen from a: (..., 3) x, y and metres above the ground, each.

        Options: crs of both, curvature and refraction, see `orogen.queries.Queries.line_of_sight`.
        """
        return self._queries.line_of_sight(a, b, **options)

    def profile(self, points: ArrayLike, step: float | None = None, *, crs: str | None = None) -> Profile:
        """Heights along a line through points (n, 2), every `step` metres at most; None: every sample.

        See `orogen.queries.Queries.profile`.
        """
        return self._queries.profile(points, step, crs=crs)

    def viewshed(self, observer: tuple[float, float], **options: Any) -> Field:
        """What is seen from a place x, y: a raster on the data's samples, computed by window when it is asked for.

        Options: height and target_height (metres above the ground), radius (m), crs, curvature and refraction, see
        `orogen.queries.Queries.viewshed`.
        """
        return self._queries.viewshed(observer, **options)
