"""The compute rasteriser: triangles to a visibility buffer by 64-bit atomics, then to the surface buffer."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from orogen.gpu import Buffer, FrameTimer, Gpu
from orogen.lod.contract import Patches
from orogen.lod.mesh import MESHLET_TRIANGLES, MESHLET_VERTICES
from orogen.raster.surface import Surface
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

MAX_DRAWS = 128
"""Draws of one module and one list of triangles in a picture."""
MAX_BATCHES = 16
"""Modules and lists of triangles in a picture."""
ROOM = (1 << 17, 1 << 16, 1 << 18)
"""Room at first for large triangles, for the pieces that they are cut into, and for the pieces' blocks of pixels."""

_FEATURES = ("shader-int64", "shader-int64-atomic-min-max")
_KINDS = ("meshes", "lists", "strips")
"""In the order of corners.wgsl."""
_TOPOLOGIES = {"triangle-list": "lists", "triangle-strip": "strips"}
_ARGUMENTS = 20
_BATCH = 16 + 24 * MAX_DRAWS
_PIECE = 48
_TILE = 8
_SPLITTERS, _DRAWERS = 256, 1024
"""Workgroups that cut large triangles into pieces, and that draw the blocks of these."""
_GROUP = 128
"""Invocations of a workgroup that draws triangles, and triangles of one without meshlets."""


def can_rasterize(gpu: Gpu) -> bool:
    """Whether the adapter has the 64-bit atomics that this takes."""
    return all(feature in gpu.features for feature in _FEATURES)


