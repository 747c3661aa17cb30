"""Settings of the chunked clipmap and its streaming."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from orogen.errors import SettingsError
from orogen.frame import REFERENCE_FOV

HEIGHT_BORDER = 2
"""Border of a node's heights in texels (border_size): one for interpolation, two for normals (Kuehnert 2022, 6.2)."""
COLOR_BORDER = 8
"""Border of a node's colours in texels: more than half of MAX_ANISOTROPY, and one texel still in the last mip level."""
COLOR_MIPS = 4
"""Mip levels stored with a node's colours (mip_count)."""
MAX_ANISOTROPY = 8
"""Greatest ratio of a colour footprint's sides that is filtered without blur: samples taken at most."""
MAX_ZOOM = 8.0
"""Greatest factor by which a narrow angle of view widens view_distance: beyond it far ground is drawn coarser."""


@dataclass(frozen=True)
class ClipmapSettings:
    """The chunked clipmap (Kuehnert 2022, section 4.5 and appendix)."""

    view_distance: float | None = None
    """Radius around the camera within which level 0 is used, in leaf nodes; level L is used to 2^L times that. None:
    the longer side of the picture over the node size, which gives about one texel a pixel (section 6.2) at an angle of
    view of 45 degrees, and in proportion at others. Infinite: level 0 everywhere."""
    load_distance: float | None = None
    """Radius within which the nodes of level 0 are loaded, in leaf nodes, at least view_distance. None: the same. More
    than that loads ahead of a moving camera."""
    behind: float = 0.25
    """Factor on load_distance for nodes outside the picture, 0 to 1: they only cast shadows, or come into view soon."""
    blend_range: float = 0.2
    """Share of a level's range in which it is blended into the next coarser one, above 0 and at most 1."""
    node_size: int = 256
    """Texels along a node's side without its border (center_size): 256, 512 or 1024."""
    height_bits: int | None = None
    """Bits of a height in the node atlas, 16 or 32. None: 16 where the pyramid is built and the data are integers that
    these hold without loss, else 32. With 16 other heights are rounded, to a step that the whole terrain shares."""
    color_compression: Literal["auto", "off"] = "off"
    """Whether an image's nodes are kept as BC7 blocks, a quarter of the bytes with some loss of colour: "auto" where
    the GPU reads them, "off" not at all."""
    memory: int = 192 << 20
    """Bytes of GPU memory for the node atlas. A full atlas lowers detail."""
    host_memory: int = 64 << 20
    """Bytes of host memory for decoded tiles and for nodes that wait to be uploaded."""
    upload_budget: int = 32 << 20
    """Bytes that are uploaded to the GPU per frame at most; a single node always may be."""
    threads: int = 2
    """Threads that read and decode."""

    def __post_init__(self) -> None:
        if self.view_distance is not None and not self.view_distance > 0:
            raise SettingsError(f"view_distance: expected more than 0 leaf nodes, got {self.view_distance}")
        if self.load_distance is not None and not self.load_distance >= (self.view_distance or 0):
            raise SettingsError(
                f"load_distance: expected at least view_distance ({self.view_distance}), got {self.load_distance}"
            )
        if not 0 <= self.behind <= 1:
            raise SettingsError(f"behind: expected 0 to 1, got {self.behind}")
        if not 0 < self.blend_range <= 1:
            raise SettingsError(f"blend_range: expected above 0 and at most 1, got {self.blend_range}")
        if self.node_size not in (256, 512, 1024):
            raise SettingsError(f"node_size: expected 256, 512 or 1024 texels, got {self.node_size}")
        if self.height_bits not in (None, 16, 32):
            raise SettingsError(f"height_bits: expected 16, 32 or none, got {self.height_bits}")
        if self.color_compression not in ("auto", "off"):
            raise SettingsError(f"color_compression: expected auto or off, got {self.color_compression!r}")
        for name in ("memory", "host_memory", "upload_budget"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1 << 20:
                raise SettingsError(f"{name}: expected a whole number of bytes, at least 1048576 (1 MiB), got {value}")
        if not isinstance(self.threads, int) or self.threads < 1:
            raise SettingsError(f"threads: expected a whole number, at least 1, got {self.threads}")

    @property
    def node_bits(self) -> int:
        """Logarithm of node_size."""
        return self.node_size.bit_length() - 1

    def view_distance_for(self, size: tuple[float, float], fov: float = REFERENCE_FOV) -> float:
        """view_distance for a picture of (width, height) pixels and a vertical angle of view in degrees."""
        if self.view_distance is not None:
            return self.view_distance
        # a narrower view magnifies what is far
        zoom = math.tan(math.radians(REFERENCE_FOV) / 2) / math.tan(math.radians(fov) / 2)
        return max(size) / self.node_size * min(zoom, MAX_ZOOM)

    def load_distance_for(self, size: tuple[float, float], fov: float = REFERENCE_FOV) -> float:
        """load_distance for a picture of (width, height) pixels and a vertical angle of view in degrees."""
        return max(self.load_distance or 0.0, self.view_distance_for(size, fov))
