"""rustic: clusters follow the bintree's splits, their errors are known ahead, their edges match whatever their size."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.bintree_twin import Plain, corners_of, grid_of
from lod.patches import torn_edges
from lod.scene import Scene, noise
from lod.triangles import read_triangles
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare import screen
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.rustic import CLUSTERS, cluster_triangles
from orogen.lod.wedgies import Wedgies, measure, subdivision

pytest.importorskip("numba")

ROWS, COLUMNS = 90, 120
HEIGHTS = hills(120, 300.0).astype(np.float32)[:ROWS] + noise(ROWS, COLUMNS, 8.0)
CAMERAS = (
    Camera(600.0, -200.0, 460.0, pitch=-20),
    Camera(360.0, 360.0, 340.0, heading=60, pitch=-30),
    Camera(600.0, 450.0, 600.0, heading=10, pitch=-90),
)


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, HEIGHTS)) as terrain:
        yield terrain


def built(heights: NDArray[Any], halvings: int, most: int = 1 << 25) -> Wedgies:
    return measure(Plain(heights), grid_of(heights), most, halvings)  # type: ignore[arg-type]


def bisected(corners: NDArray[np.float64], times: int) -> NDArray[np.float64]:
    """(n, 3, 2) apex and ends, split and split again."""
    for _ in range(times):
        apex, one, other = np.moveaxis(corners, -2, 0)
        middle = (one + other) / 2
        parts = [np.stack([middle, apex, one], -2), np.stack([middle, apex, other], -2)]
        corners = np.stack(parts, -3).reshape(-1, 3, 2)
    return corners


@pytest.mark.parametrize("segments", [2, 4, 16])
def test_a_cluster_is_a_triangle_split_again_and_again(segments: int) -> None:
    triangles = cluster_triangles(segments)
    found = np.stack([triangles % (segments + 1), triangles // (segments + 1)], axis=-1)
    whole = np.array([[[0, 0], [segments, 0], [0, segments]]], float)
    expected = bisected(whole, 2 * (segments.bit_length() - 1))
    assert found.shape == expected.shape == (segments**2, 3, 2)

    def named(corners: NDArray[Any]) -> set[frozenset[tuple[int, int]]]:
        return {frozenset((int(x), int(y)) for x, y in triangle) for triangle in corners}

    assert named(found) == named(expected)
    # every edge of the whole has all its vertices
    i, j = found.reshape(-1, 2).T
    for along in (i[j == 0], j[i == 0], i[i + j == segments]):
        np.testing.assert_array_equal(np.unique(along), np.arange(segments + 1))


@pytest.mark.parametrize(("halvings", "most"), [(1, 1 << 25), (2, 1 << 25), (2, 1200)])
def test_errors_of_clusters_are_those_of_the_wedgies_of_their_triangles(halvings: int, most: int) -> None:
    heights = noise(40, 52, 50.0)
    plain, ahead = built(heights, 0, most), built(heights, halvings, most)
    np.testing.assert_array_equal(plain.thickness, ahead.thickness)
    assert ahead.ahead == 2 * halvings
    rows, columns = ahead.heights.shape
    compared = 0
    for s in (4, 2, 1):
        for y in range(s, rows, 2 * s):
            for x in range(s, columns, 2 * s):
                falling = ((x - s) // (2 * s) + (y - s) // (2 * s)) % 2 == 0
                for which, way in enumerate([(s, -s), (-s, s)] if falling else [(-s, -s), (s, s)]):
                    apex = np.array([x, y]) + way
                    corners = corners_of(np.array([[x, y, *apex]])).astype(float)
                    small = bisected(corners, 2 * halvings)
                    middles = (small[:, 1] + small[:, 2]) / 2
                    if (middles % 1 != 0).any() or ahead.error[which, y, x] < 0:
                        continue
                    i, j = middles.astype(int).T
                    first = (small[:, 0, 1] < j) | ((small[:, 0, 1] == j) & (small[:, 0, 0] < i))
                    expected = plain.thickness[np.where(first, 0, 1), j, i].max()
                    assert ahead.error[which, y, x] == pytest.approx(expected, rel=1e-5)
                    compared += 1
    assert compared > 15


@pytest.mark.parametrize("view", range(3))
@pytest.mark.parametrize("cluster", CLUSTERS)
def test_clusters_share_all_vertices_of_their_edges(scene: Scene, view: int, cluster: int) -> None:
    state: Any = scene.algorithm("rustic", {"cluster": cluster})
    (corners,) = read_triangles(scene, scene.frame(CAMERAS[view], (160, 100)), state)
    assert corners.shape == (state.bintree.count, cluster, 3)
    # of several sizes
    assert len(np.unique(corners["tile_level"])) > 2
    statistics = state.statistics()
    assert (statistics.patches, statistics.triangles) == (len(corners), corners.size // 3)
    triangles = corners["position"].reshape(-1, 3, 3)
    x, y = triangles[..., 0], triangles[..., 1]
    assert len(torn_edges(triangles, (x.min(), y.min(), x.max(), y.max()))) == 0


@pytest.mark.parametrize(
    ("view", "tau", "cluster", "samples"),
    [(0, 1.0, 64, 1 << 20), (1, 1.0, 16, 1 << 20), (1, 3.0, 4, 1 << 20), (2, 0.5, 64, 1 << 20), (0, 2.0, 4, 4096),
     (1, 3.0, 16, 4096)],
)  # fmt: skip
def test_errors_on_screen_are_within_tau(scene: Scene, view: int, tau: float, cluster: int, samples: int) -> None:
    state: Any = scene.algorithm("rustic", {"tau": tau, "cluster": cluster, "samples": samples})
    assert (state.bintree.wedgies.level > 0) == (samples == 4096)
    frame = scene.frame(CAMERAS[view], (160, 100))
    (drawn,) = read_triangles(scene, frame, state)
    corners = drawn.reshape(-1, 3)
    texels = (corners["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits
    # points in triangles: corners are exact
    weights = np.random.default_rng(view).dirichlet([1, 1, 1], len(corners))
    x, y = np.einsum("tk,tkd->dt", weights, texels)
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
    assert off.max() <= tau + 1e-3
    assert off.max() > 0.05 * tau


def test_larger_clusters_take_fewer_splits(scene: Scene) -> None:
    frame = scene.frame(CAMERAS[0], (160, 100))
    counts = []
    for cluster in CLUSTERS:
        state: Any = scene.algorithm("rustic", {"cluster": cluster})
        scene.record(frame, state)
        counts.append(state.bintree.count)
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 5 * counts[-1]


def test_the_budget_is_one_of_triangles(scene: Scene) -> None:
    state: Any = scene.algorithm("rustic", {"triangles": 20000, "tau": 0.2})
    picture = scene.draw(scene.frame(CAMERAS[0], (160, 100)), state)
    assert 15000 < state.statistics().triangles <= 20000
    assert (picture["depth"] > 0).any()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"tau": -1}, "tau: expected a number of pixels above 0, got -1"),
        ({"cluster": 32}, "cluster: expected 4, 16, 64 or 256 triangles, got 32"),
        ({"triangles": 100}, "triangles: expected at least 512, got 100"),
        ({"milliseconds": -2}, "milliseconds: expected a number above 0, got -2"),
        ({"samples": 0}, "samples: expected at least 4096, got 0"),
    ],
)
def test_settings_out_of_range_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("rustic", values)


def test_a_raster_too_long_for_its_clusters_is_refused() -> None:
    grid = replace(grid_of(noise(2, 2)), width=1 << 24)
    with pytest.raises(SettingsError, match=r"cluster: expected edges halved at most 2 times for a raster of 16777216"):
        subdivision(grid, 4)
    assert subdivision(grid, 2) == (1, 4)


def test_frames_of_one_camera_are_one_frame(scene: Scene) -> None:
    state: Any = scene.algorithm("rustic")
    first = scene.draw(scene.frame(CAMERAS[0], (160, 100)), state)
    scene.draw(scene.frame(CAMERAS[1], (160, 100)), state)
    other = scene.draw(scene.frame(CAMERAS[0], (160, 100)), state)
    for name in first:
        np.testing.assert_array_equal(first[name], other[name])
