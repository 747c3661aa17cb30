"""Which tiles a frame shows, at which level of detail, and what is put between those that meet."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from itertools import islice
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from orogen.frame import Frame
from orogen.lod.hqterrain.settings import Settings
from orogen.lod.hqterrain.tiles import COARSEST, FINEST, Tile, TileKey, TileMaker
from orogen.lod.quadtree import PatchFrame

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class TileFrame(PatchFrame):
    """The tiles as the LOD camera of a frame sees them."""

    def __init__(self, maker: TileMaker, frame: Frame, settings: Settings) -> None:
        # the bounds below stand for those of the clipmap's nodes
        super().__init__(maker.tree, frame, cast(Any, None))
        self._maker = maker
        self._pixels = frame.pixels_per_radian(frame.lod)
        self._settings = settings

    def bounds(self, level: int, x: Ints, y: Ints) -> tuple[Floats, Floats]:
        """Lowest and highest height (metres of the data) in tiles."""
        return self._maker.bounds(level, x, y)

    def leaves(self) -> list[TileKey]:
        """Tiles of a restricted quadtree whose quads are small enough on screen."""
        maker, frame = self._maker, self.frame
        metres = maker.tree.grid.metres
        longest = float(np.linalg.norm(metres, axis=0).max())
        diagonal = float(((metres @ np.array([[1.0, 1.0], [1.0, -1.0]])) ** 2).sum(axis=0).max())

        def split(level: int, x: Ints, y: Ints) -> NDArray[np.bool_]:
            if level + frame.subtexel_bits <= maker.k:
                # a quad is at least a subtexel wide
                return np.zeros(x.size, bool)
            distance = self.distance(level, x, y)
            quad = longest * 2.0**level / maker.n
            # with curvature a flat tile passes under the bent ground, as far as a chord of its diagonal does
            sag = frame.curvature_factor * diagonal * 4.0**level / 4
            return (quad * self._pixels > self._settings.pixels_per_quad * distance) | (
                sag * self._pixels > self._settings.tau * distance
            )

        return [
            TileKey(level, *place)
            for level, (x, y) in enumerate(self.select(split, restricted=True))
            for place in zip(x.tolist(), y.tolist(), strict=True)
        ]

    def details(self, keys: Sequence[TileKey]) -> Floats:
        """Continuous levels of detail at the nearest points of tiles.

        Also fully morphed, the mesh of the level of detail below is off by at most tau.
        """
        level, x, y = np.array(keys, np.int64).reshape(-1, 3).T
        distance = np.zeros(len(keys))
        for t in np.unique(level).tolist():
            at = level == t
            distance[at] = self.distance(t, x[at], y[at])
        return self.continuous(distance)

    def corner_morphs(self, tiles: Sequence[Tile], nearest: Floats, details: Ints) -> Floats:
        """(n, 4) morph factors at the corners of tiles, in the order of `Tile.corners`.

        `nearest`: continuous levels of detail, `details`: those of the meshes. All corners start to morph where the
        mesh is taken, and are done where the next coarser one takes its place; the farther ones are ahead.
        """
        level, x, y = np.array([tile.key for tile in tiles], np.int64).reshape(-1, 3, 1).swapaxes(0, 1)
        grid = self.tree.grid
        column = np.minimum(x + np.array([0, 1, 0, 1]) << level, grid.width - 1)
        row = np.minimum(y + np.array([0, 0, 1, 1]) << level, grid.height - 1)
        height = np.array([tile.corners for tile in tiles]).reshape(-1, 4)
        distance = self.distance_to(column.ravel(), row.ravel(), height.ravel())
        ahead = self.continuous(distance).reshape(-1, 4) - nearest[:, None]
        return np.clip((nearest - details)[:, None] * (1 + ahead), 0.0, 1.0)

    def continuous(self, distance: Floats) -> Floats:
        """Logarithm of half the error (metres of the data) that tau allows at distances (Houska 2019, equation 2.4)."""
        allowed = self._settings.tau * distance / (2 * self._pixels * self.frame.exaggeration)
        return np.log2(np.clip(allowed, 2.0**FINEST, 2.0**COARSEST))


def above(key: TileKey, top: int) -> Iterator[TileKey]:
    """The tiles that a tile is a part of, the finest first."""
    for level in range(key.level + 1, top + 1):
        step = level - key.level
        yield TileKey(level, key.x >> step, key.y >> step)


def drawable(leaves: list[TileKey], resident: Collection[TileKey], top: int) -> list[TileKey]:
    """The leaves, or the nearest resident tiles above them, none below another."""
    if all(key in resident for key in leaves):
        return leaves
    found: set[TileKey] = set()
    for key in leaves:
        found.update(islice((other for other in (key, *above(key, top)) if other in resident), 1))
    return sorted(key for key in found if not any(other in found for other in above(key, top)))


def seams(keys: Sequence[TileKey], top: int) -> Iterator[tuple[int, int, list[int]]]:
    """(tile, side, tiles beyond) for all pairs of tiles that share a side, each once, as indices of `keys`.

    The tile is the coarser one; those beyond are in order along its side: west, east, north, south.
    """
    known = {key: i for i, key in enumerate(keys)}
    beyond: dict[tuple[int, int], list[int]] = {}
    for i, key in enumerate(keys):
        for side, (dx, dy) in enumerate(((-1, 0), (1, 0), (0, -1), (0, 1))):
            neighbour = TileKey(key.level, key.x + dx, key.y + dy)
            for other in (neighbour, *above(neighbour, top)):
                if other in known:
                    # of two alike the one in the east or south takes note
                    if other.level > key.level or side in (0, 2):
                        beyond.setdefault((known[other], side ^ 1), []).append(i)
                    break
    for (i, side), others in beyond.items():
        yield i, side, sorted(others, key=lambda other: keys[other].y if side < 2 else keys[other].x)


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
