"""The node atlas: texture arrays that hold the resident nodes, shared by all views (Kuehnert 2022, section 4.5.1)."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orogen.errors import BudgetError
from orogen.gpu import Gpu, Texture
from orogen.gpu.formats import texture_bytes
from orogen.keys import NodeKey
from orogen.streaming.bc7 import FORMAT as BC7
from orogen.streaming.bc7 import BlockEncoder
from orogen.streaming.heightformat import FLOATS, HeightFormat
from orogen.streaming.settings import COLOR_BORDER, COLOR_MIPS, HEIGHT_BORDER
from orogen.streaming.tiles import ColorNode, HeightNode

FOLDER = Path(__file__).parent

CEILING_BLOCK = 4
"""Cells along the side of a block that shares a sun ceiling (ceilings.wgsl)."""
_UNIFORM_STEP = 256


@dataclass(frozen=True)
class Attachment:
    """A kind of data in a node."""

    name: str
    """Such as "height"."""
    format: str
    """WebGPU texture format."""
    size: tuple[int, int]
    """Columns and rows per node, border included."""
    mips: int = 1
    """Mip levels."""
    computed: bool = False
    """Filled on the GPU rather than uploaded."""

    @property
    def nbytes(self) -> int:
        """Bytes per node."""
        return texture_bytes(self.format, self.size, mips=self.mips)

    @property
    def upload_bytes(self) -> int:
        """Bytes per node that come from the host: blocks are made of plain colours on the GPU."""
        plain = "rgba8unorm-srgb" if self.format == BC7 else self.format
        return 0 if self.computed else texture_bytes(plain, self.size, mips=self.mips)


def height_attachments(node_size: int, covered: bool, form: HeightFormat = FLOATS) -> tuple[Attachment, ...]:
    """Attachments of the height layer."""
    side = node_size + 2 * HEIGHT_BORDER
    bits = node_size.bit_length() - 1
    coverage = () if covered else (Attachment("coverage", "r8unorm", (side, side)),)
    # the layout of maxima_layout.wgsl
    maxima = (node_size // 2 + 1 + node_size // 4 + 1, node_size // 2 + bits - 2)
    return (
        Attachment("height", form.texture, (side, side)),
        *coverage,
        Attachment("maxima", "r32float", maxima, computed=True),
        Attachment("ceilings", "r32float", (node_size // CEILING_BLOCK + 1,) * 2, computed=True),
    )


def color_attachments(node_size: int, compressed: bool = False) -> tuple[Attachment, ...]:
    """Attachments of the colour layer; `compressed`: as BC7 blocks."""
    side = node_size + 2 * COLOR_BORDER
    return (Attachment("color", BC7 if compressed else "rgba8unorm-srgb", (side, side), COLOR_MIPS),)


class NodeAtlas:
    """A fixed number of slots, each with all attachments of a node; the least recently wanted node makes room."""

    def __init__(
        self, gpu: Gpu, label: str, attachments: tuple[Attachment, ...], node_count: int, memory: int, keep: int
    ) -> None:
        """`node_count`: nodes of the whole pyramid; `memory`: bytes at most; `keep`: slots that must fit at least."""
        self._gpu = gpu
        self.attachments = attachments
        self.node_bytes = sum(a.nbytes for a in attachments)
        """GPU memory of a node."""
        layers = gpu.limits["max-texture-array-layers"]
        self.capacity = min(node_count, memory // self.node_bytes, layers)
        if self.capacity < min(keep, node_count):
            raise BudgetError(
                f"{label} atlas: expected room for at least {min(keep, node_count)} nodes of {self.node_bytes} bytes, "
                f"got {memory} bytes; raise memory= or choose a smaller node_size="
            )
        self.textures: Mapping[str, Texture] = {
            a.name: gpu.texture(
                f"{label} {a.name}", a.size, a.format,
                "TEXTURE_BINDING|STORAGE_BINDING" if a.computed else "TEXTURE_BINDING|COPY_DST",
                f"atlas {a.name}", mips=a.mips, layers=self.capacity,
            )
            for a in attachments
        }  # fmt: skip
        self._encoder = next((BlockEncoder(gpu, a.size, a.mips) for a in attachments if a.format == BC7), None)
        self._slots: OrderedDict[NodeKey, int] = OrderedDict()
        self._free = list(range(self.capacity))[::-1]
        self.upload_bytes = sum(a.upload_bytes for a in attachments)
        """Bytes of a node that come from the host."""

    @property
    def resident(self) -> Mapping[NodeKey, int]:
        """Slot of every node that is loaded."""
        return self._slots

    def touch(self, keys: Collection[NodeKey]) -> None:
        """Mark nodes as wanted now."""
        for key in keys:
            if key in self._slots:
                self._slots.move_to_end(key)

    def place(self, key: NodeKey, wanted: Collection[NodeKey]) -> int | None:
        """A slot for a node: its own, a free one, or that of the least recently wanted node that is not wanted now.

        None if every slot is wanted.
        """
        if key in self._slots:
            return self._slots[key]
        if not self._free:
            victim = next((k for k in self._slots if k not in wanted), None)
            if victim is None:
                return None
            self._free.append(self._slots.pop(victim))
        slot = self._free.pop()
        self._slots[key] = slot
        return slot

    def remove(self, key: NodeKey) -> None:
        """Forget a node: what is in its slot cannot be relied on."""
        self._free.append(self._slots.pop(key))

    def upload(self, slot: int, node: HeightNode | ColorNode) -> None:
        """Copy a node's texels into a slot."""
        if isinstance(node, ColorNode):
            if self._encoder:
                self._encoder.encode(node.mips, self.textures["color"], slot)
                return
            for mip, texels in enumerate(node.mips):
                self._gpu.write_texture(self.textures["color"], texels, layer=slot, mip=mip)
            return
        self._gpu.write_texture(self.textures["height"], node.heights, layer=slot)
        if node.coverage is not None:
            self._gpu.write_texture(self.textures["coverage"], node.coverage, layer=slot)

    def destroy(self) -> None:
        """Give the memory back."""
        for texture in self.textures.values():
            texture.destroy()
        if self._encoder:
            self._encoder.destroy()


