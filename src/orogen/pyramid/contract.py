"""Heights or colours by level and window."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import StoreError
from orogen.grid import Grid
from orogen.keys import NODE_SIZE, level_count, level_shape
from orogen.pyramid.estimate import Estimate, estimated_level
from orogen.pyramid.store import Store
from orogen.source.contract import Kind, Levels, Source


class Pyramid:
    """The levels of a source. Made by `open_pyramid`; safe to use from several threads at once."""

    def __init__(self, source: Source) -> None:
        self.source: Source = source
        self.grid: Grid = source.grid
        self.kind: Kind = source.kind
        self.level_count: int = level_count(source.grid.shape)
        self.estimate_level: int = estimated_level(source.grid.shape)
        """The finest level of `read_estimate`."""
        self._store: Store | None = None
        self._levels: Levels | None = None
        self._facts: dict[str, Any] = {}
        self._bounds: list[NDArray[np.float32]] = []
        self._done = threading.Event()
        self._failure: BaseException | None = None
        self._closing: list[Callable[[], object]] = []
        self._estimating = threading.Lock()
        self._progress: float | None = None

    @property
    def progress(self) -> float | None:
        """The part (0 to 1) that is done of a build that goes on; None where none does."""
        return None if self._done.is_set() else self._progress

    @property
    def built(self) -> bool:
        """Whether all levels and bounds have been built."""
        return self._store is not None

    @property
    def exact(self) -> bool:
        """Whether bounds of nodes are there and certain: the pyramid is built, or the source makes its own levels.

        Else levels come from the overviews of a file, or are not there yet.
        """
        return self.built or (self._levels is not None and self._levels.exact)

    @property
    def chunked(self) -> bool:
        """Whether a window costs as much to read as all chunks that it touches, so that chunks are worth keeping."""
        return self.built or self._levels is None or self._levels.chunked

    @property
    def covered(self) -> bool:
        """Whether every sample is valid: certain once built, before then what the source promises."""
        return bool(self._facts.get("covered", self.source.covered))

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest height (m) of level 0: exact once built, else estimated from a decimated read.

        Where the source makes its own levels no sample lies outside.
        """
        if self.kind != "height":
            raise StoreError("colours have no range of heights")
        if self._store is not None:
            return self._facts["minimum"], self._facts["maximum"]
        if self._levels is not None and self._levels.exact:
            return self._levels.height_range
        return self._estimate.range or (0.0, 0.0)

    def available(self, level: int) -> bool:
        """Whether `level` can be read now: as it was built, or from the source's own levels."""
        known = self.built or self._levels is not None or (level == 0 and self.source.direct)
        return 0 <= level < self.level_count and known

    def read(self, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """The samples of a window inside `keys.level_shape(grid.shape, level)`.

        Heights: float32 metres (rows, columns), NaN = nodata. Colours: uint8 (rows, columns, 4) as in `Source.read`.
        Raises StoreError where the level is not built yet or damaged, SourceError where the source cannot be read.
        """
        store = self._checked(level, rows, cols)
        if level == 0 and self.source.direct:
            return self.source.read(rows, cols)
        if store is not None:
            return store.read(level, self.kind, rows, cols)
        return self._own(level).read(level, rows, cols)

    def read_coverage(self, level: int, rows: slice, cols: slice) -> NDArray[np.uint8]:
        """The valid part (0 to 255) of each sample of a window of heights: uint8 (rows, columns)."""
        store = self._checked(level, rows, cols)
        if self.covered:
            return np.full((rows.stop - rows.start, cols.stop - cols.start), 255, np.uint8)
        if level == 0:
            return np.where(np.isnan(self.read(0, rows, cols)), np.uint8(0), np.uint8(255))
        if store is not None:
            return store.read(level, "coverage", rows, cols)
        return self._own(level).read_coverage(level, rows, cols)

    def read_estimate(self, level: int, rows: slice, cols: slice) -> NDArray[Any]:
        """Like `read`, at once, from a decimated read of the source: for levels not finer than `estimate_level`."""
        self._checked(level, rows, cols)
        if level < self.estimate_level:
            raise StoreError(f"expected a level of at least {self.estimate_level} to estimate, got {level}")
        return self._estimate.read(level, rows, cols)

    def node_bounds(
        self, level: int, rows: slice | None = None, cols: slice | None = None
    ) -> NDArray[np.float32] | None:
        """(node rows, node columns, 3) of a level of heights: minimum, maximum, error (m); None while unknown.

        rows, cols: a window of nodes; None: all of the level's. Minimum and maximum are those of all valid samples of
        level 0 under the node, NaN where there is none. No point of the level's surface in the node (bilinear between
        texel centres) is further from the level-0 surface than error; next to nodata that holds where both are made of
        valid samples. A source that makes its own levels may give wider bounds.
        """
        if self._bounds:
            return self._bounds[level][rows or slice(None), cols or slice(None)]
        if self._levels is None:
            return None
        height, width = level_shape(self.grid.shape, level)
        rows, cols = rows or slice(0, -(-height // NODE_SIZE)), cols or slice(0, -(-width // NODE_SIZE))
        return self._levels.node_bounds(level, rows, cols)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for the end of a build in the background; whether the pyramid is built. Raises what the build raised."""
        self._done.wait(timeout)
        if self._failure is not None:
            raise self._failure
        return self.built

    def _own(self, level: int) -> Levels:
        if self._levels is None:
            raise StoreError(f"{self.source.name}: level {level} is not built yet; ask `available` or `read_estimate`")
        return self._levels

    def close(self) -> None:
        """Stop a build in the background and release the store and the source."""
        for action in reversed(self._closing):
            action()
        self._closing.clear()
        self.source.close()

    def __enter__(self) -> Pyramid:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @cached_property
    def _estimated(self) -> Estimate:
        return Estimate(self.source)

    @property
    def _estimate(self) -> Estimate:
        with self._estimating:
            return self._estimated

    def _checked(self, level: int, rows: slice, cols: slice) -> Store | None:
        if not 0 <= level < self.level_count:
            raise StoreError(f"expected a level of 0 to {self.level_count - 1}, got {level}")
        shape = level_shape(self.grid.shape, level)
        for axis, part, size in (("rows", rows, shape[0]), ("columns", cols, shape[1])):
            if part.step not in (None, 1) or not 0 <= part.start < part.stop <= size:
                raise StoreError(f"level {level}: expected {axis} within 0 to {size}, got {part.start} to {part.stop}")
        return self._store

    def _use_levels(self, levels: Levels) -> None:
        """Take levels that need no building."""
        self._levels = levels
        self._done.set()

    def _use(self, store: Store, facts: dict[str, Any]) -> None:
        """Take a complete store."""
        if self.kind == "height":
            everything = slice(None)
            self._bounds = [store.read(level, "bounds", everything, everything) for level in range(self.level_count)]
            nodes = -(-self.grid.height // NODE_SIZE), -(-self.grid.width // NODE_SIZE)
            if self._bounds[0].shape[:2] != nodes:
                raise StoreError(f"{store.path}: belongs to another raster; run `orogen cache clear` and open it again")
        self._facts = facts
        self._store = store
        self._done.set()
