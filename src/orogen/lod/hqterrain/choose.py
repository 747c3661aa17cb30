"""Which tiles a frame shows, at which level of detail, and what is put between those that meet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.hqterrain.settings import Settings
from orogen.lod.hqterrain.tiles import COARSEST, FINEST, TileMaker
from orogen.lod.quadtree import Ints, Leaves, PatchFrame, neighbours

Floats = NDArray[np.float64]


class TileFrame(PatchFrame):
    """The tiles as the LOD camera of a frame sees them; heights are true ones, not those of the clipmap's nodes.

    Tiles are divided where their quads are too large on screen.
    """

    def __init__(self, maker: TileMaker, frame: Frame, settings: Settings) -> None:
        metres = maker.tree.grid.metres
        self._pixels = frame.pixels_per_radian(frame.lod)
        self._settings = settings
        levels = np.arange(maker.tree.level_count)
        quad = float(np.linalg.norm(metres, axis=0).max()) * 2.0**levels / maker.n
        # with curvature a flat tile passes under the bent ground, as far as a chord of its diagonal does
        diagonal = float(((metres @ np.array([[1.0, 1.0], [1.0, -1.0]])) ** 2).sum(axis=0).max())
        sag = frame.curvature_factor * diagonal * 4.0**levels / 4
        reach = self._pixels * np.maximum(quad / settings.pixels_per_quad, sag / settings.tau)
        # a quad is at least a subtexel wide
        reach[levels + frame.subtexel_bits <= maker.k] = 0.0
        super().__init__(maker.tree, frame, maker.ground.ranges, reach)

    def details(self, tiles: Leaves) -> Floats:
        """Continuous levels of detail at the nearest points of tiles.

        Also fully morphed, the mesh of the level of detail below is off by at most tau.
        """
        return self.continuous(self.distance(*tiles))

    def corner_morphs(self, tiles: Leaves, corners: Floats, nearest: Floats, details: Ints) -> Floats:
        """(n, 4) morph factors at the corners of tiles, in the order of `Tile.corners`.

        `corners`: (n, 4) heights there. `nearest`: continuous levels of detail, `details`: those of the meshes. All
        corners start to morph where the mesh is taken, and are done where the next coarser one takes its place; the
        farther ones are ahead.
        """
        level, x, y = (part[:, None] for part in tiles)
        grid = self.tree.grid
        column = np.minimum(x + np.array([0, 1, 0, 1]) << level, grid.width - 1)
        row = np.minimum(y + np.array([0, 0, 1, 1]) << level, grid.height - 1)
        distance = self.distance_to(column.ravel(), row.ravel(), corners.ravel())
        ahead = self.continuous(distance).reshape(-1, 4) - nearest[:, None]
        return np.clip((nearest - details)[:, None] * (1 + ahead), 0.0, 1.0)

    def continuous(self, distance: Floats) -> Floats:
        """Logarithm of half the error (metres of the data) that tau allows at distances (Houska 2019, equation 2.4)."""
        allowed = self._settings.tau * distance / (2 * self._pixels * self.frame.exaggeration)
        return np.log2(np.clip(allowed, 2.0**FINEST, 2.0**COARSEST))


class Seams(NamedTuple):
    """Sides of tiles with other tiles beyond: each pair of tiles that share a side once, with the coarser one."""

    tile: Ints
    """(n,) the coarser one, or of two alike the one in the west or north."""
    side: Ints
    """(n,) west, east, north, south."""
    starts: Ints
    """(n + 1,) where each seam's tiles start in `beyond`."""
    beyond: Ints
    """Tiles beyond, in order along the side."""


def seams(tiles: Leaves) -> Seams:
    """Where tiles meet, as indices of them."""
    level, x, y = tiles
    beyond = neighbours(tiles, int(np.ptp(level)) if level.size else 0)
    coarser = np.append(level, -1)[beyond] > level[:, None]
    # of two alike the one in the east or south takes note
    coarser[:, [0, 2]] |= beyond[:, [0, 2]] >= 0
    one, edge = np.nonzero(coarser)
    side, other = edge ^ 1, beyond[one, edge]
    place = other * 4 + side
    found, first, number, counts = np.unique(place, return_index=True, return_inverse=True, return_counts=True)
    # those that are met first come first
    rank = np.argsort(first)
    order = np.lexsort((np.where(side < 2, y[one], x[one]), np.argsort(rank)[number]))
    return Seams(found[rank] // 4, found[rank] % 4, np.append(0, np.cumsum(counts[rank])), one[order])


def strip(one: tuple[Ints, Ints], other: tuple[Ints, Ints]) -> Ints:
    """(m, 3) triangles between two lines of vertices along the same side: (vertices, places in order) each.

    Where both run through the same points the triangles have no area; they close what is between them elsewhere.
    """
    (a, place_a), (b, place_b) = one, other
    # step by step along the line whose next vertex comes first
    place = np.concatenate([place_a[1:], place_b[1:]])
    from_a = np.arange(place.size) < a.size - 1
    order = np.argsort(place, kind="stable")
    from_a = from_a[order]
    i: Ints = np.cumsum(from_a) - from_a
    j: Ints = np.arange(place.size) - i
    ahead = np.where(from_a, a[np.minimum(i + 1, a.size - 1)], b[np.minimum(j + 1, b.size - 1)])
    return np.stack([a[i], b[j], ahead], axis=1)
