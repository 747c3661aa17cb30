"""udlod against its float64 twin, and what its triangles promise: no gaps, no overlap, no pops, the asked size."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.patches import Drawn, read_patches, torn_edges
from lod.scene import SPACING, Scene, noise
from lod.udlod_twin import Twin
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.contract import AlgorithmView
from orogen.lod.udlod import Settings

SHAPES = [(700, 1025), (2, 3), (500, 2), (60, 60)]
"""Rows and columns, from less than a tile to several nodes."""
SETTINGS: list[dict[str, Any]] = [
    {},
    {"grid_size": 4, "pixels_per_quad": 6.0, "morph_range": 0.3},
    {"grid_size": 10, "pixels_per_quad": 8.0, "morph_range": 0.1},
    {"grid_size": 2, "tile_scale": 40.0},
]


class Unculled(Frame):
    """A frame whose frustum is everywhere."""

    plane_rows = ((0.0, 0.0, 0.0, 1.0),) * 5


def as_unculled(frame: Frame) -> Unculled:
    return Unculled(**{field.name: getattr(frame, field.name) for field in dataclasses.fields(frame)})


def some_cameras(scene: Scene, count: int, seed: int) -> list[Camera]:
    """Over, beside and far above the terrain, looking anywhere; the last one is orthographic."""
    random = np.random.default_rng(seed)
    width, height = scene.pyramid.grid.width, scene.pyramid.grid.height
    cameras = [
        scene.camera(
            random.uniform(-0.3, 1.3) * width,
            random.uniform(-0.3, 1.3) * height,
            60 + 10 ** random.uniform(0.5, 3.5),
            heading=random.uniform(0, 360),
            pitch=random.uniform(-90, 10),
            roll=random.uniform(-20, 20),
        )
        for _ in range(count)
    ]
    return [*cameras[:-1], cameras[-1].moved(orthographic=700.0, pitch=-40.0)]


def outline(drawn: Drawn) -> tuple[float, float, float, float]:
    x, y = drawn.vertices["position"][..., 0], drawn.vertices["position"][..., 1]
    return x.min(), y.min(), x.max(), y.max()


@pytest.fixture(scope="module", params=SHAPES, ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    # coarser data from half a node on: heights blend, too
    with closing(Scene(gpu, noise(*request.param), view_distance=0.5)) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hills(400, 500.0).astype(np.float32)[:300], view_distance=0.7)) as terrain:
        yield terrain


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_tiles_and_vertices_are_those_of_the_twin(scene: Scene, settings: dict[str, Any]) -> None:
    state = scene.algorithm("udlod", settings)
    for k, camera in enumerate(some_cameras(scene, 4, seed=len(str(settings)))):
        changes = [{}, {"exaggeration": 2.0}, {"lod_camera": camera.moved(z=camera.z + 150, heading=9.0)}, {}][k]
        frame = as_unculled(scene.frame(camera, (160, 100), **changes))
        drawn = read_patches(scene, frame, state)
        twin = Twin(frame, make_settings("udlod", settings))
        expected, close = twin.refine()
        tiles = [tuple(tile) for tile in drawn.tiles.tolist()]
        assert len(tiles) == len(set(tiles))
        assert set(tiles) - close == expected
        assert len(close) <= 0.01 * len(tiles) + 4
        bits = frame.subtexel_bits
        random = np.random.default_rng(k)
        for i in random.choice(len(tiles), min(30, len(tiles)), replace=False):
            at, morph, places = twin.vertices(tiles[i])
            ours = drawn.vertices[i]
            np.testing.assert_array_equal(ours["grid"], places)
            texel = (ours["offset"] + frame.anchor.astype(np.float64)) / 2**bits - 0.5
            quad = twin.leaf * 2.0 ** tiles[i][0]
            # float32 distances decide how far a vertex has moved
            tolerance = 1e-5 * quad / twin.settings.morph_range + 2e-7 * np.abs(ours["offset"]).max() / 2**bits
            np.testing.assert_allclose(texel, at, atol=tolerance)
            assert ((morph >= 0) & (morph <= 1)).all()


def test_twin_splits_by_the_nearest_point_of_sheared_tiles(gpu: Gpu) -> None:
    """Where texels are no rectangles, the nearest point of a tile is not found axis by axis."""
    metres = np.array([[10.0, 7.0], [1.0, -8.0]])
    with closing(Scene(gpu, noise(300, 300), metres=metres)) as scene:
        state = scene.algorithm("udlod", {"grid_size": 8, "pixels_per_quad": 8.0})
        for camera in some_cameras(scene, 3, seed=8)[:-1]:
            frame = as_unculled(scene.frame(camera, (160, 100)))
            drawn = read_patches(scene, frame, state)
            expected, close = Twin(frame, make_settings("udlod", {"grid_size": 8, "pixels_per_quad": 8.0})).refine()
            assert {tuple(tile) for tile in drawn.tiles.tolist()} - close == expected
            assert differences(drawn.tiles) <= {0, 1}
            assert_no_gap_inside(scene, frame, drawn)


def assert_no_gap_inside(scene: Scene, frame: Frame, drawn: Drawn) -> None:
    """As `torn_edges`, where the outline is no rectangle in metres."""
    triangles = drawn.triangles
    torn = torn_edges(triangles, (np.nan,) * 4)
    texel = torn[..., :2] @ np.linalg.inv(frame.grid.metres).T + frame.eye - 0.5
    last = np.array([frame.grid.width, frame.grid.height]) - 1.0
    border = (np.abs(texel) < 1e-3) | (np.abs(texel - last) < 1e-3)
    assert border.all(axis=1).any(axis=1).all()


def differences(tiles: NDArray[np.int64]) -> set[int]:
    """Differences of level between tiles that share a side, from a map with a cell per finest tile."""
    finest = tiles[:, 0].min()
    cells = 1 << (tiles[:, 0] - finest)
    columns, rows = ((tiles[:, 1:] + 1) * cells[:, None]).max(axis=0)
    levels = np.full((rows, columns), -1)
    for (level, x, y), n in zip(tiles.tolist(), cells.tolist(), strict=True):
        part = levels[y * n : (y + 1) * n, x * n : (x + 1) * n]
        assert (part == -1).all(), "tiles overlap"
        part[:] = level
    found: set[int] = set()
    for a, b in ((levels[1:], levels[:-1]), (levels[:, 1:], levels[:, :-1])):
        both = (a >= 0) & (b >= 0)
        found |= set(np.abs(a - b)[both].tolist())
    return found


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_tiles_cover_the_data_once_and_edges_match_bit_for_bit(scene: Scene, settings: dict[str, Any]) -> None:
    state = scene.algorithm("udlod", settings)
    mixed = 0
    for camera in some_cameras(scene, 3, seed=3):
        frame = as_unculled(scene.frame(camera, (160, 100)))
        drawn = read_patches(scene, frame, state)
        assert differences(drawn.tiles) <= {0, 1}
        mixed += len(np.unique(drawn.tiles[:, 0])) > 1
        twin = Twin(frame, make_settings("udlod", settings))
        areas = [float(np.prod(high - low)) for low, high in map(twin.corners, map(tuple, drawn.tiles.tolist()))]
        assert sum(areas) == pytest.approx(float(np.prod(twin.size)))
        triangles = drawn.triangles
        assert len(torn_edges(triangles, outline(drawn))) == 0
        # flat areas add up: nothing is folded over
        a, b, c = triangles[..., :2].astype(np.float64).swapaxes(0, 1)
        (px, py), (qx, qy) = (b - a).T, (c - a).T
        flat = np.abs(px * qy - py * qx).sum() / 2
        assert flat == pytest.approx(np.prod(twin.size) * SPACING**2, rel=1e-3)
    assert mixed or scene.pyramid.grid.width < 100


def test_edges_match_where_distances_are_on_the_verge(gpu: Gpu) -> None:
    """An eye straight across from a vertex on the border of two levels, at the distance that divides them."""
    turn = np.radians(27.0)
    metres = SPACING * np.array([[np.cos(turn), np.sin(turn)], [np.sin(turn), -np.cos(turn)]])
    with closing(Scene(gpu, noise(260, 260), metres=metres)) as scene:
        settings = {"grid_size": 8, "pixels_per_quad": 8.0}
        state = scene.algorithm("udlod", settings)
        size, level = (160, 100), 6
        some = scene.frame(scene.camera(10, 10, 500), size)
        twin = Twin(some, make_settings("udlod", settings))
        quad, far = twin.leaf * 2.0**level, twin.range_end(level)
        border, row, up = 4 * quad * 8, 35 * quad, 0.3 * far
        away = np.sqrt(far**2 - up**2) / SPACING
        on_the_verge = Counter[bool]()
        # tiles are divided a hundred-thousandth early
        for beyond in np.linspace(0.0, 2e-5, 21):
            eye = scene.camera(border - away * (1 + beyond) + 0.5, row + 0.5, 30 + up)
            frame = Unculled(eye, some.grid, size, ground_height=30.0, height_range=some.height_range)
            drawn = read_patches(scene, frame, state)
            assert differences(drawn.tiles) <= {0, 1}
            assert_no_gap_inside(scene, frame, drawn)
            tiles = set(map(tuple, drawn.tiles.tolist()))
            assert (level, 3, 4) in tiles
            on_the_verge[(level + 1, 2, 2) in tiles] += 1
        assert len(on_the_verge) == 2


def test_a_single_sample_draws_nothing(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((1, 1), 5.0))) as scene:
        frame = scene.frame(scene.camera(0.5, 0.5, 100, pitch=-90))
        for name in ("udlod", "raycast"):
            assert (scene.draw(frame, scene.algorithm(name))["depth"] == 0).all()


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        for name in ("udlod", "raycast"):
            state = scene.algorithm(name)
            assert (scene.draw(frame, state)["depth"] == 0).all()
            assert state.statistics().patches == 0


def test_quads_have_the_size_that_was_asked_for(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((1000, 1200), 50.0))) as scene:
        asked = 6.0
        state = scene.algorithm("udlod", {"pixels_per_quad": asked})
        for up in (700.0, 1500.0, 2900.0):
            frame = scene.frame(scene.camera(600, 500, 50 + up, pitch=-90), (400, 300))
            drawn = read_patches(scene, frame, state)
            p = drawn.vertices["position"].astype(np.float64)
            clip = np.concatenate([p, np.ones((*p.shape[:2], 1))], axis=2) @ frame.view_projection.T
            pixel = clip[..., :2] / clip[..., 3:] * [200, -150]
            grid = drawn.vertices["grid"].astype(int)
            distance = np.linalg.norm(p, axis=2)
            longest, whole = [], []
            for tile in range(len(p)):
                at = {tuple(g): k for k, g in enumerate(grid[tile].tolist())}
                for (column, row), k in at.items():
                    other = at.get((column + 1, row))
                    if other is None:
                        continue
                    size = np.linalg.norm(pixel[tile, k] - pixel[tile, other])
                    # the ground is seen face on: its picture is not smaller for being further aside
                    near = min(distance[tile, k], distance[tile, other]) / up
                    longest.append(size / near)
                    whole.append(size / near if size > 0 else np.inf)
            assert max(longest) <= asked * 1.001
            assert max(longest) >= asked * 0.7
            # fully morphed ones are twice as wide or gone
            assert np.quantile([w for w in whole if np.isfinite(w)], 0.1) >= asked * 0.4


def test_tile_scale_says_the_same_as_pixels_per_quad(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 330, 600, pitch=-25))
    one = hilly.draw(frame, hilly.algorithm("udlod", {"grid_size": 8, "pixels_per_quad": 5.0}))
    other = hilly.draw(frame, hilly.algorithm("udlod", {"grid_size": 8, "tile_scale": 40.0}))
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])


def test_smaller_quads_are_more(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 330, 600, pitch=-25), (200, 150))
    triangles = []
    for pixels in (8.0, 4.0, 2.0, 1.0):
        state = hilly.algorithm("udlod", {"grid_size": 4, "pixels_per_quad": pixels})
        hilly.draw(frame, state)
        triangles.append(state.statistics().triangles)
    ratio = np.divide(triangles[1:], triangles[:-1])
    assert ((ratio > 2.5) & (ratio < 5)).all()


def test_a_full_list_grows_and_the_picture_is_the_same(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 500, pitch=-40))
    settings = {"grid_size": 2, "pixels_per_quad": 1.0}
    roomy = hilly.algorithm("udlod", settings)
    whole = hilly.draw(frame, roomy)
    assert roomy.statistics().patches > 1000
    tight = hilly.algorithm("udlod", {**settings, "tile_capacity": 64})
    first = hilly.raster(frame, hilly.record(frame, tight))
    # coarser for want of room, without a hole
    assert tight.statistics().patches <= 64
    assert ((first["depth"] > 0) == (whole["depth"] > 0)).mean() > 0.97
    assert tight.incomplete()
    grown = hilly.draw(frame, tight)
    for name in whole:
        np.testing.assert_array_equal(grown[name], whole[name])
    assert not tight.incomplete()


def test_what_finds_no_room_is_drawn_coarser_but_once(hilly: Scene) -> None:
    frame = as_unculled(hilly.frame(hilly.camera(200, 200, 700, pitch=-40)))
    for capacity in (65, 66, 67, 70, 203):
        state = hilly.algorithm("udlod", {"grid_size": 2, "pixels_per_quad": 1.0, "tile_capacity": capacity})
        drawn = read_patches(hilly, frame, state, grow=False)
        assert capacity - 3 < len(drawn.tiles) <= capacity
        differences(drawn.tiles)
        twin = Twin(frame, state._algorithm.settings)  # type: ignore[attr-defined]
        areas = [np.prod(high - low) for low, high in map(twin.corners, map(tuple, drawn.tiles.tolist()))]
        assert sum(areas) == pytest.approx(float(np.prod(twin.size)))
        assert state.incomplete()


def test_a_list_grows_by_itself_from_frame_to_frame(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 500, pitch=-40))
    settings = {"grid_size": 2, "pixels_per_quad": 1.0}
    whole = hilly.draw(frame, hilly.algorithm("udlod", settings))
    tight = hilly.algorithm("udlod", {**settings, "tile_capacity": 64})
    for _ in range(20):
        drawn = hilly.raster(frame, hilly.record(frame, tight))
    for name in whole:
        np.testing.assert_array_equal(drawn[name], whole[name])


def test_room_without_end_is_refused(hilly: Scene) -> None:
    with pytest.raises(BudgetError, match="raise pixels_per_quad"):
        hilly.algorithm("udlod", {"tile_capacity": 1 << 28})


@pytest.mark.parametrize("curvature", [False, True])
@pytest.mark.parametrize("view_distance", [0.02, 0.7, np.inf])
def test_culling_never_changes_the_picture(gpu: Gpu, view_distance: float, curvature: bool) -> None:
    heights = hills(400, 500.0).astype(np.float32)[:300] + noise(300, 400)
    # with curvature a whole country, so that it matters
    with closing(Scene(gpu, heights, view_distance=view_distance, spacing=1000.0 if curvature else SPACING)) as scene:
        culled_tiles = all_tiles = 0
        state: AlgorithmView = scene.algorithm("udlod", {"grid_size": 4})
        for camera in some_cameras(scene, 10, seed=17):
            frame = scene.frame(camera, curvature=curvature, exaggeration=1.0 + curvature)
            culled = scene.draw(frame, state)
            culled_tiles += state.statistics().patches
            everything = scene.draw(as_unculled(frame), state)
            all_tiles += state.statistics().patches
            for name in culled:
                np.testing.assert_array_equal(culled[name], everything[name])
        assert culled_tiles < 0.6 * all_tiles


def test_each_run_is_the_same(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 330, 600, pitch=-25), (200, 150))
    state = hilly.algorithm("udlod", {"grid_size": 2, "pixels_per_quad": 2.0})
    first = hilly.draw(frame, state)
    for other in (state, hilly.algorithm("udlod", {"grid_size": 2, "pixels_per_quad": 2.0})):
        again = hilly.draw(frame, other)
        for name in first:
            np.testing.assert_array_equal(first[name], again[name])


def test_a_frozen_camera_keeps_its_tiles(hilly: Scene) -> None:
    state = hilly.algorithm("udlod")
    eye = hilly.camera(200, 330, 600, pitch=-25)
    own = read_patches(hilly, hilly.frame(eye), state)
    aside = eye.moved(x=eye.x - 1234.0, z=2000.0, heading=40.0, pitch=-60.0)
    frozen = read_patches(hilly, hilly.frame(aside, lod_camera=eye), state)
    tiles = [Counter(map(tuple, drawn.tiles.tolist())) for drawn in (own, frozen)]
    # tiles that touch the frustum's planes within rounding may come and go
    assert sum(((tiles[0] - tiles[1]) + (tiles[1] - tiles[0])).values()) <= 1
    by_tile = [dict(zip(map(tuple, d.tiles.tolist()), d.vertices["height"], strict=True)) for d in (own, frozen)]
    for tile in set(by_tile[0]) & set(by_tile[1]):
        np.testing.assert_allclose(by_tile[0][tile], by_tile[1][tile], atol=0.05)


def test_the_surface_flows_with_the_camera(gpu: Gpu) -> None:
    """Tiles split and merge as the camera moves, but no point of the drawn surface jumps."""
    with closing(Scene(gpu, noise(300, 300), view_distance=0.4)) as scene:
        above = scene.camera(150, 150, 500, pitch=-90, orthographic=1200.0)
        eye = scene.camera(140, 160, 120)
        scene.frame(eye, (64, 64))
        state = scene.algorithm("udlod", {"grid_size": 4, "pixels_per_quad": 4.0})
        step = 0.25
        heights, tiles = [], []
        for k in range(60):
            lod = eye.moved(x=eye.x + step * k, y=eye.y + 0.6 * step * k)
            # fixed, so that only the horizontal motion counts
            frame = as_unculled(Frame(above, scene.pyramid.grid, (64, 64), lod, 30.0, scene.clipmap.height_range))
            depth = scene.draw(frame, state)["depth"]
            assert (depth > 0).all()
            heights.append(frame.positions(depth)[..., 2])
            tiles.append(state.statistics().patches)
        assert len(set(tiles)) > 5
        change = np.abs(np.diff(heights, axis=0))
        # all the way the surface changes by metres; in one step it must not
        assert np.ptp(heights, axis=0).max() > 10
        assert change.max() < 4


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"grid_size": "15"}, "grid_size: expected an even number from 2 to 64, got 15"),
        ({"grid_size": "66"}, "grid_size: expected an even number from 2 to 64, got 66"),
        ({"grid_size": "x"}, "udlod grid_size: expected int, got 'x'"),
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"pixels_per_quad": "nan"}, "pixels_per_quad: expected a number above 0, got nan"),
        ({"tile_scale": "-1"}, "tile_scale: expected a number of pixels above 0, got -1"),
        ({"morph_range": "0.5"}, "morph_range: expected above 0 and below 0.5, got 0.5"),
        ({"tile_capacity": "10"}, "tile_capacity: expected at least 64 tiles, got 10"),
        ({"pixel_per_quad": "3"}, "did you mean pixels_per_quad"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message.replace("(", r"\(")):
        make_settings("udlod", settings)


def test_settings_are_read_from_text() -> None:
    values = {"grid_size": "8", "tile_scale": "none", "pixels_per_quad": "2.5", "morph_range": "0.3"}
    assert make_settings("udlod", values) == Settings(8, 2.5, None, 0.3)
    assert make_settings("udlod", {"tile_scale": "64"}).quad_pixels == 4.0
