"""`orogen view`: a window."""

from __future__ import annotations

from orogen.cli.options import CameraOptions, DataOptions, DrawingOptions, SceneOptions, Size, StyleOptions


def view(
    data: str,
    /,
    *,
    size: Size = (1280, 720),
    camera: CameraOptions | None = None,
    scene: SceneOptions | None = None,
    style: StyleOptions | None = None,
    drawing: DrawingOptions | None = None,
    options: DataOptions | None = None,
) -> None:
    """Open a window to move through the terrain.

    Drag to pan, with the right button to turn, wheel to zoom, double click to go there, Tab to fly with W A S D Q E,
    N for north, Home for the start.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    size
        Width and height of the window in logical pixels.
    """
    from orogen.cli.terrain import open_terrain, place_camera, scene_of
    from orogen.view.controls import Ground
    from orogen.view.window import Window

    look, before = (style or StyleOptions()).style(), scene_of(scene)
    with open_terrain(data, options, drawing, lambda part, text: None, "background") as terrain:
        window = Window(
            terrain.device,
            lambda target, eye, pixels: terrain.draw_to(target, eye, pixels, look, before),
            place_camera(terrain, camera, before, size),
            Ground(terrain.grid, terrain.height_at, terrain.pick, before.exaggeration),
            size=size,
            title=f"{data} - orogen",
        )
        window.run()
