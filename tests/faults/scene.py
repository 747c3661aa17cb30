"""A small terrain with voids and an image, a walk through it, and seams at which its parts can be made to fail."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import binary_dilation

from orogen.camera import Camera
from orogen.errors import BudgetError, GpuError, SourceError, StoreError
from orogen.gpu.device import Gpu
from orogen.grid import Grid
from orogen.pyramid.open import open_pyramid
from orogen.pyramid.store import Store
from orogen.streaming import layer
from orogen.terrain import Terrain
from orogen.view.renderer import Picture

SIDE = 1000
GRID = Grid(SIDE, SIDE, (10.0, 0.0, 5e5, 0.0, -10.0, 4e6))
SIZE = (96, 64)
SETTINGS = {"view_distance": 0.7, "memory": 16 << 20, "host_memory": 4 << 20}
KINDS = ("read", "decode", "allocation", "upload")


def heights() -> NDArray[np.float32]:
    """(SIDE, SIDE) metres; NaN in a lake, a strip and single samples."""
    y, x = np.indices((SIDE, SIDE))
    rng = np.random.default_rng(6)
    z = 500 + 250 * np.sin(x / 61) * np.cos(y / 47) + 40 * np.sin(x / 9 + y / 13) + rng.normal(0, 1, (SIDE, SIDE))
    z[(x - 330) ** 2 + (y - 610) ** 2 < 60**2] = np.nan
    z[200:206, 500:800] = np.nan
    z[rng.integers(0, SIDE, 40), rng.integers(0, SIDE, 40)] = np.nan
    return z.astype(np.float32)


def image() -> NDArray[np.uint8]:
    """(SIDE, SIDE, 4) sRGB: smooth, so that coarser levels look like it."""
    y, x = np.indices((SIDE, SIDE))
    picture = np.full((SIDE, SIDE, 4), 255, np.uint8)
    for band, (a, b) in enumerate(((150, 210), (240, 170), (190, 310))):
        picture[..., band] = 128 + 90 * np.sin(x / a) * np.cos(y / b)
    return picture


@dataclass
class ArraySource:
    """A source of an array that names a file; every read of a window can fail."""

    data: NDArray[Any]
    name: str
    grid: Grid = GRID
    nodata: float | None = None
    units: str = "metre"
    vertical_crs: str | None = None
    block: tuple[int, int] = (256, 256)
    direct: bool = True
    fingerprint: str | None = None
    gate: threading.Event = field(default_factory=threading.Event)
    """Reading goes on while it is set."""

    def __post_init__(self) -> None:
        self.gate.set()

    @property
    def kind(self) -> str:
        return "height" if self.data.ndim == 2 else "colour"

    @property
    def dtype(self) -> str:
        return str(self.data.dtype)

    @property
    def covered(self) -> bool:
        return False

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        self.gate.wait(20)
        return self.data[rows, cols].copy()

    def overview(self, shape: tuple[int, int]) -> NDArray[Any]:
        index = [np.arange(n) * size // n for n, size in zip(shape, self.data.shape, strict=False)]
        return self.data[np.ix_(*index)]

    def close(self) -> None:
        pass


def walk() -> list[Camera]:
    """Six views: from afar, down into the terrain, over the voids, and away again."""
    places = [
        (500, 500, 9000.0, 0.0, -90.0), (300, 400, 1500.0, 30.0, -50.0), (330, 560, 1300.0, 10.0, -60.0),
        (650, 260, 1200.0, -80.0, -60.0), (800, 800, 2500.0, 120.0, -70.0), (500, 520, 6000.0, 0.0, -80.0),
    ]  # fmt: skip
    cameras = []
    for tx, ty, z, heading, pitch in places:
        x, y = (float(v) for v in GRID.to_crs(tx, ty))
        cameras.append(Camera(x, y, z, heading=heading, pitch=pitch))
    return cameras


@dataclass
class Seams:
    """Counts calls by kind and lets chosen ones fail."""

    patch: pytest.MonkeyPatch
    counts: Counter[str] = field(default_factory=Counter)
    chosen: Callable[[str, int], bool] = lambda kind, number: False
    """Whether the call of a kind with this number, from 1, fails."""
    only: str = ""
    """Function that fails where only one of its kind does, but for what every frame needs."""
    failed: list[str] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        def budget(gpu: Gpu, label: str, *_: Any, **__: Any) -> Exception:
            kind = BudgetError if self.counts["allocation"] % 2 else GpuError
            return kind(f"GPU memory for {label!r}: expected room, got none")

        self._wrap("read", ArraySource, "read", lambda source, *_: SourceError(f"{source.name}: cannot be read"))
        self._wrap("read", Store, "read", lambda store, *_: StoreError(f"{store.path}: cannot be read"))
        self._wrap("decode", layer, "height_node", lambda *_: ValueError("expected a frame of zstd, got noise"))
        self._wrap("decode", layer, "color_node", lambda *_: MemoryError())
        self._wrap("allocation", Gpu, "buffer", budget)
        self._wrap("allocation", Gpu, "texture", budget)
        self._wrap("upload", Gpu, "write", lambda gpu, buffer, *_: GpuError(f"buffer {buffer.label!r}: out of memory"))
        self._wrap("upload", Gpu, "write_texture", lambda gpu, t, *_, **__: GpuError(f"texture {t.label!r}: no memory"))

    def _wrap(self, kind: str, owner: Any, name: str, error: Callable[..., Exception]) -> None:
        original = getattr(owner, name)

        def call(*arguments: Any, **options: Any) -> Any:
            with self.lock:
                self.counts[kind] += 1
                spared = self.only and getattr(arguments[1], "label", "") == "sampled quadtree"
                fails = not spared and self.only in ("", name) and self.chosen(kind, self.counts[kind])
                if fails:
                    self.failed.append(f"{kind} {name}")
            if fails:
                raise error(*arguments, **options)
            return original(*arguments, **options)

        self.patch.setattr(owner, name, call)


@dataclass(frozen=True)
class Truth:
    """What pictures are compared with: computed from the samples alone."""

    data: NDArray[np.float32]

    def gap(self, picture: Picture) -> float:
        """Greatest distance (m) of drawn points to the surface below them; points near voids are left out."""
        x, y, z = np.moveaxis(picture.position, -1, 0)
        drawn = np.isfinite(z)
        tx, ty = (np.asarray(v) for v in GRID.to_texel(x[drawn], y[drawn]))
        true = self._surface(np.clip(np.stack([ty, tx], -1), 0.5, SIDE - 0.5))
        far = ~self._near_void(tx, ty)
        return float(np.abs(z[drawn][far] - true[far]).max())

    @cached_property
    def _surface(self) -> RegularGridInterpolator:
        centres = np.arange(SIDE) + 0.5
        return RegularGridInterpolator((centres, centres), self.data.astype(np.float64))

    @cached_property
    def _rims(self) -> NDArray[np.bool_]:
        return binary_dilation(np.pad(np.isnan(self.data), 1, constant_values=True), np.ones((3, 3)), 8)[1:-1, 1:-1]

    def _near_void(self, tx: NDArray, ty: NDArray) -> NDArray[np.bool_]:
        """Whether a void or the edge is within 8 texels: coarse levels spread its rim, and may bare what is behind."""
        return self._rims[np.clip(ty.astype(int), 0, SIDE - 1), np.clip(tx.astype(int), 0, SIDE - 1)]

    def holes(self, picture: Picture, clean: Picture) -> int:
        """Pixels without terrain where the clean picture shows terrain far from voids."""
        lost = np.isnan(picture.position[..., 2]) & np.isfinite(clean.position[..., 2])
        tx, ty = (np.asarray(v) for v in GRID.to_texel(clean.position[lost][:, 0], clean.position[lost][:, 1]))
        return int((~self._near_void(tx, ty)).sum())


@dataclass(frozen=True)
class Place:
    """The data, and the folder that keeps their pyramids from one terrain to the next."""

    cache: Path
    heights: NDArray[np.float32] = field(default_factory=heights)
    image: NDArray[np.uint8] = field(default_factory=image)

    def sources(self) -> tuple[ArraySource, ArraySource]:
        """New sources of the heights and of the image."""
        return (
            ArraySource(self.heights, "/data/heights.tif", fingerprint="heights"),
            ArraySource(self.image, "/data/image.tif", fingerprint="image"),
        )

    def terrain(
        self, sources: tuple[ArraySource, ArraySource] | None = None, algorithm: str | None = None, **settings: Any
    ) -> Terrain:
        """A terrain to be closed."""
        pyramids = [open_pyramid(source, cache=self.cache) for source in sources or self.sources()]
        return Terrain(*pyramids, algorithm=algorithm, settings={**SETTINGS, **settings})

    @cached_property
    def truth(self) -> Truth:
        """What its pictures are compared with."""
        return Truth(self.heights)

    @cached_property
    def error(self) -> float:
        """Greatest distance (m) of the coarsest level from the true surface."""
        with open_pyramid(self.sources()[0], cache=self.cache) as pyramid:
            bounds = pyramid.node_bounds(pyramid.level_count - 1)
            assert bounds is not None
            return float(np.nanmax(bounds[..., 2]))
