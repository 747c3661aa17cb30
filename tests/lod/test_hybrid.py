"""hybrid: it chooses by the costs, and every pixel is either udlod's or raycast's, with no gap between them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from lod.hybrid_twin import Twin
from lod.scene import Buffers, Scene, noise
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.hybrid import Settings, View
from orogen.lod.hybrid.choice import Costs

ROWS, COLUMNS = 300, 400
Tile = tuple[int, int, int]
"""Level, column, row."""
TILE = np.dtype([("x", "u4"), ("y", "u4"), ("level", "u4"), ("node", "u4")])


def hilly() -> np.ndarray:
    return hills(COLUMNS, 500.0).astype(np.float32)[:ROWS]


def pierced() -> np.ndarray:
    heights = hilly() + noise(ROWS, COLUMNS, 20.0)
    heights[np.random.default_rng(4).random(heights.shape) < 0.002] = np.nan
    heights[60:110, 150:220] = np.nan
    return heights


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hilly())) as terrain:
        yield terrain


def chosen(state: View) -> tuple[set[Tile], set[Tile]]:
    """Tiles of the latest frame: triangles, rays."""
    gpu = state._algorithm.clipmap.gpu
    counts = gpu.read_buffer(state._counts).result().view(np.uint32)
    listed = gpu.read_buffer(state._chosen).result().view(TILE)
    tiles = [(int(t["level"]), int(t["x"]), int(t["y"])) for t in listed]
    assert counts[0] == counts[1] + counts[2]
    return set(tiles[: counts[1]]), set(tiles[len(tiles) - counts[2] :])


def some_cameras(scene: Scene, count: int, seed: int) -> list[Camera]:
    """Over and in the terrain, looking anywhere; the first one beside it, the last one orthographic."""
    random = np.random.default_rng(seed)
    cameras = [
        scene.camera(
            random.uniform(0.1, 0.9) * COLUMNS,
            random.uniform(0.1, 0.9) * ROWS,
            10 ** random.uniform(1.8, 3.2),
            heading=random.uniform(0, 360),
            pitch=random.uniform(-80, 0),
            roll=random.uniform(-20, 20),
        )
        for _ in range(count - 2)
    ]
    beside = scene.camera(-0.1 * COLUMNS, 0.4 * ROWS, 300.0, heading=95.0, pitch=-25.0)
    return [beside, *cameras, scene.camera(200, 150, 300.0, heading=30.0, orthographic=900.0, pitch=-40.0)]


@pytest.mark.parametrize("changes", [{}, {"exaggeration": 2.0}, {"curvature": True}, {"frozen": True}], ids=str)
def test_tiles_are_chosen_by_their_costs(scene: Scene, changes: dict[str, Any]) -> None:
    settings = {"grid_size": 4, "pixels_per_quad": 6.0, "cost_triangle": 100.0, "cost_step": 1.5}
    state = scene.algorithm("hybrid", settings)
    assert isinstance(state, View)
    surface = TrueSurface(hilly())
    totals, close = [0, 0], 0
    for camera in some_cameras(scene, 4, seed=5):
        frozen = {"lod_camera": camera.moved(x=camera.x + 90, z=camera.z + 70, heading=camera.heading + 9)}
        frame = scene.frame(camera, (120, 72), **(frozen if "frozen" in changes else changes))
        scene.draw(frame, state)
        twin = Twin(frame, make_settings("hybrid", settings), surface)
        triangles, rays = chosen(state)
        assert not triangles & rays
        # enough of them: numpy is slow for one at a time
        for tile in sorted(triangles)[::3] + sorted(rays)[::3]:
            by_triangles, by_rays = twin.costs(tile)
            # float32 of a tile's place on the screen
            if abs(by_rays / by_triangles - 1) < 2e-3:
                close += 1
                continue
            assert (tile in rays) == (by_rays < by_triangles), (tile, by_triangles, by_rays)
        totals = [total + len(tiles) for total, tiles in zip(totals, (triangles, rays), strict=True)]
    assert min(totals) > 20
    assert close <= 0.02 * sum(totals) + 1


def test_a_part_of_a_picture_chooses_as_the_picture_does(scene: Scene) -> None:
    """A tile costs what it does in the whole picture, of which a part has half the pixels a side here."""
    state = scene.algorithm("hybrid", {"grid_size": 4, "pixels_per_quad": 6.0, "cost_triangle": 100.0})
    assert isinstance(state, View)
    both = [0, 0]
    for camera in some_cameras(scene, 3, seed=6):
        scene.draw(scene.frame(camera, (240, 144)), state)
        expected = chosen(state)
        scene.draw(scene.frame(camera, (120, 72), coarseness=0.5), state)
        assert chosen(state) == expected
        both = [total + len(tiles) for total, tiles in zip(both, expected, strict=True)]
    assert min(both) > 20


class Pair:
    """A terrain as hybrid, udlod and raycast draw it."""

    def __init__(self, scene: Scene, settings: dict[str, Any], *costs: dict[str, float]) -> None:
        self.scene = scene
        self.hybrids = [scene.algorithm("hybrid", {**settings, **cost}) for cost in costs]
        self.udlod = scene.algorithm("udlod", settings)
        self.raycast = scene.algorithm("raycast")

    def draw(self, frame: Frame, number: int = 0) -> tuple[View, Buffers, Buffers, Buffers]:
        """The hybrid of a number, and the three pictures."""
        state = self.hybrids[number]
        assert isinstance(state, View)
        draw = self.scene.draw
        return state, draw(frame, state), draw(frame, self.udlod), draw(frame, self.raycast)


@pytest.mark.parametrize("terrain", ["hilly", "pierced"])
def test_all_triangles_is_udlod_and_all_rays_is_raycast(gpu: Gpu, terrain: str) -> None:
    with closing(Scene(gpu, {"hilly": hilly, "pierced": pierced}[terrain](), view_distance=0.3)) as scene:
        three = Pair(scene, {"grid_size": 8, "pixels_per_quad": 6.0}, {"cost_triangle": 0.0}, {"cost_step": 0.0})
        for number, camera in enumerate(some_cameras(scene, 6, seed=len(terrain))):
            frame = scene.frame(camera, curvature=number % 2 == 1)
            state, drawn, triangles, rays = three.draw(frame, 0)
            for name in drawn:
                np.testing.assert_array_equal(drawn[name], triangles[name])
            assert state.statistics().rays == 0
            state, drawn, triangles, rays = three.draw(frame, 1)
            np.testing.assert_array_equal(drawn["depth"], rays["depth"])
            np.testing.assert_array_equal(drawn["id"], rays["id"])
            assert state.statistics().triangles == 0
            assert state.statistics().rays >= (rays["depth"] > 0).sum()


@pytest.mark.parametrize(
    ("terrain", "view_distance"),
    [("hilly", np.inf), ("pierced", 0.3), ("noise", 0.3), ("noise", np.inf)],
)
def test_no_gap_between_triangles_and_rays(gpu: Gpu, terrain: str, view_distance: float) -> None:
    """Each pixel is what udlod or what raycast shows there: a gap would show what lies behind both."""
    heights = {"hilly": hilly, "pierced": pierced, "noise": lambda: noise(ROWS, COLUMNS, 150.0)}[terrain]()
    mixed = rays_shown = 0
    with closing(Scene(gpu, heights, view_distance=view_distance)) as scene:
        # coarse triangles, so that they are far from the true surface
        costs = [{"cost_triangle": cost} for cost in (100.0, 500.0)]
        three = Pair(scene, {"grid_size": 4, "pixels_per_quad": 12.0}, *costs)
        for number, camera in enumerate(some_cameras(scene, 10, seed=len(terrain) + 20)):
            frame = scene.frame(camera, (120, 80), curvature=number % 4 == 1, exaggeration=1.0 + number % 3)
            state, drawn, triangles, rays = three.draw(frame, number % 2)
            as_triangles, as_rays = drawn["depth"] == triangles["depth"], drawn["depth"] == rays["depth"]
            assert (as_triangles | as_rays).all(), np.argwhere(~(as_triangles | as_rays))[:5]
            mixed += all(chosen(state))
            rays_shown += int((as_rays & ~as_triangles).sum())
    assert mixed >= 3
    assert rays_shown > 1000


def test_rays_are_cast_near_ray_tiles_alone(scene: Scene) -> None:
    cast = shown = 0
    three = Pair(scene, {"grid_size": 8, "pixels_per_quad": 8.0}, {"cost_triangle": 40.0})
    for camera in some_cameras(scene, 6, seed=31)[:-1]:
        state, drawn, triangles, rays = three.draw(scene.frame(camera, (320, 200)))
        cast += state.statistics().rays
        shown += int(((drawn["depth"] == rays["depth"]) & (drawn["depth"] != triangles["depth"])).sum())
    assert 5000 < shown <= cast < 3 * shown


def test_costs_are_learned_only_where_that_is_asked_for(scene: Scene) -> None:
    frame = scene.frame(scene.camera(200, 330, 600, pitch=-25), (200, 150))
    fixed = scene.algorithm("hybrid", {"grid_size": 4})
    learning = scene.algorithm("hybrid", {"grid_size": 4, "calibrate": True})
    assert isinstance(fixed, View)
    assert isinstance(learning, View)
    for _ in range(4):
        scene.draw(frame, fixed)
        scene.timer.results(wait=True)
        scene.draw(frame, learning)
        scene.timer.results(wait=True)
    assert fixed.costs == Costs(8.0, 1.0)
    if scene.timer.results():
        assert learning.costs != fixed.costs
        assert min(learning.costs.triangle, learning.costs.step) > 0


def test_learned_costs_are_nanoseconds() -> None:
    costs = Costs(8.0, 1.0)
    for _ in range(200):
        costs.learn({"raster": 3.0, "rays": 5.0, "refine": 100.0}, 10_000, 200_000.0)
    assert costs.triangle == pytest.approx(300.0)
    assert costs.step == pytest.approx(25.0)
    # a frame without rays, or without times, says nothing
    costs.learn({"raster": 3.0, "rays": 5.0}, 10_000, 10.0)
    costs.learn({}, 10_000, 200_000.0)
    assert costs.step == pytest.approx(25.0)


def test_dearer_steps_make_fewer_ray_tiles(scene: Scene) -> None:
    frame = scene.frame(scene.camera(200, 330, 600, pitch=-25), (200, 150))
    known: list[set[Tile]] = []
    for cost in (0.0, 0.1, 0.5, 2.0, 10.0, 1e6):
        state = scene.algorithm("hybrid", {"grid_size": 4, "cost_triangle": 10.0, "cost_step": cost})
        assert isinstance(state, View)
        scene.draw(frame, state)
        known.append(chosen(state)[1])
    assert all(fewer <= more for more, fewer in itertools.pairwise(known))
    assert len({len(tiles) for tiles in known}) >= 4
    assert not known[-1]


def test_a_full_list_grows_and_the_picture_is_the_same(scene: Scene) -> None:
    frame = scene.frame(scene.camera(200, 200, 500, pitch=-40), (120, 80))
    settings = {"grid_size": 2, "pixels_per_quad": 2.0, "cost_triangle": 100.0}
    roomy = scene.algorithm("hybrid", settings)
    whole = scene.draw(frame, roomy)
    tight = scene.algorithm("hybrid", {**settings, "tile_capacity": 64})
    grown = scene.draw(frame, tight)
    assert roomy.statistics().patches > 200
    assert tight.statistics() == roomy.statistics()
    for name in whole:
        np.testing.assert_array_equal(grown[name], whole[name])


def test_pictures_of_other_sizes_follow_one_another(scene: Scene) -> None:
    state = scene.algorithm("hybrid", {"cost_step": 0.0})
    camera = scene.camera(200, 200, 500, pitch=-90)
    for size in ((96, 64), (7, 9), (131, 20)):
        drawn = scene.draw(scene.frame(camera, size), state)
        assert (drawn["depth"] > 0).all()
        assert state.statistics().rays == size[0] * size[1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"grid_size": "15"}, "grid_size: expected an even number from 2 to 64, got 15"),
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"cost_triangle": "-1"}, "cost_triangle: expected a number of 0 or more, got -1"),
        ({"cost_step": "nan"}, "cost_step: expected a number of 0 or more, got nan"),
        ({"cost_step": "0", "cost_triangle": "0"}, "expected one of them above 0, got 0 for both"),
        ({"morph_range": "0.5"}, "morph_range: expected above 0 and below 0.5, got 0.5"),
        ({"tile_capacity": "10"}, "tile_capacity: expected at least 64 tiles, got 10"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("hybrid", settings)


def test_settings_are_read_from_text() -> None:
    values = {"grid_size": "8", "pixels_per_quad": "2.5", "cost_step": "3"}
    assert make_settings("hybrid", values) == Settings(8, 2.5, cost_step=3.0)
