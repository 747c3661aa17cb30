"""Level-0 samples for meshes: exact inside the raster, voids filled, continued beyond it by odd reflection."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.compare.truth import TrueSurface
from orogen.gpu import Gpu
from orogen.pyramid.open import open_pyramid
from orogen.source.open import open_height
from orogen.streaming.layer import Layer
from orogen.streaming.samples import Positions, Samples
from orogen.streaming.settings import ClipmapSettings


def ground(rows: int, columns: int, voids: bool = False) -> NDArray[np.float32]:
    random = np.random.default_rng(rows)
    heights = random.uniform(0, 100, (rows, columns)).astype(np.float32)
    if voids:
        heights[random.random(heights.shape) < 0.3] = np.nan
    return heights


@pytest.fixture
def samples_of(gpu: Gpu) -> Iterator[object]:
    layers: list[Layer] = []

    def make(heights: NDArray[np.float32]) -> Samples:
        pyramid = open_pyramid(open_height(heights, spacing=10.0))
        layers.append(Layer(gpu, pyramid, ClipmapSettings(), 8 << 20, 8 << 20))
        return Samples(layers[-1])

    yield make
    for layer in layers:
        with closing(layer.pyramid), closing(layer):
            pass


@pytest.mark.parametrize(("rows", "columns"), [(40, 57), (2, 3), (300, 4), (1, 9)])
def test_positions_beyond_the_raster_reflect_it(samples_of, rows: int, columns: int) -> None:
    heights = ground(rows, columns)
    samples = samples_of(heights)
    more = 37
    np.testing.assert_array_equal(samples.at(np.arange(rows), np.arange(columns)), heights)
    padded = heights.astype(np.float64)
    for axis, size in enumerate((rows, columns)):
        width = [(0, 0), (0, 0)]
        width[axis] = (0, more)
        # an axis of one sample has no slope to go on with
        padded = np.pad(padded, width, "reflect", reflect_type="odd") if size > 1 else np.pad(padded, width, "edge")
    found = samples.at(np.arange(rows + more), np.arange(columns + more))
    np.testing.assert_allclose(found, padded, rtol=1e-5, atol=0.02)
    some, others = np.array([0, rows + 5, rows + 30]), np.array([0, 2, columns + 7, columns + 30])
    np.testing.assert_allclose(samples.at(some, others), padded[np.ix_(some, others)], rtol=1e-5, atol=0.02)


def test_planes_go_on_exactly(samples_of) -> None:
    row, column = np.mgrid[:90, :90]
    plane = (1.25 * column - 2.75 * row + 700).astype(np.float32)
    samples = samples_of(plane[:23, :31])
    np.testing.assert_array_equal(samples.at(np.arange(90), np.arange(90)), plane)


def test_only_what_is_needed_is_read() -> None:
    needed = Positions.of(np.array([600, 632, 664]), 1000).needed
    np.testing.assert_array_equal(needed, [600, 632, 664])
    needed = Positions.of(np.array([960, 992, 1024, 1056]), 1000).needed
    np.testing.assert_array_equal(needed, [942, 960, 974, 992, 999])


def test_voids_are_filled_as_the_true_surface_fills_them(samples_of) -> None:
    heights = ground(280, 300, voids=True)
    samples, surface = samples_of(heights), TrueSurface(heights)
    for rows, cols in ((slice(0, 280), slice(0, 300)), (slice(100, 133), slice(240, 270)), (slice(5, 6), slice(7, 8))):
        found, valid = samples.window(rows, cols)
        known = np.isfinite(surface.filled[rows, cols])
        np.testing.assert_allclose(found[known], surface.filled[rows, cols][known], rtol=1e-5)
        assert np.isfinite(found).all()
        if valid is not None:
            np.testing.assert_array_equal(valid, np.isfinite(heights[rows, cols]))
