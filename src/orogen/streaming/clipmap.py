"""The chunked clipmap (Kuehnert 2022, section 4.5): node atlases shared by all views, a clipped quadtree per view."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any

import orogen
from orogen.gpu import Gpu, Texture
from orogen.grid import Grid
from orogen.keys import NODE_SIZE as CHUNK
from orogen.keys import NodeKey, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.streaming.atlas import CEILING_BLOCK
from orogen.streaming.ceilings import Ceilings
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.faults import Faults
from orogen.streaming.layer import Layer
from orogen.streaming.retry import Failures
from orogen.streaming.settings import COLOR_BORDER, HEIGHT_BORDER, MAX_ANISOTROPY, ClipmapSettings
from orogen.streaming.software import SHARED, TABLE_WIDTH, is_software

SEARCH = (Path(orogen.__file__).parent, Path(__file__).parent)
"""Folders of the WGSL that reads a frame and the clipmap."""

_STAGES = "VERTEX|FRAGMENT|COMPUTE"


class Clipmap:
    """The resident terrain, shared by all views of it."""

    def __init__(
        self,
        gpu: Gpu,
        heights: Pyramid,
        colors: Pyramid | None = None,
        settings: ClipmapSettings | None = None,
        faults: Faults | None = None,
    ) -> None:
        """`colors`: an image over the same terrain, in its CRS. `faults`: where failures are noted.

        Raises BudgetError where the memory is too little.
        """
        self.gpu = gpu
        self.faults = faults or Faults()
        """What could not be read, made or uploaded."""
        self.settings = settings or ClipmapSettings()
        s = self.settings
        self.layers: list[Layer] = []
        pyramids = [heights] if colors is None else [heights, colors]
        try:
            for pyramid in pyramids:
                share = s.memory // len(pyramids), s.host_memory // len(pyramids)
                self.layers.append(Layer(gpu, pyramid, s, *share, self.faults))
            self.slot_buffer = gpu.buffer("slots", self.layers[0].slots.nbytes, "STORAGE|COPY_DST", "clipmap")
            # stands for the attachments that this terrain does not have
            self._nothing = gpu.texture("no attachment", (1, 1), "r8unorm", "TEXTURE_BINDING", "clipmap")
        except BaseException:
            for layer in self.layers:
                layer.close()
            raise
        self.heights = self.layers[0]
        self.colors = self.layers[1] if colors is not None else None
        self.constants = {
            "NODE_BITS": s.node_bits, "HEIGHT_BORDER": HEIGHT_BORDER, "COLOR_BORDER": COLOR_BORDER,
            "MAX_ANISOTROPY": MAX_ANISOTROPY, "COVERED": self.heights.covered, "ANY_HIT": False, "WITH_LEVELS": True,
            "CEILING_BLOCK": CEILING_BLOCK, "SOFTWARE": is_software(gpu), "TABLE_WIDTH": TABLE_WIDTH,
            **SHARED, **self.heights.format.constants,
        }  # fmt: skip
        """Constants of clipmap.wgsl."""
        self._views: list[ClipmapView] = []
        array = "texture {} 2d-array"
        self.layout = gpu.layout(
            "clipmap",
            {
                0: (_STAGES, "uniform"),
                1: (_STAGES, "uniform"),
                2: (_STAGES, "read"),
                3: (_STAGES, "read"),
                4: (_STAGES, "read"),
                5: (_STAGES, self.heights.format.binding),
                6: (_STAGES, array.format("float")),
                7: (_STAGES, array.format("unfilterable")),
                8: (_STAGES, array.format("float")),
                9: (_STAGES, "sampler filtering"),
                10: (_STAGES, "sampler non-filtering"),
                11: (_STAGES, array.format("unfilterable")),
                12: (_STAGES, array.format("unfilterable")),
            },
        )
        """Layout of bind group 0, which every shader that includes frame.wgsl or clipmap.wgsl uses."""
        self.sampler = gpu.sampler("colour", mag_filter="linear", min_filter="linear", mipmap_filter="linear")
        self.texel_sampler = gpu.sampler("texels")
        self._slots_version = -1
        self._unreadable: Failures[tuple[int, ...]] = Failures()

    @cached_property
    def ceilings(self) -> Ceilings:
        """What spares rays towards the sun their way over nodes."""
        return Ceilings(self.gpu, self.heights, self.settings.node_bits)

    @property
    def grid(self) -> Grid:
        """Grid of the heights."""
        return self.heights.pyramid.grid

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest valid height (m); until the pyramid is built an estimate that covers all nodes seen."""
        return self.heights.height_range

    def view(self) -> ClipmapView:
        """A new view of the terrain."""
        view = ClipmapView(self)
        self._views.append(view)
        return view

    def drop(self, view: ClipmapView) -> None:
        """Forget a view and give its memory back."""
        self._views.remove(view)
        view.close()

    def attachment(self, name: str) -> Any:
        """View of an attachment's texture array, of a single texel where the terrain has none such."""
        texture: Texture = self._nothing
        for layer in self.layers:
            texture = layer.atlas.textures.get(name, texture)
        return texture.view(dimension="2d-array")

    def pump(self) -> int:
        """Hand the views' wishes to the loaders, and upload what is loaded within the frame's budget.

        Returns the number of bytes uploaded.
        """
        for index, layer in enumerate(self.layers):
            wishes = [view.wishes[index] for view in self._views]
            layer.want(wishes[0] if len(wishes) == 1 else _merged(wishes))
        budget = self.settings.upload_budget
        done = 0
        for layer in self.layers:
            if done == 0 or done + layer.atlas.upload_bytes <= budget:
                done += layer.pump(budget - done)
        if self._slots_version != self.heights.version:
            self.gpu.write(self.slot_buffer, self.heights.slots)
            self._slots_version = self.heights.version
        return done

    @property
    def pending(self) -> int:
        """Wanted nodes that are still to come."""
        return sum(layer.pending for layer in self.layers)

    @property
    def retry_in(self) -> float | None:
        """Seconds until a node that failed is tried again; None where none has failed."""
        return min((wait for layer in self.layers if (wait := layer.retry_in) is not None), default=None)

    def settle(self) -> None:
        """Load until every wanted node that can be read and fits is resident; what fails is tried twice."""
        while True:
            uploaded = self.pump()
            if uploaded:
                # staging memory is given back when the GPU is done with it
                self.gpu.wait()
            elif not self.pending:
                return
            else:
                for layer in self.layers:
                    if layer.pending:
                        layer.wait(1.0)
                        break

    def height_under(self, x: float, y: float) -> float:
        """Height (m) of the terrain at CRS coordinates, or nearest to them; for choosing levels of detail.

        Interpolated, so that levels do not jump while a camera moves.
        """
        layer = self.heights
        column, row = self.grid.texel_of(x, y)
        for level in filter(layer.tiles.readable, range(layer.pyramid.level_count)):
            lasts = [count - 1 for count in level_shape(self.grid.shape, level)]
            places = [
                min(max(texel / 2.0**level - 0.5, 0.0), last) for texel, last in zip((row, column), lasts, strict=True)
            ]
            firsts = [min(math.floor(at), max(last - 1, 0)) for at, last in zip(places, lasts, strict=True)]
            rows, cols = (slice(first, min(first + 1, last) + 1) for first, last in zip(firsts, lasts, strict=True))
            chunk = (level, *(first // CHUNK for first in firsts))
            if self._unreadable.resting(chunk):
                continue
            try:
                heights = layer.tiles.window(level, rows, cols)
            except Exception as error:
                # the loader reports what cannot be read; here a coarser level will do
                self._unreadable.add(chunk, error)
                continue
            self._unreadable.remove(chunk)
            down, right = (at - first for at, first in zip(places, firsts, strict=True))
            total = weights = 0.0
            for values, vertical in zip(heights.tolist(), (1 - down, down), strict=False):
                for value, horizontal in zip(values, (1 - right, right), strict=False):
                    if math.isfinite(value):
                        total += vertical * horizontal * value
                        weights += vertical * horizontal
            if weights > 0:
                return total / weights
        return sum(self.height_range) / 2

    def close(self) -> None:
        """Stop loading and give the memory back."""
        for layer in self.layers:
            layer.close()
        for view in list(self._views):
            self.drop(view)
        if "ceilings" in vars(self):
            self.ceilings.destroy()
        self.slot_buffer.destroy()
        self._nothing.destroy()


def _merged(wishes: list[list[NodeKey]]) -> list[NodeKey]:
    """One list of several views' wishes: coarse first, the views in turn."""
    ranked: dict[NodeKey, tuple[int, int]] = {}
    for keys in wishes:
        rank: dict[int, int] = {}
        for key in keys:
            rank[key.level] = rank.get(key.level, 0) + 1
            order = (-key.level, rank[key.level])
            ranked[key] = min(order, ranked.get(key, order))
    return sorted(ranked, key=lambda key: (ranked[key], key))
