"""Which GPU to use: the adapters of this machine and the choice among them."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from orogen.errors import NoAdapterError, SettingsError
from orogen.gpu.quick_types import quicken_type_parsing

ADAPTER_VARIABLE = "OROGEN_ADAPTER"
"""Environment variable that chooses an adapter where no argument does."""

KINDS = ("discrete", "integrated", "virtual", "cpu", "other")
"""Kinds of adapters, the preferred first."""

_KIND_OF_TYPE = {"DiscreteGPU": "discrete", "IntegratedGPU": "integrated", "VirtualGPU": "virtual", "CPU": "cpu"}

_INSTALL = {
    "linux": (
        "install a Vulkan driver: your graphics vendor's, or Mesa's, which also has a software driver\n"
        "  Debian, Ubuntu: sudo apt install mesa-vulkan-drivers libvulkan1\n"
        "  Fedora:         sudo dnf install mesa-vulkan-drivers vulkan-loader\n"
        "  Arch:           sudo pacman -S vulkan-icd-loader vulkan-swrast"
    ),
    "darwin": "macOS has Metal on every supported machine: run outside of a virtual machine without GPU access",
    "win32": "install the graphics vendor's driver (Direct3D 12 or Vulkan)",
}


@dataclass(frozen=True)
class AdapterInfo:
    """What is known of an adapter before it is opened."""

    index: int
    """Place in `adapters()`."""
    name: str
    """The device's name as its driver gives it."""
    kind: str
    """One of `KINDS`; "cpu" is a software driver."""
    backend: str
    """"Vulkan", "Metal" or "D3D12"."""
    driver: str
    """Driver and version, as far as the backend tells."""
    features: frozenset[str] = field(default=frozenset(), repr=False)
    """Names of the optional WebGPU features that it offers."""

    def __str__(self) -> str:
        return f"{self.name} ({self.kind}, {self.backend})"


def adapters() -> list[AdapterInfo]:
    """The adapters of this machine in the driver's order; empty where there is none."""
    return [info for info, _ in native_adapters()]


def native_adapters() -> list[tuple[AdapterInfo, Any]]:
    """`adapters()`, each with its `wgpu.GPUAdapter`."""
    import wgpu
    from wgpu.backends.wgpu_native import ffi

    quicken_type_parsing(ffi)
    _use_full_backends()
    found = wgpu.gpu.enumerate_adapters_sync()
    return [(_describe(index, adapter), adapter) for index, adapter in enumerate(found)]


def choose(found: Sequence[AdapterInfo], wanted: str | None = None) -> AdapterInfo:
    """The adapter to use.

    `wanted`: an index, a kind, or a part of the name in any case; by default what `OROGEN_ADAPTER` says, else the
    best kind (`KINDS`). Raises `NoAdapterError` where there is none at all and `SettingsError` where none fits.
    """
    if not found:
        raise NoAdapterError(f"no GPU adapter was found; {_INSTALL.get(sys.platform, _INSTALL['linux'])}")
    origin = "adapter" if wanted is not None else ADAPTER_VARIABLE
    wanted = (wanted if wanted is not None else os.environ.get(ADAPTER_VARIABLE, "")).strip().lower()
    fitting = [info for info in found if _fits(info, wanted)]
    if not fitting:
        names = "; ".join(f"{info.index}: {info}" for info in found)
        raise SettingsError(
            f"{origin}: expected an index, a kind ({', '.join(KINDS)}) or a part of a name, got {wanted!r}; "
            f"this machine has {names}"
        )
    return min(fitting, key=lambda info: (KINDS.index(info.kind), info.index))


def _fits(info: AdapterInfo, wanted: str) -> bool:
    if not wanted:
        return True
    if wanted.isdecimal():
        return info.index == int(wanted)
    return wanted == info.kind if wanted in KINDS else wanted in info.name.lower()


def _describe(index: int, adapter: Any) -> AdapterInfo:
    info = adapter.info
    name = info["device"] or info["description"] or info["vendor"] or "unnamed"
    kind = _KIND_OF_TYPE.get(info["adapter_type"], "other")
    return AdapterInfo(index, name, kind, info["backend_type"], info["description"], frozenset(adapter.features))


@cache
def _use_full_backends() -> None:
    """Keep OpenGL out: it lists every device twice, lacks what the shaders need, and costs 0.2 s to look at.

    Keep out, too, the dispatch that checks the arguments of each indirect one, all of which are written here; not on
    Windows, where Direct3D's shaders may be told of their place by it.
    """
    from wgpu.backends.wgpu_native.extras import set_instance_extras

    try:
        set_instance_extras(
            backends=("Vulkan", "Metal", "DX12"), flags=("Default" if sys.platform == "win32" else "Empty",)
        )
    except RuntimeError:
        # somebody else in this process has looked for adapters already; theirs serve as well
        return
