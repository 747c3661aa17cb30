"""A terrain: heights, the image draped over them, and pictures of both. What `orogen.open` gives."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import ArrayLike

from orogen.camera import Camera
from orogen.grid import Grid
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries
from orogen.source.open import open_colour, open_height
from orogen.values import expected_name, field_names, from_values

if TYPE_CHECKING:
    import wgpu

    from orogen.gpu import Gpu
    from orogen.shading.style import Style
    from orogen.streaming.settings import ClipmapSettings
    from orogen.view.renderer import Picture, Renderer, Scene

GPU_BUDGET = 512 << 20
"""Bytes of GPU memory that a terrain allocates at most, unless told otherwise."""


class Terrain:
    """Heights of any size and an optional image over them. Use it as a context manager or `close` it.

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
    ) -> None:
        """Use `orogen.open`."""
        self.heights = heights
        """The pyramid of heights."""
        self.colors = colors
        """The pyramid of the draped image, or None."""
        self._drawing = _chosen(algorithm, settings or {})
        self._adapter, self._rasterizer, self._gpu_memory = adapter, rasterizer, gpu_memory
        self._queries = Queries(heights)
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
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest valid height (m); an estimate until the pyramid is built."""
        return self.heights.height_range

    def camera(self, **options: Any) -> Camera:
        """A camera that shows the terrain; options as in `orogen.view.framing.frame_camera`."""
        from orogen.view.framing import frame_camera

        return frame_camera(self.grid, self.height_range, **{"height_at": self.height_at, **options})

    def height_at(self, x: ArrayLike, y: ArrayLike) -> Any:
        """Height (m) of the surface at x, y in the data's CRS; NaN outside and at nodata.

        A float for plain numbers, else float64 of the broadcast shape. See `orogen.queries.Queries.height_at`.
        """
        heights = self._queries.height_at(x, y)
        return heights if heights.ndim else float(heights)

    @property
    def renderer(self) -> Renderer:
        """What draws this terrain; opens the GPU when it is first asked for."""
        if self._renderer is None:
            from orogen.gpu import open_gpu
            from orogen.view.renderer import Renderer

            name, values, clipmap = self._drawing
            self._gpu = open_gpu(self._adapter, budget=self._gpu_memory)
            self._renderer = Renderer(
                self._gpu, self.heights, self.colors,
                name=name, settings=values, clipmap=clipmap, rasterizer=self._rasterizer,
            )  # fmt: skip
        return self._renderer

    @property
    def device(self) -> wgpu.GPUDevice:
        """The device that draws."""
        return self.renderer.device

    def use(self, name: str | None = None, **settings: Any) -> None:
        """Change the algorithm (None: the default) and its settings; what is resident stays so."""
        algorithm, values, _ = _chosen(name, settings)
        self.renderer.use(algorithm, values)

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
        return self.renderer.render(camera, size, style, scene, samples=samples)

    def draw_to(
        self,
        target: wgpu.GPUTextureView,
        camera: Camera,
        size: tuple[int, int],
        style: Style | None = None,
        scene: Scene | None = None,
    ) -> bool:
        """Draw into a texture from what is resident; whether a further call would improve the picture."""
        return self.renderer.draw_to(target, camera, size, style, scene)

    def pick(self, column: int, row: int) -> tuple[float, float, float] | None:
        """x, y in the data's CRS and height (m) of what the last picture shows at a pixel; None for the sky."""
        return self.renderer.pick(column, row)

    def close(self) -> None:
        """Stop loading, give memory back and release files."""
        self._close_renderer()
        self.heights.close()
        if self.colors:
            self.colors.close()

    def _close_renderer(self) -> None:
        if self._renderer:
            self._renderer.close()
            self._renderer = None
        if self._gpu:
            self._gpu.close()
            self._gpu = None

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


def open_terrain(
    data: Any,
    *,
    color: Any = None,
    color_extent: Literal["pixels", "samples"] = "pixels",
    spacing: float | None = None,
    height_scale: float | None = None,
    height_offset: float | None = None,
    nodata: float | None = None,
    vertical_units: str | None = None,
    crs: str | None = None,
    algorithm: str | None = None,
    settings: Mapping[str, Any] | None = None,
    adapter: str | None = None,
    rasterizer: str = "auto",
    gpu_memory: int | None = GPU_BUDGET,
    cache: str | os.PathLike[str] | None = None,
    build: Literal["wait", "background", "never"] = "wait",
    progress: Callable[[float, str], None] | None = None,
) -> Terrain:
    """Open elevation data of any size.

    data: path or GDAL name of a raster, an array of heights (rows, columns), or "synthetic".
    color: an image to drape over it: by its georeference, or without one over the same extent. color_extent: whether
    such an image spans the pixels of the heights or the centres of the outermost samples.
    spacing: metres between samples of data without georeference. height_scale, height_offset: metres = stored * scale
    + offset. nodata: stored value that means nodata. vertical_units: unit of the stored heights. crs: CRS of data that
    name none.
    algorithm: how the surface is drawn, see `orogen.lod.algorithms`; settings: of the algorithm and of the clipmap
    (`ClipmapSettings`) by name; adapter: index, kind or part of the name of the GPU; rasterizer: what draws
    triangles, "hardware", "compute" or "auto"; gpu_memory: bytes of GPU memory at most, None: no limit.
    cache: folder of built pyramids. build: whether to "wait" for the pyramid, to build it in the "background" or
    "never". progress: called with the part done (0 to 1) and what is done, from any thread.

    Raises SourceError where the data cannot be used.
    """
    # a wrong name is told before anything is read or built
    _chosen(algorithm, settings or {})
    heights = open_height(
        data, spacing=spacing, height_scale=height_scale, height_offset=height_offset, nodata=nodata,
        vertical_units=vertical_units, crs=crs,
    )  # fmt: skip
    colors = open_colour(color, heights, color_extent=color_extent) if color is not None else None
    folder = Path(cache) if cache is not None else None
    return Terrain(
        open_pyramid(heights, cache=folder, build=build, progress=progress),
        open_pyramid(colors, cache=folder, build=build, progress=progress) if colors is not None else None,
        algorithm=algorithm,
        settings=settings,
        adapter=adapter,
        rasterizer=rasterizer,
        gpu_memory=gpu_memory,
    )
