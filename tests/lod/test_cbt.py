"""cbt: its tree against bisection by geometry, sums against numpy, the same tree whatever came before, no gaps."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.cbt_twin import RoughWishes, Wishes, roots, smallest_tree
from lod.lists import read
from lod.patches import torn_edges
from lod.restricted import some_cameras, unculled
from lod.scene import SPACING, Scene, noise
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import Grid
from orogen.lod import make_settings
from orogen.lod.cbt import Settings, View, wider
from orogen.lod.cbt.field import Shape, shape_of, tree_bytes
from orogen.pyramid.open import open_pyramid
from orogen.source.open import open_height
from orogen.streaming.settings import ClipmapSettings
from orogen.view.renderer import Renderer

SHAPES = [(75, 101), (2, 3), (90, 2), (33, 33)]
SIZE = (160, 100)
ROUGH = {"pixels": 20.0}


@pytest.fixture(scope="module", params=SHAPES, ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, noise(*request.param), view_distance=0.3)) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hills(400, 500.0).astype(np.float32)[:300], view_distance=0.7)) as terrain:
        yield terrain


def view_of(scene: Scene, settings: dict[str, Any] | None = None) -> View:
    state = scene.algorithm("cbt", settings)
    assert isinstance(state, View)
    return state


def settle(scene: Scene, frame: Frame, state: View) -> None:
    """Record a frame until the tree is whole."""
    scene.record(frame, state)
    for _ in range(200):
        if not state.incomplete():
            return
        scene.record(frame, state)
    raise AssertionError("the tree does not settle")


def words(state: View) -> tuple[Shape, NDArray[np.uint32]]:
    """The shape and all words of a view's tree."""
    algorithm = state._algorithm
    return algorithm.shape, algorithm.clipmap.gpu.read_buffer(state._tree).result().view(np.uint32)


def field(state: View) -> NDArray[np.uint32]:
    """The words of the bit field."""
    shape, tree = words(state)
    return tree[: 1 << shape.field_depth >> 5]


