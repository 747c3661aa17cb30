"""What udlod leaves out, for being hidden, outside the picture or without data: the picture is the same without it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.patches import read_patches
from lod.scene import Buffers, Scene, noise
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.keys import NodeKey
from orogen.lod.contract import AlgorithmView
from orogen.lod.udlod import View
from orogen.raster.compute import can_rasterize
from orogen.raster.rasterizer import FOLDER, Rasterizer
from orogen.streaming.clipmap import SEARCH

ROWS, COLUMNS = 300, 400
SIZE = (120, 70)
FINE = {"grid_size": 4, "pixels_per_quad": 3.0, "occlusion": True}


class Unculled(Frame):
    """A frame whose frustum is everywhere."""

    plane_rows = ((0.0, 0.0, 0.0, 1.0),) * 5


def as_unculled(frame: Frame) -> Unculled:
    return Unculled(**{field.name: getattr(frame, field.name) for field in dataclasses.fields(frame)})


def steep(holes: bool) -> NDArray[np.float32]:
    """Hills with walls between valleys: much is hidden from most places."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    heights = 0.6 * hills(COLUMNS, 500.0)[:ROWS] + 250 * np.abs(np.sin(rows / 17)) + noise(ROWS, COLUMNS, 15.0)
    if holes:
        heights[100:170, 120:260] = np.nan
        heights[np.random.default_rng(4).random(heights.shape) < 0.002] = np.nan
        heights[:, 330:] = np.nan
    return (heights + 0 * columns).astype(np.float32)


@pytest.fixture(scope="module", params=[False, True], ids=["whole", "holes"])
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, steep(request.param), view_distance=0.4)) as terrain:
        yield terrain


def show(scene: Scene, raster: Rasterizer, frame: Frame, state: AlgorithmView) -> Buffers:
    """The surface buffer after both passes, as the renderer makes it."""
    surface = raster.surface(frame.size)
    while True:
        scene.view.update(frame)
        encoder = scene.gpu.encoder("show")
        raster.record(encoder, scene.timer, state.record(encoder, scene.timer, frame, scene.view), scene.view, surface)
        added = state.drawn(encoder, scene.timer, frame, scene.view, surface.targets["depth"])
        raster.record(encoder, scene.timer, added, scene.view, surface, clear=False)
        scene.timer.resolve(encoder)
        scene.gpu.submit(encoder)
        if not state.incomplete() + raster.incomplete():
            break
    result = {name: surface.read(name).result() for name in ("depth", "id", "detail")}
    surface.destroy()
    return result


def flight(scene: Scene, seed: int) -> list[tuple[Camera, tuple[int, int], dict[str, Any]]]:
    """Steps, with jumps of place, size and the way the ground is put before the camera; then orthographic."""
    random = np.random.default_rng(seed)
    result: list[tuple[Camera, tuple[int, int], dict[str, Any]]] = []
    for leg in range(4):
        camera = scene.camera(
            random.uniform(0.0, 1.0) * COLUMNS, random.uniform(0.0, 1.0) * ROWS, 10 ** random.uniform(2.3, 3.0),
            heading=random.uniform(0, 360), pitch=random.uniform(-25, 5), roll=random.uniform(-20, 20),
        )  # fmt: skip
        size = (SIZE, (60, 80))[leg % 2]
        changes: dict[str, Any] = ({}, {"exaggeration": 1.7}, {"curvature": True}, {})[leg]
        if leg == 3:
            camera = camera.moved(orthographic=900.0, pitch=-20.0, roll=0.0)
        for step in range(3):
            moved = camera.moved(x=camera.x + 25.0 * step, heading=camera.heading + 2.0 * step)
            result.append((moved, size, {**changes, "jitter": (0.3, -0.4)} if step == 2 else changes))
    return result


