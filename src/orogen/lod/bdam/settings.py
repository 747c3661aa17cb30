"""Settings of BDAM."""

from __future__ import annotations

from dataclasses import dataclass

from orogen.errors import SettingsError

TRIANGLES = (64, 256, 1024)


@dataclass(frozen=True)
class Settings:
    """How far the surface may be off, and what it is made of."""

    pixels: float = 1.0
    """Pixels that the surface may be off where it is drawn (screen-space error), above 0."""
    patch_triangles: int = 256
    """Triangles of a patch: 64, 256 or 1024."""
    memory: int = 128 << 20
    """Bytes of GPU memory for patches. Where it is full, the surface stays coarser."""

    def __post_init__(self) -> None:
        if not self.pixels > 0:
            raise SettingsError(f"pixels: expected a number of pixels above 0, got {self.pixels}")
        if self.patch_triangles not in TRIANGLES:
            raise SettingsError(f"patch_triangles: expected 64, 256 or 1024, got {self.patch_triangles}")
        if self.memory < 1 << 20:
            raise SettingsError(f"memory: expected at least 1048576 bytes (1 MiB), got {self.memory}")
