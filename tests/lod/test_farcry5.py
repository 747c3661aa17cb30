"""farcry5 against a float64 twin: its nodes, its stitched vertices, and culling that no picture shows."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod import restricted
from lod.farcry5_twin import Node, Twin
from lod.patches import torn_edges
from lod.scene import Buffers, Scene, noise
from lod.triangles import read_triangles, with_area
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Buffer, Gpu
from orogen.keys import NodeKey
from orogen.lod import make_settings
from orogen.lod.contract import AlgorithmView
from orogen.lod.farcry5 import Settings
from orogen.raster.surface import Surface

UNCULLED = {"frustum": False, "back_face": False, "occlusion": False}
CULLED = {"frustum": True, "back_face": True, "occlusion": True}
SIZE = (96, 60)


STEEP_HILLS = hills(400, 900.0).astype(np.float32)[:300]
GROUND = float(STEEP_HILLS[149:151, 199:201].max())
"""Height under texel coordinates (200, 150)."""
STEEP = [
    {"pitch": 0.0}, {"pitch": -30.0, "heading": 120.0}, {"pitch": 12.0, "heading": 220.0}, {"pitch": -89.0},
]  # fmt: skip


def nodes_of(patches: NDArray[np.int64]) -> set[Node]:
    return {(level, x >> 3, y >> 3) for level, x, y in patches.tolist()}


def patches_of(draw: NDArray[Any]) -> NDArray[np.int64]:
    """(patches, 3): level, column, row."""
    level = draw["tile_level"][:, 0, 0].astype(np.int64)
    rest = draw["id"][:, 0, 0].astype(np.int64) ^ (level << 26)
    return np.stack([level, rest & 0x1FFF, rest >> 13], axis=1)


def read(scene: Scene, frame: Frame, state: AlgorithmView) -> NDArray[Any]:
    """(patches, triangles, 3) corners of the whole list."""
    scene.record(frame, state)
    while state.incomplete():
        scene.record(frame, state)
    (draw,) = read_triangles(scene, frame, state)
    return draw


def show(scene: Scene, frame: Frame, state: AlgorithmView, surface: Surface | None = None) -> Buffers:
    """The surface buffer after both passes, as the renderer makes it."""
    target = surface or scene.rasterizer.surface(frame.size)
    while True:
        scene.view.update(frame)
        encoder = scene.gpu.encoder("show")
        draws = state.record(encoder, scene.timer, frame, scene.view)
        scene.rasterizer.record(encoder, scene.timer, draws, scene.view, target)
        more = state.drawn(encoder, scene.timer, frame, scene.view, target.targets["depth"])
        scene.rasterizer.record(encoder, scene.timer, more, scene.view, target, clear=False)
        scene.timer.resolve(encoder)
        scene.gpu.submit(encoder)
        if not state.incomplete():
            break
    result = {name: target.read(name).result() for name in ("depth", "id", "detail")}
    if surface is None:
        target.destroy()
    return result


def settled(scene: Scene, camera: Camera, **changes: Any) -> Frame:
    """A frame that knows the range of the heights, which a terrain tells when its nodes are loaded."""
    frame = scene.view.frame_for(scene.frame(camera, SIZE, **changes))
    scene.view.update(frame)
    return frame


def counts(state: AlgorithmView) -> dict[str, int]:
    found = state._read_state()  # type: ignore[attr-defined]
    return {name: int(found[name]) for name in found.dtype.names}


def assert_same(one: Buffers, other: Buffers) -> None:
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])


def assert_same_but_for_ties(one: Buffers, other: Buffers) -> None:
    """On a crest a triangle that shows its underside may be nearer than its neighbour, by a depth's rounding."""
    tied = one["id"] != other["id"]
    assert tied.mean() <= 1e-3
    np.testing.assert_allclose(one["depth"], other["depth"], rtol=1e-4)
    np.testing.assert_array_equal(one["depth"][~tied], other["depth"][~tied])


def some_cameras(scene: Scene, count: int, seed: int) -> list[Camera]:
    """Over, beside and far above the terrain, looking anywhere; the last one is orthographic."""
    cameras = restricted.some_cameras(scene, count, seed, up=10, roll=20)
    return [*cameras[:-1], cameras[-1].moved(orthographic=700.0, pitch=-40.0)]


