"""What `orogen bench` measures.

What counts from the start of a process is measured on processes of their own, with a cache of their own.
"""

from __future__ import annotations

import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orogen.cli.console import Report
from orogen.errors import OrogenError

LARGE = "taiwan_20m_10481x19401_int16.tif"
FAST = ("udlod", "raycast", "hybrid")
"""Algorithms whose passes are timed on all crops."""
IN_MEMORY = ("udlod", "raycast")
"""Algorithms whose GPU memory is measured."""
SIZE = (1920, 1080)
MB = 1e6

PINNED: dict[str, Any] = {"view_distance": math.inf, "memory": 2 << 30, "host_memory": 1 << 30}
"""Settings that keep all of level 0 resident."""

CAMERAS: dict[str, tuple[str, ...]] = {
    "whole": (),
    "near": ("--look-at", "13480000,2720000", "--distance", "4000", "--pitch", "-15"),
    "down": ("--look-at", "13460000,2650000", "--distance", "30000", "--pitch", "-90"),
    "low": ("--look-at", "13470000,2690000", "--distance", "1500", "--pitch", "-3", "--heading", "20"),
}
"""Views of the large raster under which time and memory are measured."""


@dataclass(frozen=True)
class Figure:
    """Something measured."""

    group: str
    """What it belongs to."""
    name: str
    """What was measured."""
    value: float | None
    """How much; None where it could not be measured."""
    unit: str = ""
    """Unit of value and target."""
    target: float | None = None
    """What it must not exceed; None: it only informs."""
    note: str = ""
    """Why there is no value, or what else is to be known."""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without a target or a value."""
        return None if self.target is None or self.value is None else self.value <= self.target


def speed(folder: Path, report: Report) -> list[Figure]:
    """Pictures of the large raster from the start of a process: coarse without a cache, complete with one."""
    group, raster = "Taiwan 1920x1080", folder / LARGE
    if not raster.exists():
        return [Figure(group, "time and memory", None, note=f"no {LARGE}")]
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        report(0.0, group)
        seconds, facts = _render(raster, place, "--coarse")
        figures = [Figure(group, "coarse picture without a cache", seconds, "s", 5)]
        run_python(["-c", BUILD, str(raster)], place)
        pictures = [facts]
        for number, (view, options) in enumerate(CAMERAS.items(), start=1):
            report(number / (len(CAMERAS) + 1), group)
            seconds, facts = _render(raster, place, *options)
            figures.append(Figure(group, f"complete picture, {view}", seconds, "s", 5))
            pictures.append(facts)
        figures.append(_memory(group, "peak resident memory, worst view", [p["memory"] for p in pictures], 1000))
        for name in IN_MEMORY:
            report(0.9, f"{group}, {name}")
            used = [_render(raster, place, "--algorithm", name, *options)[1] for options in CAMERAS.values()]
            sizes = [facts["gpu_memory"] for facts in used]
            figures.append(_memory(group, f"GPU allocations, {name}, worst view", sizes, 400))
        heights = [facts["heights"] for facts in used]
        sizes = [nodes["nodes"] * nodes["node_bytes"] for nodes in heights]
        figures.append(_memory(group, "heights that a picture needs, worst view", sizes, None))
        note = f"bits a height, off by {heights[0]['loss']:g} m at level 0"
        figures.append(Figure(group, "heights in the atlas", heights[0]["bits"], note=note))
        report(1.0, group)
    return figures


def pyramid(folder: Path, report: Report) -> list[Figure]:
    """Building the pyramid of the large raster, against GDAL's COG driver at its best settings."""
    group, raster = "Pyramid of Taiwan", folder / LARGE
    if not raster.exists():
        return [Figure(group, "time and memory", None, note=f"no {LARGE}")]
    report(0.0, group)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        built = run_python(["-c", BUILD, str(raster)], place)
        report(0.5, group)
        cog = run_python(["-c", COG, str(raster), str(place / "cog.tif")], place)
    report(1.0, group)
    return [
        Figure(group, "time to build", built["seconds"], "s", cog["seconds"]),
        Figure(group, "GDAL's COG driver, ZSTD level 1, predictor, average, 2 threads", cog["seconds"], "s"),
        Figure(group, "processor time to build", built["cpu"], "s", cog["cpu"]),
        Figure(group, "processor time of GDAL's COG driver", cog["cpu"], "s"),
        _memory(group, "peak resident memory", [built["memory"]], 400),
    ]


