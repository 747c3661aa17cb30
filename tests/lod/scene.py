"""A small terrain on the GPU, for tests of what lies below the renderer: draw lists, rays, surface buffers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.keys import NodeKey
from orogen.lod import algorithm, make_settings
from orogen.lod.contract import AlgorithmView, Draw
from orogen.pyramid.open import open_pyramid
from orogen.raster.rasterizer import Rasterizer
from orogen.raster.surface import Surface
from orogen.source.open import open_height
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.settings import ClipmapSettings

SPACING = 10.0
Buffers = dict[str, NDArray[Any]]


def noise(rows: int, columns: int, relief: float = 60.0, seed: int = 1) -> NDArray[np.float32]:
    """(rows, columns) independent samples: the roughest surface there is."""
    return np.random.default_rng(seed).uniform(0, relief, (rows, columns)).astype(np.float32)


class Scene:
    """One terrain, its clipmap and one view of it."""

    def __init__(
        self,
        gpu: Gpu,
        heights: NDArray[np.floating],
        *,
        view_distance: float = math.inf,
        spacing: float = SPACING,
        metres: NDArray[np.float64] | None = None,
    ) -> None:
        """`metres`: 2 x 2 matrix from texels (columns, rows) to metres (east, north), in place of `spacing`."""
        source = open_height(np.asarray(heights, np.float32), spacing=spacing)
        if metres is not None:
            (a, b), (d, e) = metres.tolist()
            source = replace(source, grid=replace(source.grid, transform=(a, b, 0.0, d, e, 0.0)))
        self.gpu = gpu
        self.pyramid = open_pyramid(source)
        self.clipmap = Clipmap(gpu, self.pyramid, None, ClipmapSettings(view_distance=view_distance, memory=24 << 20))
        self.view = self.clipmap.view()
        self.rasterizer = Rasterizer(self.clipmap)
        self.timer = gpu.timer()

    def camera(self, column: float, row: float, z: float, **angles: Any) -> Camera:
        """A camera over texel coordinates."""
        x, y = self.pyramid.grid.to_crs(column, row)
        return Camera(float(x), float(y), z, **angles)

    def frame(self, camera: Camera, size: tuple[int, int] = (96, 64), *, load: bool = True, **changes: Any) -> Frame:
        """A frame that the view has been updated for, with what it wants loaded unless `load` is off."""
        frame = self.view.frame_for(Frame(camera, self.pyramid.grid, size, **changes))
        if load:
            self.view.want(frame)
            self.clipmap.settle()
        self.view.update(frame)
        return frame

    def load(self, keys: Iterable[NodeKey]) -> None:
        """Make just these nodes resident (the coarsest first), beside what is."""
        self.view.wishes = [sorted(keys, reverse=True)]
        self.clipmap.settle()

    def algorithm(self, name: str, settings: Mapping[str, Any] | None = None) -> AlgorithmView:
        return algorithm(name)(self.clipmap, make_settings(name, settings or {})).view()

    def record(self, frame: Frame, state: AlgorithmView) -> list[Draw]:
        """Run the algorithm's GPU work for a frame; gives its draws."""
        self.view.update(frame)
        encoder = self.gpu.encoder("record")
        draws = list(state.record(encoder, self.timer, frame, self.view))
        self.timer.resolve(encoder)
        self.gpu.submit(encoder)
        return draws

    def draw(self, frame: Frame, *states: AlgorithmView, extra: Iterable[Draw] = ()) -> Buffers:
        """depth, id and detail (rows, columns) of what the algorithms draw together, whole."""
        while True:
            result = self.raster(frame, [draw for state in states for draw in self.record(frame, state)] + list(extra))
            # each has to be asked: asking makes room
            if not sum(state.incomplete() for state in states):
                return result

    def raster(self, frame: Frame, draws: Iterable[Draw]) -> Buffers:
        """The surface buffer of some draws."""
        surface: Surface = self.rasterizer.surface(frame.size)
        encoder = self.gpu.encoder("raster")
        self.rasterizer.record(encoder, self.timer, list(draws), self.view, surface)
        self.timer.resolve(encoder)
        self.gpu.submit(encoder)
        result = {name: surface.read(name).result() for name in ("depth", "id", "detail")}
        surface.destroy()
        return result

    def close(self) -> None:
        self.clipmap.close()
        self.pyramid.close()
