"""Cracks: planted ones are found, outlines that are merely off are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oracle.cellwalk import depth_picture
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.cracks import find_cracks, open_edges
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import Grid

SIDE = 97
GRID = Grid(SIDE, SIDE, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
HILLS = hills(SIDE, 500.0)
VIEWS = {
    "oblique": Camera(5e5 + 1400, 4e6 - 3300, 1200, heading=8, pitch=-30),
    "rolled": Camera(5e5 + 1400, 4e6 - 2800, 700, heading=8, pitch=-12, roll=80),
    "upside down": Camera(5e5 + 1400, 4e6 - 2800, 700, heading=8, pitch=-12, roll=180),
    "low": Camera(5e5 + 1400, 4e6 - 2700, 560, heading=-20, pitch=-8),
    "down": Camera(5e5 + 1450, 4e6 - 1450, 3200, heading=30, pitch=-90),
    "flat": Camera(5e5 + 1400, 4e6 - 2800, 2500, heading=30, pitch=-40, orthographic=2000),
}


def frame_of(view: str) -> Frame:
    return Frame(VIEWS[view], GRID, (150, 100), height_range=(0.0, 520.0))


@pytest.fixture(scope="module")
def pictures() -> dict[str, np.ndarray]:
    return {view: depth_picture(frame_of(view), HILLS) for view in VIEWS}


def inner(depth: np.ndarray, frame: Frame, away: int = 4) -> np.ndarray:
    """Pixels on an unbroken piece of surface, `away` pixels from its outline."""
    distance = np.where(depth > 0, frame.view_depth(depth), np.inf)
    smooth = depth > 0
    for axis in (0, 1):
        step = np.abs(np.diff(np.minimum(distance, 1e9), axis=axis)) < 60
        pad = [(0, 0), (0, 0)]
        for side in ((1, 0), (0, 1)):
            pad[axis] = side
            smooth &= np.pad(step, pad)
    result = smooth.copy()
    for n in range(1, away + 1):
        for row, column in ((n, 0), (-n, 0), (0, n), (0, -n), (n, n), (-n, -n), (n, -n), (-n, n)):
            result &= np.roll(smooth, (row, column), (0, 1))
    result[:away], result[-away:], result[:, :away], result[:, -away:] = False, False, False, False
    return result


@pytest.mark.parametrize("view", VIEWS)
def test_the_true_picture_has_no_cracks(view: str, pictures: dict[str, np.ndarray]) -> None:
    true = pictures[view]
    cracks = find_cracks(true, true, frame_of(view))
    assert (cracks.count, cracks.lost, cracks.gained) == (0, 0, 0)
    assert not cracks.mask.any()
    assert cracks.skyline_max == 0 or view in ("down", "flat")


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("behind", [0.0, 0.4])
def test_every_pinhole_is_found(view: str, behind: float, pictures: dict[str, np.ndarray]) -> None:
    """`behind`: depth of what shows through, as a share of the surface's; 0 for background."""
    frame, true = frame_of(view), pictures[view]
    rng = np.random.default_rng(1)
    candidates = np.argwhere(inner(true, frame))
    chosen = candidates[rng.choice(len(candidates), 60, replace=False)]
    holes = np.zeros(true.shape, bool)
    for row, column in chosen:
        if not holes[row - 3 : row + 4, column - 3 : column + 4].any():
            holes[row, column] = True
    assert holes.sum() > 15
    cracks = find_cracks(np.where(holes, true * behind, true), true, frame)
    np.testing.assert_array_equal(cracks.mask, holes)
    assert cracks.count == holes.sum()
    assert cracks.lost == 0


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("behind", [0.0, 0.4])
@pytest.mark.parametrize("step", [(0, 1), (1, 0), (1, 1), (1, -1), (1, 2)])
def test_every_sliver_along_an_edge_is_found(
    view: str, behind: float, step: tuple[int, int], pictures: dict[str, np.ndarray]
) -> None:
    frame, true = frame_of(view), pictures[view]
    row, column = np.argwhere(inner(true, frame, 8))[7]
    slit = np.zeros(true.shape, bool)
    for n in range(8):
        slit[row + n * step[0] // 2, column + n * step[1] // 2] = True
    cracks = find_cracks(np.where(slit, true * behind, true), true, frame)
    np.testing.assert_array_equal(cracks.mask, slit)


@pytest.mark.parametrize("view", ["oblique", "low", "rolled", "upside down"])
def test_a_slit_up_to_the_skyline_is_a_crack(view: str, pictures: dict[str, np.ndarray]) -> None:
    frame, true = frame_of(view), pictures[view]
    turn = -round(frame.camera.roll / 90)
    upright = np.rot90(true, turn)
    column = upright.shape[1] // 2
    top = (upright[:, column] > 0).argmax()
    slit = np.zeros(upright.shape, bool)
    slit[top : top + 12, column] = True
    drawn = np.rot90(np.where(slit, 0, upright), -turn)
    cracks = find_cracks(drawn, true, frame)
    # beside the outline the truth is not in front all around
    found = np.rot90(cracks.mask, turn)
    assert not (found & ~slit).any()
    assert found[top + 2 : top + 12, column].all()


def test_a_missing_tile_is_a_crack_even_at_the_border(pictures: dict[str, np.ndarray]) -> None:
    frame, true = frame_of("down"), pictures["down"]
    drawn = true.copy()
    assert (true[60:, 40:80] > 0).all()
    drawn[60:, 40:80] = 0
    assert find_cracks(drawn, true, frame).count > 0.9 * 40 * 40


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("metres", [-1.0, 1.0])
def test_a_surface_that_is_a_little_off_has_no_cracks(
    view: str, metres: float, pictures: dict[str, np.ndarray]
) -> None:
    frame = frame_of(view)
    cracks = find_cracks(depth_picture(frame, HILLS + metres), pictures[view], frame)
    assert cracks.count == 0


@pytest.mark.parametrize("view", VIEWS)
def test_a_coarser_surface_has_no_cracks(view: str, pictures: dict[str, np.ndarray]) -> None:
    """Every outline is different, by about a pixel."""
    frame = frame_of(view)
    noise = np.random.default_rng(2).normal(0, 2.0, HILLS.shape)
    drawn = depth_picture(frame, HILLS + noise)
    cracks = find_cracks(drawn, pictures[view], frame)
    assert cracks.count == 0
    both = (drawn > 0) & (pictures[view] > 0)
    assert (np.abs(drawn - pictures[view]) > 1e-6 * drawn)[both].mean() > 0.95


def test_a_lower_skyline_is_lost_not_cracked(pictures: dict[str, np.ndarray]) -> None:
    frame, true = frame_of("low"), pictures["low"]
    drawn = true.copy()
    for column in range(true.shape[1]):
        top = (true[:, column] > 0).argmax()
        drawn[top : top + 2, column] = 0
    cracks = find_cracks(drawn, true, frame, tolerance=2)
    assert cracks.count == 0
    assert cracks.lost == 2 * true.shape[1]
    assert cracks.skyline_mean == cracks.skyline_max == 2
    # the other way round it is a gain
    assert find_cracks(true, drawn, frame).gained == 2 * true.shape[1]


def test_a_void_is_no_crack_and_its_outline_may_be_off(pictures: dict[str, np.ndarray]) -> None:
    frame = frame_of("down")
    heights, wider = HILLS.copy(), HILLS.copy()
    heights[30:50, 30:50] = np.nan
    wider[28:52, 28:52] = np.nan
    true, drawn = depth_picture(frame, heights), depth_picture(frame, wider)
    assert (pictures["down"] > 0).sum() > (true > 0).sum() > (drawn > 0).sum()
    # 60 m are 2.3 pixels, 3.2 at the corners
    cracks = find_cracks(drawn, true, frame, tolerance=4)
    assert cracks.count == 0
    assert cracks.lost == (true > 0).sum() - (drawn > 0).sum()


def test_tolerance_widens_what_counts_as_an_outline() -> None:
    """A notch in a crest, 3 pixels deep."""
    frame = frame_of("low")
    true = np.zeros((100, 150))
    true[40:] = 0.1 / 500
    true[:40] = 0.1 / 3000
    drawn = true.copy()
    drawn[40:43, 70] = 0.1 / 3000
    assert find_cracks(drawn, true, frame).count == 2
    assert find_cracks(drawn, true, frame, tolerance=3).count == 0


@pytest.mark.parametrize("which", ["drawn", "reference"])
def test_pictures_of_another_size_are_refused(which: str) -> None:
    pictures = {"drawn": np.zeros((100, 150)), "reference": np.zeros((100, 150)), which: np.zeros((150, 100))}
    with pytest.raises(SettingsError, match=rf"{which}: expected a depth picture of shape \(100, 150\)"):
        find_cracks(**pictures, frame=frame_of("low"))


def mesh(side: int) -> np.ndarray:
    """(n, 3, 3) triangles over side x side cells of rough ground."""
    rng = np.random.default_rng(4)
    z = rng.normal(size=(side + 1, side + 1))
    y, x = np.mgrid[: side + 1, : side + 1] * 1.0
    points = np.stack([x, y, z], -1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    return np.concatenate([np.stack(t, -2).reshape(-1, 3, 3) for t in ((a, c, b), (b, c, d))])


BORDER = (0.0, 0.0, 6.0, 6.0)


def test_a_closed_mesh_has_only_its_border_open() -> None:
    triangles = mesh(6)
    assert len(open_edges(triangles, BORDER)) == 0
    assert len(open_edges(triangles)) == 4 * 6
    shuffled = np.random.default_rng(1).permutation(triangles)
    assert len(open_edges(np.roll(shuffled, 1, axis=1), BORDER)) == 0


def test_a_missing_triangle_leaves_three_edges_open() -> None:
    triangles = np.delete(mesh(6), 14, axis=0)
    edges = open_edges(triangles, BORDER)
    assert edges.shape == (3, 2, 3)
    corners = {tuple(corner) for corner in mesh(6)[14]}
    assert {tuple(corner) for corner in edges.reshape(-1, 3)} == corners


def test_a_t_junction_is_open_and_a_hair_apart_is_apart() -> None:
    # one long edge against two short ones, on the same straight line
    triangles = np.array(
        [
            [[0, 0, 0], [2, 0, 0], [0, -2, 0]],
            [[0, 0, 0], [1, 0, 0], [0, 2, 0]],
            [[1, 0, 0], [2, 0, 0], [0, 2, 0]],
        ],
        np.float64,
    )
    edges = open_edges(triangles)
    assert [[0, 0, 0], [2, 0, 0]] in edges.tolist()
    moved = mesh(6)
    moved[20, 1, 2] = np.nextafter(moved[20, 1, 2], np.inf)
    assert len(open_edges(moved, BORDER)) == 4


def test_a_fold_shared_by_three_is_no_surface() -> None:
    extra = np.array([[[1, 1, 0.0], [2, 1, 0], [1.5, 1.5, 9]]])
    triangles = mesh(6)
    extra[0, :2] = triangles[0, [1, 2]]
    assert len(open_edges(np.concatenate([triangles, extra]), BORDER)) == 3


def test_degenerate_triangles_and_the_sign_of_zero_do_not_matter() -> None:
    triangles = mesh(6)
    degenerate = np.repeat(triangles[:5, :1], 3, axis=1)
    triangles[..., 1] *= np.where(triangles[..., 1] == 0, -1.0, 1.0)
    assert np.signbit(triangles[..., 1]).any()
    triangles[::2, :, 1] = np.abs(triangles[::2, :, 1])
    assert len(open_edges(np.concatenate([triangles, degenerate]), BORDER)) == 0


def test_other_shapes_of_triangles_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"expected corners of shape \(n, 3, 3\)"):
        open_edges(np.zeros((3, 3)))


def test_a_turned_picture_gives_a_turned_mask(pictures: dict[str, np.ndarray]) -> None:
    true = pictures["oblique"]
    frame = frame_of("oblique")
    drawn = true.copy()
    drawn[60, 70] = 0
    upside_down = replace(frame, camera=frame.camera.moved(roll=180.0))
    turned = find_cracks(drawn[::-1, ::-1], true[::-1, ::-1], upside_down)
    np.testing.assert_array_equal(turned.mask, find_cracks(drawn, true, frame).mask[::-1, ::-1])
    assert turned.mask[39, 79]