def leaves(state: View) -> set[int]:
    """Heap numbers of the leaves: each begins at a set bit and ends before the next one."""
    found = field(state)
    used = np.flatnonzero(found)
    word, bit = np.nonzero(found[used, None] >> np.arange(32, dtype=np.uint32) & 1)
    start, places = 32 * used[word] + bit, 32 * len(found)
    length = np.diff(np.append(start, places))
    assert (np.bitwise_count(length) == 1).all()
    assert (start % length == 0).all()
    return set(((places + start) // length).tolist())


def test_the_tree_is_the_smallest_that_meets_all_wishes(scene: Scene) -> None:
    state = view_of(scene, ROUGH)
    for k, camera in enumerate(some_cameras(scene, 5, seed=5)):
        changes = [{}, {"exaggeration": 2.0}, {"lod_camera": camera.moved(z=camera.z + 90, heading=9.0)}, {}, {}][k]
        if k == 4:
            camera = camera.moved(orthographic=500.0, pitch=-50.0)
        frame = unculled(scene.frame(camera, SIZE, **changes))
        settle(scene, frame, state)
        wishes = Wishes(frame, state._algorithm.settings, state._algorithm.shape)
        expected = smallest_tree(state._algorithm.shape.side, wishes)
        assert wishes.closest > 1e-6
        assert leaves(state) == set(expected)


def test_the_tree_on_a_sheared_grid(gpu: Gpu) -> None:
    metres = np.array([[10.0, 7.0], [1.0, -8.0]])
    with closing(Scene(gpu, noise(70, 90), metres=metres)) as scene:
        state = view_of(scene, ROUGH)
        for camera in some_cameras(scene, 3, seed=2):
            frame = unculled(scene.frame(camera, SIZE))
            settle(scene, frame, state)
            wishes = Wishes(frame, state._algorithm.settings, state._algorithm.shape)
            assert leaves(state) == set(smallest_tree(state._algorithm.shape.side, wishes))
            drawn = read(scene, frame, state)
            # corners are named by their exact place in the grid, of which the outline is a rectangle
            flat = np.concatenate([drawn.texels, drawn.corners["height"][..., None]], axis=2)
            assert len(torn_edges(flat, (0.0, 0.0, 89.0, 69.0))) == 0


def test_the_tree_of_errors_is_the_smallest_that_meets_all_wishes(gpu: Gpu) -> None:
    heights = hills(70, 300.0).astype(np.float32)[:50]
    with closing(Scene(gpu, heights)) as scene:
        state = view_of(scene, {"metric": "error", "pixels": 6.0})
        assert state._algorithm.settings.length == 64.0
        cameras = [*some_cameras(scene, 2, seed=8), scene.camera(30, 20, 2500, pitch=-80, orthographic=500.0)]
        for k, camera in enumerate(cameras):
            frame = unculled(scene.frame(camera, SIZE, exaggeration=1.5, curvature=k == 1))
            settle(scene, frame, state)
            wishes = RoughWishes(frame, state._algorithm.settings, state._algorithm.shape, heights)
            expected = smallest_tree(state._algorithm.shape.side, wishes)
            assert wishes.decided_by_error > 100
            assert wishes.closest > 1e-5
            assert leaves(state) == set(expected)


def test_errors_make_a_tree_that_is_whole_and_does_not_depend_on_what_came_before(hilly: Scene) -> None:
    settings = {"metric": "error", "pixels": 2.0}
    travelled = view_of(hilly, settings)
    last = np.array([399.0, 299.0])
    for camera in some_cameras(hilly, 3, seed=13):
        frame = hilly.frame(camera, SIZE)
        fresh = travelled._algorithm.view()
        for state in (fresh, travelled):
            settle(hilly, frame, state)
        np.testing.assert_array_equal(field(travelled), field(fresh))
        drawn = read(hilly, unculled(frame), travelled)
        assert_whole(drawn.corners["position"], drawn.texels, last)


def test_flat_ground_is_divided_by_length_alone(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((400, 500), 50.0))) as scene:
        frame = scene.frame(scene.camera(250, 200, 1750, pitch=-60), (400, 300))
        by_error, by_length = (
            view_of(scene, {"metric": "error", "pixels": 0.25, "max_length": 30.0}),
            view_of(scene, {"pixels": 30.0}),
        )
        for state in (by_error, by_length):
            settle(scene, frame, state)
        np.testing.assert_array_equal(field(by_error), field(by_length))
        assert len(leaves(by_error)) > 100


def test_sums_are_those_of_the_field(hilly: Scene) -> None:
    state = view_of(hilly, {"updates": 3})
    for camera in some_cameras(hilly, 3, seed=4):
        hilly.record(hilly.frame(camera, SIZE), state)
        shape, tree = words(state)
        depth = shape.field_depth
        count = np.bitwise_count(field(state)).reshape(-1, 8).sum(axis=1, dtype=np.uint32)
        heap = tree[1 << depth >> 5 :][: 2 << depth >> 8]
        while len(count) >= 1:
            np.testing.assert_array_equal(heap[len(count) : 2 * len(count)], count)
            if len(count) == 1:
                break
            count = count.reshape(-1, 2).sum(axis=1)
        assert state.state()["leaves"] == count[0] > 2


def test_sums_reach_beyond_one_workgroup(gpu: Gpu) -> None:
    """A deep field over few samples: the root's sum goes through all stages."""
    with closing(Scene(gpu, noise(4, 1200))) as scene:
        state = view_of(scene, {"pixels": 24.0})
        assert state._algorithm.shape.depth == 28 > 24
        settle(scene, scene.frame(scene.camera(600, 2, 90, pitch=-30), SIZE), state)
        shape, tree = words(state)
        heap = tree[1 << shape.depth >> 5 :]
        assert heap[1] == len(leaves(state)) == state.state()["leaves"]
        for level in range(20):
            here, below = heap[1 << level : 2 << level], heap[2 << level : 4 << level]
            np.testing.assert_array_equal(here, below[::2] + below[1::2])


@pytest.mark.parametrize("curvature", [False, True])
def test_the_tree_does_not_depend_on_what_came_before(hilly: Scene, curvature: bool) -> None:
    cameras = some_cameras(hilly, 6, seed=13)
    cameras[3] = cameras[3].moved(orthographic=700.0, pitch=-40.0)
    frames = [hilly.frame(camera, SIZE, curvature=curvature) for camera in cameras]
    travelled, hurried = view_of(hilly, ROUGH), view_of(hilly, {**ROUGH, "updates": 2})
    for k, frame in enumerate(frames):
        # what the camera saw before is half built, or half torn down
        for other in frames[k - 2 : k]:
            for _ in range(5):
                hilly.record(other, hurried)
        fresh = travelled._algorithm.view()
        for state in (fresh, travelled, hurried):
            settle(hilly, frame, state)
        expected = field(fresh)
        np.testing.assert_array_equal(field(travelled), expected)
        np.testing.assert_array_equal(field(hurried), expected)
        assert travelled.statistics() == fresh.statistics()


def test_the_surface_is_whole_and_edges_match_bit_for_bit(scene: Scene) -> None:
    state = view_of(scene, ROUGH)
    last = np.array([scene.pyramid.grid.width, scene.pyramid.grid.height]) - 1.0
    for camera in some_cameras(scene, 3, seed=6):
        drawn = read(scene, unculled(scene.frame(camera, SIZE)), state)
        assert_whole(drawn.corners["position"], drawn.texels, last)


def assert_whole(positions: NDArray[np.float32], texels: NDArray[np.float64], last: NDArray[np.float64]) -> None:
    x, y = positions[..., 0], positions[..., 1]
    assert len(torn_edges(positions, (x.min(), y.min(), x.max(), y.max()))) == 0
    # nothing is folded over: areas add up
    a, b, c = texels.swapaxes(0, 1)
    (px, py), (qx, qy) = (b - a).T, (c - a).T
    turned = px * qy - py * qx
    assert (turned <= 0).all()
    assert -turned.sum() / 2 == pytest.approx(np.prod(last), rel=1e-6)


class OneFrame:
    """A view that takes no second try: what is drawn while the tree still changes."""

    def __init__(self, state: View) -> None:
        self._state = state
        self._algorithm = state._algorithm
        self.record, self.statistics = state.record, state.statistics

    def incomplete(self) -> bool:
        return False


def test_every_frame_on_the_way_is_whole(hilly: Scene) -> None:
    last = np.array([399.0, 299.0])
    state = view_of(hilly, {**ROUGH, "updates": 1})
    triangles = []
    for z in (250.0, 4000.0):
        frame = unculled(hilly.frame(hilly.camera(150, 170, z, pitch=-30), SIZE))
        for _ in range(11):
            drawn = read(hilly, frame, OneFrame(state))  # type: ignore[arg-type]
            assert_whole(drawn.corners["position"], drawn.texels, last)
            triangles.append(len(drawn.corners))
    # it grows level by level, and shrinks
    assert (np.diff(triangles) > 0).any()
    assert (np.diff(triangles) < 0).any()


def test_all_that_is_in_sight_is_drawn(hilly: Scene) -> None:
    state = view_of(hilly, ROUGH)
    heights = hills(400, 500.0).astype(np.float32)[:300]
    hidden = 0
    for heading in range(0, 360, 80):
        camera = hilly.camera(200, 150, 420, heading=heading, pitch=-15, roll=heading / 20)
        frame = hilly.frame(camera, SIZE)
        drawn = set(read(hilly, frame, state).corners["id"][:, 0].tolist())
        tree = leaves(state)
        assert drawn <= tree
        hidden += len(tree - drawn)
        rows, columns = np.mgrid[:300:3, :400:3]
        flat = np.stack([columns, rows], axis=-1).reshape(-1, 2)
        position = (flat + 0.5 - frame.eye) @ frame.grid.metres.T
        points = np.column_stack([position, heights[flat[:, 1], flat[:, 0]] - camera.z])
        planes = frame.planes()
        seen = flat[(points @ planes[:, :3].T + planes[:, 3] > 0.5).all(axis=1)]
        for place in seen[:: max(1, len(seen) // 100)].tolist():
            assert leaf_at(state._algorithm.shape, tree, place) & drawn
    assert hidden > 100


def leaf_at(shape: Shape, tree: set[int], sample: list[int]) -> set[int]:
    """The leaves that a sample lies in: several where it is on an edge."""
    unit = 256
    point = np.array(sample) * unit
    found, rest = set[int](), roots(shape.side)
    while rest:
        triangle = rest.pop()
        a, b, c = (np.array(corner) for corner in triangle.corners)
        turns = [(q - p)[0] * (point - p)[1] - (q - p)[1] * (point - p)[0] for p, q in ((a, b), (b, c), (c, a))]
        if max(turns) > 0:
            continue
        if triangle.node in tree:
            found.add(triangle.node)
        else:
            rest.extend(triangle.halves())
    return found


def test_edges_have_the_length_that_was_asked_for(gpu: Gpu) -> None:
    asked = 9.0
    with closing(Scene(gpu, np.full((400, 500), 50.0))) as scene:
        state = view_of(scene, {"pixels": asked})
        for up in (300.0, 900.0, 1700.0):
            frame = scene.frame(scene.camera(250, 200, 50 + up, pitch=-90), (400, 300))
            drawn = read(scene, frame, state)
            p = drawn.corners["position"].astype(np.float64)
            inside = ((drawn.texels > 0) & (drawn.texels < (499, 399))).all(axis=(1, 2))
            edge = np.linalg.norm(p[:, 1] - p[:, 2], axis=1)
            away = np.linalg.norm((p[:, 1] + p[:, 2]) / 2, axis=1)
            pixels = (edge / away * frame.pixels_per_radian())[inside]
            assert pixels.max() <= asked * 1.0001
            # forced halves apart, no edge is shorter than it has to be: a parent's is longer by the root of two
            assert pixels.max() >= asked * 0.7
            assert np.quantile(pixels, 0.1) >= asked * 0.6


def test_smaller_pixels_are_more_triangles(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 330, 900, pitch=-35), SIZE)
    triangles = []
    for pixels in (16.0, 8.0, 4.0):
        state = view_of(hilly, {"pixels": pixels})
        settle(hilly, frame, state)
        triangles.append(state.statistics().triangles)
    ratio = np.divide(triangles[1:], triangles[:-1])
    assert ((ratio > 2.5) & (ratio < 4.5)).all()


def test_a_fast_camera_is_followed_within_the_frame(hilly: Scene) -> None:
    """60 m a frame and 2 degrees: more than 100 m/s at any frame rate."""
    path = [hilly.camera(60 + 6 * k, 150, 450, heading=90 + 2 * k, pitch=-20) for k in range(9)]
    late = {updates: view_of(hilly, {**ROUGH, "updates": updates}) for updates in (1, Settings().updates)}
    for state in late.values():
        settle(hilly, hilly.frame(path[0], SIZE), state)
    unsettled = dict.fromkeys(late, 0)
    for camera in path[1:]:
        frame = hilly.frame(camera, SIZE)
        for updates, state in late.items():
            hilly.record(frame, state)
            unsettled[updates] += state.incomplete()
    assert unsettled == {1: 8, Settings().updates: 0}


def test_a_still_camera_costs_one_update(hilly: Scene) -> None:
    state = view_of(hilly)
    frame = hilly.frame(hilly.camera(200, 200, 400, pitch=-40), SIZE)
    settle(hilly, frame, state)
    for jitter in ((0.0, 0.0), (-0.5, 0.4), (0.3, -0.5)):
        hilly.record(hilly.frame(frame.camera, SIZE, jitter=jitter), state)
        assert state.state()["updates"] == 1
        assert not state.incomplete()


def test_samples_within_pixels_are_complete_with_one_update_a_frame(gpu: Gpu) -> None:
    pyramid = open_pyramid(open_height(hills(120, 300.0).astype(np.float32), spacing=SPACING))
    clipmap = ClipmapSettings(memory=16 << 20)
    with closing(Renderer(gpu, pyramid, name="cbt", settings={"updates": 1}, clipmap=clipmap)) as renderer:
        x, y = pyramid.grid.to_crs(60.0, 110.0)
        camera = Camera(float(x), float(y), 400.0, pitch=-25.0)
        one = renderer.render(camera, (60, 40), samples=3)
        renderer.render(camera.moved(heading=70.0), (60, 40))
        other = renderer.render(camera, (60, 40), samples=3)
    np.testing.assert_array_equal(one.color, other.color)
    assert one.statistics == other.statistics


def test_all_samples_see_what_the_wider_camera_sees(hilly: Scene) -> None:
    for camera in (hilly.camera(10, 20, 300, pitch=-30), hilly.camera(10, 20, 300, pitch=-30, orthographic=400.0)):
        plain = Frame(camera, hilly.pyramid.grid, (40, 90))
        wide = Frame(camera, hilly.pyramid.grid, (40, 90), lod_camera=wider(camera, (40, 90)))
        for jitter in ((-0.5, -0.5), (0.5, 0.5), (0.5, -0.5)):
            origin, direction = Frame(camera, hilly.pyramid.grid, (40, 90), jitter=jitter).rays()
            points = (origin + 500.0 * direction).reshape(-1, 3)
            for frame, least in ((plain, -np.inf), (wide, -1e-6)):
                planes = frame.planes()[:4]
                assert (points @ planes[:, :3].T + planes[:, 3]).min() >= least


def test_a_window_goes_on_drawing_until_the_tree_is_settled(hilly: Scene) -> None:
    state = view_of(hilly, {"updates": 1})
    frame = hilly.frame(hilly.camera(200, 150, 450, pitch=-20), SIZE)
    assert state.unfinished()
    frames = 0
    while state.unfinished():
        hilly.record(frame, state)
        frames += 1
        hilly.gpu.read_buffer(state._state).result()
        assert frames < 100
    # each update is a frame
    assert frames > 8
    assert state.state()["settled"] == 1
    whole = field(state)
    hilly.record(frame, state)
    np.testing.assert_array_equal(field(state), whole)
    assert not state.unfinished()
    # a camera that jumps is noticed while the picture is being smoothed
    frame = hilly.frame(hilly.camera(60, 250, 300, heading=120, pitch=-20), SIZE)
    noticed = 0
    for _ in range(16):
        hilly.record(frame, state)
        hilly.gpu.read_buffer(state._state).result()
        noticed += state.unfinished()
    assert noticed


def test_a_full_list_grows_and_the_picture_is_the_same(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 500, pitch=-40), SIZE)
    roomy = view_of(hilly, ROUGH)
    whole = hilly.draw(frame, roomy)
    assert roomy.state()["leaves"] > 300
    tight = view_of(hilly, {**ROUGH, "leaf_capacity": 64, "updates": 20})
    first = hilly.raster(frame, hilly.record(frame, tight))
    # coarser for want of room, without a hole
    state = tight.state()
    assert state["refused"] > 0
    assert 16 < state["leaves"] <= 64
    assert ((first["depth"] > 0) == (whole["depth"] > 0)).mean() > 0.97
    assert tight.incomplete()
    grown = hilly.draw(frame, tight)
    for name in whole:
        np.testing.assert_array_equal(grown[name], whole[name])
    assert not tight.incomplete()


def test_a_list_grows_by_itself_from_frame_to_frame(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 500, pitch=-40), SIZE)
    whole = hilly.draw(frame, view_of(hilly, ROUGH))
    tight = view_of(hilly, {**ROUGH, "leaf_capacity": 64, "updates": 20})
    for _ in range(30):
        draws = hilly.record(frame, tight)
    drawn = hilly.raster(frame, draws)
    for name in whole:
        np.testing.assert_array_equal(drawn[name], whole[name])


