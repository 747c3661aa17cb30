"""Exported parts lie where the data lie: triangles against the surface, files as other libraries read them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
import trimesh

import orogen
from oracle.landscapes import hills
from orogen.cli import run
from orogen.errors import OutputError, SettingsError
from orogen.export import mesh_of, visible_bounds, with_base, write_heights, write_mesh
from orogen.terrain import Terrain

ROWS, COLUMNS = 121, 150


@pytest.fixture(scope="module")
def raster(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("export") / "hills.tif"
    heights = hills(COLUMNS, 400.0)[:ROWS].astype(np.float32)
    heights[40:60, 70:90] = -9999
    profile = {
        "driver": "GTiff", "width": COLUMNS, "height": ROWS, "count": 1, "dtype": "float32", "nodata": -9999,
        "crs": "EPSG:32611", "transform": rasterio.Affine(30, 0, 400_000, 0, -30, 3_800_000),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as file:
        file.write(heights, 1)
    return path


@pytest.fixture(scope="module")
def terrain(raster: Path):
    image = np.zeros((ROWS, COLUMNS, 3), np.uint8)
    image[..., 0] = np.arange(COLUMNS)
    image[..., 1] = np.arange(ROWS)[:, None]
    with orogen.open(raster, color=image) as opened:
        yield opened


def places(terrain: Terrain, mesh) -> tuple[np.ndarray, np.ndarray]:
    """x, y in the data's CRS of the vertices."""
    sx, sy = terrain.grid.ground_scale
    return mesh.origin[0] + mesh.vertices[:, 0] / sx, mesh.origin[1] + mesh.vertices[:, 1] / sy


def test_a_mesh_lies_on_the_surface_and_leaves_voids_open(terrain: Terrain) -> None:
    mesh = mesh_of(terrain)
    x, y = places(terrain, mesh)
    np.testing.assert_allclose(mesh.vertices[:, 2], terrain.height_at(x, y), atol=1e-3)
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2).astype(np.float64)
    normals = np.cross(b - a, c - a)
    assert (normals[:, 2] > 0).all(), "they look up"
    # all cells but those with a corner in the void, of half a cell each
    assert len(mesh.triangles) == 2 * ((ROWS - 1) * (COLUMNS - 1) - 21 * 21)
    width, height = terrain.res
    sx, sy = terrain.grid.ground_scale
    assert normals[:, 2].sum() / 2 == pytest.approx(len(mesh.triangles) / 2 * width * sx * height * sy, rel=1e-5)


def test_fewer_triangles_come_from_coarser_samples(terrain: Terrain) -> None:
    mesh = mesh_of(terrain, max_triangles=5000)
    assert 1000 < len(mesh.triangles) <= 5000
    x, y = places(terrain, mesh)
    left, bottom, right, top = terrain.bounds
    assert left < x.min()
    assert x.max() < right
    assert bottom < y.min()
    assert y.max() < top
    truth = terrain.height_at(x, y)
    assert np.nanmean(np.abs(mesh.vertices[:, 2] - truth)) < 0.05 * np.nanstd(truth)


def test_images_lie_where_they_are_draped(terrain: Terrain) -> None:
    mesh = mesh_of(terrain, (401_000, 3_797_000, 403_500, 3_799_000))
    assert mesh.image is not None
    high, wide = mesh.image.shape[:2]
    column = np.minimum((mesh.texture[:, 0] * wide).astype(int), wide - 1)
    row = np.minimum(((1 - mesh.texture[:, 1]) * high).astype(int), high - 1)
    tx, ty = terrain.grid.to_texel(*places(terrain, mesh))
    np.testing.assert_allclose(mesh.image[row, column, 0], np.floor(tx), atol=1)
    np.testing.assert_allclose(mesh.image[row, column, 1], np.floor(ty), atol=1)