class ComputeRasterizer:
    """Draws patches without the hardware pipeline, by the same rules; see docs/raster.md."""

    def __init__(self, clipmap: Clipmap, target_layout: Any) -> None:
        """`target_layout`: bind group layout of the surface's textures as images."""
        self._clipmap = clipmap
        self._target_layout = target_layout
        gpu = clipmap.gpu
        read, storage = ("COMPUTE", "read"), ("COMPUTE", "storage")
        self._prepare_layout = gpu.layout("batch", {0: read, 1: read, 2: storage, 3: storage, 4: storage})
        self._draw_layout = gpu.layout(
            "triangles", {0: read, 1: read, 2: storage, 3: storage, 4: storage, 5: storage, 6: storage}
        )
        self._show_layout = gpu.layout("visibility", {0: read, 1: read, 2: read})
        self._no_layout = gpu.layout("nothing", {})
        self._no_group = gpu.bind("nothing", self._no_layout, {})
        self._pipelines: dict[tuple[Any, ...], Any] = {}
        self._groups: dict[tuple[Any, ...], tuple[Any, Any, Any, Buffer]] = {}
        self._arguments = gpu.buffer("arguments", _ARGUMENTS * MAX_DRAWS * MAX_BATCHES, "STORAGE|COPY_DST", "raster")
        self._nothing = gpu.buffer("no list", 16, "STORAGE", "raster")
        # how many are in each queue, the most that were in this picture, and the number of the next workgroup
        self._queues = gpu.buffer("queues", 28, "STORAGE|COPY_DST|COPY_SRC", "raster")
        self._visibility: Buffer | None = None
        self._make_room(ROOM)

    def _make_room(self, room: tuple[int, int, int]) -> None:
        gpu = self._clipmap.gpu
        large, pieces, blocks = self._room = room
        self._large = gpu.buffer("large triangles", 4 * large, "STORAGE", "raster")
        self._pieces = gpu.buffer("pieces", _PIECE * pieces, "STORAGE", "raster")
        self._blocks = gpu.buffer("blocks", 8 * blocks, "STORAGE", "raster")
        self._groups.clear()

    def can_draw(self, draws: Sequence[Patches]) -> bool:
        """Whether there is room for so many draws, and their arguments can be copied."""
        batches = _batches(draws)
        few = len(batches) <= MAX_BATCHES and all(len(batch) <= MAX_DRAWS for batch in batches)
        return few and all(draw.indirect.allows("COPY_SRC") for draw in draws)

    def record(
        self,
        encoder: Any,
        timer: FrameTimer,
        draws: Sequence[Patches],
        view: ClipmapView,
        surface: Surface,
        *,
        clear: bool,
        edges: bool,
    ) -> None:
        """Draw patches into the surface, cleared first if `clear`; `edges`: with distances to triangle edges."""
        self._use(encoder, surface, clear)
        batches = _batches(draws)
        for number, batch in enumerate(batches):
            self._draw(encoder, timer, batch, number, view)
        for number, batch in enumerate(batches):
            self._show(encoder, timer, batch[0], number, view, surface, clear and number == 0, edges)

    def incomplete(self) -> bool:
        """Whether the queues were too small for the latest picture; makes them larger. Waits for the GPU."""
        counts = self._clipmap.gpu.read_buffer(self._queues).result().view(np.uint32)[3:6].tolist()
        if all(count <= room for count, room in zip(counts, self._room, strict=True)):
            return False
        large, pieces, blocks = (max(room, 2 * count) for room, count in zip(self._room, counts, strict=True))
        self._make_room((large, pieces, blocks))
        return True

    def forget(self) -> None:
        """Let go of the buffers of earlier draws."""
        self._groups.clear()

    def _use(self, encoder: Any, surface: Surface, clear: bool) -> None:
        size = 8 * surface.size[0] * surface.size[1]
        if self._visibility is None or self._visibility.size != size:
            self._visibility = self._clipmap.gpu.buffer("visibility", size, "STORAGE|COPY_DST", "surface")
            self._groups.clear()
        if clear:
            for buffer in (self._visibility, self._queues):
                encoder.clear_buffer(buffer.raw)

    def _draw(self, encoder: Any, timer: FrameTimer, batch: list[Patches], number: int, view: ClipmapView) -> None:
        draw = batch[0]
        first = MAX_DRAWS * number
        # few pipelines for any number of draws: the rest of the next power of two draws nothing
        room = 1 << (len(batch) - 1).bit_length()
        if room > len(batch):
            encoder.clear_buffer(self._arguments.raw, _ARGUMENTS * first, _ARGUMENTS * room)
        for place, each in enumerate(batch, start=first):
            length = 16 if _kind(each) in ("lists", "strips") else _ARGUMENTS
            encoder.copy_buffer_to_buffer(
                each.indirect.raw, each.offset, self._arguments.raw, _ARGUMENTS * place, length
            )
        prepare, triangles, _, groups = self._bound(draw, number)
        own = draw.group or self._no_group
        run = timer.compute_pass(encoder, "raster")
        run.set_pipeline(self._prepare_pipeline(draw, room, first))
        run.set_bind_group(0, prepare)
        run.dispatch_workgroups(1)
        run.set_pipeline(self._pipeline(draw, "draw_meshlets"))
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, own)
        run.set_bind_group(2, triangles)
        run.dispatch_workgroups_indirect(groups.raw, 0)
        # how much there is to do is known to the GPU alone: workgroups go on until all is done
        for kernel, count in (("split_large", _SPLITTERS), ("draw_blocks", _DRAWERS)):
            run.set_pipeline(self._pipeline(draw, kernel))
            run.dispatch_workgroups(count)
        run.end()

    def _show(
        self, encoder: Any, timer: FrameTimer, draw: Patches, number: int, view: ClipmapView, surface: Surface,
        first: bool, edges: bool,
    ) -> None:  # fmt: skip
        width, height = surface.size
        run = timer.compute_pass(encoder, "raster")
        run.set_pipeline(self._show_pipeline(draw, first, edges))
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, draw.group or self._no_group)
        run.set_bind_group(2, self._bound(draw, number)[2])
        run.set_bind_group(3, surface.write_group)
        run.dispatch_workgroups(-(-width // _TILE), -(-height // _TILE))
        run.end()

    def _bound(self, draw: Patches, number: int) -> tuple[Any, Any, Any, Buffer]:
        """Bind groups for preparing, drawing and showing a batch, and the arguments of its dispatch."""
        triangles = draw.index.meshlets if draw.index else self._nothing
        key = (number, triangles)
        if key not in self._groups:
            gpu = self._clipmap.gpu
            batch = gpu.buffer("batch", _BATCH, "STORAGE", "raster")
            groups = gpu.buffer("batch groups", 12, "STORAGE|INDIRECT", "raster")
            lists = draw.index.lists if draw.index else self._nothing
            prepare = {0: self._arguments, 1: lists, 2: batch, 3: groups, 4: self._queues}
            shown = {0: batch, 1: triangles, 2: self._visibility}
            drawn = {**shown, 3: self._queues, 4: self._large, 5: self._pieces, 6: self._blocks}
            self._groups[key] = (
                gpu.bind("batch", self._prepare_layout, prepare),
                gpu.bind("triangles", self._draw_layout, drawn),
                gpu.bind("visibility", self._show_layout, shown),
                groups,
            )
        return self._groups[key]

    def _prepare_pipeline(self, draw: Patches, draws: int, first: int) -> Any:
        kind = _kind(draw)
        key = ("prepare", kind, draws, first)
        if key not in self._pipelines:
            constants = {**self._constants(kind), "DRAWS": draws, "FIRST_DRAW": first}
            shader = self._clipmap.gpu.shader("batch", FOLDER / "prepare_batch.wgsl", constants=constants)
            self._pipelines[key] = self._clipmap.gpu.compute("batch", shader, "prepare_batch", [self._prepare_layout])
        return self._pipelines[key]

    def _pipeline(self, draw: Patches, kernel: str) -> Any:
        key = (kernel, *_key(draw))
        if key not in self._pipelines:
            self._pipelines[key] = self._compile(draw, kernel, [self._draw_layout], WITH_LEVELS=False)
        return self._pipelines[key]

    def _show_pipeline(self, draw: Patches, first: bool, edges: bool) -> Any:
        key = ("show_visibility", first, edges, *_key(draw))
        if key not in self._pipelines:
            layouts = [self._show_layout, self._target_layout]
            self._pipelines[key] = self._compile(
                draw, "show_visibility", layouts, RASTER_FIRST=first, RASTER_EDGES=edges
            )
        return self._pipelines[key]

    def _compile(self, draw: Patches, kernel: str, layouts: list[Any], **constants: bool) -> Any:
        module, gpu = draw.module, self._clipmap.gpu
        shader = gpu.shader(
            f"{module.path.parent.name} {kernel}",
            module.path,
            FOLDER / f"{kernel}.wgsl",
            search=[FOLDER, *SEARCH],
            constants={
                **self._clipmap.constants,
                **module.constants,
                **self._constants(_kind(draw)),
                "RASTER_COVERED": self._clipmap.heights.covered,
                **constants,
            },
        )
        return gpu.compute(kernel, shader, kernel, [self._clipmap.layout, module.layout or self._no_layout, *layouts])

    def _constants(self, kind: str) -> dict[str, int]:
        meshes = kind == "meshes"
        return {
            "RASTER_KIND": _KINDS.index(kind),
            "RASTER_GROUP": _GROUP,
            "RASTER_TRIANGLES": MESHLET_TRIANGLES if meshes else _GROUP,
            "RASTER_VERTICES": MESHLET_VERTICES if meshes else 3 * _GROUP,
            "RASTER_SPLITTERS": 64 * _SPLITTERS,
            "RASTER_DRAWERS": _DRAWERS,
            "RASTER_BITS": MESHLET_TRIANGLES.bit_length() - 1,
            "RASTER_MAX_DRAWS": MAX_DRAWS,
        }


def _batches(draws: Sequence[Patches]) -> list[list[Patches]]:
    """Draws that follow each other and differ only in their arguments, together."""
    same = groupby(draws, lambda d: (d.module, id(d.group), id(d.index), d.topology))
    return [list(batch) for _, batch in same]


def _kind(draw: Patches) -> str:
    return "meshes" if draw.index else _TOPOLOGIES[draw.topology]


def _key(draw: Patches) -> tuple[Any, ...]:
    return draw.module.path, tuple(draw.module.constants.items()), _kind(draw)
