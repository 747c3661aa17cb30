"""The list of wanted nodes holds every node that a shader may ask for, in the order of importance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.frame import Frame
from orogen.grid import EARTH_RADIUS, Grid
from orogen.keys import NodeKey, level_count
from orogen.streaming.requests import LayerGrid, wanted

SHAPE = (9000, 12_000)
DEGREE = 1 / 3600
GRIDS = {
    "north up": Grid(12_000, 9000, (20.0, 0, 1e7, 0, -20.0, 5e6)),
    "south up": Grid(12_000, 9000, (20.0, 0, 300.0, 0, 20.0, -700.0)),
    "mirrored": Grid(12_000, 9000, (-20.0, 0, 0.0, 0, -20.0, 0.0)),
    "rotated": Grid(12_000, 9000, (17.0, 10.0, 1e6, 10.0, -17.0, 2e6)),
    "long texels": Grid(12_000, 9000, (5.0, 0, 0, 0, -40.0, 0)),
    "degrees": Grid(12_000, 9000, (DEGREE, 0, 10, 0, -DEGREE, 70), "EPSG:4326", (38_000.0, 111_500.0)),
    "sheared": Grid(12_000, 9000, (20.0, 36.0, 0, 0, -16.0, 0), None, (1.0, 1.7)),
}


@dataclass(frozen=True)
class Slope:
    """Heights that rise linearly with the texels."""

    per_col: float
    per_row: float

    def heights(self, texel: NDArray[np.float64]) -> NDArray[np.float64]:
        return 500 + texel @ np.array([self.per_col, self.per_row])

    def bounds(self, level: int, rows: NDArray, cols: NDArray) -> tuple[NDArray, NDArray]:
        side = 256 << level
        corners = [
            self.heights(np.stack([(cols + i) * side, (rows + j) * side], axis=-1).astype(float))
            for i in (0, 1)
            for j in (0, 1)
        ]
        return np.min(corners, axis=0), np.max(corners, axis=0)


@dataclass(frozen=True)
class Scene:
    frame: Frame
    layer: LayerGrid
    slope: Slope

    def wants(self, load: float = 2.0, behind: float = 0.25) -> list[NodeKey]:
        return wanted(self.frame, self.layer, self.slope.bounds, load, behind)

    def relative(self, texel: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres east, north, up of the camera of points of the data."""
        grid, camera = self.frame.grid, self.frame.camera
        x, y = grid.to_crs(*texel.T)
        east, north = (x - camera.x) * grid.ground_scale[0], (y - camera.y) * grid.ground_scale[1]
        drop = (east**2 + north**2) / (2 * EARTH_RADIUS) if self.frame.curvature else 0.0
        return np.stack([east, north, height * self.frame.exaggeration - camera.z - drop], axis=-1)

    def visible(self, point: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether camera-relative points lie in the picture of the LOD camera (at the same place as the camera)."""
        camera, (width, height) = self.frame.lod, self.frame.size
        right, up, forward = (point @ axis for axis in camera.basis)
        half = camera.orthographic / 2 if camera.orthographic else math.tan(math.radians(camera.fov) / 2) * forward
        inside = (np.abs(up) <= half) & (np.abs(right) <= half * width / height)
        return inside if camera.orthographic else inside & (forward >= camera.near)

    def level(self, texel: NDArray[np.float64], view: float) -> NDArray[np.int64]:
        """Level that the shader uses, by the distance on the approximate ground (equation 4.9)."""
        point = self.relative(texel, np.zeros(len(texel)))
        point[:, 2] = self.frame.ground_height * self.frame.exaggeration - self.frame.camera.z
        distance = np.linalg.norm(point - self.frame.lod_eye(), axis=1)
        reach = view * self.layer.node_size * self.layer.grid.spacing
        with np.errstate(divide="ignore"):
            level = np.floor(np.log2(2 * distance / reach))
        return np.clip(level, 0, self.layer.level_count - 1).astype(int)


def scene(seed: int, name: str, **changes: object) -> Scene:
    rng = np.random.default_rng(seed)
    grid = GRIDS[name]
    slope = Slope(*rng.uniform(-0.3, 0.3, 2))
    eye = rng.uniform(-0.1, 1.1, 2) * [12_000, 9000]
    ground = float(slope.heights(eye))
    x, y = (float(v) for v in grid.to_crs(*eye))
    exaggeration = float(rng.choice([1.0, 2.0]))
    camera = Camera(
        x,
        y,
        ground * exaggeration + float(10 ** rng.uniform(0, 4.5)),
        heading=float(rng.uniform(0, 360)),
        pitch=float(rng.uniform(-90, 10)),
        roll=float(rng.uniform(-180, 180)),
        fov=float(rng.uniform(10, 90)),
    )
    frame = Frame(
        camera,
        grid,
        (160, 90),
        ground_height=ground,
        exaggeration=exaggeration,
        curvature=bool(rng.integers(2)),
        height_range=(-6000.0, 7000.0),
    )
    frame = replace(frame, **changes)  # type: ignore[arg-type]
    return Scene(frame, LayerGrid(grid, level_count(SHAPE), 256), slope)


def points(s: Scene, seed: int) -> NDArray[np.float64]:
    """Texel positions on the data: everywhere, and more of them towards the camera."""
    rng = np.random.default_rng(seed)
    size = np.array([12_000.0, 9000.0])
    near = s.frame.eye + rng.normal(size=(3000, 2)) * 10 ** rng.uniform(0, 4, (3000, 1))
    texel = np.concatenate([rng.uniform(0, 1, (1500, 2)) * size, near])
    return texel[((texel >= 0) & (texel < size)).all(axis=1)]


def keys_at(s: Scene, texel: NDArray[np.float64], level: NDArray[np.int64]) -> set[NodeKey]:
    x, y = (texel // (256 << level)[:, None]).astype(int).T
    return set(map(NodeKey, level.tolist(), x.tolist(), y.tolist()))


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("seed", range(8))
def test_holds_what_the_shader_asks_for_in_the_picture(name: str, seed: int) -> None:
    s = scene(seed, name)
    texel = points(s, seed)
    texel = texel[s.visible(s.relative(texel, s.slope.heights(texel)))]
    level = s.level(texel, 2.0)
    found = set(s.wants(2.0, behind=0.0))
    top = s.layer.level_count - 1
    assert keys_at(s, texel, level) <= found
    # and what it blends into
    assert keys_at(s, texel, np.minimum(level + 1, top)) <= found


@pytest.mark.parametrize("name", GRIDS)
def test_holds_what_rays_ask_for_out_of_the_picture_within_its_part_of_the_distance(name: str) -> None:
    s = scene(20, name)
    texel = points(s, 20)
    level = s.level(texel, 1.5 * 0.5)
    assert len(np.unique(level)) > 2
    assert keys_at(s, texel, level) <= set(s.wants(1.5, behind=0.5))


@pytest.mark.parametrize("name", GRIDS)
def test_holds_all_of_a_disc(name: str) -> None:
    """Points just within the distance of every level, in every direction: nodes that a disc barely touches too."""
    s = scene(21, name)
    x, y = (float(v) for v in s.frame.grid.to_crs(6100.3, 4400.7))
    s = replace(s, frame=replace(s.frame, camera=Camera(x, y, s.frame.ground_height + 1.0), exaggeration=1.0))
    angle = np.linspace(0, 2 * np.pi, 4000)
    found = set(s.wants(1.3, behind=1.0))
    for level in range(s.layer.level_count - 1):
        radius = 0.999 * 1.3 * 256 * s.layer.grid.spacing * 2**level
        metres = radius * np.stack([np.cos(angle), np.sin(angle)])
        texel = s.frame.eye + (np.linalg.inv(s.frame.grid.metres) @ metres).T
        texel = texel[((texel >= 0) & (texel < [12_000, 9000])).all(axis=1)]
        assert keys_at(s, texel, np.full(len(texel), level)) <= found


def test_holds_the_far_corners_of_triangles_on_the_rim_of_the_picture() -> None:
    """From straight above, the picture ends a few texels before the node's border."""
    s = scene(0, "north up")
    x, y = (float(v) for v in s.frame.grid.to_crs(20.5 * 256, 18.5 * 256))
    flat = Slope(0.0, 0.0)
    down = Camera(x, y, 3500.0, pitch=-90.0, fov=2 * math.degrees(math.atan((128 - 10) * 20 / 3000)))
    frame = replace(s.frame, camera=down, size=(100, 100), ground_height=500.0, exaggeration=1.0, curvature=False)
    found = set(replace(s, frame=frame, slope=flat).wants(4.0, 0.0))
    # each of the parents' four children comes with them, so look at those of the next level
    parents = {key.parent for key in found if key.level == 0}
    assert NodeKey(1, 10, 9) in parents
    assert {NodeKey(1, 9, 9), NodeKey(1, 10, 8)} <= parents


def test_holds_what_the_earths_curvature_brings_into_the_picture() -> None:
    """Ground 150 km away lies 1.8 km lower than on a plane, in the middle of a narrow picture."""
    s = scene(0, "north up")
    x, y = (float(v) for v in s.frame.grid.to_crs(100.0, 4500.0))
    pitch = -math.degrees(math.atan((100 + 150_000**2 / (2 * EARTH_RADIUS)) / 150_000))
    east = Camera(x, y, 600.0, heading=90.0, pitch=pitch, fov=0.2)
    frame = replace(s.frame, camera=east, ground_height=500.0, exaggeration=1.0, curvature=True)
    s = replace(s, frame=frame, slope=Slope(0.0, 0.0))
    texel = np.array([[100.0 + 150_000 / 20, 4500.0]])
    assert s.visible(s.relative(texel, np.array([500.0]))).all()
    assert keys_at(s, texel, np.array([0])) <= set(s.wants(40.0, 0.0))


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("seed", range(4))
def test_orthographic_pictures_get_one_texel_a_pixel(name: str, seed: int) -> None:
    s = scene(seed, name)
    camera = replace(s.frame.camera, orthographic=3000.0, pitch=-60.0 - 5 * seed, fov=45.0)
    s = replace(s, frame=replace(s.frame, camera=camera, curvature=False))
    texel = points(s, seed)
    texel = texel[s.visible(s.relative(texel, s.slope.heights(texel)))]
    assert keys_at(s, texel, s.level(texel, 2.0)) <= set(s.wants(2.0, behind=0.0))


def test_the_lod_camera_decides() -> None:
    s = scene(3, "north up")
    turned = replace(s.frame.camera, heading=s.frame.camera.heading + 180, pitch=-20.0, fov=50.0)
    watched = replace(s, frame=replace(s.frame, lod_camera=turned))
    own = replace(s, frame=replace(s.frame, camera=turned))
    assert watched.wants() == own.wants()
    assert set(watched.wants()) != set(s.wants())


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("seed", range(3))
def test_is_a_tree_in_the_grid_coarse_first_then_near(name: str, seed: int) -> None:
    s = scene(seed, name)
    keys = s.wants(3.0)
    assert len(set(keys)) == len(keys)
    assert keys[0] == NodeKey(s.layer.level_count - 1, 0, 0)
    levels = [key.level for key in keys]
    assert levels == sorted(levels, reverse=True)
    known = set(keys)
    for key in keys[1:]:
        assert key.parent in known
        rows, cols = s.layer.nodes(key.level)
        assert 0 <= key.x < cols
        assert 0 <= key.y < rows
        siblings = [NodeKey(key.level, key.parent.x * 2 + i, key.parent.y * 2 + j) for i in (0, 1) for j in (0, 1)]
        assert all(k in known for k in siblings if k.x < cols and k.y < rows)
    # nearness is judged by brute force: the nearest of many points of a node
    way = np.stack(np.meshgrid(*[np.linspace(0, 1, 65)] * 2), axis=-1).reshape(-1, 2)
    for level in range(s.layer.level_count - 1):
        near = []
        for key in (k for k in keys if k.level == level):
            point = s.relative((np.array([key.x, key.y]) + way) * (256 << level), np.zeros(len(way)))
            point[:, 2] = s.frame.ground_height * s.frame.exaggeration - s.frame.camera.z
            near.append(np.linalg.norm(point, axis=1).min())
        slack = s.layer.grid.spacing * (256 << level) / 64 * 4
        assert all(b >= a - slack for a, b in pairwise(near))


@pytest.mark.parametrize("seed", range(10))
def test_grows_with_the_distance_and_with_what_is_loaded_behind(seed: int) -> None:
    s = scene(seed, "north up")
    previous: set[NodeKey] = set()
    for load in (0.0, 0.5, 1.0, 2.0, 4.0, 1e15):
        found = set(s.wants(load, 1.0 if load == 1e15 else 0.25))
        assert previous <= found
        previous = found
    assert len(previous) == s.layer.node_count
    behind = [set(s.wants(2.0, share)) for share in (0.0, 0.25, 1.0)]
    assert behind[0] <= behind[1] <= behind[2]
    # with all of the distance loaded behind, the direction of view does not matter
    turned = replace(s, frame=replace(s.frame, camera=replace(s.frame.camera, heading=0.0, pitch=30.0)))
    assert set(turned.wants(2.0, 1.0)) == behind[2]


def test_leaves_out_what_is_not_in_the_picture() -> None:
    s = scene(1, "north up")
    x, y = (float(v) for v in s.frame.grid.to_crs(6000, 4500))
    level = Camera(x, y, 600.0 + float(s.slope.heights(np.array([6000.0, 4500.0]))), pitch=-5.0, fov=40.0)
    s = replace(s, frame=replace(s.frame, camera=level, exaggeration=1.0, curvature=False))
    assert len(s.wants(3.0, 0.0)) < 0.5 * len(s.wants(3.0, 1.0))
    up = replace(s, frame=replace(s.frame, camera=replace(level, pitch=90.0)))
    assert len(up.wants(3.0, 0.0)) < 0.2 * len(s.wants(3.0, 0.0))


@pytest.mark.parametrize("node_size", [512, 1024])
def test_larger_nodes(node_size: int) -> None:
    s = scene(2, "rotated")
    s = replace(s, layer=replace(s.layer, node_size=node_size))

    def bounds(level: int, rows: NDArray, cols: NDArray) -> tuple[NDArray, NDArray]:
        scale = node_size // 256
        low, high = zip(
            *(
                s.slope.bounds(level, rows * scale + j, cols * scale + i)
                for i in (0, scale - 1)
                for j in (0, scale - 1)
            ),
            strict=True,
        )
        return np.min(low, axis=0), np.max(high, axis=0)

    keys = set(wanted(s.frame, s.layer, bounds, 1.0, 0.0))
    texel = points(s, 5)
    texel = texel[s.visible(s.relative(texel, s.slope.heights(texel)))]
    level = s.level(texel, 1.0)
    x, y = (texel // (node_size << level)[:, None]).astype(int).T
    assert set(map(NodeKey, level.tolist(), x.tolist(), y.tolist())) <= keys


def test_stretch_is_that_of_the_longest_row_or_column() -> None:
    def stretch(name: str) -> float:
        return LayerGrid(GRIDS[name], 6, 256).stretch

    assert stretch("north up") == pytest.approx(1.0)
    assert stretch("rotated") == pytest.approx(1.0)
    assert stretch("long texels") == pytest.approx(math.sqrt(8))
    assert stretch("degrees") == pytest.approx(math.sqrt(111_500 / 38_000))