@pytest.fixture(scope="module", params=[(700, 1025), (2, 3), (300, 2)], ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, noise(*request.param), view_distance=0.5)) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def steep(gpu: Gpu) -> Iterator[Scene]:
    """Hills as steep as 45 degrees, many of which hide others."""
    with closing(Scene(gpu, STEEP_HILLS)) as terrain:
        yield terrain


@pytest.mark.parametrize("settings", [{"pixels_per_quad": 40.0}, {"patch_quads": 4, "pixels_per_quad": 12.0}], ids=str)
def test_nodes_are_those_of_the_twin_and_edges_match_bit_for_bit(scene: Scene, settings: dict[str, Any]) -> None:
    settings = {**settings, **UNCULLED}
    state = scene.algorithm("farcry5", settings)
    for k, camera in enumerate(some_cameras(scene, 3, seed=5 + len(settings))):
        changes = [{"exaggeration": 2.0}, {"lod_camera": camera.moved(z=camera.z + 50, heading=9.0)}, {}][k]
        frame = settled(scene, camera, **changes)
        draw = read(scene, frame, state)
        twin = Twin(scene, frame, make_settings("farcry5", settings))
        expected, close = twin.refine()
        patches = patches_of(draw)
        assert nodes_of(patches) - close == expected - close
        assert len(close) <= 0.02 * len(expected) + 4
        assert_whole(twin, draw)
        assert_vertices(twin, draw)


def assert_whole(twin: Twin, draw: NDArray[Any]) -> None:
    """Patches cover the data once, and their triangles leave no gap inside."""
    patches = patches_of(draw)
    assert len(np.unique(patches, axis=0)) == len(patches)
    low = patches[:, 1:] * (twin.width(0) / 8 * 2.0 ** patches[:, :1])
    high = np.minimum(low + twin.width(0) / 8 * 2.0 ** patches[:, :1], twin.size)
    assert np.prod(high - low, axis=1).sum() == pytest.approx(float(np.prod(twin.size)))
    torn = torn_edges(with_area([draw]), (np.nan,) * 4)
    texel = torn[..., :2] @ np.linalg.inv(twin.frame.grid.metres).T + twin.frame.eye - 0.5
    border = (np.abs(texel) < 1e-3) | (np.abs(texel - twin.size) < 1e-3)
    assert border.all(axis=1).any(axis=1).all()


def assert_vertices(twin: Twin, draw: NDArray[Any]) -> None:
    """On a side with coarser nodes beyond, vertices are moved back to those that these have."""
    patches = patches_of(draw)
    nodes = nodes_of(patches)
    quad = twin.leaf * 2.0 ** patches[:, 0]
    steps = np.zeros((len(patches), 4), int)
    for i, (level, x, y) in enumerate(patches.tolist()):
        for side, (dx, dy) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
            px, py = (x + dx) >> 3, (y + dy) >> 3
            found = [s for s in range(twin.root - level + 1) if (level + s, px >> s, py >> s) in nodes]
            steps[i, side] = found[0] if found else 0
    grid = draw["grid"].astype(int)
    at = grid + (patches[:, 1:] * twin.quads)[:, None, None]
    moved = at.copy()
    for axis, side, rim in ((1, 0, 0), (1, 1, twin.quads), (0, 2, 0), (0, 3, twin.quads)):
        step = steps[:, side][:, None, None]
        on_rim = grid[..., 1 - axis] == rim
        moved[..., axis] = np.where(on_rim, at[..., axis] >> step << step, moved[..., axis])
    past = at * quad[:, None, None, None] >= twin.size
    expected = np.minimum(np.where(past, at, moved) * quad[:, None, None, None], twin.size)
    bits = twin.frame.subtexel_bits
    texel = (draw["offset"] + twin.frame.anchor.astype(np.float64)) / 2**bits - 0.5
    np.testing.assert_allclose(texel, expected, atol=2e-7 * max(1.0, np.abs(draw["offset"]).max() / 2**bits))


