"""bdam: patches that fit bit for bit at all levels, bounds against the true surface, whole meshes, its store."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from lod.restricted import assert_whole, some_cameras, unculled
from lod.scene import Scene, noise
from lod.triangles import read_triangles
from oracle.landscapes import hills
from orogen.compare.truth import TrueSurface
from orogen.errors import OutputError, SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import make_settings, mesh
from orogen.lod.bdam import Bdam, Settings
from orogen.lod.bdam.build import Builder
from orogen.lod.bdam.choose import DiamondFrame
from orogen.lod.bdam.diamonds import Diamonds, code, place
from orogen.lod.bdam.meshes import CLUSTER, View
from orogen.lod.bdam.pages import triangles_of
from orogen.lod.bdam.patches import Patches
from orogen.lod.bdam.store import Draft, open_library
from orogen.lod.contract import Patches as Draw
from orogen.pyramid.open import open_pyramid
from orogen.source.open import open_height
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.settings import ClipmapSettings

Floats = NDArray[np.float64]
FINEST = -2
"""Level down to which patches are looked at one by one."""


def cliffs() -> NDArray[np.float32]:
    ground = hills(75, 500.0).astype(np.float32)[:50]
    ground[27:33] += 150
    return ground


def voids() -> NDArray[np.float32]:
    ground = noise(50, 70) + hills(70, 300.0).astype(np.float32)[:50]
    ground[20:35, 20:45] = np.nan
    ground[rng(2).random(ground.shape) < 0.01] = np.nan
    ground[:, -2:] = np.nan
    return ground


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


TERRAINS: dict[str, Callable[[], NDArray[np.float32]]] = {
    "noise": lambda: noise(43, 70),
    "cliffs": cliffs,
    "voids": voids,
    "tiny": lambda: noise(2, 3),
    "a strip": lambda: noise(150, 5),
    "a power of two": lambda: noise(33, 33),
}


class Terrain(Scene):
    """A scene with the patches of its heights."""

    def __init__(self, gpu: Gpu, heights: NDArray[np.float32], **options: Any) -> None:
        super().__init__(gpu, heights, **options)
        self.heights = heights
        self.made = self.bdam(patch_triangles=64)

    def bdam(self, **settings: Any) -> Bdam:
        return Bdam(self.clipmap, make_settings("bdam", settings))

    def close(self) -> None:
        self.made.pages.close()
        super().close()

    @property
    def patches(self) -> Patches:
        return self.made.patches

    @property
    def diamonds(self) -> Diamonds:
        return self.made.patches.diamonds

    @cached_property
    def all_patches(self) -> list[tuple[int, int, int, int, Floats]]:
        """Level, cx, cy, side of patches down to FINEST, and (triangles, 3, 3) their corners: column, row, height."""
        found = []
        for level in range(self.diamonds.top, FINEST - 1, -1):
            for side in (0, 1):
                cx, cy = self.diamonds.over_raster(level)
                there = self.diamonds.exists(level, cx, cy, np.full(cx.size, side))
                names = [(x, y, side) for x, y in zip(cx[there].tolist(), cy[there].tolist(), strict=True)]
                codes = [code(level, *arrays(*name))[0] for name in names]
                found += [
                    (level, *n, self.read(self.patches(int(c)), level, *n)) for n, c in zip(names, codes, strict=True)
                ]
        return found

    def read(self, page: NDArray[np.uint32], level: int, cx: int, cy: int, side: int) -> Floats:
        first = int(page[1])
        vertices = page[2:first].reshape(-1, 3)
        low = self.diamonds.corners(level, *arrays(cx, cy, side))[0].min(axis=0)
        at = (low + vertices[:, :2].astype(np.int64) * self.diamonds.unit(level)) / 2**self.diamonds.bits
        heights = np.ascontiguousarray(vertices[:, 2]).view(np.float32)
        triangles = triangles_of(page[first:])
        assert len(triangles) == page[0]
        return np.column_stack([at, heights.astype(np.float64)])[triangles]


def arrays(*values: int) -> tuple[NDArray[np.int64], ...]:
    return tuple(np.array([value]) for value in values)


@pytest.fixture(scope="module", params=list(TERRAINS))
def terrain(request: pytest.FixtureRequest, gpu: Gpu) -> Iterator[Terrain]:
    with closing(Terrain(gpu, TERRAINS[request.param]())) as scene:
        yield scene


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Terrain]:
    with closing(Terrain(gpu, hills(170, 500.0).astype(np.float32)[:130])) as scene:
        yield scene


def areas(corners: Floats) -> Floats:
    """Of triangles on the ground, signed."""
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0])[:, :2].T, (corners[:, 2] - corners[:, 0])[:, :2].T
    return (ax * by - bx * ay) / 2


# -- the bintree -----------------------------------------------------------------------------------------------------


def test_patches_halve_from_level_to_level_and_fill_the_raster(terrain: Terrain) -> None:
    raster = np.prod(np.array(terrain.heights.shape) - 1.0)
    filled: dict[int, float] = defaultdict(float)
    for level, *name, corners in terrain.all_patches:
        signed = areas(corners)
        # all the same way round: nothing is folded over
        assert (signed > 0).all()
        filled[level] += signed.sum()
        outline = terrain.diamonds.corners(level, *arrays(*name))[0] / 2**terrain.diamonds.bits
        whole = areas(np.pad(outline, ((0, 0), (0, 1)))[None])[0]
        assert whole == terrain.diamonds.n**2 * 2.0 ** (level - 1)
        # within its outline: on the inner side of all three lines
        at = corners[..., :2].reshape(-1, 1, 2) - outline
        along = np.roll(outline, -1, axis=0) - outline
        assert (along[:, 0] * at[..., 1] - along[:, 1] * at[..., 0] >= 0).all()
    assert set(filled) == set(range(FINEST, terrain.diamonds.top + 1))
    assert all(area == raster for area in filled.values())


def test_vertices_lie_on_the_true_surface_and_pages_are_small(terrain: Terrain) -> None:
    surface = TrueSurface(terrain.heights)
    for level, *_, corners in terrain.all_patches:
        assert 0 < len(corners) <= 64
        tx, ty = corners.reshape(-1, 3)[:, :2].T + 0.5
        there = surface.exists(tx, ty)
        np.testing.assert_allclose(corners[..., 2].ravel()[there], surface.height(tx, ty)[there], rtol=1e-6, atol=1e-5)
        if level >= 0:
            assert (corners[..., :2] % 1 == 0).all()


def test_adjoining_patches_have_the_same_vertices_at_every_pair_of_levels(terrain: Terrain) -> None:
    """Every edge of the bintree has one chain of vertices, bit for bit, as a hypotenuse and, a level up, as a leg."""
    chains: dict[tuple[Any, ...], set[bytes]] = defaultdict(set)
    uses: dict[tuple[Any, ...], set[tuple[int, bool]]] = defaultdict(set)
    for level, *name, corners in terrain.all_patches:
        vertices = np.unique(corners.reshape(-1, 3), axis=0)
        a, b, c = terrain.diamonds.corners(level, *arrays(*name))[0] / 2**terrain.diamonds.bits
        for p, q, hypotenuse in ((a, b, True), (b, c, False), (c, a, False)):
            p, q = sorted([p.tolist(), q.tolist()])
            (px, py), (qx, qy) = p, q
            on = (qx - px) * (vertices[:, 1] - py) == (qy - py) * (vertices[:, 0] - px)
            chains[(*p, *q)].add(vertices[on].tobytes())
            uses[(*p, *q)].add((level, hypotenuse))
    assert all(len(found) == 1 for found in chains.values())
    if terrain.diamonds.top > 1:
        assert sum(len(found) > 1 for found in uses.values()) > 20
    assert all(len({level + hypotenuse for level, hypotenuse in found}) == 1 for found in uses.values())


def test_children_meet_where_their_diamond_has_its_centre(hilly: Terrain) -> None:
    diamonds = hilly.diamonds
    for level in range(FINEST, diamonds.top + 1):
        cx, cy = diamonds.over_raster(level)
        x, y, side = diamonds.children(level, cx, cy)
        corners = diamonds.corners(level - 1, x.ravel(), y.ravel(), side.ravel()).reshape(-1, 4, 3, 2)
        centre = np.stack([cx, cy], axis=1)[:, None] * diamonds.half(level)
        assert (corners[:, :, 2] == centre).all()
        # boxes hold those of what a split makes; ranges and errors follow
        first, last = diamonds.box(level, cx, cy)
        for k in range(4):
            there = diamonds.exists(level - 1, x[:, k], y[:, k], side[:, k])
            inner_first, inner_last = diamonds.box(level - 1, x[there, k], y[there, k])
            assert (first[there] <= inner_first).all()
            assert (inner_last <= last[there]).all()
            errors = hilly.patches.errors(level - 1, x[there, k], y[there, k])
            assert (errors <= hilly.patches.errors(level, cx[there], cy[there])).all()


def test_codes_name_patches() -> None:
    for name in ((-16, 5, (1 << 28) - 1, 1), (30, (1 << 28) - 2, 1, 0), (0, 0, 0, 0)):
        assert place(int(code(name[0], *arrays(*name[1:]))[0])) == name


# -- errors ----------------------------------------------------------------------------------------------------------


def on_triangles(corners: Floats, count: int, seed: int) -> Floats:
    """(n, 3) points on triangles: in their corners, the middles of their sides, and `count` more in each."""
    shares = rng(seed).dirichlet(np.full(3, 0.7), (len(corners), count))
    fixed = np.array([[1, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
    shares = np.concatenate([np.broadcast_to(fixed, (len(corners), 4, 3)), shares], axis=1)
    return np.einsum("tps,tsd->tpd", shares, corners).reshape(-1, 3)


def test_no_point_of_a_patch_is_further_off_than_its_bound(terrain: Terrain) -> None:
    surface = TrueSurface(terrain.heights)
    closest: dict[int, float] = defaultdict(float)
    for level, cx, cy, _, corners in terrain.all_patches:
        points = on_triangles(corners, 12, cx)
        there = surface.exists(points[:, 0] + 0.5, points[:, 1] + 0.5)
        off = np.abs(points[:, 2] - surface.height(points[:, 0] + 0.5, points[:, 1] + 0.5))[there]
        bound = float(terrain.patches.errors(level, *arrays(cx, cy))[0])
        assert off.max(initial=0) <= bound * (1 + 1e-6) + 1e-4
        closest[level] = max(closest[level], off.max(initial=0) / max(bound, 1e-9))
    # not by far: it is measured, not estimated
    assert all(share > 0.5 for share in closest.values())


def test_errors_of_patches_are_exact() -> None:
    """One triangle over a saddle and a spike, where the largest difference is known."""
    from orogen.lod.bdam.kernels import deviation

    page = np.array([1, 11, 0, 0, 0, 4, 0, 0, 0, 4, 0, 0 | 1 << 10 | 2 << 20], np.uint32)
    flat = np.zeros((5, 5), np.float32)
    nothing = np.zeros((0, 0), bool)
    assert deviation(page, 0, 0, flat, nothing, 0, 0) == 0
    spike = flat.copy()
    spike[1, 2] = 7
    assert deviation(page, 0, 0, spike, nothing, 0, 0) == 7
    # beyond its longest side: the edge runs through the middle of the cell, a quarter as high
    spike = flat.copy()
    spike[3, 2] = 8
    assert deviation(page, 0, 0, spike, nothing, 0, 0) == 2
    # elsewhere in the window, and left out where the ground is void
    assert deviation(page, 20, 10, spike, nothing, 20, 10) == 2
    assert deviation(page, 20, 10, spike, nothing, 0, 0) == 0
    valid = np.ones((5, 5), bool)
    valid[3, 2] = False
    assert deviation(page, 0, 0, spike, valid, 0, 0) == 0


@pytest.mark.parametrize("curvature", [False, True])
def test_screen_space_errors_never_grow_on_the_way_down(hilly: Terrain, curvature: bool) -> None:
    """What is split is part of what is split: `choose` relies on it, and both bounds and neighbours do."""
    diamonds = hilly.diamonds
    for camera in some_cameras(hilly, 6, 5):
        frame = hilly.frame(camera, load=False, curvature=curvature, exaggeration=1.7)
        seen = DiamondFrame(hilly.patches, frame, 1.0)
        for level in range(FINEST, diamonds.top + 1):
            cx, cy = diamonds.over_raster(level)
            x, y, side = diamonds.children(level, cx, cy)
            own = np.repeat(seen.shares(level, cx, cy), 4)
            x, y, side = x.ravel(), y.ravel(), side.ravel()
            there = diamonds.exists(level - 1, x, y, side)
            assert (seen.shares(level - 1, x[there], y[there]) <= own[there] * (1 + 1e-12)).all()


def drawn_triangles(scene: Terrain, frame: Frame, state: View) -> NDArray[Any]:
    """(triangles, 3) corners; clusters have no list of vertices, so one is made for the reader."""
    (draw,) = scene.record(frame, state)
    assert isinstance(draw, Draw)
    clusters = state.statistics().triangles // CLUSTER
    words = np.array([3 * CLUSTER, clusters, 0, 0, 0], np.uint32)
    index = mesh.Mesh(scene.gpu, [np.arange(3 * CLUSTER).reshape(-1, 3)], "test")
    draw = replace(draw, index=index, indirect=scene.gpu.buffer("arguments", words, "STORAGE|COPY_SRC", "test"))

    class Recorded:
        def record(self, *_: Any) -> list[Draw]:
            return [draw]

    (corners,) = read_triangles(scene, frame, Recorded())  # type: ignore[arg-type]
    return corners.reshape(-1, 3)


def with_area(corners: NDArray[Any]) -> NDArray[Any]:
    a, b, c = corners["position"].swapaxes(0, 1)
    return corners[~((a == b).all(1) | (b == c).all(1) | (c == a).all(1))]


def settled(state: View, frame: Frame) -> None:
    state.wants(frame)
    state._pages.settle()


@pytest.mark.parametrize("pixels", [1.0, 6.0])
def test_surfaces_are_whole_and_within_the_bound_on_screen(hilly: Terrain, pixels: float) -> None:
    surface = TrueSurface(hilly.heights)
    algorithm = hilly.bdam(pixels=pixels, patch_triangles=64)
    state = algorithm.view()
    assert isinstance(state, View)
    levels = set()
    for camera in some_cameras(hilly, 5, int(pixels)):
        frame = unculled(hilly.frame(camera, (200, 120), load=False))
        settled(state, frame)
        corners = with_area(drawn_triangles(hilly, frame, state))
        assert_whole(corners["position"], frame)
        levels |= set(corners["tile_level"].ravel().tolist())
        at = (corners["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits - 0.5
        points = on_triangles(np.concatenate([at, corners["height"][..., None]], axis=-1), 3, 1)
        off = np.abs(points[:, 2] - surface.height(points[:, 0] + 0.5, points[:, 1] + 0.5))
        flat = (points[:, :2] + 0.5 - frame.eye) @ frame.grid.metres.T
        away = np.sqrt((flat**2).sum(axis=1) + (points[:, 2] - frame.camera.z) ** 2)
        share = off * frame.pixels_per_radian(frame.lod) / np.maximum(away, frame.lod.near) / pixels
        # float32 heights are not closer than this
        assert (share <= 1 + 1e-3 / away).all()
        assert share.max() > 0.3
    assert len(levels) > 6
    algorithm.pages.close()


# -- in the large ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("culled", [False, True])
def test_a_flight_is_whole_at_every_frame_whatever_is_loaded(hilly: Terrain, culled: bool) -> None:
    algorithm = hilly.bdam(patch_triangles=64)
    state, other = algorithm.view(), algorithm.view()
    assert isinstance(state, View)
    assert isinstance(other, View)
    pages = state._pages
    counts, loaded = [], []
    for step in range(12):
        camera = hilly.camera(30 + 7 * step, 60 + 2 * step, 800 - 22 * step, pitch=-30, heading=40 + 5 * step)
        frame = hilly.frame(camera, (160, 100), load=False)
        frame = frame if culled else unculled(frame)
        state.wants(frame)
        # a few pages for each frame, as they come
        pages._loader.wait(5.0)
        loaded.append(pages.pump(pages.page_bytes * 20) > 0)
        if not pages.resident:
            continue
        corners = with_area(drawn_triangles(hilly, frame, state))
        counts.append(len(corners))
        if not culled and len(corners):
            assert_whole(corners["position"], frame)
    assert len(set(counts)) > 5
    assert any(loaded)
    # however one got here the picture is the same
    settled(state, frame)
    end = hilly.raster(frame, hilly.record(frame, state))
    fresh = hilly.bdam(patch_triangles=64)
    anew = fresh.view()
    assert isinstance(anew, View)
    settled(anew, frame)
    for name, values in hilly.raster(frame, hilly.record(frame, anew)).items():
        np.testing.assert_array_equal(end[name], values)
    for made in (algorithm, fresh):
        made.pages.close()


def test_little_memory_means_coarser_patches(hilly: Terrain) -> None:
    camera = hilly.camera(80, 70, 600, pitch=-50)
    drawn = {}
    for memory in (1 << 20, 64 << 20):
        algorithm = hilly.bdam(pixels=0.1, memory=memory)
        state = algorithm.view()
        assert isinstance(state, View)
        frame = unculled(hilly.frame(camera, (160, 100)))
        settled(state, frame)
        corners = with_area(drawn_triangles(hilly, frame, state))
        assert_whole(corners["position"], frame)
        drawn[memory] = len(corners)
        algorithm.pages.close()
    assert 1000 < drawn[1 << 20] < drawn[64 << 20]


def test_fewer_pixels_take_more_triangles(hilly: Terrain) -> None:
    frame = hilly.frame(hilly.camera(80, 120, 560, pitch=-35), (160, 100))
    triangles = []
    for pixels in (4.0, 2.0, 1.0, 0.5):
        algorithm = hilly.bdam(pixels=pixels)
        state = algorithm.view()
        assert isinstance(state, View)
        settled(state, frame)
        hilly.draw(frame, state)
        triangles.append(state.statistics().triangles)
        algorithm.pages.close()
    assert triangles == sorted(triangles)
    assert triangles[-1] > 2 * triangles[0]


def test_what_cannot_be_seen_is_not_drawn(hilly: Terrain) -> None:
    frame = hilly.frame(hilly.camera(80, 120, 560, pitch=-35), (160, 100))
    algorithm = hilly.bdam(pixels=0.5)
    state = algorithm.view()
    assert isinstance(state, View)
    settled(state, unculled(frame))
    depth = hilly.draw(frame, state)["depth"]
    seen = state.statistics().patches
    np.testing.assert_array_equal(depth, hilly.draw(unculled(frame), state)["depth"])
    assert 1.5 * seen < state.statistics().patches
    algorithm.pages.close()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (2, 2), (17, 17), (18, 40)])
def test_rasters_of_any_size(gpu: Gpu, shape: tuple[int, int]) -> None:
    with closing(Terrain(gpu, noise(*shape))) as scene:
        state = scene.bdam().view()
        assert isinstance(state, View)
        camera = scene.camera(shape[1] / 2, shape[0] / 2, 400, pitch=-90)
        frame = unculled(scene.frame(camera, (40, 40)))
        settled(state, frame)
        if min(shape) == 1:
            assert (scene.draw(frame, state)["depth"] == 0).all()
            assert state.statistics().patches == 0
            return
        corners = with_area(drawn_triangles(scene, frame, state))
        assert_whole(corners["position"], frame)


def test_work_in_parallel_gives_the_same_patches(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    ground = hills(150, 600.0).astype(np.float32)[:190]
    monkeypatch.setattr("orogen.lod.bdam.build.BLOCK", 64)
    made = []
    with closing(Scene(gpu, ground)) as scene:
        for threads in (1, 3):
            monkeypatch.setattr("orogen.lod.bdam.build.threads", lambda threads=threads: threads)
            algorithm = Bdam(scene.clipmap, Settings())
            made.append(algorithm.patches._library)
            algorithm.pages.close()
    one, several = made
    assert len(one.levels) == 8
    for a, b in zip(one.levels, several.levels, strict=True):
        np.testing.assert_array_equal(a.words, b.words)
        np.testing.assert_array_equal(a.starts, b.starts)
        np.testing.assert_array_equal(a.errors, b.errors)
    np.testing.assert_array_equal(one.cells, several.cells)


# -- the store -------------------------------------------------------------------------------------------------------


@pytest.fixture
def clipmap(gpu: Gpu, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Clipmap]:
    """Of a file, whose patches go to a cache folder of the test's own."""
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    heights = hills(90, 300.0).astype(np.float32)[:70]
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=90, height=70, count=1, dtype="float32", crs="EPSG:32633",
        transform=rasterio.Affine(10.0, 0, 0, 0, -10.0, 0),
    ) as file:  # fmt: skip
        file.write(heights, 1)
    with open_pyramid(open_height(tmp_path / "dem.tif")) as pyramid:
        result = Clipmap(gpu, pyramid, None, ClipmapSettings(memory=24 << 20))
        yield result
        result.close()


