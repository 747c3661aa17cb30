"""Joins two pictures in one: side by side, up to a divider, or their difference in height as colour."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orogen.frame import Frame
from orogen.gpu import Gpu, Texture
from orogen.raster.surface import Surface

if TYPE_CHECKING:
    import wgpu

MODES = ("whole", "wipe", "beside", "difference")
"""The first picture alone; the second right of the divider; each in a part of its own; their difference there."""

_BLOCK = np.dtype(
    [
        ("right", "f4", 4), ("up", "f4", 4), ("forward", "f4", 4), ("jitter", "f4", 4),
        ("size", "f4", 2), ("divider", "f4"), ("mode", "u4"),
        ("limit", "f4"), ("near", "f4"), ("encode", "u4"), ("exaggeration", "f4"),
        ("depth_scale", "f4", 4),
        ("line", "f4"), ("unused", "f4", 3),
    ]
)  # fmt: skip


class Joiner:
    """Holds the pictures that are joined, and joins them into a texture that can only be drawn to."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        texture = ("FRAGMENT", "texture unfilterable")
        self._layout = gpu.layout(
            "split",
            {
                0: ("FRAGMENT", "uniform"), 1: ("FRAGMENT", "sampler filtering"),
                2: ("FRAGMENT", "texture float"), 3: ("FRAGMENT", "texture float"), 4: texture, 5: texture,
            },
        )  # fmt: skip
        self._shader = gpu.shader("split", Path(__file__).parent / "split.wgsl")
        self._block = gpu.buffer("split", _BLOCK.itemsize, "UNIFORM|COPY_DST", "view")
        self._sampler = gpu.sampler("split", mag_filter="linear", min_filter="linear")
        self._nothing = gpu.texture("no depth", (1, 1), "r32float", "TEXTURE_BINDING", "view")
        self._pictures: list[Texture | None] = [None, None]
        self._pipelines: dict[str, Any] = {}

    def picture(self, number: int, size: tuple[int, int], format: str) -> wgpu.GPUTextureView:
        """Texture view that the first (0) or the second (1) picture of (width, height) pixels is to be drawn to."""
        held = self._pictures[number]
        if held is None or held.size[:2] != size or held.format != format:
            if held:
                held.destroy()
            self._pictures[number] = None
            held = self._gpu.texture("picture", size, format, "RENDER_ATTACHMENT|TEXTURE_BINDING", "view")
            self._pictures[number] = held
        return held.view()

    def join(
        self,
        target: wgpu.GPUTextureView,
        size: tuple[int, int],
        mode: str = "whole",
        *,
        divider: float = 0.0,
        shown: tuple[tuple[Frame, Surface], tuple[Frame, Surface]] | None = None,
        limit: float = 1.0,
        line: float = 1.0,
    ) -> None:
        """Draw the pictures into a texture of `size` pixels.

        `divider`: column where the second begins; `line`: half the width of what marks it, in pixels. `shown`: what
        the two were drawn from, for "difference": the second's height over the first in metres, `limit` the strongest
        colour (red: the second is higher).
        """
        first = self._pictures[0]
        assert first is not None, "draw the first picture first"
        second = first if mode == "whole" else self._pictures[1] or first
        form = target.texture.format
        depths: list[Texture] = [self._nothing, self._nothing]
        block = np.zeros((), _BLOCK)
        block["size"], block["divider"], block["mode"] = size, round(divider), MODES.index(mode)
        block["limit"], block["encode"], block["line"] = limit, not form.endswith("-srgb"), line
        if shown:
            depths = [surface.targets["depth"] for _, surface in shown]
            _describe(block, *(frame for frame, _ in shown))
        self._gpu.write(self._block, block.tobytes())
        group = self._gpu.bind(
            "split", self._layout,
            {0: self._block, 1: self._sampler, 2: first, 3: second, 4: depths[0], 5: depths[1]},
        )  # fmt: skip
        if form not in self._pipelines:
            self._pipelines[form] = self._gpu.render(
                "split", self._shader, "cover", "join", [{"format": form}], [self._layout]
            )
        encoder = self._gpu.encoder("split")
        attachment = {"view": target, "load_op": "clear", "store_op": "store", "clear_value": (0, 0, 0, 0)}
        run = encoder.begin_render_pass(label="split", color_attachments=[attachment])
        run.set_pipeline(self._pipelines[form])
        run.set_bind_group(0, group)
        run.draw(3)
        run.end()
        self._gpu.submit(encoder)

    def close(self) -> None:
        """Give the GPU memory back."""
        for texture in self._pictures:
            if texture:
                texture.destroy()
        self._pictures = [None, None]
        self._block.destroy()
        self._nothing.destroy()


def _describe(block: Any, first: Frame, second: Frame) -> None:
    """The rays of both pictures, which one camera sees."""
    right, up, forward = first.camera.basis
    half_x, half_y = first.half_extent
    block["right"][:3], block["up"][:3], block["forward"][:3] = right * half_x, up * half_y, forward
    block["jitter"] = (*first.jitter, *second.jitter)
    block["near"], block["exaggeration"] = first.camera.near, first.exaggeration
    if first.camera.orthographic:
        for place, frame in enumerate((first, second)):
            near, far = frame.depth_range
            block["depth_scale"][2 * place : 2 * place + 2] = far, near - far
