"""Patches chosen on the CPU: cover, distances, visibility and neighbours, against maps of single samples."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.scene import SPACING, Scene, noise
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import quadtree
from orogen.lod.quadtree import Leaves, PatchFrame, PatchTree, neighbours
from orogen.streaming.clipmap_view import ClipmapView

SIDE = 8
ROWS, COLUMNS = 150, 219
VIEWS: dict[str, dict[str, Any]] = {
    "over": {"z": 900.0, "pitch": -50.0, "heading": 30.0},
    "low": {"z": 90.0, "pitch": -5.0, "heading": 200.0},
    "down": {"z": 400.0, "pitch": -90.0},
    "rolled": {"z": 300.0, "pitch": -20.0, "heading": 80.0, "roll": 40.0},
    "flat": {"z": 300.0, "pitch": -60.0, "orthographic": 700.0},
}


@pytest.fixture(scope="module")
def heights() -> NDArray[np.float32]:
    return noise(ROWS, COLUMNS, 80.0)


@pytest.fixture(scope="module", params=["square", "sheared"])
def scene(gpu: Gpu, heights: NDArray[np.float32], request: pytest.FixtureRequest) -> Iterator[Scene]:
    metres = np.array([[9.0, 4.0], [2.0, -11.0]]) if request.param == "sheared" else None
    with closing(Scene(gpu, heights, metres=metres)) as terrain:
        yield terrain


@pytest.fixture(params=VIEWS)
def patches(scene: Scene, request: pytest.FixtureRequest) -> tuple[PatchFrame, Frame, ClipmapView]:
    angles = dict(VIEWS[request.param])
    frame = scene.frame(scene.camera(90, 80, angles.pop("z"), **angles))
    return PatchFrame(PatchTree(scene.pyramid.grid, SIDE), frame, scene.view), frame, scene.view


@pytest.fixture(params=["compiled", "numpy"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways of choosing."""
    if request.param == "numpy":
        monkeypatch.setattr(quadtree, "kernels", lambda: None)
    else:
        pytest.importorskip("numba")


def near(patches: PatchFrame, factor: float) -> Any:
    """Split where a patch is nearer than so many of its sides."""
    return lambda level, x, y: patches.distance(level, x, y) < factor * SPACING * (SIDE << level)


def level_map(tree: PatchTree, leaves: Leaves) -> NDArray[np.int64]:
    """Level of the leaf over every quad of samples, -1 where none is; fails where two overlap."""
    quads = np.full((ROWS - 1, COLUMNS - 1), -1)
    for level, x, y in zip(*(part.tolist() for part in leaves), strict=True):
        side = SIDE << level
        part = quads[y * side : (y + 1) * side, x * side : (x + 1) * side]
        assert part.size
        assert (part == -1).all()
        part[:] = level
    return quads


