"""The tile cache, the atlas and the clipped quadtree, driven at random against a plain model.

Whatever is asked for, read, broken, repaired and built in whatever order: no texel is wrong, no node is stale, no
budget is exceeded, and all detail comes in the end.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from itertools import count
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, seed, settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from numpy.typing import NDArray

from faults.scene import ArraySource
from orogen.camera import Camera
from orogen.errors import GpuError, SourceError
from orogen.frame import Frame
from orogen.gpu import Gpu, Texture
from orogen.grid import Grid
from orogen.keys import NodeKey
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.streaming import retry
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.settings import HEIGHT_BORDER, ClipmapSettings
from orogen.streaming.tiles import HeightNode

SHAPE = (1024, 1536)
GRID = Grid(SHAPE[1], SHAPE[0], (10.0, 0.0, 5e5, 0.0, -10.0, 4e6))
SLOTS = 14
SETTINGS = ClipmapSettings(view_distance=0.8, memory=SLOTS * 373_000, host_memory=2 << 20)
NO_SLOT = 0xFFFF
PARTS = 16
"""Of the nightly run, so that processes can share it."""


@cache
def samples() -> NDArray[np.float32]:
    y, x = np.indices(SHAPE)
    noise = np.random.default_rng(9).normal(0, 20, SHAPE)
    return (300 + 200 * np.sin(x / 77) * np.cos(y / 59) + noise).astype(np.float32)


@cache
def level(number: int) -> NDArray[np.float64]:
    """Means of 2^number x 2^number samples."""
    side = 1 << number
    rows, cols = SHAPE[0] // side, SHAPE[1] // side
    return samples().astype(np.float64).reshape(rows, side, cols, side).mean(axis=(1, 3))


class Broken(ArraySource):
    """A source of which some blocks cannot be read."""

    bad: frozenset[tuple[int, int]] = frozenset()

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        if (rows.start // 256, cols.start // 256) in self.bad:
            raise SourceError(f"{self.name}: block cannot be read")
        return super().read(rows, cols)


class Model(RuleBasedStateMachine):
    """What the clipmap holds, against what it should."""

    gpu: Gpu
    built: Pyramid
    steps: int
    """Those after which everything was compared."""

    def __init__(self) -> None:
        super().__init__()
        self.source = Broken(samples(), "/data/model.tif", GRID)
        self.pyramid = open_pyramid(self.source, build="never")
        self.before = self.atlas_bytes()
        self.clipmap = Clipmap(self.gpu, self.pyramid, None, SETTINGS)
        self.views: list[tuple[ClipmapView, Frame]] = []
        self.uploads_to_fail = 0
        self.uploads = Counter[int]()
        self.checked: dict[int, tuple[NodeKey, int]] = {}
        atlas = self.clipmap.heights.atlas
        original = atlas.upload

        def upload(slot: int, node: HeightNode) -> None:
            self.uploads[slot] += 1
            if self.uploads_to_fail:
                self.uploads_to_fail -= 1
                # half of a node has arrived when it fails
                self.gpu.write_texture(atlas.textures["height"], np.full_like(node.heights, 9e9), layer=slot)
                raise GpuError("expected memory for an upload, got none")
            original(slot, node)

        atlas.upload = upload  # type: ignore[method-assign]

    def atlas_bytes(self) -> int:
        return sum(size for name, size in self.gpu.memory.by_category().items() if name.startswith("atlas"))

    def teardown(self) -> None:
        self.clipmap.close()
        self.pyramid.close()

    @initialize()
    def one_view(self) -> None:
        self.look_from_another_view(0.5, 0.5, 2000.0, -60.0)

    @rule(x=st.floats(0, 1), y=st.floats(0, 1), z=st.sampled_from([900.0, 2000.0, 9000.0]), pitch=st.floats(-90, -20))
    @precondition(lambda self: len(self.views) < 3)
    def look_from_another_view(self, x: float, y: float, z: float, pitch: float) -> None:
        view = self.clipmap.view()
        self.views.append((view, self.frame(view, x, y, z, pitch)))
        view.want(self.views[-1][1])

    def frame(self, view: ClipmapView, x: float, y: float, z: float, pitch: float) -> Frame:
        left, bottom, right, top = GRID.bounds
        camera = Camera(left + x * (right - left), bottom + y * (top - bottom), z, pitch=pitch)
        return view.frame_for(Frame(camera, GRID, (96, 64)))

    @rule(x=st.floats(0, 1), y=st.floats(0, 1), z=st.sampled_from([900.0, 2000.0, 9000.0]), pitch=st.floats(-90, -20))
    def move(self, x: float, y: float, z: float, pitch: float) -> None:
        view, _ = self.views.pop(0)
        self.views.append((view, self.frame(view, x, y, z, pitch)))
        view.want(self.views[-1][1])

    @rule()
    @precondition(lambda self: len(self.views) > 1)
    def drop_a_view(self) -> None:
        self.clipmap.drop(self.views.pop()[0])

    @rule(times=st.integers(1, 3))
    def pump(self, times: int) -> None:
        for _ in range(times):
            self.clipmap.pump()

    @rule()
    def wait(self) -> None:
        self.clipmap.heights.wait(0.02)

    @rule(blocks=st.frozensets(st.tuples(st.integers(0, 3), st.integers(0, 5)), max_size=8))
    def break_blocks(self, blocks: frozenset[tuple[int, int]]) -> None:
        self.source.bad = blocks

    @rule(number=st.integers(1, 4))
    def break_uploads(self, number: int) -> None:
        self.uploads_to_fail = number

    @rule()
    def repair(self) -> None:
        self.source.bad = frozenset()
        self.uploads_to_fail = 0

    @rule()
    @precondition(lambda self: not self.pyramid.built)
    def finish_the_build(self) -> None:
        store = self.built._store
        assert store is not None
        self.pyramid._use(store, self.built._facts)

    @rule()
    def settle(self) -> None:
        """Without faults everything comes; with them the call ends all the same."""
        deadline = time.monotonic() + 20
        for tries in count(1):
            self.clipmap.settle()
            if self.source.bad or not self.clipmap.heights.failed:
                break
            assert tries < 200 or time.monotonic() < deadline, "does not converge"
            time.sleep(0.01)
        if not self.source.bad:
            self.repair()
            layer = self.clipmap.heights
            readable = list(layer._wanted)
            assert set(layer.current) == set(readable)
            assert len(readable) <= layer.atlas.capacity
            if self.pyramid.built:
                assert layer.estimates == 0
                assert len(readable) == min(len({k for v, _ in self.views for k in v.wishes[0]}), layer.atlas.capacity)

    @invariant()
    def budgets_hold(self) -> None:
        type(self).steps += 1
        layer = self.clipmap.heights
        assert self.atlas_bytes() - self.before <= SETTINGS.memory
        assert layer.tiles.size + len(layer._loader._ready) * layer.atlas.upload_bytes <= SETTINGS.host_memory
        slots = list(layer.atlas.resident.values())
        assert len(set(slots)) == len(slots) <= layer.atlas.capacity <= SLOTS

    @invariant()
    def no_texel_is_wrong(self) -> None:
        layer = self.clipmap.heights
        for key, slot in layer.atlas.resident.items():
            state = key, self.uploads[slot]
            if self.checked.get(slot) == state:
                continue
            self.checked[slot] = state
            texels = self.gpu.read_texture(layer.atlas.textures["height"], layer=slot).result()
            exact = self.around(level(key.level), key)
            inside = np.isfinite(exact)
            if key in layer._estimates:
                # of the same ground: not further from it than the noise
                assert np.abs(texels[inside] - exact[inside]).max() < 200
            else:
                np.testing.assert_allclose(texels[inside], exact[inside], atol=1e-3)

    @staticmethod
    def around(values: NDArray[np.float64], key: NodeKey) -> NDArray[np.float64]:
        """Texels of a node and its border, NaN past the data."""
        padded = np.pad(values, HEIGHT_BORDER, constant_values=np.nan)
        side = 256 + 2 * HEIGHT_BORDER
        part = padded[key.y * 256 : key.y * 256 + side, key.x * 256 : key.x * 256 + side]
        out = np.full((side, side), np.nan)
        out[: part.shape[0], : part.shape[1]] = part
        return out

    @invariant()
    def every_place_has_its_best_node(self) -> None:
        layer = self.clipmap.heights
        for view, frame in self.views:
            view.update(frame)
            table = self.gpu.read_buffer(self.readable(view), dtype=np.uint32).result()
            side = 1 << view._bits[0]
            for number in range(layer.grid.level_count):
                y0, x0 = view._height_origins[number]
                rows, cols = layer.grid.nodes(number)
                for y in range(y0, min(y0 + side, rows)):
                    for x in range(x0, min(x0 + side, cols)):
                        entry = int(table[(number * side + y % side) * side + x % side])
                        assert (entry & NO_SLOT, entry >> 16) == self.best(number, y, x)

    def readable(self, view: ClipmapView) -> Any:
        assert view._table is not None
        return view._table

    def best(self, number: int, y: int, x: int) -> tuple[int, int]:
        """Slot and level of the finest wanted resident node over a place."""
        layer = self.clipmap.heights
        for up in range(number, layer.grid.level_count):
            key = NodeKey(up, x >> (up - number), y >> (up - number))
            if key in layer.atlas.resident and key in layer._wanted:
                return layer.atlas.resident[key], up
        return NO_SLOT, layer.grid.level_count - 1


@pytest.fixture
def model(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> type[Model]:
    monkeypatch.setattr(retry, "FIRST", 0.005)
    monkeypatch.setattr(retry, "LONGEST", 0.02)
    make_texture, make_buffer = Gpu.texture, Gpu.buffer

    def texture(self: Gpu, label: str, size: Any, form: str, usage: str, *rest: Any, **options: Any) -> Texture:
        # to look into the atlas
        return make_texture(self, label, size, form, usage + "|COPY_SRC", *rest, **options)

    def buffer(self: Gpu, label: str, size: Any, usage: str, category: str) -> Any:
        return make_buffer(self, label, size, usage + ("|COPY_SRC" if label == "quadtree" else ""), category)

    monkeypatch.setattr(Gpu, "texture", texture)
    monkeypatch.setattr(Gpu, "buffer", buffer)
    with open_pyramid(ArraySource(samples(), "/data/model.tif", GRID)) as built:
        yield type("Bound", (Model,), {"gpu": gpu, "built": built, "steps": 0})


QUIET = {
    "deadline": None,
    "suppress_health_check": list(HealthCheck),
    "database": None,
}


def test_some_hundred_steps(model: type[Model]) -> None:
    run_state_machine_as_test(
        model, settings=settings(max_examples=8, stateful_step_count=30, derandomize=True, **QUIET)
    )
    assert model.steps >= 150


@pytest.mark.nightly
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("part", range(PARTS))
def test_ten_thousand_steps(model: type[Model], part: int, record_property: Callable[[str, object], None]) -> None:
    number = part
    while model.steps < 10_000 // PARTS:
        run_state_machine_as_test(
            seed(number)(model), settings=settings(max_examples=10, stateful_step_count=50, **QUIET)
        )
        number += PARTS
    record_property("steps of the model", model.steps)
