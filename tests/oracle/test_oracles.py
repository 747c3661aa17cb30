"""The oracles against closed forms and against each other: they are independent, so agreement means something."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oracle.cellwalk import depth_picture, first_hits
from oracle.crops import NAMES, crop
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.cameras import standard_cameras
from orogen.compare.embree import EmbreeSurface, compare
from orogen.compare.truth import TrueSurface
from orogen.frame import Frame
from orogen.grid import Grid

GRID = Grid(40, 30, (24.0, 12.0, 4e5, 10.0, -28.0, 5e6), None, (0.97, 1.02))
CAMERA = Camera(4e5 + 250, 5e6 - 200, 900.0, heading=85, pitch=-55, roll=12)


def frame_of(**changes: object) -> Frame:
    return replace(Frame(CAMERA, GRID, (60, 40), height_range=(0.0, 900.0)), **changes)


@pytest.mark.parametrize("orthographic", [None, 900.0])
def test_a_plane_is_hit_where_algebra_says(orthographic: float | None) -> None:
    rows, columns = np.mgrid[:30, :40]
    heights = 200 + 2.5 * columns - 4.0 * rows
    frame = frame_of(camera=CAMERA.moved(orthographic=orthographic), jitter=(0.2, -0.3))
    depth = depth_picture(frame, heights)
    assert 300 < (depth > 0).sum() < depth.size
    origin, direction = frame.rays()
    # the plane z = 200 + slope . (metres from the first sample)
    slope = np.linalg.solve(GRID.metres.T, [2.5, -4.0])
    corner = GRID.metres @ (np.array([0.5, 0.5]) - frame.eye)
    above = origin[..., 2] + frame.camera.z - 200 - (origin[..., :2] - corner) @ slope
    t = -above / (direction[..., 2] - direction[..., :2] @ slope)
    np.testing.assert_allclose(frame.view_depth(depth)[depth > 0], t[depth > 0], rtol=1e-9)


def test_a_hit_lies_on_the_bent_and_exaggerated_surface_and_nothing_before_it() -> None:
    heights = hills(40, 300.0)[:30]
    frame = frame_of(curvature=True, exaggeration=2.0, camera=CAMERA.moved(z=1400.0))
    surface = TrueSurface(heights)
    depth = depth_picture(frame, heights)
    assert (depth > 0).sum() > 300
    x, y, z = np.moveaxis(frame.positions(depth), -1, 0)
    hit = depth > 0
    np.testing.assert_allclose(z[hit], surface.height(*surface.clamp(*GRID.to_texel(x, y)))[hit], atol=1e-6)
    # along every ray, up to the hit, all points are above the surface
    for share in np.linspace(0.02, 0.999, 60):
        x, y, z = np.moveaxis(frame.positions(np.where(hit, depth / share, 0)), -1, 0)
        tx, ty = GRID.to_texel(x, y)
        inside = hit & surface.inside(tx, ty)
        assert (z > surface.height(tx, ty))[inside].all()


def test_voids_are_looked_through() -> None:
    heights = np.full((30, 40), 100.0)
    heights[10:20, 10:20] = np.nan
    frame = frame_of()
    depth = depth_picture(frame, heights)
    full = depth_picture(frame, np.full((30, 40), 100.0))
    x, y, _ = np.moveaxis(frame.positions(full), -1, 0)
    expected = TrueSurface(heights).exists(*GRID.to_texel(x, y)) & (full > 0)
    np.testing.assert_array_equal(depth > 0, expected)
    assert (depth == 0)[full > 0].sum() > 20


def test_rays_along_the_grid_and_straight_down_are_walked() -> None:
    heights = hills(40, 300.0)[:30]
    grid = Grid(40, 30, (10.0, 0.0, 0.0, 0.0, -10.0, 0.0))
    frame = Frame(Camera(205.0, -155.0, 1000.0), grid, (4, 4), height_range=(0.0, 300.0))
    # down through sample (20, 15), down through a cell's middle, along a row of samples, along a row of cells' middles
    origin = np.array([[0, 0, 0], [5, 5, 0], [-300, 0, 0], [-300, 5, 0]], np.float64)
    low = heights.max() + 1 - 1000.0
    direction = np.array([[0, 0, -1], [0, 0, -1], [1, 0, low / 300], [1, 0, low / 300]], np.float64)
    t = first_hits(frame, heights, origin, direction)
    assert t[0] == pytest.approx(1000 - heights[15, 20])
    assert t[1] == pytest.approx(1000 - heights[14:16, 20:22].mean())
    for k in (2, 3):
        x, y, z = origin[k] + t[k] * direction[k]
        at = TrueSurface(heights).height((205 + x) / 10, (155 - y) / 10)
        assert z + 1000 == pytest.approx(float(at))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("view", ["low", "outside"])
def test_two_independent_renderers_agree_on_real_ground(data_dir: Path, name: str, view: str) -> None:
    heights, grid = crop(data_dir, name, 97)
    camera = standard_cameras(grid, TrueSurface(heights))[view]
    frame = Frame(camera, grid, (160, 100), height_range=(float(heights.min()), float(heights.max())))
    depth = depth_picture(frame, heights)
    assert (depth > 0).mean() > 0.15
    agreement = compare(depth.astype(np.float32), frame, EmbreeSurface(frame, heights))
    assert agreement.share >= 0.999
    assert agreement.outline <= 1e-3
    # 8 x 8 splits leave the bilinear surface by up to a 128th of a cell's relief, and not by nothing
    assert 1e-6 < np.nanpercentile(agreement.relative, 99) < 1 / 128


def test_embree_sees_a_difference() -> None:
    heights = hills(65, 300.0)
    grid = Grid(65, 65, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
    camera = standard_cameras(grid, TrueSurface(heights))["high"]
    frame = Frame(camera, grid, (80, 50), height_range=(0.0, 310.0))
    surface = EmbreeSurface(frame, heights)
    assert compare(depth_picture(frame, heights), frame, surface).share == 1
    assert compare(depth_picture(frame, heights + 0.5), frame, surface).share < 0.6
    assert compare(np.zeros((50, 80)), frame, surface).outline > 0.5


def test_embree_parallel_rays() -> None:
    heights = hills(65, 300.0)
    grid = Grid(65, 65, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
    camera = standard_cameras(grid, TrueSurface(heights))["high"].moved(orthographic=900.0)
    frame = Frame(camera, grid, (80, 50), height_range=(0.0, 310.0), exaggeration=1.5)
    assert compare(depth_picture(frame, heights), frame, EmbreeSurface(frame, heights)).share == 1
