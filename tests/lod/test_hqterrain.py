"""hqterrain: nested vertices sent once, meshes within their errors, tiles and seams that make one closed surface."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.patches import torn_edges
from lod.restricted import some_cameras, unculled
from lod.scene import SPACING, Scene, noise
from lod.triangles import arguments, read_triangles, with_area
from oracle.landscapes import hills
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.contract import Patches
from orogen.lod.hqterrain import CLUSTER, HqTerrain, Settings, View
from orogen.lod.hqterrain.choose import strip
from orogen.lod.hqterrain.tiles import FINEST, VERTEX, Shape, Tile, TileKey, continued
from orogen.lod.mesh import Mesh

Floats = NDArray[np.float64]


@pytest.fixture(scope="module", params=[(300, 421), (2, 3), (500, 2)], ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    rows, columns = request.param
    ground = noise(rows, columns) + hills(600, 700.0).astype(np.float32)[:rows, :columns]
    with closing(Scene(gpu, ground)) as terrain:
        terrain.heights = ground  # type: ignore[attr-defined]
        yield terrain


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hills(400, 900.0).astype(np.float32)[:300])) as terrain:
        yield terrain


@pytest.fixture
def algorithm_of() -> Iterator[Any]:
    made: list[HqTerrain] = []

    def make(scene: Scene, **settings: Any) -> HqTerrain:
        made.append(HqTerrain(scene.clipmap, make_settings("hqterrain", settings)))
        return made[-1]

    yield make
    for algorithm in made:
        algorithm.store.close()


def settled(algorithm: HqTerrain, frame: Frame, state: View) -> None:
    state.wants(frame)
    algorithm.store.settle()


def tiles_of(algorithm: HqTerrain) -> Iterator[Tile]:
    """The first, the last and some tile of every level."""
    for level in range(algorithm.maker.tree.level_count):
        rows, cols = algorithm.maker.tree.shape(level)
        for key in {(0, 0), (cols - 1, rows - 1), (cols // 3, rows // 2)}:
            algorithm.maker(TileKey(level, *key))
            yield algorithm.maker.tiles[TileKey(level, *key)]


def places(tile: Tile) -> NDArray[np.int64]:
    packed = tile.vertices["place"].astype(np.int64)
    return np.stack([packed & 0xFF, packed >> 8 & 0xFF], axis=1)


def test_vertices_are_samples_and_those_beyond_the_raster_lie_on_its_edge(scene: Scene, algorithm_of: Any) -> None:
    surface = TrueSurface(scene.heights)  # type: ignore[attr-defined]
    for tile in tiles_of(algorithm_of(scene, tile_size=16)):
        at = (np.array([tile.key.x, tile.key.y]) + places(tile) / 16) * 2.0**tile.key.level
        tx, ty = surface.clamp(*(at.T + 0.5))
        np.testing.assert_allclose(tile.vertices["height"], surface.height(tx, ty), rtol=1e-6, atol=1e-4)
        assert (tile.vertices["morphed"] >= tile.vertices["height"].min()).all()
        assert (tile.vertices["morphed"] <= tile.vertices["height"].max()).all()


def test_meshes_are_nested_whole_and_as_exact_as_their_level_of_detail(hilly: Scene, algorithm_of: Any) -> None:
    for tile in tiles_of(algorithm_of(hilly, tile_size=16)):
        at, heights = places(tile), tile.vertices["height"].astype(np.float64)
        if ((np.array(tile.key[1:]) + 1) << tile.key.level > [399, 299]).any():
            continue
        grid = np.empty((17, 17))
        grid[at[:, 1], at[:, 0]] = heights
        before = 0
        for detail in range(8, -4, -2):
            mesh = tile.triangles(Shape(detail, 0))
            used = np.unique(mesh)
            # all that a mesh needs is among the vertices that have been sent for it: those of coarser ones, and more
            assert used.max() < tile.counts[detail - FINEST]
            assert tile.counts[detail - FINEST] >= before
            before = tile.counts[detail - FINEST]
            a, b, c = at[mesh].swapaxes(0, 1)
            area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
            assert np.abs(area).sum() == 2 * 16**2
            assert abs(area.sum()) == 2 * 16**2
            assert errors(grid, at[mesh], heights[mesh]).max() <= 2.0**detail * (1 + 1e-6) + 1e-4


def errors(grid: Floats, corners: NDArray[np.int64], heights: Floats) -> Floats:
    """How far the vertices of a grid are off the triangles that they lie in."""
    y, x = np.mgrid[: grid.shape[0], : grid.shape[1]]
    off = np.full(grid.shape, np.nan)
    for (a, b, c), z in zip(corners.astype(np.float64), heights, strict=True):
        shares = np.linalg.solve(np.stack([a - c, b - c], axis=1), np.stack([x - c[0], y - c[1]]).reshape(2, -1))
        shares = np.vstack([shares, 1 - shares.sum(axis=0)])
        inside = (shares >= -1e-9).all(axis=0).reshape(grid.shape)
        off[inside] = np.abs(grid - (z @ shares).reshape(grid.shape))[inside]
    assert np.isfinite(off).all()
    return off


def test_a_fully_morphed_vertex_lies_on_the_mesh_without_it(hilly: Scene, algorithm_of: Any) -> None:
    algorithm = algorithm_of(hilly, tile_size=16)
    for tile in tiles_of(algorithm):
        if ((np.array(tile.key[1:]) + 1) << tile.key.level > [399, 299]).any():
            continue
        at, levels = places(tile), (tile.vertices["place"] >> 16).astype(int) + FINEST
        z = tile.vertices["height"].astype(np.float64)
        for level in np.unique(levels[(levels > FINEST) & (levels < 31)]).tolist():
            grid = np.empty((17, 17))
            grid[at[:, 1], at[:, 0]] = tile.vertices["morphed"]
            mesh = tile.triangles(Shape(level + 1, 0))
            off = errors(grid, at[mesh], z[mesh])
            there = levels == level
            assert off[at[there, 1], at[there, 0]].max() < 1e-3


def test_the_middle_of_a_side_is_there_where_smaller_tiles_meet_it(hilly: Scene, algorithm_of: Any) -> None:
    for tile in tiles_of(algorithm_of(hilly, tile_size=16)):
        for side in range(4):
            shape = Shape(31, 1 << side)
            _, along = tile.border(side, shape)
            assert len(along) == 3
            assert np.ptp(np.diff(along)) == 0
            assert all(len(tile.border(other, shape)[1]) == 2 for other in range(4) if other != side)
            assert tile.triangles(shape).max() < tile.counts[31 - FINEST] == 9


def test_vertices_are_sent_once_as_they_are_needed(hilly: Scene, algorithm_of: Any, gpu: Gpu) -> None:
    algorithm = algorithm_of(hilly, tile_size=32)
    key = TileKey(algorithm.maker.tree.level_count - 2, 0, 0)
    algorithm.store.want([key])
    algorithm.store.settle()
    tile = algorithm.maker.tiles[key]
    details = [7, 5, 4, 5, 7, 4, 2]
    sent = []
    for detail in details:
        before = algorithm.bytes_sent
        first, count = algorithm.send(tile, Shape(detail, 0))
        sent.append(algorithm.bytes_sent - before)
        page = algorithm.store.resident[key] * algorithm.store.page_bytes
        data = gpu.read_buffer(algorithm.store.buffer).result()
        vertices = data[page : page + VERTEX.itemsize * tile.counts[detail - FINEST]].view(VERTEX)
        np.testing.assert_array_equal(vertices, tile.vertices[: vertices.size])
        numbers = data[4 * first : 4 * first + 6 * count].view(np.uint16).reshape(-1, 3)
        np.testing.assert_array_equal(numbers, tile.triangles(Shape(detail, 0)))
    # what is there already is not sent again
    assert sent[3:6] == [0, 0, 0]
    new = np.diff([9, *(tile.counts[detail - FINEST] for detail in (7, 5, 4, 2))])
    lists = [6 * len(tile.triangles(Shape(detail, 0))) for detail in (7, 5, 4, 2)]
    assert [sent[0], sent[1], sent[2], sent[6]] == (12 * new + lists).tolist()
    assert sent[6] > 0


def test_lists_start_over_where_their_room_is_used_up(hilly: Scene, algorithm_of: Any, gpu: Gpu) -> None:
    algorithm = algorithm_of(hilly, tile_size=16)
    key = TileKey(algorithm.maker.tree.level_count - 2, 0, 0)
    algorithm.store.want([key])
    algorithm.store.settle()
    tile = algorithm.maker.tiles[key]
    for halved in range(16):
        for detail in (0, 1, 2, 3, 4):
            first, count = algorithm.send(tile, Shape(detail, halved))
            data = gpu.read_buffer(algorithm.store.buffer).result()
            numbers = data[4 * first : 4 * first + 6 * count].view(np.uint16).reshape(-1, 3)
            np.testing.assert_array_equal(numbers, tile.triangles(Shape(detail, halved)))
            start = algorithm.store.resident[key] * algorithm.store.page_bytes
            assert 4 * first + 6 * count <= start + algorithm.store.page_bytes


def drawn(scene: Scene, frame: Frame, state: View) -> list[NDArray[Any]]:
    """Corners of the tiles' triangles, and of those between; made for the reader as draws of a list of vertices."""
    draws = scene.record(frame, state)
    index = Mesh(scene.gpu, [np.arange(3 * CLUSTER).reshape(-1, 3)], "test")
    found = []
    for draw in draws:
        assert isinstance(draw, Patches)
        vertices, instances = arguments(scene.gpu, draw)[:2]
        words = np.array([vertices, instances, 0, 0, 0], np.uint32)
        made = scene.gpu.buffer("arguments", words, "STORAGE|COPY_SRC", "test")
        listed = replace(draw, index=index, indirect=made, offset=0)

        class Recorded:
            def record(self, *_: Any, draws: tuple[Patches, ...] = (listed,)) -> list[Patches]:
                return list(draws)

        if instances:
            found += read_triangles(scene, frame, Recorded())  # type: ignore[arg-type]
    return found


