"""tessellation: its patterns against a graphics driver's, its factors against a twin, and watertight edges."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from functools import cache
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lod import tessellator
from lod.lists import read
from lod.patches import torn_edges
from lod.restricted import some_cameras, unculled
from lod.scene import Scene, noise
from oracle.landscapes import hills
from orogen.errors import BudgetError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import Grid
from orogen.lod import make_settings
from orogen.lod.tessellation import FOLDER, SPACINGS, usual_size

ROOM = 8192
"""Triangles of a pattern at most."""


@cache
def oracle() -> dict[str, NDArray]:
    with np.load(tessellator.FILE) as file:
        return dict(file)


def patterns(gpu: Gpu, spacing: str, factors: NDArray[np.float32]) -> tuple[NDArray[np.uint32], list[NDArray]]:
    """(n, 2) numbers of points and triangles, and the triangles of each pattern: (m, 3, 2) parameters times 65536."""
    shader = gpu.shader(
        "patterns", Path(__file__).parent / "patterns.wgsl",
        search=[FOLDER], constants={**SPACINGS[spacing], "ROOM": ROOM},
    )  # fmt: skip
    layout = gpu.layout("patterns", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage"), 2: ("COMPUTE", "storage")})
    padded = np.zeros((len(factors), 8), np.float32)
    padded[:, :6] = factors
    given = gpu.buffer("factors", padded, "STORAGE", "test")
    counts = gpu.buffer("counts", 8 * len(factors), "STORAGE|COPY_SRC", "test")
    corners = gpu.buffer("corners", 24 * ROOM * len(factors), "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("patterns")
    run = encoder.begin_compute_pass(label="patterns")
    run.set_pipeline(gpu.compute("patterns", shader, "write_patterns", [layout]))
    run.set_bind_group(0, gpu.bind("patterns", layout, {0: given, 1: counts, 2: corners}))
    run.dispatch_workgroups(len(factors))
    run.end()
    gpu.submit(encoder)
    number = gpu.read_buffer(counts).result().view(np.uint32).reshape(-1, 2).copy()
    found = gpu.read_buffer(corners).result().view(np.uint32).reshape(-1, ROOM, 3, 2)
    result = number, [part[:count].copy() for part, count in zip(found, number[:, 1], strict=True)]
    for buffer in (given, counts, corners):
        buffer.destroy()
    return result


@pytest.mark.parametrize("spacing", ["integer", "fractional_even", "fractional_odd"])
def test_patterns_are_those_of_a_graphics_driver(gpu: Gpu, spacing: str) -> None:
    expected = oracle()
    counts, drawn = patterns(gpu, spacing, expected["factors"])
    np.testing.assert_array_equal(counts[:, 1], expected[f"{spacing} counts"])
    parts = np.split(expected[spacing], np.cumsum(expected[f"{spacing} counts"])[:-1])
    for row, ours, theirs in zip(expected["factors"], drawn, parts, strict=True):
        np.testing.assert_array_equal(tessellator.canonical(ours), theirs, err_msg=str(row))


def test_points_slide_as_factors_grow(gpu: Gpu) -> None:
    """Fractional spacings have no jumps: each point of one factor is close to a point of the next, and the reverse."""
    for spacing, (low, high) in product(("fractional_even", "fractional_odd"), ((1.0, 9.0), (20.0, 23.0))):
        steps = np.arange(low, high, 0.05, dtype=np.float32)
        drawn = patterns(gpu, spacing, np.repeat(steps[:, None], 6, axis=1))[1]
        # along the north edge
        edges = [np.unique(triangles[triangles[..., 1] == 0][:, 0]) / 65536 for triangles in drawn]
        for one, other in pairwise(edges):
            apart = np.abs(one[:, None] - other[None, :])
            assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 0.01


SHAPES = [(75, 101), (2, 3), (90, 2), (33, 33)]
"""Rows and columns: several nodes would add nothing, patches that end with the data do."""
ROUGH = {"pixels_per_quad": 8.0}


@pytest.fixture(scope="module", params=SHAPES, ids=str)
def scene(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, noise(*request.param), view_distance=0.3)) as terrain:
        yield terrain


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hills(400, 500.0).astype(np.float32)[:300])) as terrain:
        yield terrain


@pytest.mark.parametrize("spacing", SPACINGS)
def test_the_surface_is_whole_and_edges_match_bit_for_bit(scene: Scene, spacing: str) -> None:
    state = scene.algorithm("tessellation", {**ROUGH, "spacing": spacing})
    last = np.array([scene.pyramid.grid.width, scene.pyramid.grid.height]) - 1.0
    for camera in some_cameras(scene, 3, seed=6):
        drawn = read(scene, unculled(scene.frame(camera, (160, 100))), state)
        positions = drawn.corners["position"]
        x, y = positions[..., 0], positions[..., 1]
        assert len(torn_edges(positions, (x.min(), y.min(), x.max(), y.max()))) == 0
        # nothing is folded over: areas add up
        a, b, c = drawn.texels.swapaxes(0, 1)
        (px, py), (qx, qy) = (b - a).T, (c - a).T
        assert np.abs(px * qy - py * qx).sum() / 2 == pytest.approx(np.prod(last), rel=1e-4)
        np.testing.assert_array_equal(drawn.texels.reshape(-1, 2).min(axis=0), [0, 0])
        np.testing.assert_array_equal(drawn.texels.reshape(-1, 2).max(axis=0), last)


def test_powers_of_two(hilly: Scene) -> None:
    state = hilly.algorithm("tessellation", {**ROUGH, "spacing": "pow2", "patch_size": 16})
    drawn = read(hilly, hilly.frame(hilly.camera(200, 200, 400, pitch=-30), (160, 100)), state)
    west = (drawn.texels % 16 == 0)[..., 0].sum(axis=1) == 2
    edges = drawn.texels[west]
    lengths = {float(np.ptp(edge[edge[:, 0] % 16 == 0][:, 1])) for edge in edges}
    assert lengths <= {16 / 2**n for n in range(7)} | {(299 % 16) / 2**n for n in range(7)}
    assert len(lengths) > 3


def test_edges_match_on_a_sheared_grid(gpu: Gpu) -> None:
    metres = np.array([[10.0, 7.0], [1.0, -8.0]])
    with closing(Scene(gpu, noise(70, 90), metres=metres)) as scene:
        state = scene.algorithm("tessellation", ROUGH)
        for camera in some_cameras(scene, 3, seed=2):
            drawn = read(scene, unculled(scene.frame(camera, (160, 100))), state)
            # corners are named by their exact place in the grid, of which the outline is a rectangle
            flat = np.concatenate([drawn.texels, drawn.corners["height"][..., None]], axis=2)
            assert len(torn_edges(flat, (0.0, 0.0, 89.0, 69.0))) == 0


class Twin:
    """Factors in float64 numpy, from the samples themselves."""

    def __init__(self, scene: Scene, frame: Frame, heights: NDArray[np.float32], side: int, pixels: float) -> None:
        self.frame, self.heights, self.side, self.pixels = frame, heights.astype(np.float64), side, pixels
        self.last = np.array([heights.shape[1], heights.shape[0]]) - 1

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

    def edge(self, one: tuple[int, int], other: tuple[int, int]) -> tuple[float, float]:
        """Length, and distance to the LOD eye, of the chord through an edge's ends and middle."""
        a, b = self.corner(*one), self.corner(*other)
        points = [self.at(a), self.at((a + b) / 2), self.at(b)]
        return sum(float(np.linalg.norm(q - p)) for p, q in pairwise(points)), min(
            self.away(p, q) for p, q in pairwise(points)
        )

    def away(self, p: NDArray[np.float64], q: NDArray[np.float64]) -> float:
        eye = self.frame.lod_eye()
        way = np.clip((eye - p) @ (q - p) / max((q - p) @ (q - p), 1e-30), 0, 1)
        return float(np.linalg.norm(p + way * (q - p) - eye))

    def factor(self, size: float, distance: float) -> float:
        return float(np.clip(size * self.frame.pixels_per_radian(self.frame.lod) / (distance * self.pixels), 1, 64))

    def outer(self, x: int, y: int) -> list[float]:
        """West, north, east, south."""
        return [self.factor(*edge) for edge in self.edges(x, y)]

    def edges(self, x: int, y: int) -> list[tuple[float, float]]:
        nw, ne, sw, se = (x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)
        return [self.edge(*ends) for ends in ((nw, sw), (nw, ne), (ne, se), (sw, se))]

    def inner(self, x: int, y: int) -> list[float]:
        """From west to east, from north to south."""
        eye = self.frame.eye - 0.5 + np.linalg.inv(self.frame.grid.metres) @ self.frame.lod_eye()[:2]
        under = self.at(np.clip(eye, self.corner(x, y), self.corner(x + 1, y + 1)))
        west, north, east, south = self.edges(x, y)
        nearest = min(*(d for _, d in (west, north, east, south)), np.linalg.norm(under - self.frame.lod_eye()))
        return [self.factor(max(north[0], south[0]), nearest), self.factor(max(west[0], east[0]), nearest)]


