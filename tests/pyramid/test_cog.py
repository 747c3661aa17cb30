"""COGs: valid by the rules of others, with overviews that are the pyramid's levels."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio

from orogen.errors import OutputError, SettingsError
from orogen.keys import level_shape
from orogen.pyramid import build_pyramid, open_pyramid
from orogen.source import open_height
from rasters import write_tiled as write

SHAPE = (1307, 1711)


@pytest.fixture
def dem(tmp_path: Path) -> Path:
    y, x = np.indices(SHAPE)
    rough = np.random.default_rng(1).integers(0, 30, SHAPE)
    data = (1000 + 400 * np.sin(x / 60) * np.cos(y / 45) + rough).astype(np.int16)
    data[100:160, 200:400] = -1
    return write(tmp_path / "dem.tif", data, nodata=-1)


@pytest.mark.parametrize("options", [{}, {"max_error": 0.5}])
def test_a_cog_is_valid_and_its_overviews_are_the_levels(dem: Path, tmp_path: Path, options: dict[str, float]) -> None:
    out = tmp_path / "out.tif"
    built = build_pyramid(dem, out, **options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dem.tif", "out.tif"]
    with rasterio.open(dem) as given, rasterio.open(out) as cog, open_pyramid(open_height(dem)) as pyramid:
        assert cog.profile["driver"] == "GTiff"
        assert cog.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert (cog.crs, cog.transform, cog.shape) == (given.crs, given.transform, given.shape)
        assert cog.units == ("metre",)
        assert (cog.dtypes[0], cog.nodata, cog.scales[0]) == (
            ("int16", -32768, 1.0) if options else ("float32", -1, 1.0)
        )
        count = len(cog.overviews(1)) + 1
        assert count == pyramid.level_count
        for level in range(count):
            rows, cols = level_shape(SHAPE, level)
            choice = {} if level == 0 else {"overview_level": level - 1}
            with rasterio.open(out, **choice) as part:
                assert part.shape == (rows, cols)
                got = part.read(1, masked=True).astype(np.float64) * cog.scales[0]
            expected = np.ma.masked_invalid(pyramid.read(level, slice(0, rows), slice(0, cols)))
            np.testing.assert_array_equal(got.mask, expected.mask)
            assert np.abs(got - expected).max() <= options.get("max_error", 0.0) * (level + 1)
    assert built.layers["height"]["minimum"] == 600 or options
    with open_pyramid(open_height(out)) as again:
        assert again.built


def test_a_validator_agrees(dem: Path, tmp_path: Path) -> None:
    cogeo = pytest.importorskip("rio_cogeo")
    build_pyramid(dem, tmp_path / "out.tif")
    assert cogeo.cog_validate(tmp_path / "out.tif", strict=True) == (True, [], [])


@pytest.mark.parametrize(("nodata", "scale", "kept"), [(-9999, 1.0, -9999), (1100, 2.0, None), (None, 1.0, -9999)])
def test_nodata_is_kept_where_no_height_has_its_value(
    tmp_path: Path, nodata: float | None, scale: float, kept: float | None
) -> None:
    data = (1000 + np.arange(300 * 300).reshape(300, 300) % 200).astype(np.int16)
    data[0, 0] = -9999  # found without being declared
    dem = write(tmp_path / "dem.tif", data, nodata=nodata)
    offset = -1000.0 if scale == 2 else 0.0
    build_pyramid(dem, tmp_path / "out.tif", options={"height_scale": scale, "height_offset": offset})
    with rasterio.open(tmp_path / "out.tif") as cog:
        assert cog.nodata == kept or (kept is None and np.isnan(cog.nodata))
        void = np.isin(data, [-9999, -9999 if nodata is None else nodata])
        got = cog.read(1, masked=True)
        np.testing.assert_array_equal(got.mask, void)
        np.testing.assert_array_equal(got[~void], data[~void] * scale + offset)


def test_a_killed_export_goes_on(dem: Path, tmp_path: Path) -> None:
    script = """
import os, signal, sys
from orogen.pyramid import build_pyramid, cog
def killed(*arguments):
    os.kill(os.getpid(), signal.SIGTERM)
cog.write_cog = killed
build_pyramid(sys.argv[1], sys.argv[2])
"""
    out = tmp_path / "out.tif"
    done = subprocess.run([sys.executable, "-c", script, str(dem), str(out)], capture_output=True, text=True)
    assert done.returncode != 0
    assert not out.exists()
    assert (tmp_path / "out.tif.levels").is_dir()
    build_pyramid(dem, out)
    build_pyramid(dem, tmp_path / "other.tif")
    assert out.read_bytes() == (tmp_path / "other.tif").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dem.tif", "other.tif", "out.tif"]


def test_nothing_is_replaced_unasked(dem: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.tif"
    out.write_text("mine")
    with pytest.raises(OutputError, match="exists; give --force"):
        build_pyramid(dem, out)
    assert out.read_text() == "mine"
    build_pyramid(dem, out, force=True)
    assert open_height(out).grid.shape == SHAPE


def test_a_cog_holds_one_layer(dem: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="a COG holds heights alone; leave out images and layers"):
        build_pyramid(dem, tmp_path / "out.tif", layers={"other": dem})
