"""cdlod against a float64 twin of its selection and its morph, and what its triangles promise: no gaps, no pops."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
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
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.cdlod import Settings
from orogen.lod.cdlod.ground import Ground
from orogen.lod.cdlod.seams import thin
from orogen.lod.quadtree import Leaves, PatchTree

SHAPES = [(60, 90), (16, 2100), (2, 3), (60, 2)]
"""Rows and columns: levels of all kinds; more than 1024 samples, so that the ground is approximate; tiny."""
SETTINGS: list[dict[str, Any]] = [
    {},
    {"grid_size": 8, "quads_per_sample": 4, "pixels_per_quad": 6.0, "morph_range": 0.3},
    {"grid_size": 8, "quads_per_sample": 1, "pixels_per_quad": 8.0, "morph_range": 0.15},
]
Piece = tuple[int, int, int, bool]
"""Level, column, row; whether drawn with every second vertex."""


some_cameras = partial(restricted.some_cameras, lowest=40, spread=(0.5, 3.2), up=10)


class Twin:
    """Strugar's recursive selection and the morph of single vertices; positions in samples from the first one."""

    def __init__(self, scene: Scene, frame: Frame, settings: Settings) -> None:
        self.frame, self.settings = frame, settings
        self.size = np.array([frame.grid.width, frame.grid.height]) - 1
        self.leaf = 1.0 / settings.quads_per_sample
        self.side = settings.grid_size // settings.quads_per_sample
        self.top = 0
        while self.side << self.top < self.size.max():
            self.top += 1
        self.bits = 0
        while max(-(-frame.grid.width >> self.bits), -(-frame.grid.height >> self.bits)) > 1024:
            self.bits += 1
        shape = (-(-frame.grid.height >> self.bits), -(-frame.grid.width >> self.bits))
        texels = scene.pyramid.read(self.bits, slice(0, shape[0]), slice(0, shape[1])).astype(np.float64)
        # corners of cells between the texels, or the samples
        self.lattice = np.empty(np.array(shape) + (self.bits > 0))
        for i, j in np.ndindex(*self.lattice.shape):
            rows = [i] if not self.bits else [max(i - 1, 0), min(i, shape[0] - 1)]
            cols = [j] if not self.bits else [max(j - 1, 0), min(j, shape[1] - 1)]
            self.lattice[i, j] = texels[np.ix_(rows, cols)].mean()
        lod = frame.lod
        self.eye = np.array([float(v) for v in frame.grid.to_texel(lod.x, lod.y)]) - 0.5
        metres = frame.grid.metres
        quad = np.linalg.norm(metres, axis=0).max() * self.leaf
        flat = self.side * max(np.linalg.norm(metres @ [1, 1]), np.linalg.norm(metres @ [1, -1]))
        pixels = frame.size[1] / (2 * np.tan(np.radians(lod.fov) / 2))
        self.first = max(2 * quad * pixels / settings.pixels_per_quad, 1.01 * flat / (1 - 2 * settings.morph_range))

    def height(self, column: float, row: float) -> float:
        at = np.array([row, column]) / 2**self.bits
        (i, j), last = np.floor(at).astype(int), np.array(self.lattice.shape) - 1
        i, j = min(i, max(last[0] - 1, 0)), min(j, max(last[1] - 1, 0))
        v, u = at - [i, j]
        k, m = min(i + 1, last[0]), min(j + 1, last[1])
        h = self.lattice
        return (1 - v) * ((1 - u) * h[i, j] + u * h[i, m]) + v * ((1 - u) * h[k, j] + u * h[k, m])

    def corners(self, level: int, x: int, y: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        low = np.array([x, y]) * (self.side << level)
        return np.minimum(low, self.size), np.minimum(low + (self.side << level), self.size)

    def node_bounds(self, level: int, x: int, y: int) -> tuple[float, float]:
        (x0, y0), (x1, y1) = self.corners(level, x, y)
        step = 1 << self.bits
        # the corners of cells inside, and the node's own where it is less than a cell
        i0, i1, j0, j1 = -(-y0 // step), y1 // step, -(-x0 // step), x1 // step
        inside = self.lattice[i0 : i1 + 1, j0 : j1 + 1].ravel().tolist()
        rim = [self.height(c, r) for c in (x0, x1) for r in (y0, y1)]
        rim += [self.height(c, r) for c in range(j0 * step, x1 + 1, step) for r in (y0, y1)]
        rim += [self.height(c, r) for c in (x0, x1) for r in range(i0 * step, y1 + 1, step)]
        return min(inside + rim), max(inside + rim)

    def box_distance(self, level: int, x: int, y: int) -> float:
        low, high = self.corners(level, x, y)
        away = (np.clip(self.eye, low, high) - self.eye) * np.abs(np.diag(self.frame.grid.metres))
        bottom, top = (z * self.frame.exaggeration for z in self.node_bounds(level, x, y))
        z = self.frame.lod.z
        return float(np.sqrt((away**2).sum() + (np.clip(z, bottom, top) - z) ** 2))

    def select(self) -> tuple[set[Piece], set[Piece]]:
        """All pieces drawn, nothing culled; and those for which a decision was close."""
        chosen: set[Piece] = set()
        close: set[Piece] = set()

        def touches(level: int, x: int, y: int, by: int) -> tuple[bool, bool]:
            ratio = self.box_distance(level, x, y) / (self.first * 2.0**by)
            return ratio < 1, abs(ratio - 1) < 1e-4

        def visit(level: int, x: int, y: int, doubtful: bool) -> bool:
            """Whether the node is drawn by itself; if not its parent draws that quadrant."""
            if level < self.top:
                near, verge = touches(level, x, y, level)
                doubtful |= verge
                if not near:
                    (close if doubtful else chosen).add((level, x, y, True))
                    return False
            finer, verge = touches(level, x, y, level - 1) if level else (False, False)
            doubtful |= verge
            if not finer:
                (close if doubtful else chosen).add((level, x, y, False))
                return True
            for j in range(2):
                for i in range(2):
                    if (self.corners(level - 1, 2 * x + i, 2 * y + j)[0] < np.maximum(self.size, 1)).all():
                        visit(level - 1, 2 * x + i, 2 * y + j, doubtful)
            return True

        visit(self.top, 0, 0, False)
        return chosen, close

    def distance(self, at: NDArray[np.float64]) -> float:
        at = np.minimum(at, self.size)
        flat = self.frame.grid.metres @ (at - self.eye)
        return float(np.hypot(np.hypot(*flat), self.height(*at) * self.frame.exaggeration - self.frame.lod.z))

    def touched(self, at: NDArray[np.float64], pieces: Iterable[Piece]) -> set[int]:
        """Levels of the grids of all pieces that have a point in them or on their rim."""
        found = set()
        for level, x, y, thinned in pieces:
            low = np.array([x, y]) * float(self.side << level)
            if (at >= low).all() and (at <= low + (self.side << level)).all():
                found.add(level + thinned)
        return found

    def vertex(
        self, piece: Piece, grid: NDArray[np.int64], pieces: Iterable[Piece] = ()
    ) -> tuple[NDArray[np.float64], float]:
        """Where a vertex of a piece's grid is drawn beside the other `pieces`, and its morph."""
        level, x, y, thinned = piece
        quad = self.leaf * 2.0 ** (level + thinned)
        whole = np.array([x, y]) * float(self.side << level) + grid * quad
        if level + thinned == self.top:
            return np.minimum(whole, self.size), 0.0
        way = self.distance(whole) / (self.first * 2.0 ** (level + thinned))
        morph = float(np.clip(1 - (1 - way) / self.settings.morph_range, 0, 1))
        around = self.touched(whole, pieces)
        if level + thinned + 1 in around:
            morph = 1.0
        elif level + thinned - 1 in around:
            morph = 0.0
        return np.minimum(whole - (grid & 1) * quad * morph, self.size), morph


def pieces_of(draws: list[NDArray[Any]]) -> dict[Piece, NDArray[Any]]:
    """Corners (triangles, 3) of every piece that is drawn."""
    found: dict[Piece, NDArray[Any]] = {}
    for draw in draws:
        for corners in draw:
            level = int(corners["id"][0, 0]) >> 26
            rest = int(corners["id"][0, 0]) & (1 << 26) - 1
            thinned = int(corners["tile_level"][0, 0]) - level
            assert thinned in (0, 1)
            piece = (level, rest & 0x1FFF, rest >> 13, bool(thinned))
            assert piece not in found
            found[piece] = corners
    return found


@pytest.fixture(scope="module", params=SHAPES, ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    # coarser data not far away: heights blend, too
    with closing(Scene(gpu, noise(*request.param), view_distance=0.3)) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def spiky(gpu: Gpu) -> Iterator[Scene]:
    """Walls of up to forty times a sample's spacing, and a plain."""
    heights = noise(60, 80, relief=100.0, seed=4)
    heights[:, 35:] = 10.0
    heights[20:40, 45:50] = 400.0
    with closing(Scene(gpu, heights)) as terrain:
        yield terrain


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_nodes_and_vertices_are_those_of_the_twin(scene: Scene, settings: dict[str, Any]) -> None:
    state = scene.algorithm("cdlod", settings)
    for k, camera in enumerate(some_cameras(scene, 3, seed=len(str(settings)))):
        changes = [{}, {"exaggeration": 3.0}, {"lod_camera": camera.moved(z=camera.z + 150, heading=9.0)}][k]
        frame = as_unculled(scene.frame(camera, (96, 64), **changes))
        drawn = pieces_of(read_triangles(scene, frame, state))
        twin = Twin(scene, frame, make_settings("cdlod", settings))
        expected, close = twin.select()
        assert expected <= set(drawn)
        extra = {(level, x, y) for level, x, y, _ in set(drawn) - expected}
        assert len(extra) <= 4 * len(close)
        random = np.random.default_rng(k)
        pieces = sorted(expected)
        for i in random.choice(len(pieces), min(12, len(pieces)), replace=False):
            corners = drawn[pieces[i]].ravel()
            for corner in random.choice(corners, min(12, corners.size)):
                grid = corner["grid"].astype(int)
                at, _ = twin.vertex(pieces[i], grid, drawn)
                texel = (corner["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits - 0.5
                quad = twin.leaf * 2.0 ** corner["tile_level"]
                tolerance = 2e-5 * quad / twin.settings.morph_range + 1e-3
                np.testing.assert_allclose(texel, at, atol=tolerance)


def test_thinned_nodes_would_be_fully_morphed(scene: Scene) -> None:
    """So that every second vertex draws what all of them would (figure 2.31)."""
    settings = {"grid_size": 8, "quads_per_sample": 4, "pixels_per_quad": 8.0}
    state = scene.algorithm("cdlod", settings)
    seen = 0
    for camera in some_cameras(scene, 3, seed=21):
        frame = as_unculled(scene.frame(camera, (96, 64)))
        twin = Twin(scene, frame, make_settings("cdlod", settings))
        for piece in pieces_of(read_triangles(scene, frame, state)):
            level, x, y, thinned = piece
            if thinned:
                seen += 1
                for grid in np.ndindex(9, 9):
                    assert twin.vertex((level, x, y, False), np.array(grid))[1] > 0.9999
    assert seen or min(scene.pyramid.grid.shape) < 10


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
@pytest.mark.parametrize("exaggeration", [1.0, 4.0])
def test_edges_match_bit_for_bit(scene: Scene, settings: dict[str, Any], exaggeration: float) -> None:
    # where distances change by more than a morph between vertices, triangles fold, without a gap
    assert_watertight(scene, settings, exaggeration, fold=0.05)


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
@pytest.mark.parametrize("exaggeration", [1.0, 4.0])
def test_edges_match_over_walls(spiky: Scene, settings: dict[str, Any], exaggeration: float) -> None:
    levels = assert_watertight(spiky, settings, exaggeration, fold=0.05)
    assert len(levels) > 2


def test_nothing_is_folded_on_hills(gpu: Gpu) -> None:
    with closing(Scene(gpu, hills(90, 150.0).astype(np.float32))) as scene:
        assert len(assert_watertight(scene, SETTINGS[0], 1.0, fold=1e-4)) > 2


def assert_watertight(scene: Scene, settings: dict[str, Any], exaggeration: float, *, fold: float) -> set[int]:
    """Every edge inside the data belongs to two triangles, and flat areas add up but for a share `fold`.

    Gives the levels drawn.
    """
    state = scene.algorithm("cdlod", settings)
    width, height = scene.pyramid.grid.width - 1, scene.pyramid.grid.height - 1
    levels: set[int] = set()
    for camera in some_cameras(scene, 2, seed=3):
        frame = as_unculled(scene.frame(camera, (96, 64), exaggeration=exaggeration))
        draws = read_triangles(scene, frame, state)
        levels |= {level + thinned for level, _, _, thinned in pieces_of(draws)}
        triangles = with_area(draws)
        positions = np.concatenate([draw["position"].reshape(-1, 3) for draw in draws])
        (west, south), (east, north) = positions[:, :2].min(axis=0), positions[:, :2].max(axis=0)
        assert (east - west, north - south) == pytest.approx((width * SPACING, height * SPACING), rel=1e-5)
        assert len(torn_edges(triangles, (west, south, east, north))) == 0
        a, b, c = triangles[..., :2].astype(np.float64).swapaxes(0, 1)
        (px, py), (qx, qy) = (b - a).T, (c - a).T
        flat = np.abs(px * qy - py * qx).sum() / 2
        assert flat == pytest.approx(width * height * SPACING**2, rel=fold)
    return levels


@pytest.mark.parametrize("near", [True, False])
def test_grids_side_by_side_differ_by_one_level_at_most(near: bool) -> None:
    """A whole leaf keeps the coarser one beside it whole, and that the next one; thinned leaves do not."""
    level, x, y = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 1, 0], [2, 1, 0]]).T
    thinned, _ = thin(Leaves(level, x, y), np.array([near] * 4 + [False] * 2))
    assert thinned.tolist() == [not near] * 6


def test_no_gaps_on_sheared_ground(gpu: Gpu) -> None:
    metres = np.array([[10.0, 7.0], [1.0, -8.0]])
    with closing(Scene(gpu, noise(150, 130, relief=200.0), metres=metres)) as scene:
        state = scene.algorithm("cdlod", {"grid_size": 8, "quads_per_sample": 2, "pixels_per_quad": 8.0})
        for camera in some_cameras(scene, 3, seed=8):
            frame = as_unculled(scene.frame(camera, (96, 64)))
            torn = torn_edges(with_area(read_triangles(scene, frame, state)), (np.nan,) * 4)
            texel = torn[..., :2] @ np.linalg.inv(metres).T + frame.eye - 0.5
            last = np.array([129.0, 149.0])
            border = (np.abs(texel) < 1e-3) | (np.abs(texel - last) < 1e-3)
            assert border.all(axis=1).any(axis=1).all()


def test_detail_follows_the_distance_in_space(gpu: Gpu) -> None:
    """A plateau right below the camera is drawn finer than the plain far below it, as far aside."""
    heights = np.zeros((200, 200), np.float32)
    heights[:, 100:] = 2000.0
    with closing(Scene(gpu, heights)) as scene:
        state = scene.algorithm("cdlod", {"grid_size": 8, "quads_per_sample": 2})
        camera = scene.camera(99.5, 99.5, 2100.0, pitch=-90)
        drawn = pieces_of(read_triangles(scene, as_unculled(scene.frame(camera, (96, 64))), state))
        finest = {"plateau": 99, "plain": 99}
        for (level, x, _, thinned), _ in drawn.items():
            side = 4 << level
            for name, aside in (("plateau", x * side - 99), ("plain", 99 - (x + 1) * side)):
                if aside >= 40:
                    finest[name] = min(finest[name], level + thinned)
        assert finest["plateau"] + 2 <= finest["plain"]


@pytest.mark.parametrize("shape", [(70, 90), (30, 2500), (1, 5)])
@pytest.mark.parametrize("side", [1, 8])
def test_ground_stays_within_its_bounds(gpu: Gpu, shape: tuple[int, int], side: int) -> None:
    with closing(Scene(gpu, noise(*shape))) as scene:
        tree = PatchTree(scene.pyramid.grid, side)
        ground = Ground(scene.clipmap, tree)
        random = np.random.default_rng(1)
        for level in range(tree.level_count):
            rows, columns = tree.shape(level)
            x, y = random.integers(0, columns, 40), random.integers(0, rows, 40)
            low, high = ground.bounds(level, x, y)
            first, last = tree.samples(level, x, y)
            for share in random.uniform(0, 1, (20, 2)):
                at = first + (last - first) * share
                height = ground.at(at[:, 0], at[:, 1])
                assert (height >= low - 1e-5).all()
                assert (height <= high + 1e-5).all()


def test_ground_is_the_samples_where_they_are_few(gpu: Gpu) -> None:
    heights = noise(40, 50)
    heights[10, 20] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        ground = Ground(scene.clipmap, PatchTree(scene.pyramid.grid, 4))
        row, column = np.nonzero(np.isfinite(heights))
        np.testing.assert_allclose(ground.at(column, row), heights[row, column], rtol=1e-6)
        assert np.isfinite(ground.heights).all()


def test_the_surface_flows_with_the_camera(gpu: Gpu) -> None:
    """Nodes come and go as the camera moves, also upwards, but no point of the drawn surface jumps."""
    with closing(Scene(gpu, noise(200, 200))) as scene:
        above = scene.camera(100, 100, 500, pitch=-90, orthographic=1200.0)
        eye = scene.camera(90, 110, 120)
        scene.frame(eye, (64, 64))
        state = scene.algorithm("cdlod", {"grid_size": 8, "quads_per_sample": 4})
        heights, nodes = [], []
        for k in range(40):
            lod = eye.moved(x=eye.x + 0.25 * k, y=eye.y + 0.15 * k, z=eye.z + 0.1 * k)
            frame = as_unculled(Frame(above, scene.pyramid.grid, (64, 64), lod, 30.0, scene.clipmap.height_range))
            depth = scene.draw(frame, state)["depth"]
            assert (depth > 0).all()
            heights.append(frame.positions(depth)[..., 2])
            nodes.append(state.statistics().patches)
        assert len(set(nodes)) > 5
        change = np.abs(np.diff(heights, axis=0))
        assert np.ptp(heights, axis=0).max() > 5
        assert change.max() < 4


def test_culling_never_changes_the_picture(spiky: Scene) -> None:
    state = spiky.algorithm("cdlod", {"grid_size": 8, "quads_per_sample": 4})
    culled_nodes = all_nodes = 0
    for camera in some_cameras(spiky, 6, seed=17):
        frame = spiky.frame(camera)
        culled = spiky.draw(frame, state)
        culled_nodes += state.statistics().patches
        everything = spiky.draw(as_unculled(frame), state)
        all_nodes += state.statistics().patches
        for name in culled:
            np.testing.assert_array_equal(culled[name], everything[name])
    assert culled_nodes < 0.7 * all_nodes


def test_a_frozen_camera_keeps_nodes_and_vertices(gpu: Gpu) -> None:
    with closing(Scene(gpu, hills(200, 500.0).astype(np.float32))) as scene:
        state = scene.algorithm("cdlod", {"grid_size": 8, "quads_per_sample": 4})
        eye = scene.camera(60, 150, 600, pitch=-25)
        own = pieces_of(read_triangles(scene, scene.frame(eye), state))
        aside = eye.moved(x=eye.x - 1234.0, z=2000.0, heading=40.0, pitch=-60.0)
        frame = scene.frame(aside, lod_camera=eye)
        frozen = pieces_of(read_triangles(scene, frame, state))
        assert set(own) == set(frozen)
        shift = (scene.frame(eye).anchor - frame.anchor).astype(np.float64)
        for piece, corners in own.items():
            np.testing.assert_allclose(corners["offset"] + shift, frozen[piece]["offset"], atol=0.02)


def test_statistics_count_what_is_drawn(spiky: Scene) -> None:
    triangles = []
    for pixels in (12.0, 8.0, 5.0):
        state = spiky.algorithm("cdlod", {"grid_size": 8, "quads_per_sample": 4, "pixels_per_quad": pixels})
        frame = spiky.frame(spiky.camera(30, 55, 400, pitch=-30), (400, 300))
        draws = read_triangles(spiky, frame, state)
        counted = state.statistics()
        assert counted.triangles == sum(draw[..., 0].size for draw in draws)
        assert counted.patches == sum(len(draw) for draw in draws)
        assert counted.draws == len(draws)
        triangles.append(counted.triangles)
    assert (np.diff(triangles) > 0).all()
    spiky.draw(spiky.frame(spiky.camera(30, 55, 2000, pitch=80)), state)
    assert state.statistics().triangles == 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"grid_size": "12"}, "grid_size: expected a power of two from 8 to 128, got 12"),
        ({"quads_per_sample": "32"}, "quads_per_sample: expected a power of two from 1 to 16, got 32"),
        ({"quads_per_sample": "3"}, "quads_per_sample: expected a power of two from 1 to 16, got 3"),
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"morph_range": "0.5"}, "morph_range: expected above 0 and below 0.5, got 0.5"),
        ({"morph": "0.2"}, "did you mean morph_range"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("cdlod", settings)
