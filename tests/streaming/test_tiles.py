"""Nodes made of decoded tiles, against plain numpy; the tiles themselves under threads and a budget."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.keys import NodeKey, level_count, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.streaming.settings import COLOR_BORDER, COLOR_MIPS, HEIGHT_BORDER
from orogen.streaming.tiles import DecodedTiles, color_node, height_node

MakePyramid = Callable[..., Pyramid]
SHAPE = (601, 1030)


def rugged(shape: tuple[int, int], seed: int, holes: float = 0.0) -> NDArray[np.float32]:
    """Random heights with round voids of several sizes over about so large a part."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(1000, 300, shape).astype(np.float32)
    covered = 0.0
    while covered < holes * heights.size:
        (row, col), radius = rng.uniform(0, shape), 10 ** rng.uniform(-0.5, 1.8)
        y, x = (
            np.arange(max(0, int(c - radius)), min(n, int(c + radius) + 2))
            for c, n in zip((row, col), shape, strict=True)
        )
        inside = np.hypot(*np.meshgrid(y - row, x - col, indexing="ij")) < radius
        heights[np.ix_(y, x)] = np.where(inside, np.nan, heights[np.ix_(y, x)])
        covered += 3 * radius**2
    return heights


def levels_of(heights: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """All levels by the rule of docs/architecture.md, in float32 like the store, sample by sample of an odd edge."""

    def evened(a: NDArray) -> NDArray:
        if len(a) % 2 == 0 or len(a) == 1:
            return a if len(a) % 2 == 0 else np.concatenate([a, a])
        more = np.where(np.isnan(a[-2]), a[-1], 2 * a[-1] - a[-2])
        return np.concatenate([a, more[None]])

    levels = [heights]
    for _ in range(level_count(heights.shape) - 1):
        a = evened(evened(levels[-1]).T).T
        children = np.stack([a[i::2, j::2] for i in (0, 1) for j in (0, 1)]).astype(np.float64)
        valid = np.isfinite(children)
        with np.errstate(invalid="ignore"):
            mean = np.where(valid, children, 0).sum(axis=0) / valid.sum(axis=0)
        levels.append(mean.astype(np.float32))
    return levels


def filled_levels(levels: list[NDArray[np.float32]]) -> list[NDArray[np.float64]]:
    """The levels without holes: mean of the valid ones of the 8 neighbours, else the finest valid coarser texel, else
    the middle of the range.
    """
    out = []
    middle = (np.nanmin(levels[0]) + np.nanmax(levels[0])) / 2
    for level, heights in enumerate(levels):
        padded = np.pad(heights.astype(np.float64), 1, constant_values=np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            around = np.nanmean(sliding_window_view(padded, (3, 3)), axis=(2, 3))
        result = np.where(np.isnan(heights), around, heights)
        y, x = np.indices(heights.shape)
        for k, coarser in enumerate(levels[level + 1 :], start=1):
            result = np.where(np.isnan(result), coarser[y >> k, x >> k], result)
        out.append(np.where(np.isnan(result), middle, result))
    return out


def texel(values: NDArray[Any], y: int, x: int, *, linear: bool) -> Any:
    """A texel of a level, also past its edges: two steps along the slope, then the same on."""
    parts = []
    for i, n in ((y, values.shape[0]), (x, values.shape[1])):
        edge = min(max(i, 0), n - 1)
        past = min(abs(i - edge), 2) if linear and n > 1 else 0
        inner = edge + (1 if i < 0 else -1)
        parts.append([(edge, 1 + past), (inner, -past)] if past else [(edge, 1)])
    return sum(wy * wx * values[j, i] for j, wy in parts[0] for i, wx in parts[1])


def square(values: NDArray[Any], key: NodeKey, size: int, border: int, *, linear: bool) -> NDArray[np.float64]:
    """A node with its border, texel by texel."""
    rows = range(key.y * size - border, (key.y + 1) * size + border)
    cols = range(key.x * size - border, (key.x + 1) * size + border)
    return np.array([[texel(values, y, x, linear=linear) for x in cols] for y in rows], np.float64)


@pytest.fixture(scope="module")
def voids(pyramid_of: MakePyramid) -> tuple[Pyramid, list[NDArray], list[NDArray]]:
    heights = rugged(SHAPE, 6, holes=0.3)
    assert 0.2 < np.isnan(heights).mean() < 0.8
    levels = levels_of(heights)
    return pyramid_of(heights), levels, filled_levels(levels)


KEYS = [
    NodeKey(0, 0, 0),
    NodeKey(0, 1, 1),
    NodeKey(0, 4, 2),
    NodeKey(0, 3, 0),
    NodeKey(1, 2, 1),
    NodeKey(2, 1, 0),
    NodeKey(3, 0, 0),
]


@pytest.mark.parametrize("key", KEYS)
def test_heights_of_a_node_and_its_border(voids: tuple[Pyramid, list[NDArray], list[NDArray]], key: NodeKey) -> None:
    pyramid, _, filled = voids
    node = height_node(DecodedTiles(pyramid, 1 << 24), pyramid, key, 256, False)
    assert node.heights.dtype == np.float32
    expected = square(filled[key.level], key, 256, HEIGHT_BORDER, linear=True)
    # rounding of float32 at a thousand metres, a few steps of it after the slopes past the edges
    np.testing.assert_allclose(node.heights, expected, rtol=1e-6, atol=1e-3)
    assert (node.low, node.high) == (node.heights.min(), node.heights.max())


def coverage_levels(heights: NDArray) -> list[NDArray[np.float64]]:
    """Share of valid samples under each texel, of those inside the raster."""
    shares = [np.isfinite(heights).astype(np.float64)]
    for _ in range(level_count(heights.shape) - 1):
        c = np.pad(shares[-1], [(0, n % 2) for n in shares[-1].shape], constant_values=np.nan)
        shares.append(np.nanmean([c[i::2, j::2] for i in (0, 1) for j in (0, 1)], axis=0))
    return shares


@pytest.mark.parametrize("key", KEYS)
def test_coverage_of_a_node_and_its_border(voids: tuple[Pyramid, list[NDArray], list[NDArray]], key: NodeKey) -> None:
    pyramid, levels, _ = voids
    node = height_node(DecodedTiles(pyramid, 1 << 24), pyramid, key, 256, False)
    assert node.coverage is not None
    assert node.coverage.dtype == np.uint8
    expected = square(coverage_levels(levels[0])[key.level] * 255, key, 256, HEIGHT_BORDER, linear=False)
    # a store rounds at every level
    assert np.abs(node.coverage - expected).max() <= 0.5 * key.level + 1e-6


@pytest.mark.parametrize("size", [512, 1024])
def test_larger_nodes(voids: tuple[Pyramid, list[NDArray], list[NDArray]], size: int) -> None:
    pyramid, _, filled = voids
    tiles = DecodedTiles(pyramid, 1 << 24)
    key = NodeKey(0, 1 if size == 512 else 0, 0)
    node = height_node(tiles, pyramid, key, size, False)
    rows = slice(0, HEIGHT_BORDER + 500)
    part = node.heights[HEIGHT_BORDER:][rows]
    expected = filled[0][rows, key.x * size : min((key.x + 1) * size, SHAPE[1])]
    np.testing.assert_allclose(part[:, HEIGHT_BORDER : HEIGHT_BORDER + expected.shape[1]], expected, rtol=3e-6)


def test_neighbours_agree_on_the_texels_that_they_share(voids: tuple[Pyramid, list[NDArray], list[NDArray]]) -> None:
    pyramid = voids[0]
    tiles = DecodedTiles(pyramid, 1 << 24)
    shared = 2 * HEIGHT_BORDER
    for level in (0, 1):
        left, right, below = (
            height_node(tiles, pyramid, NodeKey(level, x, y), 256, False) for x, y in ((0, 0), (1, 0), (0, 1))
        )
        for a, b in ((left.heights, right.heights), (left.coverage, right.coverage)):
            assert a is not None
            assert b is not None
            np.testing.assert_array_equal(a[:, -shared:], b[:, :shared])
        np.testing.assert_array_equal(left.heights[-shared:], below.heights[:shared])


@pytest.mark.parametrize("shape", [(300, 517), (257, 1), (1, 300), (1, 1), (3, 700)])
def test_planes_stay_exact_past_the_edges(pyramid_of: MakePyramid, shape: tuple[int, int]) -> None:
    y, x = np.indices(shape)
    # steps in eighths: float32 holds them exactly
    slope = np.array([0.25 if n > 1 else 0.0 for n in shape[::-1]]) * [1, -2]
    pyramid = pyramid_of((50 + slope[0] * x + slope[1] * y).astype(np.float32))
    tiles = DecodedTiles(pyramid, 1 << 24)
    for level in range(pyramid.level_count):
        rows, cols = level_shape(shape, level)
        for key in {NodeKey(level, 0, 0), NodeKey(level, (cols - 1) // 256, (rows - 1) // 256)}:
            node = height_node(tiles, pyramid, key, 256, True)
            assert node.coverage is None
            side = np.arange(-HEIGHT_BORDER, 256 + HEIGHT_BORDER)
            # sample positions, held where more than two texels past the last centre
            reach = [(-HEIGHT_BORDER, n - 1 + HEIGHT_BORDER) if n > 1 else (0, 0) for n in (rows, cols)]
            at = [np.clip(side + k * 256, *r) for k, r in zip((key.y, key.x), reach, strict=True)]
            ty, tx = ((a + 0.5) * 2**level - 0.5 for a in at)
            np.testing.assert_array_equal(node.heights, 50 + slope[0] * tx[None, :] + slope[1] * ty[:, None])


def test_a_raster_without_a_valid_neighbourhood_falls_back_to_coarser_levels(pyramid_of: MakePyramid) -> None:
    heights = np.full((700, 700), np.nan, np.float32)
    heights[690, 20] = 123.0
    pyramid = pyramid_of(heights)
    node = height_node(DecodedTiles(pyramid, 1 << 24), pyramid, NodeKey(0, 1, 0), 256, False)
    assert node.coverage is not None
    assert not node.coverage.any()
    assert np.isfinite(node.heights).all()
    np.testing.assert_array_equal(node.heights, 123.0)


# -- colours -----------------------------------------------------------------------------------------------------------


def linear(srgb: NDArray) -> NDArray[np.float64]:
    s = srgb / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def srgb(light: NDArray) -> NDArray[np.float64]:
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@pytest.fixture(scope="module")
def image(pyramid_of: MakePyramid) -> tuple[Pyramid, NDArray[np.uint8]]:
    rng = np.random.default_rng(8)
    pixels = rng.integers(0, 256, (300, 530, 4)).astype(np.uint8)
    pixels[..., 3] = np.where(rng.random((300, 530)) < 0.2, 0, 255)
    return pyramid_of(pixels), pixels


@pytest.mark.parametrize("key", [NodeKey(0, 0, 0), NodeKey(0, 1, 1), NodeKey(0, 2, 0)])
def test_colours_of_a_node_its_border_and_its_mips(image: tuple[Pyramid, NDArray[np.uint8]], key: NodeKey) -> None:
    pyramid, pixels = image
    node = color_node(DecodedTiles(pyramid, 1 << 24), pyramid, key, 256)
    side = 256 + 2 * COLOR_BORDER
    assert [mip.shape for mip in node.mips] == [(side >> k, side >> k, 4) for k in range(COLOR_MIPS)]
    straight = square(pixels, key, 256, COLOR_BORDER, linear=False)
    alpha = straight[..., 3:] / 255
    light = linear(straight[..., :3]) * alpha
    np.testing.assert_array_equal(node.mips[0], np.rint(np.concatenate([srgb(light), 255 * alpha], axis=-1)))
    for level, mip in enumerate(node.mips[1:], start=1):
        side >>= 1
        light, alpha = (a.reshape(side, 2, side, 2, -1).mean(axis=(1, 3)) for a in (light, alpha))
        # rounded at every level; steps of dark colours are the widest in light
        assert np.abs(mip[..., :3] - srgb(light)).max() < 1.2 * level
        assert np.abs(mip[..., 3:] - 255 * alpha).max() <= 0.5 * level


def test_every_grey_survives_its_mips(pyramid_of: MakePyramid) -> None:
    for grey in range(0, 256, 5):
        pyramid = pyramid_of(np.full((4, 4, 4), [grey, grey, 255 - grey, 255], np.uint8))
        for mip in color_node(DecodedTiles(pyramid, 1 << 20), pyramid, NodeKey(0, 0, 0), 256).mips:
            assert (mip == [grey, grey, 255 - grey, 255]).all()


# -- the cache ---------------------------------------------------------------------------------------------------------


def test_windows_equal_the_pyramid_under_threads_and_a_small_budget(pyramid_of: MakePyramid) -> None:
    heights = rugged((1100, 1300), 9)
    pyramid = pyramid_of(heights)
    budget = 5 * 256 * 256 * 4
    tiles = DecodedTiles(pyramid, budget)
    wrong, over = [], []

    def read(seed: int) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(40):
            level = int(rng.integers(0, pyramid.level_count))
            shape = level_shape(heights.shape, level)
            (r0, r1), (c0, c1) = (sorted(rng.choice(n + 1, 2, replace=False)) for n in shape)
            window = tiles.window(level, slice(int(r0), int(r1)), slice(int(c0), int(c1)))
            if not np.array_equal(window, pyramid.read(level, slice(int(r0), int(r1)), slice(int(c0), int(c1)))):
                wrong.append((level, r0, c0))
            over.append(tiles.size)

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(read, range(6)))
    assert not wrong
    # no more than the budget once nothing is being read
    tiles.window(0, slice(0, 1), slice(0, 1))
    assert 0 < tiles.size <= budget
    assert max(over) <= budget + 6 * 256 * 256 * 4


def test_a_chunk_is_read_once_however_many_ask_for_it(pyramid_of: MakePyramid) -> None:
    pyramid = pyramid_of(rugged((500, 500), 10))
    source: Any = pyramid.source
    before = source.reads
    tiles = DecodedTiles(pyramid, 1 << 24)
    source.gate.clear()
    with ThreadPoolExecutor(8) as pool:
        found = [pool.submit(tiles.window, 0, slice(0, 300), slice(0, 300)) for _ in range(8)]
        source.gate.set()
        for window in found:
            np.testing.assert_array_equal(window.result(), source.data[:300, :300])
    assert source.reads - before == 4


def test_a_chunk_that_cannot_be_read_is_an_error_for_all_that_wait_and_is_tried_again(pyramid_of: MakePyramid) -> None:
    pyramid = pyramid_of(rugged((500, 500), 11))
    source: Any = pyramid.source
    tiles = DecodedTiles(pyramid, 1 << 24)
    source.bad = lambda rows, cols: True
    source.gate.clear()
    with ThreadPoolExecutor(4) as pool:
        found = [pool.submit(tiles.window, 0, slice(0, 100), slice(0, 100)) for _ in range(4)]
        threading.Timer(0.05, source.gate.set).start()
        for window in found:
            with pytest.raises(SourceError):
                window.result()
    assert tiles.size == 0
    source.bad = lambda rows, cols: False
    np.testing.assert_array_equal(tiles.window(0, slice(0, 100), slice(0, 100)), source.data[:100, :100])


def test_tiles_without_a_budget_hold_nothing_for_long(pyramid_of: MakePyramid) -> None:
    pyramid = pyramid_of(rugged((600, 600), 12))
    tiles = DecodedTiles(pyramid, 0)
    np.testing.assert_array_equal(
        tiles.window(0, slice(0, 600), slice(0, 600)), pyramid.read(0, slice(0, 600), slice(0, 600))
    )
    assert tiles.size <= 256 * 256 * 4


def test_estimates_give_way_to_what_is_built(pyramid_of: MakePyramid) -> None:
    heights = rugged((3000, 2100), 13)
    pyramid = pyramid_of(heights, build="never")
    tiles = DecodedTiles(pyramid, 1 << 24)
    assert [tiles.readable(level) for level in range(pyramid.level_count)] == [True, False, True, True, True]
    built = pyramid_of(heights)
    estimate = tiles.window(2, slice(0, 256), slice(0, 256))
    exact = built.read(2, slice(0, 256), slice(0, 256))
    assert not np.array_equal(estimate, exact)
    assert built._store is not None
    pyramid._use(built._store, built._facts)
    np.testing.assert_array_equal(tiles.window(2, slice(0, 256), slice(0, 256)), exact)
