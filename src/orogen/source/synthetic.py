"""The built-in terrain: made once, kept in the cache folder, the same on every machine up to rounding."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.source import cache
from orogen.source.contract import Source
from orogen.source.heights import ArraySamples, HeightSource
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.values import Values

log = logging.getLogger("orogen")

VERSION = 1
"""Changes with the heights that `eroded` makes."""
LARGEST = 8193
"""Rows and columns that may be asked for: the terrain is made in memory."""


def recognises(data: Any) -> bool:
    """Whether the synthetic terrain is asked for."""
    return isinstance(data, str) and data == "synthetic"


def open_height(data: Any, options: HeightOptions) -> Source:
    """The synthetic terrain; no option changes it."""
    return synthetic()


def open_colour(data: Any, heights: Source, options: ColourOptions) -> Source:
    """There is no such image."""
    raise SourceError("synthetic: holds heights only, expected an image; leave color= out to colour it by height")


def synthetic(size: int = 2049, seed: int = 7, spacing: float = 30.0) -> Source:
    """An eroded mountain range of size x size samples, `spacing` metres apart; no CRS, x and y in metres from 0.

    Making it takes a few seconds (2049 x 2049 on one core); later it is read from the cache folder.
    """
    if not 2 <= size <= LARGEST:
        raise SourceError(f"synthetic: expected a size of 2 to {LARGEST}, got {size}")
    if not spacing > 0:
        raise SourceError(f"synthetic: expected a spacing above 0 m, got {spacing:g}")
    key = f"synthetic-{VERSION}-{size}-{seed}-{spacing:g}"
    heights = _kept(cache.cache_dir() / key, size, seed, spacing)
    grid = Grid(size, size, (spacing, 0.0, 0.0, 0.0, -spacing, spacing * size))
    return HeightSource(
        grid=grid, name="synthetic", dtype="float32", fingerprint=key, covered=True,
        samples=ArraySamples(heights), values=Values(),
    )  # fmt: skip


def _kept(entry: Path, size: int, seed: int, spacing: float) -> NDArray[np.float32]:
    """The heights of a cache entry, made where it is missing; without a cache they are made each time."""
    file = entry / "heights.npy"
    mark = cache.hold(entry)
    if mark is not None:
        with mark:
            try:
                heights: NDArray[np.float32] = np.load(file)
                if heights.shape == (size, size) and heights.dtype == np.float32:
                    return heights
            except (OSError, ValueError, EOFError) as error:
                log.warning("%s: damaged (%s), made anew", file, error)
        cache.remove(entry)
    from orogen.source.erosion import eroded

    heights = eroded(size, seed, spacing)
    try:
        with cache.building(entry) as draft:
            np.save(draft / os.path.basename(file), heights)
    except OSError as error:
        log.warning("%s: cannot be kept (%s)", entry, error)
    return heights
