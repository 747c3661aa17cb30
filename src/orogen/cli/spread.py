"""Pictures that the workers of a Dask cluster draw, each with its own GPU or software device."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

from orogen.cli.options import DrapedOptions, DrawingOptions
from orogen.source.mosaic import absolute

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from orogen.camera import Camera
    from orogen.shading.style import Style
    from orogen.terrain import Terrain
    from orogen.view.renderer import Scene

_opening = threading.Lock()


class Place:
    """What is drawn, as workers open it: data and options of the command line."""

    def __init__(self, data: str | list[str], options: DrapedOptions | None, drawing: DrawingOptions | None) -> None:
        self.data: str | list[str] = absolute(data)
        self.options = options or DrapedOptions()
        self.drawing = drawing or DrawingOptions()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Place) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash(str(self.data))


def drawn(
    scheduler: str,
    place: Place,
    views: Iterable[tuple[Camera, Style]],
    size: tuple[int, int],
    scene: Scene,
    samples: int,
) -> Iterator[NDArray[np.uint8]]:
    """The pictures of cameras in their order, as `Terrain.render` gives them; (rows, columns, 3 or 4) each."""
    from orogen.pyramid.workers import hired

    with hired(scheduler) as workers:
        tasks = ((place, camera, style, size, scene, samples) for camera, style in views)
        yield from workers.in_order(draw, tasks)


def draw(
    place: Place, camera: Camera, style: Style, size: tuple[int, int], scene: Scene, samples: int
) -> NDArray[np.uint8]:
    """One picture; the terrain stays open for the next ones."""
    with _opening:  # one at a time, so that it is opened once
        terrain = _opened(place)
    return terrain.render(camera, size, style, scene, samples=samples).color


@lru_cache(maxsize=1)
def _opened(place: Place) -> Terrain:
    from orogen.cli.terrain import open_terrain

    def silent(part: float, text: str) -> None:
        """Say nothing: nobody is there to read it."""

    return open_terrain(place.data, place.options, place.drawing, silent)
