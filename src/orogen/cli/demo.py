"""`orogen demo`: example pictures and a short video."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from orogen.cli import console
from orogen.cli.options import DrawingOptions
from orogen.cli.parameters import Adapter, Json, Output
from orogen.errors import OutputError

if TYPE_CHECKING:
    from orogen.terrain import Terrain

SIZE = (1280, 720)
SAMPLES = 4
VIDEO_SIZE = (640, 360)
VIDEO_FPS = 12.0
VIDEO_SECONDS = 6.0
FLIGHT = "descent"


class Example(NamedTuple):
    """A picture of the demo."""

    camera: Mapping[str, Any]
    """Options of the camera; with a distance it looks at the summit."""
    style: Mapping[str, Any] = MappingProxyType({})
    """Options of the style."""
    algorithm: str = "udlod"
    """How it is drawn."""


PICTURES = {
    "overview": Example({}),
    "summit": Example({"distance": 9000.0, "heading": 40.0, "pitch": -13.0}, {"sun": (300.0, 30.0)}),
    "evening": Example({"distance": 14000.0, "heading": 135.0, "pitch": -9.0}, {"sun": (215.0, 9.0)}),
    "raycast": Example({"distance": 5000.0, "heading": 300.0, "pitch": -25.0}, algorithm="raycast"),
    "levels": Example({"distance": 12000.0, "heading": 20.0, "pitch": -25.0}, {"overlays": ("levels", "wireframe")}),
    "map": Example(
        {"orthographic": True, "pitch": -90.0, "heading": 0.0}, {"overlays": ("contours",), "visibility": float("inf")}
    ),
}
"""What is drawn, by the picture's name."""


def demo(
    *,
    output: Output = Path("demo"),
    json: Json = False,
    adapter: Adapter = None,
) -> None:
    """Draw example pictures and a short video from built-in terrain.

    Parameters
    ----------
    output
        Folder to write into; files of an earlier demo are replaced.
    """
    from orogen.cli.fly import frames
    from orogen.cli.options import CameraOptions
    from orogen.cli.terrain import open_terrain, place_camera, scene_of
    from orogen.shading.style import Style
    from orogen.view.flight import Flight
    from orogen.view.image import write_color
    from orogen.view.video import VideoWriter

    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{output}: the folder cannot be made: {error.strerror}") from error
    scene = scene_of(None)
    written = []
    with (
        console.progress() as report,
        open_terrain("synthetic", None, DrawingOptions(adapter=adapter), report) as terrain,
    ):
        flight = Flight.load(FLIGHT).lasting(VIDEO_SECONDS)
        top = summit(terrain)
        for number, (name, example) in enumerate(PICTURES.items(), start=1):
            path = output / f"{name}.png"
            options = {**example.camera, **({"look_at": top} if "distance" in example.camera else {})}
            eye = place_camera(terrain, CameraOptions(**options), scene, SIZE)
            terrain.use(example.algorithm)
            picture = terrain.render(eye, SIZE, Style(**example.style), scene, samples=SAMPLES)
            write_color(path, picture.color, overwrite=True)
            written.append(str(path))
            report(number / len(PICTURES), "pictures")
        path = output / "flight.mp4"
        terrain.use()
        with VideoWriter(path, VIDEO_SIZE, VIDEO_FPS, overwrite=True) as video:
            for part, color in frames(terrain, flight, VIDEO_FPS, VIDEO_SIZE, Style(), scene, 1):
                video.write(color)
                report(part, "video")
        written.append(str(path))
    console.show({"files": written}, json, written)


def summit(terrain: Terrain) -> tuple[float, float]:
    """x, y of the highest sample of a coarse level that is not near the edge."""
    import numpy as np

    from orogen.keys import level_shape

    level = min(2, terrain.heights.level_count - 1)
    rows, columns = level_shape(terrain.shape, level)
    heights = terrain.heights.read(level, slice(0, rows), slice(0, columns))
    heights = heights.copy()
    heights[[*range(rows // 4), *range(3 * rows // 4, rows)]] = -np.inf
    heights[:, [*range(columns // 4), *range(3 * columns // 4, columns)]] = -np.inf
    row, column = np.unravel_index(np.argmax(heights), heights.shape)
    x, y = terrain.grid.to_crs((column + 0.5) * 2**level, (row + 0.5) * 2**level)
    return float(x), float(y)