def test_the_depth_is_capped(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 120, pitch=-40), SIZE)
    for depth in (1, 2, 7, 12):
        state = view_of(hilly, {"max_depth": depth})
        settle(hilly, frame, state)
        deepest = max(leaf.bit_length() - 1 for leaf in leaves(state))
        assert deepest == depth
        assert (read(hilly, unculled(frame), state).corners["tile_level"] == 0).any()


def test_the_depth_follows_from_data_and_memory() -> None:
    def grid(width: int, height: int) -> Grid:
        return Grid(width, height, (1.0, 0.0, 0.0, 0.0, -1.0, 0.0))

    # two triangles over 2^k samples, two bisections for each halving of their legs, down to an eighth of a sample
    assert shape_of(grid(1025, 700), None, 28) == Shape(1024 << 8, 27, 27)
    assert shape_of(grid(1026, 700), None, 28) == Shape(2048 << 8, 29, 28)
    assert shape_of(grid(1025, 700), 30, 28) == Shape(1024 << 8, 27, 27)
    assert shape_of(grid(1025, 700), 9, 28).depth == 9
    assert shape_of(grid(1, 1), None, 28).side > 0
    # 2^30 places do for legs of a sample in data of 2^14 samples, and no finer ones
    large = shape_of(grid(16385, 16385), 29, 28)
    assert large.shortest_leg / (1 << 8) == 1.0
    assert tree_bytes(28) / 2**20 == pytest.approx(40, abs=0.05)