class MaximaBuilder:
    """Makes the maximum pyramids of freshly uploaded height nodes on the GPU."""

    def __init__(self, gpu: Gpu, atlas: NodeAtlas, node_bits: int, form: HeightFormat = FLOATS) -> None:
        self._gpu = gpu
        self._bits = node_bits
        self._slots = gpu.buffer("new slots", 4 * atlas.capacity, "STORAGE|COPY_DST", "clipmap")
        layout = gpu.layout(
            "maxima",
            {
                0: ("COMPUTE", "read"),
                1: ("COMPUTE", form.binding),
                2: ("COMPUTE", "image r32float readwrite 2d-array"),
                3: ("COMPUTE", "uniform dynamic"),
            },
        )
        levels = np.zeros((node_bits, _UNIFORM_STEP // 4), np.uint32)
        levels[:, 0] = np.arange(1, node_bits + 1)
        numbers = gpu.buffer("maxima levels", levels, "UNIFORM", "clipmap")
        array = {"dimension": "2d-array"}
        self._group = gpu.bind(
            "maxima",
            layout,
            {
                0: self._slots,
                1: atlas.textures["height"].view(**array),
                2: atlas.textures["maxima"].view(**array),
                3: (numbers, 0, 4),
            },
        )
        constants = {"NODE_BITS": node_bits, "HEIGHT_BORDER": HEIGHT_BORDER, **form.constants}
        shader = gpu.shader("maxima", FOLDER / "maxima.wgsl", constants=constants)
        self._pipeline = gpu.compute("maxima", shader, "build", [layout])

    def build(self, slots: list[int]) -> None:
        """Make the pyramids of some slots."""
        if not slots:
            return
        self._gpu.write(self._slots, np.asarray(slots, np.uint32))
        encoder = self._gpu.encoder("maxima")
        run = encoder.begin_compute_pass(label="maxima")
        run.set_pipeline(self._pipeline)
        for level in range(1, self._bits + 1):
            groups = -(-((1 << self._bits >> level) + 1) // 8)
            run.set_bind_group(0, self._group, [_UNIFORM_STEP * (level - 1)])
            run.dispatch_workgroups(groups, groups, len(slots))
        run.end()
        self._gpu.submit(encoder)
