"""What a terrain algorithm is: resident nodes and a frame in, draw lists out.

An algorithm is a folder under `lod/` whose package defines one subclass of `Algorithm`. It decides on geometry only: it
records GPU work that fills buffers, and returns the draws that turn them into surface (`raster` executes these). It
never colours, and never sees the picture.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Protocol

from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer, Texture
from orogen.keys import NodeKey
from orogen.lod.mesh import Mesh
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.clipmap_view import ClipmapView


@dataclass(frozen=True)
class Module:
    """WGSL of an algorithm, with bind group 1 that it reads; group 0 is the clipmap's."""

    path: Path
    """File that defines the function which the kind of draw asks for."""
    layout: Any = None
    """Layout of bind group 1; None where the function reads nothing of its own."""
    constants: Mapping[str, int | float | str] = field(default_factory=dict, hash=False)
    """Constants beside the clipmap's."""


@dataclass(frozen=True)
class Patches:
    """Instances of a grid. Vertices may lie outside the data's extent; what is drawn there is left out.

    The module defines `fn lod_vertex(vertex: u32, instance: u32) -> LodVertex`, see lod_vertex.wgsl and patch.wgsl.
    """

    module: Module
    """Vertex function."""
    group: Any
    """Bind group 1; None where the module has no layout."""
    indirect: Buffer
    """Arguments of an indirect draw: vertices per patch, patches, 0, 0. The compute rasteriser has to be able to copy
    them (usage COPY_SRC)."""
    topology: str = "triangle-strip"
    """WebGPU topology of a patch's vertices."""
    index: Mesh | None = None
    """Lists of vertex numbers; with them the arguments are those of an indexed draw of one whole list: indices per
    patch, patches, first index, number added to all indices, 0."""
    offset: int = 0
    """Bytes before the arguments in `indirect`, a multiple of 4."""


@dataclass(frozen=True)
class Rays:
    """One ray per pixel.

    The module defines `fn lod_ray(ray: Ray, from_t: f32, to_t: f32) -> RayHit`, see ray_hit.wgsl and rays.wgsl.
    """

    module: Module
    """Ray function."""
    group: Any = None
    """Bind group 1; None where the module has no layout."""
    replace: bool = False
    """Cast rays only where the module's `fn lod_replaces(pixel: vec2<u32>, depth: f32, id: u32, detail: u32) -> bool`,
    given what was drawn there, is true; what they find replaces that, nearer or not."""


Draw = Patches | Rays


@dataclass(frozen=True)
class Statistics:
    """What a frame took. Fields that do not apply to an algorithm are 0."""

    triangles: int = 0
    """Triangles that were drawn, degenerate ones included."""
    patches: int = 0
    """Patches that were drawn."""
    draws: int = 0
    """Draw calls and ray passes."""
    rays: int = 0
    """Rays that were cast."""


@dataclass(frozen=True)
class Detail:
    """The setting that makes an algorithm's geometry finer or coarser, everything else being equal."""

    setting: str
    """Name of a numeric setting."""
    finest: float
    """Its value for the most triangles that make sense."""
    coarsest: float
    """Its value for the fewest."""


class Pages(Protocol):
    """Data of an algorithm's own that is loaded as it is needed; `AlgorithmView.wants` asks for it."""

    @property
    def pending(self) -> int:
        """Wanted pages that are still to come."""

    @property
    def retry_in(self) -> float | None:
        """Seconds until a page that failed is made again; None where none has failed."""

    def pump(self, budget: int) -> int:
        """Upload loaded pages of at most `budget` bytes (one at least); returns the bytes uploaded."""

    def settle(self) -> None:
        """Load until every wanted page that fits is resident."""

    def close(self) -> None:
        """Stop loading and give the memory back."""


class AlgorithmView(ABC):
    """An algorithm at work for one view; its state outlives a frame."""

    def wants(self, frame: Frame) -> Sequence[NodeKey]:
        """Nodes that the algorithm needs beside those that the clipmap loads for the frame.

        Also where it asks `Algorithm.pages` for what it needs of its own data.
        """
        return ()

    @abstractmethod
    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Record the frame's GPU work and say what is to be drawn. `view` has been updated for the frame."""

    def drawn(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView, depth: Texture) -> Sequence[Draw]:
        """What to add after the draws of `record` have been executed.

        `depth`: the surface buffer's reverse-z depth (r32float, the frame's size), which compute passes may read.
        """
        return ()

    @abstractmethod
    def statistics(self) -> Statistics:
        """Of the latest frame submitted; waits for the GPU."""

    def unfinished(self) -> bool:
        """Whether the latest frame's geometry is not what it will be when the same frame is drawn again, as it is where
        refinement goes on within a time budget. Does not wait for the GPU.
        """
        return False

    def incomplete(self) -> bool:
        """Whether the latest frame lacks something for want of room; asking makes room, so that a repeat is whole."""
        return False


class Algorithm(ABC):
    """A way of showing terrain."""

    name: ClassVar[str]
    """The name of its folder."""
    Settings: ClassVar[type]
    """Frozen dataclass of its settings, with a docstring under every field; its defaults are good ones."""
    detail: ClassVar[Detail | None] = None
    """How its triangles become more or fewer; None where it has no such setting."""
    pages: Pages | None = None
    """Its own data, beside the clipmap's; None where it has none."""

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        self.clipmap = clipmap
        self.settings = settings

    @abstractmethod
    def view(self) -> AlgorithmView:
        """State for one more view."""
