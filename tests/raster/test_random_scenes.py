"""Both ways of drawing triangles on random ground: the same pictures, but for pixels whose centres lie on an edge."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.scene import Scene, noise
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.raster.compute import can_rasterize
from orogen.raster.rasterizer import Rasterizer
from raster.test_compute import COLUMNS, ROWS, raster, soup

SIZE = (192, 144)
RELIEF = 80.0
STEP = 1 / 256
"""Pixels to which both ways round the corners of triangles."""


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    if not can_rasterize(gpu):
        pytest.skip("the adapter has no 64-bit atomics")
    with closing(Scene(gpu, noise(ROWS, COLUMNS))) as terrain:
        yield terrain


def ground(random: np.random.Generator, quads: int) -> NDArray[np.float64]:
    """(n, 3) corners of the triangles of a mesh over the terrain, each with three of its own: subtexels and heights."""
    across, down = quads, max(quads * (ROWS - 1) // (COLUMNS - 1), 1)
    columns, rows = np.meshgrid(np.linspace(0, COLUMNS - 1.01, across + 1), np.linspace(0, ROWS - 1.01, down + 1))
    inner = (slice(1, -1), slice(1, -1))
    # nothing is folded over
    columns[inner] += random.uniform(-0.3, 0.3, columns[inner].shape) * (COLUMNS - 1) / across
    rows[inner] += random.uniform(-0.3, 0.3, rows[inner].shape) * (ROWS - 1) / down
    heights = random.uniform(0, RELIEF, columns.shape)
    corners = np.stack([columns * 256, rows * 256, heights], axis=-1)
    a, b, c, d = corners[:-1, :-1], corners[:-1, 1:], corners[1:, :-1], corners[1:, 1:]
    triangles = np.stack([np.stack([a, b, c], axis=2), np.stack([b, d, c], axis=2)], axis=2).reshape(-1, 3, 3)
    return random.permutation(triangles).reshape(-1, 3)


def some_view(scene: Scene, random: np.random.Generator, kind: str) -> Frame:
    column, row = random.uniform(0.2, 0.8) * COLUMNS, random.uniform(0.2, 0.8) * ROWS
    heading, roll = random.uniform(0, 360), random.uniform(-30, 30)
    up, angles = {
        "above": (random.uniform(200, 600), {"pitch": random.uniform(-90, -30), "roll": roll}),
        "grazing": (RELIEF + random.uniform(1, 20), {"pitch": random.uniform(-4, 4)}),
        "within": (random.uniform(0, RELIEF), {"pitch": random.uniform(-30, 30), "near": 1.0}),
        "cut": (RELIEF + 10, {"pitch": random.uniform(-40, -5), "near": random.uniform(30, 150), "roll": roll}),
        "below": (-random.uniform(20, 200), {"pitch": random.uniform(10, 60)}),
        "orthographic": (500.0, {"pitch": random.uniform(-90, -20), "orthographic": random.uniform(60, 900)}),
    }[kind]
    return scene.frame(scene.camera(column, row, up, heading=heading, **angles), SIZE)


def outline(frame: Frame, corners: NDArray[np.floating]) -> NDArray[np.float64]:
    """Corners of a triangle cut at the near plane, in pixels, by float64."""
    texel = corners[:, :2].astype(np.float32).astype(np.float64) / 256 + 0.5
    flat = (texel - frame.eye) @ frame.grid.metres.T
    position = np.column_stack([flat, corners[:, 2].astype(np.float32) - frame.camera.z, np.ones(3)])
    clip = position @ frame.view_projection.T
    inside = clip[:, 3] - clip[:, 2]
    kept = []
    for k in range(3):
        j = (k + 1) % 3
        if inside[k] >= 0:
            kept.append(clip[k])
        if (inside[k] >= 0) != (inside[j] >= 0):
            kept.append(clip[k] + inside[k] / (inside[k] - inside[j]) * (clip[j] - clip[k]))
    polygon = np.array(kept).reshape(-1, 4)
    width, height = frame.size
    return (polygon[:, :2] / polygon[:, 3:] * [0.5, -0.5] + 0.5) * [width, height]


def away(pixel: NDArray[np.float64], polygon: NDArray[np.float64]) -> float:
    """Pixels from a place to the nearest edge of a polygon, less what float32 may move the edge by."""
    best = np.inf
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        along = b - a
        way = np.clip((pixel - a) @ along / max(along @ along, 1e-30), 0, 1)
        best = min(best, float(np.linalg.norm(pixel - a - way * along)) - 1e-6 * float(np.abs([a, b]).max()))
    return best


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 12))])
@pytest.mark.parametrize("kind", ["above", "grazing", "within", "cut", "below", "orthographic"])
def test_pictures_differ_on_edges_alone(gpu: Gpu, scene: Scene, kind: str, seed: int) -> None:
    random = np.random.default_rng(1000 * seed + len(kind))
    different = shown = 0
    # from a few triangles, each wider than the picture, to several in a pixel
    for quads in (2, 12, 80, 300):
        frame = some_view(scene, random, kind)
        vertices = ground(random, quads)
        index = np.arange(len(vertices)).reshape(-1, 3) if quads % 3 else None
        pictures = [raster(scene, frame, [soup(gpu, vertices, index)], path) for path in ("hardware", "compute")]
        shown += int((pictures[0]["depth"] > 0).sum())
        assert_alike(frame, vertices, pictures)
        different += int((seen(pictures[0]) != seen(pictures[1])).sum())
    assert shown > SIZE[0] * SIZE[1] // 4
    assert different <= 1e-4 * 4 * SIZE[0] * SIZE[1]


def test_full_queues_leave_triangles_out_and_say_so(gpu: Gpu, scene: Scene) -> None:
    """What finds no room is left out, nothing else is touched, and there is room the next time."""
    random = np.random.default_rng(5)
    frame = some_view(scene, random, "within")
    draw = soup(gpu, ground(random, 40))
    whole = raster(scene, frame, [draw], "compute")
    for room in ((64, 1 << 16, 1 << 18), (1 << 17, 3, 1 << 18), (1 << 17, 1 << 16, 8)):
        rasterizer = Rasterizer(scene.clipmap, "compute")
        assert rasterizer._compute
        rasterizer._compute._make_room(room)
        surface = rasterizer.surface(frame.size)
        drawn = []
        for again in (True, False):
            encoder = gpu.encoder("raster")
            rasterizer.record(encoder, scene.timer, [draw], scene.view, surface)
            gpu.submit(encoder)
            drawn.append({name: surface.read(name).result() for name in whole})
            assert rasterizer.incomplete() == again
        surface.destroy()
        # what is missing shows what lies behind
        assert (drawn[0]["depth"] <= whole["depth"]).all()
        assert (drawn[0]["depth"] < whole["depth"]).any()
        for name, values in whole.items():
            np.testing.assert_array_equal(drawn[1][name], values)


def seen(picture: dict[str, NDArray[Any]]) -> NDArray[np.int64]:
    """Number of the triangle in each pixel, -1 for the sky."""
    return np.where(picture["depth"] > 0, picture["id"].astype(np.int64) // 3, -1)


def assert_alike(frame: Frame, vertices: NDArray[np.float64], pictures: list[dict[str, NDArray[Any]]]) -> None:
    one, other = (seen(picture) for picture in pictures)
    same = (one == other) & (one >= 0)
    np.testing.assert_allclose(pictures[0]["depth"][same], pictures[1]["depth"][same], rtol=2e-3)
    for row, column in np.argwhere(one != other):
        centre = np.array([column, row]) + 0.5
        triangles = [t for t in (one[row, column], other[row, column]) if t >= 0]
        distances = [away(centre, outline(frame, vertices[3 * t : 3 * t + 3])) for t in triangles]
        # each is drawn in one picture and not in the other, so the centre lies on an edge of one at least
        assert min(distances) <= STEP, (row, column, triangles, distances)
