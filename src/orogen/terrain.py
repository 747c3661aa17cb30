"""A terrain: heights, the image draped over them, and pictures of both. What `orogen.open` gives."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from numpy.typing import ArrayLike

from orogen.camera import Camera
from orogen.errors import BudgetError, DeviceLostError, GpuError, NoAdapterError, SettingsError, ShaderError
from orogen.grid import Grid
from orogen.pyramid.composed import ComposedPyramid
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.queries import Field, Profile, Queries, Sight
from orogen.source.contract import attribution_of
from orogen.source.open import open_colour, open_height
from orogen.source.stored import draped
from orogen.source.vectors import open_vectors
from orogen.source.vectorstyle import VectorLayer
from orogen.streaming.faults import Fault, Faults
from orogen.values import expected_name, field_names, from_values

if TYPE_CHECKING:
    import wgpu

    from orogen.gpu import Gpu
    from orogen.shading.style import Style
    from orogen.source.painted import Stops
    from orogen.streaming.settings import ClipmapSettings
    from orogen.view.notebook import NotebookView
    from orogen.view.renderer import Picture, Renderer, Scene

T = TypeVar("T")

ATTEMPTS = 4
"""How often a picture is tried where the GPU fails on the way, before the error is raised."""
# one cause, whichever call noticed
_LOST = DeviceLostError("the GPU device was lost (driver reset, memory exhausted or device removed); another is opened")
GPU_BUDGET = 512 << 20
"""Bytes of GPU memory that a terrain allocates at most, unless told otherwise."""


class Terrain:
    """Heights of any size and an optional image over them. Use it as a context manager or `close` it.

    Safe to use from several threads at once: pictures are drawn one after the other, heights are looked up meanwhile.

    Attributes as in rasterio: `crs`, `bounds`, `transform`, `shape`, `res`, `nodata`, `units`, `vertical_crs`.
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
        self.heights = heights
        """The pyramid of heights."""
        self.colors = colors
        """The pyramid of the draped image, or None."""
        self._attribution = attribution
        self._drawing = _chosen(algorithm, settings or {})
        self._adapter, self._rasterizer, self._gpu_memory = adapter, rasterizer, gpu_memory
        self._queries = Queries(heights)
        self._faults = Faults()
        # re-entrant: drawing asks for the renderer
        self._lock = threading.RLock()
        self._closed = False
        self._gpu: Gpu | None = None
        self._renderer: Renderer | None = None

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.heights.source.name

    @property
    def grid(self) -> Grid:
        """Georeference of the heights."""
        return self.heights.grid

    @property
    def crs(self) -> str | None:
        """Coordinate reference system, or None."""
        return self.grid.crs

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(left, bottom, right, top) in CRS units."""
        return self.grid.bounds

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """(a, b, c, d, e, f): x = a column + b row + c, y = d column + e row + f."""
        return self.grid.transform

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.grid.shape

    @property
    def res(self) -> tuple[float, float]:
        """Width and height of a texel in CRS units."""
        a, b, _, d, e, _ = self.grid.transform
        return (a * a + d * d) ** 0.5, (b * b + e * e) ** 0.5

    @property
    def nodata(self) -> float | None:
        """Stored value that stands for nodata, or None."""
        return self.heights.source.nodata

    @property
    def units(self) -> str:
        """Vertical unit as stored; heights are given in metres all the same."""
        return self.heights.source.units

    @property
    def vertical_crs(self) -> str | None:
        """Name of the vertical reference, or None."""
        return self.heights.source.vertical_crs

    @property
    def attribution(self) -> str:
        """Who is to be named where the terrain is shown: as given, else as the data say; may be ""."""
        if self._attribution is not None:
            return self._attribution
        pyramids = (self.heights, self.colors) if self.colors else (self.heights,)
        return "; ".join(dict.fromkeys(filter(None, (attribution_of(pyramid.source) for pyramid in pyramids))))

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest valid height (m); an estimate until the pyramid is built."""
        return self.heights.height_range

    def camera(self, **options: Any) -> Camera:
        """A camera that shows the terrain; options as in `orogen.view.framing.frame_camera`."""
        from orogen.view.framing import frame_camera

        return frame_camera(self.grid, self.height_range, **{"height_at": self.height_at, **options})

    @property
    def queries(self) -> Queries:
        """What answers questions about the surface; those below, and shadow, slope and aspect."""
        return self._queries

    def height_at(self, x: ArrayLike, y: ArrayLike, *, crs: str | None = None) -> Any:
        """Height (m) of the surface at x, y in the data's CRS, or in `crs`; NaN outside and at nodata.

        A float for plain numbers, else float64 of the broadcast shape. See `orogen.queries.Queries.height_at`.
        """
        heights = self._queries.height_at(x, y, crs=crs)
        return heights if heights.ndim else float(heights)

    def normal_at(self, x: ArrayLike, y: ArrayLike, *, crs: str | None = None) -> Any:
        """(..., 3) unit normals (east, north, up) of the surface; see `orogen.queries.Queries.normal_at`."""
        return self._queries.normal_at(x, y, crs=crs)

    def raycast(self, origin: ArrayLike, direction: ArrayLike, **options: Any) -> Any:
        """(..., 3) x, y and height (m) where rays meet the surface; see `orogen.queries.Queries.raycast`."""
        return self._queries.raycast(origin, direction, **options)

    def line_of_sight(self, a: ArrayLike, b: ArrayLike, **options: Any) -> Sight:
        """Whether b is seen from a: x, y and metres above the ground; see `orogen.queries.Queries.line_of_sight`."""
        return self._queries.line_of_sight(a, b, **options)

    def profile(self, points: ArrayLike, step: float | None = None, *, crs: str | None = None) -> Profile:
        """Heights along a line through points; see `orogen.queries.Queries.profile`."""
        return self._queries.profile(points, step, crs=crs)

    def viewshed(self, observer: tuple[float, float], **options: Any) -> Field:
        """What is seen from a place; see `orogen.queries.Queries.viewshed`."""
        return self._queries.viewshed(observer, **options)

    @property
    def renderer(self) -> Renderer:
        """What draws this terrain; opens the GPU when it is first asked for.

        Another one after the device was lost. Not safe to use from several threads at once.
        """
        with self._lock:
            if self._renderer is None:
                self._renderer = self._opened()
            return self._renderer

    def _opened(self) -> Renderer:
        from orogen.gpu import open_gpu
        from orogen.view.renderer import Renderer

        if self._closed:
            raise SettingsError(f"{self.name}: expected an open terrain, got one that was closed; open it again")
        name, values, clipmap = self._drawing
        self._gpu = open_gpu(self._adapter, budget=self._gpu_memory)
        try:
            return Renderer(
                self._gpu, self.heights, self.colors,
                name=name, settings=values, clipmap=clipmap, rasterizer=self._rasterizer, faults=self._faults,
            )  # fmt: skip
        except BaseException:
            self._close_renderer()
            raise

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What went wrong while pictures went on, by cause; `Fault.missing` is 0 where it is over."""
        return self._faults.all

    @property
    def retry_in(self) -> float | None:
        """Seconds until data that could not be loaded are tried again; None where nothing has failed."""
        with self._lock:
            return self._renderer.retry_in if self._renderer else None

    def revive(self) -> bool:
        """Let go of a device that was lost, so that another one is opened; whether it was.

        `render`, `draw_to` and `pick` do so by themselves; this is for who uses `device`.
        """
        with self._lock:
            try:
                if self._gpu:
                    self._gpu.check()
                return False
            except DeviceLostError:
                self._faults.add("drawing", _LOST)
                self._close_renderer()
                return True

    def _drawn(self, draw: Callable[[Renderer], T]) -> T:
        """Draw, again where the GPU fails on the way: with a fresh view, then with everything on the GPU made anew."""
        from orogen.gpu.checked import checked

        with self._lock:
            for attempt in range(1, ATTEMPTS + 1):
                try:
                    with checked("drawing"):
                        return draw(self.renderer)
                except (NoAdapterError, ShaderError):
                    raise
                except GpuError as error:
                    hopeless = isinstance(error, BudgetError) and attempt > 1
                    self._faults.add("drawing", _LOST if isinstance(error, DeviceLostError) else error)
                    if attempt == ATTEMPTS or hopeless:
                        raise
                    self._recover(error, attempt)
            raise AssertionError("the last attempt returns or raises")

    def _recover(self, error: GpuError, attempt: int) -> None:
        if self._renderer and attempt == 1 and not isinstance(error, DeviceLostError):
            try:
                self._renderer.refresh()
                return
            except GpuError:
                pass
        self._close_renderer()

    @property
    def device(self) -> wgpu.GPUDevice:
        """The device that draws."""
        return self.renderer.device

    def use(self, name: str | None = None, **settings: Any) -> None:
        """Change the algorithm (None: the default) and its settings; what is resident stays so."""
        algorithm, values, _ = _chosen(name, settings)
        with self._lock:
            self._drawn(lambda renderer: renderer.use(algorithm, values))
            self._drawing = algorithm, values, self._drawing[2]

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

        `camera`: None shows the whole terrain. `size`: width and height in pixels. `samples`: per pixel, 1 to 256.
        """
        if camera is None:
            camera = self.camera(aspect=size[0] / max(size[1], 1), exaggeration=scene.exaggeration if scene else 1.0)
        return self._drawn(lambda renderer: renderer.render(camera, size, style, scene, samples=samples))

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
        with self._lock:
            device = self.device
            return self._drawn(
                lambda renderer: renderer.device is not device or renderer.draw_to(target, camera, size, style, scene)
            )

    def pick(self, column: int, row: int) -> tuple[float, float, float] | None:
        """x, y in the data's CRS and height (m) of what the last picture shows at a pixel; None for the sky."""
        return self._drawn(lambda renderer: renderer.pick(column, row))

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
        from orogen.view.session import Session
        from orogen.view.window import Window

        def opener(text: str) -> Terrain:
            return open_terrain(text, build="background")

        session = Session(self, style, scene, camera=camera, opener=opener)
        if in_notebook():
            size = size or (960, 540)
            return NotebookView(self, session, size=size, title=title or "", panel=panel, owned=owned)
        window = Window(session, size=size or (1280, 720), title=title or f"{self.name} - orogen", panel=panel)
        try:
            window.run()
        finally:
            window.close()
        return None

    def close(self) -> None:
        """Stop loading, give memory back and release files."""
        with self._lock:
            self._closed = True
            self._close_renderer()
            self.heights.close()
            if self.colors:
                self.colors.close()

    def _close_renderer(self) -> None:
        renderer, self._renderer = self._renderer, None
        gpu, self._gpu = self._gpu, None
        try:
            if renderer:
                renderer.close()
        finally:
            if gpu:
                gpu.close()

    def __enter__(self) -> Terrain:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _chosen(name: str | None, settings: Mapping[str, Any]) -> tuple[str, dict[str, Any], ClipmapSettings]:
    """Name of an algorithm, and settings parted into its own, checked, and the clipmap's."""
    from orogen.lod import DEFAULT, algorithm, make_settings
    from orogen.streaming.settings import ClipmapSettings

    name = name or DEFAULT
    own, shared = field_names(algorithm(name).Settings), field_names(ClipmapSettings)
    for key in settings:
        if key not in own and key not in shared:
            raise expected_name(f"setting of {name}", key, [*own, *shared])
    values = {key: value for key, value in settings.items() if key in own}
    make_settings(name, values)
    return name, values, from_values(ClipmapSettings, "clipmap", {k: v for k, v in settings.items() if k in shared})


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
    (a folder or a template with {z}, {x} and {y}), an array of heights (rows, columns), "synthetic" or "procedural".
    color: an image to drape over it: by its georeference, or without one over the same extent. color_extent: whether
    such an image spans the pixels of the heights or the centres of the outermost samples. color_ramp: name of a colour
    ramp, or a file of one: `color` is a raster of one band then, whose values it colours.
    overlay: vector files to draw over that, the last on top: paths, such as "trails.gpkg,color=red,width=20", or
    `orogen.source.vectorstyle.VectorLayer`s.
    attribution: who is to be named where the terrain is shown, instead of those that the data name.
    spacing: metres between samples of data without georeference. height_scale, height_offset: metres = stored * scale
    + offset. nodata: stored value that means nodata. vertical_units: unit of the stored heights. crs: CRS of data that
    name none; data of another one are warped to it. encoding: how colours hold heights, "terrain-rgb" or "terrarium".
    zoom, area: of map tiles, area as west, south, east and north in degrees.
    algorithm: how the surface is drawn, see `orogen.lod.algorithms`; settings: of the algorithm and of the clipmap
    (`ClipmapSettings`) by name; adapter: index, kind or part of the name of the GPU; rasterizer: what draws
    triangles, "hardware", "compute" or "auto"; gpu_memory: bytes of GPU memory at most, None: no limit.
    cache: folder of built pyramids. build: whether to "wait" for the pyramid, to build it in the "background" or
    "never"; "auto" waits unless the file has overviews, which are drawn from without building, as they are with
    "background" and "never". progress: called with the part done (0 to 1) and what is done, from any thread.

    Raises SourceError where the data cannot be used.
    """
    # a wrong name is told before anything is read or built
    _chosen(algorithm, settings or {})
    heights = open_height(
        data, spacing=spacing, height_scale=height_scale, height_offset=height_offset, nodata=nodata,
        vertical_units=vertical_units, crs=crs, encoding=encoding, zoom=zoom, area=area,
    )  # fmt: skip
    color = draped(data, color)
    if color_ramp is not None and color is None:
        raise SettingsError("color_ramp: expected color= too, a raster of one band to be coloured by it, got none")
    ramp = _ramp(color_ramp) if color_ramp is not None else None
    image = open_colour(color, heights, color_extent=color_extent, ramp=ramp) if color is not None else None
    layers = [overlay] if isinstance(overlay, str | os.PathLike | VectorLayer) else overlay
    drawn = open_vectors(layers, heights.grid, image) if layers else None
    folder = Path(cache) if cache is not None else None
    colors = open_pyramid(image, cache=folder, build=build, progress=progress) if image is not None else None
    if drawn is not None:
        above = open_pyramid(drawn)
        colors = ComposedPyramid(colors, above) if colors is not None else above
    return Terrain(
        open_pyramid(heights, cache=folder, build=build, progress=progress),
        colors,
        algorithm=algorithm,
        settings=settings,
        adapter=adapter,
        rasterizer=rasterizer,
        gpu_memory=gpu_memory,
        attribution=attribution,
    )