def test_a_tree_that_is_cut_short_is_said(gpu: Gpu, hilly: Scene, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "orogen"):
        view_of(hilly)
        assert not caplog.records
        for width, level in ((4100, logging.INFO), (16400, logging.WARNING)):
            with closing(Scene(gpu, np.zeros((3, width), np.float32))) as wide:
                view_of(wide)
            assert caplog.records[-1].levelno == level
    assert "28 bisections in place of 33" in caplog.text
    assert "legs of triangles are 0.707 samples" in caplog.text
    assert "28 bisections in place of 37" in caplog.text
    assert "legs of triangles are 2.83 samples" in caplog.text


def test_too_much_is_refused(gpu: Gpu, hilly: Scene) -> None:
    with pytest.raises(BudgetError, match="raise pixels"):
        hilly.algorithm("cbt", {"leaf_capacity": 1 << 30})
    if gpu.limits["max-storage-buffer-binding-size"] < tree_bytes(30):
        with (
            closing(Scene(gpu, np.zeros((3, 9000), np.float32))) as wide,
            pytest.raises(BudgetError, match=r"max_depth 30, .* lower max_depth"),
        ):
            wide.algorithm("cbt", {"max_depth": 30})


def test_nothing_is_drawn_before_the_first_data_or_of_a_single_sample(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("cbt")
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().triangles == 0
    with closing(Scene(gpu, np.full((1, 1), 5.0))) as scene:
        frame = scene.frame(scene.camera(0.5, 0.5, 100, pitch=-90))
        assert (scene.draw(frame, scene.algorithm("cbt"))["depth"] == 0).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels": "0"}, "pixels: expected a number above 0, got 0"),
        ({"metric": "errors"}, "metric: expected one of length, error, got 'errors'; did you mean error"),
        ({"max_length": "0"}, "max_length: expected a number above 0, got 0"),
        ({"updates": "0"}, "updates: expected 1 to 64 a frame, got 0"),
        ({"max_depth": "31"}, "max_depth: expected 1 to 30 bisections, got 31"),
        ({"leaf_capacity": "10"}, "leaf_capacity: expected at least 64 leaves, got 10"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("cbt", settings)
