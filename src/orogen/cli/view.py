"""`orogen view`: a window."""

from __future__ import annotations

from orogen.cli.options import CameraOptions, DrapedOptions, DrawingOptions, SceneOptions, StyleOptions, one_or_all
from orogen.cli.parameters import Flag, Rasters, Size


def view(
    *data: Rasters,
    size: Size = (1280, 720),
    no_panel: Flag = False,
    camera: CameraOptions | None = None,
    scene: SceneOptions | None = None,
    style: StyleOptions | None = None,
    drawing: DrawingOptions | None = None,
    options: DrapedOptions | None = None,
) -> None:
    """Open a window to move through the terrain.

    Drag to pan, with the right button to turn, wheel to zoom, double click to go there, Tab to fly and to walk with
    W A S D Q E, N for north, Home for the start, P for the panel, M for a map, F to freeze the level of detail.

    Parameters
    ----------
    size
        Width and height of the window in logical pixels.
    no_panel
        Show the terrain alone.
    """
    from orogen.cli.terrain import open_terrain, place_camera, scene_of
    from orogen.terrain import Terrain
    from orogen.view.session import Session
    from orogen.view.window import Window

    look, before = (style or StyleOptions()).style(), scene_of(scene)

    def opener(text: str) -> Terrain:
        return open_terrain(text, None, drawing, lambda part, text: None, "background")

    with open_terrain(one_or_all(data), options, drawing, lambda part, text: None, "background") as terrain:
        session = Session(
            terrain, look, before,
            camera=place_camera(terrain, camera, before, size) if camera else None,
            opener=opener,
        )  # fmt: skip
        window = Window(session, size=size, title=f"{terrain.name} - orogen", panel=not no_panel)
        try:
            window.run()
        finally:
            window.close()
