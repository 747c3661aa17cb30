"""The true surface against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from orogen.compare.truth import TrueSurface
from orogen.errors import SourceError

RNG = np.random.default_rng(5)
HEIGHTS = RNG.normal(500, 200, (7, 9))


def bilinear(values: np.ndarray, tx: float, ty: float) -> float:
    """One point by the tent of every sample: independent of cells."""
    rows, columns = values.shape
    total = 0.0
    for j in range(rows):
        for i in range(columns):
            weight = max(0.0, 1 - abs(tx - i - 0.5)) * max(0.0, 1 - abs(ty - j - 0.5))
            if weight > 0:
                total += weight * values[j, i]
    return total


def test_samples_lie_at_their_centres() -> None:
    ty, tx = np.mgrid[:7, :9] + 0.5
    np.testing.assert_allclose(TrueSurface(HEIGHTS).height(tx, ty), HEIGHTS, rtol=1e-14)


def test_height_is_the_sum_of_tents() -> None:
    tx, ty = RNG.uniform(0.5, 8.5, 200), RNG.uniform(0.5, 6.5, 200)
    expected = [bilinear(HEIGHTS, *at) for at in zip(tx, ty, strict=True)]
    np.testing.assert_allclose(TrueSurface(HEIGHTS).height(tx, ty), expected, rtol=1e-12)


def test_nothing_lies_outside_the_hull_of_the_centres() -> None:
    surface = TrueSurface(HEIGHTS)
    tx, ty = np.array([0.49, 8.51, 4, 4, np.nan]), np.array([3, 3, 0.49, 6.51, 3])
    assert np.isnan(surface.height(tx, ty)).all()
    assert not surface.exists(tx, ty).any()
    np.testing.assert_array_equal(surface.inside(tx, ty, 0.02), [True, True, True, True, False])
    assert np.isfinite(surface.height([0.5, 8.5], [0.5, 6.5])).all()


def test_gradient_is_the_slope_within_a_cell() -> None:
    surface = TrueSurface(HEIGHTS)
    tx = RNG.integers(0, 8, 100) + RNG.uniform(0.6, 1.4, 100)
    ty = RNG.integers(0, 6, 100) + RNG.uniform(0.6, 1.4, 100)
    dx, dy = surface.gradient(tx, ty)
    h = 1e-5
    np.testing.assert_allclose(dx, (surface.height(tx + h, ty) - surface.height(tx - h, ty)) / (2 * h), rtol=1e-5)
    np.testing.assert_allclose(dy, (surface.height(tx, ty + h) - surface.height(tx, ty - h)) / (2 * h), rtol=1e-5)


@pytest.mark.parametrize("dtype", [np.int16, np.uint16, np.int32, np.float32])
def test_number_types_keep_their_values(dtype: type) -> None:
    heights = RNG.integers(0, 4000, (5, 5)).astype(dtype)
    assert TrueSurface(heights).height(2.5, 3.5) == heights[3, 2]


def test_invalid_samples_are_filled_by_their_valid_neighbours() -> None:
    heights = HEIGHTS.copy()
    heights[2, 3] = np.nan
    heights[0, 0] = np.inf
    heights[4:7, 5:8] = np.nan
    surface = TrueSurface(heights)
    around = np.delete(HEIGHTS[1:4, 2:5].ravel(), 4)
    assert surface.filled[2, 3] == pytest.approx(around.mean())
    assert surface.filled[0, 0] == pytest.approx(np.mean([HEIGHTS[0, 1], HEIGHTS[1, 0], HEIGHTS[1, 1]]))
    assert surface.filled[4, 5] == pytest.approx(np.mean([*HEIGHTS[3, 4:7], HEIGHTS[4, 4], HEIGHTS[5, 4]]))
    # the middle of the hole has its upper neighbours invalid too, and nothing to be filled from
    assert np.isnan(surface.filled[5, 6])
    np.testing.assert_array_equal(surface.filled[surface.valid], HEIGHTS[surface.valid])


def test_the_surface_exists_where_half_is_covered() -> None:
    heights = HEIGHTS.copy()
    heights[:, 4] = np.nan
    surface = TrueSurface(heights)
    np.testing.assert_array_equal(surface.exists([3.9, 4.0, 4.1, 4.9, 5.1], 3.2), [True, True, False, False, True])
    tx, ty = RNG.uniform(0.5, 8.5, 100), RNG.uniform(0.5, 6.5, 100)
    expected = [bilinear(surface.valid.astype(float), *at) for at in zip(tx, ty, strict=True)]
    np.testing.assert_allclose(surface.coverage(tx, ty), expected, atol=1e-12)
    # a valid corner is not spoilt by an empty cell beside it
    assert np.isfinite(surface.height(3.5, 3.5))


def test_wherever_the_surface_exists_it_has_a_height() -> None:
    heights = np.where(RNG.random((40, 40)) < 0.4, np.nan, RNG.normal(size=(40, 40)))
    surface = TrueSurface(heights)
    tx, ty = RNG.uniform(0.5, 39.5, (2, 5000))
    exists = surface.exists(tx, ty)
    assert 0.2 < exists.mean() < 0.9
    assert np.isfinite(surface.height(tx, ty)[exists]).all()


def test_a_single_sample_is_a_surface() -> None:
    assert TrueSurface([[7.0]]).height(0.5, 0.5) == 7
    assert np.isnan(TrueSurface([[7.0]]).height(0.6, 0.5))


@pytest.mark.parametrize("shape", [(3,), (0, 4), (2, 2, 2)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(SourceError, match=r"expected heights of shape \(rows, columns\)"):
        TrueSurface(np.zeros(shape))
