"""frostbite: its nine index lists, its quadtree against a plain one, and a surface without T-junctions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.restricted import Leaf, PlainQuadtree, areas, assert_whole, edge_counts, some_cameras, unculled
from lod.scene import SPACING, Scene, noise
from lod.triangles import read_triangles, with_area
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.contract import Patches
from orogen.lod.frostbite import Frostbite, Settings
from orogen.lod.frostbite.patterns import PATTERNS, QUADS, Bits, index_lists, pattern_of

SHAPES = [(300, 421), (2, 3), (500, 2)]
"""Rows and columns."""
SETTINGS: list[dict[str, Any]] = [{"pixels_per_quad": 12.0}, {"quads_per_sample": 1, "pixels_per_quad": 2.0}]


@pytest.fixture(scope="module", params=SHAPES, ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    # coarser data from half a node on: heights blend, too
    with closing(Scene(gpu, noise(*request.param), view_distance=0.5)) as terrain:
        yield terrain


def places(triangles: NDArray[np.uint32]) -> NDArray[np.int64]:
    """(n, 3, 2) columns and rows of vertex numbers."""
    mask = (1 << Bits.ROW) - 1
    return np.stack([triangles & mask, triangles >> Bits.ROW & mask], axis=-1).astype(np.int64)


@pytest.mark.parametrize("pattern", range(PATTERNS))
def test_index_lists_cover_the_patch_once_and_leave_out_the_vertices_between_a_coarser_neighbours(pattern: int) -> None:
    triangles = index_lists()[pattern]
    assert ((triangles >> Bits.PATTERN) == pattern).all()
    corners = places(triangles)
    assert (areas(corners) > 0).all()
    assert areas(corners).sum() == QUADS**2
    coarser = {
        "west": pattern % 3 == 1,
        "east": pattern % 3 == 2,
        "north": pattern // 3 == 1,
        "south": pattern // 3 == 2,
    }
    expected = set()
    for side, larger in coarser.items():
        step = 2 if larger else 1
        for at in range(0, QUADS, step):
            fixed = QUADS if side in ("east", "south") else 0
            ends = [(fixed, at), (fixed, at + step)] if side in ("west", "east") else [(at, fixed), (at + step, fixed)]
            expected.add((ends[0], ends[1]))
    counts = edge_counts(corners)
    assert {edge for edge, count in counts.items() if count == 1} == expected
    assert set(counts.values()) == {1, 2}


def test_a_removed_vertex_makes_one_triangle_of_two_and_changes_no_other() -> None:
    lists = [{frozenset(map(tuple, t)) for t in places(triangles).tolist()} for triangles in index_lists()]
    for pattern, triangles in enumerate(lists):
        stitched = (pattern % 3 > 0) + (pattern // 3 > 0)
        assert len(triangles) == 2 * QUADS**2 - stitched * QUADS // 2
        new, gone = triangles - lists[0], lists[0] - triangles
        assert len(new) == stitched * QUADS // 2
        assert len(gone) == 2 * len(new)
        for merged in new:
            removed = [
                set(old) - set(merged) for old in gone if len(old & merged) == 2 and on_a_side(old - merged, merged)
            ]
            assert len(removed) == 2
            assert removed[0] == removed[1]


def on_a_side(vertices: frozenset[Any], triangle: frozenset[Any]) -> bool:
    """Whether a vertex lies in the middle of a side of a triangle."""
    a, b, c = (np.array(v) for v in triangle)
    (vertex,) = vertices
    return any((2 * np.array(vertex) == p + q).all() for p, q in ((a, b), (b, c), (c, a)))


def test_wireframe_lines_lie_on_the_edges_of_the_triangles() -> None:
    """The twin of lines_at: one function is whole along every edge, none is across a triangle."""
    for triangles in index_lists():
        at = places(triangles).astype(np.float64)
        hidden = np.stack([triangles >> Bits.HIDE_COLUMN & 1, triangles >> Bits.HIDE_ROW & 1], axis=-1) == 1
        x, y = np.moveaxis(at, -1, 0)
        lines = np.concatenate([np.where(hidden, 0.5, at), np.stack([(x + y) / 2, (x - y) / 2], axis=-1)], axis=-1)
        for a, b in ((0, 1), (1, 2), (2, 0)):
            along = (lines[:, a] == lines[:, b]) & (lines[:, a] % 1 == 0)
            assert along.any(axis=-1).all()
        low, high = lines.min(axis=1), lines.max(axis=1)
        # strictly between the corners' values there is no whole number
        assert (np.ceil(high) - np.floor(low) <= 1).all()


def test_patterns_name_the_coarser_sides() -> None:
    cases = {0: "", 1: "W", 2: "E", 3: "N", 4: "WN", 5: "EN", 6: "S", 7: "WS", 8: "ES"}
    sides = np.array([[side in word for side in "WENS"] for word in cases.values()])
    assert pattern_of(sides).tolist() == list(cases)


def plain_leaves(scene: Scene, frame: Frame, settings: Settings) -> set[Leaf]:
    """The leaves of an unculled frame; fails where a decision is too close to call."""
    tree = PlainQuadtree(scene, frame, QUADS / settings.quads_per_sample)
    pixels = frame.size[1] / 2 / math.tan(math.radians(frame.lod.fov) / 2)

    def divided(leaf: Leaf) -> bool:
        distance = tree.distance(*tree.corners(leaf), tree.heights(leaf))
        seen = pixels * SPACING / settings.quads_per_sample * 2 ** leaf[0] / max(distance, 1e-9)
        assert abs(seen / settings.pixels_per_quad - 1) > 1e-9
        return seen > settings.pixels_per_quad

    return tree.leaves(divided)


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_leaves_are_those_of_a_plain_quadtree(scene: Scene, settings: dict[str, Any]) -> None:
    algorithm = Frostbite(scene.clipmap, make_settings("frostbite", settings))
    for k, camera in enumerate(some_cameras(scene, 4, seed=5)):
        frozen = {"lod_camera": camera.moved(z=camera.z + 150, x=camera.x + 40)} if k == 2 else {}
        frame = unculled(scene.frame(camera, (160, 100), exaggeration=1.0 + (k == 1), **frozen))
        patches, _ = algorithm.choose(frame, scene.view)
        found = list(zip(patches["level"].tolist(), patches["x"].tolist(), patches["y"].tolist(), strict=True))
        assert len(found) == len(set(found))
        assert set(found) == plain_leaves(scene, frame, algorithm.settings)


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_edges_match_bit_for_bit(scene: Scene, settings: dict[str, Any]) -> None:
    """Also where the quadtree's levels are forced together, and where patches hang over the data."""
    state = scene.algorithm("frostbite", settings)
    used: set[int] = set()
    for camera in some_cameras(scene, 3, seed=6):
        frame = unculled(scene.frame(camera, (96, 64)))
        draws = read_triangles(scene, frame, state)
        statistics = state.statistics()
        assert statistics.triangles == sum(draw.shape[0] * draw.shape[1] for draw in draws)
        assert (statistics.patches, statistics.draws) == (sum(len(draw) for draw in draws), len(draws))
        used |= {draw.shape[1] for draw in draws}
        assert_whole(with_area(draws), frame)
    # no side, one side and two sides stitched
    assert len(used) == 3 or scene.pyramid.grid.width < 10