def opened(clipmap: Clipmap, **settings: Any) -> Bdam:
    algorithm = Bdam(clipmap, Settings(**settings))
    algorithm.pages.close()
    return algorithm


def stores(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache").glob("*bdam*"))


def never(self: Builder) -> None:
    raise AssertionError("is built again")


def test_a_store_is_used_again(clipmap: Clipmap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = opened(clipmap)
    (folder,) = stores(tmp_path)
    assert folder.name.startswith("dem-bdam-")
    monkeypatch.setattr(Builder, "run", never)
    again = opened(clipmap)
    for a, b in zip(first.patches._library.levels, again.patches._library.levels, strict=True):
        np.testing.assert_array_equal(a.words, b.words)
        np.testing.assert_array_equal(a.errors, b.errors)
    # the threshold has no part in it, the size of patches has
    opened(clipmap, pixels=5.0)
    with pytest.raises(AssertionError, match="is built again"):
        opened(clipmap, patch_triangles=64)


@pytest.mark.parametrize("name", ["2.pages", "1.starts.npy", "cells.npy", "patches.json"])
def test_a_damaged_store_is_made_anew(
    clipmap: Clipmap, tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    whole = opened(clipmap).patches._library
    (folder,) = stores(tmp_path)
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: len(content) // 2])
    with caplog.at_level(logging.WARNING, "orogen"):
        anew = opened(clipmap).patches._library
    assert "is damaged and made anew" in caplog.text
    assert (folder / name).read_bytes() == content
    np.testing.assert_array_equal(np.asarray(whole.cells), np.asarray(anew.cells))
    assert stores(tmp_path) == [folder]


def test_a_build_that_ends_early_leaves_nothing(
    clipmap: Clipmap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Builder._level

    def stops(self: Builder, level: int, *rest: Any) -> Any:
        if level == 3:
            raise KeyboardInterrupt
        return whole(self, level, *rest)

    monkeypatch.setattr(Builder, "_level", stops)
    with pytest.raises(KeyboardInterrupt):
        opened(clipmap)
    assert stores(tmp_path) == []
    monkeypatch.undo()
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    # what a killed one leaves is tidied away, and not used
    (tmp_path / "cache" / "dem-bdam-0.building-1").mkdir()
    opened(clipmap)
    (folder,) = stores(tmp_path)
    assert (folder / "patches.json").exists()


def test_a_folder_that_cannot_be_written_is_named(clipmap: Clipmap, tmp_path: Path) -> None:
    def fails(draft: Draft) -> None:
        raise OSError("no space left on device")

    with pytest.raises(OutputError, match=r"patches of dem\.tif cannot be written there \(no space left"):
        open_library(clipmap.heights.pyramid.source, 16, fails, clipmap)
    assert stores(tmp_path) == []


def test_missing_packages_are_named(hilly: Terrain, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "numba", None)
    with pytest.raises(SettingsError, match="bdam: expected the packages dask and numba"):
        hilly.bdam()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"pixels": "0"}, "pixels: expected a number of pixels above 0, got 0"),
        ({"pixels": "nan"}, "pixels: expected a number of pixels above 0, got nan"),
        ({"patch_triangles": "100"}, "patch_triangles: expected 64, 256 or 1024, got 100"),
        ({"memory": "5"}, "memory: expected at least 1048576 bytes"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("bdam", settings)
