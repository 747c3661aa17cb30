"""What `orogen bench` measures of data without preparation: a large file with overviews, and endless terrain."""

from __future__ import annotations

import math
import statistics
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orogen.cli.console import Report

if TYPE_CHECKING:
    from orogen.cli.measure import Figure

SAMPLES = 72_000
"""Rows and columns of the large file: 10 GB of int16."""
RELIEF = 4096
"""Rows and columns of the ground in its middle; the rest is nodata, which takes no room on disk."""
FIRST_PICTURE = """
import json, sys, time
start = time.perf_counter()
from pathlib import Path
import orogen, wgpu
raster, middle, distance = sys.argv[1], json.loads(sys.argv[2]), float(sys.argv[3])
size = 1280, 720
with orogen.open(raster) as terrain:
    camera = terrain.camera(look_at=middle, distance=distance)
    usage = wgpu.TextureUsage.RENDER_ATTACHMENT
    target = terrain.device.create_texture(size=(*size, 1), format="rgba8unorm", usage=usage)
    # a small picture asks for nodes; the next one shows the coarsest
    terrain.draw_to(target.create_view(), camera, (16, 9))
    clipmap = terrain.renderer.clipmap
    while not clipmap.heights.present:
        clipmap.heights.wait(0.1)
        clipmap.pump()
    terrain.draw_to(target.create_view(), camera, size)
    terrain.renderer.gpu.wait()
    first = time.perf_counter() - start
    picture = terrain.render(camera, size, samples=1)
    seconds, counters = time.perf_counter() - start, Path("/proc/self/io")
    read = int(counters.read_text().split()[1]) if counters.exists() else None
result = {"first": first, "seconds": seconds, "read": read}
sys.stdout.write(json.dumps(result))
"""
HEIGHTS = {"low": (300.0, -10.0), "middle": (1000.0, -30.0), "high": (3000.0, -80.0)}
"""Samples above the ground, and pitch, of cameras over endless terrain and over Taiwan, which is to fill the view."""


def large(report: Report) -> list[Figure]:
    """The first picture of a 10 GB file with overviews, from the start of a process with an empty cache."""
    from orogen.cli.measure import MB, Figure, run_python

    group = "10 GB GeoTIFF with overviews"
    figures = []
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        report(0.0, f"writing the {group}")
        raster, middle = _write(place / "large.tif")
        for number, (view, distance) in enumerate((("near", 10_000.0), ("the whole relief", 80_000.0))):
            report(0.8 + 0.1 * number, group)
            arguments = [str(raster), str(list(middle)), str(distance)]
            facts = run_python(["-c", FIRST_PICTURE, *arguments], place)
            figures.append(Figure(group, f"first picture, {view}", facts["first"], "s", 3))
            figures.append(Figure(group, f"complete picture, {view}", facts["seconds"], "s"))
            read = None if facts["read"] is None else facts["read"] / MB
            figures.append(Figure(group, f"read by the process, {view}", read, "MB", note="this system does not tell"))
    report(1.0, group)
    return figures


