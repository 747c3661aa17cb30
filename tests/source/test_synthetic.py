"""The built-in terrain: the same each time, drained by rivers, kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orogen.errors import SourceError
from orogen.source import erosion, open_height
from orogen.source.synthetic import synthetic


def test_it_is_deterministic_and_differs_by_seed() -> None:
    first = erosion.eroded(129, 3, 100)
    np.testing.assert_array_equal(first, erosion.eroded(129, 3, 100))
    assert np.abs(first - erosion.eroded(129, 4, 100)).max() > 50


def test_it_is_a_mountain_range() -> None:
    heights = erosion.eroded(257, 7, 240)
    assert heights.shape == (257, 257)
    assert heights.dtype == np.float32
    assert np.isfinite(heights).all()
    assert 500 < heights.max() < 5000
    slopes = np.hypot(*np.gradient(heights, 240))
    assert slopes.max() < 2
    # high in the middle, low at the upper and lower rim
    assert heights[96:160].mean() > 3 * heights[[0, 1, -2, -1]].mean()


def test_nearly_every_sample_drains() -> None:
    heights = erosion.eroded(257, 7, 240).astype(np.float64)
    inner = heights[1:-1, 1:-1]
    neighbours = [heights[1 + i : 256 + i, 1 + j : 256 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    pits = (inner < np.min(neighbours, axis=0)).mean()
    rough = np.random.default_rng(1).normal(size=heights.shape)
    noise = [rough[1 + i : 256 + i, 1 + j : 256 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    assert pits < 0.2 * (rough[1:-1, 1:-1] < np.min(noise, axis=0)).mean()


def test_upstream_area_adds_up_along_the_tree() -> None:
    rng = np.random.default_rng(5)
    count = 500
    receiver = np.array([0, *(rng.integers(0, i) for i in range(1, count))], np.int32)
    expected = np.ones(count)
    for i in range(count - 1, 0, -1):
        expected[receiver[i]] += expected[i]
    np.testing.assert_allclose(erosion.upstream(receiver, 1.0), expected, rtol=1e-6)


def test_the_implicit_step_solves_its_equation() -> None:
    rng = np.random.default_rng(6)
    count = 500
    receiver = np.array([0, *(rng.integers(0, i) for i in range(1, count))], np.int32)
    heights = rng.uniform(0, 1000, count).astype(np.float32)
    rate = np.append(0, rng.uniform(0, 5, count - 1)).astype(np.float32)
    expected = heights.astype(np.float64)
    for i in range(1, count):
        expected[i] = (heights[i] + rate[i] * expected[receiver[i]]) / (1 + rate[i])
    np.testing.assert_allclose(erosion.lowered(heights, rate, receiver), expected, rtol=1e-5)


def test_it_is_made_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path))
    first = synthetic(129)
    window = slice(0, 129), slice(0, 129)
    monkeypatch.setattr(erosion, "eroded", None)  # a second call would fail
    np.testing.assert_array_equal(synthetic(129).read(*window), first.read(*window))
    assert first.grid.spacing == pytest.approx(30)
    assert first.fingerprint == synthetic(129).fingerprint


def test_a_damaged_copy_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path))
    first = synthetic(129)
    (kept,) = tmp_path.glob("*/heights.npy")
    kept.write_bytes(kept.read_bytes()[:1000])
    window = slice(0, 129), slice(0, 129)
    np.testing.assert_array_equal(synthetic(129).read(*window), first.read(*window))


def test_it_opens_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(erosion, "eroded", lambda size, seed, spacing: np.ones((size, size), np.float32))
    assert open_height("synthetic").grid.shape == (2049, 2049)


@pytest.mark.parametrize("options", [{"size": 1}, {"size": 100_000}, {"spacing": 0}])
def test_sizes_and_spacings_out_of_range_are_refused(options: dict[str, int]) -> None:
    with pytest.raises(SourceError, match="synthetic: expected"):
        synthetic(**options)
