"""The kernels against plain loops, and that neither bands nor regions show in the result."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from orogen.pyramid import build, open_pyramid, regions
from orogen.pyramid.reduce import colour_means, coverage_means, filled, height_means
from orogen.pyramid.region import Edges, HeightRegion
from orogen.source import open_height

F32 = NDArray[np.float32]

RASTERS = arrays.arrays(
    np.float32,
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    elements=st.one_of(st.integers(-1000, 4000).map(float), st.just(float("nan"))),
)
ALONE = Edges(top=True, bottom=True, left=True, right=True)


def looped_means(c: F32) -> F32:
    """2 x 2 means, sample by sample."""
    rows, cols = c.shape

    def line(get: object, n: int, i: int) -> float:
        if i < n:
            return get(i)  # type: ignore[operator, no-any-return]
        last = get(n - 1)  # type: ignore[operator]
        before = get(n - 2) if n > 1 else np.nan  # type: ignore[operator]
        return last if np.isnan(before) else 2 * last - before

    def sample(i: int, j: int) -> float:
        return line(lambda k: line(lambda m: float(c[m, k]), rows, i), cols, j)

    out = np.empty((-(-rows // 2), -(-cols // 2)), np.float32)
    for i, j in np.ndindex(out.shape):
        quad = [sample(2 * i + a, 2 * j + b) for a in (0, 1) for b in (0, 1)]
        valid = [v for v in quad if not np.isnan(v)]
        out[i, j] = np.mean(valid) if valid else np.nan
    return out


@given(RASTERS)
@settings(max_examples=60, deadline=None)
def test_height_means_are_those_of_plain_loops(c: F32) -> None:
    np.testing.assert_allclose(height_means(c), looped_means(c), rtol=1e-6, atol=1e-4)


@given(RASTERS)
@settings(max_examples=60, deadline=None)
def test_voids_take_the_mean_of_their_neighbours(c: F32) -> None:
    got = filled(c)
    for i, j in np.ndindex(c.shape):
        near = c[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        valid = near[~np.isnan(near)]
        expected = c[i, j] if not np.isnan(c[i, j]) else valid.mean() if valid.size else np.nan
        np.testing.assert_allclose(got[i, j], expected, rtol=1e-5, atol=1e-3)


def test_wide_rasters_are_filled_like_narrow_ones() -> None:
    rng = np.random.default_rng(1)
    c = rng.normal(size=(40, 700)).astype(np.float32)
    c[rng.random(c.shape) < 0.3] = np.nan
    pieces = [filled(c[:, max(k - 2, 0) : k + 52])[:, min(k, 2) :][:, :50] for k in range(0, 700, 50)]
    np.testing.assert_allclose(filled(c), np.concatenate(pieces, axis=1), rtol=1e-5, atol=1e-6)


@given(arrays.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9))))
@settings(max_examples=40, deadline=None)
def test_coverage_counts_only_what_is_inside(c: NDArray[np.uint8]) -> None:
    got = coverage_means(c)
    for i, j in np.ndindex(got.shape):
        assert abs(float(got[i, j]) - c[2 * i : 2 * i + 2, 2 * j : 2 * j + 2].mean()) <= 0.5


def test_transparent_colours_do_not_bleed() -> None:
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0, 0] = (200, 100, 50, 255)
    pixels[1, 1] = (9, 255, 9, 0)
    np.testing.assert_array_equal(colour_means(pixels)[0, 0], (200, 100, 50, 64))


@pytest.mark.parametrize("bands", [[300], [4, 296], [100, 100, 100], [256, 44], [8] * 37 + [4]])
def test_bands_do_not_show(bands: list[int]) -> None:
    heights = np.random.default_rng(2).normal(0, 10, (300, 520)).astype(np.float32)
    whole = HeightRegion(heights.shape, ALONE, True, 1)
    whole.add(heights)
    whole.finish()
    parts = HeightRegion(heights.shape, ALONE, True, 1)
    for rows, stop in zip(bands, np.cumsum(bands), strict=True):
        parts.add(heights[stop - rows : stop])
    parts.finish()
    np.testing.assert_array_equal(parts.means, whole.means)
    np.testing.assert_array_equal(parts.steps, whole.steps)


@pytest.mark.parametrize("shape", [(2300, 260), (300, 2309), (2064, 2063)])
def test_regions_do_not_show(shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    heights = np.random.default_rng(3).normal(0, 10, shape).astype(np.float32)
    found = []
    for side in (2048, 4096):
        monkeypatch.setattr(regions, "REGION", side)
        monkeypatch.setattr(build, "REGION", side)
        with open_pyramid(open_height(heights, spacing=1)) as pyramid:
            found.append([pyramid.node_bounds(level) for level in range(pyramid.level_count)])
    for apart, together in zip(*found, strict=True):
        assert apart is not None
        np.testing.assert_array_equal(apart, together)
