"""geometry_image_warping: what its mesh covers, how it is weighed and warped, that it is watertight and pays."""

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

from lod.around import COLUMNS, ROWS, SIZE, some_frames
from lod.patches import torn_edges
from lod.scene import Scene, noise
from lod.strips import read_strips
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.surface_error import surface_error
from orogen.compare.truth import TrueSurface
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings
from orogen.lod.contract import AlgorithmView
from orogen.lod.geometry_image_warping import Settings
from orogen.lod.geometry_image_warping.region import nearest, rows_run_along_x, seen_region, sketch_lattice

NAME = "geometry_image_warping"
PIXEL = np.dtype([("at", "f4", 2), ("height", "f4"), ("importance", "f4")])
LOW_OVER_PUGET = (
    (117000.0, 85000.0, 5200.0, 112.0, -7.0),
    (127500.0, 73500.0, 4300.0, 155.0, -5.0),
    (141000.0, 36000.0, 4100.0, 158.0, -4.0),
    (134000.0, 8500.0, 3200.0, 266.0, -3.0),
)
"""Cameras in metres of the data (x, y, z), heading and pitch in degrees."""

Floats = NDArray[np.float64]


def read_images(scene: Scene, frame: Frame, state: AlgorithmView) -> tuple[NDArray[Any], NDArray[Any]]:
    """The sketch map (side, side) as it was weighed, and the mesh (rows + 1, columns + 1), both of dtype PIXEL."""
    assert len(scene.record(frame, state)) == 1
    settings: Settings = state._algorithm.settings  # type: ignore[attr-defined]
    columns, rows = settings.cells(frame.size)
    side = settings.sketch_size
    sketch, mesh = (
        scene.gpu.read_buffer(buffer).result().view(PIXEL)
        for buffer in (state._sketch, state._mesh)  # type: ignore[attr-defined]
    )
    return sketch.reshape(side, side).copy(), mesh.reshape(rows + 1, columns + 1).copy()


def texels(frame: Frame, pixels: NDArray[Any]) -> Floats:
    """(..., 2) columns and rows of pixels in level-0 texels."""
    return (pixels["at"].astype(np.float64) + frame.anchor) / (1 << frame.subtexel_bits)


# -- what is covered ----------------------------------------------------------------------------------------------


def seen_points(frame: Frame) -> Floats:
    """(n, 2) texels of ends of rays within the terrain's box: all of them must be covered."""
    probe = replace(frame, size=(61, 41))
    origin, direction = (a.reshape(-1, 3) for a in np.broadcast_arrays(*probe.rays()))
    inverse = np.linalg.inv(frame.grid.metres)
    start = np.column_stack([frame.eye + origin[:, :2] @ inverse.T, origin[:, 2]])
    step = np.column_stack([direction[:, :2] @ inverse.T, direction[:, 2]])
    low, high = (height * frame.exaggeration - frame.camera.z for height in frame.height_range)
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (np.array([0.5, 0.5, low]) - start) / step
        b = (np.array([frame.grid.width - 0.5, frame.grid.height - 0.5, high]) - start) / step
    first = np.where(np.isnan(a), -np.inf, np.minimum(a, b)).max(axis=1)
    last = np.where(np.isnan(b), np.inf, np.maximum(a, b)).min(axis=1)
    if not frame.camera.orthographic:
        first = np.maximum(first, frame.camera.near)
    hit = first < last
    return np.concatenate([start[hit] + t[hit, None] * step[hit] for t in (first, last)])[:, :2]


def test_the_region_holds_all_that_can_be_seen_and_hardly_more(plane: Scene, sheared_plane: Scene) -> None:
    compared = 0
    for scene in (plane, sheared_plane):
        for frame in some_frames(scene, 40, seed=1):
            frame = replace(frame, curvature=False)
            seen = seen_points(frame)
            if len(seen) < 200:
                continue
            region = seen_region(frame)
            assert region is not None
            assert (seen >= region[0] - 1e-6).all()
            assert (seen <= region[1] + 1e-6).all()
            # rays through pixel centres miss the picture's rim by half a pixel of 41
            assert (np.ptp(seen, axis=0) >= 0.85 * (region[1] - region[0]) - 1).all()
            compared += 1
    assert compared > 30


