"""A source in another grid: its windows are warped bilinearly when they are read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source.contract import Kind, Source
from orogen.source.derived import DerivedSource
from orogen.source.gdal import GDAL_ERRORS
from orogen.source.georeference import check_stretch, make_grid
from orogen.source.heights import check_window
from orogen.source.scale import parse_crs

if TYPE_CHECKING:
    from rasterio.crs import CRS

STEP = 16
"""Samples between the points whose place in the other grid is computed exactly."""


@dataclass(frozen=True)
class WarpedSource(DerivedSource):
    """A `Source` of heights or colours in the grid of another one."""

    grid: Grid
    """The grid to read it in."""
    block: tuple[int, int] = field(default=(512, 512), init=False)
    """(rows, columns) worth reading at once."""
    direct: bool = field(default=False, init=False)
    """Warping is not cheap."""
    covered: bool = field(default=False, init=False)
    """The edges of a warped raster are seldom filled."""

    @property
    def fingerprint(self) -> str | None:
        """Changes with the source and the grid."""
        mark = self.source.fingerprint
        return mark and f"{mark}|{self.grid.shape}|{self.grid.transform}|{self.grid.crs}"

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        """As `Source.read`; what lies outside the source is nodata."""
        check_window(rows, cols, self.grid.shape, self.name)
        return warped_window(self.source, self.grid, rows, cols)

    def overview(self, shape: tuple[int, int]) -> NDArray[Any]:
        """An overview of the source, warped."""
        shape = min(shape[0], self.grid.height), min(shape[1], self.grid.width)
        return resampled_overview(self.source, self.grid, shape, slice(0, shape[0]), slice(0, shape[1]))


def warped_grid(grid: Grid, crs: str, name: str) -> Grid:
    """A grid in another CRS with about as many samples as `grid`."""
    from rasterio.transform import Affine, array_bounds
    from rasterio.warp import calculate_default_transform

    wanted = parse_crs(crs)
    try:
        if grid.transform[1] or grid.transform[3]:
            raise SourceError(f"{name}: a rotated raster cannot be warped to {crs}; warp it first (gdalwarp)")
        bounds = array_bounds(grid.height, grid.width, Affine(*grid.transform))
        transform, width, height = calculate_default_transform(
            parse_crs(grid.crs or ""), wanted, grid.width, grid.height, *bounds
        )
    except GDAL_ERRORS as error:
        raise (
            error
            if isinstance(error, SourceError)
            else SourceError(f"{name}: cannot be warped to {crs} ({error}); give another crs=")
        ) from error
    return make_grid(width, height, tuple(transform)[:6], wanted, None, name)


def warped_source(source: Source, crs: CRS) -> WarpedSource:
    """A source in another CRS, in a grid of about as many samples."""
    grid = warped_grid(source.grid, crs.to_wkt(), source.name)
    check_stretch(source.grid, grid, source.name)
    return WarpedSource(source, grid)


def warped_window(source: Source, grid: Grid, rows: slice, cols: slice) -> NDArray[Any]:
    """A window of `grid` from a source in any other grid, nodata outside."""
    tx, ty = _places(grid, source.grid, rows, cols)
    own = _cover(tx, ty, source.grid.shape)
    if own is None:
        return empty((rows.stop - rows.start, cols.stop - cols.start), source.kind)
    return sampled(source.read(*own), tx - own[1].start, ty - own[0].start, source.kind)


def resampled_overview(source: Source, grid: Grid, shape: tuple[int, int], rows: slice, cols: slice) -> NDArray[Any]:
    """A window of `grid` decimated to `shape`, from an overview of a source in any grid."""
    to = _scaled(grid, shape[1], shape[0])
    factor = max(1.0, to.spacing / source.grid.spacing)
    own = source.grid
    small = source.overview((max(1, round(own.height / factor)), max(1, round(own.width / factor))))
    return sampled(small, *_places(to, _scaled(own, small.shape[1], small.shape[0]), rows, cols), source.kind)


def border(grid: Grid, frame: Grid, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Texel coordinates in `frame` of points all around a grid; SourceError where it does not lie in that CRS."""
    from rasterio.warp import transform

    along = np.linspace(0, 1, 65)
    tx = np.concatenate([along, along, 0 * along, 0 * along + 1]) * grid.width
    ty = np.concatenate([0 * along, 0 * along + 1, along, along]) * grid.height
    x, y = grid.to_crs(tx, ty)
    try:
        if grid.crs != frame.crs:
            x, y = map(np.asarray, transform(parse_crs(grid.crs or ""), parse_crs(frame.crs or ""), x, y))
    except GDAL_ERRORS as error:
        raise SourceError(f"{name}: cannot be warped to {frame.crs} ({error}); give another crs=") from error
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise SourceError(f"{name}: reaches beyond where {frame.crs} is defined; give another crs=")
    return frame.to_texel(x, y)


