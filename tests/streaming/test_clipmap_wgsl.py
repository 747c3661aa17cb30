"""The WGSL functions of the clipmap against float64 numpy: every point, level, border and edge."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import Grid
from orogen.keys import level_shape
from orogen.pyramid.contract import Pyramid
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.settings import ClipmapSettings

SHAPE = (900, 1300)
GRIDS = {
    "north up, far origin": Grid(1300, 900, (25.0, 0, 1e7 + 0.3, 0, -25.0, 9.7e6)),
    "rotated": Grid(1300, 900, (17.0, 10.0, 1e7, 10.0, -17.0, 2e6)),
    "degrees": Grid(1300, 900, (1 / 1200, 0, 120.0, 0, -1 / 1200, 61.0), "EPSG:4326", (54_000.0, 111_400.0)),
    "sheared": Grid(1300, 900, (20.0, 6.0, -1e7, 3.0, 30.0, 0), None, (1.0, 1.3)),
}
SETTINGS = ClipmapSettings(view_distance=1.1, behind=1.0, blend_range=0.3, memory=1 << 25)


def terrain(seed: int = 1) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    y, x = np.indices(SHAPE)
    waves = 300 * np.sin(x / 40) * np.cos(y / 55) + 2 * (x - y) + 2000
    return (waves + rng.normal(0, 5, SHAPE)).astype(np.float32)


@dataclass
class Twin:
    """Float64 numpy of what the shader computes, with every node resident, from the samples of all levels."""

    frame: Frame
    levels: list[NDArray[np.float64]]
    settings: ClipmapSettings
    clamp: tuple[float, float] = (-math.inf, math.inf)

    def texels(self, y: NDArray, x: NDArray, level: int) -> NDArray[np.float64]:
        """Texels of a level, past its edges two steps along the slope."""
        values = self.levels[level]

        def parts(i: NDArray, n: int) -> tuple[NDArray, NDArray, NDArray]:
            edge = np.clip(i, 0, n - 1)
            past = np.minimum(np.abs(i - edge), 2) * (n > 1)
            return edge, np.clip(edge + np.where(i < 0, 1, -1), 0, n - 1), past

        (ye, yi, yp), (xe, xi, xp) = parts(y, values.shape[0]), parts(x, values.shape[1])
        return sum(wy * wx * values[j, i] for j, wy in ((ye, 1 + yp), (yi, -yp)) for i, wx in ((xe, 1 + xp), (xi, -xp)))

    def at_level(self, tx: NDArray, ty: NDArray, level: NDArray) -> NDArray[np.float64]:
        result = np.empty(len(tx))
        for k in np.unique(level):
            on = level == k
            u, v = tx[on] / 2.0**k - 0.5, ty[on] / 2.0**k - 0.5
            i, j = np.floor(u).astype(int), np.floor(v).astype(int)
            result[on] = sum(
                np.abs(1 - di - (u - i)) * np.abs(1 - dj - (v - j)) * self.texels(j + dj, i + di, int(k))
                for di in (0, 1)
                for dj in (0, 1)
            )
        return np.clip(result, *self.clamp)

    def lod(self, tx: NDArray, ty: NDArray, grid: Grid | None = None) -> NDArray[np.float64]:
        frame = self.frame
        x, y = frame.grid.to_crs(tx, ty)
        scale = frame.grid.ground_scale
        lod = frame.lod
        flat = np.hypot((x - lod.x) * scale[0], (y - lod.y) * scale[1])
        distance = np.hypot(flat, lod.z - frame.ground_height * frame.exaggeration)
        reach = (
            self.settings.view_distance_for(frame.size, frame.lod_fov)
            * self.settings.node_size
            * (grid or frame.grid).spacing
        )
        with np.errstate(divide="ignore"):
            return np.clip(np.log2(2 * distance / reach), 0, len(self.levels) - 1)

    def blended(self, tx: NDArray, ty: NDArray, lod: NDArray, of: Callable[..., NDArray]) -> NDArray[np.float64]:
        """Two levels mixed over the last part of a level's range."""
        level = np.floor(lod).astype(int)
        ratio = np.clip((1 - (lod - level)) / self.settings.blend_range, 0, 1)
        coarse = np.minimum(level + 1, len(self.levels) - 1)
        ratio = ratio.reshape(-1, *[1] * (np.ndim(of(tx[:1], ty[:1], level[:1])) - 1))
        return ratio * of(tx, ty, level) + (1 - ratio) * of(tx, ty, coarse)

    def height(self, tx: NDArray, ty: NDArray) -> NDArray[np.float64]:
        return self.blended(tx, ty, self.lod(tx, ty), self.at_level)


