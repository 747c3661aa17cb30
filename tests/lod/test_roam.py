"""roam: the mesh is that of a plain twin whatever it was before, wedgies hold the ground, errors and budgets hold."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import orogen.lod
from lod.bintree_twin import Plain, Twin, corners_of, grid_of, named
from lod.patches import torn_edges
from lod.scene import Scene, noise
from lod.triangles import read_draw
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare import screen
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.bintree import Bintree, runs
from orogen.lod.contract import AlgorithmView
from orogen.lod.wedgies import Wedgies, measure

pytest.importorskip("numba")

LARGE = 1 << 20
ROWS, COLUMNS = 90, 120
HEIGHTS = hills(120, 300.0).astype(np.float32)[:ROWS] + noise(ROWS, COLUMNS, 8.0)


def frame_of(heights: NDArray[Any], camera: Camera, **changes: Any) -> Frame:
    return Frame(camera, grid_of(heights), (160, 100), **changes)


def built(heights: NDArray[Any], most: int = 1 << 25) -> Wedgies:
    return measure(Plain(heights), grid_of(heights), most)  # type: ignore[arg-type]


def views(heights: NDArray[Any]) -> list[Camera]:
    rows, columns = heights.shape
    top = float(np.nanmax(heights))
    return [
        Camera(5.0 * columns, -200, top + 150, pitch=-20),
        Camera(3.0 * columns, 4.0 * rows, top + 40, heading=60, pitch=-30),
        Camera(5.0 * columns, 5.0 * rows, top + 300, heading=10, pitch=-90),
        Camera(6.0 * columns, 6.0 * rows, top + 5, heading=200, pitch=-3, roll=20),
        Camera(5.0 * columns, 5.0 * rows, top + 200, heading=120, pitch=-50, orthographic=400),
    ]


def state_of(bintree: Bintree) -> set[tuple[int, ...]]:
    found = {tuple(row) for row in bintree.triangles.tolist()}
    assert len(found) == bintree.count
    return found


# -- wedgies -----------------------------------------------------------------------------------------------------------


def lattice_triangles(wedgies: Wedgies) -> Iterator[tuple[tuple[int, int, int], NDArray[np.int64]]]:
    """Place among the wedgies, and corners in cells, of all triangles that are split at a height of the lattice."""
    rows, columns = wedgies.heights.shape
    for y in range(rows):
        for x in range(columns):
            s = (x | y) & -(x | y)
            if not 0 < s < wedgies.side:
                continue
            if x & s and y & s:
                falling = ((x - s) // (2 * s) + (y - s) // (2 * s)) % 2 == 0
                ways = [(s, -s), (-s, s)] if falling else [(-s, -s), (s, s)]
            else:
                ways = [(0, -s), (0, s)] if x & s else [(-s, 0), (s, 0)]
            for which, (dx, dy) in enumerate(ways):
                if 0 <= x + dx < columns and 0 <= y + dy < rows:
                    yield (which, y, x), np.array([[x + dx, y + dy], [x - dy, y + dx], [x + dy, y - dx]])


@pytest.mark.parametrize(("rows", "columns", "most"), [(17, 17, LARGE), (13, 31, LARGE), (40, 45, 800)])
def test_wedgies_hold_the_ground(rows: int, columns: int, most: int) -> None:
    heights = noise(rows, columns, 50.0, seed=rows)
    wedgies = built(heights, most)
    assert wedgies.heights.size <= most
    assert (wedgies.level > 0) == (most == 800)
    step = 1 << wedgies.level
    surface = TrueSurface(heights)
    # between samples too
    y, x = np.mgrid[0 : rows - 1 : 0.5, 0 : columns - 1 : 0.5]
    points = np.column_stack([x.ravel(), y.ravel()])
    z = surface.height(points[:, 0] + 0.5, points[:, 1] + 0.5)
    for (which, j, i), corners in lattice_triangles(wedgies):
        share = shares(points / step, corners)
        over = (share >= -1e-9).all(axis=1)
        if not over.any():
            continue
        plane = share[over] @ wedgies.heights[corners[:, 1], corners[:, 0]].astype(np.float64)
        assert np.abs(z[over] - plane).max() <= wedgies.thickness[which, j, i] + 1e-4, (which, j, i)


def shares(points: NDArray[np.float64], corners: NDArray[Any]) -> NDArray[np.float64]:
    """(n, 3) barycentric coordinates."""
    a, b, c = corners.astype(np.float64)
    two = (points - a) @ np.linalg.inv(np.stack([b - a, c - a]))
    return np.column_stack([1 - two.sum(axis=1), two])


def test_wedgies_are_the_sums_of_the_twin() -> None:
    heights = noise(14, 23, 50.0)
    wedgies = built(heights)
    shape = (wedgies.heights.shape[0] - 1, wedgies.heights.shape[1] - 1)
    twin = Twin(heights, wedgies.side, shape, 6, frame_of(heights, views(heights)[0]))
    expected: dict[tuple[int, int, int], float] = {}
    for at, corners in lattice_triangles(wedgies):
        triangle: Any = tuple((int(x) << 6, int(y) << 6) for x, y in corners)
        expected[at] = twin.wedgie(triangle)
    assert len(expected) > 100
    found = [wedgies.thickness[at] for at in expected]
    np.testing.assert_allclose(found, list(expected.values()), rtol=1e-5)
    assert wedgies.error is wedgies.thickness


def test_where_nothing_is_drawn_nothing_is_split() -> None:
    heights = noise(40, 40, 50.0)
    heights[:, 12:] = np.nan
    camera = views(noise(40, 40, 50.0))[2]
    mesh = Bintree(built(heights))
    assert mesh.refine(frame_of(heights, camera), 0.5, LARGE)
    corners = corners_of(mesh.triangles) / 64
    small = np.ptp(corners[..., 0], axis=1) <= 1
    assert small.sum() > 100
    # but for what conformity takes
    assert (corners[small, :, 0].min(axis=1) < 16).all()


# -- the queues --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("view", "tau", "most"),
    [(0, 5.0, LARGE), (1, 16.0, LARGE), (2, 5.0, LARGE), (3, 9.0, LARGE), (0, 0.5, 140), (1, 0.5, 60), (3, 1.0, 233)],
)
def test_the_mesh_is_that_of_the_twin(view: int, tau: float, most: int) -> None:
    heights = noise(14, 23, 60.0)
    wedgies = built(heights)
    frame = frame_of(heights, views(heights)[view])
    shape = (wedgies.heights.shape[0] - 1, wedgies.heights.shape[1] - 1)
    twin = Twin(heights, wedgies.side, shape, wedgies.bits, frame)
    mesh = Bintree(wedgies)
    assert mesh.refine(frame, tau, most)
    expected = named(twin.refine(tau, most))
    assert len(expected) > 40
    assert state_of(mesh) == expected


@pytest.mark.parametrize(("most", "samples"), [(LARGE, LARGE), (700, LARGE), (60, LARGE), (LARGE, 1500), (700, 1500)])
def test_the_mesh_does_not_depend_on_what_it_was(most: int, samples: int) -> None:
    wedgies = built(HEIGHTS, samples)
    rng = np.random.default_rng(most)
    mesh = Bintree(wedgies)
    for step in range(15):
        camera = replace(
            views(HEIGHTS)[0], x=rng.uniform(0, 1200), y=rng.uniform(0, 900), z=rng.uniform(200, 600),
            heading=rng.uniform(0, 360), pitch=rng.uniform(-90, 10),
        )  # fmt: skip
        frame, tau = frame_of(HEIGHTS, camera), float(rng.choice([0.5, 2.0, 8.0]))
        assert mesh.refine(frame, tau, most)
        fresh = Bintree(wedgies)
        assert fresh.refine(frame, tau, most)
        assert state_of(mesh) == state_of(fresh), step
        roots = 2 * np.prod(np.array(wedgies.heights.shape) - 1) // wedgies.side**2
        assert mesh.count <= max(most, roots)


@pytest.mark.parametrize("view", range(5))
def test_every_edge_is_shared_as_a_whole(view: int) -> None:
    wedgies = built(HEIGHTS)
    mesh = Bintree(wedgies)
    assert mesh.refine(frame_of(HEIGHTS, views(HEIGHTS)[view]), 1.0, LARGE)
    corners = corners_of(mesh.triangles)
    assert len(corners) > 500
    height, width = (size - 1 << wedgies.bits for size in wedgies.heights.shape)
    pairs = np.sort(
        (corners @ [1, 1 << 32])[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2), axis=1
    )  # fmt: skip
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    x, y = edges & 0xFFFFFFFF, edges >> 32
    outline = ((x == 0).all(1) | (x == width).all(1) | (y == 0).all(1) | (y == height).all(1)).astype(int)
    np.testing.assert_array_equal(count, 2 - outline)
    one, two = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2
    assert area == width * height


def test_what_takes_too_long_goes_on_in_the_next_frame() -> None:
    wedgies = built(HEIGHTS)
    frame = frame_of(HEIGHTS, views(HEIGHTS)[1])
    whole, slow = Bintree(wedgies), Bintree(wedgies)
    assert whole.refine(frame, 0.3, LARGE)
    counts = []
    while not slow.refine(frame, 0.3, LARGE, seconds=0.0):
        counts.append(slow.count)
        assert len(counts) < 1000
    assert len(counts) > 3
    assert counts == sorted(counts)
    assert state_of(slow) == state_of(whole)


def test_only_what_has_changed_is_sent() -> None:
    mesh = Bintree(built(HEIGHTS))
    camera = views(HEIGHTS)[0]
    mesh.refine(frame_of(HEIGHTS, camera), 1.0, LARGE)
    copy = mesh.triangles.copy()
    for step in range(1, 6):
        mesh.refine(frame_of(HEIGHTS, camera.moved(x=camera.x + 3 * step)), 1.0, LARGE)
        assert 0 < mesh.written.size < 0.2 * mesh.count
        longer = np.zeros_like(mesh.triangles)
        shared = min(len(copy), mesh.count)
        longer[:shared] = copy[:shared]
        longer[mesh.written] = mesh.triangles[mesh.written]
        np.testing.assert_array_equal(longer, mesh.triangles)
        copy = longer
    mesh.refine(frame_of(HEIGHTS, camera.moved(x=camera.x + 15)), 1.0, LARGE)
    assert mesh.written.size == 0


def test_runs_join_what_is_near() -> None:
    assert list(runs(np.array([3, 4, 9, 30, 31]), 5)) == [(3, 10), (30, 32)]
    assert list(runs(np.zeros(0, np.int64), 5)) == []


# -- what is promised --------------------------------------------------------------------------------------------------


def drawn_at(mesh: Bintree, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres of the mesh at columns and rows; NaN where it is not."""
    drawn = np.full(len(points), np.nan)
    padded = mesh.wedgies.heights.astype(np.float64)
    for corners, shifts in zip(corners_of(mesh.triangles) / 64, mesh.shifts, strict=True):
        i, j = np.minimum(corners.astype(int), np.array(padded.shape)[::-1] - 2).T
        u, v = (corners - np.column_stack([i, j])).T
        z = (padded[j, i] * (1 - u) + padded[j, i + 1] * u) * (1 - v)
        z += (padded[j + 1, i] * (1 - u) + padded[j + 1, i + 1] * u) * v + shifts
        near = np.flatnonzero((np.abs(points - corners.mean(axis=0)) <= np.ptp(corners, axis=0).max()).all(axis=1))
        if near.size:
            share = shares(points[near], corners)
            over = (share >= -1e-9).all(axis=1)
            drawn[near[over]] = share[over] @ z
    return drawn


