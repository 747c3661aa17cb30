"""geomipmap: measured errors against meshes put together triangle by triangle; the bound on what is drawn; no gaps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod import restricted
from lod.patches import torn_edges
from lod.scene import SPACING, Scene, noise
from lod.triangles import as_unculled, read_triangles, with_area
from oracle.landscapes import hills
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import geomipmap, make_settings
from orogen.lod.geomipmap.errors import drawn_samples, extended, measured
from orogen.lod.geomipmap.levels import Levels
from orogen.lod.geomipmap.patterns import LIST_BIT, LISTS, NO_COLUMNS_BIT, index_lists
from orogen.lod.quadtree import PatchTree

SETTINGS: list[dict[str, Any]] = [
    {"block_size": 8, "quads_per_sample": 2},
    {"block_size": 16, "quads_per_sample": 1, "max_error": 3.0},
    {"block_size": 8, "quads_per_sample": 1, "max_error": 2.0, "morph": False},
]


def uneven(rows: int, columns: int) -> NDArray[np.float32]:
    """Roughness that changes by three orders of magnitude across the terrain, so that levels meet everywhere."""
    y, x = np.mgrid[:rows, :columns]
    share = 0.001 ** np.abs(np.sin(x / 23.0) * np.cos(y / 31.0))
    return noise(rows, columns, relief=40.0, seed=2) * share.astype(np.float32) + (x * 0.7 + y * 0.3).astype(np.float32)


def truth(heights: NDArray[np.floating], column: NDArray, row: NDArray) -> NDArray[np.float64]:
    """Bilinear heights at samples' columns and rows."""
    h = heights.astype(np.float64)
    i = np.clip(np.floor(row).astype(int), 0, h.shape[0] - 2)
    j = np.clip(np.floor(column).astype(int), 0, h.shape[1] - 2)
    v, u = row - i, column - j
    return (1 - v) * ((1 - u) * h[i, j] + u * h[i, j + 1]) + v * ((1 - u) * h[i + 1, j] + u * h[i + 1, j + 1])


def inner_points(count: int, seed: int = 5) -> NDArray[np.float64]:
    """(n, 3) weights of a triangle's corners: those of samples in it, and `count` points on its sides and inside."""
    random = np.random.default_rng(seed)
    weights = random.exponential(1, (count, 3)) * (random.uniform(0, 1, (count, 3)) < 0.7)
    weights[weights.sum(axis=1) == 0] = 1
    lattice = [[i, j, 8 - i - j] for i in range(9) for j in range(9 - i)]
    weights = np.concatenate([weights, lattice])
    return weights / weights.sum(axis=1, keepdims=True)


some_cameras = partial(restricted.some_cameras, lowest=100, spread=(1.0, 3.4), up=10)


@pytest.fixture(scope="module", params=[(75, 60), (49, 65), (2, 3), (60, 2)], ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, uneven(*request.param), view_distance=0.2)) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def exact(gpu: Gpu) -> Iterator[tuple[Scene, NDArray[np.float32]]]:
    """All at level 0, so that errors are those of the meshes alone."""
    heights = uneven(80, 100)
    with closing(Scene(gpu, heights)) as terrain:
        yield terrain, heights


# -- preprocessing -----------------------------------------------------------------------------------


@pytest.mark.parametrize("quads", [4, 16])
def test_lists_of_a_level_cover_a_block_once(quads: int) -> None:
    lists = index_lists(quads)
    last = quads.bit_length() - 1
    assert len(lists) == LISTS * last + 1
    for level in range(last + 1):
        for thinned in range(16 if level < last else 1):
            chosen = [LISTS * level]
            if level < last:
                chosen += [LISTS * level + 1 + 2 * edge + (thinned >> edge & 1) for edge in range(4)]
            triangles = np.concatenate([lists[number] for number in chosen])
            assert set((triangles >> LIST_BIT).ravel().tolist()) <= set(chosen)
            vertex = triangles & (1 << NO_COLUMNS_BIT) - 1
            row, column = np.divmod(vertex, quads + 1)
            # all of a level's vertices and no others, but for every second one on thinned edges
            expected = {
                (i, j)
                for i in range(0, quads + 1, 1 << level)
                for j in range(0, quads + 1, 1 << level)
                if not any(
                    thinned >> edge & 1 and at == rim and along >> level & 1
                    for edge, (at, rim, along) in enumerate([(j, 0, i), (j, quads, i), (i, 0, j), (i, quads, j)])
                )
            }
            assert set(zip(row.ravel().tolist(), column.ravel().tolist(), strict=True)) == expected
            a, b, c = np.stack([column, row], axis=-1).astype(np.int64).swapaxes(0, 1)
            (px, py), (qx, qy) = (b - a).T, (c - a).T
            double = px * qy - py * qx
            assert (np.sign(double) == np.sign(double[0])).all()
            assert np.abs(double).sum() == 2 * quads**2


