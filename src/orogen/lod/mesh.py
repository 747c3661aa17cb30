"""Index lists of patches, cut into meshlets: small groups of triangles that share vertices.

The hardware pipeline draws an index list; the compute rasteriser hands a meshlet to each workgroup, which then computes
every vertex of it once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError
from orogen.gpu import Buffer, Gpu

MESHLET_TRIANGLES, MESHLET_VERTICES = 256, 160
"""What a meshlet has at most, triangles a power of two: half a patch of 16 x 16 quads, few of whose vertices the other
half computes again."""

MESHLET_WORDS = 2 + MESHLET_VERTICES + MESHLET_TRIANGLES
"""u32 of a meshlet in the buffer: vertex count, triangle count, vertices, triangles (corners of ten bits each, the
first lowest)."""


@dataclass(frozen=True)
class Part:
    """Where one of a mesh's lists lies."""

    first_index: int
    """Its first index in `Mesh.indices`."""
    index_count: int
    """Three times its triangles."""
    first_meshlet: int
    """Its first meshlet."""
    meshlet_count: int
    """Its meshlets."""


class Mesh:
    """Triangles of a patch in one or several lists (patterns) over the same vertices."""

    def __init__(self, gpu: Gpu, lists: Sequence[NDArray[np.integer]], category: str) -> None:
        """`lists`: (n, 3) vertex numbers each. `category`: of the memory account."""
        parts: list[Part] = []
        indices: list[NDArray[np.integer]] = []
        meshlets: list[NDArray[np.uint32]] = []
        for triangles in lists:
            if triangles.ndim != 2 or triangles.shape[1] != 3:
                raise SettingsError(f"mesh: expected lists of (n, 3) vertex numbers, got shape {triangles.shape}")
            groups = clusters(np.asarray(triangles, np.int64)) if len(triangles) else []
            first = 3 * sum(len(part) for part in indices)
            parts.append(Part(first, triangles.size, len(meshlets), len(groups)))
            indices.append(triangles)
            meshlets += [_meshlet(group) for group in groups]
        self.parts = tuple(parts)
        """Of each list, in order: what indirect arguments are made of."""
        self.indices: Buffer = gpu.buffer(
            f"{category} index", np.concatenate(indices).astype(np.uint32).ravel(), "INDEX|STORAGE|COPY_SRC", category
        )
        """u32 list for indexed draws."""
        self.meshlets: Buffer = gpu.buffer(f"{category} meshlets", np.stack(meshlets), "STORAGE", category)
        """The meshlets of all lists, `MESHLET_WORDS` each."""
        table = [(part.first_index, part.first_meshlet, part.meshlet_count, 0) for part in parts]
        self.lists: Buffer = gpu.buffer(f"{category} lists", np.array(table, np.uint32), "STORAGE", category)
        """Per list: first index, first meshlet, meshlets, 0."""


def grid_triangles(columns: int, rows: int) -> NDArray[np.int64]:
    """(2 * rows * columns, 3) triangles of a grid of quads; vertices are numbered row by row.

    Quads are cut along their falling diagonal (column + row is constant on it).
    """
    row, column = (a.ravel() for a in np.mgrid[:rows, :columns])
    a = row * (columns + 1) + column
    b, c, d = a + 1, a + columns + 1, a + columns + 2
    return np.stack([a, c, b, b, c, d], axis=1).reshape(-1, 3)


def clusters(triangles: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Triangles by meshlet, (n, 3) each, in their order: lists that go row by row share most of their vertices so."""
    cuts, vertices = [0], set[int]()
    for number, corners in enumerate(triangles.tolist()):
        if number - cuts[-1] == MESHLET_TRIANGLES or len(vertices.union(corners)) > MESHLET_VERTICES:
            cuts.append(number)
            vertices = set()
        vertices.update(corners)
    return np.split(triangles, cuts[1:])


def _meshlet(triangles: NDArray[np.integer]) -> NDArray[np.uint32]:
    vertices, local = np.unique(triangles, return_inverse=True)
    local = local.reshape(-1, 3)
    words = np.zeros(MESHLET_WORDS, np.uint32)
    words[0], words[1] = len(vertices), len(triangles)
    words[2 : 2 + len(vertices)] = vertices
    first = 2 + MESHLET_VERTICES
    words[first : first + len(triangles)] = local @ [1, 1 << 10, 1 << 20]
    return words