@pytest.mark.parametrize("morph", [0.0, 0.5])
@pytest.mark.parametrize(
    ("view", "tau", "changes"),
    [
        *((view, 1.5, {}) for view in range(5)), (1, 4.0, {}), (3, 4.0, {}),
        (0, 2.0, {"exaggeration": 3.0}), (1, 2.0, {"exaggeration": 3.0, "curvature": True}),
    ],
)  # fmt: skip
def test_errors_on_screen_are_within_tau(view: int, tau: float, changes: dict[str, Any], morph: float) -> None:
    mesh = Bintree(built(HEIGHTS))
    camera = views(HEIGHTS)[view]
    frame = frame_of(HEIGHTS, camera.moved(z=camera.z * changes.get("exaggeration", 1.0)), **changes)
    assert mesh.refine(frame, tau / (1 + morph), LARGE, morph=morph)
    assert (mesh.shifts != 0).any() == (morph > 0)
    rng = np.random.default_rng(view)
    points = rng.uniform(0, [COLUMNS - 1, ROWS - 1], (3000, 2))
    truth, drawn = TrueSurface(HEIGHTS).height(points[:, 0] + 0.5, points[:, 1] + 0.5), drawn_at(mesh, points)
    assert np.isfinite(drawn).all()
    x, y = frame.grid.to_crs(points[:, 0] + 0.5, points[:, 1] + 0.5)
    clipped = screen.clip(frame, x, y, truth)
    before = np.column_stack(screen.pixels(frame, clipped))
    after = np.column_stack(screen.pixels(frame, screen.clip(frame, x, y, drawn)))
    seen = (clipped[:, 3] > 0.5) & ((before >= 0) & (before <= frame.size)).all(axis=1)
    assert seen.sum() > 100
    off = np.linalg.norm(after - before, axis=1)[seen]
    assert off.max() <= tau
    # and no more triangles than that takes, by far
    assert off.max() > 0.1 * tau


