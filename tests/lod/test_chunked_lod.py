"""chunked_lod: its bounds against level-0 samples in float64, nested meshes, morphs without pops, skirts that reach."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.restricted import unculled
from lod.scene import Scene, noise
from lod.triangles import read_triangles
from oracle.landscapes import hills
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings, mesh, rtin
from orogen.lod.chunked_lod import ChunkedLod, Settings
from orogen.lod.chunked_lod.choose import morphs
from orogen.lod.chunked_lod.chunks import CLUSTER, ChunkKey, ChunkMaker, Mesh
from orogen.lod.chunked_lod.meshes import MeshView
from orogen.lod.contract import Patches

Floats = NDArray[np.float64]


def cliffs() -> NDArray[np.float32]:
    """Smooth ground with a wall through it."""
    ground = hills(300, 500.0).astype(np.float32)[:211]
    ground[97:103] += 150
    return ground


def voids() -> NDArray[np.float32]:
    ground = noise(180, 233) + hills(233, 300.0).astype(np.float32)[:180]
    ground[30:70, 100:190] = np.nan
    ground[rng(2).random(ground.shape) < 0.01] = np.nan
    ground[:, -2:] = np.nan
    return ground


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


TERRAINS: dict[str, Callable[[], NDArray[np.float32]]] = {
    "noise": lambda: noise(300, 421),
    "cliffs": cliffs,
    "voids": voids,
    "tiny": lambda: noise(2, 3),
    "a strip": lambda: noise(700, 5),
    "a power of two": lambda: noise(257, 257),
}


@pytest.fixture(scope="module", params=list(TERRAINS))
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, TERRAINS[request.param]())) as terrain:
        terrain.heights = TERRAINS[request.param]()  # type: ignore[attr-defined]
        yield terrain


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hills(400, 900.0).astype(np.float32)[:300])) as terrain:
        yield terrain


def maker_of(scene: Scene, **settings: Any) -> ChunkMaker:
    algorithm = algorithm_of(scene, **settings)
    algorithm.pages.close()
    return algorithm.maker


def algorithm_of(scene: Scene, **settings: Any) -> ChunkedLod:
    return ChunkedLod(scene.clipmap, make_settings("chunked_lod", settings))


def some_keys(maker: ChunkMaker, each: int = 3) -> Iterator[ChunkKey]:
    """A few chunks of every level, those at the far corner among them."""
    for level in range(maker.tree.level_count):
        rows, cols = maker.tree.shape(level)
        yield ChunkKey(level, cols - 1, rows - 1)
        places = rng(level).integers(0, [cols, rows], (each, 2))
        yield from (ChunkKey(level, x, y) for x, y in places.tolist())


def corners_of(maker: ChunkMaker, key: ChunkKey, mesh: Mesh, parents: bool = False) -> Floats:
    """(triangles, 3, 3) columns and rows in samples, heights."""
    at = np.array([key.x, key.y]) * 2.0**key.level + mesh.places * maker.unit(key.level)
    z = mesh.parents if parents else mesh.heights
    return np.column_stack([at, z.astype(np.float64)])[mesh.triangles]


def areas(corners: Floats) -> Floats:
    """Of triangles on the ground, signed."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0])[:, :2].T, (corners[:, 2] - corners[:, 0])[:, :2].T
    return (ax * by - bx * ay) / 2


