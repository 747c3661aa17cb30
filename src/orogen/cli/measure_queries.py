"""How long questions to the surface take: a part of `orogen bench`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from orogen.cli.console import Report
from orogen.cli.measure import Figure
from orogen.terrain import Terrain, open_terrain


def measure(crops: Sequence[tuple[str, Any, float]], report: Report) -> list[Figure]:
    """Heights at a million points, rays, and rasters of what is seen, all tiles decoded.

    crops: name, heights and spacing of each.
    """
    figures = []
    for title, heights, spacing in crops:
        with open_terrain(heights, spacing=spacing) as terrain:
            group = f"queries, {title} {terrain.shape[1]} x {terrain.shape[0]}"
            work = _work(terrain)
            for done, (name, ask, target) in enumerate(work):
                report(done / len(work), group)
                if "of all samples" not in name:
                    ask()  # reads the tiles, and compiles
                start = time.perf_counter()
                ask()
                figures.append(Figure(group, name, time.perf_counter() - start, "s", target))
            report(1.0, group)
    return figures


def _work(terrain: Terrain) -> list[tuple[str, Callable[[], object], float | None]]:
    """Names of questions, what asks them, and seconds that they may take."""
    asked, rng = terrain.queries, np.random.default_rng(0)
    left, bottom, right, top = terrain.bounds
    x, y = rng.uniform(left, right, 10**6), rng.uniform(bottom, top, 10**6)
    down = rng.normal(size=(10**5, 3)) * (1, 1, 0.2) - (0, 0, 0.2)
    place, above = ((left + right) / 2, (bottom + top) / 2), terrain.height_range[1]
    return [
        ("10^6 heights", lambda: asked.height_at(x, y), 1.0),
        ("10^6 normals", lambda: asked.normal_at(x, y), None),
        ("10^5 rays", lambda: asked.raycast((*place, above), down), None),
        ("viewshed of all samples", lambda: asked.viewshed(place, height=30.0).values(), None),
        ("shadow of all samples", lambda: asked.shadow((315.0, 20.0)).values(), None),
        ("slope of all samples", lambda: asked.slope().values(), None),
    ]
