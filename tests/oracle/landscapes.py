"""Seeded height fields for the tests of measures and algorithms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def hills(size: int, relief: float, seed: int = 3) -> NDArray[np.float64]:
    """(size, size) smooth hills and valleys of about `relief` metres, waves down to 1/16 of the side."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size] / (size - 1)
    heights = np.zeros((size, size))
    for _ in range(40):
        frequency, angle, phase = rng.uniform(1, 16), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
        wave = np.cos(angle) * x + np.sin(angle) * y
        heights += np.sin(2 * np.pi * frequency * wave + phase) / frequency
    return (heights - heights.min()) / np.ptp(heights) * relief
