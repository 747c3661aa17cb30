"""gamer: its pool of patterns, its tags against a twin, and edges that match between all of its patterns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.restricted import areas, assert_whole, edge_counts, some_cameras, unculled
from lod.scene import Scene, noise
from lod.triangles import read_triangles, with_area
from oracle.landscapes import hills
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import Grid
from orogen.lod import make_settings
from orogen.lod.contract import AlgorithmView, Draw
from orogen.lod.gamer import TAGS, cell_rows, cell_side
from orogen.lod.gamer.patterns import WAYS, Bits, Depths, index_lists, pattern, pool

SHAPES = [(75, 101), (2, 3), (90, 2), (33, 33)]
"""Rows and columns: cells that end with the data are narrower."""
FEW: dict[str, Any] = {"max_depth": 3, "coarse": 12, "pixels": 6.0}

# -- patterns --------------------------------------------------------------------------------------------------------


def smallest_angles(triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """Degrees, in a triangle of equal sides."""
    u, v = triangles[..., 0].astype(float), triangles[..., 1].astype(float)
    at = np.stack([u + v / 2, v * np.sqrt(0.75)], axis=-1)
    side = np.roll(at, -1, axis=1) - at
    length = np.linalg.norm(side, axis=-1)
    cosine = -(side * np.roll(side, 1, axis=1)).sum(axis=-1) / (length * np.roll(length, 1, axis=1))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))).min(axis=1)


def outline(depths: Depths, most: int) -> set[Any]:
    """Segments that a pattern's border must have; edge k lies opposite corner k."""
    whole = 1 << most
    corners = np.array([(whole, 0), (0, whole), (0, 0)])
    found = set()
    for k, depth in enumerate(depths):
        a, b = corners[k - 2], corners[k - 1]
        points = [tuple((a + (b - a) * i // 2**depth).tolist()) for i in range(2**depth + 1)]
        found |= {tuple(sorted(ends)) for ends in pairwise(points)}
    return found


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("most", [1, 3, 5])
def test_patterns_are_whole_and_have_the_edges_that_their_depths_say(way: str, most: int) -> None:
    for depths in pool(most):
        triangles = pattern(depths, most, way)
        assert (areas(triangles) > 0).all()
        assert areas(triangles).sum() == 4**most / 2
        counts = edge_counts(triangles)
        assert {edge for edge, count in counts.items() if count == 1} == outline(depths, most)
        assert set(counts.values()) <= {1, 2}


def test_patterns_are_numbered_by_their_depths() -> None:
    for most in (1, 6, 7):
        numbers = {depths: number for number, depths in enumerate(pool(most))}
        assert len(numbers) == (most + 1) * (most + 2) * (most + 3) // 6
        for (i, j, k), number in numbers.items():
            assert number == i * (i + 1) * (i + 2) // 6 + j * (j + 1) // 2 + k
        # as many as the compute rasteriser takes in one go
        assert len(numbers) <= 128


def test_the_uniform_way_splits_border_triangles_alone() -> None:
    for depths in pool(6):
        segments = [2**depth for depth in depths]
        # a uniform mesh, and one more triangle for each point that is added to an edge
        expected = min(segments) ** 2 + sum(count - min(segments) for count in segments)
        assert len(pattern(depths, 6, "uniform")) == expected


def test_the_graded_way_has_more_and_less_oblique_triangles() -> None:
    # the depths of figure 7
    uniform, graded = (pattern((5, 4, 3), 6, way) for way in ("uniform", "graded"))
    assert len(uniform) < len(graded) < 4**5
    assert (smallest_angles(graded) < 20).sum() < 0.2 * (smallest_angles(uniform) < 20).sum()
    every = {way: np.concatenate([smallest_angles(pattern(depths, 6, way)) for depths in pool(6)]) for way in WAYS}
    assert len(every["graded"]) > len(every["uniform"])
    assert (every["graded"] < 15).mean() < 0.5 * (every["uniform"] < 15).mean()


@pytest.mark.parametrize("way", WAYS)
def test_vertex_numbers_hold_the_patterns(way: str) -> None:
    for number, (depths, numbers) in enumerate(zip(pool(4), index_lists(4, way), strict=True)):
        assert (numbers >> Bits.PATTERN == number).all()
        at = np.stack([numbers & 255, numbers >> Bits.SECOND & 255], axis=-1)
        np.testing.assert_array_equal(at, pattern(depths, 4, way))
        # each corner has a line of its own to its far side
        np.testing.assert_array_equal(np.sort(numbers >> Bits.CORNER & 3, axis=1), np.tile([0, 1, 2], (len(at), 1)))
    # vertices of regular meshes are shared
    assert len(np.unique(numbers)) == 17 * 18 // 2


# -- what is drawn ---------------------------------------------------------------------------------------------------


class Occurring(AlgorithmView):
    """A view with only the draws of the patterns that occur in a frame."""

    def __init__(self, scene: Scene, frame: Frame, state: AlgorithmView) -> None:
        self.state = state
        draws = scene.record(frame, state)
        arguments = scene.gpu.read_buffer(draws[0].indirect, dtype=np.uint32).result().reshape(-1, 5)
        self.numbers = np.flatnonzero(arguments[:, 1]).tolist()

    def record(self, *args: Any) -> Sequence[Draw]:
        draws = self.state.record(*args)
        return [draws[number] for number in self.numbers]

    def statistics(self) -> Any:
        return self.state.statistics()


def read(scene: Scene, frame: Frame, state: AlgorithmView) -> dict[int, NDArray[Any]]:
    """Corners (instances, triangles, 3) of dtype VERTEX by pattern, of the patterns that occur."""
    occurring = Occurring(scene, frame, state)
    return dict(zip(occurring.numbers, read_triangles(scene, frame, occurring), strict=True))


@pytest.fixture(scope="module", params=SHAPES, ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    rows, columns = request.param
    y, x = np.mgrid[:rows, :columns]
    # roughness that changes by orders of magnitude, so that patterns of all kinds meet
    share = 0.001 ** np.abs(np.sin(x / 11.0) * np.cos(y / 13.0))
    with closing(Scene(gpu, noise(rows, columns) * share.astype(np.float32), view_distance=0.3)) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[tuple[Scene, NDArray[np.float32]]]:
    heights = hills(140, 300.0).astype(np.float32)[:100]
    with closing(Scene(gpu, heights)) as terrain:
        yield terrain, heights


@pytest.mark.parametrize("way", WAYS)
def test_the_surface_is_whole_and_edges_match_bit_for_bit(scene: Scene, way: str) -> None:
    seen: set[int] = set()
    for tag, camera in zip(TAGS, some_cameras(scene, 3, seed=6), strict=True):
        state = scene.algorithm("gamer", {**FEW, "patterns": way, "tag": tag})
        frame = unculled(scene.frame(camera, (160, 100)))
        drawn = read(scene, frame, state)
        assert_whole(with_area(list(drawn.values())), frame)
        seen |= set(drawn)
    # patterns of many kinds meet
    assert len(seen) > 8 or min(scene.pyramid.grid.shape) < 40


def test_edges_match_on_a_sheared_grid(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(70, 90), metres=np.array([[10.0, 7.0], [1.0, -8.0]]))) as scene:
        state = scene.algorithm("gamer", {**FEW, "tag": "error"})
        for camera in some_cameras(scene, 2, seed=2):
            frame = unculled(scene.frame(camera, (160, 100)))
            assert_whole(with_area(list(read(scene, frame, state).values())), frame)


class Twin:
    """Tags in float64 numpy, from the samples themselves."""

    def __init__(self, frame: Frame, heights: NDArray[np.float32], settings: Any) -> None:
        self.frame, self.heights, self.settings = frame, heights.astype(np.float64), settings
        self.last = np.array([heights.shape[1], heights.shape[0]]) - 1
        self.side = cell_side(frame.grid, settings.coarse)
        self.cells = cell_rows(frame.grid, self.side)[::-1]
        self.tags = {place: self.tag(*place) for place in product(*(range(n + 1) for n in self.cells))}

    def at(self, texel: NDArray[np.float64]) -> NDArray[np.float64]:
        """Camera-relative metres of the surface at (column, row)."""
        i, j = np.minimum(np.floor(texel).astype(int), self.last - 1)
        u, v = texel - (i, j)
        h = self.heights
        height = (1 - v) * ((1 - u) * h[j, i] + u * h[j, i + 1]) + v * ((1 - u) * h[j + 1, i] + u * h[j + 1, i + 1])
        flat = self.frame.grid.metres @ (texel + 0.5 - self.frame.eye)
        return np.append(flat, height * self.frame.exaggeration - self.frame.camera.z)

    def corner(self, x: int, y: int) -> NDArray[np.float64]:
        return np.minimum(np.array([x, y]) * self.side, self.last).astype(np.float64)

    def around(self, x: int, y: int) -> list[NDArray[np.float64]]:
        places = product(range(x - 1, x + 2), range(y - 1, y + 2))
        return [self.corner(i, j) for i, j in places if 0 <= i <= self.cells[0] and 0 <= j <= self.cells[1]]

    def tag(self, x: int, y: int) -> float:
        corners = self.around(x, y)
        points = np.array([self.at(corner) for corner in corners])
        eye = self.frame.lod_eye()
        distance = float(np.linalg.norm(np.clip(eye, points.min(axis=0), points.max(axis=0)) - eye))
        pixels_per_radian = self.frame.pixels_per_radian(self.frame.lod)
        allowed = self.settings.pixels * max(distance, 1e-3) / pixels_per_radian
        if self.settings.tag == "distance":
            tag = np.log2(self.side * np.linalg.norm(self.frame.grid.metres, axis=0).max() / allowed)
        else:
            tag = self.from_errors(self.errors(self.corner(x, y), corners), allowed)
        return float(np.clip(tag, 0, self.settings.max_depth))

    def errors(self, middle: NDArray[np.float64], corners: list[NDArray[np.float64]]) -> list[float]:
        """Of edges halved 0, 1 and 2 times, at eighths of them."""
        errors = []
        lines = [[self.at(middle + (corner - middle) * i / 8)[2] for i in range(9)] for corner in corners]
        for stride in (8, 4, 2):
            chords = [np.interp(range(9), range(0, 9, stride), line[::stride]) for line in lines]
            errors.append(float(np.abs(np.subtract(lines, chords)).max()))
        return errors

    def from_errors(self, errors: list[float], allowed: float) -> float:
        smooth = 2 + np.log2(max(errors[2], 1e-30) / allowed) / 2
        if self.settings.tag == "curvature":
            return smooth
        return next((float(k) for k in (0, 1) if errors[k] <= allowed), max(smooth, 2.0))

    def depths(self, triangle: int) -> list[float]:
        """Of a coarse triangle's edges, before they are rounded up."""
        y, x = divmod(triangle // 2, self.cells[0])
        corners = [(x + 1, y + 1), (x, y + 1), (x + 1, y)] if triangle % 2 else [(x, y), (x + 1, y), (x, y + 1)]
        return [(self.tags[corners[k - 2]] + self.tags[corners[k - 1]]) / 2 for k in range(3)]


@pytest.mark.parametrize("tag", TAGS)
def test_patterns_are_those_of_the_twins_tags(hilly: tuple[Scene, NDArray[np.float32]], tag: str) -> None:
    scene, heights = hilly
    settings = {"coarse": 20, "max_depth": 4, "tag": tag, "pixels": 6.0 if tag == "distance" else 1.0}
    state = scene.algorithm("gamer", settings)
    seen: set[int] = set()
    checked = 0
    near = scene.camera(72.5, 50.5, float(heights[50, 72]) + 50)
    for k, camera in enumerate([near, *some_cameras(scene, 1, seed=4)]):
        frozen = {"lod_camera": camera.moved(x=camera.x + 90, z=camera.z + 70)} if k else {}
        frame = unculled(scene.frame(camera, (160, 100), exaggeration=1.0 + k, **frozen))
        drawn = read(scene, frame, state)
        twin = Twin(frame, heights, make_settings("gamer", settings))
        found = {int(name): number for number, corners in drawn.items() for name in corners["id"][:, 0, 0]}
        assert sorted(found) == list(range(2 * twin.cells[0] * twin.cells[1]))
        for triangle, number in found.items():
            wanted = twin.depths(triangle)
            # too close to call, unless all that has a say is a whole number
            if all(depth == round(depth) or abs(depth - round(depth)) > 1e-3 for depth in wanted):
                assert pool(4)[number] == tuple(sorted((int(np.ceil(depth)) for depth in wanted), reverse=True))
                checked += 1
        seen |= set(drawn)
    assert checked > 700
    assert len(seen) > 7


def test_statistics_count_what_is_drawn_and_the_order_is_always_the_same(
    hilly: tuple[Scene, NDArray[np.float32]],
) -> None:
    scene, _ = hilly
    triangles = []
    for pixels in (12.0, 6.0, 3.0):
        state = scene.algorithm("gamer", {"coarse": 24, "max_depth": 4, "pixels": pixels})
        frame = scene.frame(scene.camera(50, 130, 250, pitch=-30), (160, 100))
        drawn = read(scene, frame, state)
        counted = state.statistics()
        assert counted.triangles == sum(corners[..., 0].size for corners in drawn.values())
        assert counted.patches == sum(len(corners) for corners in drawn.values())
        assert counted.draws == len(pool(4))
        assert 0 < counted.patches < 2 * 24 * 24
        triangles.append(counted.triangles)
        for number, corners in drawn.items():
            assert corners.shape[1] == len(pattern(pool(4)[number], 4, "graded"))
            assert (np.diff(corners["id"][:, 0, 0].astype(int)) > 0).all()
            assert (corners["tile_level"] == 4 - pool(4)[number][0]).all()
    assert (np.diff(triangles) > 0).all()


def test_culling_never_changes_the_picture(hilly: tuple[Scene, NDArray[np.float32]]) -> None:
    scene, _ = hilly
    state = scene.algorithm("gamer", {"coarse": 40, "max_depth": 5})
    seen = everything = 0
    for camera in some_cameras(scene, 5, seed=9):
        frame = scene.frame(camera)
        culled = scene.draw(frame, state)
        seen += state.statistics().patches
        unseen = scene.draw(unculled(frame), state)
        everything += state.statistics().patches
        for name in culled:
            np.testing.assert_array_equal(culled[name], unseen[name])
    assert seen < 0.7 * everything


def test_flat_ground_needs_no_depth_but_for_the_distance(gpu: Gpu) -> None:
    with closing(Scene(gpu, np.full((40, 60), 7.0))) as scene:
        frame = unculled(scene.frame(scene.camera(30, 20, 60, pitch=-90), (160, 100)))
        for tag in TAGS:
            state = scene.algorithm("gamer", {"coarse": 8, "tag": tag})
            scene.draw(frame, state)
            counted = state.statistics()
            assert (counted.triangles > 2 * counted.patches) == (tag == "distance")
            assert (counted.triangles == counted.patches) == (tag != "distance")


def test_a_coarse_mesh_of_one_cell(hilly: tuple[Scene, NDArray[np.float32]]) -> None:
    scene, _ = hilly
    frame = scene.frame(scene.camera(70, 50, 900, pitch=-90), (96, 64))
    state = scene.algorithm("gamer", {"coarse": 1, "pixels": 0.5})
    assert (scene.draw(frame, state)["depth"] > 0).all()
    assert (state.statistics().patches, state.statistics().triangles) == (2, 2 * 4**6)


def test_nothing_is_drawn_before_the_first_data_or_of_a_single_sample(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("gamer", FEW)
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().triangles == 0
    with closing(Scene(gpu, np.full((1, 1), 5.0))) as scene:
        frame = scene.frame(scene.camera(0.5, 0.5, 100, pitch=-90))
        assert (scene.draw(frame, scene.algorithm("gamer", FEW))["depth"] == 0).all()


def test_cells_are_wider_over_more_data() -> None:
    def grid(width: int, height: int) -> Grid:
        return Grid(width, height, (1.0, 0.0, 0.0, 0.0, -1.0, 0.0))

    assert [cell_side(grid(1025, n), 128) for n in (2, 1025, 1026, 19401)] == [8, 8, 16, 256]
    assert cell_side(grid(1025, 1025), 1) == 1024
    assert cell_side(grid(2, 3), 1024) == 1
    assert cell_rows(grid(1025, 1026), 16) == (65, 64)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"coarse": "0"}, "coarse: expected 1 to 1024 cells, got 0"),
        ({"coarse": "1025"}, "coarse: expected 1 to 1024 cells, got 1025"),
        ({"max_depth": "8"}, "max_depth: expected 1 to 7, got 8"),
        ({"tag": "errors"}, "tag: expected one of distance, curvature, error, got 'errors'"),
        ({"pixels": "0"}, "pixels: expected a number above 0, got 0"),
        ({"pixels": "nan"}, "pixels: expected a number above 0, got nan"),
        ({"patterns": "even"}, "patterns: expected one of uniform, graded, got 'even'"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("gamer", settings)