@pytest.mark.parametrize("path", ["hardware", "compute"])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 6))])
def test_what_is_left_out_is_not_seen(scene: Scene, path: str, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if path == "compute" and not can_rasterize(scene.gpu):
        pytest.skip("the adapter has no 64-bit atomics")
    raster = Rasterizer(scene.clipmap, path)
    # on GPUs that draw triangles in compute tiles are looked at less closely
    monkeypatch.setattr("orogen.lod.udlod.draws_in_compute", lambda gpu: path == "compute")
    state = scene.algorithm("udlod", FINE)
    plain = scene.algorithm("udlod", {**FINE, "occlusion": False})
    fewer, waited = 0, 0
    # the software driver is slow at the compute path
    for camera, size, changes in flight(scene, seed)[:: 1 + (path == "compute")]:
        jitter = {k: v for k, v in changes.items() if k == "jitter"}
        rest = {k: v for k, v in changes.items() if k != "jitter"}
        frame = dataclasses.replace(scene.frame(camera, size, **rest), **jitter)
        drawn = show(scene, raster, frame, state)
        everything = show(scene, raster, as_unculled(frame), plain)
        for name, values in everything.items():
            np.testing.assert_array_equal(drawn[name], values)
        fewer += plain.statistics().patches - state.statistics().patches
        waited += counts(state)["revealed"] > 0
    assert fewer > 0
    # something was put aside in vain, and came back
    assert waited > 0


def test_the_picture_is_the_same_while_data_comes_and_goes(gpu: Gpu) -> None:
    """Boxes are those of the data that is drawn now, whatever was there when the frame before was seen."""
    with closing(Scene(gpu, steep(False), view_distance=0.4)) as scene:
        raster = scene.rasterizer
        state = scene.algorithm("udlod", FINE)
        plain = scene.algorithm("udlod", {**FINE, "occlusion": False})
        camera = scene.camera(60, 280, 420, heading=30.0, pitch=-8.0)
        nodes = [NodeKey(1, 0, 0), NodeKey(0, 0, 0), NodeKey(0, 1, 0), NodeKey(0, 0, 1), NodeKey(0, 1, 1)]
        for number in range(1, len(nodes) + 1):
            scene.load(nodes[:number])
            for step in range(2):
                frame = scene.frame(camera.moved(heading=30.0 + step), SIZE, load=False)
                drawn = show(scene, raster, frame, state)
                for name, values in show(scene, raster, as_unculled(frame), plain).items():
                    np.testing.assert_array_equal(drawn[name], values)


def counts(state: AlgorithmView) -> dict[str, int]:
    assert isinstance(state, View)
    read = state._list._read_state()
    counts = {name: int(read[name]) for name in read.dtype.names if name != "draws"}
    return {**counts, "drawn": int(read["draws"]["tiles"][0]), "revealed": int(read["draws"]["tiles"][1])}


def test_most_of_what_is_behind_a_ridge_is_not_drawn(gpu: Gpu) -> None:
    """A plain behind a wall: nothing of it is seen, whether or not there was a frame before."""
    heights = noise(ROWS, COLUMNS, 5.0)
    heights[200:206] += 400
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(200, 240, 40, pitch=0.0), SIZE)
        state = scene.algorithm("udlod", FINE)
        plain = scene.algorithm("udlod", {**FINE, "occlusion": False})
        expected = show(scene, scene.rasterizer, frame, plain)
        behind = []
        for _ in range(2):
            drawn = show(scene, scene.rasterizer, frame, state)
            for name, values in expected.items():
                np.testing.assert_array_equal(drawn[name], values)
            behind.append(state.statistics().patches)
        assert behind[1] <= behind[0]
        assert behind[0] < 0.75 * plain.statistics().patches


def test_a_frozen_camera_is_not_culled_by_what_another_sees(gpu: Gpu) -> None:
    with closing(Scene(gpu, steep(False))) as scene:
        state = scene.algorithm("udlod", FINE)
        eye = scene.camera(200, 250, 420, pitch=-5.0)
        own = scene.frame(eye, SIZE)
        for _ in range(2):
            show(scene, scene.rasterizer, own, state)
        assert counts(state)["hidden"] > 0
        frozen = scene.frame(eye.moved(x=eye.x + 300, z=eye.z + 900, pitch=-60.0), SIZE, lod_camera=eye)
        show(scene, scene.rasterizer, frozen, state)
        assert counts(state)["hidden"] == 0
        plain = scene.algorithm("udlod", {**FINE, "occlusion": False})
        show(scene, scene.rasterizer, frozen, plain)
        assert plain.statistics().patches == state.statistics().patches


