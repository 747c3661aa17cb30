"""Smooth interpolation between the keyframes of a flight."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Spline:
    """Piecewise cubic through `values` (n, k) at increasing `times` (n,), with a continuous velocity (C1).

    Free: the velocity at a key is that of the parabola through it and its neighbours (quadratics are kept exactly);
    where all k values rest between two keys, the velocity is zero at both, so that a pause is a pause.
    Bounded: every value stays between those of the neighbouring keys, and turns only at keys (monotone piecewise cubic
    interpolation of Fritsch and Butland, A method for constructing local monotone piecewise cubic interpolants, 1984).
    """

    def __init__(self, times: ArrayLike, values: ArrayLike, bounded: bool = False) -> None:
        self.times = np.asarray(times, np.float64)
        self.values = np.asarray(values, np.float64)
        steps = np.diff(self.times)[:, None]
        slopes = np.diff(self.values, axis=0) / steps
        self.velocities = _bounded(steps, slopes) if bounded else _free(steps, slopes)

    def __call__(self, t: ArrayLike) -> NDArray[np.float64]:
        """Values (k,) at the time t, or (m, k) at m times; times outside are taken as the first or the last one."""
        t = np.clip(np.asarray(t, np.float64), self.times[0], self.times[-1])
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        step = (self.times[i + 1] - self.times[i])[..., None]
        s = (t - self.times[i])[..., None] / step
        a, b = self.values[i], self.values[i + 1]
        # the cubic as a correction of the straight line: exact at both ends whatever the magnitude of a and b
        bend = (1 - s) * (step * self.velocities[i] - (b - a)) - s * (step * self.velocities[i + 1] - (b - a))
        return np.where(s == 1, b, a + s * (b - a) + s * (1 - s) * bend)


def _free(h: NDArray[np.float64], d: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(d) == 1:
        return np.repeat(d, 2, axis=0)
    inner = (h[1:] * d[:-1] + h[:-1] * d[1:]) / (h[:-1] + h[1:])
    velocities = np.concatenate([_end(h, d), inner, _end(h[::-1], d[::-1])])
    still = np.flatnonzero((d == 0).all(axis=1))
    velocities[still] = velocities[still + 1] = 0
    return velocities


def _bounded(h: NDArray[np.float64], d: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(d) == 1:
        return np.repeat(d, 2, axis=0)
    before, after = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        harmonic = (before + after) / (before / d[:-1] + after / d[1:])
    inner = np.where(d[:-1] * d[1:] > 0, harmonic, 0)
    return np.concatenate([_bounded_end(h, d), inner, _bounded_end(h[::-1], d[::-1])])


def _end(h: NDArray[np.float64], d: NDArray[np.float64]) -> NDArray[np.float64]:
    """(1, k): velocity at the first key of the parabola through the first three."""
    return (((2 * h[0] + h[1]) * d[0] - h[0] * d[1]) / (h[0] + h[1]))[None]


def _bounded_end(h: NDArray[np.float64], d: NDArray[np.float64]) -> NDArray[np.float64]:
    velocity = _end(h, d)
    velocity = np.where(velocity * d[0] > 0, velocity, 0)
    # a cubic is monotone while its end velocity is at most three times the slope
    return np.where((d[0] * d[1] < 0) & (np.abs(velocity) > 3 * np.abs(d[0])), 3 * d[0], velocity)
