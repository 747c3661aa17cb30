"""`orogen render`: a picture."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from orogen.cli import console
from orogen.cli.options import CameraOptions, DrapedOptions, DrawingOptions, SceneOptions, StyleOptions, one_or_all
from orogen.cli.parameters import Flag, Json, Output, Overwrite, Rasters, Size


def render(
    *data: Rasters,
    output: Output,
    depth: Path | None = None,
    position: Path | None = None,
    size: Size = (1280, 720),
    samples: int = 4,
    coarse: Flag = False,
    overwrite: Overwrite = False,
    json: Json = False,
    camera: CameraOptions | None = None,
    scene: SceneOptions | None = None,
    style: StyleOptions | None = None,
    drawing: DrawingOptions | None = None,
    options: DrapedOptions | None = None,
) -> None:
    """Draw a picture of the terrain as a camera sees it: complete, and the same each time.

    Parameters
    ----------
    output
        Picture to write (.png).
    depth
        Also write metres along the view axis, sky NaN, as float32 (.npy, .tif).
    position
        Also write x, y in the data's CRS and height in metres, sky NaN, as float64 (.npy).
    size
        Width and height in pixels.
    samples
        Samples per pixel, which smooth edges.
    coarse
        Do not build the pyramid of data that has none yet: a coarse picture at once.
    """
    from orogen.cli.memory import peak_memory
    from orogen.cli.terrain import open_terrain, place_camera, scene_of
    from orogen.view import image
    from orogen.view.output import check_output

    wanted = (
        (output, image.COLOR_SUFFIXES),
        (depth, image.DEPTH_SUFFIXES),
        (position, image.POSITION_SUFFIXES),
    )
    files = [check_output(path, suffixes, overwrite) for path, suffixes in wanted if path is not None]
    look = (style or StyleOptions()).style()
    before = scene_of(scene)
    start = time.perf_counter()
    build: Literal["auto", "never"] = "never" if coarse else "auto"
    with console.progress() as report, open_terrain(one_or_all(data), options, drawing, report, build) as terrain:
        eye = place_camera(terrain, camera, before, size)
        picture = terrain.render(eye, size, look, before, samples=samples)
        image.write_color(output, picture.color, overwrite)
        if depth is not None:
            image.write_depth(depth, picture.depth, overwrite)
        if position is not None:
            image.write_position(position, picture.position, overwrite)
        gpu_memory = terrain.renderer.gpu.memory.peak
        heights = terrain.renderer.clipmap.heights
        form, nodes = heights.format, len(heights.current)
    result = {
        "files": [str(path) for path in files],
        "size": size,
        "seconds": time.perf_counter() - start,
        "camera": asdict(picture.frame.camera),
        "statistics": asdict(picture.statistics),
        "gpu_milliseconds": dict(picture.gpu_times),
        "gpu_memory": gpu_memory,
        "heights": {
            "bits": form.bits,
            "step": form.step if form.bits == 16 else None,
            "loss": form.loss,
            "nodes": nodes,
            "node_bytes": heights.atlas.node_bytes,
        },
        "memory": peak_memory(),
    }
    console.show(result, json, [str(path) for path in files])
