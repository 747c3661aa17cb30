"""The compute rasteriser against the hardware pipeline, and both against a rasteriser in float64."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.scene import Buffers, Scene, noise
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod.contract import Draw, Module, Patches
from orogen.lod.mesh import MESHLET_TRIANGLES, MESHLET_VERTICES, Mesh, clusters, grid_triangles
from orogen.raster.compute import can_rasterize
from orogen.raster.rasterizer import Rasterizer

HERE = Path(__file__).parent
ROWS, COLUMNS = 60, 80


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    if not can_rasterize(gpu):
        pytest.skip("the adapter has no 64-bit atomics")
    with closing(Scene(gpu, noise(ROWS, COLUMNS))) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def holed(gpu: Gpu) -> Iterator[Scene]:
    if not can_rasterize(gpu):
        pytest.skip("the adapter has no 64-bit atomics")
    heights = noise(ROWS, COLUMNS)
    heights[20:40, 30:50] = np.nan
    with closing(Scene(gpu, heights)) as terrain:
        yield terrain


def soup(gpu: Gpu, vertices: NDArray[np.floating], triangles: Any = None, **changes: Any) -> Patches:
    """A draw of (n, 3) offsets and heights: by index list (`triangles`), or one after the other."""
    layout = gpu.layout("soup", {0: ("VERTEX|COMPUTE", "read")})
    padded = np.concatenate([vertices, np.zeros((len(vertices), 1))], axis=1).astype(np.float32)
    group = gpu.bind("soup", layout, {0: gpu.buffer("soup", padded, "STORAGE", "test")})
    instances = changes.pop("instances", 1)
    if triangles is None:
        arguments = [len(vertices), instances, 0, 0]
    else:
        arguments = [triangles.size, instances, 0, 0, 0]
        changes["index"] = Mesh(gpu, [triangles], "test")
    indirect = gpu.buffer("arguments", np.array(arguments, np.uint32), "INDIRECT|COPY_SRC", "test")
    return Patches(Module(HERE / "soup.wgsl", layout), group, indirect, **{"topology": "triangle-list", **changes})


def raster(scene: Scene, frame: Frame, draws: list[Draw], path: str, room: Any = None) -> Buffers:
    rasterizer = Rasterizer(scene.clipmap, path)
    if room:
        assert rasterizer._compute
        rasterizer._compute._make_room(room)
    while True:
        surface = rasterizer.surface(frame.size)
        encoder = scene.gpu.encoder("raster")
        rasterizer.record(encoder, scene.timer, draws, scene.view, surface)
        scene.gpu.submit(encoder)
        result = {name: surface.read(name).result() for name in ("depth", "id", "detail")}
        surface.destroy()
        if not rasterizer.incomplete():
            return result


def assert_same(one: Buffers, other: Buffers, share: float = 0.999) -> None:
    close = np.isclose(one["depth"], other["depth"], rtol=1e-3)
    assert close.mean() >= share
    assert (one["id"] == other["id"]).mean() >= share
    # levels; distances to edges are rounded to sixteenths
    assert ((one["detail"] >> 16) == (other["detail"] >> 16)).mean() >= share


def random_vertices(count: int, seed: int, spread: float) -> NDArray[np.float64]:
    """Triangles, three vertices each, of sizes from less than a pixel to the whole picture."""
    random = np.random.default_rng(seed)
    middle = random.uniform(0.1, 0.9, (count, 1, 3)) * [COLUMNS, ROWS, 80]
    size = 10 ** random.uniform(-1.5, np.log10(spread), (count, 1, 1))
    vertices = middle + random.normal(0, 1, (count, 3, 3)) * size * [1, 1, 4]
    vertices[..., :2] = np.clip(vertices[..., :2], 0.0, [COLUMNS - 1.01, ROWS - 1.01]) * 256
    return vertices.reshape(-1, 3)


VIEWS: dict[str, dict[str, Any]] = {
    "above": {"z": 500.0, "pitch": -60.0, "heading": 20.0},
    "amid": {"z": 40.0, "pitch": -5.0, "near": 1.0},
    "among large ones": {"z": 60.0, "pitch": -20.0, "heading": 140.0, "near": 30.0},
    "orthographic": {"z": 500.0, "pitch": -50.0, "orthographic": 600.0},
    "rolled": {"z": 200.0, "pitch": -30.0, "roll": 33.0},
}


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("kind", ["list", "strip", "index", "instances"])
def test_both_paths_draw_the_same(gpu: Gpu, scene: Scene, view: str, kind: str) -> None:
    angles = dict(VIEWS[view])
    frame = scene.frame(scene.camera(40, 30, angles.pop("z"), **angles), (160, 120))
    vertices = random_vertices(400, seed=len(view), spread=12.0)
    draw = {
        "list": lambda: soup(gpu, vertices),
        "strip": lambda: soup(gpu, vertices[::3], topology="triangle-strip"),
        "index": lambda: soup(gpu, vertices, np.random.default_rng(1).permutation(1200).reshape(-1, 3)[:150]),
        "instances": lambda: soup(gpu, vertices, np.arange(1200).reshape(-1, 3), instances=3),
    }[kind]()
    hardware, compute = (raster(scene, frame, [draw], path) for path in ("hardware", "compute"))
    assert (hardware["depth"] > 0).mean() > 0.1
    assert_same(hardware, compute, 0.998)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("path", ["hardware", "compute"])
def test_pixels_are_those_of_the_nearest_triangle(gpu: Gpu, scene: Scene, view: str, path: str) -> None:
    angles = dict(VIEWS[view])
    frame = scene.frame(scene.camera(40, 30, angles.pop("z"), **angles), (120, 90))
    vertices = random_vertices(60, seed=7, spread=15.0)
    drawn = raster(scene, frame, [soup(gpu, vertices)], path)
    nearest, depth, sure = oracle(frame, vertices)
    assert sure.mean() > 0.7
    seen = np.where(drawn["depth"] > 0, drawn["id"].astype(np.int64) // 3, -1)
    np.testing.assert_array_equal(seen[sure], nearest[sure])
    hit = sure & (nearest >= 0)
    np.testing.assert_allclose(drawn["depth"][hit], depth[hit], rtol=2e-3)


def oracle(frame: Frame, vertices: NDArray[np.floating]) -> tuple[NDArray, NDArray, NDArray]:
    """Nearest triangle per pixel (-1: none), its depth, and where this is beyond doubt; by homogeneous edges."""
    texel = vertices[:, :2].astype(np.float32) / 256 + 0.5
    flat = (texel - frame.eye) @ frame.grid.metres.T
    position = np.column_stack([flat, vertices[:, 2] - frame.camera.z, np.ones(len(vertices))])
    clip = (position @ frame.view_projection.T).reshape(-1, 3, 4)
    width, height = frame.size
    ndc = np.stack(
        np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1, 1 - (np.arange(height) + 0.5) / height * 2), axis=-1
    )
    pixel = np.concatenate([ndc, np.ones((height, width, 1))], axis=-1)
    best, nearest = np.zeros((height, width)), np.full((height, width), -1)
    sure = np.ones((height, width), bool)
    for number, corners in enumerate(clip):
        edges = np.cross(np.roll(corners, -1, axis=0)[:, [0, 1, 3]], np.roll(corners, -2, axis=0)[:, [0, 1, 3]])
        volume = float(np.dot(corners[0, [0, 1, 3]], edges[0]))
        if volume == 0:
            continue
        weights = pixel @ edges.T / volume
        total = weights.sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = weights / total[..., None]
            # depth after the division by w
            depth = (weights @ corners[:, 2]) / (weights @ corners[:, 3])
            slope = np.linalg.norm(edges[:, :2] * [2 / width, 2 / height], axis=1) / abs(volume)
        inside = (weights > 0).all(axis=-1) & (depth <= 1) & (total > 0)
        # within a fiftieth of a pixel of an edge rounding decides
        close = (np.abs(weights) < 0.02 * slope).any(axis=-1) & (weights > -0.05 * slope).all(axis=-1)
        close |= inside & (np.abs(depth - 1) < 1e-3)
        close |= inside & (np.abs(depth - best) < 3e-3 * best)
        front = inside & (depth > best)
        sure &= ~(close & (depth > best * 0.99)) | ~np.isfinite(share).all(axis=-1)
        best, nearest = np.where(front, depth, best), np.where(front, number, nearest)
    return nearest, best, sure


def test_a_grid_has_no_holes(gpu: Gpu, scene: Scene) -> None:
    """Each pixel inside belongs to a triangle, also where corners lie on pixels' centres."""
    frame = scene.frame(scene.camera(40, 30, 400.0, pitch=-90.0, orthographic=300.0), (150, 150))
    triangles = grid_triangles(COLUMNS - 1, ROWS - 1)
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    random = np.random.default_rng(3)
    inner = (rows > 0) & (columns > 0) & (rows < ROWS - 1) & (columns < COLUMNS - 1)
    for wobble in (0.0, 0.3):
        moved = np.stack([columns, rows], axis=-1) + wobble * inner[..., None] * random.uniform(
            -1, 1, (ROWS, COLUMNS, 2)
        )
        vertices = np.concatenate([moved * 256, random.uniform(0, 50, (ROWS, COLUMNS, 1))], axis=-1).reshape(-1, 3)
        for draw in (soup(gpu, vertices, triangles), soup(gpu, vertices[triangles.ravel()])):
            drawn = raster(scene, frame, [draw], "compute")
            assert (drawn["depth"] > 0).all()


