"""Shapes of triangles: planted ones against what they are, those of algorithms against float64 and their statistics."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.patches import VERTEX
from lod.scene import SPACING, Scene, noise
from lod.triangles import read_triangles
from orogen.compare.triangle_quality import BIN, BINS, SLIVER, TriangleMeter, TriangleQuality
from orogen.gpu import Gpu
from orogen.lod.contract import Module, Patches, Rays
from orogen.lod.mesh import Mesh
from orogen.view.renderer import Renderer

VERTICES = np.dtype([("cell", "i4", 2), ("frac", "f4", 2), ("height", "f4"), ("unused", "f4")])


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    scene = Scene(gpu, noise(70, 80))
    yield scene
    scene.close()


@pytest.fixture(scope="module")
def meter(scene: Scene) -> TriangleMeter:
    return TriangleMeter(scene.clipmap)


class Planted:
    """Draws of vertices that are given in texels and metres; a subtexel is 1 / `per_texel` texels."""

    def __init__(self, scene: Scene, each: int = 0) -> None:
        self.scene = scene
        self.frame = scene.frame(scene.camera(40, 60, 300.0, pitch=-30.0))
        self.per_texel = 1 << self.frame.subtexel_bits
        self._layout = scene.gpu.layout("given", {0: ("VERTEX|COMPUTE", "read")})
        self.module = Module(Path(__file__).parent / "triangle_list.wgsl", self._layout, {"EACH": each})

    def draw(
        self,
        points: Sequence[Sequence[float]],
        arguments: Sequence[int],
        topology: str = "triangle-list",
        index: Mesh | None = None,
        offset: int = 0,
    ) -> Patches:
        """`points`: x, y in texels (fractions of subtexels too), height in metres."""
        gpu = self.scene.gpu
        values = np.asarray(points, np.float64)
        vertices = np.zeros(len(values), VERTICES)
        places = values[:, :2] * self.per_texel
        vertices["cell"] = np.floor(places)
        vertices["frac"] = places - np.floor(places)
        vertices["height"] = values[:, 2]
        buffer = gpu.buffer("given", vertices, "STORAGE", "test")
        group = gpu.bind("given", self._layout, {0: buffer})
        indirect = gpu.buffer("given draw", np.array(arguments, np.uint32), "INDIRECT|COPY_SRC", "test")
        return Patches(self.module, group, indirect, topology, index, offset)


def flat(*corners: tuple[float, float]) -> list[tuple[float, float, float]]:
    return [(x, y, 5.0) for x, y in corners]


def angles(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) smallest angles in degrees by the law of cosines, of (n, 3, 3) corners in metres."""
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    a, b, c = np.sort(sides, axis=1).T
    return np.degrees(np.arccos(np.clip((b * b + c * c - a * a) / (2 * b * c), -1, 1)))


def by_angle(smallest: NDArray[np.float64]) -> list[int]:
    return np.histogram(smallest, BINS, (0, 60))[0].tolist()


def test_planted_triangles_are_what_they_are(scene: Scene, meter: TriangleMeter) -> None:
    planted = Planted(scene)
    fine = 1 / planted.per_texel
    triangles = [
        flat((10, 10), (20, 10), (10, 20)),
        flat((10, 10), (20, 10), (15, 10 + 5 * math.sqrt(3))),
        flat((10, 10), (50, 10), (10, 12)),
        # one corner twice
        flat((10, 10), (20, 10), (20, 10)),
        flat((10, 10), (20, 10), (10, 10)),
        # on a line, evenly and not
        flat((10, 10), (20, 15), (30, 20)),
        [(10, 10, 0.0), (20, 10, 30.0), (40, 10, 90.0)],
        # upright: without area on the map, with area in space
        [(10, 10, 0.0), (20, 10, 0.0), (10, 10, 100.0)],
        [(10, 10, 0.0), (20, 10, 77.0), (40, 10, 90.0)],
        # thinner than the rounding of its length, but not without area
        flat((0, 0), (400_000, 0), (200_000, fine)),
        # where steepness decides: 45 degrees on the map
        [(10, 10, 0.0), (20, 10, 0.0), (10, 20, 100.0 / math.tan(math.radians(8)))],
    ]
    quality = meter.measure([planted.draw(list(chain(*triangles)), [3 * len(triangles), 1, 0, 0])], scene.view)
    assert quality.degenerate == 4
    corners = np.array([t for n, t in enumerate(triangles) if n not in (3, 4, 5, 6)]) * [SPACING, SPACING, 1]
    smallest = angles(corners)
    assert quality.angles == tuple(by_angle(np.where(np.isclose(smallest, 45), 45.1, smallest)))
    assert quality.mean_angle == pytest.approx(smallest.mean(), abs=2e-3)
    assert quality.slivers == np.count_nonzero(smallest < SLIVER) == 3
    assert quality.triangles == len(triangles)


def test_fractions_of_subtexels_count(scene: Scene, meter: TriangleMeter) -> None:
    """On different fractions an area is only known to rounding; none is degenerate that has some."""
    planted = Planted(scene)
    fine = 1 / planted.per_texel
    wide = flat((10, 10), (10 + 0.5 * fine, 10), (10, 10 + 0.25 * fine))
    line = flat((10.0, 10.0), (10 + 0.25 * fine, 10 + 0.25 * fine), (10 + 0.75 * fine, 10 + 0.75 * fine))
    quality = meter.measure([planted.draw(wide + line, [6, 1, 0, 0])], scene.view)
    assert (quality.degenerate, quality.triangles) == (1, 2)
    assert quality.mean_angle == pytest.approx(math.degrees(math.atan(0.5)), abs=2e-3)