def test_every_way_of_warping_covers_all_that_is_visible(plane: Scene, sheared_plane: Scene) -> None:
    """A plane has no error but what is not covered, however coarse the mesh."""
    ways = ({"columns": 9, "rows": 8}, {"columns": 16, "rows": 40, "straight_rows": False}, {"warping": False})
    drawn = 0
    for scene in (plane, sheared_plane):
        states = [scene.algorithm(NAME, way) for way in ways]
        truth = scene.algorithm("raycast")
        for frame in some_frames(scene, 20, seed=2, ground=150.0):
            true = scene.draw(frame, truth)["depth"] > 0
            drawn += int(true.any())
            for state, way in zip(states, ways, strict=True):
                got = scene.draw(frame, state)["depth"] > 0
                # only rounding decides on which side of an outline a pixel lies
                assert (got != true).sum() <= 3, (way, frame.camera)
    assert drawn >= 16


@pytest.mark.parametrize("away", [3e3, 1e5, 3e6])
def test_a_camera_far_outside_sees_the_data_whole(plane: Scene, away: float) -> None:
    camera = plane.camera(110, 90 + away / 10, 0.5 * away, heading=0.0, pitch=-26.57, fov=math.degrees(3000 / away))
    frame = plane.frame(camera, SIZE)
    region = seen_region(frame)
    assert region is not None
    np.testing.assert_allclose(region, [[0.5, 0.5], [COLUMNS - 0.5, ROWS - 0.5]])
    _, mesh = read_images(plane, frame, plane.algorithm(NAME))
    assert least_area(mesh) > 0
    true, got = (plane.draw(frame, plane.algorithm(name))["depth"] > 0 for name in ("raycast", NAME))
    assert true.any()
    assert (got != true).sum() <= 8


def test_what_sees_no_terrain_draws_nothing(plane: Scene) -> None:
    frame = plane.frame(plane.camera(110, 90, 1500, pitch=60), SIZE)
    state = plane.algorithm(NAME)
    assert seen_region(frame) is None
    assert plane.record(frame, state) == []
    assert state.statistics().triangles == 0


def test_nothing_is_drawn_before_the_first_data(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        assert (scene.draw(frame, scene.algorithm(NAME))["depth"] == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (2, 2), (2, 300)])
def test_the_smallest_terrains(gpu: Gpu, shape: tuple[int, int]) -> None:
    with closing(Scene(gpu, np.full(shape, 5.0))) as scene:
        frame = scene.frame(scene.camera(shape[1] / 2, shape[0] / 2, 20 + 20 * min(shape), pitch=-90))
        got, true = (scene.draw(frame, scene.algorithm(name))["depth"] > 0 for name in (NAME, "raycast"))
        assert (got != true).sum() <= 4
        assert got.any() == true.any()


# -- where vertices lie -------------------------------------------------------------------------------------------


def least_area(mesh: NDArray[Any]) -> float:
    """Smallest signed area of the triangles, over that of all; below 0 where the mesh folds over."""
    at = mesh["at"].astype(np.float64)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    corners = np.stack([[a, d], [b, b], [c, c]])
    (x, y), (u, v) = (np.moveaxis(corners[k] - corners[0], -1, 0) for k in (1, 2))
    areas = x * v - y * u
    areas[1] *= -1
    return float((areas * np.sign(areas.sum())).min() / abs(areas.sum()))