def _write(raster: Path) -> tuple[Path, tuple[float, float]]:
    """A sparse GeoTIFF with overviews beside it, and the middle of its relief in its CRS."""
    import numpy as np
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.transform import from_origin

    from orogen.pyramid.reduce import height_means
    from orogen.source.procedural import ProceduralSource

    transform = from_origin(300_000, 3_000_000, 10, 10)
    profile: dict[str, Any] = {
        "driver": "GTiff", "count": 1, "dtype": "int16", "nodata": -32768, "tiled": True, "blockxsize": 512,
        "blockysize": 512, "compress": "DEFLATE", "BIGTIFF": "YES", "SPARSE_OK": True, "crs": "EPSG:32651",
    }  # fmt: skip
    # steep enough for 10 m between samples
    heights = ProceduralSource().levels.read(3, slice(98_000, 98_000 + RELIEF), slice(480_000, 480_000 + RELIEF))
    # the first overview is a file of its own, so that nobody has to read all that is empty to make it
    beside = raster.with_name(raster.name + ".ovr")
    for path, step, ground in ((raster, 1, heights), (beside, 4, height_means(height_means(heights)))):
        size, first = SAMPLES // step, (SAMPLES - RELIEF) // 2 // step
        part = (first, first + RELIEF // step)
        place = transform * rasterio.Affine.scale(step)
        with rasterio.open(path, "w", width=size, height=size, transform=place, **profile) as file:
            file.write(np.rint(ground).astype(np.int16), 1, window=(part, part))
    with rasterio.Env(SPARSE_OK_OVERVIEW="YES"), rasterio.open(beside, "r+") as file:
        file.build_overviews([4, 16], Resampling.average)
    x, y = transform * (SAMPLES / 2, SAMPLES / 2)
    return raster, (float(x), float(y))


def endless(folder: Path, report: Report) -> list[Figure]:
    """The same flights over 2^22 x 2^22 samples and over Taiwan: what a frame costs, and what is drawn."""
    from orogen.cli.measure import LARGE, SIZE, Figure

    raster, title = folder / LARGE, "Endless terrain"
    if not raster.exists():
        return [Figure(title, "cost of a frame", None, note=f"no {LARGE}")]
    places = {"procedural": (0.92, 0.79), str(raster): (0.5, 0.45)}
    figures = []
    for number, algorithm in enumerate(("udlod", "raycast")):
        costs: dict[str, dict[str, tuple[float, float, int, float]]] = {}
        for step, (data, place) in enumerate(places.items()):
            report((2 * number + step) / 4, f"{title}, {algorithm}")
            costs[data] = _costs(data, place, algorithm)
        for view in HEIGHTS:
            own, other = (costs[data][view] for data in places)
            group = f"{title} against Taiwan {SIZE[0]}x{SIZE[1]}, {algorithm}, {view}"
            figures += [
                Figure(group, "GPU passes", own[0] / other[0] if other[0] else math.nan, "times", 1.1),
                Figure(group, "GPU passes, endless", own[0], "ms"),
                Figure(group, "GPU passes without shading", own[3] / other[3] if other[3] else math.nan, "times", 1.1),
                Figure(group, "CPU to record", own[1] / other[1], "times"),
                Figure(group, "triangles", own[2] / other[2] if other[2] else 1.0, "times"),
            ]
    return figures


def _costs(data: str, place: tuple[float, float], algorithm: str) -> dict[str, tuple[float, float, int, float]]:
    """Of frames of a short flight, by height: ms of the GPU's passes, of the CPU, triangles, ms without shading."""
    from orogen.camera import Camera
    from orogen.cli.measure import SIZE
    from orogen.terrain import open_terrain

    result = {}
    settings = {"pixels_per_quad": "1"} if algorithm == "udlod" else {}
    with open_terrain(data, algorithm=algorithm, settings=settings, build="wait", gpu_memory=None) as terrain:
        grid = terrain.grid
        x, y = (float(n) for n in grid.to_crs(place[0] * grid.width, (1 - place[1]) * grid.height))
        ground, step = terrain.height_at(x, y), grid.spacing
        for view, (above, pitch) in HEIGHTS.items():
            start = Camera(x=x, y=y, z=ground + above * step, heading=20.0, pitch=pitch)
            flight = [start.moved(heading=20.0 + 0.1 * n) for n in range(5)]
            timings = terrain.renderer.time_frames(flight, SIZE)[1:]
            triangles = terrain.render(start, SIZE, samples=1).statistics.triangles
            passes = statistics.median(sum(timing.gpu_times.values()) for timing in timings)
            geometry = statistics.median(
                sum(timing.gpu_times.values()) - timing.gpu_times.get("shade", 0.0) for timing in timings
            )
            recording = 1000 * statistics.median(timing.record_time for timing in timings)
            result[view] = passes, recording, triangles, geometry
    return result