def test_a_node_is_split_only_if_all_its_children_are_resident(gpu: Gpu) -> None:
    """With some children missing neighbours differ by many levels, and still no edge is torn."""
    with closing(Scene(gpu, noise(1000, 1025))) as scene:
        settings = {**UNCULLED, "patch_quads": 4, "pixels_per_quad": 8.0}
        state = scene.algorithm("farcry5", settings)
        # just across the border of a node that is missing, near enough for the finest quads
        frame = scene.frame(scene.camera(510.0, 300.0, 65.0, pitch=-20), (160, 100), load=False)
        top = NodeKey(3, 0, 0)
        coarse = [NodeKey(1, x, y) for x in (0, 1) for y in (0, 1)]
        fine = [NodeKey(0, x, y) for x in (0, 1) for y in (0, 1)]
        seen = []
        for keys in ([], coarse, [*coarse, *fine], [*coarse, *fine[:3]], [*coarse[:3], *fine]):
            scene.load([top, *keys])
            frame = scene.view.frame_for(frame)
            scene.view.update(frame)
            draw = read(scene, frame, state)
            twin = Twin(scene, frame, make_settings("farcry5", settings))
            expected, close = twin.refine()
            found = nodes_of(patches_of(draw))
            assert found - close == expected - close
            assert_whole(twin, draw)
            assert_vertices(twin, draw)
            seen.append(found)
        root = twin.root
        assert seen[0] == {(root, 0, 0)}
        assert seen[1] == {(root - 1, x, y) for x in (0, 1) for y in (0, 1)}
        # at the border of what is resident levels are as far apart as the vertices of a node allow
        assert {level for level, _, _ in seen[2]} >= {root - 1, root - 6}
        # three of four are as good as none
        assert seen[3] == seen[1]
        assert seen[4] == seen[0]


def test_a_sheared_terrain_is_whole(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(300, 300), metres=np.array([[10.0, 7.0], [1.0, -8.0]]))) as scene:
        settings = {**UNCULLED, "patch_quads": 8, "pixels_per_quad": 40.0}
        state = scene.algorithm("farcry5", settings)
        for camera in some_cameras(scene, 3, seed=8)[:-1]:
            frame = settled(scene, camera)
            draw = read(scene, frame, state)
            twin = Twin(scene, frame, make_settings("farcry5", settings))
            expected, close = twin.refine()
            assert nodes_of(patches_of(draw)) - close == expected - close
            assert_whole(twin, draw)


def test_quads_are_no_wider_than_was_asked_for(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((500, 600), 50.0))) as scene:
        asked = 6.0
        state = scene.algorithm("farcry5", {**UNCULLED, "pixels_per_quad": asked})
        for up in (300.0, 1500.0):
            frame = settled(scene, scene.camera(300, 250, 50 + up, pitch=-90))
            draw = read(scene, frame, state)
            p = draw["position"][:, :, :2].astype(np.float64)
            side = np.linalg.norm(p[:, ::2, 1] - p[:, ::2, 0], axis=2)
            pixels = side / np.linalg.norm(p, axis=3).min(axis=2)[:, ::2] * frame.pixels_per_radian()
            assert pixels.max() <= asked * 1.001
            assert pixels.max() >= asked * 0.5


def steep_cameras(scene: Scene) -> list[Camera]:
    """In valleys and on crests, under ground, outside looking under the terrain, and above."""
    low = [scene.camera(200, 150, GROUND + 3, **angles) for angles in STEEP[:3]]
    high = [scene.camera(60, 220, 900, **angles) for angles in STEEP[1::2]]
    below = [scene.camera(230, 100, -50, pitch=25.0), scene.camera(140, 60, 250, pitch=10.0, heading=90.0)]
    # its near plane cuts off the crests before it
    cutting = scene.camera(200, 150, GROUND + 30, near=300.0, heading=180.0, pitch=-5.0)
    beside = [scene.camera(-60, 100, 300, heading=90.0), scene.camera(420, 320, 100, heading=300.0, pitch=5.0)]
    return [*low, *high, *below, *beside, cutting, high[0].moved(orthographic=2500.0, pitch=-10.0)]


