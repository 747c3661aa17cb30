"""seamless_patches: its cached meshes, its edges against equation 2.7 one by one, and a surface without T-junctions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.restricted import (
    SIDES,
    Leaf,
    PlainQuadtree,
    areas,
    assert_whole,
    edge_counts,
    some_cameras,
    unculled,
)
from lod.scene import SPACING, Scene, noise
from lod.triangles import read_triangles, with_area
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.seamless_patches import SeamlessPatches, Settings
from orogen.lod.seamless_patches.meshes import Bits, index_lists, resolutions, strip, trile

SHAPES = [(300, 421), (2, 3), (500, 2)]
"""Rows and columns."""
SETTINGS: list[dict[str, Any]] = [
    {"pixels_per_quad": 9.0, "resolution": 8, "quads_per_sample": 8},
    {"quads_per_sample": 1, "pixels_per_quad": 1.0, "resolution": 32},
]


@pytest.fixture(scope="module", params=SHAPES, ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    # coarser data from half a node on: heights blend, too
    with closing(Scene(gpu, noise(*request.param), view_distance=0.5)) as terrain:
        yield terrain


def turned(corners: NDArray[np.int64], turn: int, most: int) -> NDArray[np.int64]:
    """By quarters clockwise, rows going down."""
    for _ in range(turn):
        corners = np.stack([most - corners[..., 1], corners[..., 0]], axis=-1)
    return corners


def patch(north: int, east: int, south: int, west: int, most: int) -> NDArray[np.int64]:
    """(n, 3, 2) corners of a whole patch, in units."""
    sides = [north, east, south, west]
    parts = []
    for turn, side in enumerate(sides):
        for triangles in (trile(side, most), strip(side, sides[turn - 1], most)):
            parts.append(turned(np.array(triangles, np.int64).reshape(-1, 3, 2), turn, most))
    return np.concatenate(parts)


def combinations(most: int) -> list[tuple[int, ...]]:
    every = list(itertools.product(resolutions(most), repeat=4))
    return every if len(every) < 100 else [every[k] for k in np.random.default_rng(2).integers(0, len(every), 25)]


@pytest.mark.parametrize("most", [8, 16, 64])
def test_a_patch_of_any_resolutions_is_whole(most: int) -> None:
    for sides in combinations(most):
        corners = patch(*sides, most=most)
        assert (areas(corners) > 0).all()
        assert areas(corners).sum() == most**2
        expected = set()
        for turn, segments in enumerate(sides):
            at = np.arange(segments + 1) * (most // segments)
            points = turned(np.stack([at, np.zeros_like(at)], axis=-1), turn, most).tolist()
            expected |= {tuple(sorted((tuple(a), tuple(b)))) for a, b in itertools.pairwise(points)}
        counts = edge_counts(corners)
        assert {edge for edge, count in counts.items() if count == 1} == expected
        assert set(counts.values()) == {1, 2}
        # vertices lie on the grid of the finest side: a texel of the fitting level
        assert (corners % (most // max(sides)) == 0).all()


def test_no_triangle_turns_over_where_a_patch_collapses_onto_the_datas_border() -> None:
    random = np.random.default_rng(3)
    for sides in combinations(16):
        corners = patch(*sides, most=16)
        for limit in random.integers(0, 17, (6, 2)):
            collapsed = np.minimum(corners, limit)
            assert (areas(collapsed) >= 0).all()
            assert areas(collapsed).sum() == np.prod(limit)


def test_index_lists_are_the_meshes() -> None:
    most = 16
    lists = index_lists(most)
    known = resolutions(most)
    meshes = [trile(r, most) for r in known] + [strip(a, b, most) for a in known for b in known]
    assert len(lists) == len(meshes)
    for number, (triangles, mesh) in enumerate(zip(lists, meshes, strict=True)):
        assert (triangles >> Bits.MESH == number).all()
        at = np.stack([triangles & 127, triangles >> Bits.ROW & 127], axis=-1)
        assert at.tolist() == [[list(v) for v in corners] for corners in mesh]
        corners = triangles >> Bits.CORNER & 3
        assert (corners == (0 if number < len(known) else [1, 2, 3])).all()
    assert [len(triangles) for triangles in lists[: len(known)]] == [0, 2, 18, 98]


def test_wireframe_lines_of_triles_lie_on_the_edges_of_the_triangles() -> None:
    """The twin of lines_at: one function is whole along every edge, none is across a triangle."""
    for resolution in (4, 8, 32):
        x, y = np.moveaxis(np.array(trile(resolution, resolution), float), -1, 0)
        lines = np.stack([x, y, (x + y + 1) / 2, (x - y + 1) / 2], axis=-1)
        for a, b in ((0, 1), (1, 2), (2, 0)):
            assert ((lines[:, a] == lines[:, b]) & (lines[:, a] % 1 == 0)).any(axis=-1).all()
        assert (np.ceil(lines.max(axis=1)) - np.floor(lines.min(axis=1)) <= 1).all()


class PlainEdges:
    """Equation 2.7, edge by edge."""

    def __init__(self, scene: Scene, frame: Frame, settings: Settings) -> None:
        self.settings = settings
        self.tree = PlainQuadtree(scene, frame, settings.resolution / settings.quads_per_sample)
        pixels = frame.size[1] / 2 / math.tan(math.radians(frame.lod.fov) / 2)
        self.precision = max(pixels / settings.pixels_per_quad / settings.resolution, 1.0)

    def epsilon(self, leaf: Leaf, side: int) -> float:
        level, x, y = leaf
        width = self.tree.side * 2**level
        a, b = [((0, 0), (1, 0)), ((1, 0), (1, 1)), ((0, 1), (1, 1)), ((0, 0), (0, 1))][side]
        ends = np.array([[x + a[0], y + a[1]], [x + b[0], y + b[1]]]) * width
        other = level, x + SIDES[side][0], y + SIDES[side][1]
        beside = [self.tree.heights(one) for one in (leaf, other) if self.tree.exists(one)]
        heights = min(low for low, _ in beside), max(high for _, high in beside)
        distance = self.tree.distance(*ends, heights)
        found = self.precision * width * SPACING / max(distance, 1e-9)
        # too close to call
        assert min(abs(found * 2**k - 1) for k in range(8)) > 1e-9
        return found

    def leaves(self) -> set[Leaf]:
        return self.tree.leaves(lambda leaf: any(self.epsilon(leaf, side) > 1 for side in range(4)))

    def own_segments(self, leaf: Leaf, side: int) -> int:
        asked = self.epsilon(leaf, side) * self.settings.resolution
        return next(n for n in (4, 8, 16, 32, 64) if n >= min(asked, self.settings.resolution))

    def segments(self, leaves: set[Leaf], leaf: Leaf) -> list[int]:
        found = [self.own_segments(leaf, side) for side in range(4)]
        for side, larger, steps in self.tree.larger(leaves, leaf):
            assert steps == 1
            found[side] = self.own_segments(larger, (side + 2) % 4) // 2
        return found


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_patches_and_their_sides_are_those_of_the_equation(scene: Scene, settings: dict[str, Any]) -> None:
    algorithm = SeamlessPatches(scene.clipmap, make_settings("seamless_patches", settings))
    shared = 0
    for k, camera in enumerate(some_cameras(scene, 3, seed=8)):
        frozen = {"lod_camera": camera.moved(z=camera.z + 150, x=camera.x + 40)} if k == 2 else {}
        frame = unculled(scene.frame(camera, (160, 100), exaggeration=1.0 + (k == 1), **frozen))
        plain = PlainEdges(scene, frame, algorithm.settings)
        expected = plain.leaves()
        edges = algorithm.edges(frame, scene.view)
        leaves = edges.leaves(restricted=True)
        found = list(zip(*(part.tolist() for part in leaves), strict=True))
        assert len(found) == len(set(found))
        assert set(found) == expected
        segments = edges.resolutions(leaves).tolist()
        random = np.random.default_rng(k)
        for i in random.choice(len(found), min(60, len(found)), replace=False):
            assert segments[i] == plain.segments(expected, found[i])
            shared += len(plain.tree.larger(expected, found[i]))
    assert shared or scene.pyramid.grid.width < 10


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_edges_match_bit_for_bit(scene: Scene, settings: dict[str, Any]) -> None:
    state = scene.algorithm("seamless_patches", settings)
    most = 0
    for camera in some_cameras(scene, 3, seed=9):
        frame = unculled(scene.frame(camera, (96, 64)))
        draws = read_triangles(scene, frame, state)
        statistics = state.statistics()
        assert statistics.triangles == sum(draw.shape[0] * draw.shape[1] for draw in draws)
        assert statistics.draws == len(draws)
        assert statistics.patches == len(
            {(int(i), int(t)) for draw in draws for i, t in draw[["id", "tile_level"]][:, 0, 0].tolist()}
        )
        assert_whole(with_area(draws), frame)
        most = max(most, len(draws))
    # triles and strips of several resolutions
    assert most >= 5 or scene.pyramid.grid.width < 10


def test_edges_match_where_the_equation_alone_does_not_see_to_it(gpu: Gpu) -> None:
    """Texels are long and sheared, so that the sides of a patch differ much in length; rho is least."""
    with closing(Scene(gpu, noise(150, 170), metres=np.array([[10.0, 2.0], [1.0, -2.5]]))) as scene:
        state = scene.algorithm("seamless_patches", {"pixels_per_quad": 20.0, "quads_per_sample": 4})
        for camera in some_cameras(scene, 4, seed=10):
            frame = unculled(scene.frame(camera, (96, 64)))
            assert_whole(with_area(read_triangles(scene, frame, state)), frame)


def test_segments_are_no_longer_on_screen_than_was_asked_for(gpu: Gpu) -> None:
    """Of patches that are not the finest; inside a patch, which may be nearer than its sides, a little longer."""
    with closing(Scene(gpu, noise(300, 421, 5.0))) as scene:
        settings = {"pixels_per_quad": 5.0, "resolution": 8, "quads_per_sample": 8}
        algorithm = SeamlessPatches(scene.clipmap, make_settings("seamless_patches", settings))
        for z in (60.0, 300.0, 1500.0):
            frame = scene.frame(scene.camera(200, 150, z, pitch=-50), (200, 150))
            # the least precision has no say
            precision = frame.pixels_per_radian() / 5.0 / 8
            assert precision > 1
            draws = read_triangles(scene, frame, algorithm.view())
            longest = 0.0
            for draw in draws:
                p = draw["position"].astype(np.float64)[draw["tile_level"][:, 0, 0] > 0]
                side = p - np.roll(p, 1, axis=2)
                straight = (np.abs(side[..., :2]) < 1e-3).any(axis=-1)
                nearest = np.linalg.norm(p, axis=-1).min(axis=2)[..., None]
                seen = np.linalg.norm(side[..., :2], axis=-1) / nearest * frame.pixels_per_radian()
                longest = max(longest, float(np.where(straight, seen, 0).max(initial=0)))
            # a patch's middle is nearer than its sides by 1 / 2 rho at most
            assert 0 < longest <= 5.0 / (1 - 0.5 / precision)


def test_finer_settings_draw_more(scene: Scene) -> None:
    frame = scene.frame(scene.camera(100, 100, 600, pitch=-40), (160, 100))
    triangles = []
    for pixels in (16.0, 8.0, 4.0, 2.0):
        state = scene.algorithm("seamless_patches", {"pixels_per_quad": pixels, "resolution": 8, "quads_per_sample": 8})
        scene.draw(frame, state)
        triangles.append(state.statistics().triangles)
    if scene.pyramid.grid.width > 10:
        assert triangles[0] <= triangles[1] < triangles[2] < triangles[3]


def test_the_list_of_pieces_grows(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(300, 421))) as scene:
        frame = scene.frame(scene.camera(200, 150, 130, pitch=-20), (160, 100))
        settings = {"pixels_per_quad": 1.0}
        used = scene.algorithm("seamless_patches", settings)
        # first a picture that fits
        scene.draw(scene.frame(scene.camera(200, 150, 20000, pitch=-90), (160, 100)), used)
        drawn = scene.draw(frame, used)
        assert used.statistics().patches > 500
        fresh = scene.draw(frame, scene.algorithm("seamless_patches", settings))
        for name in drawn:
            np.testing.assert_array_equal(drawn[name], fresh[name])


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("seamless_patches")
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().patches == 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"pixels_per_quad": "nan"}, "pixels_per_quad: expected a number above 0, got nan"),
        ({"resolution": "12"}, "resolution: expected a power of two from 8 to 64, got 12"),
        ({"resolution": "128"}, "resolution: expected a power of two from 8 to 64, got 128"),
        ({"quads_per_sample": "3"}, r"quads_per_sample: expected a power of two from 1 to resolution \(16\), got 3"),
        ({"quads_per_sample": "16", "resolution": "8"}, r"quads_per_sample: .* resolution \(8\), got 16"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("seamless_patches", settings)