def test_quads_are_no_larger_on_screen_than_was_asked_for(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(300, 421, 5.0))) as scene:
        state = scene.algorithm("frostbite", {"pixels_per_quad": 6.0})
        for z in (60.0, 300.0, 1500.0):
            frame = scene.frame(scene.camera(200, 150, z, pitch=-50), (200, 150))
            draws = read_triangles(scene, frame, state)
            assert draws
            for draw in draws:
                quad = SPACING * 2.0 ** draw["tile_level"][:, 0, 0] / 32
                nearest = np.linalg.norm(draw["position"].astype(np.float64), axis=-1).min(axis=(1, 2))
                assert (quad / nearest * frame.pixels_per_radian() <= 6.0 + 1e-6).all()


def test_finer_settings_draw_more(scene: Scene) -> None:
    frame = scene.frame(scene.camera(100, 100, 600, pitch=-40), (160, 100))
    triangles = []
    for pixels in (16.0, 8.0, 4.0):
        state = scene.algorithm("frostbite", {"pixels_per_quad": pixels, "quads_per_sample": 8})
        scene.draw(frame, state)
        triangles.append(state.statistics().triangles)
    if scene.pyramid.grid.width > 10:
        assert triangles[0] < triangles[1] < triangles[2]


def test_the_list_of_patches_grows(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(300, 421))) as scene:
        frame = scene.frame(scene.camera(200, 150, 130, pitch=-20), (160, 100))
        settings = {"pixels_per_quad": 0.5}
        used = scene.algorithm("frostbite", settings)
        # first a picture that fits
        scene.draw(scene.frame(scene.camera(200, 150, 20000, pitch=-90), (160, 100)), used)
        drawn = scene.draw(frame, used)
        assert used.statistics().patches > 512
        fresh = scene.draw(frame, scene.algorithm("frostbite", settings))
        for name in drawn:
            np.testing.assert_array_equal(drawn[name], fresh[name])


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("frostbite")
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().patches == 0


def test_each_pattern_is_one_draw_of_the_same_buffers(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(300, 421))) as scene:
        frame = scene.frame(scene.camera(200, 150, 130, pitch=-20), (160, 100))
        draws = scene.record(frame, scene.algorithm("frostbite"))
        assert 2 <= len(draws) <= PATTERNS
        assert all(isinstance(draw, Patches) for draw in draws)
        assert len({(id(draw.index), id(draw.indirect), id(draw.group)) for draw in draws}) == 1  # type: ignore[union-attr]
        assert len({draw.offset for draw in draws}) == len(draws)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"pixels_per_quad": "nan"}, "pixels_per_quad: expected a number above 0, got nan"),
        ({"quads_per_sample": "3"}, "quads_per_sample: expected a power of two from 1 to 32, got 3"),
        ({"quads_per_sample": "64"}, "quads_per_sample: expected a power of two from 1 to 32, got 64"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("frostbite", settings)
