"""The clipmap as a whole: complete, the same each time, within its budgets, whatever happens to the data."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from orogen.camera import Camera
from orogen.errors import BudgetError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import Grid
from orogen.keys import NodeKey
from orogen.pyramid.contract import Pyramid
from orogen.streaming import clipmap_view as module
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.layer import Layer
from orogen.streaming.settings import ClipmapSettings

SHAPE = (2100, 2500)
GRID = Grid(2500, 2100, (10.0, 0, 5e5, 0, -10.0, 4e6))
EXPRESSION = "vec4<f32>(height_at(p), coverage_at(p), gradient_at(p, lod_at(p)))"
NODE = 260 * 260 * 4


def frame(tx: float, ty: float, **camera: Any) -> Frame:
    x, y = (float(v) for v in GRID.to_crs(tx, ty))
    settings = {"z": 1500.0, "heading": 30.0, "pitch": -25.0, **camera}
    return Frame(Camera(x, y, **settings), GRID, (192, 108))


def settings(**changes: Any) -> ClipmapSettings:
    return ClipmapSettings(**{"view_distance": 1.2, "memory": 24 << 20, "host_memory": 8 << 20, **changes})


@pytest.fixture(scope="module")
def heights() -> NDArray[np.float32]:
    y, x = np.indices(SHAPE)
    rng = np.random.default_rng(1)
    return (600 + 300 * np.sin(x / 90) * np.cos(y / 70) + rng.normal(0, 3, SHAPE)).astype(np.float32)


@pytest.fixture(scope="module")
def built(heights: NDArray, pyramid_of: Callable[..., Pyramid]) -> Pyramid:
    return pyramid_of(heights, GRID)


def points() -> tuple[NDArray, NDArray]:
    rng = np.random.default_rng(2)
    return rng.uniform(0.5, 2499.5, 2000), rng.uniform(0.5, 2099.5, 2000)


def test_everything_that_is_wanted_comes(built: Pyramid, clipmap_of: Any, settle: Any, gpu: Gpu) -> None:
    clipmap: Clipmap = clipmap_of(built, None, settings())
    view, _ = settle(clipmap, frame(700, 800))
    assert clipmap.pending == 0
    assert set(view.wishes[0]) == set(clipmap.heights.current)
    assert len(view.wishes[0]) == len(set(view.wishes[0])) > 20


def test_no_node_is_loaded_twice(heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any) -> None:
    pyramid = pyramid_of(heights, GRID)
    clipmap: Clipmap = clipmap_of(pyramid, None, settings(host_memory=64 << 20))
    before = pyramid.source.reads
    settle(clipmap, frame(700, 800))
    fine = {key for key in clipmap.heights.current if key.level == 0}
    # the chunks of level 0 and those around them, once each
    around = {(key.x + i, key.y + j) for key in fine for i in (-1, 0, 1) for j in (-1, 0, 1)}
    assert len(fine) <= pyramid.source.reads - before <= len(around)


def test_a_picture_depends_on_the_camera_and_not_on_the_way_there(
    built: Pyramid, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    there = frame(1500, 900)
    tx, ty = points()
    pictures = []
    for memory, threads, way in (
        (24 << 20, 1, []),
        (24 << 20, 3, [frame(1450, 1300, z=900.0), frame(200, 200), frame(1520, 880, z=700.0, heading=200.0)]),
        (96 << 20, 2, [frame(1500, 900, heading=120.0), frame(1600, 1000, z=650.0)]),
    ):
        clipmap: Clipmap = clipmap_of(built, None, settings(memory=memory, threads=threads))
        view = clipmap.view()
        for stop in way:
            settle(clipmap, stop, view)
        view, drawn = settle(clipmap, there, view)
        pictures.append(probe(view, drawn, EXPRESSION, tx, ty))
    np.testing.assert_array_equal(pictures[0], pictures[1])
    np.testing.assert_array_equal(pictures[0], pictures[2])


def test_a_full_atlas_lowers_detail(built: Pyramid, clipmap_of: Any, settle: Any, probe: Any) -> None:
    """With room for a part of what is wanted: coarse levels are whole, the nearest nodes of the last one are there."""
    wide = settings(view_distance=3.0)
    whole: Clipmap = clipmap_of(built, None, replace(wide, memory=96 << 20))
    view, drawn = settle(whole, frame(700, 800))
    wishes = view.wishes[0]
    assert len(wishes) > 35
    tx, ty = points()
    full = probe(view, drawn, EXPRESSION, tx, ty)
    whole.close()
    small: Clipmap = clipmap_of(built, None, replace(wide, memory=8 << 20))
    capacity = small.heights.atlas.capacity
    assert capacity < len(wishes) - 10
    pictures = []
    for _ in range(2):
        view, drawn = settle(small, frame(700, 800), small.view())
        assert set(small.heights.current) == set(wishes[:capacity])
        assert small.pending == 0
        pictures.append(probe(view, drawn, EXPRESSION, tx, ty))
        settle(small, frame(2000, 300), small.view())
        small.drop(small._views[-1])
        small.drop(small._views[-1])
    np.testing.assert_array_equal(*pictures)
    # smooth terrain: less detail is close to all of it
    assert np.abs(pictures[0][:, 0] - full[:, 0]).max() < 100
    assert (pictures[0][:, 0] != full[:, 0]).any()


def test_memory_stays_within_its_budgets(built: Pyramid, gpu: Gpu, clipmap_of: Any, settle: Any) -> None:
    before = gpu.memory.total
    clipmap: Clipmap = clipmap_of(built, None, settings(memory=12 << 20, host_memory=4 << 20))
    view = clipmap.view()
    layer = clipmap.heights
    for seed in range(6):
        rng = np.random.default_rng(seed)
        settle(clipmap, frame(*rng.uniform(0, 2000, 2), heading=float(rng.uniform(0, 360))), view)
        assert gpu.memory.by_category().get("atlas height", 0) + gpu.memory.by_category()["atlas maxima"] <= 12 << 20
        assert layer.tiles.size <= 4 << 20
        assert len(layer.atlas.resident) <= layer.atlas.capacity
    del view
    clipmap.close()
    clipmap_free = gpu.memory.total
    assert clipmap_free - before < 1 << 20


def test_a_frame_uploads_no_more_than_it_may(built: Pyramid, clipmap_of: Any) -> None:
    budget = 1 << 20
    clipmap: Clipmap = clipmap_of(built, None, settings(upload_budget=budget))
    view = clipmap.view()
    view.want(view.frame_for(frame(700, 800)))
    total = frames = 0
    while clipmap.pending or not frames:
        done = clipmap.pump()
        assert done <= budget
        total += done
        frames += done > 0
        clipmap.heights.wait(1.0)
    assert total == len(view.wishes[0]) * NODE
    assert frames >= total / budget


def test_nodes_for_a_moving_camera_are_worked_out_now_and_then(
    built: Pyramid, clipmap_of: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    clipmap: Clipmap = clipmap_of(built, None, settings())
    counted, original = [], module.wanted
    monkeypatch.setattr(module, "wanted", lambda *given: counted.append(1) or original(*given))
    view, other = clipmap.view(), clipmap.view()
    flight = [view.frame_for(frame(300 + 90 * k, 400 + 80 * k)) for k in range(14)]
    answers = []
    for asked in flight:
        view.want(asked, patient=True)
        view.wishes[0] = [*view.wishes[0], NodeKey(0, 0, 0)]  # as algorithms add theirs
        answers.append(len(counted))
    assert answers == [1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4]
    # once it rests, at once, and then no more
    assert view.behind
    for _ in range(3):
        view.want(flight[-1], patient=True)
        assert not view.behind
        assert len(counted) == 5
    other.want(replace(flight[-1]))
    assert view.wishes == other.wishes
    # without patience every frame is answered
    for number, asked in enumerate(flight, start=len(counted) + 1):
        other.want(asked)
        assert not other.behind
        assert len(counted) == number


def test_a_frame_is_written_at_once(built: Pyramid, clipmap_of: Any, settle: Any, gpu: Gpu, probe: Any) -> None:
    clipmap: Clipmap = clipmap_of(built, None, settings())
    view, _ = settle(clipmap, frame(700, 800))
    writes: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gpu, "write", lambda *given: writes.append(1) or Gpu.write(gpu, *given))
        for k in range(4):
            view.update(view.frame_for(frame(700 + 0.01 * k, 800)))
    assert len(writes) == 4
    # and what was written is what a new view writes
    tx, ty = points()
    fresh = clipmap.view()
    fresh.update(view.frame_for(frame(700.03, 800)))
    moved = view.frame_for(frame(700.03, 800))
    np.testing.assert_array_equal(probe(view, moved, EXPRESSION, tx, ty), probe(fresh, moved, EXPRESSION, tx, ty))


def test_nothing_is_drawn_before_the_coarsest_node_is_there(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, probe: Any
) -> None:
    pyramid = pyramid_of(heights, GRID)
    clipmap: Clipmap = clipmap_of(pyramid, None, settings())
    view = clipmap.view()
    drawn = view.frame_for(frame(700, 800))
    view.update(drawn)
    trace = "vec4<f32>(select(0.0, 1.0, trace(Ray(vec3<f32>(0.0), vec3<f32>(0.0, 0.0, -1.0)), 0.0, 1e5, true).found))"
    tx, ty = points()
    assert not probe(view, drawn, "vec4<f32>(coverage_at(p))", tx, ty).any()
    assert not probe(view, drawn, trace, tx, ty).any()
    view.want(drawn)
    clipmap.settle()
    view.update(drawn)
    assert probe(view, drawn, "vec4<f32>(coverage_at(p))", tx, ty).all()
    assert probe(view, drawn, trace, tx, ty).all()


def test_nodes_that_cannot_be_read_are_reported_once_and_coarser_ones_stand_in(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, "orogen")
    pyramid = pyramid_of(heights, GRID)
    pyramid.source.bad = lambda rows, cols: rows.start == 768 and cols.start == 512
    clipmap: Clipmap = clipmap_of(pyramid, None, settings())
    # also where the camera stands over what cannot be read
    for tx, ty in ((700, 800), (600, 850)):
        view, drawn = settle(clipmap, frame(tx, ty, pitch=-90.0))
    bad = set(clipmap.heights.failed)
    assert NodeKey(0, 2, 3) in bad
    assert {key.level for key in bad} == {0}
    assert len(bad) > 1
    (record,) = caplog.records
    assert "expected a block that can be read" in record.message
    (fault,) = clipmap.faults.all
    assert fault.missing == len(bad)
    found = probe(
        view, drawn, "vec4<f32>(f32(resident_level(p, 0u)), height_at(p), coverage_at(p), 0.0)", [600.0], [850.0]
    )
    assert found[0, 0] >= 1
    assert abs(found[0, 1] - heights[850, 600]) < 30
    assert found[0, 2] == 1


def test_estimates_are_replaced_once_the_pyramid_is_built(
    heights: NDArray, built: Pyramid, pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    pyramid = pyramid_of(heights, GRID, build="never")
    clipmap: Clipmap = clipmap_of(pyramid, None, settings())
    view, drawn = settle(clipmap, frame(700, 800))
    tx, ty = points()
    assert clipmap.heights.estimates > 0
    early = probe(view, drawn, EXPRESSION, tx, ty)
    levels = {key.level for key in clipmap.heights.current}
    assert 0 in levels
    assert 1 not in levels, "level 1 can be neither read nor estimated"
    assert built._store is not None
    pyramid._use(built._store, built._facts)
    assert clipmap.pump() >= 0
    view, drawn = settle(clipmap, frame(700, 800), view)
    assert clipmap.heights.estimates == 0
    late = probe(view, drawn, EXPRESSION, tx, ty)
    other, drawn = settle(clipmap_of(built, None, settings()), frame(700, 800))
    np.testing.assert_array_equal(late, probe(other, drawn, EXPRESSION, tx, ty))
    assert (late != early).any()


def test_heights_beyond_the_estimated_range_are_drawn(
    pyramid_of: Any, clipmap_of: Any, settle: Any, probe: Any
) -> None:
    """A peak that the decimated read misses is neither cut off nor culled once its node is there."""
    shape = (3000, 3000)
    grid = Grid(3000, 3000, (10.0, 0, 0, 0, -10.0, 0))
    heights = np.full(shape, 100, np.float32)
    heights[801, 701] = 900
    pyramid = pyramid_of(heights, grid, build="never")
    assert pyramid.height_range == (100, 100)
    x, y = (float(v) for v in grid.to_crs(701.5, 801.5))
    near = Frame(Camera(x, y, 1500.0, pitch=-90.0), grid, (192, 108))
    view, drawn = settle(clipmap_of(pyramid, None, settings()), near)
    assert drawn.height_range[1] >= 900
    found = probe(view, drawn, "vec4<f32>(height_at(p), bounds_over(p.cell, p.cell, 0u), 0.0)", [701.5], [801.5])[0]
    assert found[0] == 900
    assert found[1] <= 100
    assert found[2] >= 900


def test_views_share_the_atlas(built: Pyramid, clipmap_of: Any, probe: Any) -> None:
    clipmap: Clipmap = clipmap_of(built, None, settings(memory=96 << 20))
    frames = [frame(500, 500), frame(2000, 1700)]
    views = [clipmap.view() for _ in frames]
    for view, wide in zip(views, frames, strict=True):
        view.want(view.frame_for(wide))
    clipmap.settle()
    assert set(clipmap.heights.current) == set(views[0].wishes[0]) | set(views[1].wishes[0])
    for view, wide in zip(views, frames, strict=True):
        drawn = view.frame_for(wide)
        view.update(drawn)
        eye = drawn.eye
        assert probe(view, drawn, "vec4<f32>(f32(resident_level(p, 0u)))", [eye[0]], [eye[1]])[0, 0] == 0
    clipmap.drop(views[1])
    clipmap.settle()
    assert set(clipmap.heights.current) == set(views[0].wishes[0])


def test_colours_are_wanted_where_the_mountains_are(
    heights: NDArray, pyramid_of: Any, clipmap_of: Any, settle: Any
) -> None:
    """High ground in the picture: its image is loaded although at height 0 it would lie below the picture."""
    high = pyramid_of(heights + 8000, GRID)
    image = pyramid_of(np.full((2100, 2500, 4), 255, np.uint8), GRID)
    clipmap: Clipmap = clipmap_of(high, image, settings(memory=96 << 20, behind=0.0))
    view, _ = settle(clipmap, frame(1200, 1800, z=9500.0, heading=0.0, pitch=-10.0))
    assert set(view.wishes[0]) <= set(view.wishes[1])
    assert set(clipmap.layers[1].current) == set(view.wishes[1])
    assert len([key for key in view.wishes[1] if key.level == 0]) >= 2


def test_can_be_closed_while_it_loads(built: Pyramid, gpu: Gpu) -> None:
    before = gpu.memory.total
    for seed in range(30):
        clipmap = Clipmap(gpu, built, None, settings(threads=3, memory=8 << 20))
        view = clipmap.view()
        view.want(view.frame_for(frame(*np.random.default_rng(seed).uniform(0, 2000, 2))))
        for _ in range(seed % 4):
            clipmap.pump()
        clipmap.close()
    assert gpu.memory.total - before < 1 << 20


def test_too_little_memory_is_an_error_that_leaves_nothing_behind(built: Pyramid, pyramid_of: Any, gpu: Gpu) -> None:
    before, threads = gpu.memory.total, threading.active_count()
    with pytest.raises(BudgetError, match="height atlas: expected room for at least 6 nodes"):
        Clipmap(gpu, built, None, settings(memory=1 << 20))
    image = pyramid_of(np.zeros((20_000, 4, 4), np.uint8))
    with pytest.raises(BudgetError, match="colour atlas"):
        Clipmap(gpu, pyramid_of(np.zeros((4, 4), np.float32)), image, settings(memory=2 << 20))
    assert gpu.memory.total - before < 1 << 20
    assert threading.active_count() == threads


def test_the_ground_under_the_camera(heights: NDArray, built: Pyramid, clipmap_of: Any) -> None:
    clipmap: Clipmap = clipmap_of(built, None, settings())
    surface = RegularGridInterpolator((np.arange(2100) + 0.5, np.arange(2500) + 0.5), heights.astype(np.float64))
    places = [(700.3, 800.9), (0.5, 0.5), (2499.4, 2099.4), (0.0, 2100.0), (-1e7, 1e9), (1e12, -5)]
    for tx, ty in places:
        true = surface((np.clip(ty, 0.5, 2099.5), np.clip(tx, 0.5, 2499.5)))
        assert clipmap.height_under(*(float(v) for v in GRID.to_crs(tx, ty))) == pytest.approx(float(true), abs=1e-3)


def test_the_quadtree_is_written_only_when_it_changes(
    built: Pyramid, clipmap_of: Any, settle: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Layer] = []
    original = module.build_tables
    monkeypatch.setattr(module, "build_tables", lambda layer, *rest: calls.append(layer) or original(layer, *rest))
    clipmap: Clipmap = clipmap_of(built, None, settings())
    view, drawn = settle(clipmap, frame(700, 800))
    assert len(calls) == 1
    moved = replace(drawn, camera=drawn.camera.moved(x=drawn.camera.x + 0.5, heading=32.0), jitter=(0.2, 0.3))
    view.update(moved)
    assert len(calls) == 1
    settle(clipmap, frame(2000, 300), view)
    assert len(calls) == 2