def read_levels(pyramid: Pyramid) -> list[NDArray[np.float64]]:
    shapes = [level_shape(pyramid.grid.shape, level) for level in range(pyramid.level_count)]
    return [pyramid.read(k, slice(0, h), slice(0, w)).astype(np.float64) for k, (h, w) in enumerate(shapes)]


def places(shape: tuple[int, int], seed: int) -> tuple[NDArray, NDArray]:
    """Points of the drawn area: anywhere, on and beside the borders of nodes, on centres of samples, on the edges."""
    rng = np.random.default_rng(seed)
    height, width = shape

    def axis(n: int) -> NDArray[np.float64]:
        borders = np.arange(256, n, 256)
        if not len(borders):
            borders = np.array([n / 2])
        return np.concatenate(
            [
                rng.uniform(0.5, n - 0.5, 500),
                rng.choice(borders, 100) + rng.choice([-1, -0.5, -1 / 256, 0, 1 / 512, 0.5, 1], 100),
                rng.integers(0, n, 100) + 0.5,
                rng.choice([0.5, 0.5 + 1e-4, 0.9, n - 0.5 - 1e-4, n - 0.5], 100),
            ]
        )

    tx, ty = rng.permutation(axis(width)), rng.permutation(axis(height))
    return np.clip(tx, 0.5, width - 0.5), np.clip(ty, 0.5, height - 0.5)


def camera_over(grid: Grid, tx: float, ty: float, z: float, **settings: Any) -> Camera:
    x, y = (float(v) for v in grid.to_crs(tx, ty))
    return Camera(x, y, z, **{"heading": 70.0, "pitch": -30.0, **settings})


@dataclass
class Stage:
    pyramid: Pyramid
    view: ClipmapView
    frame: Frame
    twin: Twin


@pytest.fixture(scope="module")
def heights() -> NDArray[np.float32]:
    return terrain()


@pytest.fixture(scope="module", params=GRIDS)
def stage(request: pytest.FixtureRequest, gpu: Gpu, heights: NDArray, pyramid_of: Any, settle: Any) -> Iterator[Stage]:
    grid = GRIDS[request.param]
    pyramid = pyramid_of(heights, grid)
    clipmap = Clipmap(gpu, pyramid, None, SETTINGS)
    view, frame = settle(clipmap, Frame(camera_over(grid, 500.3, 600.7, 2500.0), grid, (64, 48)))
    yield Stage(pyramid, view, frame, Twin(frame, read_levels(pyramid), SETTINGS, pyramid.height_range))
    clipmap.close()


def test_level_of_detail(stage: Stage, probe: Any) -> None:
    tx, ty = places(SHAPE, 1)
    found = probe(stage.view, stage.frame, "vec4<f32>(lod_at(p))", tx, ty)[:, 0]
    expected = stage.twin.lod(tx, ty)
    assert len(np.unique(np.floor(expected))) >= 3
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)


def test_heights_of_every_level(stage: Stage, probe: Any) -> None:
    tx, ty = places(SHAPE, 2)
    top = stage.pyramid.level_count - 1
    level = np.random.default_rng(3).integers(0, top + 1, len(tx))
    asked = probe(
        stage.view, stage.frame, "vec4<f32>(height_at_level(p, q.level), f32(resident_level(p, q.level)), 0.0, 0.0)",
        tx, ty, level=level,
    )  # fmt: skip
    resident = asked[:, 1].astype(int)
    # what is not resident falls back to a coarser level, and some is
    assert (resident >= level).all()
    assert 0.3 < (resident == level).mean() < 1
    np.testing.assert_allclose(asked[:, 0], stage.twin.at_level(tx, ty, resident), rtol=1e-6, atol=2e-3)