def on_triangles(corners: Floats, count: int, seed: int) -> Floats:
    """(n, 3) points on triangles: the corners, the middles of their sides, and `count` more in each."""
    shares = rng(seed).dirichlet(np.full(3, 0.7), (len(corners), count))
    fixed = np.array([[1, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
    shares = np.concatenate([np.broadcast_to(fixed, (len(corners), 4, 3)), shares], axis=1)
    return np.einsum("tps,tsd->tpd", shares, corners).reshape(-1, 3)


def test_meshes_hold_their_bounds_against_the_true_surface(scene: Scene) -> None:
    surface = TrueSurface(scene.heights)  # type: ignore[attr-defined]
    for settings in ({}, {"chunk_size": 16, "base_error": 7.0}):
        maker = maker_of(scene, **settings)
        closest = []
        for key in some_keys(maker):
            points = on_triangles(corners_of(maker, key, maker.mesh(key)), 40, key.x)
            tx, ty = points[:, 0] + 0.5, points[:, 1] + 0.5
            there = surface.exists(tx, ty)
            off = np.abs(points[:, 2] - surface.height(tx, ty))[there]
            bound = float(maker.errors.at(*(np.array([part]) for part in key))[0, 0])
            assert off.size == 0 or off.max() <= bound * (1 + 1e-6) + 1e-4, key
            closest.append(off.max(initial=0) / max(bound, 1e-9))
        # not by far: some get near to what they are allowed, or half of that where the raster's edge cuts all of them
        assert max(closest) > (0.2 if min(scene.heights.shape) < 10 else 0.4)  # type: ignore[attr-defined]


def test_vertices_are_samples_and_meshes_fill_their_chunks(scene: Scene) -> None:
    surface = TrueSurface(scene.heights)  # type: ignore[attr-defined]
    maker = maker_of(scene, chunk_size=16)
    size = np.array(scene.heights.shape[::-1]) - 1  # type: ignore[attr-defined]
    for key in some_keys(maker):
        mesh = maker.mesh(key)
        corners = corners_of(maker, key, mesh)
        tx, ty = corners.reshape(-1, 3)[:, :2].T + 0.5
        there = surface.exists(tx, ty)
        exact = surface.height(tx, ty)
        np.testing.assert_allclose(corners[..., 2].ravel()[there], exact[there], rtol=1e-6, atol=1e-5)
        low = np.array([key.x, key.y]) * 2.0**key.level
        assert np.abs(areas(corners)).sum() == pytest.approx(np.prod(np.minimum(low + 2.0**key.level, size) - low))
        # all the same way round: nothing is folded over
        assert len(np.unique(np.sign(areas(corners)))) == 1


def test_bounds_double_from_level_to_level_except_where_the_ground_is_too_rough(hilly: Scene) -> None:
    maker = maker_of(hilly, base_error=3.0, chunk_size=32)
    for level, bounds in enumerate(maker.bounds):
        delta = 3.0 * 2.0 ** (level - 5)
        assert (bounds >= np.float32(delta)).all()
        assert (bounds[bounds > 1.001 * delta] >= 1.4 * maker.survey.floors[level].min()).all()
    assert (maker.bounds[5] == 3.0).all()
    assert (maker.bounds[2] == 0.375).all()
    assert maker.bounds[-1].max() > 1.5 * 3.0 * 2.0 ** (len(maker.bounds) - 6)


def test_bounds_never_grow_towards_finer_levels(scene: Scene) -> None:
    maker = maker_of(scene, chunk_size=16)
    for level in range(1, maker.tree.level_count):
        rows, cols = maker.tree.shape(level - 1)
        y, x = (index.ravel() for index in np.mgrid[:rows, :cols])
        assert (maker.errors.at(level - 1, x, y) <= maker.errors.at(level, x >> 1, y >> 1)).all()


def interpolated(corners: Floats, points: Floats) -> Floats:
    """Heights of a mesh at (n, 2) points of its own lattice; NaN beside it."""
    found = np.full(len(points), np.nan)
    for a, b, c in corners:
        shares = np.linalg.solve(np.stack([a[:2] - c[:2], b[:2] - c[:2]], axis=1), (points - c[:2]).T).T
        shares = np.column_stack([shares, 1 - shares.sum(axis=1)])
        inside = (shares >= -1e-9).all(axis=1)
        found[inside] = shares[inside] @ np.array([a[2], b[2], c[2]])
    return found


@pytest.mark.parametrize("settings", [{"chunk_size": 16}, {"chunk_size": 16, "base_error": 4.0}], ids=str)
def test_a_fully_morphed_chunk_is_its_parent(hilly: Scene, settings: dict[str, Any]) -> None:
    maker = maker_of(hilly, **settings)
    for level in range(maker.tree.level_count - 1):
        # well inside the raster: a parent that its edge cuts follows that edge besides
        key = ChunkKey(level, *(int(v) >> level for v in rng(level).integers(20, 120, 2)))
        parent = ChunkKey(level + 1, key.x >> 1, key.y >> 1)
        if ((np.array(parent[1:]) + 1) << parent.level > [399, 299]).any():
            continue
        mesh = maker.mesh(key)
        above = corners_of(maker, parent, maker.mesh(parent))
        points = on_triangles(corners_of(maker, key, mesh, parents=True), 5, level)
        # not just at the vertices: what is drawn is the same surface
        np.testing.assert_allclose(points[:, 2], interpolated(above, points[:, :2]), atol=1e-3)


def test_triangles_and_errors_of_small_networks() -> None:
    heights = np.zeros((5, 5))
    heights[2, 2] = 1.0
    errors = rtin.vertex_errors(heights)
    assert errors[2, 2] == 1.0
    mesh = rtin.triangles(errors > 0.5)
    assert len(mesh) == 4
    assert (rtin.surface(heights, errors > 0.5) - heights).max() == pytest.approx(0.5)
    # the corner of a chunk needs a chain of splits towards it
    heights = np.zeros((17, 17))
    heights[0, 1] = 1.0
    needed = rtin.vertex_errors(heights) > 0.5
    assert needed[[8, 0, 4, 0], [8, 8, 4, 4]].all()
    for seed in range(3):
        heights = rng(seed).normal(size=(17, 17))
        for threshold in (0.0, 0.7, 2.0, 9.0):
            needed = rtin.vertex_errors(heights) > threshold
            assert np.abs(rtin.surface(heights, needed) - heights).max() <= threshold
    assert len(rtin.triangles(np.zeros((17, 17), bool))) == 2
    assert len(rtin.triangles(np.ones((17, 17), bool))) == 512


def test_morphs_start_and_end_where_levels_change_and_keep_to_tau() -> None:
    share, ratio = rng(0).random(1000), rng(1).uniform(1, 6, 1000)
    above = np.maximum(1.0, share * ratio)
    morph = morphs(share, above, 0.5)
    assert ((1 - morph) * share + morph * above <= 1 + 1e-12).all()
    np.testing.assert_array_equal(morphs(share, np.ones(1000), 0.5), 1.0)
    np.testing.assert_array_equal(morphs(np.ones(1000), above + 1e-9, 0.5), 0.0)
    assert morphs(np.array([0.6]), np.array([1.25]), 0.5)[0] == 0.5
    # chunks that cannot be split although they are too coarse
    assert morphs(np.array([3.0, np.inf]), np.array([7.0, np.inf]), 0.5).tolist() == [0.0, 0.0]


def settled(scene: Scene, frame: Frame, state: MeshView) -> None:
    state.wants(frame)
    state._pages.settle()


def largest_change(scene: Scene, **settings: Any) -> float:
    """Of any point of the drawn surface from one frame to the next as a camera comes down, in errors of tau."""
    above = scene.camera(200, 150, 3000, pitch=-90, orthographic=1000.0)
    algorithm = algorithm_of(scene, chunk_size=16, tau=4.0, **settings)
    state = algorithm.view()
    changes, patches, before = [], [], None
    for k in range(40):
        lod = scene.camera(200, 150, 3000 * 0.97**k, pitch=-90)
        frame = unculled(scene.frame(above, (40, 40), lod_camera=lod))
        settled(scene, frame, state)
        heights = frame.positions(scene.draw(frame, state)["depth"])[..., 2]
        if before is not None:
            changes.append(np.abs(heights - before).max() / (4.0 * lod.z / frame.pixels_per_radian(lod)))
        before = heights
        patches.append(state.statistics().patches)
    assert len(set(patches)) > 3
    algorithm.pages.close()
    return max(changes)


def test_the_surface_flows_with_the_camera(hilly: Scene) -> None:
    """Chunks split as the camera comes nearer, but no point of the drawn surface jumps."""
    flowing = largest_change(hilly)
    jumping = largest_change(hilly, morph_range=1e-6)
    # a step of 3 % moves a surface that morphs over a third of its range by a tenth of what it jumps without
    assert flowing < 0.12
    assert jumping > 3 * flowing


def drawn_triangles(scene: Scene, frame: Frame, state: Any) -> NDArray[Any]:
    """(instances, triangles, 3) corners; clusters have no list of vertices, so one is made for the reader."""
    (draw,) = scene.record(frame, state)
    assert isinstance(draw, Patches)
    if draw.index is None:
        clusters = state.statistics().triangles // CLUSTER
        words = np.array([3 * CLUSTER, clusters, 0, 0, 0], np.uint32)
        index = mesh.Mesh(scene.gpu, [np.arange(3 * CLUSTER).reshape(-1, 3)], "test")
        arguments = scene.gpu.buffer("arguments", words, "STORAGE|COPY_SRC", "test")
        draw = replace(draw, index=index, indirect=arguments)

    class Recorded:
        def record(self, *_: Any) -> list[Patches]:
            return [draw]

    (corners,) = read_triangles(scene, frame, Recorded())  # type: ignore[arg-type]
    return corners


@pytest.mark.parametrize(
    "settings",
    [{"chunk_size": 16, "tau": 6.0}, {"preprocessed": False, "chunk_size": 16, "pixels_per_quad": 20.0}],
    ids=["meshes", "grids"],
)
def test_skirts_reach_the_edges_beyond(hilly: Scene, settings: dict[str, Any]) -> None:
    """Where two chunks touch, the skirt of the higher edge hangs down to the lower one."""
    algorithm = algorithm_of(hilly, **settings)
    state = algorithm.view()
    gaping = 0
    for k, column in enumerate((80, 330)):
        camera = hilly.camera(column, 140, 1100, pitch=-30, heading=100 * k)
        frame = unculled(hilly.frame(camera, (320, 200)))
        if algorithm.pages:
            settled(hilly, frame, state)
        corners = drawn_triangles(hilly, frame, state).reshape(-1, 3)
        texel = (corners["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits - 0.5
        heights, ids, levels = corners["height"].astype(np.float64), corners["id"][:, 0], corners["tile_level"][:, 0]
        assert len(np.unique(levels)) > 1
        # the lower ends of skirts lie on no line
        hangs = (corners["grid"] == 0.5).all(axis=2).any(axis=1)
        pieces: dict[int, list[tuple[bool, Floats, Floats]]] = {}
        for chunk in np.unique(ids).tolist():
            parts = [(surface, (ids == chunk) & (hangs != surface)) for surface in (True, False)]
            pieces[chunk] = [(surface, texel[part], heights[part]) for surface, part in parts]
        ends = {chunk: (texel[ids == chunk].min(axis=(0, 1)), texel[ids == chunk].max(axis=(0, 1))) for chunk in pieces}
        for chunk in pieces:
            level = int(levels[ids == chunk][0])
            rest = chunk ^ (level << 26)
            x, y = rest & 0x1FFF, rest >> 13
            side = 2.0**level
            if (x + 1) * side >= 399:
                continue
            # points along the eastern edge
            along = np.linspace(y * side + 0.01, min((y + 1) * side, 299) - 0.01, 23)
            tops = [profile(pieces[chunk][0], (x + 1) * side, along, np.fmax)]
            lows = [np.fmin(tops[0], profile(pieces[chunk][1], (x + 1) * side, along, np.fmin))]
            for other in pieces:
                (west, north), (_, south) = ends[other]
                if abs(west - (x + 1) * side) > 0.5 or north > along[-1] or south < along[0]:
                    continue
                there = profile(pieces[other][0], (x + 1) * side, along, np.fmax)
                if other != chunk and np.isfinite(there).any():
                    tops.append(there)
                    lows.append(np.fmin(there, profile(pieces[other][1], (x + 1) * side, along, np.fmin)))
            tops_, lows_ = np.array(tops), np.array(lows)
            assert (np.isfinite(tops_).sum(axis=0) >= 2).all()
            highest = np.nanmax(tops_, axis=0)
            hung = np.nanmin(np.where(tops_ >= highest - 1e-6, lows_, np.nan), axis=0)
            assert (hung <= np.nanmin(tops_, axis=0) + 1e-3).all()
            gaping += int((highest - np.nanmin(tops_, axis=0) > 0.5).sum())
    assert gaping > 20
    if algorithm.pages:
        algorithm.pages.close()


def profile(piece: tuple[bool, Floats, Floats], column: float, along: Floats, pick: Any) -> Floats:
    """Heights along an edge at a column: of the sides of triangles that lie on it (skirts: within a little)."""
    surface, texel, heights = piece
    result = np.full(along.size, np.nan)
    close = np.abs(texel[..., 0] - column) < (1e-6 if surface else 0.2)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        on = close[:, i] & close[:, j] & (texel[:, i, 1] != texel[:, j, 1])
        for a, b, za, zb in zip(texel[on, i, 1], texel[on, j, 1], heights[on, i], heights[on, j], strict=True):
            (low, z_low), (high, z_high) = sorted([(a, za), (b, zb)])
            within = (along >= low - 1e-9) & (along <= high + 1e-9)
            result[within] = pick(result[within], z_low + (z_high - z_low) * (along[within] - low) / (high - low))
    return result


def test_what_is_not_there_yet_is_drawn_coarser(hilly: Scene) -> None:
    algorithm = algorithm_of(hilly, chunk_size=16)
    state = algorithm.view()
    assert isinstance(state, MeshView)
    frame = hilly.frame(hilly.camera(200, 200, 1300, pitch=-50))
    assert (hilly.draw(frame, state)["depth"] == 0).all()
    assert state.statistics().patches == 0
    covered, patches = [], []
    wanted = state._seen(frame).wanted()
    for count in (1, 5, len(wanted) // 2, len(wanted)):
        algorithm.pages.want(wanted[:count], state)  # type: ignore[union-attr]
        algorithm.pages.settle()  # type: ignore[union-attr]
        covered.append((hilly.draw(frame, state)["depth"] > 0).sum())
        patches.append(state.statistics().patches)
    assert patches[0] == 1
    assert patches[0] < patches[1] < patches[-1]
    # never a hole, whatever is there
    assert min(covered) > 0.98 * max(covered)
    algorithm.pages.close()  # type: ignore[union-attr]


def test_little_memory_means_coarser_chunks(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 1100, pitch=-50), (160, 100))
    drawn = {}
    for memory in (1 << 20, 64 << 20):
        algorithm = algorithm_of(hilly, chunk_size=64, tau=0.25, memory=memory)
        state = algorithm.view()
        settled(hilly, frame, state)
        depth = hilly.draw(frame, state)["depth"]
        drawn[memory] = state.statistics().patches, (depth > 0).sum()
        algorithm.pages.close()
    assert drawn[1 << 20][0] < drawn[64 << 20][0]
    assert drawn[1 << 20][1] > 0.98 * drawn[64 << 20][1]


def test_a_smaller_tau_takes_more_triangles(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 290, 1100, pitch=-30), (160, 100))
    triangles = []
    for tau in (4.0, 2.0, 1.0, 0.5):
        algorithm = algorithm_of(hilly, tau=tau)
        state = algorithm.view()
        settled(hilly, frame, state)
        hilly.draw(frame, state)
        triangles.append(state.statistics().triangles)
        algorithm.pages.close()
    assert triangles == sorted(triangles)
    assert triangles[-1] > 3 * triangles[0]


@pytest.mark.parametrize("view", [{"pitch": -35.0}, {"pitch": -90.0}])
def test_grids_are_drawn_without_anything_made_beforehand(hilly: Scene, view: dict[str, float]) -> None:
    frame = hilly.frame(hilly.camera(200, 290, 1300, **view), (160, 100))
    grids = algorithm_of(hilly, preprocessed=False, pixels_per_quad=2.0)
    assert grids.pages is None
    state = grids.view()
    depth = hilly.draw(frame, state)["depth"]
    meshes = algorithm_of(hilly, tau=0.25)
    other = meshes.view()
    settled(hilly, frame, other)
    exact = hilly.draw(frame, other)["depth"]
    both = (depth > 0) & (exact > 0)
    assert both.sum() > 5000
    assert ((depth > 0) == (exact > 0)).mean() > 0.995
    assert np.quantile(np.abs(depth[both] / exact[both] - 1), 0.99) < 0.01
    statistics = state.statistics()
    assert statistics.triangles == statistics.patches * (2 * 64**2 + 8 * 64)
    meshes.pages.close()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tau": "0"}, "tau: expected a number of pixels above 0, got 0"),
        ({"tau": "nan"}, "tau: expected a number of pixels above 0, got nan"),
        ({"chunk_size": "24"}, "chunk_size: expected 16, 32 or 64 quads, got 24"),
        ({"base_error": "-1"}, "base_error: expected a number of metres above 0, got -1"),
        ({"morph_range": "1.5"}, "morph_range: expected above 0 and at most 1, got 1.5"),
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"memory": "5"}, "memory: expected at least 1048576 bytes"),
        ({"preprocessed": "maybe"}, "chunked_lod preprocessed: expected bool, got 'maybe'"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("chunked_lod", settings)


def test_settings_are_read_from_text() -> None:
    values = {"tau": "2", "chunk_size": "32", "base_error": "none", "preprocessed": "false"}
    assert make_settings("chunked_lod", values) == Settings(2.0, 32, None, preprocessed=False)
