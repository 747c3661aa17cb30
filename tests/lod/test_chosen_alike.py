"""Patches chosen on the CPU: compiled or in numpy, what the GPU is given is the same."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.restricted import some_cameras
from lod.scene import Scene, noise
from oracle.landscapes import hills
from orogen.frame import Frame
from orogen.gpu import Buffer, Gpu
from orogen.lod import algorithm, make_settings
from orogen.lod.contract import AlgorithmView
from orogen.lod.quadtree import Leaves, Table, kernels
from orogen.lod.resident import Residents, drawable, number_of, with_ancestors

ALGORITHMS: dict[str, dict[str, Any]] = {
    "brute": {},
    "geomipmap": {"block_size": 8, "max_error": 4.0},
    "geomipmap jumping": {"block_size": 16, "morph": False},
    "frostbite": {"pixels_per_quad": 6.0},
    "cdlod": {"grid_size": 8, "quads_per_sample": 2, "pixels_per_quad": 6.0},
    "seamless_patches": {"pixels_per_quad": 6.0, "quads_per_sample": 8},
    "chunked_lod": {"chunk_size": 16},
    "chunked_lod grids": {"chunk_size": 16, "preprocessed": False},
    "hqterrain": {"tile_size": 16},
    "bdam": {"patch_triangles": 64},
}
CHANGES: list[dict[str, Any]] = [{}, {"exaggeration": 1.7, "curvature": True}, {"frozen": True}]


@pytest.fixture(scope="module")
def scene(gpu: Gpu) -> Iterator[Scene]:
    heights = hills(230, 400.0).astype(np.float32)[:180] + noise(180, 230, 6.0)
    metres = np.array([[9.0, 2.0], [1.0, -11.0]])
    # coarser data from half a node on
    with closing(Scene(gpu, heights, metres=metres, view_distance=0.5)) as terrain:
        yield terrain


@contextmanager
def no_numba() -> Iterator[None]:
    """As where it is not installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "numba", None)
        for name in [name for name in sys.modules if name.startswith("orogen.lod.")]:
            if name.endswith("kernels") or name.endswith(".walk"):
                patch.delitem(sys.modules, name)
        kernels.cache_clear()
        yield
        assert kernels() is None
    kernels.cache_clear()


def given(scene: Scene, frame: Frame, state: AlgorithmView) -> dict[str, NDArray[np.uint32]]:
    """All words that a frame writes, by buffer, but those of pages."""
    found: dict[str, list[bytes]] = {}
    write = Gpu.write

    def noted(self: Gpu, buffer: Buffer, data: Any, offset: int = 0) -> None:
        found.setdefault(buffer.label, []).append(bytes(np.ascontiguousarray(data).data))
        write(self, buffer, data, offset)

    scene.view.update(frame)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Gpu, "write", noted)
        state.record(scene.gpu.encoder("record"), scene.timer, frame, scene.view)
    found.pop("hqterrain", None)
    return {label: np.frombuffer(b"".join(parts), np.uint32) for label, parts in found.items()}


@pytest.mark.parametrize("name", ALGORITHMS)
def test_compiled_or_not_the_same_is_drawn(scene: Scene, name: str) -> None:
    pytest.importorskip("numba")
    kind = name.split()[0]
    made = algorithm(kind)(scene.clipmap, make_settings(kind, ALGORITHMS[name]))
    words = 0
    for camera, changes in zip(some_cameras(scene, 3, seed=4, lowest=500.0), CHANGES, strict=True):
        frozen = {"lod_camera": camera.moved(x=camera.x + 90, z=camera.z + 70, heading=camera.heading + 9)}
        frame = scene.frame(camera, (160, 100), **(frozen if "frozen" in changes else changes))
        state = made.view()
        state.wants(frame)
        if made.pages:
            made.pages.settle()
        compiled = given(scene, frame, state)
        with no_numba():
            plain = given(scene, frame, made.view())
        assert compiled.keys() == plain.keys()
        for label, ours in compiled.items():
            theirs = plain[label]
            assert ours.shape == theirs.shape, label
            # numbers with a fraction may differ by their rounding
            differ = ours != theirs
            np.testing.assert_allclose(ours[differ].view(np.float32), theirs[differ].view(np.float32), rtol=1e-5)
            words += ours.size
    assert words > 100
    if made.pages:
        made.pages.close()


class Pages:
    """A page store with these pages."""

    def __init__(self, keys: list[tuple[int, int, int]]) -> None:
        self.version = 0
        self.resident = {key: slot for slot, key in enumerate(keys)}


@pytest.mark.parametrize("seed", range(6))
def test_the_nearest_resident_patches_take_the_place_of_others(seed: int) -> None:
    """Against a walk of single patches."""
    random, top = np.random.default_rng(seed), 4
    listed: set[tuple[int, int, int]] = set()

    def divide(level: int, x: int, y: int) -> None:
        if level and random.random() < 0.75:
            for k in range(4):
                divide(level - 1, 2 * x + k % 2, 2 * y + k // 2)
        else:
            listed.add((level, x, y))

    divide(top, 0, 0)
    leaves = Leaves(*(np.array(part, np.int64) for part in zip(*sorted(listed), strict=True)))
    every = with_ancestors(leaves, top)
    assert every == sorted(every, reverse=True)
    assert {key for key in every if key in listed} == listed
    kept = [key for key in every if random.random() < 0.6 + 0.1 * seed]
    pages: Any = Pages(kept)
    residents = Residents(pages, lambda key: int(number_of(*key)))
    assert residents.update()
    assert not residents.update()
    expected = set()
    for leaf in listed:
        above = [(leaf[0] + k, leaf[1] >> k, leaf[2] >> k) for k in range(top - leaf[0] + 1)]
        expected.update([key for key in above if key in pages.resident][:1])
    expected = {
        key for key in expected
        if not any((key[0] + k, key[1] >> k, key[2] >> k) in expected for k in range(1, top - key[0] + 1))
    }  # fmt: skip
    chosen, places = drawable(leaves, residents)
    found = list(zip(*(part.tolist() for part in chosen), strict=True))
    assert found == sorted(expected)
    assert [residents.keys[place] for place in places.tolist()] == found
    assert residents.slots[places].tolist() == [pages.resident[key] for key in found]


def test_tables_give_every_level_its_numbers() -> None:
    random = np.random.default_rng(1)
    shared, last = (random.random((rows, columns, 2)).astype(np.float32) for rows, columns in ((6, 5), (3, 3)))
    table = Table.of([shared, shared, shared, last], shared=2)
    # the finest levels have the numbers of the third, once
    assert len(table.values) == 6 * 5 + 3 * 3
    x, y = random.integers(0, 5, 20), random.integers(0, 6, 20)
    for level in range(3):
        finer = 2 - level
        found = table.at(level, (x << finer) + finer, (y << finer) + finer)
        np.testing.assert_array_equal(found, shared[y, x].astype(np.float64))
    level = np.arange(20) % 2 + 2
    expected = np.where((level == 2)[:, None], shared[y, x], last[y >> 1, x >> 1])
    shift = level - 2
    np.testing.assert_array_equal(table.at(level, x >> shift, y >> shift), expected.astype(np.float64))
