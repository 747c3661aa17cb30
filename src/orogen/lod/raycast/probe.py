"""Rays against the resident terrain, for questions that are not about pixels: picking, lines of sight, tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

_RAY = np.dtype([("origin", "f4", 3), ("start", "f4"), ("direction", "f4", 3), ("end", "f4")])
_HIT = np.dtype([("t", "f4"), ("height", "f4"), ("level", "u4"), ("padding", "u4")])
_GROUP = 64
_BATCH = 1 << 18
_FARTHEST = 1e30


@dataclass(frozen=True)
class Hits:
    """Where rays first meet the surface."""

    t: NDArray[np.float32]
    """(n,) parameter along the ray, in units of its direction; NaN for a miss."""
    height: NDArray[np.float32]
    """(n,) metres of the data (exaggeration and curvature undone); NaN for a miss."""
    level: NDArray[np.int32]
    """(n,) level of the data that was hit; -1 for a miss."""


class Probe:
    """Casts lists of rays into what is resident, by the traversal that `raycast` draws with."""

    def __init__(self, clipmap: Clipmap) -> None:
        self._clipmap = clipmap
        gpu = clipmap.gpu
        self._layout = gpu.layout("probe", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")})
        shader = gpu.shader(
            "probe", Path(__file__).parent / "probe.wgsl", search=SEARCH, constants=clipmap.constants
        )  # fmt: skip
        self._pipeline = gpu.compute("probe", shader, "cast_probes", [clipmap.layout, self._layout])

    def cast(
        self, view: ClipmapView, origins: ArrayLike, directions: ArrayLike, start: float = 0.0, end: float = _FARTHEST
    ) -> Hits:
        """First hits of rays origin + t direction with start <= t <= end; waits for the GPU.

        origins, directions: (n, 3) metres (east, north, up) relative to the camera of the frame that `view` was last
        updated for; rounded to float32. Directions need not be of unit length. A ray that starts under the surface
        meets it from below.
        """
        origins, directions = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
        rays = np.zeros(len(origins), _RAY)
        rays["origin"], rays["direction"], rays["start"], rays["end"] = origins, directions, start, end
        parts = [self._cast(view, rays[first : first + _BATCH]) for first in range(0, len(rays), _BATCH)]
        hits = np.concatenate(parts) if parts else np.zeros(0, _HIT)
        found = hits["t"] >= np.float32(start)
        nothing = np.float32(np.nan)
        return Hits(
            np.where(found, hits["t"], nothing),
            np.where(found, hits["height"], nothing),
            np.where(found, hits["level"].astype(np.int32), -1),
        )

    def _cast(self, view: ClipmapView, rays: NDArray[np.void]) -> NDArray[np.void]:
        gpu = self._clipmap.gpu
        given = gpu.buffer("probe rays", rays, "STORAGE", "probe")
        hits = gpu.buffer("probe hits", _HIT.itemsize * len(rays), "STORAGE|COPY_SRC", "probe")
        encoder = gpu.encoder("probe")
        run = encoder.begin_compute_pass(label="probe")
        run.set_pipeline(self._pipeline)
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, gpu.bind("probe", self._layout, {0: given, 1: hits}))
        run.dispatch_workgroups(-(-len(rays) // _GROUP))
        run.end()
        result = gpu.read_buffer(hits, dtype=_HIT, encoder=encoder)
        gpu.submit(encoder)
        found = result.result()
        given.destroy()
        hits.destroy()
        return found
