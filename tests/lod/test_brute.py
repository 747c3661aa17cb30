"""brute: every sample is a vertex, the mesh is whole, and what is too large is refused."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.patches import torn_edges
from lod.restricted import some_cameras, unculled
from lod.scene import SPACING, Scene, noise
from lod.triangles import read_triangles, with_area
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.keys import NodeKey
from orogen.lod import make_settings
from orogen.lod.brute import TILE, index_list

ROWS, COLUMNS = 150, 220
HEIGHTS = noise(ROWS, COLUMNS)


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, HEIGHTS)) as terrain:
        yield terrain


def texels(frame: Frame, corners: NDArray[Any]) -> NDArray[np.float64]:
    """(..., 2) columns and rows of vertices, from the first sample."""
    return (corners["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits - 0.5


def low_camera(scene: Scene) -> Any:
    """One tile's samples are far apart on screen, those of others are not."""
    return scene.camera(30, 40, 62.0, heading=70.0)


@pytest.mark.parametrize("split", [1, 4])
def test_every_sample_is_a_vertex(scene: Scene, split: int) -> None:
    frame = unculled(scene.frame(low_camera(scene), (160, 100)))
    state = scene.algorithm("brute", {"split": split})
    far, near = read_triangles(scene, frame, state)
    assert len(near) >= 1
    assert len(far) + len(near) == math.ceil((ROWS - 1) / TILE) * math.ceil((COLUMNS - 1) / TILE)
    everywhere = np.concatenate([far.ravel(), near.ravel()])
    at = texels(frame, everywhere)
    whole = (at == np.round(at)).all(axis=1)
    column, row = at[whole].astype(int).T
    np.testing.assert_array_equal(everywhere["height"][whole], HEIGHTS[row, column])
    assert len(np.unique(at[whole], axis=0)) == ROWS * COLUMNS
    # what is not split has no other vertices
    assert (texels(frame, far) % 1 == 0).all()
    assert whole.all() == (split == 1)


def test_split_tiles_follow_the_bilinear_surface(scene: Scene) -> None:
    frame = scene.frame(low_camera(scene), (160, 100))
    _, near = read_triangles(scene, frame, scene.algorithm("brute", {"split": 4}))
    at = texels(frame, near.ravel())
    i, j = np.minimum(np.floor(at).astype(int), [COLUMNS - 2, ROWS - 2]).T
    u, v = (at - np.stack([i, j], axis=1)).T
    h = HEIGHTS.astype(np.float64)
    expected = (1 - v) * ((1 - u) * h[j, i] + u * h[j, i + 1]) + v * ((1 - u) * h[j + 1, i] + u * h[j + 1, i + 1])
    np.testing.assert_allclose(near.ravel()["height"], expected, atol=1e-4)


@pytest.mark.parametrize("split", [1, 2, 4])
def test_the_mesh_is_whole_and_edges_match_bit_for_bit(scene: Scene, split: int) -> None:
    frame = unculled(scene.frame(low_camera(scene), (160, 100)))
    draws = read_triangles(scene, frame, scene.algorithm("brute", {"split": split}))
    triangles = with_area(draws)
    x, y = triangles[..., 0], triangles[..., 1]
    assert len(torn_edges(triangles, (x.min(), y.min(), x.max(), y.max()))) == 0
    # nothing is folded over: areas add up
    a, b, c = triangles[..., :2].astype(np.float64).swapaxes(0, 1)
    (px, py), (qx, qy) = (b - a).T, (c - a).T
    area = np.abs(px * qy - py * qx).sum() / 2
    assert area == pytest.approx((ROWS - 1) * (COLUMNS - 1) * SPACING**2, rel=1e-4)


def test_finer_tiles_have_no_vertices_of_their_own_on_the_border() -> None:
    split = 4
    row, column = np.divmod(index_list(split, 1).ravel(), TILE * split + 1)
    last = TILE * split
    assert set(column[(row == 0) | (row == last)] % split) == {0}
    assert set(row[(column == 0) | (column == last)] % split) == {0}
    assert index_list(split, split).size == 6 * TILE**2


def test_statistics_count_what_is_drawn(scene: Scene) -> None:
    state = scene.algorithm("brute", {"split": 4})
    far, near = read_triangles(scene, scene.frame(low_camera(scene)), state)
    found = state.statistics()
    assert found.patches == len(far) + len(near)
    assert found.triangles == far.size // 3 + near.size // 3
    assert found.draws == 2


def test_all_that_is_seen_is_drawn_at_level_0(gpu: Gpu) -> None:
    """Also where the clipmap's own windows end long before the data does."""
    heights = noise(40, 3000, relief=400.0)
    with closing(Scene(gpu, heights, view_distance=0.05)) as scene:
        state = scene.algorithm("brute")
        camera = scene.camera(-60, 20, 420, heading=90.0)
        frame = scene.frame(camera, (160, 100))
        coarse = scene.draw(frame, state)["detail"]
        assert ((coarse & 0xFF) > 0).any()
        wanted = state.wants(frame)
        assert {key for key in wanted if key.level == 0} == {NodeKey(0, x, 0) for x in range(12)}
        scene.view.wishes[0] = [*scene.view.wishes[0], *wanted]
        scene.clipmap.settle()
        drawn = scene.draw(frame, state)
        with closing(Scene(gpu, heights)) as whole:
            expected = whole.draw(whole.frame(camera, (160, 100)), whole.algorithm("brute"))
        np.testing.assert_array_equal(drawn["depth"], expected["depth"])
        np.testing.assert_array_equal(drawn["detail"], expected["detail"])
        assert (drawn["depth"] > 0).sum() > 1000
        aside = scene.frame(camera.moved(heading=270.0), (160, 100))
        assert not [key for key in state.wants(aside) if key.level == 0]


def test_culling_never_changes_the_picture(scene: Scene) -> None:
    state = scene.algorithm("brute")
    seen = everything = 0
    for camera in some_cameras(scene, 5, seed=9):
        frame = scene.frame(camera)
        culled = scene.draw(frame, state)
        seen += state.statistics().patches
        unseen = scene.draw(unculled(frame), state)
        everything += state.statistics().patches
        for name in culled:
            np.testing.assert_array_equal(culled[name], unseen[name])
    assert seen < everything


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("brute")
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().patches == 0


def test_a_terrain_of_too_many_triangles_is_refused(scene: Scene) -> None:
    count = 2 * (ROWS - 1) * (COLUMNS - 1)
    scene.algorithm("brute", {"most_triangles": count})
    message = f"at most {count - 1} triangles, got 220 x 150 samples, {count} triangles; open a part of it"
    with pytest.raises(SettingsError, match=message):
        scene.algorithm("brute", {"most_triangles": count - 1})


def test_a_terrain_whose_nodes_do_not_fit_is_refused(gpu: Gpu) -> None:
    # room for a few dozen nodes of a hundred
    with (
        closing(Scene(gpu, np.zeros((2400, 2400), np.float32))) as scene,
        pytest.raises(BudgetError, match="raise memory="),
    ):
        scene.algorithm("brute")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"split": "3"}, "split: expected 1, 2, 4 or 8 quads between samples, got 3"),
        ({"split_pixels": "0"}, "split_pixels: expected a number above 0, got 0"),
        ({"most_triangles": "1"}, "most_triangles: expected at least 2, got 1"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("brute", settings)
