"""What a source that is made of another one says of itself, unless it knows better."""

from __future__ import annotations

from dataclasses import dataclass

from orogen.source.contract import Kind, Source, attribution_of


@dataclass(frozen=True)
class DerivedSource:
    """The words of a `Source` that are those of another one; the grid and the samples are left to subclasses."""

    source: Source
    """The other one."""

    @property
    def kind(self) -> Kind:
        """Heights or colours."""
        return self.source.kind

    @property
    def name(self) -> str:
        """What messages call it."""
        return self.source.name

    @property
    def dtype(self) -> str:
        """The type of the samples as stored."""
        return self.source.dtype

    @property
    def nodata(self) -> float | None:
        """The stored value that stands for nodata, or None."""
        return self.source.nodata

    @property
    def units(self) -> str:
        """The vertical unit as stored."""
        return self.source.units

    @property
    def vertical_crs(self) -> str | None:
        """Name of the vertical reference, or None."""
        return self.source.vertical_crs

    @property
    def attribution(self) -> str:
        """Who is to be named where it is shown, or ""."""
        return attribution_of(self.source)

    def close(self) -> None:
        """Release open files."""
        self.source.close()