@pytest.mark.parametrize("holes", [False, True])
def test_no_cull_changes_the_picture(gpu: Gpu, holes: bool) -> None:
    heights = STEEP_HILLS.copy()
    if holes:
        heights[100:140, 150:260] = np.nan
        heights[200:, 30:60] = np.nan
    with closing(Scene(gpu, heights)) as scene:
        shape = {"patch_quads": 4, "pixels_per_quad": 12.0}
        whole = scene.algorithm("farcry5", {**UNCULLED, **shape})
        choices = [("frustum",), ("back_face",), ("occlusion",), ("frustum", "back_face")]
        culls = {
            cull: scene.algorithm("farcry5", {**UNCULLED, **dict.fromkeys(cull, True), **shape}) for cull in choices
        }
        fewer = dict.fromkeys(culls, 0)
        for camera in steep_cameras(scene):
            frame = scene.frame(camera, SIZE)
            expected = show(scene, frame, whole)
            for cull, state in culls.items():
                for _ in range(1 + ("occlusion" in cull)):
                    drawn = show(scene, frame, state)
                    if "back_face" in cull:
                        assert_same_but_for_ties(drawn, expected)
                    else:
                        assert_same(drawn, expected)
                fewer[cull] += whole.statistics().patches - state.statistics().patches
        assert fewer["frustum",] > 0
        assert fewer["occlusion",] > 0
        # undersides can be seen through holes: nothing is culled there for showing only them
        assert (fewer["back_face",] > 0) == (not holes)


def test_back_faces_are_what_they_are_called(steep: Scene) -> None:
    shape = {"patch_quads": 4, "pixels_per_quad": 10.0, **UNCULLED}
    whole = steep.algorithm("farcry5", shape)
    part = steep.algorithm("farcry5", {**shape, "back_face": True})
    culled = 0
    for camera in steep_cameras(steep)[1:8:2]:
        frame = settled(steep, camera)
        all_of_it = read(steep, frame, whole)
        kept = set(map(tuple, patches_of(read(steep, frame, part)).tolist()))
        gone = np.array([tuple(p) not in kept for p in patches_of(all_of_it).tolist()])
        culled += gone.sum()
        a, b, c = with_area([all_of_it[gone]]).astype(np.float64).swapaxes(0, 1)
        up = np.cross(c - a, b - a)
        assert (up[:, 2] > 0).all()
        assert (np.einsum("ij,ij->i", up, -a) < 0).all()
        # a patch that is kept shows an upper side, or something could be seen from below
        if gone.any():
            k = all_of_it[~gone]["position"].astype(np.float64)
            facing = np.einsum("ptj,ptj->pt", np.cross(k[:, :, 2] - k[:, :, 0], k[:, :, 1] - k[:, :, 0]), -k[:, :, 0])
            assert (facing.max(axis=1) > -1e-3 * np.abs(facing).max()).all()
    assert culled > 20


def wall(gpu: Gpu) -> Scene:
    """A plain behind a long wall."""
    heights = noise(300, 300, relief=5.0)
    heights[150:154] = 400.0
    return Scene(gpu, heights)


def test_what_a_wall_hides_is_not_drawn(gpu: Gpu) -> None:
    with closing(wall(gpu)) as scene:
        state = scene.algorithm("farcry5", {**CULLED, "patch_quads": 4})
        frame = scene.frame(scene.camera(150, 200, 60, pitch=0.0), SIZE)
        first = show(scene, frame, state)
        before = counts(state)
        # nothing is known of what is hidden before the first frame
        assert before["hidden"] == before["revealed"] == 0
        again = show(scene, frame, state)
        after = counts(state)
        assert_same(first, again)
        assert after["revealed"] == 0
        assert after["visible"] + after["hidden"] == before["visible"]
        seen = len(np.unique(again["id"][again["depth"] > 0]))
        assert seen <= after["visible"] <= 0.7 * before["visible"]


