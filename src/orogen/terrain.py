"""A terrain: heights, the image draped over them, and pictures of both. What `orogen.open` gives."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.pyramid.composed import ComposedPyramid
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.queries.dataset import Dataset
from orogen.source.contract import attribution_of
from orogen.source.open import open_colour, open_height
from orogen.source.stored import draped
from orogen.source.vectors import open_vectors
from orogen.source.vectorstyle import VectorLayer
from orogen.streaming.faults import Fault, Faults
from orogen.view.recovery import Recovery

if TYPE_CHECKING:
    import wgpu

    from orogen.shading.style import Style
    from orogen.source.painted import Stops
    from orogen.view.notebook import NotebookView
    from orogen.view.renderer import Picture, Renderer, Scene

GPU_BUDGET = 512 << 20
"""Bytes of GPU memory that a terrain allocates at most, unless told otherwise."""


class Terrain(Dataset):
    """Heights of any size and an optional image over them. Use it as a context manager or `close` it.

    Safe to use from several threads at once: pictures are drawn one after the other, heights are looked up meanwhile.
    """

    def __init__(
        self,
        heights: Pyramid,
        colors: Pyramid | None = None,
        *,
        algorithm: str | None = None,
        settings: Mapping[str, Any] | None = None,
        adapter: str | None = None,
        rasterizer: str = "auto",
        gpu_memory: int | None = GPU_BUDGET,
        attribution: str | None = None,
    ) -> None:
        """Use `orogen.open`."""
        from orogen.view.choice import choose

        super().__init__(heights)
        self.colors = colors
        """The pyramid of the draped image, or None."""
        self._attribution = attribution
        given: object = gpu_memory
        if not isinstance(given, Real | None) or (gpu_memory is not None and gpu_memory <= 0):
            raise SettingsError(f"gpu_memory: expected bytes above 0 or None, got {gpu_memory!r}")
        self._choice = choose(algorithm, settings or {})
        self._adapter, self._rasterizer, self._gpu_memory = adapter, rasterizer, gpu_memory
        self._recovery = Recovery(self._opened)
        self._closed = False

    @property
    def attribution(self) -> str:
        """Who is to be named where the terrain is shown: as given, else as the data say; may be ""."""
        if self._attribution is not None:
            return self._attribution
        pyramids = (self.heights, self.colors) if self.colors else (self.heights,)
        return "; ".join(dict.fromkeys(filter(None, (attribution_of(pyramid.source) for pyramid in pyramids))))

    def camera(self, **options: Any) -> Camera:
        """A camera that shows the terrain, all of it unless options say otherwise.

        Options: look_at (x, y in the data's CRS), distance (m), heading, pitch and fov (degrees), orthographic, bounds
        (left, bottom, right, top), exaggeration and aspect, see `orogen.view.framing.frame_camera`. Raises
        SettingsError, naming the option, for values out of their range.
        """
        from orogen.view.framing import frame_camera

        return frame_camera(self.grid, self.height_range, **{"height_at": self.height_at, **options})

    @property
    def renderer(self) -> Renderer:
        """What draws this terrain; opens the GPU when it is first asked for.

        Another one after the device was lost. Not safe to use from several threads at once.
        """
        return self._recovery.renderer

    def _opened(self, faults: Faults) -> Renderer:
        from orogen.gpu import open_gpu
        from orogen.view.renderer import Renderer

        if self._closed:
            raise SettingsError(f"{self.name}: expected an open terrain, got one that was closed; open it again")
        chosen = self._choice
        gpu = open_gpu(self._adapter, budget=self._gpu_memory)
        try:
            return Renderer(
                gpu, self.heights, self.colors,
                name=chosen.name, settings=chosen.settings, clipmap=chosen.clipmap, rasterizer=self._rasterizer,
                faults=faults,
            )  # fmt: skip
        except BaseException:
            gpu.close()
            raise

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What went wrong while pictures went on, by cause; `Fault.missing` is 0 where it is over."""
        return self._recovery.faults.all

    @property
    def retry_in(self) -> float | None:
        """Seconds until data that could not be loaded are tried again; None where nothing has failed."""
        return self._recovery.retry_in

    def revive(self) -> bool:
        """Let go of a device that was lost, so that another one is opened; whether it was.

        `render`, `draw_to` and `pick` do so by themselves; this is for who uses `device`.
        """
        return self._recovery.revive()

    @property
    def device(self) -> wgpu.GPUDevice:
        """The device that draws."""
        return self.renderer.device

    def use(self, name: str | None = None, **settings: Any) -> None:
        """Change the algorithm (None: the default) and its settings; what is resident stays so.

        Raises SettingsError for names that do not exist and values out of their range: nothing is changed then.
        """
        from orogen.view.choice import choose

        chosen = choose(name, settings)
        with self._recovery.lock:
            self._recovery.draw(lambda renderer: renderer.use(chosen.name, chosen.settings))
            self._choice = replace(chosen, clipmap=self._choice.clipmap)

    def render(
        self,
        camera: Camera | None = None,
        size: tuple[int, int] = (1280, 720),
        style: Style | None = None,
        scene: Scene | None = None,
        *,
        samples: int = 4,
    ) -> Picture:
        """A complete picture, the same each time.

        `camera`: None shows the whole terrain. `size`: width and height in pixels; what is more than the GPU holds is
        drawn in parts. `style` and `scene`: None for the defaults. `samples`: per pixel, 1 to 256. Waits for what the
        picture needs.

        Raises SettingsError for values out of their range, SourceError or StoreError where nothing of the data can be
        read, and GpuError (NoAdapterError, BudgetError, DeviceLostError) where the GPU cannot draw it.
        """
        from orogen.shading.style import Style
        from orogen.view.parts import check_picture_size
        from orogen.view.renderer import Scene

        check_picture_size(size)
        for name, value, kind in (("camera", camera, Camera), ("style", style, Style), ("scene", scene, Scene)):
            if not isinstance(value, kind | None):
                raise SettingsError(f"{name}: expected an orogen.{kind.__name__} or None, got {value!r}")
        if camera is None:
            camera = self.camera(aspect=size[0] / size[1], exaggeration=scene.exaggeration if scene else 1.0)
        return self._recovery.draw(lambda renderer: renderer.render(camera, size, style, scene, samples=samples))

    def draw_to(
        self,
        target: wgpu.GPUTextureView,
        camera: Camera,
        size: tuple[int, int],
        style: Style | None = None,
        scene: Scene | None = None,
    ) -> bool:
        """Draw into a texture from what is resident; whether a further call would improve the picture.

        Where the device is lost, and `target` with it, nothing is drawn and `device` is another one from then on.
        """
        with self._recovery.lock:
            device = self.device
            return self._recovery.draw(
                lambda renderer: renderer.device is not device or renderer.draw_to(target, camera, size, style, scene)
            )

    def pick(self, column: int, row: int) -> tuple[float, float, float] | None:
        """x, y in the data's CRS and height (m) of what the last picture shows at a pixel.

        `column` and `row` count from 0 at the upper left. None for the sky, outside the picture and before the first.
        """
        return self._recovery.draw(lambda renderer: renderer.pick(column, row))

    def view(
        self,
        camera: Camera | None = None,
        style: Style | None = None,
        scene: Scene | None = None,
        *,
        size: tuple[int, int] | None = None,
        title: str | None = None,
        panel: bool = True,
        owned: bool = False,
    ) -> NotebookView | None:
        """Move through the terrain: in a notebook in a widget, which this gives; else in a window, until it is closed.

        `camera`: where to begin; None shows the whole terrain. `size`: width and height in logical pixels.
        `panel`: whether there is one, where imgui-bundle is installed. `owned`: close the terrain with the widget.
        Raises OutputError where no window can be opened.
        """
        from orogen.view.notebook import NotebookView, in_notebook
        from orogen.view.opening import Shared
        from orogen.view.session import Session
        from orogen.view.window import Window

        def opener(text: str) -> Terrain:
            return open_terrain(text, build="background")

        if in_notebook():
            session = Session(Shared(self), style, scene, camera=camera, opener=opener, owned=True)
            size = size or (960, 540)
            return NotebookView(self, session, size=size, title=title or "", panel=panel, owned=owned)
        session = Session(self, style, scene, camera=camera, opener=opener)
        window = Window(session, size=size or (1280, 720), title=title or f"{self.name} - orogen", panel=panel)
        try:
            window.run()
        finally:
            window.close()
        return None

    def close(self) -> None:
        """Stop loading, give memory back and release files. What draws afterwards raises SettingsError."""
        with self._recovery.lock:
            self._closed = True
            self._recovery.close()
            self.heights.close()
            if self.colors:
                self.colors.close()

    def __enter__(self) -> Terrain:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _ramp(name: str) -> Stops:
    from orogen.shading.ramp import ramp_stops

    return ramp_stops(name)


def open_terrain(
    data: Any,
    *,
    color: Any = None,
    color_extent: Literal["pixels", "samples"] = "pixels",
    color_ramp: str | None = None,
    overlay: str | os.PathLike[str] | VectorLayer | Sequence[str | os.PathLike[str] | VectorLayer] | None = None,
    attribution: str | None = None,
    spacing: float | None = None,
    height_scale: float | None = None,
    height_offset: float | None = None,
    nodata: float | None = None,
    vertical_units: str | None = None,
    crs: str | None = None,
    encoding: str | None = None,
    zoom: int | None = None,
    area: tuple[float, float, float, float] | None = None,
    algorithm: str | None = None,
    settings: Mapping[str, Any] | None = None,
    adapter: str | None = None,
    rasterizer: str = "auto",
    gpu_memory: int | None = GPU_BUDGET,
    cache: str | os.PathLike[str] | None = None,
    build: Literal["auto", "wait", "background", "never"] = "auto",
    progress: Callable[[float, str], None] | None = None,
) -> Terrain:
    """Open elevation data of any size.

    data: path, URL or GDAL name of a raster, a list of them, a pattern or a folder of rasters (a mosaic), map tiles
    (a folder or a template with {z}, {x} and {y}), an array of heights (rows, columns) of numpy or xarray, an open
    rasterio dataset, "synthetic" or "procedural".

    What is draped over it
    color: an image, a list of them, a pattern, a folder or map tiles, laid by its georeference, or without one over the
    same extent.
    color_extent: whether such an image spans the "pixels" of the heights or the centres of the outermost "samples".
    color_ramp: name of a colour ramp, or a file of one: `color` is a raster of one band then, whose values it colours.
    overlay: vector files to draw over that, the last on top: paths, such as "trails.gpkg,color=red,width=20", or
    `orogen.source.vectorstyle.VectorLayer`s.
    attribution: who is to be named where the terrain is shown, instead of those that the data name.

    What the data do not say, or say wrongly
    spacing: metres between samples of data without georeference.
    height_scale, height_offset: metres = stored * scale + offset.
    nodata: stored value that means nodata.
    vertical_units: unit of the stored heights, such as "foot".
    crs: CRS of data that name none ("EPSG:n", WKT); data of another one are warped to it.
    encoding: how colours hold heights, "terrain-rgb" or "terrarium".
    zoom, area: of map tiles; area as west, south, east and north in degrees.

    How it is drawn
    algorithm: by name, see `orogen.lod.algorithms`.
    settings: values by name, of the algorithm and of the clipmap (`ClipmapSettings`).
    adapter: the GPU: index, kind or part of the name.
    rasterizer: what draws triangles, "hardware", "compute" or "auto".
    gpu_memory: bytes of GPU memory at most; None: no limit.

    How it is kept
    cache: folder of built pyramids.
    build: whether to "wait" for the pyramid, to build it in the "background" or "never"; "auto" waits unless the file
    has overviews, which are drawn from without building, as they are with "background" and "never".
    progress: called with the part done (0 to 1) and what is done, from any thread.

    Raises SourceError where the data cannot be used, SettingsError for options out of their range, StoreError where a
    built pyramid is damaged, and OutputError where the pyramid cannot be kept. No GPU is needed until it is drawn.
    """
    from orogen.view.choice import choose

    # a wrong name is told before anything is read or built
    choose(algorithm, settings or {})
    folder = Path(cache) if cache is not None else None
    # what was opened before something fails is closed again; a pyramid closes its source
    with contextlib.ExitStack() as opened:
        heights = open_height(
            data, spacing=spacing, height_scale=height_scale, height_offset=height_offset, nodata=nodata,
            vertical_units=vertical_units, crs=crs, encoding=encoding, zoom=zoom, area=area,
        )  # fmt: skip
        opened.callback(heights.close)
        color = draped(data, color)
        if color_ramp is not None and color is None:
            raise SettingsError("color_ramp: expected color= too, a raster of one band to be coloured by it, got none")
        ramp = _ramp(color_ramp) if color_ramp is not None else None
        image = open_colour(color, heights, color_extent=color_extent, ramp=ramp) if color is not None else None
        if image is not None:
            opened.callback(image.close)
        layers = [overlay] if isinstance(overlay, str | os.PathLike | VectorLayer) else overlay
        drawn = open_vectors(layers, heights.grid, image) if layers else None
        colors = open_pyramid(image, cache=folder, build=build, progress=progress) if image is not None else None
        if drawn is not None:
            above = open_pyramid(drawn)
            colors = ComposedPyramid(colors, above) if colors is not None else above
        if colors is not None:
            opened.callback(colors.close)
        terrain = Terrain(
            open_pyramid(heights, cache=folder, build=build, progress=progress),
            colors,
            algorithm=algorithm,
            settings=settings,
            adapter=adapter,
            rasterizer=rasterizer,
            gpu_memory=gpu_memory,
            attribution=attribution,
        )
        opened.pop_all()
        return terrain
