"""Pyramids that are made of another one while they are read."""

from __future__ import annotations

from orogen.pyramid.contract import Pyramid
from orogen.source.contract import Source


class DerivedPyramid(Pyramid):
    """As built, as exact and as available as the pyramid below it; subclasses say how to read."""

    def __init__(self, below: Pyramid, source: Source) -> None:
        """`source`: what describes the samples."""
        super().__init__(source)
        self._below = below

    @property
    def built(self) -> bool:
        """Whether the one below is."""
        return self._below.built

    @property
    def exact(self) -> bool:
        """Whether the one below is."""
        return self._below.exact

    @property
    def chunked(self) -> bool:
        """Whether the one below is."""
        return self._below.chunked

    @property
    def covered(self) -> bool:
        """Whether the one below is."""
        return self._below.covered

    def available(self, level: int) -> bool:
        """Whether the level of the one below is."""
        return self._below.available(level)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for the one below."""
        return self._below.wait(timeout)
