"""The data of a plan, opened once: pyramids of heights and of what is draped over them, and renderers of both."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any

import numpy as np

from orogen.compare.crop import Crop
from orogen.compare.plan import Entry, Plan
from orogen.compare.prelit import content_digest, prelit_image
from orogen.compare.truth import TrueSurface
from orogen.errors import OrogenError, SettingsError
from orogen.gpu import Gpu, open_gpu
from orogen.grid import Grid
from orogen.keys import NODE_SIZE
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries
from orogen.source.contract import Source
from orogen.source.open import open_colour, open_height
from orogen.source.stored import draped
from orogen.streaming.requests import LayerGrid
from orogen.streaming.settings import ClipmapSettings
from orogen.view.renderer import Renderer, Scene

Progress = Callable[[float, str], None]

LARGEST = 2048
"""Nodes of level 0 at most: layers that a texture has on any GPU. The true surface is drawn with all of them."""
PER_SAMPLE = 14
"""Bytes of GPU memory that a sample of heights takes at most: 7 with borders, maxima and coverage, and as much again
for the coarser levels of a raster that is long and narrow."""


class Scenery(AbstractContextManager["Scenery"]):
    """What is flown over. Use it as a context manager."""

    def __init__(self, plan: Plan, progress: Progress) -> None:
        """Raises SourceError, or SettingsError for a crop outside the data."""
        self.plan = plan
        options = dict(plan.options)
        color, extent = draped(plan.data, options.pop("color", None)), options.pop("color_extent", "pixels")
        source = open_height(plan.data, **options)
        cut = source if plan.crop is None else Crop(source, plan.crop)
        _check_size(cut)
        self._closing: list[Callable[[], None]] = []
        try:
            self.heights = self._opened(cut, progress)
            self.fingerprint = cut.fingerprint or content_digest(cut.read, cut.grid.shape)
            """Changes with every change of the heights."""
            if plan.prelit:
                color = prelit_image(self.heights, plan.style, progress)
            image = None if color is None else open_colour(color, source, color_extent=extent)
            self.colors = None if image is None else self._opened(image, progress)
            if image is not None:
                self.fingerprint += f"|{image.fingerprint or 'array'}"
            self.gpu: Gpu = open_gpu(plan.adapter)
            self._closing.append(self.gpu.close)
        except BaseException:
            self.close()
            raise
        self._queries = Queries(self.heights)

    def _opened(self, source: Any, progress: Progress) -> Pyramid:
        pyramid = open_pyramid(source, progress=progress)
        self._closing.append(pyramid.close)
        return pyramid

    @property
    def grid(self) -> Grid:
        """Georeference of the heights, cropped."""
        return self.heights.grid

    def height_at(self, x: float, y: float) -> float:
        """Height (m) of the ground at x, y in the data's CRS; NaN where there is none."""
        return float(self._queries.height_at(x, y))

    def scene(self, **options: Any) -> Scene:
        """How the plan puts the terrain before the camera."""
        return Scene(exaggeration=self.plan.exaggeration, curvature=self.plan.curvature, **options)

    def truth(self) -> TrueSurface:
        """The true surface: reads all samples into memory, 5 bytes each."""
        rows, columns = self.grid.shape
        return TrueSurface(self.heights.read(0, slice(0, rows), slice(0, columns)))

    def renderer(self, entry: Entry) -> Renderer:
        """Draws an entry as it would be in use; to be closed."""
        return Renderer(
            self.gpu, self.heights, self.colors, name=entry.algorithm, settings=entry.settings,
            clipmap=self.plan.clipmap_settings(),
        )  # fmt: skip

    def exact_renderer(self) -> Renderer:
        """Draws the true surface: rays over all of level 0. No colours; to be closed."""
        memory = (64 << 20) + PER_SAMPLE * math.prod(-(-n // NODE_SIZE) * NODE_SIZE for n in self.grid.shape)
        settings = ClipmapSettings(view_distance=math.inf, behind=1.0, memory=memory, host_memory=256 << 20)
        return Renderer(self.gpu, self.heights, None, name="raycast", clipmap=settings)

    def check_exact(self, renderer: Renderer) -> None:
        """Raise OrogenError unless all of level 0 is resident: an atlas has only so many layers."""
        layer = renderer.clipmap.heights
        shape = LayerGrid(self.grid, self.heights.level_count, renderer.clipmap.settings.node_size).nodes(0)
        resident = sum(key.level == 0 for key in layer.current)
        if resident < int(np.prod(shape)):
            rows, columns = self.grid.shape
            raise OrogenError(
                f"{self.heights.source.name}: {columns} x {rows} samples are too many to draw the true surface at "
                f"once: {resident} of {int(np.prod(shape))} nodes fit; compare on a part of the data (--crop)"
            )

    def close(self) -> None:
        """Release GPU and files."""
        for action in reversed(self._closing):
            action()
        self._closing.clear()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _check_size(source: Source) -> None:
    """Refuse at once what cannot be compared whole, before any of it is read."""
    rows, columns = source.grid.shape
    if -(-rows // NODE_SIZE) * -(-columns // NODE_SIZE) > LARGEST:
        part = tuple(min(4096, size) for size in (columns, rows))
        middle = (columns - part[0]) // 2, (rows - part[1]) // 2
        raise SettingsError(
            f"crop: expected a part of the {columns} x {rows} samples of {source.name}, too many to hold and draw the "
            f"true surface of, got none or a large one; such as {middle[0]},{middle[1]},{part[0]},{part[1]} (--crop)"
        )
