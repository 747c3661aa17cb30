"""Executes draw lists: patches through the hardware pipeline, rays in a compute pass; both into the surface buffer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orogen.errors import SettingsError
from orogen.gpu import FrameTimer, Gpu
from orogen.lod.contract import Draw, Module, Patches, Rays
from orogen.raster.compute import ComputeRasterizer, can_rasterize
from orogen.raster.surface import FORMATS, READ_LAYOUT, WRITE_LAYOUT, Surface
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView
from orogen.streaming.software import block_copies
from orogen.values import expected_name

FOLDER = Path(__file__).parent

PATHS = ("auto", "hardware", "compute")
"""Ways of drawing patches: in compute on GPUs that can, where draws allow it; by the hardware pipeline; in compute."""

_TILE = 8


class Rasterizer:
    """The pipelines of a terrain, made when a module is first drawn."""

    def __init__(self, clipmap: Clipmap, path: str = "auto") -> None:
        """`path`: one of `PATHS`. Raises SettingsError where the adapter cannot follow it."""
        self._clipmap = clipmap
        self._path = path
        gpu = clipmap.gpu
        if path not in PATHS:
            raise expected_name("rasterizer", path, PATHS)
        if path == "compute" and not can_rasterize(gpu):
            raise SettingsError("rasterizer: the adapter lacks 64-bit atomics; choose 'auto' or 'hardware'")
        self.read_layout = gpu.layout("surface", READ_LAYOUT)
        """Layout of `Surface.read_group`."""
        self._write_layout = gpu.layout("surface targets", WRITE_LAYOUT)
        self._empty_layout = gpu.layout("nothing", {})
        self._empty_group = gpu.bind("nothing", self._empty_layout, {})
        self._pipelines: dict[tuple[Any, ...], Any] = {}
        self._compute = ComputeRasterizer(clipmap, self._write_layout) if _wants_compute(path, gpu) else None

    def another(self) -> Rasterizer:
        """One of the same kind, with queues of its own, for another view."""
        return Rasterizer(self._clipmap, self._path)

    def surface(self, size: tuple[int, int]) -> Surface:
        """A surface buffer of (width, height) pixels."""
        return Surface(self._clipmap.gpu, size, self.read_layout, self._write_layout)

    def record(
        self,
        encoder: Any,
        timer: FrameTimer,
        draws: Sequence[Draw],
        view: ClipmapView,
        surface: Surface,
        *,
        clear: bool = True,
        edges: bool = True,
    ) -> None:
        """Draw into the surface, cleared first unless `clear` is off; the nearest surface wins, whatever drew it.

        `edges`: whether distances to triangle edges are needed.
        """
        rays = [draw for draw in draws if isinstance(draw, Rays)]
        patches = [draw for draw in draws if isinstance(draw, Patches)]
        # rays alone need no clearing: that costs more than they do
        if patches or (clear and not rays):
            if self._compute and patches and self._compute.can_draw(patches):
                self._compute.record(encoder, timer, patches, view, surface, clear=clear, edges=edges)
            else:
                self._draw_patches(encoder, timer, patches, view, surface, clear)
        for number, draw in enumerate(rays):
            self._cast(encoder, timer, draw, view, surface, first=clear and not patches and number == 0)

    def forget(self) -> None:
        """Let go of what belongs to draws of earlier frames."""
        if self._compute:
            self._compute.forget()

    def incomplete(self) -> bool:
        """Whether the latest picture lacks something for want of room; asking makes room, so that a repeat is whole."""
        return self._compute is not None and self._compute.incomplete()

    def _draw_patches(
        self,
        encoder: Any,
        timer: FrameTimer,
        patches: Sequence[Patches],
        view: ClipmapView,
        surface: Surface,
        clear: bool,
    ) -> None:
        run = timer.render_pass(encoder, "raster", **(surface.cleared if clear else surface.kept))
        run.set_bind_group(0, view.bind_group)
        for draw in patches:
            run.set_pipeline(self._patch_pipeline(draw))
            run.set_bind_group(1, draw.group or self._empty_group)
            if draw.index is None:
                run.draw_indirect(draw.indirect.raw, draw.offset)
            else:
                run.set_index_buffer(draw.index.indices.raw, "uint32")
                run.draw_indexed_indirect(draw.indirect.raw, draw.offset)
        run.end()

    def _cast(
        self, encoder: Any, timer: FrameTimer, draw: Rays, view: ClipmapView, surface: Surface, *, first: bool
    ) -> None:
        width, height = surface.size
        run = timer.compute_pass(encoder, "rays")
        run.set_pipeline(self._ray_pipeline(draw, first))
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, draw.group or self._empty_group)
        run.set_bind_group(2, surface.write_group)
        run.dispatch_workgroups(-(-width // _TILE), -(-height // _TILE))
        run.end()

    def _shader(self, module: Module, main: Path, *parts: Path | str, **constants: bool | str) -> Any:
        return self._clipmap.gpu.shader(
            f"{module.path.parent.name} {main.stem}",
            module.path,
            main,
            *parts,
            search=[FOLDER, *SEARCH],
            constants={**self._clipmap.constants, **module.constants, **constants},
        )

    def _patch_pipeline(self, draw: Patches) -> Any:
        key = (draw.module.path, tuple(draw.module.constants.items()), draw.topology)
        if key not in self._pipelines:
            copies, names = block_copies(self._clipmap.gpu)
            self._pipelines[key] = self._clipmap.gpu.render(
                f"{draw.module.path.parent.name} patches",
                self._shader(
                    draw.module, FOLDER / "patch.wgsl", copies, RASTER_COVERED=self._clipmap.heights.covered, **names
                ),
                "corner",
                "surface",
                [{"format": form} for form in FORMATS.values()],
                [self._clipmap.layout, draw.module.layout or self._empty_layout],
                primitive={"topology": draw.topology},
                depth_stencil={"format": "depth32float", "depth_write_enabled": True, "depth_compare": "greater"},
            )
        return self._pipelines[key]

    def _ray_pipeline(self, draw: Rays, first: bool) -> Any:
        key = (draw.module.path, tuple(draw.module.constants.items()), first, draw.replace)
        if key not in self._pipelines:
            chosen = FOLDER / ("replace.wgsl" if draw.replace else "everywhere.wgsl")
            copies, names = block_copies(self._clipmap.gpu)
            self._pipelines[key] = self._clipmap.gpu.compute(
                f"{draw.module.path.parent.name} rays",
                self._shader(
                    draw.module, FOLDER / "rays.wgsl", chosen, copies, FIRST=first, REPLACE=draw.replace, **names
                ),
                "cast_rays",
                [self._clipmap.layout, draw.module.layout or self._empty_layout, self._write_layout],
            )
        return self._pipelines[key]


def _wants_compute(path: str, gpu: Gpu) -> bool:
    # software drivers draw triangles as fast themselves, and interpolate their depth a little better
    return path == "compute" or (path == "auto" and gpu.info.kind != "cpu" and can_rasterize(gpu))
