"""The surface buffer: per pixel depth, id and detail, which shading, picking and metrics read."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from orogen.gpu import Gpu, Readback

FORMATS = {"depth": "r32float", "id": "r32uint", "detail": "r32uint"}
"""Colour targets of the surface buffer, in the order of their locations."""

READ_LAYOUT = {
    0: ("COMPUTE|FRAGMENT", "texture unfilterable"),
    1: ("COMPUTE|FRAGMENT", "texture uint"),
    2: ("COMPUTE|FRAGMENT", "texture uint"),
}
"""Bind group 2 of shaders that include surface.wgsl."""

WRITE_LAYOUT = {n: ("COMPUTE", f"image {form} readwrite") for n, form in enumerate(FORMATS.values())}
"""Bind group 2 of ray passes."""


class Surface:
    """The surface buffer of a picture of `size` (width, height) pixels: 16 bytes a pixel."""

    def __init__(self, gpu: Gpu, size: tuple[int, int], read_layout: Any, write_layout: Any) -> None:
        self._gpu = gpu
        self.size = size
        usage = "RENDER_ATTACHMENT|TEXTURE_BINDING|STORAGE_BINDING|COPY_SRC"
        self.targets = {
            name: gpu.texture(f"surface {name}", size, form, usage, "surface") for name, form in FORMATS.items()
        }
        """Textures by name: reverse-z depth, id, detail."""
        # the fixed-function depth test needs a texture of its own: depth formats cannot be written by compute passes
        self.z = gpu.texture("surface z", size, "depth32float", "RENDER_ATTACHMENT", "surface")
        numbered = dict(enumerate(self.targets.values()))
        self.read_group = gpu.bind("surface", read_layout, numbered)
        """Bind group 2 of shaders that include surface.wgsl."""
        self.write_group = gpu.bind("surface", write_layout, numbered)
        """Bind group 2 of ray passes."""

    @cached_property
    def cleared(self) -> dict[str, Any]:
        """Attachments of a render pass that clears the surface first."""
        return self._attachments("clear")

    @cached_property
    def kept(self) -> dict[str, Any]:
        """Attachments of a render pass that adds to the surface."""
        return self._attachments("load")

    def _attachments(self, load: str) -> dict[str, Any]:
        color = {"load_op": load, "store_op": "store", "clear_value": (0, 0, 0, 0)}
        depth = {"depth_load_op": load, "depth_store_op": "store", "depth_clear_value": 0.0}
        return {
            "color_attachments": [{"view": texture.view(), **color} for texture in self.targets.values()],
            "depth_stencil_attachment": {"view": self.z.view(), **depth},
        }

    def read(self, name: str) -> Readback:
        """A target as (height, width) array: "depth" float32 (reverse z, 0 for the sky), "id", "detail" uint32."""
        return self._gpu.read_texture(self.targets[name])

    def destroy(self) -> None:
        """Give the memory back."""
        for texture in (*self.targets.values(), self.z):
            texture.destroy()
