"""rag against its float64 twin, and what its triangles promise: shared edges, true heights, no end in itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.lists import Drawn, read
from lod.patches import torn_edges
from lod.rag_twin import Triangle, Twin, area, edges, holds_vertex, vertices
from lod.restricted import some_cameras, unculled
from lod.scene import Buffers, Scene, noise
from oracle.landscapes import hills
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.contract import AlgorithmView
from orogen.lod.rag import Settings
from orogen.lod.rag.budget import Pace

SIZE = (160, 100)
ROWS, COLUMNS = 22, 35
RUNS: list[dict[str, Any]] = [
    {"metric": "screen_error", "threshold": 6.0, "coarse": 6},
    {"metric": "samples", "threshold": 12.0, "coarse": 9, "samples": 4},
    {"metric": "area", "threshold": 8.0, "coarse": 4},
    {"metric": "object_error", "threshold": 12.0, "coarse": 6, "depth_detail": 0.3},
    {"metric": "height_difference", "threshold": 25.0, "coarse": 6},
    {"metric": "samples", "threshold": 9.0, "coarse": 6, "move_to_worst": True},
    {"variant": "conforming", "metric": "screen_error", "threshold": 8.0, "coarse": 4},
    {"variant": "conforming", "metric": "height_difference", "threshold": 30.0, "coarse": 8},
    {"variant": "right_angled", "threshold": 25.0, "coarse": 6, "depth_detail": 0.2},
    {"variant": "right_angled", "threshold": 35.0, "coarse": 2},
]
VARIANTS = ["oblique", "right_angled", "conforming"]


def usual(variant: str, pixels: float, **more: Any) -> dict[str, Any]:
    """Settings with a threshold in pixels, or with metres that make about as many triangles of `hilly`."""
    return {"variant": variant, "threshold": (30 if variant == "right_angled" else 1) * pixels, **more}


def heights(rows: int = ROWS, columns: int = COLUMNS) -> NDArray[np.float32]:
    """Rough in places, smooth in others, so that decisions differ from edge to edge."""
    rough = noise(rows, columns, 40.0)
    rough[:, columns // 2 :] *= 0.05
    return hills(max(rows, columns), 300.0)[:rows, :columns].astype(np.float32) + rough


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, heights())) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hills(400, 500.0).astype(np.float32)[:300], view_distance=0.7)) as terrain:
        yield terrain


def cells(drawn: Drawn, frame: Frame) -> list[Triangle]:
    """Triangles in subtexels from the first sample."""
    at = np.rint(drawn.texels * 2**frame.subtexel_bits).astype(int)
    return [tuple(map(tuple, triangle)) for triangle in at.tolist()]


def frames(scene: Scene) -> list[Frame]:
    """Seen from aside, straight from above, by a frozen camera, without perspective; nothing is culled."""
    over = scene.camera(15, 33, 300, pitch=-35, heading=20)
    found = [
        scene.frame(over, SIZE),
        scene.frame(scene.camera(12, 12, 400, pitch=-89), SIZE, exaggeration=0.6, curvature=True),
        scene.frame(over.moved(z=700.0, pitch=-80.0), SIZE, lod_camera=over.moved(heading=-40.0)),
        scene.frame(over.moved(orthographic=450.0), SIZE),
    ]
    return [unculled(frame) for frame in found]


@pytest.mark.parametrize("values", RUNS, ids=str)
def test_triangles_are_those_of_the_twin(scene: Scene, values: dict[str, Any]) -> None:
    state = scene.algorithm("rag", values)
    kinds = frames(scene)
    for frame in (kinds[0], kinds[1 + RUNS.index(values) % 3]):
        drawn = read(scene, frame, state)
        ours = cells(drawn, frame)
        twin = Twin(frame, make_settings("rag", values), heights(), vertices(ours))
        theirs = twin.refine()
        assert twin.close <= 0.01 * twin.asked + 1
        assert len(theirs) > len(twin.coarse())
        if twin.invisible:
            assert_welded(ours, theirs)
        else:
            # from the right angle on, so that the longest edge has kept its place
            assert Counter(ours) == Counter(theirs)
        known = vertices(theirs)
        for triangle, height in zip(ours, drawn.corners["height"].tolist(), strict=True):
            for corner, h in zip(triangle, height, strict=True):
                # others stand in the middle of welded triangles
                if corner in known:
                    assert h == pytest.approx(twin.height(corner), abs=1e-3)


def assert_welded(ours: list[Triangle], theirs: list[Triangle]) -> None:
    """Triangles that have invisible vertices on their edges are cut up to meet these; all others are the same."""
    known = vertices(theirs)
    met = [any(holds_vertex(*at, known) for at in edges(triangle)) for triangle in theirs]
    assert 0 < sum(met) < len(theirs)
    plain = Counter(triangle for triangle, cut in zip(theirs, met, strict=True) if not cut)
    assert not plain - Counter(ours)
    parts = Counter(ours) - plain
    cut = [triangle for triangle, cut in zip(theirs, met, strict=True) if cut]
    assert sum(map(area, parts.elements())) == pytest.approx(sum(map(area, cut)))
    # nothing is left that meets another's edge, and every part has an area
    assert not any(holds_vertex(*at, known) for triangle in parts for at in edges(triangle))
    assert min(map(area, parts)) > 0
    assert known <= vertices(ours)


@pytest.mark.parametrize("shape", [(ROWS, COLUMNS), (2, 3), (40, 2)], ids=str)
@pytest.mark.parametrize("variant", VARIANTS)
def test_edges_are_shared_bit_for_bit(gpu: Gpu, shape: tuple[int, int], variant: str) -> None:
    rows, columns = shape
    with closing(Scene(gpu, noise(rows, columns), view_distance=0.3)) as scene:
        state = scene.algorithm("rag", {"variant": variant, "threshold": 8.0, "coarse": 7})
        for camera in some_cameras(scene, 2, seed=6):
            frame = unculled(scene.frame(camera, SIZE))
            drawn = read(scene, frame, state)
            positions = drawn.corners["position"]
            x, y = positions[..., 0], positions[..., 1]
            assert len(torn_edges(positions, (x.min(), y.min(), x.max(), y.max()))) == 0
            ours = cells(drawn, frame)
            # nothing is folded over, nothing is without area
            assert sum(map(area, ours)) == (rows - 1) * (columns - 1) << 2 * frame.subtexel_bits
            assert min(map(area, ours)) > 0


@pytest.mark.parametrize("variant", VARIANTS)
def test_turning_opens_no_edge_in_the_frustum(scene: Scene, variant: str) -> None:
    state = scene.algorithm("rag", {"variant": variant, "threshold": 6.0, "coarse": 12})
    counts = []
    for heading in np.arange(0, 360, 60.0):
        frame = scene.frame(scene.camera(17, 11, 220, heading=heading, pitch=-10), SIZE)
        drawn = read(scene, frame, state)
        counts.append(len(drawn.corners))
        positions = drawn.corners["position"]
        torn = torn_edges(positions, (np.nan,) * 4).astype(np.float64)
        texel = torn[..., :2] @ np.linalg.inv(frame.grid.metres).T + frame.eye - 0.5
        last = np.array([COLUMNS, ROWS]) - 1.0
        border = ((np.abs(texel) < 1e-3) | (np.abs(texel - last) < 1e-3)).all(axis=1).any(axis=1)
        planes = frame.planes()
        outside = (torn @ planes[:, :3].T + planes[:, 3] < 0).all(axis=1).any(axis=1)
        assert (border | outside).all()
    # a good part is dropped
    everything = len(read(scene, unculled(frame), state).corners)
    assert max(counts) < 0.8 * everything


@pytest.mark.parametrize("variant", VARIANTS)
def test_dropping_triangles_never_changes_the_picture(hilly: Scene, variant: str) -> None:
    state = hilly.algorithm("rag", usual(variant, 4.0))
    for k, camera in enumerate(some_cameras(hilly, 4, seed=17)):
        frame = hilly.frame(camera, (96, 64), curvature=k == 1, exaggeration=1.0 + k % 2)
        culled = hilly.draw(frame, state)
        everything = hilly.draw(unculled(frame), state)
        if variant == "oblique":
            np.testing.assert_array_equal(culled["depth"], everything["depth"])
        # forced splits do not come in from outside
        assert ((culled["depth"] > 0) == (everything["depth"] > 0)).mean() > 0.999


def test_right_angles(gpu: Gpu) -> None:
    """On whole coarse cells triangles are right-angled with two equal legs; oblique ones are what they are called."""
    with closing(Scene(gpu, heights(33, 33))) as scene:
        frame = unculled(scene.frame(scene.camera(16, 16, 300, pitch=-60), SIZE))
        odd = {}
        for variant in ("oblique", "conforming"):
            state = scene.algorithm("rag", {"variant": variant, "coarse": 4, "threshold": 4.0})
            at = np.array(cells(read(scene, frame, state), frame))
            one, other = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
            square = (one**2).sum(axis=1) == (other**2).sum(axis=1)
            odd[variant] = int((~square | ((one * other).sum(axis=1) != 0)).sum())
        assert odd["conforming"] == 0
        assert odd["oblique"] > 50


def test_forced_splits_close_the_gap(hilly: Scene) -> None:
    """Free decisions need far fewer triangles than monotonic ones, and right angles cost little then (section 6.1)."""
    frame = unculled(hilly.frame(hilly.camera(200, 330, 700, pitch=-35), SIZE))
    found = {}
    for variant, threshold in (("oblique", 1.0), ("conforming", 1.0), ("right_angled", 12.0)):
        values = {"variant": variant, "threshold": threshold, "coarse": 10, "depth_detail": 0.0}
        drawn = read(hilly, frame, hilly.algorithm("rag", values))
        found[variant] = len(drawn.corners), surface_gap(drawn, frame)
    assert found["oblique"][0] < found["conforming"][0] < 1.4 * found["oblique"][0]
    assert found["conforming"][1] < 1.05 * found["oblique"][1]
    assert found["conforming"][0] < 0.5 * found["right_angled"][0]
    assert found["conforming"][1] < found["right_angled"][1]


def surface_gap(drawn: Drawn, frame: Frame) -> float:
    """Mean distance in pixels, face on, of the true surface to the triangles at their centres."""
    surface = hills(400, 500.0)[:300]
    centre = drawn.texels.mean(axis=1)
    column, row = np.clip(np.floor(centre).astype(int).T, 0, [[398], [298]])
    x, y = centre[:, 0] - column, centre[:, 1] - row
    top = surface[row, column] * (1 - x) + surface[row, column + 1] * x
    bottom = surface[row + 1, column] * (1 - x) + surface[row + 1, column + 1] * x
    off = np.abs(top * (1 - y) + bottom * y - drawn.corners["height"].mean(axis=1))
    away = np.linalg.norm(drawn.corners["position"].mean(axis=1), axis=1)
    weight = np.array([area(triangle) for triangle in cells(drawn, frame)]) / away**2
    return float((off * frame.pixels_per_radian() / away * weight).sum() / weight.sum())


@pytest.mark.parametrize("variant", VARIANTS)
def test_too_little_room_is_mended(hilly: Scene, variant: str) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 500, pitch=-40))
    values = usual(variant, 1.0, coarse=8)
    roomy = hilly.algorithm("rag", values)
    whole = hilly.draw(frame, roomy)
    assert roomy.statistics().triangles > 1000
    tight = hilly.algorithm("rag", {**values, "triangle_capacity": 64})
    first = hilly.raster(frame, hilly.record(frame, tight))
    # coarser for want of room, without a hole
    assert 0 < tight.statistics().triangles < roomy.statistics().triangles
    assert ((first["depth"] > 0) == (whole["depth"] > 0)).mean() > 0.96
    assert tight.incomplete()
    assert_same(hilly.draw(frame, tight), whole)
    assert not tight.incomplete()
    # and without being asked
    alone = hilly.algorithm("rag", {**values, "triangle_capacity": 64})
    for _ in range(12):
        drawn = hilly.raster(frame, hilly.record(frame, alone))
    assert_same(drawn, whole)


def assert_same(one: Buffers, other: Buffers) -> None:
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])


def test_room_without_end_is_refused(hilly: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BudgetError, match="raise threshold"):
        hilly.algorithm("rag", {"triangle_capacity": 1 << 26})
    # as many as fit are drawn
    monkeypatch.setitem(hilly.gpu.limits, "max-storage-buffer-binding-size", 80 << 11)
    state = hilly.algorithm("rag", {"threshold": 0.02, "triangle_capacity": 64, "coarse": 8})
    frame = hilly.frame(hilly.camera(200, 200, 500, pitch=-40))
    with pytest.raises(BudgetError, match="expected room for at most 2048 triangles, got"):
        hilly.draw(frame, state)
    for _ in range(12):
        drawn = hilly.raster(frame, hilly.record(frame, state))
    assert (drawn["depth"] > 0).any()
    assert 64 < state.statistics().triangles <= 2048


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_time_budget_is_kept_and_a_still_camera_sees_everything(hilly: Scene, variant: str) -> None:
    frame = hilly.frame(hilly.camera(200, 330, 600, pitch=-25))
    values = usual(variant, 1.0, coarse=6)
    whole = hilly.draw(frame, hilly.algorithm("rag", values))
    # so little that each frame has time for one pass
    hurried = hilly.algorithm("rag", {**values, "time_budget": 1e-6})
    counts = progress(hilly, frame, hurried)
    assert len(counts) > 4
    if variant == "oblique":
        assert counts == sorted(counts)
        assert counts[0] < counts[-1] / 2
    assert_same(hilly.raster(frame, hilly.record(frame, hurried)), whole)
    # another camera begins anew, and ends with what there is to see from there
    aside = hilly.frame(hilly.camera(150, 300, 500, pitch=-30))
    assert progress(hilly, aside, hurried)[-1] != counts[-1]
    assert_same(hilly.draw(aside, hurried), hilly.draw(aside, hilly.algorithm("rag", values)))
    # samples of a picture do not
    hilly.raster(aside, hilly.record(Frame(**{**vars_of(aside), "jitter": (0.25, -0.25)}), hurried))
    assert not hurried.incomplete()


def vars_of(frame: Frame) -> dict[str, Any]:
    return {name: getattr(frame, name) for name in Frame.__dataclass_fields__}


def progress(scene: Scene, frame: Frame, state: AlgorithmView) -> list[int]:
    """Triangles frame by frame, until nothing is left to be done."""
    counts = []
    while True:
        scene.record(frame, state)
        counts.append(state.statistics().triangles)
        if not state.incomplete():
            return counts


def test_the_pace_follows_what_was_measured() -> None:
    pace = Pace()
    assert pace.passes(0, 9, 5.0) == 1
    pace.learn({"refine 0": 1.0, "coarse": 9.0, "refine": 9.0, "draw": 4.0})
    # 1 + 4 + 16: the third would be too much
    assert pace.passes(0, 9, 5.0) == 2
    assert pace.passes(3, 9, 5.0) == 1
    pace.learn({"refine 1": 1.5, "refine 2": 2.0})
    assert pace.passes(0, 9, 5.0) == 3
    assert pace.passes(0, 2, 5.0) == 2
    assert pace.passes(2, 9, 1.0) == 1


def test_a_frame_may_bring_its_own_time_budget(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 330, 600, pitch=-25))
    state = hilly.algorithm("rag", {"threshold": 2.0, "coarse": 6})
    assert len(progress(hilly, frame, state)) == 1
    assert len(progress(hilly, Frame(**{**vars_of(frame), "time_budget": 1e-9}), state)) > 4


@pytest.mark.parametrize("variant", VARIANTS)
def test_recursion_ends_with_the_samples(gpu: Gpu, variant: str) -> None:
    values = {"variant": variant, "threshold": 1e-6, "metric": "height_difference", "coarse": 4}
    with closing(Scene(gpu, noise(9, 17))) as scene:
        frame = unculled(scene.frame(scene.camera(8, 10, 420, pitch=-75), SIZE))
        found = [read(scene, frame, scene.algorithm("rag", {**values, "depth": n})) for n in (0, 1, 2, 1000)]
        assert [len(drawn.corners) for drawn in found] == [2 * 4 * 2, 8 * 4 * 2, 32 * 4 * 2, 32 * 4 * 2]
        # a vertex for every sample and none between
        assert vertices(cells(found[-1], frame)) == {(x << 8, y << 8) for x in range(17) for y in range(9)}


def test_recursion_ends_where_the_surface_is_flat(gpu: Gpu) -> None:
    """The surface between four samples is bent: errors go on there, but not without end."""
    with closing(Scene(gpu, noise(3, 5))) as scene:
        frame = unculled(scene.frame(scene.camera(2, 3, 90, pitch=-75), SIZE))
        found = [
            len(read(scene, frame, scene.algorithm("rag", {"threshold": 1e-9, "coarse": 4, **more})).corners)
            for more in ({}, {"depth": 1000})
        ]
        assert 2 * 4 * 2 * 16 < found[0] <= 2 * 4 * 2 * 64
        assert found[0] == found[1]


@pytest.mark.parametrize("coarse", [1, 512])
def test_any_coarse_mesh_gives_a_right_picture(hilly: Scene, coarse: int) -> None:
    """One cell, and more cells than samples."""
    frame = hilly.frame(hilly.camera(200, 330, 600, pitch=-25), SIZE)
    usual = hilly.frame(frame.camera, SIZE).positions(hilly.draw(frame, hilly.algorithm("rag"))["depth"])
    other = frame.positions(hilly.draw(frame, hilly.algorithm("rag", {"coarse": coarse}))["depth"])
    off = np.linalg.norm(usual - other, axis=2)
    assert (np.isnan(usual) == np.isnan(other)).mean() > 0.99
    # a pixel's width
    distance = np.linalg.norm(usual - [*frame.grid.to_crs(*frame.eye), frame.camera.z], axis=2)
    assert np.nanmean(off / distance) * frame.pixels_per_radian() < 2.0


@pytest.mark.parametrize("variant", VARIANTS)
def test_large_voids_stay_empty(gpu: Gpu, variant: str) -> None:
    holes = hills(200, 300.0).astype(np.float32)
    holes[40:160, 30:120] = np.nan
    holes[:, 170:] = np.nan
    with closing(Scene(gpu, holes)) as scene:
        frame = scene.frame(scene.camera(100, 100, 2200, pitch=-90), SIZE)
        state = scene.algorithm("rag", {"variant": variant, "threshold": 0.5})
        depth = scene.draw(frame, state)["depth"]
        truth = scene.draw(frame, scene.algorithm("raycast"))["depth"]
        assert 0.3 < (truth > 0).mean() < 0.95
        assert ((depth > 0) == (truth > 0)).mean() > 0.995
        both = (depth > 0) & (truth > 0)
        assert np.abs(1 / depth[both] - 1 / truth[both]).mean() < 0.02 / truth[both].mean()


@pytest.mark.parametrize("variant", VARIANTS)
def test_each_run_is_the_same_and_a_frozen_camera_keeps_its_triangles(hilly: Scene, variant: str) -> None:
    values = usual(variant, 2.0)
    eye = hilly.camera(200, 330, 600, pitch=-25)
    own = read(hilly, hilly.frame(eye), hilly.algorithm("rag", values))
    again = read(hilly, hilly.frame(eye), hilly.algorithm("rag", values))
    np.testing.assert_array_equal(own.corners, again.corners)
    aside = eye.moved(x=eye.x - 1234.0, z=2000.0, heading=40.0, pitch=-60.0)
    frozen = read(hilly, hilly.frame(aside, lod_camera=eye), hilly.algorithm("rag", values))
    ids = [Counter(map(tuple, drawn.corners[["id", "tile_level"]].tolist())) for drawn in (own, frozen)]
    # heights are blended by rounded distances
    assert sum(((ids[0] - ids[1]) + (ids[1] - ids[0])).values()) <= 0.002 * 3 * len(own.corners)


def test_parts_of_an_edge_that_is_left_whole_ask_for_nothing(scene: Scene) -> None:
    """Decisions by height differences are monotonic, also where they count less with the distance (section 4.2.1)."""
    frame = frames(scene)[0]
    values = {"variant": "right_angled", "threshold": 20.0, "depth_detail": 0.0}
    twin = Twin(frame, make_settings("rag", values), heights(), set())
    random = np.random.default_rng(4)
    left = 0
    for _ in range(300):
        a, b = (tuple((random.integers(0, [COLUMNS, ROWS]) * 256).tolist()) for _ in range(2))
        if a == b or twin.measure(a, b)[0] >= 20:
            continue
        left += 1
        m = ((a[0] + b[0]) // 2, (a[1] + b[1]) // 2)
        twin.invisible = {m: (twin.height(a) + twin.height(b)) / 2}
        assert max(twin.measure(a, m)[0], twin.measure(m, b)[0]) < 20
        twin.invisible = {}
    assert left > 50


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("rag")
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().triangles == 0


def test_a_single_sample_draws_nothing(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((1, 1), 5.0))) as scene:
        frame = scene.frame(scene.camera(0.5, 0.5, 100, pitch=-90))
        assert (scene.draw(frame, scene.algorithm("rag"))["depth"] == 0).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"variant": "obligue"}, "variant: expected one of oblique, right_angled, conforming, got 'obligue'; did you"),
        ({"metric": "screen"}, "metric: expected one of height_difference.*got 'screen'"),
        ({"variant": "right_angled", "metric": "samples"}, "metric: expected height_difference for right_angled"),
        ({"threshold": "0"}, "threshold: expected a number above 0, got 0"),
        ({"threshold": "-2"}, "threshold: expected a number above 0, got -2"),
        ({"threshold": "nan"}, "threshold: expected a number above 0, got nan"),
        ({"samples": "0"}, "samples: expected 1 to 15 on an edge, got 0"),
        ({"samples": "16"}, "samples: expected 1 to 15 on an edge, got 16"),
        ({"move_to_worst": "true", "variant": "conforming"}, "move_to_worst: expected oblique .* got conforming"),
        ({"move_to_worst": "true", "metric": "screen_error"}, "move_to_worst: expected .* got oblique and screen_err"),
        ({"depth_detail": "1.5"}, "depth_detail: expected 0 to 1, got 1.5"),
        ({"coarse": "0"}, "coarse: expected 1 to 512 cells, got 0"),
        ({"depth": "-1"}, "depth: expected at least 0 passes, got -1"),
        ({"time_budget": "0"}, "time_budget: expected milliseconds above 0, got 0"),
        ({"triangle_capacity": "10"}, "triangle_capacity: expected at least 64 triangles, got 10"),
        ({"treshold": "3"}, "did you mean threshold"),
    ],
)
def test_settings_out_of_range_are_named(values: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("rag", values)


def test_settings_are_read_from_text() -> None:
    values = {"variant": "conforming", "metric": "none", "threshold": "2.5", "depth": "3", "time_budget": "none"}
    assert make_settings("rag", values) == Settings("conforming", None, 2.5, depth=3)
    assert Settings("right_angled").measured == "height_difference"
    assert Settings().measured == "samples"