def test_the_lattice_follows_the_distance_from_the_eye(plane: Scene, sheared_plane: Scene) -> None:
    compared = 0
    for scene in (plane, sheared_plane):
        for frame in some_frames(scene, 20, seed=5):
            region = seen_region(frame)
            if region is None:
                continue
            unit = 1 << frame.subtexel_bits
            even = (sketch_lattice(frame, region, 96, even=True).astype(np.float64) + frame.anchor) / unit
            np.testing.assert_allclose(even, np.linspace(*region, 96), atol=1e-2)
            lines = (sketch_lattice(frame, region, 96).astype(np.float64) + frame.anchor) / unit
            np.testing.assert_allclose(lines[[0, -1]], region, atol=1e-2)
            steps = np.diff(lines, axis=0)
            assert (steps > 0).all()
            eye = frame.lod_eye()
            foot = frame.eye + np.linalg.inv(frame.grid.metres) @ eye[:2]
            altitude = abs(eye[2] - (frame.ground_height * frame.exaggeration - frame.camera.z))
            along = np.linalg.norm(np.linalg.inv(frame.grid.metres), axis=1)
            distance = np.hypot((lines[1:] + lines[:-1]) / 2 - foot, max(altitude, nearest(frame)) * along)
            share = steps / distance
            assert (share.max(axis=0) < 1.05 * share.min(axis=0) + 0.02).all()
            compared += 1
    assert compared > 12