def test_heights_blend_into_the_next_level(stage: Stage, probe: Any) -> None:
    tx, ty = places(SHAPE, 4)
    found = probe(stage.view, stage.frame, "vec4<f32>(height_at(p))", tx, ty)[:, 0]
    expected = stage.twin.height(tx, ty)
    # the share of a level in the mix is known to about 1e-4
    apart = np.abs(stage.twin.at_level(tx, ty, np.zeros(len(tx), int)) - expected).max()
    assert np.abs(found - expected).max() < 2e-3 + 2e-4 * apart
    lod = stage.twin.lod(tx, ty)
    blended = (lod - np.floor(lod) > 1 - SETTINGS.blend_range) & (lod < stage.pyramid.level_count - 1)
    assert blended.sum() > 50


def test_points_within_a_texel_are_as_exact_as_float32_heights(stage: Stage, probe: Any) -> None:
    """A ramp of points 1/4096 texel apart near the camera climbs evenly: no steps from rounded positions."""
    start = stage.frame.eye + np.array([3.2, -4.3])
    tx, ty = start[0] + np.arange(2000) / 4096, np.full(2000, start[1])
    found = probe(stage.view, stage.frame, "vec4<f32>(height_at_level(p, 0u))", tx, ty)[:, 0]
    expected = stage.twin.at_level(tx, ty, np.zeros(2000, int))
    assert np.abs(found - expected).max() < 1e-3


def test_gradients(stage: Stage, probe: Any) -> None:
    tx, ty = places(SHAPE, 5)
    top = stage.pyramid.level_count - 1
    lod = np.random.default_rng(6).uniform(-0.5, top + 0.5, len(tx)).astype(np.float32)
    # of what is resident everywhere: the two coarsest levels
    lod = np.maximum(lod, top - 1)
    found = probe(stage.view, stage.frame, "vec4<f32>(gradient_at(p, q.value), 0.0, 0.0)", tx, ty, value=lod)[:, :2]
    twin = replace(stage.twin, clamp=(-math.inf, math.inf))

    def slope(tx: NDArray, ty: NDArray, level: NDArray) -> NDArray[np.float64]:
        step = 2.0**level
        per_texel = np.stack(
            [
                (twin.at_level(tx + step, ty, level) - twin.at_level(tx - step, ty, level)) / (2 * step),
                (twin.at_level(tx, ty + step, level) - twin.at_level(tx, ty - step, level)) / (2 * step),
            ],
            axis=-1,
        )
        # dh = slope . d(texel) and d(metres) = M d(texel)
        return np.linalg.solve(stage.frame.grid.metres.T, per_texel.T).T * stage.frame.exaggeration

    expected = twin.blended(tx, ty, np.clip(lod.astype(float), 0, top), slope)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 + 1e-4 * np.abs(expected).max())


def test_bounds_hold_what_is_drawn(stage: Stage, probe: Any) -> None:
    """Over a rectangle no wider than a node of the level: every height drawn within it, and not much more than that."""
    rng = np.random.default_rng(7)
    count = 200
    level = rng.integers(0, stage.pyramid.level_count, count)
    size = rng.uniform(0, 1, (count, 2)) * (256 << level)[:, None]
    low = np.clip(rng.uniform(-0.05, 1.0, (count, 2)) * SHAPE[::-1], 0, None)
    high = low + size
    one = 1 << stage.frame.subtexel_bits
    found = probe(
        stage.view, stage.frame, "vec4<f32>(bounds_over(q.cell, q.high, q.level), 0.0, 0.0)",
        *low.T, high=np.ceil(high * one).astype(int), level=level,
    )[:, :2]  # fmt: skip
    inside = low[:, None] + rng.uniform(0, 1, (count, 100, 2)) * size[:, None]
    inside = np.clip(inside, 0.5, np.array(SHAPE[::-1]) - 0.5).reshape(-1, 2)
    drawn = probe(stage.view, stage.frame, "vec4<f32>(height_at(p))", *inside.T)[:, 0].reshape(count, 100)
    assert (found[:, 0] <= drawn.min(axis=1) + 1e-3).all()
    assert (found[:, 1] >= drawn.max(axis=1) - 1e-3).all()
    fine = level == 0
    assert (found[fine, 1] - found[fine, 0]).mean() < 0.8 * np.ptp(stage.pyramid.height_range)


