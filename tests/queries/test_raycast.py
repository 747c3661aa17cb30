"""Rays on the CPU: against a walk of every cell, Embree's triangles, pictures, and themselves in numpy."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from oracle.cellwalk import first_hits
from oracle.crops import crop
from orogen.camera import Camera
from orogen.compare.embree import EmbreeSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries, blocks, march, pages
from orogen.source.open import open_height
from orogen.terrain import open_terrain
from orogen.view.renderer import Scene

KERNELS = ("compiled", "numpy")


@pytest.fixture(params=KERNELS)
def kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What solves cells: compiled or numpy."""
    if request.param == "numpy":
        monkeypatch.setattr(march, "_solver", lambda: march.solve)
    else:
        pytest.importorskip("numba")
        assert march._solver() is not march.solve
    return request.param


def ground(data_dir: Path, size: int = 600, holes: bool = False) -> tuple[NDArray[np.float32], Pyramid]:
    """A crop that takes several blocks, with voids if asked for."""
    heights, grid = crop(data_dir, "taiwan", size)
    if holes:
        rng = np.random.default_rng(6)
        heights = heights.copy()
        heights[rng.random(heights.shape) < 0.03] = np.nan
        heights[200:280, 150:260] = np.nan
    return heights, open_pyramid(open_height(heights, spacing=grid.spacing))


