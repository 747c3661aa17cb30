"""Files of which GDAL takes what is cut off for zeros, or for a raster without a mask."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil

from orogen.errors import SourceError
from orogen.source import open_height
from rasters import everything, hills, write

FORMATS: dict[str, dict[str, Any]] = {
    "dem.envi": {"driver": "ENVI"},
    "dem.bil": {"driver": "EHdr"},
    "dem.ers": {"driver": "ERS"},
    "dem.nc": {"driver": "netCDF", "FORMAT": "NC2"},
    "dem.gpkg": {"driver": "GPKG"},
    "dem.pix": {"driver": "PCIDSK"},
    "dem.gtx": {"driver": "GTX"},
    "dem.cub": {"driver": "ISIS3"},
    "dem.vic": {"driver": "VICAR"},
    "dem.map": {"driver": "PCRaster"},
    "dem.xml": {"driver": "PDS4"},
}
LARGEST = {"dem.ers": "dem", "dem.xml": "dem.img"}
"""Where the samples lie, if not in the file that is opened."""


@pytest.mark.parametrize("name", FORMATS)
def test_it_is_refused(tmp_path: Path, name: str) -> None:
    plain = write(tmp_path / "plain.tif", hills(150, 130, "float32"))
    rasterio.shutil.copy(plain, tmp_path / name, **FORMATS[name])
    with rasterio.open(tmp_path / name) as dataset:
        expected = dataset.read(1)
    source = open_height(tmp_path / name)
    np.testing.assert_array_equal(everything(source), expected)
    source.close()
    samples = tmp_path / LARGEST.get(name, name)
    data = samples.read_bytes()
    for share in (0.6, 0.97):
        samples.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(SourceError, match=rf"{samples.name}: cannot be read as a raster: "):
            open_height(tmp_path / name)


@pytest.mark.parametrize("layout", [{}, {"BIGTIFF": "YES"}, {"ENDIANNESS": "BIG"}])
def test_a_mask_that_is_cut_off_is_not_forgotten(tmp_path: Path, layout: dict[str, str]) -> None:
    mask = np.full((60, 70), 255, np.uint8)
    mask[10:20, 30:50] = 0
    path = write(tmp_path / "dem.tif", hills(), compress="deflate", **layout)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(mask)
    np.testing.assert_array_equal(np.isnan(everything(open_height(path))), mask == 0)
    data = path.read_bytes()
    path.write_bytes(data[:-100])
    with rasterio.open(path) as dataset:
        assert dataset.read_masks(1).all(), "GDAL shows what the mask hid"
    with pytest.raises(SourceError, match=r"dem\.tif: cannot be read as a raster: it is cut off"):
        open_height(path)


def test_records_of_netcdf_files_are_counted(tmp_path: Path) -> None:
    """Of variables along an unlimited dimension the parts of a record follow each other."""
    from scipy.io import netcdf_file

    path = tmp_path / "dem.nc"
    with netcdf_file(path, "w") as file:
        for name, size in (("time", None), ("y", 20), ("x", 30)):
            file.createDimension(name, size)
        for name, kind, axes in (("z", "h", ("time", "y", "x")), ("time", "d", ("time",)), ("flag", "b", ("time",))):
            file.createVariable(name, kind, axes)
        file.variables["z"][:] = hills(20, 30)[None].repeat(3, axis=0)
        file.variables["time"][:] = [0, 1, 2]
        file.variables["flag"][:] = [1, 1, 1]
    named = f'NETCDF:"{path}":z'
    assert everything(open_height(named, spacing=1)).shape == (20, 30)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(SourceError, match=r"dem\.nc: .*damaged netCDF header, values up to byte"):
        open_height(named, spacing=1)
