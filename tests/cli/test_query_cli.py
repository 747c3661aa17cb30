"""The commands that ask the surface: what they print and write, and what they refuse."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.warp import transform

from orogen.terrain import open_terrain
from rasters import cone, write

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cone of 1000 m in the middle of 300 x 320 samples of 30 m, a hole in it."""
    path = tmp_path_factory.mktemp("dem") / "cone.tif"
    heights = cone(300, 320)
    heights[10:14, 10:14] = -9999
    transform = rasterio.Affine(30.0, 0.0, 500000.0, 0.0, -30.0, 4000000.0)
    return write(path, heights, transform=transform, nodata=-9999, tiled=True, blockxsize=128, blockysize=128)


def place(column: float, row: float) -> str:
    return f"{500000 + 30 * column},{4000000 - 30 * row}"


def test_height(call: Call, dem: Path) -> None:
    x, y = place(160.5, 150.5).split(",")
    assert call("height", dem, x, y)[:2] == (0, "1000\n")
    (lon,), (lat,) = transform("EPSG:32633", "EPSG:4326", [float(x)], [float(y)])
    code, out, _ = call("height", dem, lon, lat, "--point-crs", "EPSG:4326", "--json")
    assert code == 0
    assert json.loads(out)["height"] == pytest.approx(1000, abs=1e-3)
    assert call("height", dem, -5, -7.5)[:2] == (0, "nan\n")
    code, _, err = call("height", dem, x, y, "--point-crs", "EPSG:1")
    assert code == 2
    assert "expected 'EPSG:n' or WKT, got 'EPSG:1'" in err


def test_profile_as_table_csv_and_json(call: Call, dem: Path) -> None:
    ends = ("--from", place(100.5, 150.5), "--to", place(220.5, 150.5))
    code, out, _ = call("profile", dem, *ends, "--step", 30, "--csv")
    assert code == 0
    rows = list(csv.DictReader(io.StringIO(out)))
    distance, height = (np.array([float(row[key]) for row in rows]) for key in ("distance", "height"))
    # 120 samples of 30 m, 0.9996 of the true length on the zone's central meridian
    assert distance[-1] == pytest.approx(3600 / 0.9996, rel=1e-5)
    across = np.abs(np.array([float(row["x"]) for row in rows]) - (500000 + 30 * 160.5)) / 30
    np.testing.assert_allclose(height, np.maximum(0, 1000 - 25 * across), atol=0.5)
    code, out, _ = call("profile", dem, *ends, "--json")
    assert json.loads(out)["complete"] is True
    code, out, _ = call("profile", dem, *ends, "--step", 1000)
    assert out.splitlines()[0].split() == ["distance", "height", "x", "y"]
    assert len(out.splitlines()) == 6
    assert call("profile", dem, *ends, "--csv", "--json")[0] == 2
    # what is missing is empty in tables of values and null in JSON
    hole = ("--from", place(8, 12), "--to", place(16, 12))
    assert ",," in call("profile", dem, *hole, "--csv")[1]
    assert None in json.loads(call("profile", dem, *hole, "--json")[1])["height"]


def test_sight(call: Call, dem: Path) -> None:
    through = ("--from", place(60.5, 150.5), "--to", place(260.5, 150.5))
    code, out, _ = call("sight", dem, *through, "--json")
    found = json.loads(out)
    assert code == 0
    assert found["visible"] is False
    assert found["known"] is True
    assert found["distance"] == pytest.approx(6000 / 0.9996, rel=1e-5)
    # the foot of the cone
    assert found["obstacle"][0] == pytest.approx(500000 + 30 * 120.5, abs=30)
    code, out, _ = call("sight", dem, *through, "--height", 1100, "--target-height", 1100)
    assert out.splitlines()[0].split() == ["visible", "yes"]


def test_viewshed(call: Call, dem: Path, tmp_path: Path) -> None:
    path = tmp_path / "seen.tif"
    arguments = ("viewshed", dem, "--at", place(160.5, 150.5), "--height", 10, "--radius", 3000, "-o", path)
    code, out, _ = call(*arguments, "--json")
    assert code == 0
    facts = json.loads(out)
    with rasterio.open(path) as file:
        values = file.read(1)
        assert file.crs == rasterio.CRS.from_epsg(32633)
        assert file.nodata == 255
        assert file.profile["tiled"]
        j, i = np.nonzero(values != 255)
        x, y = file.transform @ (i + 0.5, j + 0.5)
    assert {key: int((values == value).sum()) for key, value in (("seen", 1), ("hidden", 0), ("unknown", 255))} == {
        key: facts[key] for key in ("seen", "hidden", "unknown")
    }
    with open_terrain(str(dem)) as terrain:
        top = [500000 + 30 * 160.5, 4000000 - 30 * 150.5, 10.0]
        lines = terrain.line_of_sight(top, np.stack([x, y, np.zeros(len(x))], axis=-1))
    np.testing.assert_array_equal(values[j, i] == 1, lines.visible)
    assert lines.distance.max() <= 3000
    assert len(x) == pytest.approx(math.pi * 100**2, rel=0.02)
    before = path.read_bytes()
    code, _, err = call(*arguments)
    assert code == 1
    assert "exists already" in err
    assert path.read_bytes() == before
    assert call(*arguments, "--force")[0] == 0
    code, _, err = call("viewshed", dem, "--at", "0,0", "-o", tmp_path / "none.tif")
    assert code == 2
    assert "observer: expected a place with data, got 0, 0" in err
    assert not (tmp_path / "none.tif").exists()


def test_shadow_and_slope(call: Call, dem: Path, tmp_path: Path) -> None:
    code, out, _ = call("shadow", dem, "--sun", "270,20", "-o", tmp_path / "lit.tif", "--json")
    assert code == 0
    with rasterio.open(tmp_path / "lit.tif") as file:
        lit = file.read(1)
        with open_terrain(str(dem)) as terrain:
            np.testing.assert_array_equal(lit, terrain.queries.shadow((270.0, 20.0)).values())
    assert json.loads(out)["unknown"] == 16
    assert (lit[:, :100] != 0).all()
    assert (lit[150, 170:200] == 0).all()
    assert call("slope", dem, "-o", tmp_path / "slope.tif", "--unit", "percent", "--aspect")[0] == 0
    with rasterio.open(tmp_path / "slope.tif") as file:
        slope, aspect = file.read()
        assert file.descriptions == ("slope", "aspect")
        assert np.isnan(file.nodata)
    # differences over three samples of a round slope are a little less
    assert slope[150, 170] == pytest.approx(100 * 25 / 30 * 0.9996, rel=5e-3)
    assert aspect[150, 170] == pytest.approx(90, abs=1e-3)
    assert np.isnan(aspect[290, 10])
    assert call("slope", dem, "-o", tmp_path / "slope.png")[0] == 1
    assert call("shadow", dem, "--sun", "270,-5", "-o", tmp_path / "night.tif")[0] == 2
