"""`orogen serve`: the window in a browser."""

from __future__ import annotations

import signal
import threading

from orogen.cli.options import CameraOptions, DrapedOptions, DrawingOptions, SceneOptions, StyleOptions, one_or_all
from orogen.cli.parameters import Flag, Rasters


def serve(
    *data: Rasters,
    port: int = 8000,
    host: str = "127.0.0.1",
    clients: int = 4,
    no_panel: Flag = False,
    camera: CameraOptions | None = None,
    scene: SceneOptions | None = None,
    style: StyleOptions | None = None,
    drawing: DrawingOptions | None = None,
    options: DrapedOptions | None = None,
) -> None:
    """Show the terrain in a browser, until Ctrl-C.

    Prints the address to open. Whoever has it can look, nobody else: it holds a new secret each time. Every page has
    a view of its own; pages can neither read nor write files.

    Parameters
    ----------
    port
        Where to listen; 0: any port that is free.
    host
        Address of the network interface to listen on. Other than the default, other machines reach it, unencrypted.
    clients
        Pages that can look at a time.
    no_panel
        Show the terrain alone.
    """
    from orogen.cli import console
    from orogen.cli.terrain import open_terrain, place_camera, scene_of
    from orogen.errors import SettingsError

    try:
        from orogen.view.serve import Look, Server, ServerSettings
    except ModuleNotFoundError as error:
        raise SettingsError(f"orogen serve needs {error.name}; pip install 'orogen[serve]' brings it") from error

    settings = ServerSettings(host=host, port=port, clients=clients)
    look, before = (style or StyleOptions()).style(), scene_of(scene)
    with open_terrain(one_or_all(data), options, drawing, lambda part, text: None, "background") as terrain:
        start = place_camera(terrain, camera, before, (1280, 720)) if camera else None
        with Server(terrain, settings, Look(look, before, start, panel=not no_panel)) as server:

            def end(*_: object) -> None:
                # a thread of its own: what this one was doing when it was interrupted may hold a lock
                threading.Thread(target=server.stop).start()

            # before the address is told: who reads it may end the server at once
            before_signals = {kind: signal.signal(kind, end) for kind in (signal.SIGINT, signal.SIGTERM)}
            try:
                console.show({"address": server.address}, False, [server.address])
                console.note("open this address in a browser; Ctrl-C ends")
                server.run()
            finally:
                for kind, handler in before_signals.items():
                    signal.signal(kind, handler)
