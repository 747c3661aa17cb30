"""Orogen: exact, real-time, out-of-core terrain rendering on WebGPU.

import orogen

with orogen.open("dem.tif", color="ortho.tif") as terrain:
picture = terrain.render(terrain.camera(heading=30, pitch=-25), size=(1920, 1080))
picture.color, picture.depth, picture.position
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orogen.camera import Camera
    from orogen.errors import OrogenError
    from orogen.shading.style import Style
    from orogen.streaming.settings import ClipmapSettings
    from orogen.terrain import Terrain
    from orogen.terrain import open_terrain as open
    from orogen.view.renderer import Picture, Scene

__version__ = "0.1.0"

__all__ = ["Camera", "ClipmapSettings", "OrogenError", "Picture", "Scene", "Style", "Terrain", "open"]

_HOMES = {
    "Camera": "orogen.camera",
    "ClipmapSettings": "orogen.streaming.settings",
    "OrogenError": "orogen.errors",
    "Picture": "orogen.view.renderer",
    "Scene": "orogen.view.renderer",
    "Style": "orogen.shading.style",
    "Terrain": "orogen.terrain",
    "open": "orogen.terrain",
}


def __getattr__(name: str) -> Any:
    # each name is imported when it is first asked for: `import orogen` stays fast
    if name not in _HOMES:
        raise AttributeError(f"module 'orogen' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), "open_terrain" if name == "open" else name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