def test_factors_are_those_of_the_twin(gpu: Gpu) -> None:
    heights = hills(140, 300.0).astype(np.float32)[:100]
    with closing(Scene(gpu, heights)) as scene:
        state = scene.algorithm("tessellation", {**ROUGH, "spacing": "integer", "patch_size": 16})
        seen: set[int] = set()
        near = scene.camera(72.5, 50.5, float(heights[50, 72]) + 12)
        for k, camera in enumerate([near, *some_cameras(scene, 2, seed=4)]):
            frame = unculled(scene.frame(camera, (160, 100), exaggeration=1.0 + k))
            drawn = read(scene, frame, state)
            twin = Twin(scene, frame, heights, 16, 8.0)
            for place in np.unique(drawn.patches, axis=0).tolist():
                corners = drawn.texels[(drawn.patches == place).all(axis=1)].reshape(-1, 2)
                points = np.unique(corners, axis=0)
                low, high = twin.corner(*place), twin.corner(place[0] + 1, place[1] + 1)
                sides = [
                    points[:, 0] == low[0],
                    points[:, 1] == low[1],
                    points[:, 0] == high[0],
                    points[:, 1] == high[1],
                ]
                outer = twin.outer(*place)
                for side, factor in zip(sides, outer, strict=True):
                    found = int(side.sum()) - 1
                    assert factor - 1e-3 <= found <= factor + 1 + 1e-3
                    seen.add(found)
                inner = twin.inner(*place)
                inside = int((~np.any(sides, axis=0)).sum())
                if all(abs(f - round(f)) > 1e-3 for f in inner) and max(inner) > 1:
                    across, down = (max(2, math.ceil(f)) - 1 for f in inner)
                    assert inside == across * down
        # from the coarsest to the finest
        assert {1, 64} <= seen
        assert len(seen) > 20


