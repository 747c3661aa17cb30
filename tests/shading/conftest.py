"""A stage for shading: an inclined plane under a camera, in front of the stand-ins of the other rooms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import Grid
from orogen.shading import Samples, Shading, Style

DOUBLES = Path(__file__).parent / "doubles"
GRID = Grid(4096, 2048, (25.0, 0.0, 400_000.0, 0.0, -30.0, 5_000_000.0), crs="EPSG:32633")


def camera(x: float = 1000.0, y: float = -700.0, **settings: Any) -> Camera:
    """A camera `x` and `y` metres off the middle of the data, 3000 m high, that looks down to the north-east."""
    middle = (400_000 + 25 * 2048 + x, 5_000_000 - 30 * 1024 + y)
    return Camera(*middle, **{"z": 3000.0, "heading": 40.0, "pitch": -35.0, **settings})


@dataclass
class Stage:
    """A plane z = base + gradient . (east, north) of the drawn world, relative to the camera's foot at height 0."""

    camera: Camera = field(default_factory=camera)
    size: tuple[int, int] = (48, 32)
    gradient: tuple[float, float] = (0.0, 0.0)
    base: float = 0.0
    gradient_per_level: tuple[float, float] = (0.0, 0.0)
    lod: float = 0.0
    resident: int = 0
    error: float = 0.0
    image_alpha: float = 0.0
    shadow_east: float = 1e30
    exaggeration: float = 1.0
    jitter: tuple[float, float] = (0.0, 0.0)
    height_range: tuple[float, float] = (-2000.0, 4000.0)
    detail: NDArray[np.uint32] | None = None

    @property
    def frame(self) -> Frame:
        return Frame(
            self.camera, GRID, self.size, height_range=self.height_range, exaggeration=self.exaggeration,
            jitter=self.jitter,
        )  # fmt: skip

    def view_depth(self) -> NDArray[np.float64]:
        """Metres along the view axis of the plane, (height, width); NaN where a ray misses it."""
        origin, direction = self.frame.rays()
        normal = np.array([-self.gradient[0], -self.gradient[1], 1.0])
        with np.errstate(divide="ignore"):
            t = (self.base - self.camera.z - origin @ normal) / (direction @ normal)
        return np.where((t > 0) & np.isfinite(t), t, np.nan)

    def positions(self) -> NDArray[np.float64]:
        """Camera-relative metres of the plane, (height, width, 3)."""
        origin, direction = self.frame.rays()
        return origin + self.view_depth()[..., None] * direction

    def heights(self) -> NDArray[np.float64]:
        """Metres of the data, (height, width)."""
        return (self.positions()[..., 2] + self.camera.z) / self.exaggeration

    def depth(self) -> NDArray[np.float32]:
        """The surface buffer's depth."""
        t = self.view_depth()
        if self.camera.orthographic:
            near, far = self.frame.depth_range
            depth = (far - t) / (far - near)
        else:
            depth = self.camera.near / t
        return np.nan_to_num(depth, nan=0.0).astype(np.float32)

    def frame_block(self) -> NDArray[np.float32]:
        frame = self.frame
        right, up, forward = self.camera.basis
        half_x, half_y = frame.half_extent
        block = np.zeros(32, np.float32)
        block[0:3], block[4:7], block[8:11] = right * half_x, up * half_y, forward
        block[11] = 1.0 if self.camera.orthographic else 0.0
        block[12:16] = np.linalg.inv(frame.metres).ravel()
        block[16:18].view(np.uint32)[:] = self.size
        block[18:20] = self.jitter
        block[20:22].view(np.int32)[:] = frame.anchor
        block[22:24] = frame.eye_offset
        block[24:27] = self.camera.near, *(frame.depth_range if self.camera.orthographic else (0, 0))
        block[27:30] = self.camera.z / self.exaggeration, self.exaggeration, GRID.spacing
        block[30:31].view(np.uint32)[:] = frame.subtexel_bits
        return block

    def scene_block(self) -> NDArray[np.float32]:
        block = np.zeros(12, np.float32)
        block[:5] = *self.gradient, *self.gradient_per_level, self.lod
        block[5:6].view(np.uint32)[:] = self.resident
        block[6:9] = self.error, self.image_alpha, self.shadow_east
        return block


class Studio:
    """Shades stages on a device."""

    def __init__(self, gpu: Gpu) -> None:
        self.gpu = gpu
        self._scene = gpu.layout("scene", dict.fromkeys((0, 1), ("COMPUTE", "uniform")))
        self._surface = gpu.layout("surface", dict.fromkeys((0, 1), ("COMPUTE", "read")))
        self.shading = Shading(gpu, self._scene, self._surface, [DOUBLES], {})
        self.timer = gpu.timer()

    def add(self, samples: Samples, stage: Stage, style: Style, *, last: bool = False) -> None:
        """One more sample."""
        width, height = stage.size
        detail = stage.detail if stage.detail is not None else np.full((height, width), 0xFF00, np.uint32)
        blocks = [self.gpu.buffer("block", b, "UNIFORM", "test") for b in (stage.frame_block(), stage.scene_block())]
        pixels = [self.gpu.buffer("pixels", p, "STORAGE", "test") for p in (stage.depth(), detail.astype(np.uint32))]
        scene = self.gpu.bind("scene", self._scene, dict(enumerate(blocks)))
        surface = self.gpu.bind("surface", self._surface, dict(enumerate(pixels)))
        encoder = self.gpu.encoder("stage")
        self.shading.record(encoder, self.timer, stage.frame, scene, surface, samples, style, last=last)
        self.gpu.submit(encoder)

    def light(self, stage: Stage, style: Style) -> NDArray[np.float32]:
        """Light and cover of one sample, (height, width, 4)."""
        samples = self.shading.samples(stage.size)
        self.add(samples, stage, style)
        return self.sums(samples)

    def sums(self, samples: Samples) -> NDArray[np.float32]:
        """What the samples add up to, (height, width, 4)."""
        width, height = samples.size
        return self.gpu.read_buffer(samples.light, dtype=np.float32).result().reshape(height, width, 4)

    def resolve(self, samples: Samples, style: Style, form: str = "rgba8unorm") -> NDArray[np.uint8]:
        """The picture, (height, width, 4)."""
        texture = self.gpu.texture("picture", samples.size, form, "RENDER_ATTACHMENT|COPY_SRC", "test")
        encoder = self.gpu.encoder("resolve")
        self.shading.resolve(encoder, self.timer, samples, texture.view(), style)
        self.gpu.submit(encoder)
        return self.gpu.read_texture(texture).result()


@pytest.fixture(scope="session")
def studio(gpu: Gpu) -> Studio:
    return Studio(gpu)


@pytest.fixture
def stage() -> type[Stage]:
    """The class, to make stages of."""
    return Stage


@pytest.fixture
def camera_at() -> Callable[..., Camera]:
    return camera
