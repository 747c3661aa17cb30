"""Settings of Chunked LOD."""

from __future__ import annotations

from dataclasses import dataclass

from orogen.errors import SettingsError

SIZES = (16, 32, 64)


@dataclass(frozen=True)
class Settings:
    """How far chunks may be off, and what they are made of."""

    tau: float = 1.0
    """Pixels that the surface may be off where it is drawn (screen-space error), above 0."""
    chunk_size: int = 64
    """Quads along a chunk's side where it has all its vertices: 16, 32 or 64."""
    base_error: float | None = None
    """Metres that chunks whose vertices are a sample apart may be off, above 0; doubles from level to level. None: what
    suits the terrain, by a factor of two to four from level to level."""
    morph_range: float = 0.5
    """Part of the way from one level to the next in which a chunk morphs out of its parent's surface, above 0 and at
    most 1."""
    preprocessed: bool = True
    """Whether chunks are meshes that follow the terrain, made beforehand; if not they are regular grids that take their
    heights from the node atlas as they are drawn (Vistnes)."""
    pixels_per_quad: float = 4.0
    """Greatest width of a regular grid's quad in pixels where it is seen face on, above 0; only where not
    preprocessed."""
    memory: int = 128 << 20
    """Bytes of GPU memory for chunks. Where it is full, chunks stay coarser."""

    def __post_init__(self) -> None:
        if not self.tau > 0:
            raise SettingsError(f"tau: expected a number of pixels above 0, got {self.tau}")
        if self.chunk_size not in SIZES:
            raise SettingsError(f"chunk_size: expected 16, 32 or 64 quads, got {self.chunk_size}")
        if self.base_error is not None and not self.base_error > 0:
            raise SettingsError(f"base_error: expected a number of metres above 0, got {self.base_error}")
        if not 0 < self.morph_range <= 1:
            raise SettingsError(f"morph_range: expected above 0 and at most 1, got {self.morph_range}")
        if not self.pixels_per_quad > 0:
            raise SettingsError(f"pixels_per_quad: expected a number above 0, got {self.pixels_per_quad}")
        if self.memory < 1 << 20:
            raise SettingsError(f"memory: expected at least 1048576 bytes (1 MiB), got {self.memory}")
