"""`orogen fly`: a video along a flight."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from orogen.cli import console
from orogen.cli.options import DrapedOptions, DrawingOptions, SceneOptions, StyleOptions
from orogen.cli.parameters import Data, FlightName, Json, Output, Overwrite, Size

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from orogen.camera import Camera
    from orogen.shading.style import Style
    from orogen.terrain import Terrain
    from orogen.view.flight import Flight
    from orogen.view.renderer import Scene


def fly(
    data: Data,
    /,
    *,
    flight: FlightName = "orbit",
    output: Output,
    fps: float = 30.0,
    duration: float | None = None,
    size: Size = (1280, 720),
    samples: int = 4,
    quality: Literal["high", "medium", "low"] = "high",
    scheduler: str | None = None,
    overwrite: Overwrite = False,
    json: Json = False,
    scene: SceneOptions | None = None,
    style: StyleOptions | None = None,
    drawing: DrawingOptions | None = None,
    options: DrapedOptions | None = None,
) -> None:
    """Draw a video along a flight; every frame is complete before it is written.

    Parameters
    ----------
    output
        Video to write: .mp4, .webm, or .mkv without loss.
    fps
        Frames per second.
    duration
        Seconds that the flight takes, in place of those that it says.
    size
        Width and height in pixels.
    samples
        Samples per pixel, which smooth edges.
    quality
        Of .mp4 and .webm: as good as what is drawn, or files of about a half and a quarter of the size.
    scheduler
        Address of a Dask scheduler whose workers draw the frames, such as tcp://host:8786; they must see the same
        files. [default: this process draws them]
    """
    from orogen.cli.spread import Place, drawn
    from orogen.cli.terrain import open_terrain, scene_of
    from orogen.view.flight import Flight
    from orogen.view.video import VideoWriter

    way = Flight.load(flight)
    if duration is not None:
        way = way.lasting(duration)
    video = VideoWriter(output, size, fps, overwrite, quality=quality)
    look, before = (style or StyleOptions()).style(), scene_of(scene)
    start = time.perf_counter()
    with console.progress() as report, open_terrain(data, options, drawing, report) as terrain, video:
        views = flown(terrain, way, fps, look, before)
        colors: Iterator[NDArray[np.uint8]]
        if scheduler is None:
            colors = (terrain.render(eye, size, shown, before, samples=samples).color for eye, shown in views)
        else:
            colors = drawn(scheduler, Place(data, options, drawing), views, size, before, samples)
        for number, color in enumerate(colors, start=1):
            video.write(color)
            report(number / len(views), str(output))
    result = {
        "file": str(output),
        "frames": video.frames,
        "size": size,
        "encoder": video.encoder.codec,
        "seconds": time.perf_counter() - start,
    }
    console.show(result, json, [str(output)])


def frames(
    terrain: Terrain,
    flight: Flight,
    fps: float,
    size: tuple[int, int],
    style: Style,
    scene: Scene,
    samples: int,
) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """(part done, picture) of every frame of a flight over a terrain."""
    views = flown(terrain, flight, fps, style, scene)
    for number, (camera, look) in enumerate(views, start=1):
        yield number / len(views), terrain.render(camera, size, look, scene, samples=samples).color


def flown(terrain: Terrain, flight: Flight, fps: float, style: Style, scene: Scene) -> list[tuple[Camera, Style]]:
    """Camera and style of every frame of a flight over a terrain."""
    path = flight.over(terrain.grid, terrain.height_range, exaggeration=scene.exaggeration, height_at=terrain.height_at)
    suns = ((camera, path.sun_at(t)) for t, camera in path.frames(fps))
    return [(camera, style if sun is None else replace(style, sun=sun)) for camera, sun in suns]