def twin_importance(frame: Frame, settings: Settings, flat: Floats, height: Floats, slope: Floats) -> Floats:
    """Importance in float64. `flat` (r, c, 2): camera-relative metres; `slope` (r, c, 2): of the exaggerated height."""
    z = height * frame.exaggeration - frame.camera.z - frame.curvature_factor * (flat**2).sum(axis=-1)
    position = np.concatenate([flat, z[..., None]], axis=-1)
    to_eye = frame.lod_eye() - position
    away = np.maximum(np.linalg.norm(to_eye, axis=-1), nearest(frame))
    normal = np.concatenate([-slope, np.ones((*z.shape, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    facing = (normal * to_eye).sum(axis=-1) / away
    way = np.clip((facing + 0.5) / 0.5, 0, 1)
    orientation = settings.back + (1 - settings.back) * way**2 * (3 - 2 * way)
    # from each pixel to the next, at the end to the one before
    steps = [np.concatenate([np.diff(flat, axis=k), -np.diff(flat, axis=k).take([-1], k)], axis=k) for k in (0, 1)]
    planes = frame.planes()
    reach = sum(np.abs(step @ planes[:, :2].T) for step in steps)
    outside = (-(position @ planes[:, :3].T) - planes[:, 3] - reach).max(axis=-1).clip(0)
    return orientation * np.maximum(settings.outside, np.exp(-outside / (settings.fall * away))) / away


def test_importance_over_a_plane_is_that_of_the_twin(plane: Scene, sheared_plane: Scene) -> None:
    settings = {"sketch_size": 40, "back": 0.3, "outside": 0.05, "fall": 0.2, "columns": 8, "rows": 8}
    spread = []
    for scene in (plane, sheared_plane):
        state = scene.algorithm(NAME, settings)
        metres = np.linalg.inv(scene.pyramid.grid.metres)
        for frame in some_frames(scene, 16, seed=6, ground=500.0):
            if seen_region(frame) is None:
                continue
            sketch, _ = read_images(scene, frame, state)
            at = texels(frame, sketch).clip(0.5, [COLUMNS - 0.5, ROWS - 0.5])
            height = 1.25 * (at[..., 0] - 0.5) - 0.75 * (at[..., 1] - 0.5) + 200
            np.testing.assert_allclose(sketch["height"], height, atol=0.02)
            slope = np.broadcast_to(np.array([1.25, -0.75]) @ metres * frame.exaggeration, at.shape)
            flat = (at - frame.eye) @ scene.pyramid.grid.metres.T
            expected = twin_importance(frame, Settings(**settings), flat, height, slope)
            np.testing.assert_allclose(sketch["importance"], expected, rtol=5e-3)
            spread.append(expected.max() / expected.min())
    assert len(spread) > 12
    assert max(spread) > 20


def test_importance_over_rough_ground_is_that_of_the_twin(gpu: Gpu) -> None:
    heights = noise(40, 50, relief=30.0).astype(np.float64)
    settings = {"sketch_size": 120, "columns": 8, "rows": 8}
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(25, 39, 60, heading=10.0, pitch=-15), SIZE)
        sketch, _ = read_images(scene, frame, scene.algorithm(NAME, settings))
    at = texels(frame, sketch)
    flat = (at - frame.eye) * [10.0, -10.0]
    # far enough from the border that the slopes' samples lie within the data, and finely enough sampled for level 0
    apart = [np.linalg.norm(np.diff(flat, axis=k), axis=-1) for k in (0, 1)]
    sure = np.maximum(apart[0][:, :-1], apart[1][:-1]) < 19.9
    sure &= ((at > 2) & (at < [48, 38])).all(axis=-1)[:-1, :-1]
    assert sure.sum() > 4000
    whole = np.clip(np.floor(at - 0.5).astype(int), 1, [47, 37])
    way = at - 0.5 - whole

    def bilinear(values: Floats) -> Floats:
        (x, y), (u, v) = np.moveaxis(whole, -1, 0), np.moveaxis(way, -1, 0)
        top = values[y, x] + (values[y, x + 1] - values[y, x]) * u
        return top + (values[y + 1, x] + (values[y + 1, x + 1] - values[y + 1, x]) * u - top) * v

    south, east = np.gradient(heights.astype(np.float64), 10.0)
    slope = np.stack([bilinear(east), -bilinear(south)], axis=-1)
    expected = twin_importance(frame, Settings(**settings), flat, bilinear(heights), slope)
    inner = np.s_[:-1, :-1]
    np.testing.assert_allclose(sketch["height"][inner][sure], bilinear(heights)[inner][sure], atol=0.02)
    np.testing.assert_allclose(sketch["importance"][inner][sure], expected[inner][sure], rtol=5e-3)


def twin_warp(image: Floats, samples: int, axis: int) -> Floats:
    """(lines, samples, 3) of (lines, pixels, 3): x, y and importance, sampled anew at equal importance along x or y."""
    result = np.empty((len(image), samples, 3))
    for line, new in zip(image, result, strict=True):
        weights = (line[1:, 2] + line[:-1, 2]) / 2 * np.abs(np.diff(line[:, axis]))
        sums = np.concatenate([[0.0], np.cumsum(weights)])
        for k in range(3):
            new[:, k] = np.interp(np.linspace(0, sums[-1], samples), sums, line[:, k])
    return result


@pytest.mark.parametrize("straight", [True, False])
def test_the_mesh_is_that_of_the_twin(hilly: Scene, straight: bool) -> None:
    """Rows first, then columns, both up-sampled."""
    compared = 0
    state = hilly.algorithm(NAME, {"columns": 70, "rows": 90, "sketch_size": 48, "straight_rows": straight})
    for frame in some_frames(hilly, 16, seed=7, ground=500.0):
        if seen_region(frame) is None:
            continue
        sketch, mesh = read_images(hilly, frame, state)
        image = np.concatenate([texels(frame, sketch), sketch["importance"][..., None]], axis=-1)
        across = 0 if rows_run_along_x(frame) else 1
        # rows of the sketch map run along the data's axis across the view
        assert np.ptp(image[0, :, 1 - across]) == 0
        half = twin_warp(image, 71, across)
        if straight:
            half[..., 2] = half[..., 2].mean(axis=1, keepdims=True)
        expected = twin_warp(half.swapaxes(0, 1), 91, 1 - across).swapaxes(0, 1)[..., :2]
        off = np.abs(texels(frame, mesh) - expected)
        assert off.max() < 2e-3 * np.ptp(image[..., :2])
        compared += 1
    assert compared >= 6


def test_straight_rows_do_not_fold(hilly: Scene) -> None:
    settings = {"columns": 60, "rows": 90}
    straight, free = (hilly.algorithm(NAME, {**settings, "straight_rows": s}) for s in (True, False))
    folded = 0
    for frame in some_frames(hilly, 40, seed=3, ground=500.0):
        region = seen_region(frame)
        if region is None:
            continue
        _, mesh = read_images(hilly, frame, straight)
        assert least_area(mesh) >= 0
        # no row bends, to the bit
        across = 0 if rows_run_along_x(frame) else 1
        assert (mesh["at"][..., 1 - across] == mesh["at"][:, :1, 1 - across]).all()
        _, bent = read_images(hilly, frame, free)
        folded += least_area(bent) < -1e-6
        for image in (mesh, bent):
            # the rim stays on the rim
            at = texels(frame, image)
            ends = np.sort([at[0, 0], at[-1, -1]], axis=0)
            np.testing.assert_allclose(ends, region, atol=1e-2)
            for edge in (at[0], at[-1], at[:, 0], at[:, -1]):
                assert (np.ptp(edge, axis=0) == 0).any()
    # what the default avoids
    assert folded >= 3


def read(scene: Scene, frame: Frame, state: AlgorithmView) -> NDArray[Any]:
    """(rows of cells, vertices of a strip) of dtype VERTEX as they are drawn."""
    (draw,) = scene.record(frame, state)
    columns, rows = state._algorithm.settings.cells(frame.size)  # type: ignore[attr-defined]
    strips = read_strips(scene, draw)
    assert strips.shape == (rows, 2 * (columns + 1))
    return strips


def test_edges_match_bit_for_bit(hilly: Scene, sheared_plane: Scene) -> None:
    """All edges but those of the region's rim are shared by two triangles; statistics count them all."""
    for scene in (hilly, sheared_plane):
        state = scene.algorithm(NAME, {"columns": 24, "rows": 60})
        for frame in some_frames(scene, 6, seed=3, ground=500.0):
            if seen_region(frame) is None:
                continue
            strips = read(scene, frame, state)
            p = strips["position"]
            corners = np.stack([p[:, :-2], p[:, 1:-1], p[:, 2:]], axis=2).reshape(-1, 3, 3)
            statistics = state.statistics()
            assert (len(corners), 1, 1) == (statistics.triangles, statistics.patches, statistics.draws)
            a, b, c = corners.swapaxes(0, 1)
            same = (a == b).all(1) | (b == c).all(1) | (c == a).all(1)
            torn = torn_edges(corners[~same], (np.nan,) * 4)
            rim = np.concatenate([p[0, ::2], p[-1, 1::2], p[:, :2].reshape(-1, 3), p[:, -2:].reshape(-1, 3)])
            known = {point.tobytes() for point in rim + np.float32(0)}
            assert len(torn)
            assert all(point.tobytes() in known for point in torn.reshape(-1, 3))


def test_a_frozen_camera_keeps_its_mesh(hilly: Scene) -> None:
    state = hilly.algorithm(NAME, {"columns": 20, "rows": 60})
    eye = hilly.camera(110, 160, 700, heading=10.0, pitch=-25)
    aside = eye.moved(x=eye.x - 700.0, z=2000.0, heading=40.0, pitch=-60.0)
    own, frozen = hilly.frame(eye, SIZE), hilly.frame(aside, SIZE, lod_camera=eye)
    at = [texels(frame, read_images(hilly, frame, state)[1]) for frame in (own, frozen)]
    np.testing.assert_allclose(*at, atol=0.05)


# -- what warping is worth ----------------------------------------------------------------------------------------


def test_vertices_go_where_they_matter(hilly: Scene, gpu: Gpu) -> None:
    frame = hilly.frame(hilly.camera(60, 160, 530, heading=45.0, pitch=-8, fov=20), SIZE)
    planes = frame.planes()

    def share_seen(settings: dict[str, Any]) -> float:
        """Of the vertices in the picture."""
        strips = read(hilly, frame, hilly.algorithm(NAME, {"columns": 40, "rows": 60, **settings}))
        inside = strips["position"].astype(np.float64) @ planes[:, :3].T + planes[:, 3] > 0
        return float(inside.all(axis=-1).mean())

    even, warped, narrow = (share_seen(s) for s in ({"warping": False}, {}, {"fall": 0.02, "outside": 1e-3}))
    assert even < 0.5
    assert even + 0.15 < warped < narrow
    assert narrow > 0.7
    # a roof whose far side turns away
    heights = np.maximum(0, 400 - 8 * np.abs(np.arange(120) - 60))[:, None] * np.ones(100, np.float32)
    with closing(Scene(gpu, heights)) as scene:
        frame = scene.frame(scene.camera(50, 115, 250, heading=0.0, pitch=-5), SIZE)
        far = []
        for back in (1.0, 0.1):
            _, mesh = read_images(scene, frame, scene.algorithm(NAME, {"columns": 20, "rows": 80, "back": back}))
            row = texels(frame, mesh)[..., 1]
            far.append(((row > 12) & (row < 60)).mean())
    assert far[1] < 0.6 * far[0]


def test_warping_pays(gpu: Gpu, data_dir: Path) -> None:
    """Over Puget, low over ground, at equal triangles: errors of the even, the document's and the default mesh."""
    with Image.open(data_dir / "puget_height_1k.png") as image:
        heights = np.asarray(image).astype(np.float32) * np.float32(0.1)
    surface = TrueSurface(heights)
    errors = []
    with closing(Scene(gpu, heights, spacing=160.0)) as scene:
        ways = ({"warping": False}, {"straight_rows": False}, {})
        states = [scene.algorithm(NAME, {"columns": 60, "rows": 120, **way}) for way in ways]
        truth = scene.algorithm("raycast")
        for x, y, z, heading, pitch in LOW_OVER_PUGET:
            frame = scene.frame(Camera(x, y, z, heading=heading, pitch=pitch), (160, 90))
            true = scene.draw(frame, truth)["depth"]
            drawn = [scene.draw(frame, state)["depth"] for state in states]
            errors.append([surface_error(depth, true, frame, surface).backward.mean for depth in drawn])
        assert len({state.statistics().triangles for state in states}) == 1
    even, each, straight = np.mean(errors, axis=0)
    assert straight < each < 0.3 * even


def test_more_cells_are_better(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(110, 160, 560, pitch=-15), (160, 100))
    true = hilly.draw(frame, hilly.algorithm("raycast"))["depth"]
    surface = TrueSurface(hills(COLUMNS, 500.0).astype(np.float32)[:ROWS])
    triangles, errors = [], []
    for pixels in (16.0, 8.0, 4.0, 2.0):
        state = hilly.algorithm(NAME, {"pixels_per_column": pixels})
        errors.append(surface_error(hilly.draw(frame, state)["depth"], true, frame, surface).backward.mean)
        triangles.append(state.statistics().triangles)
    assert (np.diff(errors) < 0).all()
    assert triangles == [2 * n * 2 * n for n in (10, 20, 40, 80)]


# -- procedural detail --------------------------------------------------------------------------------------------


def twin_detail(at: Floats, bits: int, amplitude: float, size: float) -> Floats:
    """Noise in metres at texels (n, 2) from the first sample's centre, octave by octave."""

    def random_at(x: NDArray[np.int64], y: NDArray[np.int64], octave: int) -> Floats:
        v = [(a + octave * 0x9E3779B9) * 1664525 + 1013904223 & 0xFFFFFFFF for a in (x, y)]
        for _ in range(2):
            v[0] = v[0] + v[1] * 1664525 & 0xFFFFFFFF
            v[1] = v[1] + v[0] * 1664525 & 0xFFFFFFFF
            v = [a ^ a >> 16 for a in v]
        return (v[0] >> 8) / 8388607.5 - 1.0

    total = np.zeros(len(at))
    for octave in range(4):
        width = max(int(size * 0.5**octave * (1 << bits)), 1) / (1 << bits)
        x, y = np.floor(at / width).astype(np.int64).T
        u, v = ((at / width) % 1.0).T
        u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
        top = random_at(x, y, octave) * (1 - u) + random_at(x + 1, y, octave) * u
        bottom = random_at(x, y + 1, octave) * (1 - u) + random_at(x + 1, y + 1, octave) * u
        total += 0.5**octave * (top * (1 - v) + bottom * v)
    return amplitude * total / 1.875


def test_detail_is_a_function_of_the_place(gpu: Gpu) -> None:
    settings = {"detail_height": 20.0, "detail_size": 6.0, "columns": 60, "rows": 90}
    with closing(Scene(gpu, np.full((ROWS, COLUMNS), 100.0))) as scene:
        state = scene.algorithm(NAME, settings)
        for camera in (
            scene.camera(110, 160, 260, heading=10.0, pitch=-20),
            scene.camera(30, 20, 900, heading=140.0, pitch=-60),
        ):
            frame = scene.frame(camera, SIZE)
            _, mesh = read_images(scene, frame, state)
            at = texels(frame, mesh).clip(0.5, [COLUMNS - 0.5, ROWS - 0.5]).reshape(-1, 2) - 0.5
            added = mesh["height"].ravel() - 100.0
            np.testing.assert_allclose(added, twin_detail(at, frame.subtexel_bits, 20.0, 6.0), atol=0.02)
            assert 8 < np.abs(added).max() <= 20.0
            assert abs(added.mean()) < 2.0
        plain = scene.algorithm(NAME, {**settings, "detail_height": 0.0})
        _, mesh = read_images(scene, frame, plain)
        assert (mesh["height"] == 100.0).all()


def test_detail_that_rises_into_the_picture_is_covered(gpu: Gpu) -> None:
    """The ground lies below the picture; only what the noise adds is in it."""
    with closing(Scene(gpu, np.full((ROWS, COLUMNS), 100.0))) as scene:
        frame = scene.frame(scene.camera(110, 260, 130, heading=0.0, pitch=23.0), SIZE)
        assert seen_region(frame) is None
        state = scene.algorithm(NAME, {"detail_height": 150.0, "detail_size": 20.0})
        depth = scene.draw(frame, state)["depth"]
        assert 0.01 < (depth > 0).mean() < 0.5


# -- settings -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels_per_column": "0"}, "pixels_per_column: expected a number above 0, got 0"),
        ({"rows_per_column": "nan"}, "rows_per_column: expected a number above 0, got nan"),
        ({"columns": "4"}, "columns: expected at least 8 cells, got 4"),
        ({"rows": "7"}, "rows: expected at least 8 cells, got 7"),
        ({"sketch_size": "7"}, "sketch_size: expected 8 to 256 pixels, got 7"),
        ({"sketch_size": "257"}, "sketch_size: expected 8 to 256 pixels, got 257"),
        ({"outside": "0"}, "outside: expected 0.0001 to 1, got 0"),
        ({"back": "1.5"}, "back: expected 0.0001 to 1, got 1.5"),
        ({"fall": "-1"}, "fall: expected a number above 0, got -1"),
        ({"detail_height": "-1"}, "detail_height: expected 0 metres or more, got -1"),
        ({"detail_height": "inf"}, "detail_height: expected 0 metres or more, got inf"),
        ({"detail_size": "0"}, "detail_size: expected a number above 0, got 0"),
        ({"sketch": "3"}, f"setting of {NAME}: expected one of"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings(NAME, settings)


def test_cells_follow_the_picture_unless_they_are_given() -> None:
    assert make_settings(NAME, {"pixels_per_column": "4", "rows_per_column": "5"}).cells((1600, 900)) == (400, 2000)
    assert make_settings(NAME, {"columns": "240", "rows": "1050"}).cells((1600, 900)) == (240, 1050)
    assert Settings().cells((1, 1)) == (8, 16)


def test_a_mesh_that_is_too_large_says_what_to_change(plane: Scene) -> None:
    frame = plane.frame(plane.camera(110, 90, 900, pitch=-90), SIZE)
    for settings in ({"columns": 100_000, "rows": 100_000}, {"columns": 80_000, "rows": 8}):
        with pytest.raises(BudgetError, match="raise pixels_per_column"):
            plane.record(frame, plane.algorithm(NAME, settings))