def record(folder: Path, report: Report) -> list[Figure]:
    """CPU time to record and submit a frame, while the camera moves over what is resident."""
    from orogen.lod import algorithms
    from orogen.terrain import open_terrain

    group, frames = "Recording a frame", 30
    figures = []
    with open_terrain(_small(folder), build="wait") as terrain:
        camera = terrain.camera()
        for name in algorithms():
            terrain.use(name)
            step = abs(terrain.grid.transform[0])
            flight = [
                camera.moved(x=camera.x + step * number, heading=camera.heading + 0.1 * number)
                for number in range(frames)
            ]
            report(list(algorithms()).index(name) / len(algorithms()), f"{group}, {name}")
            times = [1000 * timing.record_time for timing in terrain.renderer.time_frames(flight, (160, 90))]
            # the first ones make pipelines and fill caches
            figures.append(Figure(group, f"{name}, median", statistics.median(times[5:]), "ms", 0.7))
    return figures


def passes(folder: Path, report: Report) -> list[Figure]:
    """Milliseconds of the GPU's passes, from every second standard camera, all that is wanted being resident.

    All algorithms on the first crop; on the others those that come into question as defaults.
    """
    from orogen.compare.cameras import standard_cameras
    from orogen.compare.truth import TrueSurface
    from orogen.gpu import open_gpu
    from orogen.lod import algorithms
    from orogen.raster.compute import can_rasterize
    from orogen.source import open_height
    from orogen.terrain import open_terrain

    with open_gpu() as gpu:
        slow, paths = gpu.info.kind == "cpu", ["compute", "hardware"] if can_rasterize(gpu) else ["hardware"]
        adapter = gpu.info.name
    usual: list[tuple[str, dict[str, float]]] = [(name, {}) for name in algorithms()]
    fine = [("udlod", {"pixels_per_quad": 1.0})]
    figures = []
    for number, (title, heights, spacing) in enumerate(_crops(folder)):
        cameras = list(standard_cameras(open_height(heights, spacing=spacing).grid, TrueSurface(heights)).values())
        chosen = usual if number == 0 else [entry for entry in usual if entry[0] in FAST]
        for path in paths:
            with open_terrain(heights, spacing=spacing, rasterizer=path, gpu_memory=None) as terrain:
                work = [(SIZE, *entry) for entry in fine + chosen]
                if not slow and path == "compute":
                    work += [((3840, 2160), *entry) for entry in [*fine, ("raycast", {})]]
                for done, (size, name, settings) in enumerate(work):
                    report(done / len(work), f"passes, {title}, {path}, {name}")
                    terrain.use(name, **settings)
                    given = "".join(f" {key}={value:g}" for key, value in settings.items())
                    group = f"{name}{given}, {title} {size[0]}x{size[1]}, {path}, {adapter}"
                    figures += _timings(group, terrain, cameras[:2] if slow else cameras[::2], size, 1 if slow else 3)
    return figures


def _timings(group: str, terrain: Any, cameras: Sequence[Any], size: tuple[int, int], count: int) -> list[Figure]:
    """Median and 99 % of all passes, and the median of each."""
    found = [timing for camera in cameras for timing in terrain.renderer.time_frames([camera] * count, size)]
    totals = sorted(sum(timing.gpu_times.values()) for timing in found)
    parts: dict[str, list[float]] = {}
    for timing in found:
        for part, value in timing.gpu_times.items():
            parts.setdefault(part, []).append(value)
    return [
        Figure(group, "all passes, median", statistics.median(totals), "ms"),
        Figure(group, "all passes, 99 %", totals[math.ceil(0.99 * len(totals)) - 1], "ms"),
        *(Figure(group, f"{part}, median", statistics.median(values), "ms") for part, values in parts.items()),
        Figure(group, "CPU to record, median", statistics.median(1000 * timing.record_time for timing in found), "ms"),
    ]


