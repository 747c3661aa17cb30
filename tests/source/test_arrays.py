"""Arrays: of numpy in every type and byte order, of xarray with coordinates, and others that can be sliced."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from numpy.typing import NDArray
from rasterio.crs import CRS

from orogen.errors import SourceError
from orogen.source import open_colour, open_height, survey
from rasters import everything


def hills(rows: int = 40, cols: int = 50, dtype: str = "float64") -> NDArray[Any]:
    y, x = np.indices((rows, cols))
    return (50 + 30 * np.sin(x / 20) * np.cos(y / 15) + x / 7).astype(dtype)


def labelled(data: NDArray[Any] | None = None, **attributes: Any) -> xarray.DataArray:
    """Heights with the centres of 30 m samples in UTM as coordinates, rows from north to south."""
    data = hills() if data is None else data
    x, y = 500_015 + 30.0 * np.arange(data.shape[-1]), 4_999_985 - 30.0 * np.arange(data.shape[-2])
    return xarray.DataArray(data, coords={"y": y, "x": x}, dims=("y", "x"), name="dem", attrs=attributes)


def with_crs(array: xarray.DataArray, text: str = "EPSG:32633") -> xarray.DataArray:
    """The same with a CF grid mapping."""
    mapping = xarray.DataArray(0, attrs={"crs_wkt": CRS.from_user_input(text).to_wkt()})
    return array.assign_coords(spatial_ref=mapping)


@pytest.mark.parametrize("kind", ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8", "g"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_every_type_and_byte_order(kind: str, order: str) -> None:
    data = hills().astype(np.dtype(kind).newbyteorder(order))
    got = everything(open_height(data, spacing=1))
    assert got.dtype == np.float32
    assert got.dtype.isnative
    np.testing.assert_array_equal(got, data.astype(np.float32))


@pytest.mark.parametrize(
    ("dtype", "value"),
    [
        ("<f4", -9999),
        (">f4", -9999),
        ("f2", -9999),
        (">i2", -32768),
        ("i8", -(2**63)),
        ("u8", 2**64 - 1),
        (">f8", 1e300),
    ],
)
def test_undeclared_nodata_of_every_type(dtype: str, value: float) -> None:
    data = hills().astype(dtype)
    data[3, 4] = value
    assert np.argwhere(np.isnan(everything(open_height(data, spacing=1)))).tolist() == [[3, 4]]


def test_arrays_of_any_stride_and_of_zarr_and_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    import dask.array
    import zarr

    data = hills(dtype="float32")
    np.testing.assert_array_equal(everything(open_height(data[::-1, ::2], spacing=1)), data[::-1, ::2])
    stored = zarr.create_array({}, shape=data.shape, chunks=(16, 16), dtype="float32")
    stored[:] = data
    for limit in (2**22, 0):
        monkeypatch.setattr(survey, "IN_MEMORY", limit)
        for other in (dask.array.from_array(data, chunks=(16, 16)), stored):
            source = open_height(other, spacing=1)
            np.testing.assert_array_equal(everything(source), data)
            np.testing.assert_array_equal(source.read(slice(5, 9), slice(3, 20)), data[5:9, 3:20])
            assert source.overview((8, 10)).shape == (8, 10)
            assert np.isin(source.overview((8, 10)), data).all()


def test_coordinates_place_an_array() -> None:
    data = hills()
    source = open_height(with_crs(labelled(data)))
    assert source.grid.transform == (30, 0, 500_000, 0, -30, 5_000_000)
    assert CRS.from_user_input(source.grid.crs) == CRS.from_epsg(32633)
    assert source.name == "DataArray 'dem'"
    np.testing.assert_array_equal(everything(source), data.astype(np.float32))
    upwards = open_height(labelled(data).isel(y=slice(None, None, -1)), crs="EPSG:32633")
    assert upwards.grid.transform == (30, 0, 500_000, 0, 30, 5_000_000 - 40 * 30)
    np.testing.assert_array_equal(everything(upwards), data[::-1].astype(np.float32))
    turned = open_height(with_crs(labelled(data).transpose("x", "y").expand_dims("band", 0)))
    np.testing.assert_array_equal(everything(turned), data.astype(np.float32))


def test_degrees_east_are_degrees() -> None:
    array = labelled().rename(x="lon", y="lat")
    array = array.assign_coords(
        lon=("lon", 170 + 0.5 * np.arange(50), {"units": "degrees_east"}), lat=45 - 0.5 * np.arange(40)
    )
    source = open_height(array)
    assert source.grid.crs == "EPSG:4326"
    assert source.grid.bounds == pytest.approx((169.75, 25.25, 194.75, 45.25))


def test_attributes_of_cf_are_applied() -> None:
    data = hills(dtype="int16")
    data[2, 3], data[4, 5] = -1, -2
    packed = labelled(
        data, scale_factor=0.5, add_offset=10.0, _FillValue=-1, missing_value=-2, units="ft", positive="down"
    )
    got = everything(open_height(packed))
    expected = np.where(data < 0, np.nan, -(data * 0.5 + 10) * 0.3048)
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_a_file_of_xarray_is_read_by_window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "IN_MEMORY", 0)
    data = hills()
    labelled(data).to_dataset().to_zarr(tmp_path / "a.zarr")
    with xarray.open_zarr(tmp_path / "a.zarr") as dataset:
        source = open_height(dataset)
        np.testing.assert_array_equal(everything(source), data.astype(np.float32))
        assert source.grid.transform == (30, 0, 500_000, 0, -30, 5_000_000)


def test_crs_warps_an_array() -> None:
    source = open_height(with_crs(labelled()), crs="EPSG:4326")
    assert CRS.from_user_input(source.grid.crs) == CRS.from_epsg(4326)
    got = everything(source)
    assert np.nanmin(got) >= hills().min() - 1e-4
    assert np.nanmax(got) <= hills().max() + 1e-4
    assert np.isfinite(got).mean() > 0.9


def test_without_rioxarray_the_grid_mapping_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rioxarray", None)
    assert CRS.from_user_input(open_height(with_crs(labelled())).grid.crs) == CRS.from_epsg(32633)
    written = with_crs(labelled()).drop_vars(["x", "y"])
    written.coords["spatial_ref"].attrs["GeoTransform"] = "500000 20 7 5000000 7 -20"
    assert open_height(written).grid.transform == (20, 7, 500_000, 7, -20, 5_000_000)


def test_colours_of_xarray_lie_by_their_coordinates() -> None:
    heights = open_height(with_crs(labelled()))
    pixels = np.random.default_rng(1).integers(0, 256, (3, 40, 50), np.uint8)
    array = with_crs(xarray.DataArray(pixels, coords=labelled().coords, dims=("band", "y", "x")))
    colours = open_colour(array, heights)
    np.testing.assert_array_equal(everything(colours)[..., :3], np.moveaxis(pixels, 0, 2))
    assert colours.grid.transform == heights.grid.transform


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (labelled(np.zeros((3, 4), bool)), "'dem': expected numbers as heights, got bool"),
        (labelled().expand_dims(band=3), r"'dem': expected dimensions \(y, x\).*\.isel\(band=0\)"),
        (labelled().rename(x="p").expand_dims(q=2), "cannot tell x from y among the dimensions q, y, p"),
        (labelled().isel(x=[0, 1, 5]), "coordinate x is not evenly spaced"),
        (xarray.Dataset({"a": labelled(), "b": labelled()}), r"expected one variable of heights, got a, b.*dataset\["),
        (xarray.Dataset(), "expected one variable of heights, got none"),
        (labelled().isel(x=[0], y=[0]), "a single sample says nothing of the spacing; give spacing="),
        (labelled(np.full((3, 4), np.nan)), "'dem': no valid sample"),
        (np.zeros((3, 4), "datetime64[s]"), "expected numbers as heights"),
        (np.zeros((3, 4), object), "expected numbers as heights"),
        ([[1, 2], [3, 4]], "an array of numpy or xarray, got list"),
        (None, "got NoneType"),
    ],
)
def test_what_cannot_be_used_is_refused(data: Any, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        open_height(data)
