"""lorenz_doellner: its patterns, its decisions against a twin, watertight edges, and meshes that know no history."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.lists import Drawn, read
from lod.patches import torn_edges
from lod.restricted import some_cameras, unculled
from lod.scene import Scene, noise
from oracle.landscapes import hills
from orogen.compare.cracks import find_cracks
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import Grid
from orogen.lod import make_settings
from orogen.lod.lorenz_doellner import View, cell_bits
from orogen.lod.lorenz_doellner.patterns import pattern_pool

NAME = "lorenz_doellner"
ROUGH = {"pixels": 12.0}


def unpacked(words: NDArray[np.uint32]) -> NDArray[np.int64]:
    """(n, 3, 2) shares of a and b."""
    return np.stack([words & 255, words >> 8 & 255], axis=-1).astype(np.int64)


def pattern(depth: int, edges: tuple[int, ...]) -> NDArray[np.int64]:
    """(n, 3, 2) shares of a and b of a pattern's corners."""
    table, words = pattern_pool(depth)
    first, count = table[int(np.ravel_multi_index(edges, (depth + 1,) * 3))]
    return unpacked(words[first : first + count])


def doubled_areas(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    (px, py), (qx, qy) = (triangles[:, 1] - triangles[:, 0]).T, (triangles[:, 2] - triangles[:, 0]).T
    return px * qy - py * qx


SOME = [*product(range(4), repeat=3), (6, 0, 0), (0, 6, 0), (0, 0, 6), (6, 5, 0), (2, 6, 4), (6, 6, 6), (5, 6, 6)]


@pytest.mark.parametrize("depth", [3, 6])
def test_patterns_fill_a_triangle_and_end_where_their_edges_say(depth: int) -> None:
    one = 1 << depth
    for edges in SOME:
        if max(edges) > depth:
            continue
        triangles = pattern(depth, edges)
        areas = doubled_areas(triangles)
        assert (areas > 0).all()
        assert areas.sum() == one * one
        assert len(triangles) <= 4 ** max(edges)
        # within, each edge is passed once in either direction; what is passed once is the outline
        passed: dict[tuple[int, ...], int] = {}
        for triangle in triangles.tolist():
            for k in range(3):
                way = (*triangle[k], *triangle[(k + 1) % 3])
                passed[way] = passed.get(way, 0) + 1
        assert set(passed.values()) == {1}
        outline = np.array([way for way in passed if (*way[2:], *way[:2]) not in passed])
        shares = np.stack([outline[:, ::2], outline[:, 1::2], one - outline[:, ::2] - outline[:, 1::2]], axis=-1)
        assert len(outline) == sum(1 << d for d in edges)
        for opposite, d in enumerate(edges):
            on = shares[(shares[..., opposite] == 0).all(axis=1)]
            assert len(on) == 1 << d
            assert (np.abs(np.diff(on, axis=1)).max(axis=(1, 2)) == one >> d).all()


def test_equal_edges_give_equal_triangles() -> None:
    for d in range(5):
        triangles = pattern(4, (d, d, d))
        assert len(triangles) == 4**d
        assert set(doubled_areas(triangles).tolist()) == {4 ** (4 - d)}
        # and all have their edges along the coarse ones
        steps = np.abs(triangles - np.roll(triangles, 1, axis=1)) // (16 >> d)
        assert {tuple(step) for step in steps.reshape(-1, 2).tolist()} == {(1, 0), (0, 1), (1, 1)}


def smallest_angle(triangles: NDArray[np.int64]) -> float:
    """Degrees, over ground where a coarse triangle has its right angle at c."""
    angles = []
    for k in range(3):
        u, v = triangles[:, k - 2] - triangles[:, k], triangles[:, k - 1] - triangles[:, k]
        angles.append(np.arccos((u * v).sum(axis=1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)))
    return float(np.degrees(np.min(angles)))


def test_of_two_diagonals_the_less_oblique_is_taken() -> None:
    a, b, c = np.array([2, 0]), np.array([0, 2]), np.array([0, 0])
    for unsplit, (p, q, tip) in enumerate([(b, c, a), (c, a, b), (a, b, c)]):
        edges = tuple(int(k != unsplit) for k in range(3))
        m, n = (p + tip) // 2, (q + tip) // 2
        ways = [np.array([[p, q, n], [p, n, m]]), np.array([[p, q, m], [q, n, m]])]
        best = max(smallest_angle(np.concatenate([way, [[m, n, tip]]])) for way in ways)
        assert smallest_angle(pattern(1, edges)) == pytest.approx(best)


class Twin:
    """Pattern selection in float64 numpy, from the samples themselves; for square texels and nothing culled."""

    def __init__(self, scene: Scene, frame: Frame, heights: NDArray[np.float32], state: View) -> None:
        self.frame, self.heights = frame, heights.astype(np.float64)
        self.settings = state._algorithm.settings
        self.last = np.array(heights.shape[::-1]) - 1
        self.side = 1
        while max(self.last) > self.side * (self.settings.coarse or 32):
            self.side *= 2
        self.cells = -(-self.last // self.side)

    def vertex(self, place: NDArray[np.int64]) -> NDArray[np.int64]:
        """Column and row of a lattice vertex, which ends with the data."""
        return np.clip(place * self.side, 0, self.last)

    def at(self, texel: NDArray[np.floating]) -> NDArray[np.float64]:
        """Camera-relative metres of the surface at (column, row)."""
        i, j = np.minimum(np.floor(texel).astype(int), self.last - 1)
        u, v = texel - (i, j)
        h = self.heights
        height = (1 - v) * ((1 - u) * h[j, i] + u * h[j, i + 1]) + v * ((1 - u) * h[j + 1, i] + u * h[j + 1, i + 1])
        flat = self.frame.grid.metres @ (texel + 0.5 - self.frame.eye)
        return np.array([*flat, height * self.frame.exaggeration - self.frame.camera.z])

    def depth(self, first: NDArray[np.int64], along: tuple[int, int], *beside: tuple[int, int]) -> tuple[int, bool]:
        """How often an edge is halved, and whether that is beyond doubt."""
        start, end = self.vertex(first), self.vertex(first + along)
        a, middle, b = self.at(start), self.at((start + end) / 2), self.at(end)
        box = np.array([a, middle, b, *(self.at(self.vertex(first + step)) for step in beside)])
        eye = self.frame.lod_eye()
        away = float(np.linalg.norm(np.maximum(np.maximum(box.min(0) - eye, eye - box.max(0)), 0)))
        size = np.linalg.norm(middle - a) + np.linalg.norm(b - middle)
        parts = size * self.frame.pixels_per_radian(self.frame.lod) / max(away, 1e-9) / self.settings.pixels
        halvings = np.log2(max(parts, 1e-9))
        depth = int(np.clip(np.ceil(halvings), 0, self.settings.depth))
        sure = bool(abs(halvings - np.rint(halvings)) > 1e-3 or not -0.5 < halvings < self.settings.depth + 0.5)
        return depth, sure

    def triangles(self) -> dict[int, NDArray[np.int64] | None]:
        """By coarse triangle, (n, 3, 2) subtexels of its pattern; None where rounding may decide."""
        found: dict[int, NDArray[np.int64] | None] = {}
        for y, x in product(range(self.cells[1]), range(self.cells[0])):
            cell = np.array([x, y])
            diagonal = self.depth(cell, (1, 1), (1, 0), (0, 1))
            for lower in (0, 1):
                side = self.depth(cell + np.array([1 - lower, 0]), (0, 1), (-1, 0), (1, 1))
                level = self.depth(cell + np.array([0, lower]), (1, 0), (0, -1), (1, 1))
                number = 2 * (y * int(self.cells[0]) + x) + lower
                if not (side[1] and level[1] and diagonal[1]):
                    found[number] = None
                    continue
                low, high = self.vertex(cell), self.vertex(cell + 1)
                corners = np.array([low, high, [high[0], low[1]]] if lower == 0 else [high, low, [low[0], high[1]]])
                shares = pattern(self.settings.depth, (side[0], level[0], diagonal[0]))
                one = 1 << self.settings.depth
                weights = np.concatenate([shares, one - shares.sum(axis=-1, keepdims=True)], axis=-1)
                found[number] = weights @ (corners << self.frame.subtexel_bits) // one
        return found


def canonical(triangles: NDArray[np.int64]) -> set[tuple[tuple[int, int], ...]]:
    return {tuple(sorted(map(tuple, triangle))) for triangle in triangles.tolist()}


@pytest.fixture(scope="module")
def ground() -> NDArray[np.float32]:
    return hills(150, 500.0).astype(np.float32)[:120]


@pytest.fixture(scope="module")
def hilly(gpu: Gpu, ground: NDArray[np.float32]) -> Iterator[Scene]:
    with closing(Scene(gpu, ground)) as terrain:
        yield terrain


def subtexels(drawn: Drawn, frame: Frame) -> NDArray[np.int64]:
    return np.rint(drawn.texels * (1 << frame.subtexel_bits)).astype(np.int64)


@pytest.mark.parametrize(
    "settings", [{"pixels": 20.0}, {"pixels": 9.0, "coarse": 5, "depth": 4}, {"pixels": 20.0, "coarse": 9, "ratio": 2}]
)
def test_triangles_are_those_of_a_twin(hilly: Scene, ground: NDArray[np.float32], settings: dict[str, float]) -> None:
    state = hilly.algorithm(NAME, settings)
    assert isinstance(state, View)
    for camera in some_cameras(hilly, 2, seed=8):
        frame = unculled(hilly.frame(camera, (160, 100), exaggeration=1.5))
        drawn = read(hilly, frame, state)
        places, numbers = subtexels(drawn, frame), drawn.corners["id"][:, 0]
        expected = Twin(hilly, frame, ground, state).triangles()
        sure = 0
        for number, triangles in expected.items():
            if triangles is None:
                continue
            sure += 1
            ours = places[numbers == number]
            assert len(ours) == len(triangles)
            assert canonical(ours) == canonical(triangles)
        assert sure > 0.97 * len(expected)
        assert set(numbers.tolist()) == set(expected)


@pytest.mark.parametrize("shape", [(75, 101), (2, 3), (90, 2), (33, 33)], ids=str)
@pytest.mark.parametrize("settings", [{}, {"coarse": 3}, {"coarse": 50, "depth": 3}], ids=str)
def test_the_surface_is_whole_and_edges_match_bit_for_bit(
    gpu: Gpu, shape: tuple[int, int], settings: dict[str, int]
) -> None:
    with closing(Scene(gpu, noise(*shape), view_distance=0.3)) as scene:
        state = scene.algorithm(NAME, {**ROUGH, **settings})
        last = np.array(shape[::-1]) - 1.0
        for camera in some_cameras(scene, 2, seed=6):
            drawn = read(scene, unculled(scene.frame(camera, (160, 100))), state)
            positions = drawn.corners["position"]
            x, y = positions[..., 0], positions[..., 1]
            assert len(torn_edges(positions, (x.min(), y.min(), x.max(), y.max()))) == 0
            # nothing is folded over: areas add up
            a, b, c = drawn.texels.swapaxes(0, 1)
            (px, py), (qx, qy) = (b - a).T, (c - a).T
            assert np.abs(px * qy - py * qx).sum() / 2 == pytest.approx(np.prod(last), rel=1e-4)


def test_edges_match_on_a_sheared_grid(gpu: Gpu) -> None:
    metres = np.array([[10.0, 7.0], [1.0, -8.0]])
    with closing(Scene(gpu, noise(70, 90), metres=metres)) as scene:
        state = scene.algorithm(NAME, ROUGH)
        for camera in some_cameras(scene, 2, seed=2):
            drawn = read(scene, unculled(scene.frame(camera, (160, 100))), state)
            # corners are named by their exact place in the grid, of which the outline is a rectangle
            flat = np.concatenate([drawn.texels, drawn.corners["height"][..., None]], axis=2)
            assert len(torn_edges(flat, (0.0, 0.0, 89.0, 69.0))) == 0


def test_the_mesh_does_not_depend_on_what_was_drawn_before(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(60, 130, 600, pitch=-25), (160, 100))
    fresh = read(hilly, frame, hilly.algorithm(NAME, ROUGH))
    histories = {
        "near": [hilly.camera(70, 60, 520, pitch=-60)],
        "far, then near": [hilly.camera(60, 400, 3000, pitch=-30), hilly.camera(20, 20, 550, pitch=-20)],
        "the sky": [hilly.camera(60, 130, 600, pitch=80)],
    }
    for ratio in (2, 4096):
        state = hilly.algorithm(NAME, {**ROUGH, "ratio": ratio, "triangle_capacity": 1 << 16})
        for name, cameras in histories.items():
            for camera in cameras:
                hilly.record(hilly.frame(camera, (160, 100)), state)
            # one frame is enough: copies go on until all patterns are complete
            drawn = read(hilly, hilly.frame(frame.camera, (160, 100)), state)
            for field in ("position", "id", "level", "tile_level"):
                np.testing.assert_array_equal(drawn.corners[field], fresh.corners[field], err_msg=f"{name}, {ratio}")


@pytest.mark.parametrize("ratio", [2, 3, 4, 16, 4096])
def test_copies_are_as_many_as_the_ratio_asks_for(hilly: Scene, ratio: int) -> None:
    state = hilly.algorithm(NAME, {"ratio": ratio, "coarse": 4, "pixels": 6.0})
    assert isinstance(state, View)
    before = np.ones(2 * 2 * 3, np.int64)
    taken = []
    # from the coarse mesh to the finest; the same again; turned; coarser; finer; the sky, and back
    for z, heading, pitch in (
        (600, 0, -90), (600, 0, -90), (600, 7, -90), (9000, 0, -90), (5000, 0, -90), (600, 0, 80), (600, 0, -90),
    ):  # fmt: skip
        frame = hilly.frame(hilly.camera(60, 60, z, pitch=pitch, heading=heading), (160, 100))
        count = np.bincount(read(hilly, frame, state).corners["id"][:, 0], minlength=before.size)
        copies = 1
        while (before * ratio**copies < count).any():
            copies += 1
        taken.append(int(state.read_state()["updates"]))
        assert taken[-1] == copies
        before = count
    # cells of 64 samples, one of which is as fine as may be
    assert before.max() == 4096
    cold = next(n for n in range(1, 13) if ratio**n >= 4096)
    assert taken[0] == taken[-1] == cold
    assert taken[1] == taken[5] == 1


def test_triangles_out_of_sight_stay_as_they_are(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(60, 130, 600, pitch=-25), (160, 100))
    state = hilly.algorithm(NAME, ROUGH)
    seen, everything = read(hilly, frame, state), read(hilly, unculled(frame), state)
    ours, all_of_it = (np.bincount(drawn.corners["id"][:, 0]) for drawn in (seen, everything))
    assert ours.size == all_of_it.size == 2 * 15 * 19
    assert set(np.flatnonzero(ours != all_of_it)) <= set(np.flatnonzero(ours == 1))
    assert ours.sum() < 0.8 * all_of_it.sum()
    # nothing that is left out is to be seen
    for camera in some_cameras(hilly, 6, seed=17):
        frame = hilly.frame(camera, (96, 64), curvature=True)
        one, other = hilly.draw(frame, state), hilly.draw(unculled(frame), state)
        for name in ("depth", "id"):
            np.testing.assert_array_equal(one[name], other[name])


def test_without_room_all_is_coarser_but_whole_until_there_is(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(75, 60, 1500, pitch=-90, fov=30.0), (160, 100))
    roomy = hilly.algorithm(NAME)
    whole = hilly.draw(frame, roomy)
    asked = roomy.statistics().triangles
    tight, alone = (hilly.algorithm(NAME, {"triangle_capacity": 2000}) for _ in range(2))
    first = hilly.raster(frame, hilly.record(frame, tight))
    assert tight.statistics().triangles <= 2000 < asked
    assert (first["depth"] > 0).all()
    assert find_cracks(first["depth"], whole["depth"], frame, tolerance=4).count == 0
    assert tight.incomplete()
    grown = hilly.draw(frame, tight)
    assert tight.statistics() == roomy.statistics()
    # also where nobody asks
    for _ in range(20):
        by_itself = hilly.raster(frame, hilly.record(frame, alone))
    for name in whole:
        np.testing.assert_array_equal(grown[name], whole[name])
        np.testing.assert_array_equal(by_itself[name], whole[name])


def test_room_without_end_is_refused(hilly: Scene) -> None:
    with pytest.raises(BudgetError, match="raise pixels"):
        hilly.algorithm(NAME, {"triangle_capacity": 1 << 28})
    # parts without end are not asked for either: patterns end at 4096 triangles
    state = hilly.algorithm(NAME, {"pixels": 1e-6, "triangle_capacity": 2000})
    assert isinstance(state, View)
    hilly.record(unculled(hilly.frame(hilly.camera(60, 60, 700, pitch=-40))), state)
    assert state.read_state()["totals"][0] == 570 * 4096
    assert state.statistics().triangles == 570


def test_smaller_triangles_are_more(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(60, 200, 900, pitch=-35), (160, 100))
    triangles = []
    for pixels in (32.0, 16.0, 8.0):
        state = hilly.algorithm(NAME, {"pixels": pixels, "coarse": 8})
        hilly.draw(frame, state)
        triangles.append(state.statistics().triangles)
    ratio = np.divide(triangles[1:], triangles[:-1])
    assert ((ratio > 2.5) & (ratio < 5)).all()
    state = hilly.algorithm(NAME, {"coarse": 8, "depth": 0})
    hilly.draw(frame, state)
    # cells of 4 samples where 32 are allowed: without halvings only the coarse mesh is left
    assert state.statistics().triangles == 2 * 4 * 5


def test_nothing_is_drawn_before_the_first_data_or_of_a_single_sample(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        camera = scene.camera(30, 30, 300, pitch=-90)
        frame = scene.frame(camera, load=False)
        state = scene.algorithm(NAME)
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().triangles == 0
        assert (scene.draw(scene.frame(camera), state)["depth"] > 0).any()
    with closing(Scene(gpu, np.full((1, 1), 5.0))) as scene:
        frame = scene.frame(scene.camera(0.5, 0.5, 100, pitch=-90))
        assert (scene.draw(frame, scene.algorithm(NAME))["depth"] == 0).all()


def test_cells_are_powers_of_two_and_no_more_than_allowed() -> None:
    def bits(side: int, cells: int | None = None, depth: int = 6) -> int:
        return cell_bits(Grid(side, 1 + side // 2, (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)), cells, depth)

    assert bits(1025) == 5
    assert bits(220) == 3
    assert bits(220, 20) == 4
    assert bits(220, 512) == 0
    assert bits(1) == bits(2) == 0
    # half a sample as long as 512 cells allow it
    assert bits(16384) == 5
    assert bits(16384, depth=3) == 5
    assert bits(100_000) == 8


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels": "0"}, "pixels: expected a number above 0, got 0"),
        ({"pixels": "inf"}, "pixels: expected a number above 0, got inf"),
        ({"pixels": "nan"}, "pixels: expected a number above 0, got nan"),
        ({"ratio": "1"}, "ratio: expected 2 to 4096, got 1"),
        ({"ratio": "5000"}, "ratio: expected 2 to 4096, got 5000"),
        ({"coarse": "0"}, "coarse: expected 1 to 512 cells, got 0"),
        ({"coarse": "513"}, "coarse: expected 1 to 512 cells, got 513"),
        ({"depth": "7"}, "depth: expected 0 to 6 halvings, got 7"),
        ({"depth": "-1"}, "depth: expected 0 to 6 halvings, got -1"),
        ({"triangle_capacity": "10"}, "triangle_capacity: expected at least 64 triangles, got 10"),
        ({"rate": "4"}, "did you mean ratio"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings(NAME, settings)