def mesh_error(heights: NDArray[np.float32], side: int, triangles: NDArray, x: int, y: int) -> float:
    """Greatest difference of a block's triangles from the bilinear surface, at points of triangles inside the data."""
    vertex = triangles & (1 << NO_COLUMNS_BIT) - 1
    row, column = np.divmod(vertex, side + 1)
    row, column = row.astype(int) + y * side, column.astype(int) + x * side
    h = extended(heights, np.arange((y + 1) * side + 1), np.arange((x + 1) * side + 1)).astype(np.float64)[row, column]
    weights = inner_points(60)
    at = [(part[:, None, :] * weights).sum(axis=-1) for part in (row, column, h)]
    inside = (at[0] <= heights.shape[0] - 1) & (at[1] <= heights.shape[1] - 1)
    off = np.abs(at[2] - truth(heights, at[1], at[0]))
    return float(off[inside].max(initial=0.0))


@pytest.mark.parametrize("shape", [(33, 49), (30, 21)])
def test_measured_errors_bound_the_meshes_closely(shape: tuple[int, int]) -> None:
    side = 8
    heights = noise(*shape, seed=9)
    errors = measured(heights, side, 0)
    lists = index_lists(side)
    rows, columns = errors.low.shape
    assert (rows, columns) == (-(-(shape[0] - 1) // side), -(-(shape[1] - 1) // side))
    twist = np.abs(heights[:-1, :-1] + heights[1:, 1:] - heights[:-1, 1:] - heights[1:, :-1]).max() / 4
    for y, x in np.ndindex(rows, columns):
        for level in range(4):
            both = level < 3
            chosen = [lists[LISTS * level]]
            own = chosen + [lists[LISTS * level + 1 + 2 * edge] for edge in range(4)] if both else chosen
            true = mesh_error(heights, side, np.concatenate(own), x, y)
            bound = errors.own[level, :, y, x].max()
            assert true <= bound + 1e-3
            assert bound <= 1.01 * true + twist + 1e-3
            if not both:
                continue
            edges = [lists[LISTS * level + 2 + 2 * edge] for edge in range(4)]
            thinnest = mesh_error(heights, side, np.concatenate(chosen + edges), x, y)
            assert thinnest <= errors.seam[level, :, y, x].max() + 1e-3
            assert errors.seam[level, :, y, x].max() <= 1.01 * thinnest + twist + 1e-3
            for edge, triangles in enumerate(edges):
                assert mesh_error(heights, side, triangles, x, y) <= errors.seam[level, edge, y, x] + 1e-3


def test_parts_of_samples_have_a_quarter_of_the_twist() -> None:
    heights = np.zeros((9, 9), np.float32)
    heights[3, 3] = 16.0
    errors = measured(heights, 8, 2)
    # the cells around the sample are twisted by 16
    assert errors.own.max(axis=1)[:3, 0, 0].tolist() == [4.0 / 16, 4.0 / 4, 4.0]
    np.testing.assert_array_equal(errors.seam[:2], errors.own[:2])


def test_bands_are_measured_like_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    heights = noise(75, 40, seed=3)
    whole = measured(heights, 8, 1)
    monkeypatch.setattr("orogen.lod.geomipmap.errors._BAND", 16)
    for a, b in zip(vars(whole).values(), vars(measured(heights, 8, 1)).values(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_planes_have_no_error_up_to_their_rim() -> None:
    row, column = np.mgrid[:37, :50]
    errors = measured((0.25 * row - 1.5 * column).astype(np.float32), 8, 1)
    assert errors.own.max() == 0
    assert errors.seam.max() == 0


def test_voids_are_measured_as_they_are_drawn(gpu: Gpu) -> None:
    heights = noise(70, 80)
    heights[20:40, 30:50] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        samples = drawn_samples(scene.clipmap)
        valid = np.isfinite(heights)
        np.testing.assert_array_equal(samples[valid], heights[valid])
        low, high = np.nanmin(heights), np.nanmax(heights)
        assert ((samples >= low) & (samples <= high)).all()
        around = [heights[19, 29], heights[19, 30], heights[19, 31], heights[20, 29], heights[21, 29]]
        assert samples[20, 30] == pytest.approx(np.mean(around), rel=1e-5)


# -- levels ------------------------------------------------------------------------------------------


def some_levels(morph: bool) -> tuple[Levels, Any, NDArray[np.float64], NDArray[np.float64]]:
    heights = uneven(130, 180)
    with_grid = type("G", (), {"width": 180, "height": 130, "metres": np.diag([SPACING, -SPACING])})()
    errors = measured(heights, 8, 1)
    levels = Levels(PatchTree(with_grid, 8), errors)
    y, x = np.indices(errors.low.shape)
    allowed = 0.02 + 0.15 * np.hypot(x - 5.0, y - 7.0)
    return levels, errors, allowed, levels.at(allowed, morph=morph)


@pytest.mark.parametrize("morph", [True, False])
def test_levels_keep_to_what_is_allowed(morph: bool) -> None:
    levels, errors, allowed, level = some_levels(morph)
    whole = np.floor(level).astype(int)
    assert len(np.unique(whole)) >= 4
    if not morph:
        np.testing.assert_array_equal(level, whole)
    assert (np.abs(np.diff(level, axis=0)) <= 1 + 1e-9).all()
    assert (np.abs(np.diff(level, axis=1)) <= 1 + 1e-9).all()
    edges = levels.edges(level)
    never = np.full((2, *errors.own.shape[1:]), np.inf)
    own, seam = (np.concatenate([part, never]).astype(np.float64) for part in (errors.own, errors.seam))
    met = 0
    for y, x, edge in np.ndindex(*level.shape, 4):
        n, a, e = whole[y, x], level[y, x] - whole[y, x], edges[edge, y, x] - whole[y, x]
        if n == 0 and own[0, :, y, x].max() > allowed[y, x]:
            continue
        assert a <= e <= a + 1 + 1e-9
        met += e > a
        # shares of the meshes that the drawn one is a mixture of: see Levels._limit
        if e <= 1:
            shares = (1 - e, own[n]), (e - a, seam[n]), (a, own[n + 1])
        else:
            shares = (1 - a, seam[n]), (a - (e - 1), own[n + 1]), (e - 1, seam[n + 1])
        error = sum(share * part[edge, y, x] for share, part in shares if share > 1e-9)
        assert error <= allowed[y, x] * (1 + 1e-6)
    assert met > 100


def test_levels_are_no_finer_than_asked_for() -> None:
    """Where nothing is forced by neighbours, the error is just what is allowed."""
    levels, errors, allowed, level = some_levels(True)
    free = levels._free(np.maximum(allowed.ravel(), levels._own[0])).reshape(level.shape)
    assert (level <= free).all()
    assert (level == free).mean() > 0.3
    whole = np.floor(free).astype(int)
    top = len(errors.own) - 1
    assert (whole == 0).any()
    between = (free > 0) & (free < top) & (free > whole)
    y, x = np.nonzero(between)
    own = levels._own.reshape(-1, *level.shape)
    a = (free - whole)[y, x]
    mixed = (1 - a) * own[whole[y, x], y, x] + a * own[whole[y, x] + 1, y, x]
    np.testing.assert_allclose(mixed, allowed[y, x], rtol=1e-6)
    np.testing.assert_array_equal(levels.at(np.full_like(allowed, 1e9), morph=True), float(top))


def test_distances_are_to_the_nearest_point_of_boxes(gpu: Gpu, exact: tuple[Scene, NDArray[np.float32]]) -> None:
    scene, heights = exact
    frame = scene.frame(scene.camera(40, 30, 300), exaggeration=2.0)
    errors = measured(heights, 8, 0)
    distance = Levels(PatchTree(scene.pyramid.grid, 8), errors).distance(frame)
    eye = np.array([39.5 * SPACING, 29.5 * SPACING, 300.0])
    random = np.random.default_rng(2)
    for _ in range(60):
        y, x = random.integers(0, distance.shape[0]), random.integers(0, distance.shape[1])
        part = heights[8 * y : 8 * y + 9, 8 * x : 8 * x + 9]
        high = np.array([part.shape[1] - 1 + 8 * x, part.shape[0] - 1 + 8 * y])
        box = np.array([[8 * x * SPACING, 8 * y * SPACING, 2 * part.min()], [*(high * SPACING), 2 * part.max()]])
        assert distance[y, x] == pytest.approx(np.linalg.norm(np.clip(eye, *box) - eye), rel=1e-6)


# -- what is drawn -----------------------------------------------------------------------------------


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_drawn_triangles_keep_to_the_error(exact: tuple[Scene, NDArray[np.float32]], settings: dict[str, Any]) -> None:
    scene, heights = exact
    state = scene.algorithm("geomipmap", settings)
    chosen = make_settings("geomipmap", settings)
    weights = inner_points(8)
    worst = []
    for camera in some_cameras(scene, 2, seed=4):
        frame = as_unculled(scene.frame(camera, (160, 100)))
        errors = measured(heights, chosen.block_size, chosen.quads_per_sample.bit_length() - 1)
        distance = Levels(PatchTree(scene.pyramid.grid, chosen.block_size), errors).distance(frame)
        pixels = 100 / (2 * np.tan(np.radians(45.0) / 2))
        for draw in read_triangles(scene, frame, state):
            corners = draw["position"].astype(np.float64)
            at = np.einsum("itck,pc->itpk", corners, weights)
            texel = at[..., :2] @ np.linalg.inv(frame.grid.metres).T + frame.eye - 0.5
            last = np.array([heights.shape[1], heights.shape[0]]) - 1.0
            inside = (texel <= last + 1e-6).all(axis=-1)
            off = np.abs(at[..., 2] + camera.z - truth(heights, texel[..., 0], texel[..., 1])) * inside
            rest = draw["id"][:, 0, 0].astype(int) & (1 << 26) - 1
            x, y = rest & 0x1FFF, rest >> 13
            allowed = distance[y, x] * chosen.max_error / pixels
            # the finest level is the best there is
            allowed = np.maximum(
                allowed, np.where(draw["tile_level"][:, 0, 0] == 0, errors.own[0].max(axis=0)[y, x], 0)
            )
            worst.append((off.max(axis=(1, 2)) - 1e-2) / allowed)
    ratio = np.concatenate(worst)
    assert ratio.max() <= 1.001
    # some blocks come close: the bound is used
    assert ratio.max() > 0.6


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_edges_match_bit_for_bit(scene: Scene, settings: dict[str, Any]) -> None:
    state = scene.algorithm("geomipmap", settings)
    side = make_settings("geomipmap", settings).block_size
    grid = scene.pyramid.grid
    rows, columns = (max(1, -(-(count - 1) // side)) for count in grid.shape)
    levels: set[int] = set()
    for camera in some_cameras(scene, 2, seed=3):
        draws = read_triangles(scene, as_unculled(scene.frame(camera, (160, 100))), state)
        triangles = with_area(draws)
        levels |= {int(level) for draw in draws for level in draw["tile_level"][:, 0, 0]}
        positions = triangles.reshape(-1, 3)
        (west, south), (east, north) = positions[:, :2].min(axis=0), positions[:, :2].max(axis=0)
        assert (east - west, north - south) == pytest.approx((columns * side * SPACING, rows * side * SPACING))
        assert len(torn_edges(triangles, (west, south, east, north))) == 0
        a, b, c = triangles[..., :2].astype(np.float64).swapaxes(0, 1)
        (px, py), (qx, qy) = (b - a).T, (c - a).T
        assert np.abs(px * qy - py * qx).sum() / 2 == pytest.approx(rows * columns * (side * SPACING) ** 2, rel=1e-5)
    assert len(levels) > 2 or min(grid.shape) < 10


def flow(gpu: Gpu, morph: bool) -> float:
    """Greatest change of a point's height in a small step of the LOD camera."""
    with closing(Scene(gpu, hills(150, 300.0).astype(np.float32))) as scene:
        above = scene.camera(75, 75, 900, pitch=-90, orthographic=900.0)
        eye = scene.camera(60, 80, 500)
        scene.frame(eye, (64, 64))
        state = scene.algorithm("geomipmap", {"block_size": 8, "quads_per_sample": 1, "max_error": 4.0, "morph": morph})
        heights, triangles = [], []
        for k in range(30):
            lod = eye.moved(x=eye.x + 4.0 * k, z=eye.z + 6.0 * k)
            frame = as_unculled(Frame(above, scene.pyramid.grid, (64, 64), lod, 30.0, scene.clipmap.height_range))
            heights.append(frame.positions(scene.draw(frame, state)["depth"])[..., 2])
            triangles.append(state.statistics().triangles)
        assert len(set(triangles)) > 5
        return float(np.abs(np.diff(heights, axis=0)).max())


def test_morphs_are_without_jumps(gpu: Gpu) -> None:
    assert flow(gpu, True) < 0.1 * flow(gpu, False)


def test_blocks_next_to_rough_ones_are_refined_step_by_step(gpu: Gpu) -> None:
    heights = np.zeros((129, 129), np.float32)
    heights[60:68, 60:68] = noise(8, 8, relief=200.0)
    with closing(Scene(gpu, heights)) as scene:
        state = scene.algorithm("geomipmap", {"block_size": 8, "quads_per_sample": 1})
        frame = as_unculled(scene.frame(scene.camera(64, 64, 2000, pitch=-90)))
        levels = np.full((16, 16), -1)
        for draw in read_triangles(scene, frame, state):
            rest = draw["id"][:, 0, 0].astype(int) & (1 << 26) - 1
            levels[rest >> 13, rest & 0x1FFF] = draw["tile_level"][:, 0, 0]
        assert levels[7:9, 7:9].max() == 0
        y, x = np.indices(levels.shape)
        steps = np.maximum(np.maximum(7 - x, x - 8), 0) + np.maximum(np.maximum(7 - y, y - 8), 0)
        np.testing.assert_array_equal(levels, np.minimum(steps, 3))


def test_culling_never_changes_the_picture(exact: tuple[Scene, NDArray[np.float32]]) -> None:
    scene, _ = exact
    state = scene.algorithm("geomipmap", SETTINGS[0])
    culled_blocks = all_blocks = 0
    for camera in some_cameras(scene, 6, seed=17):
        frame = scene.frame(camera)
        culled = scene.draw(frame, state)
        culled_blocks += state.statistics().patches
        everything = scene.draw(as_unculled(frame), state)
        all_blocks += state.statistics().patches
        for name in culled:
            np.testing.assert_array_equal(culled[name], everything[name])
    assert culled_blocks < 0.7 * all_blocks


def test_statistics_count_what_is_drawn(exact: tuple[Scene, NDArray[np.float32]]) -> None:
    scene, _ = exact
    triangles = []
    for error in (8.0, 2.0, 0.5):
        state = scene.algorithm("geomipmap", {"block_size": 8, "quads_per_sample": 1, "max_error": error})
        frame = scene.frame(scene.camera(50, 70, 500, pitch=-30))
        draws = read_triangles(scene, frame, state)
        counted = state.statistics()
        assert counted.triangles == sum(draw[..., 0].size for draw in draws)
        assert counted.patches == len({int(name) for draw in draws for name in draw["id"].ravel()})
        assert counted.draws == len(draws)
        triangles.append(counted.triangles)
    assert (np.diff(triangles) > 0).all()


def test_too_many_samples_are_refused(
    exact: tuple[Scene, NDArray[np.float32]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(geomipmap, "MOST_SAMPLES", 7_999)
    with pytest.raises(BudgetError, match="at most 7999 of them, got 100 x 80; cut the data"):
        exact[0].algorithm("geomipmap")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"block_size": "20"}, "block_size: expected a power of two from 4 to 64, got 20"),
        ({"quads_per_sample": "16"}, "quads_per_sample: expected 1, 2, 4 or 8, got 16"),
        ({"max_error": "0"}, "max_error: expected a number of pixels above 0, got 0"),
        ({"max_eror": "1"}, "did you mean max_error"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("geomipmap", settings)
