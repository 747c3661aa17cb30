"""Terrain to pictures: one terrain on the GPU, one view of it, an algorithm and the shading."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
import wgpu
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu, Readback
from orogen.gpu.load import Load
from orogen.lod import DEFAULT, algorithm, make_settings
from orogen.lod.contract import Draw, Statistics
from orogen.pyramid.contract import Pyramid
from orogen.raster.rasterizer import FOLDER as RASTER
from orogen.raster.rasterizer import Rasterizer
from orogen.raster.surface import Surface
from orogen.shading.light import sun_of
from orogen.shading.shade import Samples, Shading
from orogen.shading.style import Style
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.faults import Faults
from orogen.streaming.settings import ClipmapSettings
from orogen.view.parts import PIXEL_BYTES, Part, check_picture_size, divisions, parts

TOGETHER = 4
"""Frames that are submitted together to time one of them."""
BUSY = 50.0
"""Milliseconds of other work before a frame that is timed, at least: an H200 takes as long to raise its clock."""
TIMED = 8
"""Every so many frames of a window are timed."""
STILL_SAMPLES = 16
"""Samples per pixel that a window gathers while nothing moves."""
FIRST_WAIT = 0.2
"""Seconds that the first picture of a window waits for ground, at most."""
BALANCED = {2: (3, 9), 4: (9, 12, 13, 15), 8: (0, 3, 5, 6, 7, 8, 9, 11)}
"""Which of them come first where so many are added at once: those whose mean is the pixel's centre."""


@dataclass(frozen=True)
class Scene:
    """How the terrain is put before the camera."""

    exaggeration: float = 1.0
    """Factor on all heights, above 0."""
    curvature: bool = False
    """Whether the ground drops with the distance as on a sphere of the earth's radius."""
    lod_camera: Camera | None = None
    """Camera that decides on levels of detail and culling; None: the one that looks."""
    coarseness: float = 1.0
    """Factor, at least 1, by which triangles may be larger than the algorithm's settings say."""

    def __post_init__(self) -> None:
        for name, least in (("exaggeration", "a number above 0"), ("coarseness", "1 or more")):
            value = getattr(self, name)
            number = isinstance(value, Real) and math.isfinite(value)
            if not number or value <= 0 or (name == "coarseness" and value < 1):
                raise SettingsError(f"{name}: expected {least}, got {value!r}")
        if not isinstance(self.curvature, bool | np.bool_):
            raise SettingsError(f"curvature: expected True or False, got {self.curvature!r}")
        if not isinstance(self.lod_camera, Camera | None):
            raise SettingsError(f"lod_camera: expected an orogen.Camera or None, got {self.lod_camera!r}")


@dataclass(frozen=True)
class Picture:
    """A finished picture."""

    frame: Frame
    """What was drawn: camera, size, grid."""
    color: NDArray[np.uint8]
    """(height, width, 4) sRGB and alpha."""
    reverse_depth: NDArray[np.float32]
    """(height, width) reverse-z depth of the surface buffer at the pixel centres, 0 for the sky."""
    statistics: Statistics
    """What was drawn, in the last part of a picture of several."""
    gpu_times: Mapping[str, float] = field(default_factory=dict)
    """Milliseconds per pass of the last sample, of the last part; empty where the adapter has no timestamps."""
    record_time: float = 0.0
    """Seconds of CPU time to record and submit the last sample, of the last part."""

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        """(height, width) metres along the view axis; NaN for the sky."""
        return self.frame.view_depth(self.reverse_depth).astype(np.float32)

    @cached_property
    def position(self) -> NDArray[np.float64]:
        """(height, width, 3): x, y in the data's CRS and height in metres of the data; NaN for the sky."""
        return self.frame.positions(self.reverse_depth)


@dataclass(frozen=True)
class Timing:
    """How long a frame took."""

    gpu_times: Mapping[str, float]
    """Milliseconds per pass; empty where the adapter has no timestamps."""
    record_time: float
    """Seconds of CPU time to record and submit the one before it, without timestamps."""