def test_every_kind_of_draw(scene: Scene, meter: TriangleMeter) -> None:
    """Lists, strips and indexed meshes, instances, first vertices and indices, several draws of one buffer, none."""
    each = 12
    planted = Planted(scene, each)
    rng = np.random.default_rng(3)
    points = np.concatenate([rng.uniform(5, 60, (3 * each, 2)), rng.uniform(0, 300, (3 * each, 1))], axis=1)
    # on whole subtexels, as the numbers below are
    points[:, :2] = np.floor(points[:, :2] * planted.per_texel) / planted.per_texel
    metres = points.astype(np.float32).astype(np.float64) * [SPACING, SPACING, 1]
    lists = [rng.permuted(np.tile(np.arange(8), (4, 1)), axis=1)[:, :3] for _ in range(2)]
    mesh = Mesh(scene.gpu, lists, "test")
    strip = planted.draw(points, [9, 2, 1, 0], "triangle-strip")
    whole = planted.draw(points, [6, 3, 3, 0])
    first, second = mesh.parts
    words = [
        0,
        0,
        0,
        0,
        0,
        first.index_count,
        2,
        first.first_index,
        1,
        0,
        second.index_count,
        1,
        second.first_index,
        4,
        0,
    ]
    several = [planted.draw(points, words, index=mesh, offset=20 * n) for n in range(3)]
    # draws that share all but their arguments
    several = [Patches(s.module, several[0].group, several[0].indirect, s.topology, mesh, s.offset) for s in several]
    numbers = {
        "strip": [[i * each + 1 + t + k for k in range(3)] for i in range(2) for t in range(7)],
        "list": [[i * each + 3 + 3 * t + k for k in range(3)] for i in range(3) for t in range(2)],
        "mesh": [*(lists[0] + 1).tolist(), *(lists[0] + 1 + each).tolist(), *(lists[1] + 4).tolist()],
    }
    expected = {name: angles(metres[np.array(part)]) for name, part in numbers.items()}
    rays = Rays(Module(Path("nothing.wgsl")))
    for name, draws in (("strip", [strip]), ("list", [whole, rays]), ("mesh", several)):
        assert meter.measure(draws, scene.view).angles == tuple(by_angle(expected[name])), name
    together = meter.measure([several[1], strip, several[2], whole, several[0]], scene.view)
    assert together.degenerate == 0
    assert together.angles == tuple(by_angle(np.concatenate(list(expected.values()))))
    nothing = meter.measure([rays, several[0]], scene.view)
    assert nothing.triangles == 0
    assert nothing.record() == {"shapes": None, "angles": None}


def test_patches_of_an_algorithm(scene: Scene, meter: TriangleMeter) -> None:
    """udlod's triangles against float64, those that morphing closes included."""
    frame = scene.frame(scene.camera(40, 66, 120.0, pitch=-20.0))
    state = scene.algorithm("udlod", {"pixels_per_quad": 6})
    draws = scene.record(frame, state)
    assert not state.incomplete()
    quality = meter.measure(draws, scene.view)
    assert quality.triangles == state.statistics().triangles
    corners = np.concatenate([part.reshape(-1, 3) for part in read_triangles(scene, frame, state)])
    assert corners.dtype == VERTEX
    # offsets in subtexels are exact here, camera-relative metres are not
    metres = np.concatenate([corners["offset"] / (1 << frame.subtexel_bits) * SPACING, corners["height"][..., None]], 2)
    metres = metres.astype(np.float64)
    same = (metres == np.roll(metres, 1, axis=1)).all(axis=2).any(axis=1)
    assert 0 < np.count_nonzero(same) < len(same)
    assert quality.degenerate == pytest.approx(np.count_nonzero(same), abs=0.002 * len(same))
    smallest = angles(metres[~same])
    assert quality.mean_angle == pytest.approx(smallest.mean(), abs=0.05)
    difference = np.abs(np.array(quality.angles) - by_angle(smallest + 1e-3))
    assert difference.sum() <= 0.004 * len(same)


def test_a_renderer_hands_its_draws_over(scene: Scene) -> None:
    """What was counted is what was drawn: of every number of triangles, those of all draws."""
    renderer = Renderer(scene.gpu, scene.pyramid, name="geomipmap")
    try:
        assert renderer.draws == ()
        meter = TriangleMeter(renderer.clipmap)
        for name in ("geomipmap", "pgm", "raycast", "chunked_lod"):
            renderer.use(name)
            assert renderer.draws == ()
            picture = renderer.render(scene.camera(40, 66, 120.0, pitch=-20.0), (64, 40))
            quality = meter.measure(renderer.draws, renderer.view)
            assert quality.triangles == picture.statistics.triangles
            assert (quality.triangles > 0) == (name != "raycast")
            again = meter.measure(renderer.draws, renderer.view)
            assert again == quality or (math.isnan(again.mean_angle) and name == "raycast")
    finally:
        renderer.close()


def test_records() -> None:
    quality = TriangleQuality(10, (5, 3, *[0] * 6, 2, 20, 0, 0), 38.25)
    assert quality.record() == {
        "shapes": {
            "degenerate": 10, "slivers": 8, "degenerate_share": 0.25, "sliver_share": 0.2, "smallest_angle": 38.25,
        },
        "angles": {f"{BIN * n:02d}": count for n, count in enumerate(quality.angles)},
    }  # fmt: skip
    assert TriangleQuality(3, (0,) * BINS, math.nan).record()["shapes"]["smallest_angle"] is None
