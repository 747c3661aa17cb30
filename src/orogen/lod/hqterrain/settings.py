"""Settings of HQTerrain."""

from __future__ import annotations

from dataclasses import dataclass

from orogen.errors import SettingsError

SIZES = (16, 32, 64)


@dataclass(frozen=True)
class Settings:
    """How exact tiles are, and how large."""

    tau: float = 1.0
    """Pixels that a tile's mesh may be off the surface of all its vertices, above 0."""
    pixels_per_quad: float = 4.0
    """Greatest width in pixels of a quad of a tile that has all its vertices, seen face on, above 0."""
    tile_size: int = 64
    """Quads along a tile's side where it has all its vertices: 16, 32 or 64."""
    memory: int = 128 << 20
    """Bytes of GPU memory for tiles. Where it is full, tiles stay coarser."""

    def __post_init__(self) -> None:
        if not self.tau > 0:
            raise SettingsError(f"tau: expected a number of pixels above 0, got {self.tau}")
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if self.tile_size not in SIZES:
            raise SettingsError(f"tile_size: expected 16, 32 or 64 quads, got {self.tile_size}")
        if self.memory < 1 << 20:
            raise SettingsError(f"memory: expected at least 1048576 bytes (1 MiB), got {self.memory}")