@pytest.mark.parametrize(
    "settings",
    [{"tile_size": 16, "tau": 4.0}, {"tile_size": 32, "pixels_per_quad": 8.0, "tau": 1.0}],
    ids=str,
)
def test_tiles_and_seams_are_one_closed_surface(scene: Scene, settings: dict[str, Any], algorithm_of: Any) -> None:
    algorithm = algorithm_of(scene, **settings)
    state = algorithm.view()
    rows, columns = scene.heights.shape  # type: ignore[attr-defined]
    levels: set[int] = set()
    for camera in some_cameras(scene, 3, seed=4):
        frame = unculled(scene.frame(camera, (160, 100)))
        settled(algorithm, frame, state)
        corners = drawn(scene, frame, state)
        levels |= set(np.unique(corners[0]["tile_level"]).tolist())
        triangles = with_area(corners)
        x, y = triangles[..., 0], triangles[..., 1]
        assert len(torn_edges(triangles, (x.min(), y.min(), x.max(), y.max()))) == 0
        # and it lies over all of the raster, without seams having any extent
        a, b, c = with_area(corners[:1])[..., :2].astype(np.float64).swapaxes(0, 1)
        (px, py), (qx, qy) = (b - a).T, (c - a).T
        assert np.abs(px * qy - py * qx).sum() / 2 == pytest.approx((rows - 1) * (columns - 1) * SPACING**2, rel=1e-3)
    assert len(levels) > 1 or min(rows, columns) < 3