@pytest.mark.parametrize(("tau", "most"), [(2.0, LARGE), (1.0, 1500)])
def test_vertices_rise_out_of_the_side_that_they_split(tau: float, most: int) -> None:
    wedgies, camera = built(HEIGHTS), views(HEIGHTS)[0]
    # well inside the picture: at its sides triangles are split and merged as they come and go
    points = np.random.default_rng(5).uniform([50, 20], [70, 70], (150, 2))
    jumps = []
    for morph in (0.0, 1.0):
        mesh, before, most_moved, splits = Bintree(wedgies), np.zeros(0), 0.0, 0
        for step in range(10):
            frame = frame_of(HEIGHTS, camera.moved(y=camera.y + step))
            assert mesh.refine(frame, tau, most, morph=morph)
            z = drawn_at(mesh, points)
            if before.size:
                most_moved = max(most_moved, float(np.abs(z - before).max()))
                splits += mesh.written.size > 0
            before = z
        assert splits > 2
        jumps.append(most_moved)
        fresh = Bintree(wedgies)
        assert fresh.refine(frame, tau, most, morph=morph)
        one, two = (dict(zip(map(tuple, m.triangles.tolist()), m.shifts.tolist(), strict=True)) for m in (mesh, fresh))
        assert one == two
    assert jumps[0] > 1
    assert jumps[1] < (0.02 if most == LARGE else 0.1) * jumps[0]