class Renderer:
    """Draws one terrain. Not safe to use from several threads at once."""

    def __init__(
        self,
        gpu: Gpu,
        heights: Pyramid,
        colors: Pyramid | None = None,
        *,
        name: str = DEFAULT,
        settings: Mapping[str, Any] | None = None,
        clipmap: ClipmapSettings | None = None,
        rasterizer: str = "auto",
        faults: Faults | None = None,
    ) -> None:
        """`name` and `settings`: the algorithm and values of its settings. `rasterizer`: see `Rasterizer`.

        `faults`: where what goes wrong is noted.
        """
        kind = algorithm(name)
        chosen = make_settings(name, settings or {})
        self.gpu = gpu
        self.clipmap = Clipmap(gpu, heights, colors, clipmap, faults)
        try:
            self.view = self.clipmap.view()
            self.rasterizer = Rasterizer(self.clipmap, rasterizer)
            self.shading = Shading(
                gpu,
                self.clipmap.layout,
                self.rasterizer.read_layout,
                [RASTER, *SEARCH],
                self.clipmap.constants,
                image=colors is not None,
            )
            self.timer = gpu.timer()
            self.algorithm = kind(self.clipmap, chosen)
            self._state = self.algorithm.view()
        except BaseException:
            self.clipmap.close()
            raise
        self.draws: tuple[Draw, ...] = ()
        """What the latest frame was drawn with; their buffers are those of that frame until the next one."""
        self._targets: tuple[Surface, Samples] | None = None
        self._drawn = 0
        self._shown: tuple[Any, ...] = ()
        self._offsets = ordered_jitters(1)  # of the samples of the picture in a window
        self._patience = FIRST_WAIT
        self._changes = [0]  # how often what is resident has changed, whichever view saw to it: all share this list
        self._frame: Frame | None = None
        self._owns_clipmap = True

    def beside(self, name: str, settings: Mapping[str, Any] | None = None) -> Renderer:
        """Another view of the same terrain, such as the other half of a split window; close it before this one.

        It shares what is resident, and has its own algorithm, picture and times.
        """
        other = copy.copy(self)
        other._owns_clipmap = False
        other._targets, other._drawn, other._shown, other._frame = None, 0, (), None
        other.draws = ()
        other.algorithm = algorithm(name)(self.clipmap, make_settings(name, settings or {}))
        other._state = other.algorithm.view()
        # the rasteriser's queues and visibility are those of one picture
        other.rasterizer = self.rasterizer.another()
        other.timer = self.gpu.timer()
        other.view = self.clipmap.view()
        return other

    @property
    def shown(self) -> tuple[Frame, Surface] | None:
        """The frame of the latest sample and its surface buffer; None before the first."""
        return (self._frame, self._targets[0]) if self._frame and self._targets else None

    def statistics(self) -> Statistics:
        """What the latest frame took; waits for the GPU."""
        return self._state.statistics()

    @property
    def device(self) -> wgpu.GPUDevice:
        """The device that draws."""
        return self.gpu.device

    def use(self, name: str, settings: Mapping[str, Any] | None = None) -> None:
        """Change the algorithm; resident nodes stay."""
        following = algorithm(name)(self.clipmap, make_settings(name, settings or {}))
        if self.algorithm.pages:
            self.algorithm.pages.close()
        self.algorithm = following
        self.rasterizer.forget()
        self._state = self.algorithm.view()
        self.draws = ()
        self._shown = ()

    def refresh(self) -> None:
        """Forget what a frame that was broken off may have left half done; resident nodes stay."""
        self._state = self.algorithm.view()
        self.rasterizer.forget()
        self.timer = self.gpu.timer()
        self.draws = ()
        self._shown = ()

    @property
    def retry_in(self) -> float | None:
        """Seconds until something that failed to load is tried again; None where nothing has failed."""
        waits = [self.clipmap.retry_in, self.algorithm.pages.retry_in if self.algorithm.pages else None]
        return min((wait for wait in waits if wait is not None), default=None)

    def render(
        self,
        camera: Camera,
        size: tuple[int, int] = (1280, 720),
        style: Style | None = None,
        scene: Scene | None = None,
        *,
        samples: int = 1,
    ) -> Picture:
        """A picture of everything that is to be seen from `camera`, complete and the same each time.

        `size`: width and height in pixels; what is more than the GPU can hold is drawn in parts. `samples`: samples
        per pixel, from 1 to 256.
        """
        if samples not in range(1, 257):
            raise SettingsError(f"samples: expected 1 to 256 per pixel, got {samples}")
        check_picture_size(size)
        style, whole = style or Style(), self._prepare(camera, size, scene or Scene())
        held = PIXEL_BYTES * math.prod(self._targets[0].size) if self._targets else 0
        count = divisions(size, self.gpu, held)
        if count == 1:
            return self._render(Part(whole, whole, 0, 0), style, samples)
        color = np.empty((size[1], size[0], 4), np.uint8)
        depth = np.empty((size[1], size[0]), np.float32)
        for part in parts(whole, count):
            drawn = self._render(part, style, samples)
            for place, pixels in ((color, drawn.color), (depth, drawn.reverse_depth)):
                room = place[part.row :, part.column :][: len(pixels), : pixels.shape[1]]
                room[:] = pixels[: room.shape[0], : room.shape[1]]
        self._frame, self._shown = None, ()  # nothing of a part is to be picked
        return replace(drawn, frame=self.view.frame_for(whole), color=color, reverse_depth=depth)

    def _render(self, part: Part, style: Style, samples: int) -> Picture:
        """A picture, or a part of one, complete."""
        self.view.want(self.view.frame_for(part.seen))
        self._want_more(part.frame)
        self.clipmap.settle()
        if self.algorithm.pages:
            self.algorithm.pages.settle()
        frame = self.view.frame_for(part.frame)
        surface, light = self._targets_for(frame.size)
        depth, record_time = self._draw(frame, surface, light, style, samples)
        while self._incomplete():
            depth, record_time = self._draw(frame, surface, light, style, samples)
        color = self.gpu.read_texture(light.picture).result()
        return Picture(
            frame, color, depth.result(), self._state.statistics(), self.timer.results(wait=True), record_time
        )

    def keep_busy(self, record_time: float = 0.0) -> None:
        """Have a GPU work while the CPU prepares the frame that is drawn next, so that its clock is up for it.

        `record_time`: seconds that such a frame took to record. For times that are compared; a software driver has no
        clock of its own.
        """
        if self.gpu.info.kind != "cpu":
            self._load.submit(max(BUSY, 2000 * record_time))

    @cached_property
    def _load(self) -> Load:
        return Load(self.gpu)

    def time_frames(
        self,
        cameras: Sequence[Camera],
        size: tuple[int, int] = (1280, 720),
        style: Style | None = None,
        scene: Scene | None = None,
    ) -> list[Timing]:
        """How long the frames of a flight take with all that is wanted resident, of one sample a pixel, not read back.

        Each frame is drawn after the few before it without a wait, and a GPU is kept at work while the CPU records it,
        so that its clock is up.
        """
        frames = [self.render(camera, size, style, scene).frame for camera in cameras]
        surface, light = self._targets_for(size)
        self._changes[0] += 1
        result, record_time = [], 0.0
        for last in range(len(frames)):
            for number in range(last + 1 - TOGETHER, last + 1):
                light.reset()
                # as in a window, where most frames are not timed
                self.timer.enabled = number == last
                if number == last:
                    self.keep_busy(record_time)
                # a copy: what a frame works out for itself counts
                frame = replace(frames[max(number, 0)])
                start = time.thread_time()
                self._submit_sample(frame, surface, light, style or Style(), last=True)
                if number < last:
                    record_time = time.thread_time() - start
            result.append(Timing(self.timer.results(wait=True), record_time))
        return result

    def draw_to(
        self,
        view: wgpu.GPUTextureView,
        camera: Camera,
        size: tuple[int, int],
        style: Style | None = None,
        scene: Scene | None = None,
        *,
        samples: int = 1,
    ) -> bool:
        """Draw into a texture without waiting for data: from what is resident, better the next time.

        `samples`: how many a pixel are added at once, at most; a picture at rest gathers up to 16 by and by.

        True while a further call would improve the picture: data streams in, geometry is refined, or samples smooth it.
        """
        style = style or Style()
        frame = self._prepare(camera, size, scene or Scene())
        self.view.want(frame, patient=True)
        self._want_more(frame)
        uploaded = 0
        if self.clipmap.pump() + self._ground_comes():
            self._changes[0] += 1
        if self.algorithm.pages:
            uploaded = self.algorithm.pages.pump(self.clipmap.settings.upload_budget)
        # what was read meanwhile may lie higher or lower; the ground under the camera is where it was
        if self.clipmap.height_range != frame.height_range:
            frame = replace(frame, height_range=self.clipmap.height_range)
        surface, light = self._targets_for(size)
        shown = (camera, size, style, scene, frame.height_range, self._changes[0])
        if uploaded or shown != self._shown or self._state.unfinished():
            light.reset()
            self._shown, self._offsets = shown, ordered_jitters(samples)
        self._drawn += 1
        for number in range(min(samples, STILL_SAMPLES - light.count)):
            self.timer.enabled = number == 0 and self._drawn % TIMED == 1
            self._submit_sample(_moved(frame, self._offsets[light.count]), surface, light, style)
        encoder = self.gpu.encoder("resolve")
        self.shading.resolve(encoder, self.timer, light, view, style)
        self.gpu.submit(encoder)
        pending = self.view.behind or self.clipmap.pending or (self.algorithm.pages and self.algorithm.pages.pending)
        return bool(pending) or light.count < STILL_SAMPLES or self._state.unfinished()

    def _ground_comes(self) -> bool:
        """Wait a moment, once, for the coarsest ground; whether it comes. A picture of the sky tells nothing."""
        heights, end = self.clipmap.heights, time.monotonic() + self._patience
        self._patience = 0.0
        came = False
        while heights.pending and not heights.present and (left := end - time.monotonic()) > 0:
            heights.wait(left)
            came = self.clipmap.pump() > 0 or came
        return came

    def pick(self, column: int, row: int) -> tuple[float, float, float] | None:
        """x, y in the data's CRS and height (m) of what the last picture shows at a pixel; None for the sky."""
        if self._targets is None or self._frame is None:
            return None
        width, height = self._frame.size
        if not (0 <= column < width and 0 <= row < height):
            return None
        depth = self._targets[0].targets["depth"]
        value = float(self.gpu.read_texture(depth, origin=(column, row), size=(1, 1)).result()[0, 0])
        if value == 0.0:
            return None
        x, y, z = self._frame.position(column, row, value)
        return x, y, z

    def release(self) -> None:
        """Give back what holds the picture; the next one makes it anew. Until then nothing is picked."""
        self.draws, self._shown, self._frame = (), (), None
        if self._targets:
            for target in self._targets:
                target.destroy()
            self._targets = None

    def close(self) -> None:
        """Give the GPU memory back and stop loading."""
        self.release()
        if self.algorithm.pages:
            self.algorithm.pages.close()
        if self._owns_clipmap:
            self.clipmap.close()
        else:
            self.clipmap.drop(self.view)

    def _prepare(self, camera: Camera, size: tuple[int, int], scene: Scene) -> Frame:
        return self.view.frame_for(
            Frame(
                camera, self.clipmap.grid, size, scene.lod_camera,
                exaggeration=scene.exaggeration, curvature=scene.curvature, coarseness=scene.coarseness,
            )
        )  # fmt: skip

    def _draw(
        self, frame: Frame, surface: Surface, light: Samples, style: Style, samples: int
    ) -> tuple[Readback, float]:
        """Draw all samples; gives the depth at the pixel centres and the seconds that the last one took to record."""
        light.reset()
        self._changes[0] += 1  # of what is resident, and the last sample is not kept: windows begin anew
        self.timer.enabled = True
        depth: Readback | None = None
        record_time = 0.0
        for number, jitter in enumerate(jitters(samples), start=1):
            start = time.thread_time()
            self._submit_sample(_moved(frame, jitter), surface, light, style, last=number == samples)
            record_time = time.thread_time() - start
            depth = depth or surface.read("depth")
        assert depth is not None
        return depth, record_time

    def _incomplete(self) -> bool:
        # both are asked: asking makes room
        return sum([self._state.incomplete(), self.rasterizer.incomplete()]) > 0

    def _want_more(self, frame: Frame) -> None:
        if more := self._state.wants(frame):
            known = set(self.view.wishes[0])
            self.view.wishes[0] = [*self.view.wishes[0], *(key for key in more if key not in known)]

    def _submit_sample(
        self, frame: Frame, surface: Surface, light: Samples, style: Style, *, last: bool = False
    ) -> None:
        self._frame = frame
        self.view.update(frame, sun_of(style))
        encoder = self.gpu.encoder("frame")
        draws = self._state.record(encoder, self.timer, frame, self.view)
        edges = "wireframe" in style.overlays
        self.rasterizer.record(encoder, self.timer, draws, self.view, surface, edges=edges)
        added = self._state.drawn(encoder, self.timer, frame, self.view, surface.targets["depth"])
        self.rasterizer.record(encoder, self.timer, added, self.view, surface, clear=False, edges=edges)
        self.draws = (*draws, *added)
        scene = self.view.bind_group
        self.shading.record(encoder, self.timer, frame, scene, surface.read_group, light, style, last=last)
        self.timer.resolve(encoder)
        self.gpu.submit(encoder)

    def _targets_for(self, size: tuple[int, int]) -> tuple[Surface, Samples]:
        if self._targets is None or self._targets[0].size != size:
            if self._targets:
                for target in self._targets:
                    target.destroy()
                self._targets = None
            self._targets = self.rasterizer.surface(size), self.shading.samples(size)
            self._shown = ()
        return self._targets


def jitters(samples: int) -> list[tuple[float, float]]:
    """Offsets of the samples in a pixel, the first in its centre: a low-discrepancy lattice (Roberts 2018, R2)."""
    golden = 1.324717957244746
    return [((0.5 + i / golden) % 1 - 0.5, (0.5 + i / golden**2) % 1 - 0.5) for i in range(samples)]


def ordered_jitters(together: int) -> list[tuple[float, float]]:
    """Offsets of the samples of a window, of which the first `together` make a picture already."""
    offsets = jitters(max(STILL_SAMPLES, 16))
    first = BALANCED.get(together, ())
    return [offsets[i] for i in first] + [offset for i, offset in enumerate(offsets) if i not in first]


def _moved(frame: Frame, jitter: tuple[float, float]) -> Frame:
    if jitter == (0.0, 0.0):
        return frame
    return replace(frame, jitter=(frame.jitter[0] + jitter[0], frame.jitter[1] + jitter[1]))
