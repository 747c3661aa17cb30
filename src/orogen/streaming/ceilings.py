"""Sun ceilings: what spares most rays towards the sun their way over a node (ceilings.wgsl)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.grid import EARTH_RADIUS, Grid
from orogen.streaming import blocks
from orogen.streaming.atlas import CEILING_BLOCK, FOLDER
from orogen.streaming.layer import Layer
from orogen.streaming.settings import HEIGHT_BORDER

_AT_ONCE = 16
"""Nodes of 256 texels a side whose ceilings are made for one frame at most."""
_PATIENCE = 4
"""Frames for which a sun has to stand still until ceilings are made for it."""
_UNIFORM_STEP = 256
_SUN = np.dtype(
    [("way", "f4", 2), ("slope", "f4", 2), ("rise", "f4"), ("step", "i4"), ("last", "u4"), ("padding", "u4")]
)
"""`Sun` of ceilings.wgsl."""
_STEEPEST = 1e4
"""Rise over run of rays that hardly leave the cell they start in: ceilings would save nothing."""


class Sun(NamedTuple):
    """Rays towards the sun in the coordinates of the data."""

    way: tuple[float, float]
    """Texels of level 0 (columns, rows) per metre of the ray."""
    rise: float
    """Metres of the data that a ray rises over the surface per metre of its length, at least."""

    @property
    def slope(self) -> tuple[float, float]:
        """Metres that rays rise per texel of level 0, along columns and rows."""
        x, y = self.way
        share = self.rise / (x * x + y * y)
        return share * x, share * y


@lru_cache(maxsize=16)
def _sun(direction: tuple[float, float, float], grid: Grid, exaggeration: float, curvature: bool) -> Sun | None:
    """None where ceilings would save nothing."""
    east, north, up = direction
    flat = math.hypot(east, north)
    if flat * _STEEPEST < up:
        return None
    # with curvature rays that come up to the camera rise less
    across = float(np.hypot(*(grid.metres @ np.array([grid.width, grid.height]))))
    bend = flat * across / EARTH_RADIUS if curvature else 0.0
    x, y = (grid.texels @ np.array([east, north])).tolist()
    # a little less, as the GPU rounds
    return Sun((x, y), (up - bend) / exaggeration - 1e-6)


class Ceilings:
    """Keeps the ceilings of the nodes in use, for one sun at a time that stands still."""

    def __init__(self, gpu: Gpu, layer: Layer, node_bits: int) -> None:
        """`layer`: of the heights; their atlas has the ceilings."""
        self._gpu, self._layer, self._bits = gpu, layer, node_bits
        self._builder: CeilingBuilder | None = None
        self._sun: Sun | None = None
        self._asked: Sun | None = None
        self._turns = 0
        self._made: set[int] = set()
        self._ready_for = -1

    def block(self, direction: tuple[float, float, float], frame: Frame) -> bytes:
        """What the clipmap's uniform block says of a sun; where ceilings are missing, makes some of them.

        They are used once all nodes in use have theirs. `direction`: unit vector (east, north, up) towards the sun.
        """
        sun = _sun(direction, frame.grid, frame.exaggeration, frame.curvature)
        if sun is None or not self._ready(sun):
            return blocks.NO_SUN_BLOCK
        x, y = (along / (1 << frame.subtexel_bits) for along in sun.slope)
        return blocks.sun_block((x, y), sun.rise)

    def _ready(self, sun: Sun) -> bool:
        self._turns = self._turns + 1 if sun == self._asked else 1
        self._asked = sun
        if sun != self._sun and self._turns < _PATIENCE:
            return False
        layer = self._layer
        self._builder = self._builder or CeilingBuilder(self._gpu, layer, self._bits)
        if sun != self._sun:
            self._builder.shine(sun)  # first: where it fails, the sun is not the chosen one
            self._sun, self._ready_for = sun, -1
            self._made.clear()
        if self._ready_for != layer.version:
            self._made -= layer.refilled
            layer.refilled.clear()
            missing = [slot | key.level << 16 for key, slot in layer.current.items() if slot not in self._made]
            now = missing[: self._builder.at_once]
            self._builder.build(now)
            self._made.update(slot & 0xFFFF for slot in now)
            if len(now) == len(missing):
                self._ready_for = layer.version
        return self._ready_for == layer.version

    def destroy(self) -> None:
        """Give the memory back, but for the atlas."""
        if self._builder:
            self._builder.destroy()


class CeilingBuilder:
    """Makes the ceilings of some nodes on the GPU."""

    def __init__(self, gpu: Gpu, layer: Layer, node_bits: int) -> None:
        self._gpu = gpu
        self.at_once = max(1, _AT_ONCE >> 2 * (node_bits - 8))
        """Nodes that `build` takes at most."""
        side = (1 << node_bits) // CEILING_BLOCK + 1
        self._groups = -(-side // 8)
        # each step joins what lies within twice the distance of the one before
        self._steps = [0, *(1 << k for k in range(math.ceil(math.log2(side))))]
        self._slots = gpu.buffer("sunlit slots", 4 * self.at_once, "STORAGE|COPY_DST", "clipmap")
        room = _UNIFORM_STEP * (1 + len(self._steps))
        self._numbers = gpu.buffer("sun ceilings", room, "UNIFORM|COPY_DST", "clipmap")
        usage = "TEXTURE_BINDING|STORAGE_BINDING"
        self._between = [
            gpu.texture(f"ceilings {k}", (side, side), "r32float", usage, "clipmap", layers=self.at_once)
            for k in range(2)
        ]
        layout = gpu.layout(
            "ceilings",
            {
                0: ("COMPUTE", "read"),
                1: ("COMPUTE", layer.format.binding),
                2: ("COMPUTE", "texture unfilterable 2d-array"),
                3: ("COMPUTE", "image r32float write 2d-array"),
                4: ("COMPUTE", "uniform dynamic"),
            },
        )
        array = {"dimension": "2d-array"}
        heights, ceilings = (layer.atlas.textures[name].view(**array) for name in ("height", "ceilings"))
        turns = [texture.view(**array) for texture in self._between]
        targets = [turns[k % 2] for k in range(len(self._steps))] + [ceilings]
        self._bound = [
            gpu.bind(
                "ceilings",
                layout,
                {0: self._slots, 1: heights, 2: turns[1 - k % 2], 3: target, 4: (self._numbers, 0, _SUN.itemsize)},
            )
            for k, target in enumerate(targets)
        ]
        constants = {
            "NODE_BITS": node_bits, "HEIGHT_BORDER": HEIGHT_BORDER, "CEILING_BLOCK": CEILING_BLOCK,
            **layer.format.constants,
        }  # fmt: skip
        shader = gpu.shader("ceilings", FOLDER / "ceilings.wgsl", constants=constants)
        self._pipelines = [gpu.compute("ceilings", shader, entry, [layout]) for entry in ("obstacles", "spread")]

    def shine(self, sun: Sun) -> None:
        """Choose the sun."""
        numbers = np.zeros((1 + len(self._steps), _UNIFORM_STEP // _SUN.itemsize), _SUN)
        passes = numbers[:, 0]
        passes["way"], passes["slope"], passes["rise"] = sun.way, sun.slope, sun.rise
        passes["step"][1:] = self._steps
        passes["last"][-1] = 1
        self._gpu.write(self._numbers, numbers)

    def build(self, slots: list[int]) -> None:
        """Make the ceilings of some nodes: slot | level << 16 each."""
        if not slots:
            return
        self._gpu.write(self._slots, np.asarray(slots, np.uint32))
        encoder = self._gpu.encoder("ceilings")
        run = encoder.begin_compute_pass(label="ceilings")
        for k, group in enumerate(self._bound):
            run.set_pipeline(self._pipelines[min(k, 1)])
            run.set_bind_group(0, group, [_UNIFORM_STEP * k])
            run.dispatch_workgroups(self._groups, self._groups, len(slots))
        run.end()
        self._gpu.submit(encoder)

    def destroy(self) -> None:
        """Give the memory back."""
        for resource in (self._slots, self._numbers):
            resource.destroy()
        for texture in self._between:
            texture.destroy()