def seen_samples(frame: Frame, heights: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which samples lie in the frustum."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    flat = (np.stack([columns, rows], axis=-1) + 0.5 - frame.eye) @ frame.grid.metres.T
    points = np.concatenate([flat, heights[..., None] - frame.camera.z], axis=-1)
    planes = frame.planes()
    return (points @ planes[:, :3].T + planes[:, 3] >= 0).all(axis=-1)


def test_the_top_patch_covers_the_data() -> None:
    from orogen.grid import Grid

    for width, height in ((1, 1), (9, 9), (10, 3), (1025, 1025), (1026, 2)):
        tree = PatchTree(Grid(width, height, (1, 0, 0, 0, -1, 0)), SIDE)
        assert tree.shape(tree.level_count - 1) == (1, 1)
        assert SIDE << (tree.level_count - 1) >= max(width, height) - 1
        assert tree.level_count == 1 or SIDE << (tree.level_count - 2) < max(width, height) - 1


@pytest.mark.parametrize("restricted", [False, True])
def test_leaves_cover_what_is_seen_once(patches: Any, heights: NDArray[np.float32], restricted: bool) -> None:
    chosen, frame, _ = patches
    leaves = chosen.select(near(chosen, 3.0), restricted=restricted)
    levels = level_map(chosen.tree, leaves)
    assert len(np.unique(levels)) >= 2
    seen = seen_samples(frame, heights)
    assert seen.sum() > 100
    rows, columns = np.nonzero(seen)
    # a sample belongs to the quads on either side
    assert (levels[np.minimum(rows, ROWS - 2), np.minimum(columns, COLUMNS - 2)] >= 0).all()


def test_restricted_leaves_differ_by_one_level(patches: Any) -> None:
    chosen, _, _ = patches
    # a decision that jumps: the finest level in a few places, the coarsest elsewhere
    rng = np.random.default_rng(5)
    fine = {(int(x), int(y)) for x, y in rng.integers(0, 20, (6, 2))}

    def split(level: int, x: NDArray, y: NDArray) -> NDArray:
        return np.array(
            [any((fx >> level, fy >> level) == (a, b) for fx, fy in fine) for a, b in zip(x, y, strict=True)]
        )

    free = level_map(chosen.tree, chosen.select(split))
    bound = level_map(chosen.tree, chosen.select(split, restricted=True))
    assert ((bound <= free) | (bound == -1) | (free == -1)).all()
    for axis in (0, 1):
        steps = np.abs(np.diff(bound, axis=axis))
        both = (np.minimum(bound[1:], bound[:-1]) if axis == 0 else np.minimum(bound[:, 1:], bound[:, :-1])) >= 0
        assert steps[both].max(initial=0) <= 1


def test_neighbours_are_those_beyond_the_edges(patches: Any, way: None) -> None:
    chosen, _, _ = patches
    leaves = chosen.select(near(chosen, 2.0))
    levels = level_map(chosen.tree, leaves)
    listed = list(zip(*(part.tolist() for part in leaves), strict=True))
    beyond = {most: neighbours(leaves, most).tolist() for most in (1, chosen.tree.level_count)}
    coarser = 0
    for (level, x, y), *found in zip(listed, *beyond.values(), strict=True):
        side = SIDE << level
        row, column = y * side, x * side
        places = [(row, column - 1), (row, column + side), (row - 1, column), (row + side, column)]
        for (r, c), one, other in zip(places, *found, strict=True):
            there = levels[r, c] if 0 <= r < ROWS - 1 and 0 <= c < COLUMNS - 1 else -1
            expected = (there, c // (SIDE << there), r // (SIDE << there)) if there >= level else None
            assert (listed[other] if other >= 0 else None) == expected
            assert one == (other if there <= level + 1 else -1)
            coarser += there > level
    assert coarser or len(np.unique(levels[levels >= 0])) == 1


def test_distances_are_to_the_nearest_point_of_the_box(patches: Any, way: None) -> None:
    chosen, frame, _ = patches
    lod = frame.lod_eye()
    for level in (0, 2):
        rows, columns = chosen.tree.shape(level)
        y, x = (a.ravel() for a in np.mgrid[:rows, :columns])
        low, high = chosen.bounds(level, x, y)
        first, last = chosen.tree.samples(level, x, y)
        way = np.linspace(0, 1, 17)
        u, v, w = (a.ravel() for a in np.meshgrid(way, way, way))
        column = first[:, :1] + u * (last - first)[:, :1]
        row = first[:, 1:] + v * (last - first)[:, 1:]
        z = low[:, None] + w * (high - low)[:, None]
        flat = (np.stack([column, row], axis=-1) + 0.5 - frame.eye) @ frame.grid.metres.T - lod[:2]
        dense = np.sqrt((flat**2).sum(axis=-1) + (z - frame.camera.z - lod[2]) ** 2).min(axis=1)
        found = chosen.distance(level, x, y)
        step = SPACING * (SIDE << level) / 16 + (high - low) / 16
        assert (found <= dense + 1e-6).all()
        assert (found >= dense - 2 * step).all()
        points = chosen.distance_to(column[:, 0], row[:, 0], z[:, 0])
        np.testing.assert_allclose(
            points, np.sqrt((flat[:, 0] ** 2).sum(axis=-1) + (z[:, 0] - frame.camera.z - lod[2]) ** 2), rtol=1e-9
        )


def test_bounds_hold_the_samples(patches: Any, heights: NDArray[np.float32]) -> None:
    chosen, _, _ = patches
    for level in range(chosen.tree.level_count):
        rows, columns = chosen.tree.shape(level)
        y, x = (a.ravel() for a in np.mgrid[:rows, :columns])
        low, high = chosen.bounds(level, x, y)
        first, last = chosen.tree.samples(level, x, y)
        for (c0, r0), (c1, r1), lo, hi in zip(first, last, low, high, strict=True):
            part = heights[r0 : r1 + 1, c0 : c1 + 1]
            assert lo <= part.min()
            assert hi >= part.max()


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("view_distance", [0.3, 0.02])
def test_bounds_hold_what_is_drawn_from_any_level(gpu: Gpu, view: str, view_distance: float) -> None:
    # a few single peaks: means of coarser levels reach where no sample is high
    rough = noise(700, 900, 5.0)
    rough[np.random.default_rng(2).random(rough.shape) < 3e-4] = 3000.0
    angles = dict(VIEWS[view])
    with closing(Scene(gpu, rough, view_distance=view_distance)) as scene:
        frame = scene.frame(scene.camera(300, 260, angles.pop("z") + 60.0, **angles), (160, 120))
        drawn = scene.draw(frame, scene.algorithm("raycast"))["depth"]
        x, y, z = frame.positions(drawn)[drawn > 0].T
        column, row = (v - 0.5 for v in frame.grid.to_texel(x, y))
        chosen = PatchFrame(PatchTree(scene.pyramid.grid, SIDE), frame, scene.view)
        assert len(z) > 3000
        for level in range(5):
            px, py = ((v / (SIDE << level)).astype(np.int64) for v in (column, row))
            low, high = chosen.bounds(level, px, py)
            slack = 1e-3 + 1e-5 * np.abs(z - frame.camera.z)
            assert (z >= low - slack).all()
            assert (z <= high + slack).all()


def test_bounds_are_close_where_the_data_is_at_hand(gpu: Gpu) -> None:
    slope = np.tile(3.0 * np.arange(400, dtype=np.float32), (300, 1))
    with closing(Scene(gpu, slope)) as scene:
        frame = scene.frame(scene.camera(200, 150, 3000.0, pitch=-90.0))
        chosen = PatchFrame(PatchTree(scene.pyramid.grid, 16), frame, scene.view)
        x, y = np.arange(20), np.full(20, 5)
        low, high = chosen.bounds(0, x, y)
        # 16 samples rise by 48 m; blocks and their surroundings by at most 4.5 times that, a node by 768 m
        assert (high - low <= 4.5 * 48).all()
        assert (low <= 48.0 * x).all()
        assert (high >= 48.0 * (x + 1)).all()


def test_a_view_of_the_sky_has_few_patches(scene: Scene) -> None:
    frame = scene.frame(scene.camera(90, 80, 500.0, pitch=80.0))
    chosen = PatchFrame(PatchTree(scene.pyramid.grid, SIDE), frame, scene.view)
    # boxes around the camera cross every plane without being seen
    assert chosen.select(near(chosen, 3.0)).x.size < 10
