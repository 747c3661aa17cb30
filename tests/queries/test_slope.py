"""Slope and aspect against Sobel filters of scipy and planes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from oracle.crops import crop
from orogen.errors import SettingsError
from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries
from orogen.source.open import open_height


def test_slopes_are_those_of_horn(data_dir: Path) -> None:
    ndimage = pytest.importorskip("scipy.ndimage")
    heights, grid = crop(data_dir, "taiwan", 300)
    queries = Queries(open_pyramid(open_height(heights, spacing=grid.spacing)))
    h = heights.astype(np.float64)
    # Sobel's weights are Horn's
    east = ndimage.sobel(h, axis=1) / (8 * grid.spacing)
    north = -ndimage.sobel(h, axis=0) / (8 * grid.spacing)
    inner = np.s_[1:-1, 1:-1]
    slope = queries.slope().values()
    np.testing.assert_allclose(slope[inner], np.degrees(np.arctan(np.hypot(east, north)))[inner], rtol=1e-5)
    np.testing.assert_allclose(queries.slope("percent").values()[inner], 100 * np.hypot(east, north)[inner], rtol=1e-5)
    downhill = np.degrees(np.arctan2(-east, -north)) % 360
    off = (queries.aspect().values() - downhill + 180) % 360 - 180
    assert np.nanmax(np.abs(off[inner])) < 1e-3
    assert not np.isnan(slope).any()


def test_planes_keep_their_slope_beside_voids_and_edges() -> None:
    j, i = np.mgrid[:50, :70]
    heights = (3.0 * i + 2.0 * j).astype(np.float32)
    heights[20:25, 30:31] = np.nan
    heights[0, 5] = np.nan
    affine = rasterio.Affine(8.0, 3.0, 471000.0, 2.0, -9.0, 5.2e6)
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=70, height=50, count=1, dtype="float32", transform=affine, nodata=np.nan
        ) as file:
            file.write(heights, 1)
        with memory.open() as file:
            queries = Queries(open_pyramid(open_height(file)))
            slope, aspect = queries.slope("percent").values(), queries.aspect().values()
    # metres per metre: the row of steps times the slope is the rise
    east, north = np.linalg.solve(np.array([[8.0, 2.0], [3.0, -9.0]]), [3.0, 2.0])
    valid = ~np.isnan(heights)
    np.testing.assert_allclose(slope[valid], 100 * np.hypot(east, north), rtol=1e-5)
    np.testing.assert_allclose(aspect[valid], np.degrees(np.arctan2(-east, -north)) % 360, rtol=1e-5)
    np.testing.assert_array_equal(np.isnan(slope), ~valid)


def test_degrees_grow_shorter_to_the_poles() -> None:
    """A rise of 1 m a row and a column from the equator to 80 degrees north: slopes follow each row's true size."""
    j, i = np.mgrid[:161, :40]
    heights = (i - j).astype(np.float32)
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=40, height=161, count=1, dtype="float32", crs="EPSG:4326",
            transform=rasterio.Affine(0.5, 0, 10, 0, -0.5, 80.25),
        ) as file:  # fmt: skip
            file.write(heights, 1)
        with memory.open() as file:
            slope = Queries(open_pyramid(open_height(file))).slope("percent").values()
    latitude = np.radians(80 - 0.5 * np.arange(161))
    e2 = (2 - 1 / 298.257223563) / 298.257223563
    w = np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    east = 1 / (np.radians(0.5) * 6378137 / w * np.cos(latitude))
    north = 1 / (np.radians(0.5) * 6378137 * (1 - e2) / w**3)
    np.testing.assert_allclose(slope, np.broadcast_to(100 * np.hypot(east, north)[:, None], slope.shape), rtol=2e-3)


def test_level_ground_falls_nowhere() -> None:
    queries = Queries(open_pyramid(open_height(np.full((20, 20), 7.0, np.float32), spacing=3.0)))
    assert (queries.slope().values() == 0).all()
    assert np.isnan(queries.aspect().values()).all()
    with pytest.raises(SettingsError, match="unit: expected degrees or percent, got 'gon'"):
        queries.slope("gon")  # type: ignore[arg-type]