def test_voids_are_left_out(gpu: Gpu, holed: Scene) -> None:
    frame = holed.frame(holed.camera(40, 30, 500.0, pitch=-70.0), (120, 100))
    corners = np.array([[0, 0], [COLUMNS - 1, 0], [0, ROWS - 1], [COLUMNS - 1, ROWS - 1]]) * 256
    small = grid_triangles(40, 30)
    rows, columns = np.mgrid[:31, :41]
    fine = np.stack([columns * (COLUMNS - 1) / 40, rows * (ROWS - 1) / 30], axis=-1).reshape(-1, 2) * 256
    for vertices, triangles in ((corners, np.array([[0, 1, 2], [2, 1, 3]])), (fine, small)):
        draw = soup(gpu, np.column_stack([vertices, np.full(len(vertices), 30.0)]), triangles)
        hardware, compute = (raster(holed, frame, [draw], path) for path in ("hardware", "compute"))
        assert 0.02 < ((hardware["depth"] == 0)[20:80, 20:100]).mean() < 0.5
        assert_same(hardware, compute)


def test_what_overhangs_is_left_out(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 30, 900.0, pitch=-80.0), (120, 100))
    low, high = np.array([-30.0, -20.0]), np.array([COLUMNS + 25.0, ROWS + 30.0])
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [low[0], high[1]], [high[0], high[1]]]) * 256
    vertices = np.column_stack([corners, np.full(4, 30.0)])
    draw = soup(gpu, vertices, np.array([[0, 1, 2], [2, 1, 3]]))
    hardware, compute = (raster(scene, frame, [draw], path) for path in ("hardware", "compute"))
    assert 0.1 < (hardware["depth"] > 0).mean() < 0.9
    assert_same(hardware, compute)


