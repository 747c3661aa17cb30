"""The draped image in WGSL: where it lies, how it is filtered, what becomes of transparent parts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.frame import Frame
from orogen.grid import Grid
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.settings import ClipmapSettings

SHAPE = (900, 1300)
GRIDS = {
    "north up, far origin": Grid(1300, 900, (25.0, 0, 1e7 + 0.3, 0, -25.0, 9.7e6)),
    "rotated": Grid(1300, 900, (17.0, 10.0, 1e7, 10.0, -17.0, 2e6)),
}
SETTINGS = ClipmapSettings(view_distance=1.1, behind=1.0, blend_range=0.3, memory=1 << 26)


@pytest.fixture(scope="module")
def heights() -> NDArray[np.float32]:
    return np.random.default_rng(1).normal(2000, 100, SHAPE).astype(np.float32)


def places(seed: int) -> tuple[NDArray, NDArray]:
    """Points of the drawn area, some of them beside the borders of nodes of the heights."""
    rng = np.random.default_rng(seed)
    tx, ty = (
        np.concatenate([rng.uniform(0.5, n - 0.5, 600), rng.choice([256, 512], 200) + rng.normal(size=200)])
        for n in SHAPE[::-1]
    )
    return rng.permutation(tx), rng.permutation(ty)


def camera_over(grid: Grid, tx: float, ty: float, z: float) -> Camera:
    x, y = (float(v) for v in grid.to_crs(tx, ty))
    return Camera(x, y, z, heading=70.0, pitch=-30.0)


def linear(srgb: NDArray) -> NDArray[np.float64]:
    s = srgb / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def test_colours_lie_where_the_image_says(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    """Each band a smooth ramp: a shift of the image by a third of a texel would be seen."""
    grid = GRIDS["rotated"]
    # an image of other texels over part of the heights: its own matrix, in the same CRS
    x, y = (float(v) for v in grid.to_crs(150.5, 60.2))
    colors = Grid(700, 620, (25.0, 4.0, x, 9.0, -22.0, y), grid.crs)
    y, x = np.indices((620, 700))
    image = np.stack([x * 255 / 700, y * 255 / 620, 128 + 100 * np.sin(x / 60) * np.cos(y / 60), 255 + 0 * x], axis=-1)
    image = np.rint(image).astype(np.uint8)
    clipmap = clipmap_of(pyramid_of(heights, grid), pyramid_of(image, colors), SETTINGS)
    view, frame = settle(clipmap, Frame(camera_over(grid, 600, 500, 2500.0), grid, (64, 48)))
    tx, ty = places(12)
    footprint = "mat2x2<f32>(vec2<f32>(8.0, 0.0), vec2<f32>(0.0, 8.0))"
    found = probe(view, frame, f"color_at(p, {footprint})", tx, ty)
    u, v = (np.asarray(k) for k in colors.to_texel(*grid.to_crs(tx, ty)))
    rim = np.minimum(np.minimum(u, 700 - u), np.minimum(v, 620 - v))
    assert (found[rim < -1e-3] == 0).all()
    assert found[rim > 1e-3, 3] == pytest.approx(1.0)
    inside = rim > 2.0**clipmap.colors.grid.level_count
    assert inside.sum() > 200
    i, j = np.floor(u - 0.5).astype(int), np.floor(v - 0.5).astype(int)
    exact = sum(
        (np.abs(1 - di - (u - 0.5 - i)) * np.abs(1 - dj - (v - 0.5 - j)))[inside, None]
        * linear(image[(j + dj)[inside], (i + di)[inside], :3].astype(float))
        for di in (0, 1)
        for dj in (0, 1)
    )
    # an eighth of a texel of a filter's weights, and the curve over the widest texel in use
    assert np.abs(found[inside, :3] - exact).max() < 0.012
    assert np.abs(found[inside, :3] - exact).mean() < 0.002


def test_colour_footprints_choose_the_mip(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    """A checkerboard is seen at a small footprint and becomes its mean in linear light at a large one."""
    grid = GRIDS["north up, far origin"]
    y, x = np.indices(SHAPE)
    board = np.where((x + y)[..., None] % 2, np.uint8(255), np.uint8(0)).repeat(4, axis=-1)
    board[..., 3] = 255
    settings = replace(SETTINGS, view_distance=20.0)
    clipmap: Clipmap = clipmap_of(pyramid_of(heights, grid), pyramid_of(board, grid), settings)
    view, frame = settle(clipmap, Frame(camera_over(grid, 600, 500, 2500.0), grid, (64, 48)))
    rng = np.random.default_rng(14)
    # beside the borders of nodes too
    tx, ty = rng.choice([4.5, 255.5, 256.5, 511.5, 512.5, 100.5], (2, 200))
    expected = (np.floor(tx) + np.floor(ty)) % 2
    for diagonal in (8.0, 256.0):
        sharp = probe(view, frame, f"color_at(p, mat2x2<f32>({diagonal}, 0.0, 0.0, {diagonal}))", tx, ty)
        np.testing.assert_allclose(sharp[:, 0], expected, atol=0.01)
        assert (sharp[:, 3] == 1).all()
    soft = probe(
        view, frame, "color_at(p, mat2x2<f32>(q.value, 0.0, 0.0, q.value))", tx, ty, value=512 * (1 + expected)
    )
    np.testing.assert_allclose(soft[:, 0], 0.5, atol=0.01)


def test_long_footprints_are_filtered_along_them_alone(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    """Stripes one texel wide: a footprint along them keeps them, one across them mixes them, whatever its angle."""
    grid = GRIDS["north up, far origin"]
    stripes = np.zeros((*SHAPE, 4), np.uint8)
    stripes[::2, :, :3] = 255
    stripes[..., 3] = 255
    settings = replace(SETTINGS, view_distance=20.0)
    clipmap: Clipmap = clipmap_of(pyramid_of(heights, grid), pyramid_of(stripes, grid), settings)
    view, frame = settle(clipmap, Frame(camera_over(grid, 600, 500, 2500.0), grid, (64, 48)))
    rng = np.random.default_rng(15)
    tx, ty = rng.integers(10, 800, (2, 200)) + 0.5
    light = np.floor(ty) % 2 == 0
    # 1 texel by 6, its steps along the axes or mixed by a turn
    for long_way, expected in (((6.0, 0.0), light), ((0.0, 6.0), 0.5 + 0 * tx)):
        short_way = (1.0, 0.0) if long_way[1] else (0.0, 1.0)
        for turn in (0.0, 0.6, 1.5):
            c, s = np.cos(turn), np.sin(turn)
            steps = np.array([long_way, short_way]).T @ np.array([[c, -s], [s, c]]) * 256
            text = ", ".join(f"{v:.6f}" for v in steps.T.ravel())
            found = probe(view, frame, f"color_at(p, mat2x2<f32>({text}))", tx, ty)[:, 0]
            np.testing.assert_allclose(found, expected, atol=0.02)


def test_transparent_texels_do_not_colour_their_neighbours(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    grid = GRIDS["north up, far origin"]
    image = np.zeros((*SHAPE, 4), np.uint8)
    image[:, 300:] = [200, 100, 50, 255]
    clipmap: Clipmap = clipmap_of(pyramid_of(heights, grid), pyramid_of(image, grid), SETTINGS)
    view, frame = settle(clipmap, Frame(camera_over(grid, 600, 500, 2500.0), grid, (64, 48)))
    tx = np.linspace(290, 310, 200)
    found = probe(view, frame, "color_at(p, mat2x2<f32>(700.0, 0.0, 0.0, 700.0))", tx, np.full(200, 500.3))
    seen = found[:, 3] > 0.01
    assert 10 < (seen & (found[:, 3] < 0.99)).sum() < 180
    np.testing.assert_allclose(
        found[seen, :3], np.broadcast_to(linear(np.array([200, 100, 50])), (seen.sum(), 3)), atol=0.02
    )
