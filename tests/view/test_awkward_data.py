"""Awkward rasters on screen: every pixel of the surface lies within the range of the valid samples."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine, from_origin

import orogen


def drawn_heights(data: Any, **options: Any) -> tuple[NDArray[np.float64], float]:
    """Heights (m) of the surface in a small picture of the whole, and what single precision leaves uncertain (m)."""
    with orogen.open(data, **options) as terrain:
        picture = terrain.render(size=(160, 100), samples=1)
        surface = np.asarray(picture.position)[..., 2]
        rows, cols = terrain.shape
        far = float(np.hypot(*(terrain.grid.metres @ (cols, rows))))
        return surface[np.isfinite(surface) & (np.asarray(picture.depth) > 0)].astype(np.float64), 2e-7 * far


REAL = {
    "gz_dem_moon.tif": (-212.29616, -205.4401),
    "gz_dem_nodata.dem": (682, 2932),
    "rasterio_float_nan.tif": (-1.88, 1.41),
    "rasterio_rotated.tif": (0, 149),
    "rasterio_world.byte.tif": (0, 1),
    "riocogeo_image_missing_nodata.tif": (-2000, 8028),
    "riocogeo_image_with_offsets.tif": (999.9106, 1001.3413),
}
"""Lowest and highest valid sample, as GDAL reads them."""


@pytest.mark.parametrize("name", REAL)
def test_awkward_files_draw_no_spike(data_dir: Path, name: str) -> None:
    low, high = REAL[name]
    heights, slack = drawn_heights(data_dir / "bad" / name)
    assert heights.size > 500
    slack += 1e-3 * (high - low)
    assert low - slack <= heights.min()
    assert heights.max() <= high + slack


def hills() -> NDArray[np.float32]:
    y, x = np.indices((90, 120))
    heights: NDArray[np.float32] = (500 + 200 * np.sin(x / 15) * np.cos(y / 12)).astype(np.float32)
    return heights


@pytest.mark.parametrize("garbage", [3.4028235e38, -9999.0, np.nan, -np.inf, 1e12])
def test_no_nodata_of_any_kind_is_drawn(garbage: float) -> None:
    data = hills()
    data[20:50, 30:70] = garbage
    data[80, 110] = garbage
    heights, _ = drawn_heights(data, spacing=30)
    valid = hills()
    assert heights.size > 3000
    assert valid.min() - 0.5 <= heights.min()
    assert heights.max() <= valid.max() + 0.5


@pytest.mark.parametrize(
    "place", [Affine(30, 0, 0, 0, 30, 0), Affine(0, 30, 0, 30, 0, 0), Affine(-30, 0, 0, 0, -30, 0)]
)
def test_however_a_raster_lies_the_same_ground_is_drawn(tmp_path: Path, place: Affine) -> None:
    """The same samples stored from another corner give the same picture."""
    data = hills()
    rows, cols = data.shape
    # what lies where: from the south, with columns to the north and rows to the east, from the east
    flipped = {30.0: data[::-1], 0.0: data[::-1].T, -30.0: data[:, ::-1]}[place.a]
    pictures = []
    for name, samples, where in (
        ("plain.tif", data, from_origin(0, 30 * rows, 30, 30)),
        ("other.tif", flipped, _onto(place, rows, cols)),
    ):
        path = tmp_path / name
        with rasterio.open(
            path, "w", driver="GTiff", width=samples.shape[1], height=samples.shape[0], count=1, dtype="float32",
            crs="EPSG:32633", transform=where,
        ) as dataset:  # fmt: skip
            dataset.write(samples, 1)
        with orogen.open(path) as terrain:
            assert terrain.bounds == pytest.approx((0, 0, 30 * cols, 30 * rows))
            camera = terrain.camera(look_at=(30 * cols / 2, 30 * rows / 2), distance=5000, heading=330, pitch=-40)
            pictures.append(np.asarray(terrain.render(camera, (160, 100), samples=1).depth))
    assert (pictures[0] > 0).mean() > 0.2
    both = (pictures[0] > 0) & (pictures[1] > 0)
    assert ((pictures[0] > 0) != (pictures[1] > 0)).mean() < 0.003
    np.testing.assert_allclose(pictures[0][both], pictures[1][both], rtol=2e-3)


def _onto(place: Affine, rows: int, cols: int) -> Affine:
    """`place` moved so that the raster covers (0, 0) to (30 cols, 30 rows)."""
    if place.a == 0:  # rows run east, columns north
        return Affine(0, 30, 0, 30, 0, 0)
    return Affine(place.a, 0, 0 if place.a > 0 else 30 * cols, 0, place.e, 0 if place.e > 0 else 30 * rows)
