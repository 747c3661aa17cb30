"""A terrain that no memory holds: pictures are right wherever the camera flies, and what is kept does not grow."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import orogen
from orogen.camera import Camera
from orogen.pyramid import open_pyramid
from orogen.source import open_height
from orogen.streaming.ranges import WHOLE, NodeRanges
from orogen.streaming.requests import LayerGrid
from orogen.terrain import Terrain

SIZE = (160, 90)
MEMORY = 24 << 20


@pytest.fixture(scope="module")
def terrain() -> Iterator[Terrain]:
    settings = {"memory": 80 << 20, "host_memory": MEMORY}
    with orogen.open("procedural", algorithm="raycast", settings=settings) as terrain:
        yield terrain


def overlook(terrain: Terrain, x: float, y: float, above: float) -> Camera:
    """A camera so many metres above the ground that looks down to the north."""
    ground = terrain.height_at(x, y)
    return Camera(x=x, y=y, z=float(ground) + above, heading=10, pitch=-35)


def surface(terrain: Terrain, x: float, y: float) -> float:
    """Height of level 0 at a place: bilinear between the four samples around it."""
    column, row = (float(n) - 0.5 for n in terrain.grid.to_texel(x, y))
    i, j = int(column // 1), int(row // 1)
    (a, b), (c, d) = terrain.heights.source.read(slice(j, j + 2), slice(i, i + 2)).tolist()
    u, v = column - i, row - j
    return (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v


def test_pictures_are_right_wherever_the_camera_flies(terrain: Terrain) -> None:
    spot = (1_234_567.25, 3_456_789.5)
    far = (spot[0] + 1_000_000, spot[1] - 1_000_000)
    camera = overlook(terrain, *spot, 300)
    first = terrain.render(camera, SIZE, samples=1)
    rng = np.random.default_rng(0)
    kept = []
    for x, y, above in ((*far, 60.0), (4_000_000.5, 200.75, 30_000.0), (*spot, 100_000.0), (*spot, 300.0)):
        camera = overlook(terrain, x, y, above)
        picture = terrain.render(camera, SIZE, samples=1)
        at = picture.position[picture.reverse_depth > 0]
        assert len(at) > 0.6 * SIZE[0] * SIZE[1]
        at = at[rng.choice(len(at), 150, replace=False)]
        true = np.array([surface(terrain, *point) for point in at[:, :2]])
        away = np.hypot(np.hypot(at[:, 0] - x, at[:, 1] - y), at[:, 2] - camera.z)
        # a pixel covers that much of what is so far away, and levels are about as fine
        pixel = away * 2 * np.tan(np.radians(22.5)) / SIZE[1]
        apart = np.abs(at[:, 2] - true) / pixel
        assert np.percentile(apart, 99) < 1
        assert np.mean(apart) < 0.25
        layer = terrain.renderer.clipmap.heights
        ranges = layer._ranges
        assert ranges is not None
        assert len(layer.atlas.resident) <= layer.atlas.capacity
        assert layer.tiles.size <= MEMORY
        kept.append(sum(part.table.nbytes for parts in ranges._parts.values() for part in parts))
    assert max(kept) < 4 << 20
    # back where it began
    np.testing.assert_array_equal(picture.color, first.color)


def test_bounds_around_the_camera_hold_what_is_there(terrain: Terrain) -> None:
    pyramid = terrain.heights
    layer = terrain.renderer.clipmap.heights
    rng = np.random.default_rng(3)
    for level in (0, 3, 9, pyramid.level_count - 1):
        count = layer.grid.nodes(level)
        rows, cols = (rng.integers(max(0, n // 2 - 20), min(n, n // 2 + 20), 30) for n in count)
        low, high = layer.bounds(level, rows, cols)
        for row, col, lowest, highest in list(zip(rows, cols, low, high, strict=True))[:4]:
            part = pyramid.read(level, *(slice(int(n) * 256, int(n) * 256 + 256) for n in (row, col)))
            assert lowest <= part.min()
            assert part.max() <= highest


@pytest.mark.parametrize("node_size", [256, 512])
def test_parts_of_a_level_are_what_the_whole_level_says(node_size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """`WHOLE` decides only how much is kept."""
    rng = np.random.default_rng(1)
    heights = rng.normal(size=(1800, 2300)).astype(np.float32).cumsum(axis=0)
    heights[:600, :700] = np.nan
    with open_pyramid(open_height(heights, spacing=1)) as pyramid:
        grid = LayerGrid(pyramid.grid, pyramid.level_count, node_size)
        assert max(grid.nodes(0)) <= WHOLE
        whole = NodeRanges(pyramid, grid)
        monkeypatch.setattr("orogen.streaming.ranges.WHOLE", 0)
        monkeypatch.setattr("orogen.streaming.ranges.SPARE", 1)
        parts = NodeRanges(pyramid, grid)
        for level in (0, 1, 0, 2, 0):
            rows, cols = (rng.integers(-2, n + 2, (5, 3)) for n in grid.nodes(level))
            found = parts.over(level, rows, cols)
            np.testing.assert_array_equal(found, whole.over(level, rows, cols))
            # of a node's own samples, and of those around it
            side = node_size << level
            row, col = (
                min(max(int(n[0, 0]), 0), count - 1) for n, count in zip((rows, cols), grid.nodes(level), strict=True)
            )
            own = heights[row * side : (row + 1) * side, col * side : (col + 1) * side]
            if np.isfinite(own).any():
                assert found[0, 0, 0] <= np.nanmin(own)
                assert found[0, 0, 1] >= np.nanmax(own)
            else:
                assert (found[0, 0, :2] == pyramid.height_range).all() or np.isfinite(found[0, 0]).all()
        assert parts.over(0, np.zeros((0,), int), np.zeros((0,), int)).shape == (0, 3)
