"""BDAM, batched dynamic adaptive meshes; see README.md in this folder."""

from __future__ import annotations

from typing import Any

from orogen.lod.bdam import meshes
from orogen.lod.bdam.build import Builder
from orogen.lod.bdam.diamonds import Diamonds
from orogen.lod.bdam.patches import Patches
from orogen.lod.bdam.settings import Settings
from orogen.lod.bdam.store import open_library
from orogen.lod.contract import Algorithm, AlgorithmView, Detail
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.pages import PageStore
from orogen.streaming.samples import Samples


class Bdam(Algorithm):
    """A bintree of triangular patches, each a triangulated irregular network that was simplified beforehand."""

    name = "bdam"
    Settings = Settings
    detail = Detail("pixels", finest=0.25, coarsest=32.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        samples = Samples(clipmap.heights)
        # n quads along the legs of a patch make n * n triangles
        diamonds = Diamonds(clipmap.grid, round(settings.patch_triangles**0.5))
        source = clipmap.heights.pyramid.source
        library = open_library(source, diamonds.n, lambda draft: Builder(samples, diamonds, draft).run(), self)
        self.patches = Patches(samples, diamonds, library)
        self.pages = self._store = PageStore(
            clipmap.gpu, "bdam", self.patches.page_bytes, self.patches, memory=settings.memory, faults=clipmap.faults
        )
        self._module = meshes.module(clipmap)

    def view(self) -> AlgorithmView:
        """State for one more view."""
        return meshes.View(self.clipmap, self.settings, self.patches, self._store, self._module)
