"""From options to terrain, cameras and scenes."""

from __future__ import annotations

import logging
from dataclasses import asdict
from typing import Literal

from orogen.camera import Camera
from orogen.cli.console import Report
from orogen.cli.options import CameraOptions, DrapedOptions, DrawingOptions, SceneOptions
from orogen.frame import check_size
from orogen.terrain import Terrain
from orogen.terrain import open_terrain as open_any
from orogen.view.framing import frame_camera
from orogen.view.renderer import Scene

log = logging.getLogger("orogen")


def open_terrain(
    data: str | list[str],
    options: DrapedOptions | None,
    drawing: DrawingOptions | None,
    report: Report,
    build: Literal["auto", "background", "never"] = "auto",
) -> Terrain:
    """The terrain that the options describe; to be used in a `with` block."""
    drawing = drawing or DrawingOptions()
    return open_any(
        data,
        **asdict(options or DrapedOptions()),
        algorithm=drawing.algorithm,
        settings=drawing.settings(),
        adapter=drawing.adapter,
        rasterizer=drawing.rasterizer,
        build=build,
        progress=report,
    )


def scene_of(options: SceneOptions | None) -> Scene:
    """The scene that the options describe."""
    return Scene(**asdict(options or SceneOptions()))


def place_camera(terrain: Terrain, options: CameraOptions | None, scene: Scene, size: tuple[int, int]) -> Camera:
    """The camera that the options describe, for a picture of `size` pixels."""
    check_size(size)
    camera = frame_camera(
        terrain.grid,
        terrain.height_range,
        **asdict(options or CameraOptions()),
        exaggeration=scene.exaggeration,
        aspect=size[0] / size[1],
        height_at=terrain.height_at,
    )
    depth = terrain.height_at(camera.x, camera.y) * scene.exaggeration - camera.z
    if depth > 0 and not camera.orthographic:
        log.warning("the camera is %.0f m below the ground; raise --distance, or lower --pitch", depth)
    return camera
