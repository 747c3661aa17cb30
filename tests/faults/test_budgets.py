"""Budgets for GPU and host memory hold within a twentieth at full, half and an eighth of their sizes."""

from __future__ import annotations

import gc
import tracemalloc
from typing import Any

import pytest

from faults.scene import SIZE, Place, walk
from orogen.gpu import Gpu
from orogen.gpu.resources import Buffer, Texture
from orogen.view.framing import frame_camera

FULL_ATLAS, FULL_HOST = 64 << 20, 8 << 20
TEXEL = {
    "depth32float": 4,
    "rgba32float": 16,
    "r32float": 4,
    "r32uint": 4,
    "r8unorm": 1,
    "rgba8unorm-srgb": 4,
    "rgba8unorm": 4,
    "rgba16float": 8,
}


def raw_bytes(resource: Buffer | Texture) -> int:
    """Bytes of a live object by what the driver was asked for."""
    raw = resource.raw
    if isinstance(resource, Buffer):
        return raw.size
    layers = raw.depth_or_array_layers
    shapes = [(max(1, raw.width >> mip), max(1, raw.height >> mip)) for mip in range(raw.mip_level_count)]
    return sum(w * h * layers * TEXEL[raw.format] for w, h in shapes)


@pytest.mark.parametrize("part", [1, 2, 8])
def test_gpu_memory(place: Place, part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the account says is what is allocated; the atlas takes what it may, and the peak stays in the budget."""
    made: list[tuple[Buffer | Texture, int]] = []
    for name in ("buffer", "texture"):
        original = getattr(Gpu, name)

        def make(self: Gpu, *arguments: Any, original: Any = original, **options: Any) -> Any:
            resource = original(self, *arguments, **options)
            made.append((resource, raw_bytes(resource)))
            return resource

        monkeypatch.setattr(Gpu, name, make)
    memory = FULL_ATLAS // part
    with place.terrain(view_distance=float("inf"), memory=memory) as terrain:
        for camera in walk()[1:3]:
            terrain.render(camera, SIZE, samples=1)
        account = terrain.renderer.gpu.memory
        gc.collect()
        live = sum(size for resource, size in made if resource._release.alive)
        assert live == pytest.approx(account.total, rel=0.001)
        atlas = sum(size for name, size in account.by_category().items() if name.startswith("atlas"))
        layers = terrain.renderer.clipmap.layers
        whole = all(layer.atlas.capacity == layer.grid.node_count for layer in layers)
        assert atlas <= memory
        assert whole or atlas >= 0.9 * memory, "less than a node of each layer is left"
        assert account.peak <= account.budget * 1.05


@pytest.mark.parametrize("part", [1, 2, 8])
def test_host_memory(place: Place, part: int) -> None:
    """Tiles and nodes in waiting, by their own count and by what Python's allocator says."""
    budget = FULL_HOST // part
    with place.terrain(view_distance=float("inf"), host_memory=budget) as terrain:
        renderer = terrain.renderer
        camera = frame_camera(terrain.grid, terrain.height_range, aspect=1.5)
        terrain.render(camera, SIZE, samples=1)
        caches = [layer.tiles for layer in renderer.clipmap.layers]
        for tiles in caches:
            assert tiles.size == sum(future.result().nbytes for future in tiles._tiles.values())
        assert 0.4 * budget < sum(tiles.size for tiles in caches) <= 1.05 * budget
        for tiles in caches:
            tiles._tiles.clear()
            tiles._bytes = 0
        gc.collect()
        tracemalloc.start()
        try:
            for view in walk():
                terrain.render(view, SIZE, samples=1)
            renderer.draws = ()
            gc.collect()
            traced = sum(
                found.size for found in tracemalloc.take_snapshot().statistics("lineno") if found.size > 60_000
            )
        finally:
            tracemalloc.stop()
        assert 0.1 * budget < traced <= 1.05 * budget
