"""Buffers and textures that are counted in the memory account for as long as anything holds them."""

from __future__ import annotations

import weakref
from typing import Any

import wgpu

from orogen.gpu.checked import checked
from orogen.gpu.formats import Format, format_of, mip_size
from orogen.gpu.memory import MemoryAccount


class Buffer:
    """A GPU buffer. Its memory is given back by `destroy`, or when nothing refers to it any more."""

    def __init__(self, raw: Any, account: MemoryAccount, category: str) -> None:
        """`raw`: the `wgpu.GPUBuffer`, counted already in the account."""
        self.raw = raw
        """The `wgpu.GPUBuffer`."""
        self.label: str = raw.label
        """Its name in messages."""
        self.size: int = raw.size
        """Bytes."""
        self._release = weakref.finalize(raw, account.release, raw.size, category)

    def allows(self, usage: str) -> bool:
        """Whether it was made for a use, by its name in `wgpu.BufferUsage`."""
        return bool(self.raw.usage & wgpu.BufferUsage[usage])

    def destroy(self) -> None:
        """Give the memory back now; again does nothing."""
        if self._release.alive:
            self.raw.destroy()
            self._release()


class Texture:
    """A GPU texture. Its memory is given back by `destroy`, or when nothing refers to it or its views any more."""

    def __init__(self, raw: Any, account: MemoryAccount, category: str, nbytes: int) -> None:
        """`raw`: the `wgpu.GPUTexture`, counted already as `nbytes` in the account."""
        self.raw = raw
        """The `wgpu.GPUTexture`."""
        self.label: str = raw.label
        """Its name in messages."""
        self.nbytes = nbytes
        """Bytes of all mip levels, layers and samples."""
        self._views: dict[tuple[tuple[str, Any], ...], Any] = {}
        self._release = weakref.finalize(raw, account.release, nbytes, category)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of mip level 0 in texels."""
        return self.raw.width, self.raw.height

    @property
    def layers(self) -> int:
        """Array layers, or slices of a 3D texture."""
        return self.raw.depth_or_array_layers

    @property
    def mips(self) -> int:
        """Mip levels."""
        return self.raw.mip_level_count

    @property
    def format(self) -> str:
        """WebGPU name of the format."""
        return self.raw.format

    @property
    def layout(self) -> Format:
        """How its texels lie in memory."""
        return format_of(self.raw.format)

    def mip_size(self, mip: int) -> tuple[int, int]:
        """Width and height of a mip level."""
        return mip_size(self.size, mip)

    def view(self, **choice: Any) -> Any:
        """A `wgpu.GPUTextureView`; the same object for the same choice.

        `choice`: arguments of `GPUTexture.create_view`, such as `dimension="2d-array"` or `base_mip_level=1`.
        """
        key = tuple(sorted(choice.items()))
        if key not in self._views:
            with checked(f"texture {self.label!r}"):
                self._views[key] = self.raw.create_view(label=self.label, **choice)
        return self._views[key]

    def destroy(self) -> None:
        """Give the memory back now; again does nothing."""
        if self._release.alive:
            self._views.clear()
            self.raw.destroy()
            self._release()