def accuracy(folder: Path, report: Report) -> list[Figure]:
    """Every algorithm against rays over level 0, from twelve cameras."""
    from orogen.compare.accuracy import measure, rows
    from orogen.compare.cameras import standard_cameras
    from orogen.compare.truth import TrueSurface
    from orogen.lod import algorithms
    from orogen.terrain import open_terrain

    size = (960, 540)
    figures = []
    for title, heights, spacing in _crops(folder):
        surface = TrueSurface(heights)
        views: dict[str, list[Any]] = {name: [] for name in algorithms() if name != "raycast"}
        with (
            open_terrain(heights, spacing=spacing, algorithm="raycast", settings=PINNED, gpu_memory=None) as exact,
            open_terrain(heights, spacing=spacing) as terrain,
        ):
            cameras = standard_cameras(exact.grid, surface)
            done, total = 0, len(cameras) * (1 + len(views))
            references = {}
            for view, camera in cameras.items():
                references[view] = exact.render(camera, size, samples=1)
                done += 1
                report(done / total, f"accuracy, {title}")
            for name, measured in views.items():
                settings = {"pixels_per_quad": 1.0} if name == "udlod" else {}
                terrain.use(name, **settings)
                for view, camera in cameras.items():
                    true = references[view]
                    drawn = terrain.render(camera, size, samples=1)
                    measured.append(measure(view, drawn.reverse_depth, true.reverse_depth, true.frame, surface))
                    done += 1
                    report(done / total, f"accuracy, {title}")
        for name, measured in views.items():
            group = f"{name}, {title}"
            figures += [Figure(group, row.name, row.value, row.unit, row.target) for row in rows(measured)]
    return figures