def test_occlusion_follows_jumps_of_camera_size_and_terrain(steep: Scene) -> None:
    """Wherever the camera was before, the picture is the one without culling: what was hidden wrongly comes back."""
    state = steep.algorithm("farcry5", {**CULLED, "patch_quads": 4, "pixels_per_quad": 8.0})
    plain = steep.algorithm("farcry5", {**UNCULLED, "patch_quads": 4, "pixels_per_quad": 8.0})
    x, y, z = 200.0, 150.0, GROUND + 20
    views: list[tuple[dict[str, Any], tuple[int, int], dict[str, Any]]] = [
        *(({"heading": 30.0 + 4 * k, "pitch": -5.0}, SIZE, {}) for k in range(3)),
        ({"heading": 200.0}, SIZE, {}),
        ({"heading": 200.0}, SIZE, {"jitter": (0.3, -0.4)}),
        ({"heading": 200.0}, (90, 120), {}),
        ({"heading": 205.0}, (90, 120), {"exaggeration": 1.5}),
        ({"heading": 205.0}, (90, 120), {"curvature": True}),
        ({"heading": 205.0, "z": 900.0, "pitch": -20.0}, (90, 120), {}),
        ({"heading": 205.0, "orthographic": 900.0}, (90, 120), {}),
        ({"heading": 205.0, "orthographic": 900.0}, (90, 120), {}),
        ({"heading": 20.0, "fov": 12.0}, (90, 120), {}),
        ({"heading": 20.0, "fov": 12.0}, (1, 1), {}),
        ({"heading": 20.0}, (1, 1), {}),
    ]
    hidden, revealed = [], []
    for angles, size, changes in views:
        camera = steep.camera(x, y, z).moved(**angles)
        jitter = {k: v for k, v in changes.items() if k == "jitter"}
        rest = {k: v for k, v in changes.items() if k != "jitter"}
        frame = dataclasses.replace(steep.frame(camera, size, **rest), **jitter)
        assert_same(show(steep, frame, state), show(steep, frame, plain))
        found = counts(state)
        hidden.append(found["hidden"])
        revealed.append(found["revealed"])
    assert hidden[0] == hidden[5] == 0
    assert hidden[1] > 0
    assert hidden[4] > 0
    assert hidden[10] > 0
    # a turn on the spot shows what was hidden by other ground before
    assert sum(revealed) > 0