def test_a_base_makes_it_watertight(terrain: Terrain, tmp_path: Path) -> None:
    solid = with_base(mesh_of(terrain, max_triangles=8000), 100.0)
    write_mesh(tmp_path / "solid.stl", solid)
    made = trimesh.load(tmp_path / "solid.stl")
    assert made.is_watertight
    assert made.is_winding_consistent
    assert made.volume > 0
    assert made.bounds[0][2] == pytest.approx(solid.vertices[:, 2].max() - np.ptp(solid.vertices[:, 2]), abs=1e-2)


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl"])
def test_other_programs_read_the_files(terrain: Terrain, tmp_path: Path, suffix: str) -> None:
    mesh = mesh_of(terrain, max_triangles=8000)
    path = tmp_path / f"part{suffix}"
    write_mesh(path, mesh, crs=terrain.crs)
    made = trimesh.load(path, force="mesh", process=False)
    corners = made.vertices[made.faces]
    if suffix == ".glb":  # y is up there
        corners = corners[..., [0, 2, 1]] * [1, -1, 1]
        assert made.visual.material.baseColorTexture.size == (mesh.image.shape[1], mesh.image.shape[0])
    np.testing.assert_allclose(corners, mesh.vertices[mesh.triangles], atol=0.02)


def test_heights_are_those_of_the_file(terrain: Terrain, raster: Path, tmp_path: Path) -> None:
    write_heights(tmp_path / "part.tif", terrain, (401_000, 3_797_500, 403_000, 3_799_500))
    with rasterio.open(tmp_path / "part.tif") as part, rasterio.open(raster) as whole:
        assert part.crs == whole.crs
        window = rasterio.windows.from_bounds(*part.bounds, whole.transform)
        expected = whole.read(1, window=window, masked=True).filled(np.nan)
        np.testing.assert_array_equal(part.read(1), expected)
        # all centres within the bounds, and no more
        assert part.bounds == pytest.approx((401_000 - 10, 3_797_500 - 10, 403_000 + 10, 3_799_500 + 10), abs=21)


def test_what_a_picture_shows_has_bounds(terrain: Terrain) -> None:
    left, bottom, right, top = terrain.bounds
    camera = terrain.camera(bounds=(left + 900, bottom + 900, left + 1800, bottom + 1600), pitch=-90, heading=0)
    found = visible_bounds(terrain.render(camera, (80, 60), samples=1))
    assert left < found[0] < left + 1000
    assert right > found[2] > left + 1700
    assert bottom < found[1] < bottom + 1000
    assert top > found[3] > bottom + 1500


def test_bad_requests_are_told(terrain: Terrain, tmp_path: Path) -> None:
    for bounds in [(0, 0, 10, 10), (5, 5, 5, 9), (float("nan"), 0, 1, 1)]:
        with pytest.raises(SettingsError, match="bounds: expected"):
            mesh_of(terrain, bounds)
    with pytest.raises(SettingsError, match="at least 2"):
        mesh_of(terrain, max_triangles=1)
    void = (400_000 + 71 * 30, 3_800_000 - 59 * 30, 400_000 + 89 * 30, 3_800_000 - 41 * 30)
    with pytest.raises(SettingsError, match="have data"):
        mesh_of(terrain, void)
    with pytest.raises(SettingsError, match="more than 0"):
        with_base(mesh_of(terrain, max_triangles=100), 0)
    with pytest.raises(OutputError, match="suffix"):
        write_mesh(tmp_path / "part.xyz", mesh_of(terrain, max_triangles=100))


def test_the_command(raster: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "out.glb"
    assert run(["export", str(raster), "-o", str(target), "--max-triangles", "2000", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["triangles"] <= 2000
    assert len(trimesh.load(target, force="mesh").faces) == told["triangles"]
    assert run(["export", str(raster), "-o", str(target)]) == 1, "it exists"
    assert run(["export", str(raster), "-o", str(tmp_path / "out.tif"), "--base", "5"]) == 2