def test_stored_errors_bound_the_distance_to_the_samples(stage: Stage, probe: Any) -> None:
    tx, ty = places(SHAPE, 8)
    found = probe(stage.view, stage.frame, "vec4<f32>(error_at(p), height_at(p), 0.0, 0.0)", tx, ty)
    exact = stage.twin.at_level(tx, ty, np.zeros(len(tx), int))
    # the outermost centres of a coarser level lie inside the drawn area
    margin = 2.0 ** (stage.pyramid.level_count - 2)
    inside = (tx > margin) & (ty > margin) & (tx < SHAPE[1] - margin) & (ty < SHAPE[0] - margin)
    assert (np.abs(found[:, 1] - exact) <= found[:, 0] + 2e-3)[inside].all()
    assert found[:, 0].max() > 1
    assert (found[:, 0] == 0).any()


def test_exaggeration_and_a_lod_camera_elsewhere(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    grid = GRIDS["rotated"]
    pyramid = pyramid_of(heights, grid)
    frame = Frame(
        camera_over(grid, -3000, 400, 9000.0), grid, (64, 48), camera_over(grid, 900.5, 300.25, 5000.0),
        exaggeration=2.0,
    )  # fmt: skip
    view, frame = settle(clipmap_of(pyramid, None, SETTINGS), frame)
    twin = Twin(frame, read_levels(pyramid), SETTINGS, pyramid.height_range)
    tx, ty = places(SHAPE, 9)
    found = probe(view, frame, "vec4<f32>(lod_at(p), height_at(p), 0.0, 0.0)", tx, ty)
    np.testing.assert_allclose(found[:, 0], twin.lod(tx, ty), atol=1e-4)
    assert np.abs(found[:, 1] - twin.height(tx, ty)).max() < 0.05


# -- nodata ------------------------------------------------------------------------------------------------------------


def test_coverage_is_interpolated_and_blended_like_heights(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    rng = np.random.default_rng(10)
    holed = heights.copy()
    for _ in range(200):
        y, x, r = rng.integers(0, SHAPE[0]), rng.integers(0, SHAPE[1]), rng.integers(1, 30)
        holed[max(0, y - r) : y + r, max(0, x - r) : x + r] = np.nan
    grid = GRIDS["north up, far origin"]
    pyramid = pyramid_of(holed, grid)
    view, frame = settle(
        clipmap_of(pyramid, None, SETTINGS), Frame(camera_over(grid, 500, 600, 2500.0), grid, (64, 48))
    )
    levels = []
    for level in range(pyramid.level_count):
        h, w = level_shape(SHAPE, level)
        levels.append(pyramid.read_coverage(level, slice(0, h), slice(0, w)) / 255.0)
    twin = Twin(frame, levels, SETTINGS)
    twin.texels = lambda y, x, k: levels[k][  # type: ignore[method-assign]
        np.clip(y, 0, levels[k].shape[0] - 1), np.clip(x, 0, levels[k].shape[1] - 1)
    ]
    tx, ty = places(SHAPE, 11)
    found = probe(view, frame, "vec4<f32>(coverage_at(p), height_at(p), 0.0, 0.0)", tx, ty)
    expected = twin.height(tx, ty)
    np.testing.assert_allclose(found[:, 0], expected, atol=3e-4)
    assert min((expected == 0).mean(), (expected == 1).mean()) > 0.05
    # what is drawn stays within the data, whatever the holes are filled with
    low, high = pyramid.height_range
    assert ((found[:, 1] >= low) & (found[:, 1] <= high)).all()


def test_without_an_image_there_is_no_colour(stage: Stage, probe: Any) -> None:
    found = probe(stage.view, stage.frame, "color_at(p, mat2x2<f32>(1.0, 0.0, 0.0, 1.0))", *places(SHAPE, 13))
    assert not found.any()


# -- large and far -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tx", [300.3, 100_000.7, (1 << 18) - 500.2])
def test_a_terrain_of_2_to_the_18_samples(pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any, tx: float) -> None:
    """A strip a quarter of a million samples wide: positions stay exact at both ends, far from the CRS origin."""
    width = 1 << 18
    x = np.arange(width)
    strip = np.stack([500 + 200 * np.sin(x / 37 + row) for row in range(3)]).astype(np.float32)
    grid = Grid(width, 3, (1.0, 0, 1e7, 0, -1.0, 9e6))
    pyramid = pyramid_of(strip, grid)
    settings = ClipmapSettings(view_distance=2.0, behind=1.0, memory=1 << 26)
    frame = Frame(camera_over(grid, tx, 1.5, 720.0, pitch=-90.0), grid, (64, 48))
    view, frame = settle(clipmap_of(pyramid, None, settings), frame)
    twin = Twin(frame, read_levels(pyramid), settings, pyramid.height_range)
    rng = np.random.default_rng(15)
    at = np.clip(tx + rng.normal(size=600) * 10 ** rng.uniform(-2, 3.5, 600), 0.5, width - 0.5)
    ty = rng.uniform(0.5, 2.5, 600)
    found = probe(view, frame, "vec4<f32>(height_at(p), lod_at(p), 0.0, 0.0)", at, ty)
    np.testing.assert_allclose(found[:, 1], twin.lod(at, ty), atol=1e-4)
    near = twin.lod(at, ty) < 1 - settings.blend_range
    assert near.sum() > 100
    assert np.abs(found[:, 0] - twin.height(at, ty))[near].max() < 1e-3
    assert np.abs(found[:, 0] - twin.height(at, ty)).max() < 0.05


def test_a_camera_far_outside_the_data(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    grid = GRIDS["north up, far origin"]
    pyramid = pyramid_of(heights, grid)
    clipmap = clipmap_of(pyramid, None, SETTINGS)
    tx, ty = places(SHAPE, 16)
    for eye in ((-2e5, 3e5), (3e6, 400.0)):
        view, frame = settle(clipmap, Frame(camera_over(grid, *eye, 1e5), grid, (64, 48)))
        twin = Twin(frame, read_levels(pyramid), SETTINGS, pyramid.height_range)
        found = probe(view, frame, "vec4<f32>(height_at(p))", tx, ty)[:, 0]
        top = np.full(len(tx), pyramid.level_count - 1)
        np.testing.assert_allclose(found, twin.at_level(tx, ty, top), rtol=1e-6, atol=2e-3)


@pytest.mark.parametrize("shape", [(1, 1), (1, 700), (700, 1), (2, 2), (257, 256)])
def test_rasters_of_a_few_samples(
    pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any, north_up: Any, shape: tuple[int, int]
) -> None:
    values = np.random.default_rng(17).normal(100, 10, shape).astype(np.float32)
    grid = north_up(shape, 10.0)
    pyramid = pyramid_of(values, grid)
    view, frame = settle(clipmap_of(pyramid, None, SETTINGS), Frame(camera_over(grid, 0.4, 0.4, 150.0), grid, (64, 48)))
    twin = Twin(frame, read_levels(pyramid), SETTINGS, pyramid.height_range)
    rng = np.random.default_rng(18)
    tx, ty = (rng.uniform(0.5, n - 0.5, 100) for n in shape[::-1])
    found = probe(view, frame, "vec4<f32>(height_at(p), coverage_at(p), 0.0, 0.0)", tx, ty)
    np.testing.assert_allclose(found[:, 0], twin.height(tx, ty), atol=1e-3)
    assert (found[:, 1] == 1).all()


@pytest.mark.parametrize("node_size", [512, 1024])
def test_larger_nodes(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any, node_size: int
) -> None:
    grid = GRIDS["north up, far origin"]
    pyramid = pyramid_of(heights, grid)
    settings = replace(SETTINGS, node_size=node_size, view_distance=0.3, memory=1 << 26)
    view, frame = settle(
        clipmap_of(pyramid, None, settings), Frame(camera_over(grid, 500.3, 600.7, 2500.0), grid, (64, 48))
    )
    twin = Twin(frame, read_levels(pyramid), settings, pyramid.height_range)
    tx, ty = places(SHAPE, 19)
    found = probe(view, frame, "vec4<f32>(height_at(p), lod_at(p), 0.0, 0.0)", tx, ty)
    assert np.ptp(np.floor(found[:, 1])) >= 2
    assert np.abs(found[:, 0] - twin.height(tx, ty)).max() < 0.05