def test_tau_and_budget_choose_the_number_of_triangles() -> None:
    wedgies = built(HEIGHTS)
    frame = frame_of(HEIGHTS, views(HEIGHTS)[0])
    counts = []
    for tau in (0.5, 1.0, 2.0, 4.0, 8.0):
        mesh = Bintree(wedgies)
        mesh.refine(frame, tau, LARGE)
        counts.append(mesh.count)
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 4 * counts[-1]
    for most in (100, 1000, counts[0] - 10):
        mesh = Bintree(wedgies)
        assert mesh.refine(frame, 0.5, most)
        assert 0.9 * most <= mesh.count <= most


# -- on the GPU --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, HEIGHTS)) as terrain:
        yield terrain


def read_list(scene: Scene, frame: Frame, state: AlgorithmView) -> NDArray[Any]:
    """(triangles, 3) corners of dtype VERTEX."""
    (draw,) = scene.record(frame, state)
    corners = read_draw(scene.gpu, scene.clipmap, scene.view, draw)[0]
    assert len(corners) == state.statistics().triangles
    return corners


def placed(scene: Scene, frame: Frame, corners: NDArray[Any]) -> NDArray[np.float64]:
    """(..., 2) columns and rows, from the first sample."""
    return (corners["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits - 0.5


@pytest.mark.parametrize("view", range(2))
def test_errors_are_within_tau_also_where_not_all_samples_are_kept(scene: Scene, view: int) -> None:
    frame = scene.frame(views(HEIGHTS)[view], (160, 100))
    state: Any = scene.algorithm("roam", {"samples": 4096, "tau": 2.0})
    corners = read_list(scene, frame, state)
    assert state.bintree.wedgies.level == 1
    weights = np.random.default_rng(view).dirichlet([1, 1, 1], len(corners))
    x, y = np.einsum("tk,tkd->dt", weights, placed(scene, frame, corners)) + 0.5
    z = (weights * corners["height"]).sum(axis=1)
    inside = (x <= COLUMNS - 0.5) & (y <= ROWS - 0.5)
    x, y, z = x[inside], y[inside], z[inside]
    place = frame.grid.to_crs(x, y)
    clipped = screen.clip(frame, *place, TrueSurface(HEIGHTS).height(x, y))
    before = np.column_stack(screen.pixels(frame, clipped))
    after = np.column_stack(screen.pixels(frame, screen.clip(frame, *place, z)))
    seen = (clipped[:, 3] > 0.5) & ((before >= 0) & (before <= frame.size)).all(axis=1)
    off = np.linalg.norm(after - before, axis=1)[seen]
    assert off.size > 500
    assert off.max() <= 2.0


@pytest.mark.parametrize("view", range(4))
def test_the_gpu_draws_the_mesh(scene: Scene, view: int) -> None:
    frame = scene.frame(views(HEIGHTS)[view], (160, 100))
    state: Any = scene.algorithm("roam")
    corners = read_list(scene, frame, state)
    expected = corners_of(state.bintree.triangles) / 64
    np.testing.assert_allclose(placed(scene, frame, corners), expected, atol=1e-6)
    x, y = expected[..., 0], expected[..., 1]
    inside = (x <= COLUMNS - 1) & (y <= ROWS - 1)
    assert not inside.all()
    truth = TrueSurface(HEIGHTS)
    np.testing.assert_allclose(corners["height"][inside], truth.height(x[inside] + 0.5, y[inside] + 0.5), atol=1e-3)
    # beyond the raster it is reflected in its edge
    padded = state.bintree.wedgies.heights
    i, j = expected[~inside].T
    whole = (i % 1 == 0) & (j % 1 == 0)
    assert whole.any()
    beyond = padded[j[whole].astype(int), i[whole].astype(int)]
    np.testing.assert_allclose(corners["height"][~inside][whole], beyond, atol=1e-3)
    # a corner's three functions name it
    assert len(np.unique(corners["id"])) > 0.99 * len(corners)
    assert (corners["tile_level"] == corners["tile_level"][:, :1]).all()


@pytest.mark.parametrize("morph", [0.0, 0.5])
@pytest.mark.parametrize("view", range(4))
def test_corners_that_coincide_are_the_same_to_the_bit(scene: Scene, view: int, morph: float) -> None:
    frame = scene.frame(views(HEIGHTS)[view], (160, 100))
    state: Any = scene.algorithm("roam", {"tau": 0.5, "morph": morph})
    triangles = read_list(scene, frame, state)["position"]
    x, y = triangles[..., 0], triangles[..., 1]
    assert len(torn_edges(triangles, (x.min(), y.min(), x.max(), y.max()))) == 0


@pytest.mark.parametrize("morph", [0.0, 0.5])
def test_a_slow_flight_sends_little(scene: Scene, morph: float) -> None:
    camera = views(HEIGHTS)[0]
    state: Any = scene.algorithm("roam", {"morph": morph})
    scene.record(scene.frame(camera, (160, 100)), state)
    whole = state.sent
    assert whole == (28 if morph else 16) * state.statistics().triangles
    for step in range(1, 5):
        frame = scene.frame(camera.moved(x=camera.x + 2 * step), (160, 100))
        before = state.sent
        scene.record(frame, state)
        assert morph or state.sent - before < whole / 2
        # what lies on the GPU is what lies here, however it came there
        corners = read_list(scene, frame, state)
        fresh: Any = scene.algorithm("roam", {"morph": morph})
        other = read_list(scene, frame, fresh)
        one, two = (np.sort(each["position"].reshape(-1, 9).view("V36").ravel()) for each in (corners, other))
        np.testing.assert_array_equal(one, two)


def test_time_that_runs_out_makes_a_frame_incomplete(scene: Scene) -> None:
    frame = scene.frame(views(HEIGHTS)[1], (160, 100))
    hasty, patient = scene.algorithm("roam", {"milliseconds": 1e-6, "tau": 0.3}), scene.algorithm("roam", {"tau": 0.3})
    scene.record(frame, hasty)
    assert hasty.incomplete()
    picture = scene.draw(frame, hasty)
    assert not hasty.incomplete()
    np.testing.assert_array_equal(picture["depth"], scene.draw(frame, patient)["depth"])
    asked = scene.algorithm("roam", {"tau": 0.3})
    scene.record(replace(frame, time_budget=1e-9), asked)
    assert asked.incomplete()


def test_detail_is_that_of_a_frozen_camera(scene: Scene) -> None:
    one, two = views(HEIGHTS)[:2]
    own: Any = scene.algorithm("roam")
    scene.record(scene.frame(one, (160, 100)), own)
    frozen: Any = scene.algorithm("roam")
    scene.record(scene.frame(two, (160, 100), lod_camera=one), frozen)
    assert state_of(own.bintree) == state_of(frozen.bintree)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"tau": 0}, "tau: expected a number of pixels above 0, got 0"),
        ({"tau": math.nan}, "tau: expected a number of pixels above 0, got nan"),
        ({"morph": -0.5}, "morph: expected 0 to 1, got -0.5"),
        ({"triangles": 1}, "triangles: expected at least 2, got 1"),
        ({"milliseconds": 0}, "milliseconds: expected a number above 0, got 0"),
        ({"samples": 100}, "samples: expected at least 4096, got 100"),
    ],
)
def test_settings_out_of_range_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("roam", values)


def test_without_a_compiler_it_says_what_to_install(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "orogen.lod.bintree_kernels", raising=False)
    monkeypatch.delattr(orogen.lod, "bintree_kernels", raising=False)
    with pytest.raises(SettingsError, match=r'pip install "orogen\[compiled\]"'):
        scene.algorithm("roam")


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (2, 2), (3, 300), (65, 65)])
def test_rasters_of_any_size(shape: tuple[int, int]) -> None:
    heights = noise(*shape, 5.0)
    mesh = Bintree(built(heights))
    assert mesh.refine(frame_of(heights, Camera(5.0, 5.0, 40.0, pitch=-60)), 0.5, LARGE)
    corners = corners_of(mesh.triangles) / 64
    assert corners.min() == 0
    assert (corners.max(axis=(0, 1)) >= np.array(shape)[::-1] - 1).all()
