"""Surface buffer to picture: shading of one sample after another, then their mean as sRGB."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.errors import GpuError
from orogen.frame import Frame
from orogen.shading.color import parse_hex
from orogen.shading.light import light_of
from orogen.shading.ramp import RAMP_SIZE, ramp_range, ramp_table
from orogen.shading.style import Style
from orogen.streaming.software import block_copies

if TYPE_CHECKING:
    from orogen.gpu import Buffer, FrameTimer, Gpu, Texture

_HERE = Path(__file__).parent
_GROUP = 8
_STYLE_FLOATS = 32
_RESOLVE_FLOATS = 8

# flags of shade.wgsl
_LIT, _SHADOWS, _SKY = 1, 2, 4
_OVERLAY_FLAGS = {"wireframe": 8, "levels": 16, "nodes": 32, "contours": 64, "error": 128}
_IMAGE, _RAMP = 256, 512
_COLOR_FLAGS = {"auto": _IMAGE | _RAMP, "image": _IMAGE, "ramp": _RAMP, "plain": 0}
# flag of develop.wgsl
_TONED = 1


class Layouts(NamedTuple):
    """Of what the shaders of a picture read and write."""

    add: Any
    """Bind group 1 of accumulate.wgsl."""
    finish: Any
    """Bind group 1 of finish.wgsl."""
    resolve: Any
    """Bind group 0 of resolve.wgsl."""


class Samples:
    """The light that the samples of one picture add up to, and the picture. Of one view; see `Shading.samples`."""

    def __init__(self, gpu: Gpu, size: tuple[int, int], layouts: Layouts) -> None:
        """`size`: width and height in pixels."""
        self._gpu = gpu
        self._layouts = layouts
        self.size = size
        """Width and height in pixels."""
        self.count = 0
        """Samples added since the last `reset`."""
        self.ramp: str | None = None
        """Name of the ramp that `ramp_table` holds."""
        self.styled: Any = None
        """What `style` was made of."""
        self.style = gpu.buffer("style", 4 * _STYLE_FLOATS, "UNIFORM|COPY_DST", "shading")
        self.ramp_table = gpu.buffer("ramp", 16 * RAMP_SIZE, "UNIFORM|COPY_DST", "shading")
        self.resolve = gpu.buffer("resolve", 4 * _RESOLVE_FLOATS, "UNIFORM|COPY_DST", "shading")
        self._written: dict[Buffer, bytes] = {}
        self._nothing = gpu.buffer("no sums", 16, "STORAGE", "shading")

    @cached_property
    def light(self) -> Buffer:
        """Sums of linear RGB and of cover, four float32 a pixel, row by row from the upper left."""
        width, height = self.size
        return self._gpu.buffer("samples", 16 * width * height, "STORAGE|COPY_DST|COPY_SRC", "shading")

    @cached_property
    def picture(self) -> Texture:
        """What the last sample finished: sRGB and alpha."""
        return self._gpu.texture("picture", self.size, "rgba8unorm", "STORAGE_BINDING|COPY_SRC", "surface")

    @cached_property
    def add_group(self) -> Any:
        """Bind group 1 of accumulate.wgsl."""
        return self._gpu.bind("shade", self._layouts.add, {0: self.style, 1: self.ramp_table, 2: self.light})

    @cached_property
    def finish_group(self) -> Any:
        """Bind group 1 of finish.wgsl for the last of several samples."""
        return self._finish_group(self.light)

    @cached_property
    def only_group(self) -> Any:
        """Bind group 1 of finish.wgsl for a picture of one sample, which sums nothing."""
        return self._finish_group(self._nothing)

    def _finish_group(self, light: Buffer) -> Any:
        entries = {0: self.style, 1: self.ramp_table, 2: light, 3: self.resolve, 4: self.picture}
        return self._gpu.bind("finish", self._layouts.finish, entries)

    @cached_property
    def resolve_group(self) -> Any:
        """Bind group 0 of resolve.wgsl."""
        return self._gpu.bind("resolve", self._layouts.resolve, {0: self.resolve, 1: self.light})

    def write(self, buffer: Buffer, block: NDArray[np.float32]) -> None:
        """Write what is to be in one of the uniform buffers, unless it is there already."""
        data = block.tobytes()
        if self._written.get(buffer) != data:
            self._gpu.write(buffer, data)
            self._written[buffer] = data

    def reset(self) -> None:
        """Start a new picture."""
        self.count = 0

    def destroy(self) -> None:
        """Give the GPU memory back."""
        made = vars(self)
        for resource in (self.style, self.ramp_table, self.resolve, self._nothing):
            resource.destroy()
        for name in ("light", "picture"):
            if name in made:
                made[name].destroy()


class Shading:
    """The pipelines of the room.

    A picture: `samples.reset()`, then per sample draw the surface buffer and `record`, the last with `last`, which
    makes `samples.picture`; or at any time `resolve` into a texture that can only be drawn to.
    """

    def __init__(
        self,
        gpu: Gpu,
        scene_layout: Any,
        surface_layout: Any,
        search: Sequence[Path],
        constants: Mapping[str, int | float | str],
        *,
        image: bool = True,
    ) -> None:
        """`scene_layout`: of bind group 0, which frame.wgsl, clipmap.wgsl and trace.wgsl declare; `surface_layout`: of
        bind group 2, which surface.wgsl declares; `search`: folders of these files; `constants`: what they ask for.
        `image`: whether there is one to drape; without, its filtering is left out of the shader.
        """
        self._gpu = gpu
        self._scene_layout, self._surface_layout = scene_layout, surface_layout
        self._search, self._constants = tuple(search), dict(constants)
        self._image = image
        adding = {0: ("COMPUTE", "uniform"), 1: ("COMPUTE", "uniform"), 2: ("COMPUTE", "storage")}
        finishing = {**adding, 3: ("COMPUTE", "uniform"), 4: ("COMPUTE", "image rgba8unorm write")}
        self._layouts = Layouts(
            gpu.layout("shade", adding),
            gpu.layout("finish", finishing),
            gpu.layout("resolve", {0: ("FRAGMENT", "uniform"), 1: ("FRAGMENT", "read")}),
        )
        self._shade_pipelines: dict[tuple[int, bool, bool], Any] = {}
        self._resolve_pipelines: dict[str, Any] = {}

    def samples(self, size: tuple[int, int]) -> Samples:
        """Room for the samples of a picture of (width, height) pixels.

        That is 16 bytes of GPU memory a pixel for sums, where there are several, and 4 for a finished picture.
        """
        return Samples(self._gpu, size, self._layouts)

    def record(
        self,
        encoder: Any,
        timer: FrameTimer,
        frame: Frame,
        scene_group: Any,
        surface_group: Any,
        samples: Samples,
        style: Style,
        *,
        last: bool = False,
    ) -> None:
        """Record the shading of a surface buffer as one more sample: bind groups 0 and 2. The `last` makes the picture.

        Camera, size and style are those of all samples of the picture; only the jitter changes between them. The first
        use of a combination of colour source, light, shadows, background and overlays compiles a pipeline for it.
        """
        if frame.size != samples.size:
            raise GpuError(f"shading: expected samples for the frame's {frame.size} pixels, got {samples.size}")
        styled = style, frame.grid, frame.height_range, frame.exaggeration, frame.camera.orthographic
        if styled != samples.styled:
            samples.write(samples.style, style_block(style, frame))
            samples.styled = styled
        if samples.ramp != style.ramp:
            table = np.ones((RAMP_SIZE, 4), np.float32)
            table[:, :3] = ramp_table(style.ramp)
            self._gpu.write(samples.ramp_table, table)
            samples.ramp = style.ramp
        first = samples.count == 0
        samples.count += 1
        if last:
            samples.write(samples.resolve, resolve_block(style, samples))
            group = samples.only_group if first else samples.finish_group
        else:
            group = samples.add_group
        width, height = samples.size
        shade = timer.compute_pass(encoder, "shade")
        shade.set_pipeline(self._shade_pipeline(flags_of(style, image=self._image), first, last))
        shade.set_bind_group(0, scene_group)
        shade.set_bind_group(1, group)
        shade.set_bind_group(2, surface_group)
        shade.dispatch_workgroups(-(-width // _GROUP), -(-height // _GROUP))
        shade.end()

    def _shade_pipeline(self, flags: int, first: bool, last: bool) -> Any:
        key = flags, first, last
        if key not in self._shade_pipelines:
            copies, names = block_copies(self._gpu)
            tones = bool(flags & _LIT)
            constants = {**self._constants, **names, "FLAGS": flags, "FIRST": first, "ANY_HIT": True, "TONES": tones}
            name = "finish" if last else "accumulate"
            sources = _HERE / f"{name}.wgsl", copies
            shader = self._gpu.shader(name, *sources, search=self._search, constants=constants)
            own = self._layouts.finish if last else self._layouts.add
            layouts = [self._scene_layout, own, self._surface_layout]
            self._shade_pipelines[key] = self._gpu.compute(name, shader, name, layouts)
        return self._shade_pipelines[key]

    def resolve(self, encoder: Any, timer: FrameTimer, samples: Samples, view: Any, style: Style) -> None:
        """Record the mean of the samples so far as a picture, in sRGB, not multiplied by alpha.

        In a texture of 8 bits what lies between two steps is one or the other, pixel by pixel in a fixed pattern.
        `view`: a texture view, a window's for one, of the samples' size and of a format that can be drawn to, which is
        its texture's; those that end in "-srgb" do the encoding themselves.
        """
        form: str = view.texture.format
        samples.write(samples.resolve, resolve_block(style, samples))
        if form not in self._resolve_pipelines:
            step = 1 / 255 if "8unorm" in form else 0.0
            constants = {"TONES": True, "STEP": step, "ENCODES": form.endswith("-srgb")}
            shader = self._gpu.shader("resolve", _HERE / "resolve.wgsl", constants=constants)
            self._resolve_pipelines[form] = self._gpu.render(
                "resolve", shader, "cover", "develop", [{"format": form}], [self._layouts.resolve]
            )
        attachment = {"view": view, "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 0)}
        resolve = timer.render_pass(encoder, "resolve", color_attachments=[attachment])
        resolve.set_pipeline(self._resolve_pipelines[form])
        resolve.set_bind_group(0, samples.resolve_group)
        resolve.draw(3)
        resolve.end()


def flags_of(style: Style, *, image: bool) -> int:
    """The FLAGS of shade.wgsl."""
    flags = _COLOR_FLAGS[style.color] & ~(0 if image else _IMAGE)
    flags |= _SKY if style.background == "sky" else 0
    if style.lit:
        flags |= _LIT | (_SHADOWS if style.shadows else 0)
    for overlay in style.overlays:
        flags |= _OVERLAY_FLAGS[overlay]
    return flags


def style_block(style: Style, frame: Frame) -> NDArray[np.float32]:
    """The `StyleBlock` of shade.wgsl, (32,)."""
    light = light_of(style)
    density, falloff, base = haze(style, frame)
    low, high = style.ramp_range or ramp_range(style.ramp) or frame.height_range
    block = np.zeros(_STYLE_FLOATS, np.float32)
    rows = block[:24].reshape(6, 4)
    colors = (light.sun, light.sun_color, light.zenith, light.horizon, light.skylight, light.bounce)
    rows[:, :3] = np.stack(colors)
    rows[:3, 3] = density, falloff, base
    block[24:26] = low, 1 / (high - low) if high > low else 0.0
    block[26:29] = contour_interval(style, frame), style.error_limit_px, style.wireframe_width
    return block


def resolve_block(style: Style, samples: Samples) -> NDArray[np.float32]:
    """The `ResolveBlock` of develop.wgsl, (8,)."""
    block = np.zeros(_RESOLVE_FLOATS, np.float32)
    if style.background.startswith("#"):
        block[:4] = (*parse_hex(style.background), 1.0)
    block[4:6] = 1 / max(samples.count, 1), style.exposure
    block[6:8].view(np.uint32)[:] = samples.size[0], _TONED if style.lit else 0
    return block


def haze(style: Style, frame: Frame) -> tuple[float, float, float]:
    """Density at its base (1 / m), its falloff upwards (1 / m) and its base (drawn metres).

    The falloff follows the size of the data: from high above, a whole data set shines through; from the ground, its far
    ridges fade.
    """
    low, high = (height * frame.exaggeration for height in frame.height_range)
    diagonal = float(np.hypot(*(frame.grid.metres @ np.array([frame.grid.width, frame.grid.height]))))
    visibility = style.visibility if style.visibility is not None else 2 * diagonal
    density = 0.0 if frame.camera.orthographic else 1 / visibility
    return density, 1 / max(0.5 * (high - low), 0.05 * diagonal), low


def contour_interval(style: Style, frame: Frame) -> float:
    """Metres of height between contours; where the style leaves it open the next 1, 2 or 5 times a power of ten."""
    if style.contour_interval > 0:
        return style.contour_interval
    low, high = frame.height_range
    wanted = (high - low) / 20
    if wanted <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= wanted * (1 - 1e-9))