def random_rays(pyramid: Pyramid, count: int, seed: int = 7) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays from above, inside and beside the data, most of them going down."""
    rng = np.random.default_rng(seed)
    left, bottom, right, top = pyramid.grid.bounds
    low, high = pyramid.height_range
    margin = 0.2 * (right - left)
    origin = np.stack(
        [
            rng.uniform(left - margin, right + margin, count),
            rng.uniform(bottom - margin, top + margin, count),
            rng.uniform(low - 100, high + 900, count),
        ],
        axis=-1,
    )
    direction = rng.normal(size=(count, 3)) * [1, 1, 0.3] - [0, 0, 0.2]
    # along rows and columns, and exactly through samples
    direction[: count // 20, 0] = 0
    direction[count // 20 : count // 10, 1] = 0
    origin[count // 20 : count // 10, 1] = top - pyramid.grid.spacing * (np.arange(count // 10 - count // 20) + 0.5)
    return origin, direction


@pytest.mark.parametrize("holes", [False, True])
def test_hits_are_those_of_a_walk_through_every_cell(data_dir: Path, kernel: str, holes: bool) -> None:
    heights, pyramid = ground(data_dir, holes=holes)
    origin, direction = random_rays(pyramid, 2000)
    found = Queries(pyramid).raycast(origin, direction)
    middle = Camera(float(np.mean(pyramid.grid.bounds[::2])), float(np.mean(pyramid.grid.bounds[1::2])), 500.0)
    t = first_hits(Frame(middle, pyramid.grid, (8, 8)), heights, origin - [middle.x, middle.y, middle.z], direction)
    expected = origin + t[:, None] * direction
    assert 200 < np.isnan(expected[:, 0]).sum() < 1700
    # voids are filled in float32 by the pyramid, in float64 by the walk
    np.testing.assert_allclose(found, expected, atol=2e-3 if holes else 1e-8)


def test_rays_bend_as_in_pictures(data_dir: Path, kernel: str) -> None:
    heights, pyramid = ground(data_dir)
    left, bottom, right, top = pyramid.grid.bounds
    eye = Camera(left + 0.3 * (right - left), bottom + 0.4 * (top - bottom), pyramid.height_range[1] + 50)
    _, direction = random_rays(pyramid, 2000, seed=8)
    queries = Queries(pyramid)
    found = queries.raycast([eye.x, eye.y, eye.z], direction, curvature=True)
    frame = Frame(eye, pyramid.grid, (8, 8), curvature=True)
    t = first_hits(frame, heights, np.zeros_like(direction), direction)
    flat = t[:, None] * direction
    expected = np.array([eye.x, eye.y, eye.z]) + flat
    expected[:, 2] += (flat[:, :2] ** 2).sum(axis=1) / (2 * 6371008.8)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    straight = queries.raycast([eye.x, eye.y, eye.z], direction)
    assert np.nanmax(np.abs(straight - found)) > 0.1


def test_rays_agree_with_embree(data_dir: Path) -> None:
    pytest.importorskip("embreex")
    heights, grid = crop(data_dir, "puget", 65)
    pyramid = open_pyramid(open_height(heights, spacing=grid.spacing))
    left, bottom, right, top = pyramid.grid.bounds
    eye = Camera((left + right) / 2, (bottom + top) / 2, float(heights.max()) + 300)
    surface = EmbreeSurface(Frame(eye, pyramid.grid, (8, 8)), heights)
    _, direction = random_rays(pyramid, 1500, seed=9)
    t, _ = surface.cast(np.zeros_like(direction), direction)
    found = Queries(pyramid).raycast([eye.x, eye.y, eye.z], direction)
    assert (np.isnan(t) == np.isnan(found[:, 0])).mean() > 0.999
    both = ~np.isnan(t) & ~np.isnan(found[:, 0])
    off = np.linalg.norm(found[both] - ([eye.x, eye.y, eye.z] + t[both, None] * direction[both]), axis=1)
    assert np.percentile(off, 99) < 0.02 * grid.spacing


def test_compiled_and_numpy_give_the_same(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    _, pyramid = ground(data_dir, holes=True)
    origin, direction = random_rays(pyramid, 20_000, seed=10)
    compiled = Queries(pyramid).raycast(origin, direction)
    monkeypatch.setattr(march, "_solver", lambda: march.solve)
    np.testing.assert_allclose(Queries(pyramid).raycast(origin, direction), compiled, atol=1e-9)


def test_a_pyramid_that_is_not_built_gives_the_same(data_dir: Path, kernel: str) -> None:
    heights, pyramid = ground(data_dir, holes=True)
    spacing = pyramid.grid.spacing
    rough = open_pyramid(open_height(heights, spacing=spacing), build="never")
    assert not rough.built
    origin, direction = random_rays(pyramid, 500, seed=11)
    np.testing.assert_array_equal(
        Queries(rough).raycast(origin, direction), Queries(pyramid).raycast(origin, direction)
    )


def test_no_ray_slips_between_cells(data_dir: Path, kernel: str) -> None:
    """Rays through corners and along edges of cells, down from above: all of them meet the ground, where it is."""
    heights, pyramid = ground(data_dir)
    rows, columns = heights.shape
    rng = np.random.default_rng(12)
    j, i = rng.integers(1, rows - 1, 4000), rng.integers(1, columns - 1, 4000)
    x, y = pyramid.grid.to_crs(i + 0.5, j + 0.5)
    target = np.stack([x, y, heights[j, i].astype(np.float64)], axis=-1)
    away = rng.integers(-3, 4, (4000, 2)) * pyramid.grid.spacing
    origin = target + np.column_stack([away, np.full(4000, 5000.0)])
    found = Queries(pyramid).raycast(origin, target - origin)
    inside = ~np.isnan(found[:, 0])
    assert inside.all()
    np.testing.assert_allclose(found[away.any(axis=1) == 0], target[away.any(axis=1) == 0], atol=1e-7)
    # nothing is met below the ground
    level = Queries(pyramid).height_at(found[:, 0], found[:, 1])
    np.testing.assert_allclose(found[:, 2], level, atol=1e-6)


def test_unusable_rays(data_dir: Path) -> None:
    _, pyramid = ground(data_dir, size=64)
    queries = Queries(pyramid)
    left, bottom, right, top = pyramid.grid.bounds
    above = [(left + right) / 2, (bottom + top) / 2, 1e4]
    directions = [[0, 0, 0], [np.nan, 0, -1], [0, 0, 1], [0, 0, -1], [1, 0, 0]]
    found = queries.raycast(above, directions)
    assert np.isnan(found[:, 0]).tolist() == [True, True, True, False, True]
    np.testing.assert_allclose(found[3, 2], queries.height_at(above[0], above[1]))
    with pytest.raises(
        SettingsError, match=r"direction: expected x, y and a height, shape \(..., 3\), got shape \(2,\)"
    ):
        queries.raycast(above, [0, -1])
    with pytest.raises(SettingsError, match="refraction: expected 0 to 1"):
        queries.raycast(above, [0, 0, -1], curvature=True, refraction=2.0)


@pytest.mark.parametrize("curvature", [False, True])
def test_pictures_show_what_rays_meet(gpu: object, data_dir: Path, curvature: bool) -> None:
    heights, grid = crop(data_dir, "taiwan", 300)
    with closing(
        open_terrain(heights, spacing=grid.spacing, algorithm="raycast", settings={"view_distance": np.inf})
    ) as terrain:
        camera = terrain.camera(pitch=-20)
        picture = terrain.render(camera, (160, 100), scene=Scene(curvature=curvature), samples=1)
        _, direction = picture.frame.rays()
        found = terrain.raycast([camera.x, camera.y, camera.z], direction, curvature=curvature, refraction=0.0)
        both = np.isfinite(picture.position[..., 0]) & np.isfinite(found[..., 0])
        assert both.mean() > 0.3
        assert (np.isfinite(picture.position[..., 0]) == np.isfinite(found[..., 0])).mean() > 0.999
        off = np.linalg.norm(picture.position - found, axis=-1)[both]
        pixel = (
            np.linalg.norm(found[both] - [camera.x, camera.y, camera.z], axis=-1) / picture.frame.pixels_per_radian()
        )
        assert np.percentile(off / pixel, 99) < 0.1
        # a picture's points lie on the surface
        x, y, z = np.moveaxis(picture.position[both], -1, 0)
        np.testing.assert_allclose(terrain.height_at(x, y), z, atol=0.05)


def test_bounds_that_are_looked_up_by_page_give_the_same(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As over terrains of more blocks than bounds are held of."""
    _, pyramid = ground(data_dir, size=1100, holes=True)
    origin, direction = random_rays(pyramid, 2000, seed=15)
    expected = Queries(pyramid).raycast(origin, direction)
    monkeypatch.setattr(blocks, "MANY", 1)
    monkeypatch.setattr(pages, "PAGE", 2)
    np.testing.assert_array_equal(Queries(pyramid).raycast(origin, direction), expected)
