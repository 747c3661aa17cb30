"""The ray caster's traversal against exact float64 intersection, and whether anything slips through."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.scene import SPACING, Scene, noise
from oracle.cellwalk import first_hits
from oracle.landscapes import hills
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.keys import NodeKey, level_shape
from orogen.lod.raycast.probe import Probe
from orogen.lod.raycast.watertight import crossing_rays, lost_rays
from orogen.streaming.clipmap import SEARCH

Rays = tuple[NDArray[np.float64], NDArray[np.float64]]


def spiky() -> NDArray[np.float32]:
    heights = noise(140, 300)
    heights[np.random.default_rng(2).random(heights.shape) < 0.01] = 900
    return heights


def pierced() -> NDArray[np.float32]:
    heights = noise(140, 300)
    heights[np.random.default_rng(4).random(heights.shape) < 0.08] = np.nan
    heights[40:70, 90:150] = np.nan
    return heights


TERRAINS = {
    "rough": lambda: noise(300, 140),
    "spiky": spiky,
    "pierced": pierced,
    "smooth": lambda: hills(270, 400.0).astype(np.float32),
    "2 x 2": lambda: noise(2, 2),
    "3 x 2": lambda: noise(3, 2),
    "2 x 500": lambda: noise(2, 500),
}


def every_direction(frame: Frame, count: int, seed: int) -> Rays:
    """Rays from in, over, under and outside the terrain; some along the axes, level, or straight down or up."""
    random = np.random.default_rng(seed)
    extent = np.array([frame.grid.width, -frame.grid.height]) * SPACING
    flat = random.uniform(-0.3, 1.3, (count, 2)) * extent - [frame.camera.x, frame.camera.y]
    origin = np.column_stack([flat, random.uniform(-100, 1000, count) - frame.camera.z])
    direction = random.normal(size=(count, 3))
    direction[:, 2] *= 10 ** random.uniform(-3, 1, count)
    kind = random.integers(0, 8, count)
    for axis in (0, 1):
        direction[kind == axis, axis] = 0
    direction[kind == 2, :2] = 0
    direction[kind == 3, 2] = 0
    # what the GPU is given
    return origin.astype(np.float32).astype(np.float64), direction.astype(np.float32).astype(np.float64)


def at_height(frame: Frame, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres of the data of camera-relative points."""
    drop = frame.curvature_factor * (points[:, :2] ** 2).sum(axis=1)
    return (points[:, 2] + drop + frame.camera.z) / frame.exaggeration


def texels(frame: Frame, points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points[:, :2] @ np.linalg.inv(frame.grid.metres).T + frame.eye


@pytest.mark.parametrize("curvature", [False, True])
@pytest.mark.parametrize("terrain", TERRAINS)
def test_random_rays_hit_where_exact_intersection_says(gpu: Gpu, terrain: str, curvature: bool) -> None:
    heights = TERRAINS[terrain]()
    rows, columns = heights.shape
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(
            scene.camera(columns * 0.37, rows * 0.61, 150), curvature=curvature, exaggeration=1.0 + curvature
        )
        origin, direction = every_direction(frame, 8000, seed=rows)
        hits = Probe(scene.clipmap).cast(scene.view, origin, direction)
    expected = first_hits(frame, heights, origin, direction)
    expected = np.where(expected >= 0, expected, np.nan)
    found = ~np.isnan(hits.t)
    assert found.sum() > 15
    # rays that graze an edge of the data or of a hole may fall on either side of it
    assert (found != ~np.isnan(expected)).sum() <= 2
    both = found & ~np.isnan(expected)
    apart = np.abs(hits.t - expected)[both] * np.linalg.norm(direction[both], axis=1)
    # so may those that graze a crest
    assert (apart > 0.02).sum() <= 2
    assert (hits.level[both] == 0).all()
    assert (hits.level[~found] == -1).all()

    points = origin[found] + hits.t[found, None].astype(np.float64) * direction[found]
    z = at_height(frame, points)
    np.testing.assert_allclose(hits.height[found], z, atol=0.01)
    if np.isfinite(heights).all():
        surface = TrueSurface(heights)
        at = np.clip(texels(frame, points), 0.5, [columns - 0.5, rows - 0.5])
        slope = np.hypot(*surface.gradient(*at.T)) / SPACING
        reach = np.linalg.norm(points, axis=1) + np.linalg.norm(origin[found], axis=1)
        # float32 of the position, carried up the slope
        assert (np.abs(z - surface.height(*at.T)) <= 1e-3 + 4e-7 * reach * (1 + slope)).all()


@pytest.fixture(scope="module")
def rough(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, noise(300, 400))) as scene:
        yield scene


