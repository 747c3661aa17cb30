"""Whether rays slip through: random ones, and ones along and through the places where cells and nodes meet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.keys import NODE_SIZE
from orogen.lod.raycast.probe import Probe
from orogen.streaming.clipmap_view import ClipmapView

_BATCH = 1 << 18


def lost_rays(probe: Probe, view: ClipmapView, frame: Frame, count: int, seed: int = 0) -> int:
    """How many of `count` rays from above the terrain to below it meet nothing: 0 where the surface is watertight.

    A quarter of the rays each: anywhere; through cell corners; along cell borders; along node borders. `view` has been
    updated for `frame`. Raises SettingsError for terrain with missing data, which rays may pass.
    """
    if not view.clipmap.heights.covered:
        raise SettingsError("lost_rays: expected terrain without missing data; rays pass through holes")
    random = np.random.default_rng(seed)
    lost = 0
    for first in range(0, count, _BATCH):
        start, end = crossing_rays(frame, min(_BATCH, count - first), random)
        lost += int(np.isnan(probe.cast(view, start, end - start, 0.0, 1.0).t).sum())
    return lost


def crossing_rays(
    frame: Frame, count: int, random: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts above and ends below all terrain, (count, 3) camera-relative metres each, both over the samples' hull."""
    size = np.array([frame.grid.width - 1.0, frame.grid.height - 1.0])
    # positions in samples from the first one's centre; paths from steep to as flat as the data is wide
    start = random.uniform(0, size, (count, 2))
    way = random.normal(size=(count, 2)) * 10 ** random.uniform(-3, np.log10(size.max() + 1), (count, 1))
    kind = np.arange(count) % 4
    corner = kind == 1
    middle = np.round(start)
    start, end = np.where(corner[:, None], middle - way, start), np.where(corner[:, None], middle + way, start + way)
    axis = random.integers(0, 2, count)
    # nodes meet half a sample past a multiple of their size
    lines = {2: np.round(start), 3: np.round(start / NODE_SIZE) * NODE_SIZE - 0.5}
    for which, line in lines.items():
        rows = np.flatnonzero(kind == which)
        start[rows, axis[rows]] = end[rows, axis[rows]] = line[rows, axis[rows]]
    # rounding may carry what lies on the border itself outside
    start, end = (np.clip(part, 0.001, size - 0.001) for part in (start, end))
    low, high = frame.height_range
    margin = 0.01 * (high - low) + 1.0
    return _placed(frame, start, high + margin), _placed(frame, end, low - margin)


def _placed(frame: Frame, sample: NDArray[np.float64], height: float) -> NDArray[np.float64]:
    flat = (sample + 0.5 - frame.eye) @ frame.grid.metres.T
    drop = frame.curvature_factor * (flat**2).sum(axis=1)
    up = (height - frame.camera.z / frame.exaggeration) * frame.exaggeration - drop
    return np.column_stack([flat, up])