def test_strips_close_what_is_between_two_lines() -> None:
    random = np.random.default_rng(0)
    for _ in range(20):
        a, b = (np.unique(np.append(random.integers(0, 64, 9), [0, 64])) for _ in range(2))
        found = strip((np.arange(a.size), a), (100 + np.arange(b.size), b))
        assert len(found) == a.size + b.size - 2
        edges, count = np.unique(
            np.sort(found[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_counts=True
        )
        once = {tuple(edge) for edge in edges[count == 1].tolist()}
        lines = {(i, i + 1) for i in range(a.size - 1)} | {(100 + i, 101 + i) for i in range(b.size - 1)}
        ends = {(0, 100), (a.size - 1, 99 + b.size)}
        assert once == lines | ends
        assert count.max() == 2


def test_ground_goes_on_beyond_the_raster_as_it_was() -> None:
    columns = np.arange(9)
    plane = 3.0 + 2.0 * np.arange(5)[:, None] - 1.5 * np.minimum(columns, 5.25)
    np.testing.assert_allclose(continued(plane, 5.25), 3.0 + 2.0 * np.arange(5)[:, None] - 1.5 * columns)
    np.testing.assert_array_equal(continued(plane, 8.0), plane)
    wave = np.sin(np.minimum(columns, 6.0))[None]
    np.testing.assert_allclose(continued(wave, 6.0)[0, 7:], 2 * np.sin(6.0) - np.sin([5.0, 4.0]))
    # little ground to go by
    np.testing.assert_allclose(continued(plane, 1.0)[:, 0], plane[:, 0])


def largest_change(scene: Scene, algorithm: HqTerrain, morph: bool) -> float:
    """Of any point of the drawn surface from one frame to the next as a camera comes down, in errors of tau."""
    above = scene.camera(200, 150, 3000, pitch=-90, orthographic=1000.0)
    state = algorithm.view()
    changes, patches, before = [], [], None
    for k in range(45):
        lod = scene.camera(200, 150, 3000 * 0.985**k, pitch=-90)
        frame = unculled(scene.frame(above, (40, 40), lod_camera=lod))
        settled(algorithm, frame, state)
        if not morph:
            for tile in algorithm.maker.tiles.values():
                tile.vertices["morphed"] = tile.vertices["height"]
        heights = frame.positions(scene.draw(frame, state)["depth"])[..., 2]
        if before is not None:
            changes.append(np.abs(heights - before).max() / (8.0 * lod.z / frame.pixels_per_radian(lod)))
        before = heights
        patches.append(state.statistics().triangles)
    assert len(set(patches)) > 2
    return max(changes)


def test_vertices_morph_in_before_they_count(hilly: Scene, algorithm_of: Any) -> None:
    # a single tile: what is exchanged for other tiles may jump a little
    options = {"tile_size": 64, "tau": 8.0, "pixels_per_quad": 1000.0}
    flowing = largest_change(hilly, algorithm_of(hilly, **options), morph=True)
    jumping = largest_change(hilly, algorithm_of(hilly, **options), morph=False)
    assert flowing < 0.3 * jumping


def test_what_is_not_there_yet_is_drawn_coarser(hilly: Scene, algorithm_of: Any) -> None:
    algorithm = algorithm_of(hilly, tile_size=16)
    state = algorithm.view()
    frame = hilly.frame(hilly.camera(200, 200, 1300, pitch=-50))
    assert (hilly.draw(frame, state)["depth"] == 0).all()
    assert state.statistics().patches == 0
    state.wants(frame)
    wanted = sorted(algorithm.store.wanted, reverse=True)
    covered, patches = [], []
    for count in (1, 3, len(wanted) // 2, len(wanted)):
        algorithm.store.want(wanted[:count], state)
        algorithm.store.settle()
        covered.append((hilly.draw(frame, state)["depth"] > 0).sum())
        patches.append(state.statistics().patches)
    assert patches[0] == 1
    assert patches[0] <= patches[1] < patches[-1]
    assert min(covered) > 0.98 * max(covered)


def test_tiles_that_have_gone_are_forgotten_and_come_back(gpu: Gpu, algorithm_of: Any) -> None:
    with closing(Scene(gpu, noise(900, 900))) as scene:
        algorithm = algorithm_of(scene, tile_size=64, pixels_per_quad=1.0, memory=20 << 20)
        state = algorithm.view()
        pictures = []
        for column in (200, 700, 200):
            frame = scene.frame(scene.camera(column, 500, 700, pitch=-50), (160, 100))
            settled(algorithm, frame, state)
            pictures.append(scene.draw(frame, state)["depth"])
            assert len(algorithm.maker.tiles) <= algorithm.store.capacity + 1
        np.testing.assert_array_equal(pictures[0], pictures[2])


def test_a_smaller_tau_takes_more_triangles(hilly: Scene, algorithm_of: Any) -> None:
    frame = hilly.frame(hilly.camera(200, 290, 1100, pitch=-30), (160, 100))
    triangles = []
    for tau in (8.0, 4.0, 2.0, 1.0):
        algorithm = algorithm_of(hilly, tau=tau)
        state = algorithm.view()
        settled(algorithm, frame, state)
        hilly.draw(frame, state)
        triangles.append(state.statistics().triangles)
    assert triangles == sorted(triangles)
    assert triangles[-1] > 3 * triangles[0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tau": "0"}, "tau: expected a number of pixels above 0, got 0"),
        ({"pixels_per_quad": "nan"}, "pixels_per_quad: expected a number above 0, got nan"),
        ({"tile_size": "24"}, "tile_size: expected 16, 32 or 64 quads, got 24"),
        ({"memory": "5"}, "memory: expected at least 1048576 bytes"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("hqterrain", settings)


def test_settings_are_read_from_text() -> None:
    assert make_settings("hqterrain", {"tau": "2", "tile_size": "32"}) == Settings(2.0, tile_size=32)
