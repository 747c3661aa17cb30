"""What `orogen bench` measures of data without preparation: a large file with overviews, and endless terrain."""

from __future__ import annotations

import itertools
import math
import statistics
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orogen.cli.console import Report

if TYPE_CHECKING:
    from orogen.camera import Camera
    from orogen.cli.measure import Figure
    from orogen.terrain import Terrain

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
ENDLESS: dict[str, dict[str, Any]] = {"udlod": {"pixels_per_quad": 1.0}, "raycast": {}}
"""Algorithms that are timed over endless terrain, and their settings."""
SOFTWARE_SIZE = (480, 270)
"""Size of their pictures with a software driver, which takes half a minute for a frame of 1920 x 1080."""


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
    from orogen.camera import Camera
    from orogen.cli.measure import LARGE, SIZE, Figure
    from orogen.terrain import open_terrain

    raster, title = folder / LARGE, "Endless terrain"
    if not raster.exists():
        return [Figure(title, "cost of a frame", None, note=f"no {LARGE}")]
    sites = {"procedural": (0.92, 0.21), str(raster): (0.5, 0.55)}
    costs = []
    with ExitStack() as stack:
        report(0.0, title)
        terrains = [stack.enter_context(open_terrain(data, build="wait", gpu_memory=None)) for data in sites]
        size, frames = (SOFTWARE_SIZE, 3) if terrains[0].renderer.gpu.info.kind == "cpu" else (SIZE, 16)
        work = list(itertools.product(ENDLESS.items(), HEIGHTS.items()))
        for done, ((algorithm, settings), (view, (above, pitch))) in enumerate(work):
            report(done / len(work), title)
            flights = []
            for terrain, (right, down) in zip(terrains, sites.values(), strict=True):
                terrain.use(algorithm, **settings)
                grid = terrain.grid
                x, y = (float(n) for n in grid.to_crs(right * grid.width, down * grid.height))
                z = terrain.height_at(x, y) + above * grid.spacing
                start = Camera(x=x, y=y, z=z, heading=20.0, pitch=pitch)
                flights.append([start.moved(heading=20.0 + 0.1 * n) for n in range(frames)])
            # one right after the other: what else the machine does is the same for both
            own, other = (_cost(terrain, flight, size) for terrain, flight in zip(terrains, flights, strict=True))
            costs.append((f"{size[0]}x{size[1]}, {algorithm}, {view}", own, other))
    figures = []
    for name, own, other in costs:
        group = f"{title} against Taiwan {name}"
        figures += [
            Figure(group, "GPU passes", _ratio(own.passes, other.passes), "times", 1.1),
            Figure(group, "GPU passes, endless", own.passes, "ms"),
            Figure(group, "GPU passes without shading", _ratio(own.geometry, other.geometry), "times", 1.1),
            Figure(group, "CPU to record", own.recording / other.recording, "times"),
            Figure(group, "triangles", own.triangles / other.triangles if other.triangles else 1.0, "times"),
        ]
    return figures


def _ratio(one: float, other: float) -> float:
    """One time over another; NaN where the adapter tells no times."""
    return one / other if other else math.nan


@dataclass(frozen=True)
class _Cost:
    """Medians over the frames of a short flight."""

    passes: float
    """Milliseconds of the GPU's passes."""
    geometry: float
    """The same without shading."""
    recording: float
    """Milliseconds of the CPU."""
    triangles: int
    """Triangles drawn."""


def _cost(terrain: Terrain, flight: Sequence[Camera], size: tuple[int, int]) -> _Cost:
    """Medians over the second half of a flight: its first frames make pipelines, and what nodes need for the sun."""
    timings = terrain.renderer.time_frames(flight, size)[len(flight) // 2 :]
    times = [timing.gpu_times for timing in timings]
    return _Cost(
        statistics.median(sum(passes.values()) for passes in times),
        statistics.median(sum(passes.values()) - passes.get("shade", 0.0) for passes in times),
        1000 * statistics.median(timing.record_time for timing in timings),
        terrain.render(flight[0], size, samples=1).statistics.triangles,
    )
