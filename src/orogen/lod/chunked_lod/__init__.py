"""Chunked LOD; see README.md in this folder."""

from __future__ import annotations

from typing import Any

from orogen.lod.chunked_lod import meshes
from orogen.lod.chunked_lod.chunks import ChunkMaker
from orogen.lod.chunked_lod.grids import Grids, GridView
from orogen.lod.chunked_lod.settings import Settings
from orogen.lod.chunked_lod.survey import Survey
from orogen.lod.contract import Algorithm, AlgorithmView, Detail
from orogen.lod.quadtree import PatchTree
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.pages import PageStore
from orogen.streaming.samples import Samples


class ChunkedLod(Algorithm):
    """Meshes of a quadtree, made beforehand within errors that double from level to level."""

    name = "chunked_lod"
    Settings = Settings
    detail = Detail("tau", finest=0.25, coarsest=32.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        self._grids: Grids | None = None
        if not settings.preprocessed:
            self._grids = Grids(clipmap, settings.chunk_size)
            return
        tree = PatchTree(clipmap.grid, 1)
        survey = Survey(Samples(clipmap.heights), tree, settings.chunk_size)
        self.maker = ChunkMaker(survey, settings.base_error)
        self.pages = self._store = PageStore(
            clipmap.gpu, "chunked_lod", self.maker.page_bytes, self.maker, memory=settings.memory, faults=clipmap.faults
        )
        self._module = meshes.module(clipmap)

    def view(self) -> AlgorithmView:
        """State for one more view."""
        if self._grids:
            return GridView(self._grids, self.settings)
        return meshes.MeshView(self.clipmap, self.settings, self.maker, self._store, self._module)
