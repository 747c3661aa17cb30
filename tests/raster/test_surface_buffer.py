"""Patches and rays in one picture, and what the surface buffer says of them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.patches import read_patches
from lod.scene import SPACING, Scene, noise
from lod.udlod_twin import Twin
from orogen.gpu import Gpu
from orogen.lod.contract import Draw, Module, Patches, Rays
from orogen.lod.mesh import Mesh
from orogen.lod.udlod import Settings
from orogen.raster.surface import FORMATS

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, noise(60, 80))) as terrain:
        yield terrain


def plate(gpu: Gpu, left: float, right: float, name: int) -> Patches:
    module = Module(HERE / "plate.wgsl", constants={"LEFT": float(left), "RIGHT": float(right), "ID": name})
    return Patches(module, None, gpu.buffer("plate", np.array([4, 1, 0, 0], np.uint32), "INDIRECT|COPY_SRC", "test"))


def plane(height: float, name: int) -> Rays:
    return Rays(Module(HERE / "plane.wgsl", constants={"HEIGHT": float(height), "ID": name}))


CAMERAS = {
    "perspective": {"pitch": -35.0},
    "straight down": {"pitch": -90.0, "heading": 20.0},
    "orthographic": {"pitch": -35.0, "orthographic": 900.0},
    "from below": {"pitch": 40.0, "z": -400.0},
}


@pytest.mark.parametrize("view", CAMERAS)
def test_the_nearest_surface_wins_whatever_drew_it_in_any_order(gpu: Gpu, scene: Scene, view: str) -> None:
    angles = dict(CAMERAS[view])
    frame = scene.frame(scene.camera(40, 50, angles.pop("z", 500.0), **angles))
    draws: list[Draw] = [plate(gpu, 0, 200, 1), plate(gpu, 150, 50, 2), plane(90, 3), plane(110, 4)]
    alone = [scene.raster(frame, [draw]) for draw in draws]
    depths = np.stack([a["depth"] for a in alone])
    first = depths.argmax(axis=0)
    assert len(np.unique(first[depths.max(axis=0) > 0])) >= 3
    # where two are as near as rounding, either may win
    second = np.sort(depths, axis=0)[-2]
    sure = (depths.max(axis=0) - second) > 1e-5 * second
    for order in itertools.permutations(range(4)):
        both = scene.raster(frame, [draws[k] for k in order])
        np.testing.assert_allclose(both["depth"], depths.max(axis=0), rtol=1e-6)
        for name in ("id", "detail"):
            expected = np.take_along_axis(np.stack([a[name] for a in alone]), first[None], axis=0)[0]
            np.testing.assert_array_equal(both[name][sure], expected[sure])


def test_terrain_by_patches_and_by_rays_share_a_picture(scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 70, 300, pitch=-30))
    triangles, rays = scene.algorithm("udlod"), scene.algorithm("raycast")
    one, other = scene.draw(frame, triangles), scene.draw(frame, rays)
    both = scene.draw(frame, triangles, rays)
    np.testing.assert_array_equal(both["depth"], np.maximum(one["depth"], other["depth"]))
    assert 0 < (both["depth"] == one["depth"]).mean() < 1


def test_index_lists_and_several_arguments_in_a_buffer(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 50, 500, pitch=-60))
    strip = plate(gpu, 20, 120, 9)
    index = Mesh(gpu, [np.array([[0, 1, 2], [2, 1, 3]]), np.array([[0, 1, 2]])], "test")
    arguments = np.array([0, 0, 0, 0, 0, 6, 1, 0, 0, 0, 3, 1, 6, 0, 0], np.uint32)
    indirect = gpu.buffer("arguments", arguments, "INDIRECT|COPY_SRC", "test")
    whole = Patches(strip.module, None, indirect, topology="triangle-list", index=index, offset=20)
    half = Patches(strip.module, None, indirect, topology="triangle-list", index=index, offset=40)
    expected = scene.raster(frame, [strip])
    assert (expected["depth"] > 0).mean() > 0.1
    drawn = scene.raster(frame, [whole])
    np.testing.assert_array_equal(drawn["id"], expected["id"])
    np.testing.assert_allclose(drawn["depth"], expected["depth"], rtol=1e-4)
    first = scene.raster(frame, [half])["depth"]
    assert 0.2 < (first > 0).sum() / (expected["depth"] > 0).sum() < 0.8
    np.testing.assert_allclose(first[first > 0], expected["depth"][first > 0], rtol=1e-4)
    gap = Patches(strip.module, None, indirect, topology="triangle-list", index=index)
    assert (scene.raster(frame, [gap])["depth"] == 0).all()


def test_what_is_drawn_later_is_added(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 50, 500, pitch=-35))
    draws: list[Draw] = [plate(gpu, 0, 200, 1), plate(gpu, 150, 50, 2), plane(90, 3)]
    together = scene.raster(frame, draws)
    surface = scene.rasterizer.surface(frame.size)
    encoder = gpu.encoder("raster")
    for number, draw in enumerate(draws):
        scene.rasterizer.record(encoder, scene.timer, [draw], scene.view, surface, clear=number == 0)
    scene.rasterizer.record(encoder, scene.timer, [], scene.view, surface, clear=False)
    gpu.submit(encoder)
    for name, values in together.items():
        np.testing.assert_array_equal(surface.read(name).result(), values)
    surface.destroy()


def test_rays_replace_where_they_are_asked_to(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 50, 500, pitch=-35))
    near, far = plate(gpu, 150, 150, 1), plane(20, 3)
    before, alone = scene.raster(frame, [near]), scene.raster(frame, [far])
    module = Module(HERE / "replacing_plane.wgsl", constants={"HEIGHT": 20.0, "ID": 3, "OF": 1})
    after = scene.raster(frame, [near, Rays(module, replace=True)])
    asked = (before["id"] == 1) & (np.arange(frame.size[0]) % 2 == 1)
    assert asked.sum() > 500
    for name, values in after.items():
        np.testing.assert_array_equal(values, np.where(asked, alone[name], before[name]))


def test_fragments_outside_the_data_are_left_out(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 30, 800, pitch=-90))
    inside = scene.raster(frame, [plate(gpu, 50, 50, 1)])["depth"]
    module = Module(HERE / "overhang.wgsl", constants={"HEIGHT": 50.0, "ID": 1, "BY": 5000})
    arguments = gpu.buffer("plate", np.array([4, 1, 0, 0], np.uint32), "INDIRECT|COPY_SRC", "test")
    wide = Patches(module, None, arguments)
    drawn = scene.raster(frame, [wide])["depth"]
    assert 0.05 < (inside > 0).mean() < 0.95
    assert ((drawn > 0) != (inside > 0)).sum() == 0
    np.testing.assert_allclose(drawn, inside, rtol=1e-6)


def test_nothing_drawn_is_sky(scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 50, 500, pitch=-90))
    scene.draw(frame, scene.algorithm("raycast"))
    for values in scene.raster(frame, []).values():
        assert (values == 0).all()


def test_the_near_plane_cuts_patches_and_rays_alike(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 30, 100, pitch=-60, near=60.0))
    patches, rays = scene.raster(frame, [plate(gpu, 50, 50, 1)]), scene.raster(frame, [plane(50, 2)])
    # the plate ends with the data, the plane does not
    inside = patches["depth"] > 0
    assert 0.1 < inside.mean() < 0.9
    assert (rays["depth"][:5] > 0).all()
    assert (rays["depth"][-5:] == 0).all()
    assert not (inside & (rays["depth"] == 0)).any()
    np.testing.assert_allclose(rays["depth"][inside], patches["depth"][inside], rtol=1e-5)
    assert patches["depth"].max() <= 1
    assert rays["depth"].max() <= 1


def test_formats_and_shapes(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 50, 500, pitch=-90), (33, 17))
    drawn = scene.raster(frame, [plate(gpu, 5, 5, 77)])
    assert {name: values.dtype for name, values in drawn.items()} == {
        "depth": np.float32, "id": np.uint32, "detail": np.uint32,
    }  # fmt: skip
    assert {values.shape for values in drawn.values()} == {(17, 33)}
    held = gpu.memory.by_category().get("surface", 0)
    surface = scene.rasterizer.surface((33, 17))
    assert gpu.memory.by_category()["surface"] - held == 16 * 33 * 17
    assert list(FORMATS) == ["depth", "id", "detail"]
    surface.destroy()
    assert gpu.memory.by_category().get("surface", 0) == held


def unpack(detail: NDArray[np.uint32]) -> tuple[NDArray[np.uint32], NDArray[np.float64], NDArray[np.uint32]]:
    """Level of the data, pixels to the nearest edge, level of the tile."""
    return detail & 255, ((detail >> 8) & 255) / 16, (detail >> 16) & 255


def test_the_detail_word(gpu: Gpu, scene: Scene) -> None:
    frame = scene.frame(scene.camera(40, 30, 2000, pitch=-90, orthographic=400.0))
    drawn = scene.raster(frame, [plate(gpu, 5, 5, 77)])
    assert (drawn["id"] == 77).all()
    level, _, tile = unpack(drawn["detail"])
    assert (level == 2).all()
    assert (tile == 7).all()
    assert (drawn["detail"] >> 24 == 0).all()
    level, edge, tile = unpack(scene.raster(frame, [plane(5, 3)])["detail"])
    assert (level == 1).all()
    assert (edge == 2.5).all()
    assert (tile == 4).all()


def test_edge_distance_is_in_pixels(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((60, 80), 100.0))) as scene:
        pixel = 1.5
        camera = scene.camera(40, 30, 300, pitch=-90, orthographic=64 * pixel)
        frame = scene.frame(camera)
        drawn = scene.draw(frame, scene.algorithm("raycast"))
        position = frame.positions(drawn["depth"])
        sample = np.stack(frame.grid.to_texel(position[..., 0], position[..., 1]), axis=-1) - 0.5
        lines = np.abs(sample - np.round(sample)) * SPACING / pixel
        _, edge, _ = unpack(drawn["detail"])
        np.testing.assert_allclose(edge, np.minimum(lines.min(axis=-1), 255 / 16), atol=1 / 16 + 0.01)

        state = scene.algorithm("udlod", {"pixels_per_quad": 6.0})
        drawn = scene.draw(frame, state)
        twin = Twin(frame, Settings(pixels_per_quad=6.0))
        _, edge, tile = unpack(drawn["detail"])
        quad = twin.leaf * 2.0 ** tile.astype(float)
        # grid lines and the falling diagonals, away from the morphs
        grid = sample / quad[..., None]
        still = twin.distance(sample) < (1 - 0.25) * np.vectorize(twin.range_end)(tile.astype(int))
        assert still.mean() > 0.2
        diagonal = grid.sum(axis=-1)
        away = [np.abs(grid[..., 0] - np.round(grid[..., 0])), np.abs(grid[..., 1] - np.round(grid[..., 1]))]
        away.append(np.abs(diagonal - np.round(diagonal)) / np.sqrt(2))
        expected = np.min(away, axis=0) * quad * SPACING / pixel
        off = np.abs(edge - expected)[still]
        assert np.quantile(off, 0.98) < 1 / 16 + 0.02


def test_ids_are_made_of_the_tile_and_the_same_each_time(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((300, 400), 100.0))) as scene:
        settings = {"grid_size": 8, "pixels_per_quad": 3.0}
        frame = scene.frame(scene.camera(200, 260, 900, pitch=-50), (160, 100))
        drawn = scene.draw(frame, scene.algorithm("udlod", settings))
        twin = Twin(frame, Settings(grid_size=8, pixels_per_quad=3.0))
        position = frame.positions(drawn["depth"])
        sample = np.stack(frame.grid.to_texel(position[..., 0], position[..., 1]), axis=-1) - 0.5
        _, _, level = unpack(drawn["detail"])
        side = 8 * twin.leaf * 2.0 ** level.astype(float)
        tile = sample / side[..., None]
        inside = (np.abs(tile - np.round(tile)) > 0.01).all(axis=-1) & (drawn["depth"] > 0)
        x, y = (np.floor(tile[..., k]).astype(np.uint32) for k in (0, 1))
        np.testing.assert_array_equal(drawn["id"][inside], ((level << 26) ^ (y << 13) ^ x)[inside])
        tiles = set(map(tuple, read_patches(scene, frame, scene.algorithm("udlod", settings)).tiles.tolist()))
        seen = np.stack([level, x, y], axis=-1)[inside]
        assert set(map(tuple, np.unique(seen, axis=0).tolist())) <= tiles
        assert inside.mean() > 0.5


@pytest.mark.parametrize("name", ["udlod", "raycast"])
def test_missing_data_is_not_drawn(gpu: Gpu, name: str) -> None:
    heights = np.full((60, 80), 100.0)
    heights[20:40, 30:50] = np.nan
    heights[50, 10] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(40, 30, 300, pitch=-90, orthographic=590.0), (400, 300))
        drawn = scene.draw(frame, scene.algorithm(name))["depth"] > 0
    width, height = frame.size
    u, v = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    sample = np.stack([u, v], axis=-1) * (590.0 / height / SPACING) + [39.5, 29.5]
    cell = np.clip(np.floor(sample).astype(int), 0, [78, 58])
    way = sample - cell
    valid = np.isfinite(heights).astype(float)
    i, j = cell[..., 0], cell[..., 1]
    covered = (valid[j, i] * (1 - way[..., 0]) + valid[j, i + 1] * way[..., 0]) * (1 - way[..., 1]) + (
        valid[j + 1, i] * (1 - way[..., 0]) + valid[j + 1, i + 1] * way[..., 0]
    ) * way[..., 1]
    inside = ((sample >= 0) & (sample <= [79, 59])).all(axis=-1)
    # rounding decides on the line of one half alone
    sure = inside & (np.abs(covered - 0.5) > 1e-3)
    assert (covered[sure] < 0.5).sum() > 1000
    np.testing.assert_array_equal(drawn[sure], covered[sure] >= 0.5)
    assert not drawn[~((sample > -1e-3) & (sample < [79.001, 59.001])).all(axis=-1)].any()


def test_patches_of_other_algorithms_spare_missing_data_too(gpu: Gpu) -> None:
    heights = np.full((60, 80), 100.0)
    heights[20:40, 30:50] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(40, 30, 300, pitch=-90, orthographic=400.0))
        depth = scene.raster(frame, [plate(gpu, 100, 100, 1)])["depth"]
    assert (depth[28:36, 44:52] == 0).all()
    assert (depth[:8] > 0).all()