def test_queues_grow_until_nothing_is_missing(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 30, 60.0, pitch=-20.0, near=1.0), (160, 120))
    vertices = random_vertices(300, seed=4, spread=20.0)
    draw = soup(gpu, vertices)
    expected = raster(scene, frame, [draw], "compute")
    small = raster(scene, frame, [draw], "compute", room=(64, 4, 16))
    for name, values in expected.items():
        np.testing.assert_array_equal(small[name], values)


def test_several_draws_share_a_picture(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 30, 300.0, pitch=-50.0), (160, 120))
    triangles = np.arange(300).reshape(-1, 3)
    draws: list[Draw] = [
        soup(gpu, random_vertices(100, seed=1, spread=5.0), triangles),
        soup(gpu, random_vertices(100, seed=2, spread=5.0), triangles[::-1]),
        soup(gpu, random_vertices(100, seed=3, spread=5.0)),
    ]
    assert_same(raster(scene, frame, draws, "hardware"), raster(scene, frame, draws, "compute"), 0.998)


def test_meshlets_hold_every_triangle_once() -> None:
    random = np.random.default_rng(9)
    for triangles in (grid_triangles(33, 21), grid_triangles(1, 1), random.integers(0, 700, (1000, 3))):
        groups = clusters(triangles)
        np.testing.assert_array_equal(np.concatenate(groups), triangles)
        for group in groups:
            assert len(group) <= MESHLET_TRIANGLES
            assert len(np.unique(group)) <= MESHLET_VERTICES
    # a grid shares most vertices: far fewer than three a triangle
    for side in (16, 32, 64):
        assert np.mean([len(np.unique(group)) / len(group) for group in clusters(grid_triangles(side, side))]) < 1.1


def test_bad_requests_say_what_there_is(gpu: Gpu, scene: Scene) -> None:
    with pytest.raises(SettingsError, match="hardware"):
        Rasterizer(scene.clipmap, "software")
    with pytest.raises(SettingsError, match="vertex numbers"):
        Mesh(gpu, [np.zeros((4, 2), int)], "test")