def test_room_grows_and_the_picture_is_the_same(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 400, pitch=-40))
    roomy = hilly.algorithm("tessellation")
    whole = hilly.draw(frame, roomy)
    assert roomy.statistics().triangles > 4096
    tight = hilly.algorithm("tessellation", {"triangle_capacity": 64})
    first = hilly.raster(frame, hilly.record(frame, tight))
    # coarse for want of room, two triangles a patch, without a hole
    assert tight.statistics().triangles == 2 * tight.statistics().patches
    assert ((first["depth"] > 0) == (whole["depth"] > 0)).mean() > 0.97
    assert tight.incomplete()
    grown = hilly.draw(frame, tight)
    assert not tight.incomplete()
    for name in whole:
        np.testing.assert_array_equal(grown[name], whole[name])
    assert tight.statistics() == roomy.statistics()


def test_room_grows_by_itself_from_frame_to_frame(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 200, 400, pitch=-40))
    whole = hilly.draw(frame, hilly.algorithm("tessellation"))
    tight = hilly.algorithm("tessellation", {"triangle_capacity": 64})
    for _ in range(20):
        drawn = hilly.raster(frame, hilly.record(frame, tight))
    for name in whole:
        np.testing.assert_array_equal(drawn[name], whole[name])


def test_room_without_end_is_refused(hilly: Scene) -> None:
    with pytest.raises(BudgetError, match="raise pixels_per_quad"):
        hilly.algorithm("tessellation", {"triangle_capacity": 1 << 30})


