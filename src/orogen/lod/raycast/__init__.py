"""GPU ray casting over maximum mipmaps, exact and watertight; see README.md in this folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orogen.frame import Frame
from orogen.gpu import FrameTimer
from orogen.lod.contract import Algorithm, AlgorithmView, Draw, Module, Rays, Statistics
from orogen.streaming.clipmap_view import ClipmapView


@dataclass(frozen=True)
class Settings:
    """Ray casting has no settings of its own: the clipmap's decide on the level of detail."""


class View(AlgorithmView):
    """Counts the rays of a frame."""

    def __init__(self, algorithm: RayCast) -> None:
        self._algorithm = algorithm
        self._rays = 0

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """One ray per pixel."""
        self._rays = frame.size[0] * frame.size[1]
        return [Rays(self._algorithm.module)]

    def statistics(self) -> Statistics:
        """Rays only."""
        return Statistics(draws=1, rays=self._rays)


class RayCast(Algorithm):
    """Rays through the node atlas: the reference, and a contender."""

    name = "raycast"
    Settings = Settings
    module = Module(Path(__file__).parent / "raycast.wgsl")

    def view(self) -> View:
        """State for one more view."""
        return View(self)
