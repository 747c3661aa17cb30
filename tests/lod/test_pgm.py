"""pgm: what its grid covers, where its vertices lie, that it is watertight, and that each improvement is one."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import ConvexHull

from lod.around import COLUMNS, ROWS, SIZE, slope, some_frames
from lod.patches import VERTEX, torn_edges
from lod.scene import Buffers, Scene, noise
from lod.strips import read_strips
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.cracks import find_cracks
from orogen.compare.surface_error import surface_error
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.contract import AlgorithmView, Patches
from orogen.lod.pgm import TAILORING, TESSELLATION, WARPING, Settings
from orogen.lod.pgm.outline import Projector, data_corners, find_outline, ground_points, visible_volume

PGM: dict[str, Any] = {"tailoring": "off", "warping": "off", "edge_search": False}
PGM_T = {**PGM, "tailoring": "hull"}
PGM_TE = {**PGM_T, "edge_search": True}
PGM_TWE = {**PGM_TE, "warping": "importance"}
LOW_OVER_PUGET = (
    (117000.0, 85000.0, 5200.0, 112.0, -7.0),
    (127500.0, 73500.0, 4300.0, 155.0, -5.0),
    (141000.0, 36000.0, 4100.0, 158.0, -4.0),
    (134000.0, 8500.0, 3200.0, 266.0, -3.0),
    (66000.0, 36000.0, 1700.0, 135.0, -3.0),
    (37000.0, 60000.0, 600.0, 105.0, 1.0),
)
"""Cameras in metres of the data (x, y, z), heading and pitch in degrees."""


def combinations() -> list[dict[str, Any]]:
    """Every tailoring with every warping; edge search and tessellation change along."""
    ways = [(tailoring, warping) for tailoring in TAILORING for warping in WARPING]
    return [
        {"tailoring": t, "warping": w, "edge_search": k % 2 == 0, "tessellation": TESSELLATION[k % 4 % 3]}
        for k, (t, w) in enumerate(ways)
    ]


def read_grid(scene: Scene, frame: Frame, state: AlgorithmView) -> tuple[NDArray[Any], NDArray[Any]]:
    """(rows of cells, vertices of a strip) of dtype VERTEX, and (rows + 1, columns + 1) vertices by place."""
    (draw,) = scene.record(frame, state)
    assert isinstance(draw, Patches)
    settings: Settings = state._algorithm.settings  # type: ignore[attr-defined]
    columns, rows = settings.cells(frame.size)
    each = settings.vertices_per_row(columns)
    strips = read_strips(scene, draw)
    assert strips.shape == (rows, each)
    # strips run along the row of cells, so that a row of vertices is what they have by their near and far side
    grid = np.empty((rows + 1, columns + 1), VERTEX)
    for j in range(rows):
        for k, vertex in enumerate(strips[j]):
            at = k - (settings.tessellation == "symmetric" and k > 2 * (columns // 2) + 1)
            far = at % 2
            if settings.tessellation == "symmetric" and at == k:
                far = 1 - at % 2
            if settings.tessellation == "diamond":
                far = (at ^ j) & 1
            grid[j + far, at // 2] = vertex
    return strips, grid


def on_ground(frame: Frame, vertices: NDArray[Any]) -> NDArray[np.float64]:
    """s and l of vertices."""
    flat = vertices["position"][..., :2].astype(np.float64).reshape(-1, 2)
    return ground_points(frame, flat).reshape(*vertices.shape, 2)


def area(polygon: NDArray[np.float64]) -> float:
    x, y = polygon.T
    return abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / 2


# -- what has to be covered ---------------------------------------------------------------------------------------


def seen_samples(frame: Frame) -> NDArray[np.float64]:
    """(n, 2) s and l of points of rays within the terrain volume: from inside, the part of the ground to be covered."""
    probe = replace(frame, size=(61, 41))
    origin, direction = (a.reshape(-1, 3) for a in np.broadcast_arrays(*probe.rays()))
    corners = data_corners(frame)
    low, high = (height * frame.exaggeration - frame.camera.z for height in frame.height_range)
    inverse = np.linalg.inv(np.stack([corners[1] - corners[0], corners[3] - corners[0]], axis=1))
    start = (origin[:, :2] - corners[0]) @ inverse.T
    step = direction[:, :2] @ inverse.T
    start, step = (np.column_stack([a, b]) for a, b in ((start, origin[:, 2]), (step, direction[:, 2])))
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (np.array([0, 0, low]) - start) / step, (np.array([1, 1, high]) - start) / step
    first = np.where(np.isnan(a), -np.inf, np.minimum(a, b)).max(axis=1)
    last = np.where(np.isnan(b), np.inf, np.maximum(a, b)).min(axis=1)
    if not frame.camera.orthographic:
        first = np.maximum(first, frame.camera.near)
    hit = first < last
    ends = [origin[hit] + t[hit, None] * direction[hit] for t in (first, last)]
    return ground_points(frame, np.concatenate(ends)) if hit.any() else np.zeros((0, 2))


def test_the_outline_holds_all_that_can_be_seen_and_hardly_more(plane: Scene, sheared_plane: Scene) -> None:
    compared = 0
    for scene in (plane, sheared_plane):
        for frame in some_frames(scene, 40, seed=1):
            frame = replace(frame, curvature=False)
            seen = seen_samples(frame)
            outline = find_outline(frame, "hull")
            if len(seen) < 200:
                continue
            assert outline is not None
            left, right = (np.interp(seen[:, 0], *border.T) for border in (outline.left, outline.right))
            slack = 1e-6 * (1 + np.abs(seen).max())
            assert (seen[:, 0] >= outline.rows[0] - slack).all()
            assert (seen[:, 0] <= outline.rows[1] + slack).all()
            assert (seen[:, 1] >= left - slack).all()
            assert (seen[:, 1] <= right + slack).all()
            # rays through pixel centres miss the picture's rim by half a pixel of 41
            whole = area(np.concatenate([outline.left, outline.right[::-1]]))
            assert ConvexHull(seen).volume > 0.8 * whole
            assert ConvexHull(seen).volume <= whole * (1 + 1e-6)
            compared += 1
    assert compared > 30


def test_the_hull_is_smaller_than_the_box_and_this_than_the_whole_plane(plane: Scene) -> None:
    frame = plane.frame(plane.camera(110, 90, 500, heading=20, pitch=-10), SIZE)
    outlines = [find_outline(frame, tailoring) for tailoring in TAILORING]
    areas = [area(np.concatenate([o.left, o.right[::-1]])) for o in outlines if o]
    assert len(areas) == 3
    assert areas[0] > areas[1] > areas[2]


def test_what_sees_no_terrain_volume_draws_nothing(plane: Scene) -> None:
    frame = plane.frame(plane.camera(110, 90, 1500, pitch=60), SIZE)
    state = plane.algorithm("pgm")
    assert find_outline(frame, "hull") is None
    assert plane.record(frame, state) == []
    assert state.statistics().triangles == 0


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        assert (scene.draw(frame, scene.algorithm("pgm"))["depth"] == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (2, 2), (2, 300)])
def test_the_smallest_terrains(gpu: Gpu, shape: tuple[int, int]) -> None:
    with closing(Scene(gpu, np.full(shape, 5.0))) as scene:
        frame = scene.frame(scene.camera(shape[1] / 2, shape[0] / 2, 20 + 20 * min(shape), pitch=-90))
        got, true = (scene.draw(frame, scene.algorithm(name))["depth"] > 0 for name in ("pgm", "raycast"))
        assert (got != true).sum() <= 4
        assert got.any() == true.any()


@pytest.mark.parametrize(("terrain", "cells"), [("sheared_plane", (9, 9)), ("plane", (16, 40))], ids=str)
def test_the_grid_covers_all_that_is_visible(
    request: pytest.FixtureRequest, terrain: str, cells: tuple[int, int]
) -> None:
    """A plane has no error but what is not covered, however coarse the grid."""
    scene = request.getfixturevalue(terrain)
    states = [scene.algorithm("pgm", {**ways, "columns": cells[0], "rows": cells[1]}) for ways in combinations()]
    truth = scene.algorithm("raycast")
    drawn = 0
    for frame in some_frames(scene, 24, seed=sum(cells), ground=150.0):
        true = scene.draw(frame, truth)["depth"] > 0
        drawn += int(true.any())
        for state in states:
            got = scene.draw(frame, state)["depth"] > 0
            # only rounding decides on which side of an outline a pixel lies
            assert (got != true).sum() <= 3, (state._algorithm.settings, frame.camera)
    assert drawn >= 10


@pytest.mark.parametrize("ways", combinations(), ids=lambda w: "-".join(map(str, w.values())))
def test_planes_are_exact_and_rough_ground_has_no_cracks(plane: Scene, hilly: Scene, ways: dict[str, Any]) -> None:
    views = [(110, 90, 320, {"heading": 30, "pitch": -12}), (40, 200, 800, {"pitch": -30, "roll": 25.0})]
    for scene, exact in ((plane, True), (hilly, False)):
        # without warping rows are far apart where the ground is seen from aside
        state = scene.algorithm("pgm", {**ways, "columns": 96, "rows": 600})
        heights = slope() if exact else hills(COLUMNS, 500.0).astype(np.float32)[:ROWS]
        for column, row, z, angles in views:
            frame = scene.frame(scene.camera(column, row, z + 200, **angles), SIZE)
            got = scene.draw(frame, state)["depth"]
            z_drawn = frame.positions(got)[..., 2]
            where = got > 0
            assert where.sum() > 500
            if exact:
                tx, ty = frame.grid.to_texel(*np.moveaxis(frame.positions(got)[..., :2], -1, 0))
                off = np.abs(z_drawn - (1.25 * (tx - 0.5) - 0.75 * (ty - 0.5) + 200))
                assert off[where].max() < 0.05
            else:
                true = scene.draw(frame, scene.algorithm("raycast"))["depth"]
                assert find_cracks(got, true, frame, tolerance=2).count == 0
                assert z_drawn[where].min() >= heights.min() - 0.01
                assert z_drawn[where].max() <= heights.max() + 0.01


# -- where vertices lie -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tessellation", TESSELLATION)
def test_edges_match_bit_for_bit(hilly: Scene, sheared_plane: Scene, tessellation: str) -> None:
    """All edges inside the outline are shared by two triangles."""
    for scene in (hilly, sheared_plane):
        state = scene.algorithm("pgm", {"columns": 24, "rows": 60, "tessellation": tessellation})
        for frame in some_frames(scene, 6, seed=3, ground=500.0):
            outline = find_outline(frame, "hull")
            if outline is None:
                continue
            strips, _ = read_grid(scene, frame, state)
            p = strips["position"]
            corners = np.stack([p[:, :-2], p[:, 1:-1], p[:, 2:]], axis=2).reshape(-1, 3, 3)
            assert len(corners) == state.statistics().triangles
            a, b, c = corners.swapaxes(0, 1)
            same = (a == b).all(1) | (b == c).all(1) | (c == a).all(1)
            torn = torn_edges(corners[~same], (np.nan,) * 4)
            middle = ground_points(frame, torn.mean(axis=1).astype(np.float64))
            left, right = (np.interp(middle[:, 0], *border.T) for border in (outline.left, outline.right))
            inside = np.min([middle[:, 1] - left, right - middle[:, 1]], axis=0)
            inside = np.minimum(
                inside, np.min([middle[:, 0] - outline.rows[0], outline.rows[1] - middle[:, 0]], axis=0)
            )
            assert (inside <= 1e-3 + 1e-6 * np.abs(middle).max()).all()


def test_without_tailoring_the_grid_is_even_on_the_view_plane(plane: Scene) -> None:
    """Vertices that are projected onto the auxiliary camera's view plane, built from vectors (section 3.2.2)."""
    state = plane.algorithm("pgm", {**PGM, "columns": 20, "rows": 30, "tessellation": "orthogonal"})
    for pitch, z in ((5.0, 300.0), (-30.0, 600.0), (-90.0, 700.0)):
        frame = plane.frame(plane.camera(110, 90, z, heading=70.0, pitch=pitch), SIZE)
        _, grid = read_grid(plane, frame, state)
        down = math.radians(max(-pitch, 45.0))
        heading = math.radians(70.0)
        ahead = np.array([math.sin(heading), math.cos(heading), 0.0])
        right = np.array([math.cos(heading), -math.sin(heading), 0.0])
        axis = math.cos(down) * ahead - math.sin(down) * np.array([0, 0, 1])
        low = frame.height_range[0]
        away = grid["position"].astype(np.float64)
        away[..., 2] = low - z
        depth = away @ axis
        x, y = away @ right / depth, away @ np.cross(right, axis) / depth
        # those that were not moved to the border of the data, nor stop at it
        texel = (grid["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits
        free = ((texel > 1) & (texel < [COLUMNS - 1, ROWS - 1])).all(axis=-1)
        assert free.sum() > 100
        i, j = np.meshgrid(np.arange(21), np.arange(31))
        half = SIZE[0] / SIZE[1]
        np.testing.assert_allclose(x[free], (half * (i / 10 - 1))[free], atol=2e-3)
        steps = np.polyfit(j[free], y[free], 1, full=True)
        assert steps[1][0] < 1e-6
        if pitch == -90.0:
            # all that the plane shows lies before the end of the data
            np.testing.assert_allclose(y[free], (j / 15 - 1)[free], atol=2e-3)


@pytest.mark.parametrize("warping", ["importance", "analytic"])
def test_warped_cells_are_alike(plane: Scene, warping: str) -> None:
    """Height over width is the same in all rows, the width being at least that of the picture's columns."""
    rows = 80
    settings = {**PGM_T, "warping": warping, "columns": 20, "rows": rows, "tessellation": "orthogonal"}
    state = plane.algorithm("pgm", settings)
    for pitch in (-5.0, -25.0):
        frame = plane.frame(plane.camera(110, 20, 600, heading=180.0, pitch=pitch), SIZE)
        _, grid = read_grid(plane, frame, state)
        ground = on_ground(frame, grid)
        altitude = 600 - frame.ground_height
        column = ground[:, 10]
        height = np.linalg.norm(np.diff(column, axis=0), axis=1)
        middle = (column[1:] + column[:-1]) / 2
        distance = np.hypot(np.hypot(*middle.T), altitude)
        if warping == "importance":
            width = np.diff(ground[:, [10, 11], 1], axis=1)[:, 0]
            width = np.maximum((width[1:] + width[:-1]) / 2, distance * SIZE[0] / 20 / frame.pixels_per_radian())
        else:
            width = np.hypot(middle[:, 0], altitude)
        importance = (height / width)[1:-1]
        assert importance.max() < 1.12 * importance.min()


def test_the_mip_level_is_that_of_the_cells_longer_side(gpu: Gpu) -> None:
    with closing(Scene(gpu, hills(600, 300.0).astype(np.float32))) as scene:
        frame = scene.frame(scene.camera(300, 20, 500, heading=180.0, pitch=-10), SIZE)
        state = scene.algorithm("pgm", {**PGM_T, "columns": 20, "rows": 40, "tessellation": "orthogonal"})
        _, grid = read_grid(scene, frame, state)
        ground = on_ground(frame, grid)
        width = np.diff(ground[..., 1], axis=1)[1:-1, 1:]
        height = np.linalg.norm(ground[2:] - ground[:-2], axis=-1)[:, 1:-1] / 2
        level = np.log2(np.maximum(np.maximum(width, height) / 10.0, 1))
        sure = np.abs(level - np.rint(level)) > 0.02
        assert len(np.unique(np.floor(level[sure]))) >= 3
        np.testing.assert_array_equal(grid["tile_level"][1:-1, 1:-1][sure], np.floor(level[sure]))


def test_edge_search_moves_vertices_onto_a_ridge(gpu: Gpu) -> None:
    """A roof across the view: the vertices behind it move to it, those elsewhere stay."""
    heights = np.zeros((300, 200), np.float32)
    heights[140:161] = (100 - 10 * np.abs(np.arange(-10, 11)))[:, None]
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(100, 280, 150, heading=0.0, pitch=-5), SIZE)
        settings = {**PGM_T, "warping": "importance", "columns": 30, "rows": 60, "tessellation": "orthogonal"}
        (_, plain), (_, moved) = (
            read_grid(scene, frame, scene.algorithm("pgm", {**settings, "edge_search": search}))
            for search in (False, True)
        )
        inner = np.s_[1:-1, 1:-1]
        s = [on_ground(frame, grid)[..., 0] for grid in (plain, moved)]
        changed = (np.abs(s[0] - s[1]) > 1e-3)[inner]
        assert changed.sum() >= 20
        # towards the eye, not past the vertex before
        assert (s[1][inner] <= s[0][inner] + 1e-3).all()
        assert (s[1][inner] >= s[0][:-2, 1:-1] - 1e-3).all()
        ridge = 129.5 * 10.0
        np.testing.assert_allclose(s[1][inner][changed], ridge, atol=8.0)
        tops = [grid["height"][inner].max(axis=0).mean() for grid in (plain, moved)]
        assert tops[1] > tops[0] + 2
        near = scene.algorithm("pgm", {**settings, "edge_search": True, "edge_distance": 60.0})
        _, kept = read_grid(scene, frame, near)
        np.testing.assert_array_equal(kept["position"], plain["position"])


def test_a_frozen_camera_keeps_its_grid(hilly: Scene) -> None:
    state = hilly.algorithm("pgm", {"columns": 20, "rows": 60})
    eye = hilly.camera(110, 160, 700, heading=10.0, pitch=-25)
    aside = eye.moved(x=eye.x - 700.0, z=2000.0, heading=40.0, pitch=-60.0)
    frames = hilly.frame(eye, SIZE), hilly.frame(aside, SIZE, lod_camera=eye)
    texels = []
    for frame in frames:
        _, grid = read_grid(hilly, frame, state)
        texels.append((grid["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits)
    # where the edge search's comparisons are close, rounding decides
    apart = np.abs(texels[0] - texels[1]).max(axis=-1)
    assert (apart < 0.02).mean() > 0.99
    assert apart.max() < 1


# -- what the improvements are worth ------------------------------------------------------------------------------


def test_every_improvement_improves(gpu: Gpu, data_dir: Path) -> None:
    """PGM, T, TE and TWE over Puget, low over ground, with 8,000 triangles: the mean PSNR grows (table 4.6)."""
    with Image.open(data_dir / "puget_height_1k.png") as image:
        heights = np.asarray(image).astype(np.float32) * np.float32(0.1)
    north, east = np.gradient(heights, 160.0)
    light = np.clip(0.5 + 0.6 * (north + east), 0, 1) * 255
    with closing(Scene(gpu, heights, spacing=160.0)) as scene:

        def picture(frame: Frame, state: AlgorithmView) -> NDArray[np.float64]:
            """Unlit colours of an image that lies on the ground; the sky is black."""
            depth = scene.draw(frame, state)["depth"]
            tx, ty = frame.grid.to_texel(*np.moveaxis(np.nan_to_num(frame.positions(depth)), -1, 0)[:2])
            rows, columns = (np.clip(t.astype(int), 0, 1024) for t in (ty, tx))
            return np.where(depth > 0, light[rows, columns], 0)

        truth = scene.algorithm("raycast")
        states = [
            scene.algorithm("pgm", {**ways, "columns": 30, "rows": 133}) for ways in (PGM, PGM_T, PGM_TE, PGM_TWE)
        ]
        decibels = []
        for x, y, z, heading, pitch in LOW_OVER_PUGET:
            camera = Camera(x, y, z, heading=heading, pitch=pitch)
            frame = scene.frame(camera, (400, 225))
            true = picture(frame, truth)
            squares = [((picture(frame, state) - true) ** 2).mean() for state in states]
            decibels.append(10 * np.log10(255**2 / np.array(squares)))
        means = np.mean(decibels, axis=0)
        assert (np.diff(means) > 0.1).all(), means


def test_more_cells_are_better(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(110, 160, 560, pitch=-15), (160, 100))
    true = hilly.draw(frame, hilly.algorithm("raycast"))["depth"]
    surface = TrueSurface(hills(COLUMNS, 500.0).astype(np.float32)[:ROWS])
    triangles, errors = [], []
    for pixels in (16.0, 8.0, 4.0, 2.0):
        state = hilly.algorithm("pgm", {"pixels_per_column": pixels})
        errors.append(surface_error(hilly.draw(frame, state)["depth"], true, frame, surface).backward.mean)
        triangles.append(state.statistics().triangles)
    assert (np.diff(errors) < 0).all()
    assert np.divide(triangles[1:], triangles[:-1]) == pytest.approx([4, 4, 4], rel=0.15)


# -- the bound ----------------------------------------------------------------------------------------------------


def cast(buffers: Buffers) -> NDArray[np.bool_]:
    return buffers["id"] == 1 << 31


@pytest.mark.parametrize("bound", [0.25, 1.0])
def test_no_drawn_point_is_off_by_more_than_the_bound(hilly: Scene, bound: float) -> None:
    surface = TrueSurface(hills(COLUMNS, 500.0).astype(np.float32)[:ROWS])
    truth = hilly.algorithm("raycast")
    bounded, free = (hilly.algorithm("pgm", {"columns": 24, "rows": 80, "max_error": limit}) for limit in (bound, None))
    shares, worst = [], 0.0
    for frame in some_frames(hilly, 24, seed=7, ground=500.0):
        true = hilly.draw(frame, truth)["depth"]
        if (true > 0).sum() < 200 or frame.camera.z < 500 * frame.exaggeration:
            continue
        drawn = hilly.draw(frame, bounded)
        error = surface_error(drawn["depth"], true, frame, surface)
        assert error.forward.max <= bound + 0.02
        worst = max(worst, surface_error(hilly.draw(frame, free)["depth"], true, frame, surface).forward.max)
        # a ray that finds nothing leaves no mark
        rays = bounded.statistics().rays
        assert cast(drawn).sum() <= rays <= frame.size[0] * frame.size[1]
        shares.append(rays / (frame.size[0] * frame.size[1]))
    assert len(shares) >= 4
    assert worst > 4 * bound
    assert 0 < np.mean(shares) < 0.95


def test_a_peak_between_vertices_is_found(gpu: Gpu) -> None:
    """A needle against the sky, on otherwise level ground."""
    heights = np.zeros((200, 200), np.float32)
    heights[100, 103] = 150.0
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(100, 190, 60, heading=0.0, pitch=0.0), SIZE)
        true = scene.draw(frame, scene.algorithm("raycast"))["depth"]
        settings = {"columns": 16, "rows": 30, "edge_search": False}
        missed = scene.draw(frame, scene.algorithm("pgm", settings))["depth"]
        state = scene.algorithm("pgm", {**settings, "max_error": 0.5})
        found = scene.draw(frame, state)
        peak = (true > 0) & (missed == 0)
        assert peak.sum() >= 5
        np.testing.assert_array_equal(found["depth"] > 0, true > 0)
        np.testing.assert_allclose(found["depth"][peak], true[peak], rtol=1e-5)
        # level ground needs no rays
        assert state.statistics().rays < 0.2 * SIZE[0] * SIZE[1]


# -- settings -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels_per_column": "0"}, "pixels_per_column: expected a number above 0, got 0"),
        ({"rows_per_column": "nan"}, "rows_per_column: expected a number above 0, got nan"),
        ({"columns": "4"}, "columns: expected at least 8 cells, got 4"),
        ({"rows": "7"}, "rows: expected at least 8 cells, got 7"),
        ({"tailoring": "hul"}, "pgm tailoring: expected one of off, box, hull, got 'hul'; did you mean hull"),
        ({"warping": "on"}, "pgm warping: expected one of off, importance, analytic, got 'on'"),
        (
            {"tessellation": "hexagon"},
            "pgm tessellation: expected one of orthogonal, symmetric, diamond, got 'hexagon'",
        ),
        ({"edge_distance": "-1"}, "edge_distance: expected 0 texels or more, got -1"),
        ({"max_error": "0"}, "max_error: expected a number of pixels above 0, got 0"),
        ({"edges": "true"}, "setting of pgm: expected one of"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("pgm", settings)


def test_cells_follow_the_picture_unless_they_are_given() -> None:
    assert make_settings("pgm", {"pixels_per_column": "4", "rows_per_column": "5"}).cells((1600, 900)) == (400, 2000)
    assert make_settings("pgm", {"columns": "240", "rows": "1050"}).cells((1600, 900)) == (240, 1050)
    assert Settings().cells((1, 1)) == (8, 36)


def test_the_auxiliary_camera_has_everything_before_it(plane: Scene) -> None:
    for frame in some_frames(plane, 40, seed=9, ground=100.0):
        visible = ground_points(frame, visible_volume(frame))
        if len(visible) < 3:
            continue
        eye = Projector.over(frame, visible)
        assert min(eye.depth(float(s)) for s in visible[:, 0]) > 1e-3 * eye.height