def empty(shape: tuple[int, int], kind: Kind) -> NDArray[Any]:
    """Nodata of a kind: NaN or transparent."""
    return np.full(shape, np.nan, np.float32) if kind == "height" else np.zeros((*shape, 4), np.uint8)


def sampled(samples: NDArray[Any], tx: NDArray[np.float64], ty: NDArray[np.float64], kind: Kind) -> NDArray[Any]:
    """Samples at texel coordinates, bilinearly of those that are valid; nodata where less than half is."""
    bands = samples[..., None].astype(np.float64) if kind == "height" else samples.astype(np.float64)
    valid = np.isfinite(bands[..., 0]) if kind == "height" else bands[..., 3] > 0
    weight = valid.astype(np.float64) if kind == "height" else bands[..., 3] / 255
    values = np.where(valid[..., None], bands if kind == "height" else bands[..., :3], 0.0) * weight[..., None]
    height, width = valid.shape
    known = np.isfinite(tx) & np.isfinite(ty)
    u, v = np.where(known, tx, -9.0) - 0.5, np.where(known, ty, -9.0) - 0.5
    col, row = np.floor(u), np.floor(v)
    total, part = np.zeros((*u.shape, values.shape[2])), np.zeros(u.shape)
    for j in (0, 1):
        for i in (0, 1):
            x, y = col + i, row + j
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            x, y = np.where(inside, x, 0).astype(np.intp), np.where(inside, y, 0).astype(np.intp)
            share = np.where(inside, (1 - np.abs(u - col - i)) * (1 - np.abs(v - row - j)), 0.0)
            total += share[..., None] * values[y, x]
            part += share * weight[y, x]
    enough = part >= 0.5 if kind == "height" else part > 0
    mean = total / np.where(enough, part, 1.0)[..., None]
    if kind == "height":
        return np.where(enough, mean[..., 0], np.nan).astype(np.float32)
    return np.rint(np.dstack([np.where(enough[..., None], mean, 0.0), part * 255])).astype(np.uint8)


def _places(grid: Grid, own: Grid, rows: slice, cols: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Texel coordinates in `own` of the centres of the samples of a window of `grid`; NaN where it has none.

    Exact at the knots of a lattice that does not depend on the window, linear between them: windows meet.
    """
    from rasterio.warp import transform

    knots = [np.arange(part.start // STEP, -(-part.stop // STEP) + 1) * float(STEP) for part in (rows, cols)]
    x, y = grid.to_crs(*np.meshgrid(knots[1], knots[0]))
    if own.crs != grid.crs:
        shape = x.shape
        try:
            moved = transform(parse_crs(grid.crs or ""), parse_crs(own.crs or ""), x.ravel(), y.ravel())
        except GDAL_ERRORS as error:
            raise SourceError(f"cannot be warped from {own.crs} to {grid.crs} ({error})") from error
        x, y = (np.asarray(axis, np.float64).reshape(shape) for axis in moved)
    with np.errstate(invalid="ignore"):
        lattice = own.to_texel(np.where(np.isfinite(x), x, np.nan), np.where(np.isfinite(y), y, np.nan))
    at = [(np.arange(part.start, part.stop) + 0.5) / STEP - part.start // STEP for part in (rows, cols)]
    first = [np.floor(axis).astype(np.intp) for axis in at]
    down, right = (at[0] - first[0])[:, None], (at[1] - first[1])[None, :]
    result = []
    for axis in lattice:
        corners = [axis[np.ix_(first[0] + j, first[1] + i)] for j in (0, 1) for i in (0, 1)]
        upper, lower = (corners[k] + (corners[k + 1] - corners[k]) * right for k in (0, 2))
        result.append(upper + (lower - upper) * down)
    return result[0], result[1]


def _cover(tx: NDArray[np.float64], ty: NDArray[np.float64], shape: tuple[int, int]) -> tuple[slice, slice] | None:
    """The window that holds all samples around some texel coordinates; None where they lie outside."""
    known = np.isfinite(tx) & np.isfinite(ty)
    if not known.any():
        return None
    result = []
    for at, size in ((ty[known], shape[0]), (tx[known], shape[1])):
        low, high = max(0, int(np.floor(at.min() - 0.5))), min(size, int(np.floor(at.max() - 0.5)) + 2)
        if low >= high:
            return None
        result.append(slice(low, high))
    return result[0], result[1]


def _scaled(grid: Grid, width: int, height: int) -> Grid:
    """A grid over the same area with another number of samples."""
    a, b, c, d, e, f = grid.transform
    sx, sy = grid.width / width, grid.height / height
    return Grid(width, height, (a * sx, b * sy, c, d * sx, e * sy, f), grid.crs, grid.ground_scale)