def test_the_pyramid_holds_farthest_depths(steep: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    make = steep.gpu.buffer

    def readable(label: str, size: Any, usage: str, category: str) -> Buffer:
        return make(label, size, f"{usage}|COPY_SRC" if label == "farcry5 depth" else usage, category)

    monkeypatch.setattr(steep.gpu, "buffer", readable)
    for size in ((150, 67), (64, 64), (5, 1)):
        state = steep.algorithm("farcry5", {**CULLED, "pixels_per_quad": 12.0})
        depth = show(steep, steep.frame(steep.camera(200, 150, GROUND + 20), size), state)["depth"]
        expected = []
        while max(depth.shape) > 1 or not expected:
            padded = np.pad(depth, [(0, -n % 4) for n in depth.shape], constant_values=1.0)
            depth = padded.reshape(padded.shape[0] // 4, 4, padded.shape[1] // 4, 4).min(axis=(1, 3))
            expected.append(depth.ravel())
        cells = steep.gpu.read_buffer(state._pyramid.cells, dtype=np.float32).result()  # type: ignore[attr-defined]
        np.testing.assert_array_equal(cells, np.concatenate(expected))


def test_boxes_are_put_where_the_frame_before_saw_them(steep: Scene) -> None:
    state = steep.algorithm("farcry5", CULLED)
    eye = steep.camera(200, 150, 700, pitch=-10)
    before = steep.frame(eye, SIZE)
    show(steep, before, state)
    now = steep.frame(eye.moved(x=eye.x + 31.0, y=eye.y - 57.0, z=eye.z + 23.0, heading=20.0), SIZE)
    columns = np.reshape(state._pyramid.projection(now), (4, 4))  # type: ignore[attr-defined]
    points = np.random.default_rng(2).uniform(-500, 500, (20, 3))
    moved = points + np.array([31.0, -57.0, 23.0])
    np.testing.assert_allclose(
        np.c_[points, np.ones(20)] @ columns, np.c_[moved, np.ones(20)] @ before.view_projection.T, atol=1e-6
    )


def test_a_frozen_camera_is_not_occluded_by_what_another_sees(steep: Scene) -> None:
    state = steep.algorithm("farcry5", CULLED)
    eye = steep.camera(200, 150, 700, pitch=-10)
    own = steep.frame(eye, SIZE)
    show(steep, own, state)
    everything = counts(state)["visible"]
    show(steep, own, state)
    frozen = steep.frame(eye.moved(x=eye.x + 300, z=eye.z + 900, pitch=-60.0), SIZE, lod_camera=eye)
    for _ in range(2):
        show(steep, frozen, state)
        found = counts(state)
        assert found["hidden"] == found["revealed"] == 0
        # boxes that touch the frustum's planes within rounding may come and go
        assert abs(found["visible"] - everything) <= 2


def test_without_a_second_pass_nothing_is_hidden(steep: Scene) -> None:
    """Who only takes the draws of `record` gets all of them."""
    state = steep.algorithm("farcry5", CULLED)
    frame = steep.frame(steep.camera(200, 150, 400), SIZE)
    show(steep, frame, state)
    for hides in (True, False, False):
        steep.record(frame, state)
        assert (counts(state)["hidden"] > 0) == hides


def test_a_full_list_grows_and_the_picture_is_the_same(steep: Scene) -> None:
    frame = steep.frame(steep.camera(200, 150, 700, pitch=-30), SIZE)
    settings = {**CULLED, "patch_quads": 4, "pixels_per_quad": 4.0}
    roomy = steep.algorithm("farcry5", settings)
    whole = show(steep, frame, roomy)
    assert roomy.statistics().patches > 200
    tight = steep.algorithm("farcry5", {**settings, "patch_capacity": 64})
    steep.record(frame, tight)
    assert tight.statistics().patches <= 64
    assert tight.incomplete()
    assert_same(show(steep, frame, tight), whole)
    assert not tight.incomplete()
    # and by itself, where nobody asks
    alone = steep.algorithm("farcry5", {**settings, "patch_capacity": 64})
    for _ in range(12):
        drawn = steep.raster(frame, steep.record(frame, alone))
    assert_same(drawn, whole)


def test_each_run_is_the_same(steep: Scene) -> None:
    frame = steep.frame(steep.camera(200, 330, 900, pitch=-25), SIZE)
    state = steep.algorithm("farcry5")
    first = show(steep, frame, state)
    for other in (state, steep.algorithm("farcry5")):
        assert_same(show(steep, frame, other), first)


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("farcry5", CULLED)
        assert (show(scene, frame, state)["depth"] == 0).all()
        assert state.statistics().patches == 0


def test_a_single_sample_draws_nothing(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((1, 1), 5.0))) as scene:
        frame = scene.frame(scene.camera(0.5, 0.5, 100, pitch=-90))
        assert (show(scene, frame, scene.algorithm("farcry5"))["depth"] == 0).all()


def test_more_nodes_than_the_map_holds_are_refused(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(300, 300))) as scene:
        frame = scene.frame(scene.camera(150, 150, 100))
        state = scene.algorithm("farcry5", {"pixels_per_quad": 0.001, "patch_quads": 4})
        with pytest.raises(BudgetError, match="at most 256 nodes a side around the eye, got"):
            scene.record(frame, state)
        with pytest.raises(BudgetError, match="raise pixels_per_quad"):
            scene.algorithm("farcry5", {"patch_capacity": 1 << 30})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"patch_quads": "12"}, "patch_quads: expected 4, 8, 16 or 32, got 12"),
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"pixels_per_quad": "nan"}, "pixels_per_quad: expected a number above 0, got nan"),
        ({"patch_capacity": "100"}, "patch_capacity: expected a multiple of 64, got 100"),
        ({"occlusion": "maybe"}, "farcry5 occlusion: expected bool, got 'maybe'"),
        ({"backface": "true"}, "did you mean back_face"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("farcry5", settings)


def test_settings_are_read_from_text() -> None:
    values = {"patch_quads": "8", "pixels_per_quad": "2.5", "frustum": "false", "occlusion": "1"}
    assert make_settings("farcry5", values) == Settings(8, 2.5, frustum=False, occlusion=True)
