"""Sun ceilings against rays that are followed in small steps over the bilinear surface."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.streaming import blocks
from orogen.streaming.atlas import CEILING_BLOCK, NodeAtlas, height_attachments
from orogen.streaming.ceilings import CeilingBuilder, Sun
from orogen.streaming.heightformat import FLOATS, HeightFormat
from orogen.streaming.settings import HEIGHT_BORDER
from orogen.streaming.tiles import HeightNode
from streaming.test_atlas import read_layer

WHOLE = HeightFormat(16, 1 / 32, -1000.0)
STEP = 0.2


def ground(side: int, seed: int) -> NDArray[np.float32]:
    """Hills and smooth valleys, a wall, and rough patches, for samples a metre apart."""
    y, x = np.mgrid[0:side, 0:side] / 24.0
    heights = 9 * np.sin(x + seed) * np.cos(0.6 * y) + 0.02 * 24 * x
    heights[40:43, 60:200] += 15
    rough = np.random.default_rng(seed).normal(0, 1.5, (30, 40))
    heights[150:180, 20:60] += rough
    return heights.astype(np.float32)


def surface(samples: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights at cell coordinates (column, row): sample s is at s + 1, and HEIGHT_BORDER samples come before it."""
    at = u - 1 + HEIGHT_BORDER
    c = np.clip(np.floor(at).astype(int), 0, len(samples) - 2)
    fx, fy = np.moveaxis(at - c, -1, 0)
    x, y = np.moveaxis(c, -1, 0)
    top = samples[y, x] * (1 - fx) + samples[y, x + 1] * fx
    return top * (1 - fy) + (samples[y + 1, x] * (1 - fx) + samples[y + 1, x + 1] * fx) * fy


@pytest.mark.parametrize(
    ("azimuth", "elevation", "size", "level", "form"),
    [
        (315, 35, 256, 0, FLOATS), (80, 12, 256, 2, WHOLE), (200, 20, 256, 1, FLOATS), (90, 25, 256, 0, WHOLE),
        (0, 3, 512, 0, FLOATS),
    ],
)  # fmt: skip
def test_what_is_over_the_ceiling_sees_the_sun(
    gpu: Gpu, azimuth: float, elevation: float, size: int, level: int, form: HeightFormat
) -> None:
    atlas = NodeAtlas(gpu, "test", height_attachments(size, True, form), 3, 1 << 30, 1)
    builder = CeilingBuilder(gpu, SimpleNamespace(atlas=atlas, format=form), size.bit_length() - 1)  # type: ignore[arg-type]
    # level k is as steep as level 0: its samples are 2^k times as far apart
    samples = form.encode(ground(size + 2 * HEIGHT_BORDER, azimuth) * 2**level)
    atlas.upload(2, HeightNode(samples, None, 0.0, 0.0, np.zeros((0, 0, 2), np.float32)))
    a, e = np.radians([azimuth, elevation])
    sun = Sun((np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e)), float(np.sin(e)))
    builder.shine(sun)
    builder.build([2 | level << 16])
    ceilings = read_layer(gpu, atlas.textures["ceilings"], 2).astype(np.float64)
    builder.destroy()
    atlas.destroy()

    heights = form.decode(samples).astype(np.float64)
    way, slope = np.array(sun.way) / 2**level, np.array(sun.slope) * 2**level
    rng = np.random.default_rng(1)
    starts = rng.integers(0, size // CEILING_BLOCK, (2000, 2))
    u = (starts + rng.uniform(0, 1, starts.shape)) * CEILING_BLOCK
    ceiling = ceilings[starts[:, 1], starts[:, 0]]
    at_ground = surface(heights, u) - u @ slope
    # from the ground where that is over the ceiling already, else from the ceiling
    ray = np.maximum(at_ground, ceiling)
    pace = way / np.linalg.norm(way) * STEP
    lit, clear = np.ones(len(u), bool), np.ones(len(u), bool)
    place = u.copy()
    for _ in range(int(1.5 * size / STEP)):
        place = place + pace
        inside = ((place >= 0) & (place <= size + 1)).all(axis=-1)
        there = surface(heights, place) - place @ slope
        clear &= ~inside | (there <= ray + 2e-3 * 2**level)
        lit &= ~inside | (there <= at_ground + 2e-3 * 2**level)
    assert clear.all()
    spared = at_ground >= ceiling
    assert 0.2 < lit.mean() < 0.99
    # it is worth having: most of what is lit needs no ray
    assert spared[lit].mean() > 0.6
    assert not (spared & ~lit).any()


def test_ceilings_are_of_one_sun_that_stands_still(
    clipmap_of: Any, pyramid_of: Any, settle: Any, north_up: Any
) -> None:
    heights = ground(600, 1)
    clipmap = clipmap_of(pyramid_of(heights, north_up(heights.shape, 1.0)))
    view, frame = settle(clipmap, Frame(Camera(300.0, 300.0, 200.0), clipmap.grid, (64, 48)))
    west, south = (-0.8, 0.0, 0.6), (0.0, -0.8, 0.6)

    def used(sun: tuple[float, float, float]) -> bool:
        view.update(frame, sun)
        return view._sun_block != blocks.NO_SUN_BLOCK

    assert [used(west) for _ in range(5)] == [False, False, False, True, True]
    # suns in turn get none, and take none from the one that has them
    assert [used(sun) for sun in (south, west) * 4] == [False, True] * 4
    assert [used(south) for _ in range(4)] == [False, False, False, True]
    assert not used(west)
    view.update(frame)
    assert view._sun_block == blocks.NO_SUN_BLOCK