def rays(folder: Path, report: Report) -> list[Figure]:
    """Ray casting against Embree's triangles on real crops, and rays that slip through."""
    from orogen.compare.cameras import standard_cameras
    from orogen.compare.embree import EmbreeSurface, compare
    from orogen.compare.truth import TrueSurface
    from orogen.lod.raycast.probe import Probe
    from orogen.lod.raycast.watertight import lost_rays
    from orogen.terrain import open_terrain

    size, side, count = (320, 200), 129, 10_000_000
    figures = []
    crops = _crops(folder, all_of_them=True)
    for number, (title, heights, spacing) in enumerate(crops):
        middle = heights[heights.shape[0] // 2 :, heights.shape[1] // 2 :][:side, :side]
        with open_terrain(middle, spacing=spacing, algorithm="raycast", settings=PINNED) as terrain:
            off: list[float] = []
            views = standard_cameras(terrain.grid, TrueSurface(middle))
            for name, camera in views.items():
                picture = terrain.render(camera, size, samples=1)
                try:
                    surface = EmbreeSurface(picture.frame, middle)
                except OrogenError as error:
                    return [Figure("raycast", "against Embree", None, note=str(error))]
                off.append(100 * (1 - compare(picture.reverse_depth, picture.frame, surface).share))
                report((number + list(views).index(name) / len(views)) / (len(crops) + 1), f"rays, {title}")
        group, name = f"raycast against Embree, {title}", "pixels off by 0.01 of a cell's relief"
        figures.append(Figure(group, f"{name}, all views", statistics.mean(off), "%", 0.1))
        figures.append(Figure(group, f"{name}, worst view", max(off), "%"))
    title, heights, spacing = crops[0]
    report(len(crops) / (len(crops) + 1), f"rays, {count:.0e} through {title}")
    with open_terrain(heights, spacing=spacing, algorithm="raycast", settings=PINNED, gpu_memory=None) as terrain:
        picture = terrain.render(size=size, samples=1)
        renderer = terrain.renderer
        lost = lost_rays(Probe(renderer.clipmap), renderer.view, picture.frame, count)
    figures.append(Figure(f"raycast, {title}", f"rays lost of {count:.0e}", lost, "", 0))
    report(1.0, "rays")
    return figures


def queries(folder: Path, report: Report) -> list[Figure]:
    """Questions to the surface, on the CPU."""
    from orogen.cli.measure_queries import measure

    return measure(_crops(folder), report)


def large(folder: Path, report: Report) -> list[Figure]:
    """The first picture of a 10 GB file with overviews, of which nothing has been prepared."""
    from orogen.cli import measure_large

    return measure_large.large(report)


def endless(folder: Path, report: Report) -> list[Figure]:
    """What a frame costs over 2^22 x 2^22 samples, and over Taiwan."""
    from orogen.cli import measure_large

    return measure_large.endless(folder, report)


def views(folder: Path, report: Report) -> list[Figure]:
    """From an event to the picture that answers it."""
    from orogen.cli.measure_views import measure

    return measure(_small(folder), report)


MEASUREMENTS: dict[str, Callable[[Path, Report], list[Figure]]] = {
    "speed": speed,
    "pyramid": pyramid,
    "record": record,
    "passes": passes,
    "accuracy": accuracy,
    "rays": rays,
    "queries": queries,
    "large": large,
    "endless": endless,
    "views": views,
}
"""What can be measured, by name."""

BUILD = """
import json, os, sys, time
from orogen.cli.memory import peak_memory
from orogen.source import open_height
from orogen.pyramid.open import open_pyramid
start = time.perf_counter()
open_pyramid(open_height(sys.argv[1])).close()
seconds, cpu = time.perf_counter() - start, sum(os.times()[:4])
sys.stdout.write(json.dumps({"seconds": seconds, "cpu": cpu, "memory": peak_memory()}))
"""
COG = """
import json, os, sys, time
import rasterio
from rasterio.shutil import copy
start = time.perf_counter()
with rasterio.Env(GDAL_CACHEMAX=256):
    copy(
        sys.argv[1], sys.argv[2], driver="COG", COMPRESS="ZSTD", LEVEL="1", PREDICTOR="YES",
        OVERVIEW_RESAMPLING="AVERAGE", NUM_THREADS="2", BIGTIFF="IF_SAFER",
    )
sys.stdout.write(json.dumps({"seconds": time.perf_counter() - start, "cpu": sum(os.times()[:4])}))
"""


def _render(raster: Path, place: Path, *options: str) -> tuple[float, dict[str, Any]]:
    """Seconds of a process that draws a picture, and what it tells of it."""
    command = ["-m", "orogen", "render", str(raster), "-o", str(place / "picture.png"), "--overwrite"]
    size = f"{SIZE[0]}x{SIZE[1]}"
    start = time.perf_counter()
    facts = run_python([*command, "--size", size, "--samples", "1", "--json", "--quiet", *options], place)
    return time.perf_counter() - start, facts


def run_python(arguments: Sequence[str], cache: Path) -> dict[str, Any]:
    """Run Python with a cache folder of its own; gives the JSON that it writes. Raises OrogenError where it fails."""
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "OROGEN_CACHE_DIR": str(cache)},
        check=False,
    )
    if done.returncode:
        raise OrogenError(f"{' '.join(arguments[:3])} ... ended with {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def _memory(group: str, name: str, sizes: Sequence[int | None], target: float | None) -> Figure:
    """The largest of sizes in bytes."""
    known = [size / MB for size in sizes if size is not None]
    if not known:
        return Figure(group, name, None, "MB", target, "this system does not tell")
    return Figure(group, name, max(known), "MB", target)


def _small(folder: Path) -> Any:
    """Data of moderate size, whatever there is."""
    raster = folder / "bigtujunga_30m_utm.tif"
    return str(raster) if raster.exists() else "synthetic"


def _crops(folder: Path, all_of_them: bool = False) -> list[tuple[str, Any, float]]:
    """(name, heights, spacing in metres) of the data that accuracy is measured on: two crops, or all."""
    from orogen.source import open_height

    crops = []
    puget = folder / "puget_height_1k.png"
    if puget.exists():
        source = open_height(puget, spacing=160.0, height_scale=0.1)
        crops.append(("Puget", source.read(slice(0, source.grid.height), slice(0, source.grid.width)), 160.0))
        source.close()
    taiwan = folder / LARGE
    if taiwan.exists():
        source = open_height(taiwan)
        crops.append(("Taiwan crop", source.read(slice(8000, 10048), slice(4000, 6048)), source.grid.spacing))
        source.close()
    tujunga = folder / "bigtujunga_30m_utm.tif"
    if all_of_them and tujunga.exists():
        source = open_height(tujunga)
        crops.append(("Big Tujunga", source.read(slice(0, 643), slice(0, 1197)), source.grid.spacing))
        source.close()
    return crops