def test_smaller_quads_are_more(hilly: Scene) -> None:
    frame = hilly.frame(hilly.camera(200, 330, 900, pitch=-35), (200, 150))
    triangles = []
    for pixels in (8.0, 4.0, 2.0, 1.0):
        state = hilly.algorithm("tessellation", {"pixels_per_quad": pixels, "patch_size": 16})
        hilly.draw(frame, state)
        triangles.append(state.statistics().triangles)
    ratio = np.divide(triangles[1:], triangles[:-1])
    assert ((ratio > 2.5) & (ratio < 4.5)).all()


def test_culling_never_changes_the_picture(hilly: Scene) -> None:
    state = hilly.algorithm("tessellation")
    seen = everything = 0
    for camera in some_cameras(hilly, 5, seed=9):
        frame = hilly.frame(camera)
        culled = hilly.draw(frame, state)
        seen += state.statistics().patches
        unseen = hilly.draw(unculled(frame), state)
        everything += state.statistics().patches
        for name in culled:
            np.testing.assert_array_equal(culled[name], unseen[name])
    assert seen < 0.7 * everything


def test_nothing_is_drawn_before_the_first_data_or_of_a_single_sample(gpu: Gpu) -> None:
    with closing(Scene(gpu, noise(60, 60) + 100)) as scene:
        frame = scene.frame(scene.camera(30, 30, 300, pitch=-90), load=False)
        state = scene.algorithm("tessellation")
        assert (scene.draw(frame, state)["depth"] == 0).all()
        assert state.statistics().triangles == 0
    with closing(Scene(gpu, np.full((1, 1), 5.0))) as scene:
        frame = scene.frame(scene.camera(0.5, 0.5, 100, pitch=-90))
        assert (scene.draw(frame, scene.algorithm("tessellation"))["depth"] == 0).all()


def test_patches_are_larger_over_more_data() -> None:
    def grid(width: int, height: int) -> Grid:
        return Grid(width, height, (1.0, 0.0, 0.0, 0.0, -1.0, 0.0))

    assert usual_size(grid(1025, 1025)) == 8
    assert usual_size(grid(2049, 2049)) == 8
    assert usual_size(grid(2050, 2049)) == 16
    assert usual_size(grid(10481, 19401)) == 64


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"patch_size": "12"}, "patch_size: expected a power of two from 1 to 4096, got 12"),
        ({"pixels_per_quad": "0"}, "pixels_per_quad: expected a number above 0, got 0"),
        ({"spacing": "even"}, "spacing: expected one of integer, pow2, fractional_even, fractional_odd, got 'even'"),
        ({"max_factor": "65"}, "max_factor: expected 1 to 64, got 65"),
        ({"triangle_capacity": "10"}, "triangle_capacity: expected at least 64 triangles, got 10"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("tessellation", settings)


def test_patches_without_number_are_refused(gpu: Gpu) -> None:
    with (
        closing(Scene(gpu, np.zeros((1100, 1100), np.float32))) as scene,
        pytest.raises(SettingsError, match="patch_size"),
    ):
        scene.algorithm("tessellation", {"patch_size": 1})