def test_straight_down_and_up(rough: Scene) -> None:
    heights = noise(300, 400)
    frame = rough.frame(rough.camera(200, 150, 100))
    random = np.random.default_rng(0)
    i, j = random.integers(0, 400, 500), random.integers(0, 300, 500)
    # sample centres are whole subtexels: exact in float32
    origin = np.column_stack([(i + 0.5 - 200) * SPACING, -(j + 0.5 - 150) * SPACING, np.zeros(500)])
    probe = Probe(rough.clipmap)
    inside = (i > 0) & (i < 399) & (j > 0) & (j < 299)
    down = probe.cast(rough.view, origin, [0.0, 0.0, -1.0])
    np.testing.assert_allclose(100 - down.t[inside], heights[j, i][inside], atol=1e-4)
    assert np.isnan(probe.cast(rough.view, origin, [0.0, 0.0, 1.0]).t).all()
    # from under the ground the surface is met from below
    under = probe.cast(rough.view, origin - [0, 0, 200], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(under.t[inside] - 100, heights[j, i][inside], atol=1e-4)
    assert frame.camera.z == 100


def test_a_range_ends_a_ray(rough: Scene) -> None:
    rough.frame(rough.camera(200, 150, 100))
    probe = Probe(rough.clipmap)
    t = float(probe.cast(rough.view, [0.0, 0.0, 0.0], [0.0, 0.0, -2.0]).t[0])
    assert np.isnan(probe.cast(rough.view, [0.0, 0.0, 0.0], [0.0, 0.0, -2.0], end=t * 0.999).t[0])
    assert probe.cast(rough.view, [0.0, 0.0, 0.0], [0.0, 0.0, -2.0], end=t * 1.001).t[0] == np.float32(t)
    # from beyond it nothing is left: the ray is under the ground already
    assert np.isnan(probe.cast(rough.view, [0.0, 0.0, 0.0], [0.0, 0.0, -2.0], start=t * 1.001).t[0])


def test_no_rays_are_no_hits(rough: Scene) -> None:
    rough.frame(rough.camera(200, 150, 100))
    assert Probe(rough.clipmap).cast(rough.view, np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)


def test_crossing_rays_cross(rough: Scene) -> None:
    frame = rough.frame(rough.camera(10, 290, 5000), curvature=True)
    start, end = crossing_rays(frame, 4000, np.random.default_rng(1))
    heights = TrueSurface(noise(300, 400))
    for points, sign in ((start, 1), (end, -1)):
        at = texels(frame, points)
        assert (at > 0.5).all()
        assert (at < [399.5, 299.5]).all()
        assert (sign * (at_height(frame, points) - heights.height(*at.T)) > 0).all()
    # a quarter each through corners and along borders of cells
    middle = (texels(frame, start) + texels(frame, end))[1::4] / 2 - 0.5
    near = np.abs(middle - np.round(middle)).max(axis=1) < 1e-6
    assert near.mean() > 0.4
    along = np.abs(texels(frame, start) - texels(frame, end))[2::4].min(axis=1)
    assert (along < 1e-9).all()


@pytest.mark.parametrize("curvature", [False, True])
def test_no_ray_is_lost_at_level_0(rough: Scene, curvature: bool) -> None:
    frame = rough.frame(rough.camera(123.4, 56.7, 800), curvature=curvature)
    assert lost_rays(Probe(rough.clipmap), rough.view, frame, 60_000) == 0


@pytest.mark.parametrize("view_distance", [0.3, 1.0, 4.0])
def test_no_ray_is_lost_between_levels(gpu: Gpu, view_distance: float) -> None:
    shape = (700, 1025)
    heights = noise(*shape) + hills(1025, 900.0).astype(np.float32)[:700]
    random = np.random.default_rng(int(view_distance * 10))
    with closing(Scene(gpu, heights, view_distance=view_distance)) as scene:
        top = scene.pyramid.level_count - 1
        keys = [NodeKey(top, 0, 0)]
        for level in range(top):
            rows, columns = (-(-n // 256) for n in level_shape(shape, level))
            keys += [NodeKey(level, x, y) for y in range(rows) for x in range(columns) if random.random() < 0.5]
        scene.load(keys)
        frame = scene.frame(scene.camera(500.4, 400.2, 1200), load=False)
        probe = Probe(scene.clipmap)
        start, end = crossing_rays(frame, 4000, random)
        levels = np.unique(probe.cast(scene.view, start, end - start, 0.0, 1.0).level)
        assert len(levels) >= 2
        assert lost_rays(probe, scene.view, frame, 40_000) == 0


def test_lost_rays_are_counted(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(20, 30))) as scene:
        # nothing is loaded, so there is nothing to hit
        frame = scene.frame(scene.camera(5, 5, 100), load=False)
        assert lost_rays(Probe(scene.clipmap), scene.view, frame, 300) == 300


def test_lost_rays_need_terrain_without_holes(gpu: Gpu) -> None:
    with closing(Scene(gpu, pierced())) as scene:
        frame = scene.frame(scene.camera(5, 5, 100))
        with pytest.raises(SettingsError, match="without missing data"):
            lost_rays(Probe(scene.clipmap), scene.view, frame, 300)


def test_a_hole_has_no_walls_and_shows_the_underside(gpu: Gpu) -> None:
    heights = np.full((40, 40), 100.0, np.float32)
    heights[10:30, 10:30] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        scene.frame(scene.camera(20, 20, 100))
        probe = Probe(scene.clipmap)
        # in through the hole, down at 45 degrees, then below the plateau: nothing
        assert np.isnan(probe.cast(scene.view, [0.0, 0.0, 50.0], [1.0, 0.0, -1.0]).t[0])
        # coverage is one half in the middle between the last valid sample and the first missing one: at texel 10
        probes = probe.cast(scene.view, [[-99.9, 0, 50], [-100.1, 0, 50]], [0.0, 0.0, -1.0])
        np.testing.assert_array_equal(np.isnan(probes.t), [True, False])
        # from within the ground up: the underside beside the hole, the sky in it
        up = probe.cast(scene.view, [[0.0, 0.0, -50.0], [150.0, 0.0, -50.0]], [0.0, 0.0, 1.0])
        np.testing.assert_allclose(up.t, [np.nan, 50.0], atol=1e-3)
        # the data's outer edge is open too: level, below the surface, from outside
        assert np.isnan(probe.cast(scene.view, [-1000.0, 0.0, -30.0], [1.0, 0.0, 0.0]).t[0])


def test_a_twisted_cell_is_left_through_its_hole_and_entered_again(gpu: Gpu) -> None:
    # saddle: the ray comes up through the missing corner's quarter and goes down again in the valid part
    heights = np.array([[0, 10, 10], [10, 0, 0], [10, 0, 0]], np.float32) * 8
    heights[0, 0] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(1.5, 1.5, 0))
        box = np.random.default_rng(0).uniform([-10, 0, 20], [0, 10, 70], (2, 20_000, 3))
        start, end = box.astype(np.float32).astype(np.float64)
        hits = Probe(scene.clipmap).cast(scene.view, start, end - start, 0.0, 1.0)
    expected = first_hits(frame, heights, start, end - start)
    expected = np.where(expected <= 1, expected, np.nan)
    agree = np.isclose(hits.t, expected, atol=1e-3, equal_nan=True)
    assert (~np.isnan(expected)).sum() > 1000
    assert agree.mean() > 0.999


def test_a_camera_farther_than_integers_reach_sees_the_coarsest_level(gpu: Gpu) -> None:
    heights = noise(600, 600)
    with closing(Scene(gpu, heights, view_distance=1.0, spacing=0.1)) as scene:
        eye = scene.camera(300, 300, 200)
        far = eye.moved(x=eye.x + 2.5e6, y=eye.y - 2.5e6)
        frame = scene.frame(eye, lod_camera=far)
        origin, down = np.zeros((1, 3)), np.array([[0.0, 0.0, -1.0]])
        hits = Probe(scene.clipmap).cast(scene.view, origin, down)
        assert hits.level[0] == scene.pyramid.level_count - 1
        assert frame.lod is far


OCCLUDED = """
#include trace.wgsl
@group(1) @binding(0) var<storage, read> positions: array<vec4<f32>>;
@group(1) @binding(1) var<storage, read_write> shadows: array<u32>;
@compute @workgroup_size(64)
fn shade(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= arrayLength(&shadows)) { return; }
    shadows[id.x] = u32(occluded(positions[id.x].xyz, vec3<f32>(0.6, -0.3, 0.35)));
}
"""


@pytest.mark.parametrize("lift", [0.02, -0.02])
def test_occluded_is_the_shadow_of_other_ground(gpu: Gpu, tmp_path: Path, lift: float) -> None:
    heights = hills(200, 300.0).astype(np.float32)
    file = tmp_path / "occluded.wgsl"
    file.write_text(OCCLUDED)
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(100, 100, 400))
        random = np.random.default_rng(5)
        tx, ty = random.uniform(1, 199, (2, 3000))
        z = TrueSurface(heights).height(tx, ty)
        points = np.column_stack([(tx - 100) * SPACING, -(ty - 100) * SPACING, z - 400 + lift]).astype(np.float32)
        shader = gpu.shader("occluded", file, search=SEARCH, constants=scene.clipmap.constants)
        layout = gpu.layout("occluded", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")})
        pipeline = gpu.compute("occluded", shader, "shade", [scene.clipmap.layout, layout])
        given = gpu.buffer("positions", np.pad(points, ((0, 0), (0, 1))), "STORAGE", "test")
        shadows = gpu.buffer("shadows", 4 * len(points), "STORAGE|COPY_SRC", "test")
        encoder = gpu.encoder("occluded")
        run = encoder.begin_compute_pass()
        run.set_pipeline(pipeline)
        run.set_bind_group(0, scene.view.bind_group)
        run.set_bind_group(1, gpu.bind("occluded", layout, {0: given, 1: shadows}))
        run.dispatch_workgroups(math.ceil(len(points) / 64))
        run.end()
        gpu.submit(encoder)
        ours = gpu.read_buffer(shadows, dtype=np.uint32).result() == 1
    # the truth from well above the ground, so that only other ground is met
    origin = points.astype(np.float64) + np.array([0, 0, 0.05 - lift])
    direction = np.broadcast_to(np.float32([0.6, -0.3, 0.35]).astype(np.float64), origin.shape)
    true = ~np.isnan(first_hits(frame, heights, origin, direction))
    dx, dy = TrueSurface(heights).gradient(tx, ty)
    # ground that faces away is dark by its normal; from just under it a ray never comes up
    lit = 0.35 - (0.6 * dx - -0.3 * dy) / SPACING > 0.01
    assert 0.1 < true[lit].mean() < 0.8
    assert (ours != true)[lit].mean() < 0.01


def test_orthographic_rays_that_miss_leave_the_sky(gpu: Gpu) -> None:
    """The near plane of an orthographic camera amid the data is behind it, at a negative distance."""
    with closing(Scene(gpu, noise(60, 60))) as scene:
        camera = scene.camera(30, 30, 30, pitch=-30, orthographic=800)
        frame = scene.frame(camera)
        assert frame.depth_range[0] < -1
        drawn = scene.draw(frame, scene.algorithm("raycast"))["depth"]
        origin, direction = (part.reshape(-1, 3) for part in frame.rays())
        hits = Probe(scene.clipmap).cast(scene.view, origin, direction, start=-1e6)
    expected = np.isfinite(hits.t).reshape(drawn.shape)
    assert 0.05 < expected.mean() < 0.7
    np.testing.assert_array_equal(drawn > 0, expected)
