"""What GDAL and the libraries below it keep while windows of netCDF files are read is bounded."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.transform import from_origin

from orogen.source import open_height

SIZE = 3000
WINDOW = 64


def resident() -> float:
    """Memory of this process (MB)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
@pytest.mark.parametrize("creation", [{"FORMAT": "NC4", "COMPRESS": "DEFLATE", "ZLEVEL": "1"}, {"FORMAT": "NC2"}])
def test_ten_thousand_windows(tmp_path: Path, creation: dict[str, str]) -> None:
    y, x = np.indices((SIZE, SIZE), np.int16)
    data = ((x * 7 + y * 3) % 2000).astype(np.int16)
    place = {"crs": "EPSG:32633", "transform": from_origin(500_000, 5_000_000, 30, 30)}
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=SIZE, height=SIZE, count=1, dtype="int16", **place
    ) as dataset:
        dataset.write(data, 1)
    rasterio.shutil.copy(tmp_path / "dem.tif", tmp_path / "dem.nc", driver="netCDF", **creation)
    source = open_height(tmp_path / "dem.nc")
    rng = np.random.default_rng(1)
    used = []
    for number in range(10_000):
        row, col = (int(start) for start in rng.integers(0, SIZE - WINDOW, 2))
        window = slice(row, row + WINDOW), slice(col, col + WINDOW)
        found = source.read(*window)
        if number % 100 == 0:
            np.testing.assert_array_equal(found, data[window])
        if number % 1000 == 0:
            used.append(resident())
    source.close()
    assert max(used) - used[0] < 96, "GDAL's block cache of 64 MB, and what its threads keep"
    assert max(used[5:]) - used[4] < 8, "it does not go on"
