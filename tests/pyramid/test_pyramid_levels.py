"""Levels, coverage, bounds and errors of built pyramids against float64 numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.keys import NODE_SIZE, level_count, level_shape
from orogen.pyramid import Pyramid, open_pyramid
from orogen.source import open_colour, open_height

F64 = NDArray[np.float64]

SHAPES = [
    (1, 1),
    (1, 700),
    (2, 513),
    (257, 256),
    (300, 601),
    (513, 1),
    (511, 1030),
    (2049, 300),
    (270, 2067),
    (2050, 2065),
]
"""Odd and even, thin, within a node, across nodes, and across the regions that are built apart."""


def terrain(shape: tuple[int, int], seed: int) -> NDArray[np.float32]:
    """Smooth hills, roughness and a cliff."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(shape)
    hills = 500 * np.sin(x / 37.0 + 1) * np.cos(y / 23.0) + 200 * (x > shape[1] // 3)
    return (hills + rng.normal(0, 5, shape)).astype(np.float32)


def voids(shape: tuple[int, int], seed: int) -> NDArray[np.bool_]:
    """Isolated samples, blocks, a whole band and the last column."""
    rng = np.random.default_rng(seed)
    mask = rng.random(shape) < 0.02
    for _ in range(5):
        y, x = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        mask[y : y + rng.integers(1, 70), x : x + rng.integers(1, 300)] = True
    mask[shape[0] // 2 : shape[0] // 2 + 3] = True
    mask[:, -1] = rng.random(shape[0]) < 0.5
    return mask


def oracle_evened(a: F64) -> F64:
    """One more row and column where odd: linear from the last two, else the last."""
    for axis in (0, 1):
        a = np.moveaxis(a, axis, 0)
        if len(a) % 2:
            new = a[-1] if len(a) == 1 else np.where(np.isnan(a[-2]), a[-1], 2 * a[-1] - a[-2])
            a = np.concatenate([a, new[None]])
        a = np.moveaxis(a, 0, axis)
    return a


def oracle_means(a: F64) -> F64:
    a = oracle_evened(a)
    quads = np.stack([a[i::2, j::2] for i in (0, 1) for j in (0, 1)])
    count = np.sum(~np.isnan(quads), axis=0)
    return np.where(count, np.nansum(quads, axis=0) / np.maximum(count, 1), np.nan)


def whole(pyramid: Pyramid, level: int) -> NDArray[np.float32]:
    rows, cols = level_shape(pyramid.grid.shape, level)
    return pyramid.read(level, slice(0, rows), slice(0, cols))


@pytest.mark.parametrize("shape", [*SHAPES, (2050, 2065)])
@pytest.mark.parametrize("holes", [False, True])
def test_levels_are_means_without_nodata(shape: tuple[int, int], holes: bool) -> None:
    heights = terrain(shape, 1)
    if holes:
        heights[voids(shape, 2)] = np.nan
        heights[shape[0] // 3, shape[1] // 3] = 7
    expected = heights.astype(np.float64)
    with open_pyramid(open_height(heights, spacing=1)) as pyramid:
        assert pyramid.level_count == level_count(shape)
        for level in range(1, pyramid.level_count):
            expected = oracle_means(expected)
            got = whole(pyramid, level)
            assert got.dtype == np.float32
            np.testing.assert_allclose(got, expected, rtol=1e-5, atol=2e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_planes_stay_planes_at_every_level(shape: tuple[int, int]) -> None:
    y, x = np.indices(shape)
    plane = (2 * x - 3 * y + 5).astype(np.float32)  # exact in float32
    with open_pyramid(open_height(plane, spacing=1)) as pyramid:
        for level in range(pyramid.level_count):
            sizes = level_shape(shape, level)
            if any(n == 1 and m > 1 for n, m in zip(sizes, shape, strict=True)):
                break  # a single row or column cannot slope
            rows, cols = np.indices(sizes)
            cy, cx = ((i + 0.5) * 2**level - 0.5 if m > 1 else i for i, m in zip((rows, cols), shape, strict=True))
            np.testing.assert_array_equal(whole(pyramid, level), 2 * cx - 3 * cy + 5)
            bounds = pyramid.node_bounds(level)
            assert bounds is not None
            assert bounds[..., 2].max() == 0


@pytest.mark.parametrize("shape", [(300, 601), (2050, 300)])
def test_coverage_is_the_mean_of_the_valid_part(shape: tuple[int, int]) -> None:
    heights = terrain(shape, 3)
    heights[voids(shape, 4)] = np.nan
    expected = np.where(np.isnan(heights), 0.0, 255.0)
    with open_pyramid(open_height(heights, spacing=1)) as pyramid:
        assert not pyramid.covered
        for level in range(pyramid.level_count):
            if level:
                padded = np.pad(expected, [(0, n % 2) for n in expected.shape], mode="edge")
                expected = np.mean([padded[i::2, j::2] for i in (0, 1) for j in (0, 1)], axis=0)
            rows, cols = level_shape(shape, level)
            got = pyramid.read_coverage(level, slice(0, rows), slice(0, cols))
            assert got.dtype == np.uint8
            assert np.abs(got - expected).max() <= 0.5 * level


@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_minimum_and_maximum_of_nodes_are_those_of_level_0(shape: tuple[int, int], holes: bool) -> None:
    heights = terrain(shape, 5)
    if holes:
        heights[voids(shape, 6)] = np.nan
        heights[0:256, 0:256] = np.nan
        heights[-1, -1] = 3
    with open_pyramid(open_height(heights, spacing=1)) as pyramid:
        for level in range(pyramid.level_count):
            bounds = pyramid.node_bounds(level)
            assert bounds is not None
            side = NODE_SIZE << level
            for y, x in np.ndindex(bounds.shape[:2]):
                block = heights[y * side : (y + 1) * side, x * side : (x + 1) * side]
                valid = block[~np.isnan(block)]
                expected = (valid.min(), valid.max()) if valid.size else (np.nan, np.nan)
                np.testing.assert_array_equal(bounds[y, x, :2], np.array(expected, np.float32))
        assert pyramid.height_range == (np.nanmin(heights), np.nanmax(heights))
        assert pyramid.covered == (not np.isnan(heights).any())


def surface(level: NDArray[np.float32], scale: int, x: F64, y: F64) -> F64:
    """Bilinear heights at level-0 texel coordinates (x, y); one texel beyond the edge is extrapolated linearly."""
    padded = level.astype(np.float64)
    for axis in (0, 1):
        a = np.moveaxis(padded, axis, 0)
        first = 2 * a[0] - a[1] if len(a) > 1 else a[0]
        last = 2 * a[-1] - a[-2] if len(a) > 1 else a[-1]
        padded = np.moveaxis(np.concatenate([first[None], a, last[None]]), 0, axis)
    tx, ty = x / scale - 0.5 + 1, y / scale - 0.5 + 1
    i = np.clip(np.floor(ty).astype(int), 0, padded.shape[0] - 2)
    j = np.clip(np.floor(tx).astype(int), 0, padded.shape[1] - 2)
    u, v = tx - j, ty - i
    top = padded[i, j] * (1 - u) + padded[i, j + 1] * u
    bottom = padded[i + 1, j] * (1 - u) + padded[i + 1, j + 1] * u
    return top * (1 - v) + bottom * v


@pytest.mark.parametrize("shape", [(1, 700), (300, 601), (511, 1030), (2049, 300), (270, 2067), (2100, 2100)])
def test_error_bounds_the_difference_from_level_0(shape: tuple[int, int]) -> None:
    heights = terrain(shape, 7)
    rng = np.random.default_rng(8)
    with open_pyramid(open_height(heights, spacing=1)) as pyramid:
        for level in range(1, pyramid.level_count):
            bounds = pyramid.node_bounds(level)
            assert bounds is not None
            side = NODE_SIZE << level
            # half texels hold every corner of the patches of levels 0 and 1; random points for all others
            n = 200_000
            x = rng.integers(1, 2 * shape[1], n) / 2 + (level > 1) * rng.uniform(-0.2, 0.2, n)
            y = rng.integers(1, 2 * shape[0], n) / 2 + (level > 1) * rng.uniform(-0.2, 0.2, n)
            x, y = np.clip(x, 0.5, shape[1] - 0.5), np.clip(y, 0.5, shape[0] - 0.5)
            difference = np.abs(surface(whole(pyramid, level), 2**level, x, y) - surface(heights, 1, x, y))
            error = bounds[(y // side).astype(int), (x // side).astype(int), 2]
            assert (difference <= error + 2e-3).all()


def test_error_of_level_1_is_exact() -> None:
    heights = terrain((700, 900), 9)
    with open_pyramid(open_height(heights, spacing=1)) as pyramid:
        x, y = np.meshgrid(np.arange(1, 1800) / 2, np.arange(1, 1400) / 2)
        difference = np.abs(surface(whole(pyramid, 1), 2, x, y) - surface(heights, 1, x, y))
        bounds = pyramid.node_bounds(1)
        assert bounds is not None
        for node_y, node_x in np.ndindex(bounds.shape[:2]):
            # the cells that a node's edge runs through count as a whole: 2 texels more on each side
            near = [(512 * n - 2, 512 * n + 514) for n in (node_y, node_x)]
            inside = (y >= near[0][0]) & (y <= near[0][1]) & (x >= near[1][0]) & (x <= near[1][1])
            assert bounds[node_y, node_x, 2] <= difference[inside].max() + 1e-3


def test_error_next_to_nodata_bounds_where_both_surfaces_are_made_of_valid_samples() -> None:
    shape = (300, 2100)
    heights = terrain(shape, 10)
    heights[voids(shape, 11)] = np.nan
    with open_pyramid(open_height(heights, spacing=1)) as pyramid:
        x, y = np.meshgrid(np.arange(1, 2 * shape[1]) / 2, np.arange(1, 2 * shape[0]) / 2)
        difference = np.abs(surface(whole(pyramid, 1), 2, x, y) - surface(heights, 1, x, y))
        bounds = pyramid.node_bounds(1)
        assert bounds is not None
        error = bounds[(y // 512).astype(int), (x // 512).astype(int), 2]
        valid = ~np.isnan(difference)
        assert valid.mean() > 0.3
        assert (difference[valid] <= error[valid] + 2e-3).all()
        assert np.isfinite(bounds[..., 2]).all()


def linear(byte: F64) -> F64:
    s = byte / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def srgb(light: F64) -> F64:
    return 255 * np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("shape", [(300, 601), (2051, 300)])
def test_colours_are_means_of_light_weighted_by_alpha(shape: tuple[int, int], tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    pixels = rng.integers(0, 256, (*shape, 4)).astype(np.uint8)
    pixels[..., 3] = rng.choice([0, 255, 130], shape)
    pixels[: shape[0] // 2, :, 3] = 255
    with open_pyramid(open_colour(pixels, open_height(np.zeros(shape), spacing=1))) as pyramid:
        for level in range(1, pyramid.level_count):
            padded = np.pad(pixels, [(0, n % 2) for n in pixels.shape[:2]] + [(0, 0)], mode="edge").astype(np.float64)
            quads = np.stack([padded[i::2, j::2] for i in (0, 1) for j in (0, 1)])
            alpha = quads[..., 3:]
            weight = alpha.sum(axis=0)
            light = (linear(quads[..., :3]) * alpha).sum(axis=0) / np.maximum(weight, 1)
            rows, cols = level_shape(shape, level)
            pixels = pyramid.read(level, slice(0, rows), slice(0, cols))
            assert np.abs(pixels[..., :3] - srgb(light))[weight[..., 0] > 0].max() <= 0.56  # the table rounds light too
            assert np.abs(pixels[..., 3:] - weight / 4).max() <= 0.5


def test_uniform_colours_of_every_byte_stay_as_they_are() -> None:
    for byte in range(256):
        pixels = np.full((2, 260, 4), byte, np.uint8)
        pixels[..., 3] = 255
        from orogen.pyramid.reduce import colour_means

        assert (colour_means(pixels)[..., :3] == byte).all()