def test_hidden_tiles_are_left_out_of_large_data_by_default(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = scene.frame(scene.camera(200, 250, 420, pitch=-5.0), SIZE)
    for most, draws in ((COLUMNS, 1), (COLUMNS - 1, 2)):
        monkeypatch.setattr("orogen.lod.udlod.OCCLUDING", most)
        state = scene.algorithm("udlod")
        show(scene, scene.rasterizer, frame, state)
        assert state.statistics().draws == draws


@pytest.mark.parametrize(("pitch", "rests"), [(-5.0, False), (-85.0, True)])
def test_occlusion_rests_where_it_spares_little(
    scene: Scene, pitch: float, rests: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seen from above nothing is hidden; it is looked at again after a while, and the picture stays the same."""
    monkeypatch.setattr("orogen.lod.udlod.OCCLUDING", 1)
    monkeypatch.setattr("orogen.lod.udlod.WORTH", {True: 20, False: 20})
    monkeypatch.setattr("orogen.lod.tiles._REST", 5)
    settings = {"grid_size": 4, "pixels_per_quad": 3.0}
    frame = scene.frame(scene.camera(200, 250, 420 if pitch > -45 else 2000, pitch=pitch), SIZE)
    expected = show(scene, scene.rasterizer, frame, scene.algorithm("udlod", {**settings, "occlusion": False}))
    state = scene.algorithm("udlod", settings)
    passes = []
    for _ in range(12):
        drawn = show(scene, scene.rasterizer, frame, state)
        passes.append(state.statistics().draws)
        for name, values in expected.items():
            np.testing.assert_array_equal(drawn[name], values)
    # two frames: the first knows nothing of one before, the second tells
    once = [2, 2, 1, 1, 1, 1, 1, 2, 2, 1, 1, 1]
    assert passes == (once if rests else [2] * 12)


def test_a_small_list_draws_the_same(scene: Scene) -> None:
    frame = scene.frame(scene.camera(200, 250, 420, pitch=-5.0), SIZE)
    expected = show(scene, scene.rasterizer, frame, scene.algorithm("udlod", {**FINE, "occlusion": False}))
    tight = scene.algorithm("udlod", {**FINE, "tile_capacity": 64})
    for _ in range(2):
        drawn = show(scene, scene.rasterizer, frame, tight)
        for name, values in expected.items():
            np.testing.assert_array_equal(drawn[name], values)


def test_tiles_without_data_are_not_drawn(gpu: Gpu) -> None:
    heights = steep(False)
    heights[:, COLUMNS // 2 :] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        state = scene.algorithm("udlod", {**FINE, "occlusion": False})
        camera = scene.camera(200, 150, 1500, pitch=-90)
        show(scene, scene.rasterizer, scene.frame(camera, SIZE), state)
        half = state.statistics().patches
        with closing(Scene(gpu, steep(False))) as full:
            whole = full.algorithm("udlod", {**FINE, "occlusion": False})
            show(full, full.rasterizer, full.frame(camera, SIZE), whole)
            assert 0.4 < half / whole.statistics().patches < 0.65


@pytest.mark.parametrize("view_distance", [0.1, 0.4, np.inf])
def test_boxes_hold_all_that_is_drawn(gpu: Gpu, view_distance: float) -> None:
    turn = np.radians(27.0)
    metres = 10.0 * np.array([[np.cos(turn), np.sin(turn)], [np.sin(turn), -np.cos(turn)]])
    with closing(Scene(gpu, steep(True), view_distance=view_distance, metres=metres)) as scene:
        state = scene.algorithm("udlod", {"grid_size": 4, "pixels_per_quad": 8.0})
        heights = []
        for number, (camera, _, changes) in enumerate(flight(scene, 5)[::2]):
            frame = as_unculled(
                scene.frame(camera, SIZE, curvature=number % 2 == 1, exaggeration=changes.get("exaggeration", 1))
            )
            vertices = read_patches(scene, frame, state).vertices
            boxes = measured(scene, state, len(vertices))
            position = vertices["position"]
            assert (position >= boxes["low"][:, None]).all()
            assert (position <= boxes["high"][:, None]).all()
            # lids are not far above the ground
            heights.append(
                (boxes["high"][:, 2] - position[..., 2].max(axis=1)) / np.maximum(np.ptp(position[..., 2], axis=1), 1)
            )
        assert np.median(np.concatenate(heights)) < 1.0


MEASURED = np.dtype([("low", "f4", 3), ("empty", "u4"), ("high", "f4", 3), ("outside", "u4")])


def measured(scene: Scene, state: AlgorithmView, count: int) -> NDArray[Any]:
    assert isinstance(state, View)
    # of the same run as the vertices: another may list the tiles in another order
    draw = state._draws[0]
    gpu = scene.gpu
    shader = gpu.shader(
        "boxes", Path(__file__).parent / "tile_boxes.wgsl", search=[FOLDER, *SEARCH],
        constants={**scene.clipmap.constants, **draw.module.constants},
    )  # fmt: skip
    layout = gpu.layout("boxes", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")})
    pipeline = gpu.compute("boxes", shader, "measure_tiles", [scene.clipmap.layout, draw.module.layout, layout])
    boxes = gpu.buffer("boxes", MEASURED.itemsize * count, "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("boxes")
    run = encoder.begin_compute_pass(label="boxes")
    run.set_pipeline(pipeline)
    run.set_bind_group(0, scene.view.bind_group)
    run.set_bind_group(1, draw.group)
    run.set_bind_group(2, gpu.bind("boxes", layout, {0: draw.indirect, 1: boxes}))
    run.dispatch_workgroups(-(-count // 64))
    run.end()
    gpu.submit(encoder)
    return gpu.read_buffer(boxes).result().view(MEASURED)
