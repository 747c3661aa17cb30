"""Raster files through GDAL: one handle for each reading thread, never a file written beside the data."""

from __future__ import annotations

import logging
import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SourceError

# GDAL takes 5 % of the machine's memory for its block cache unless told before its first read.
os.environ.setdefault("GDAL_CACHEMAX", "64")

import rasterio
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.enums import Resampling
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.vrt import WarpedVRT

# Each failed read is reported as one SourceError: GDAL's own log lines would repeat it.
logging.getLogger("rasterio._err").setLevel(logging.CRITICAL)
logging.getLogger("rasterio._env").setLevel(logging.CRITICAL)

GDAL_ERRORS = (RasterioError, CPLE_BaseError, OSError, ValueError)
"""What rasterio raises when it cannot open, read or transform."""
SLOW_DRIVERS = {"PNG", "JPEG", "GIF", "BMP"}
"""Formats without random access."""


@dataclass
class RasterFile:
    """A raster file, optionally warped to another CRS. Thread-safe."""

    path: str
    """Path, URL or GDAL name."""
    warp: str | None = None
    """CRS to warp to, or None."""
    source_crs: str | None = None
    """CRS of a file that names none; used in warping."""
    _idle: list[Any] = field(default_factory=list, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @contextmanager
    def handle(self) -> Iterator[Any]:
        """A dataset that this thread alone uses meanwhile; errors of GDAL become SourceError."""
        with self._lock:
            dataset = self._idle.pop() if self._idle else None
        try:
            if dataset is None:
                dataset = self._open()
            yield dataset
        except GDAL_ERRORS as error:
            if isinstance(error, SourceError):
                raise
            raise SourceError(f"{self.path}: cannot be read as a raster: {_cause(error)}") from error
        else:
            with self._lock:
                self._idle.append(dataset)

    def _open(self) -> Any:
        with warnings.catch_warnings(), rasterio.Env(GDAL_PAM_ENABLED="NO", GDAL_DISABLE_READDIR_ON_OPEN=None):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(self.path, sharing=False)
            if self.warp is None:
                return dataset
            return WarpedVRT(
                dataset,
                src_crs=CRS.from_user_input(self.source_crs) if self.source_crs else None,
                crs=CRS.from_user_input(self.warp),
                resampling=Resampling.bilinear,
                add_alpha=True,
            )

    def read(
        self, bands: int | list[int], rows: slice, cols: slice, shape: tuple[int, int] | None = None
    ) -> NDArray[Any]:
        """Bands of a window, (rows, columns) or (bands, rows, columns), decimated to `shape` where given."""
        with self.handle() as dataset:
            return dataset.read(bands, **_window(rows, cols, shape, bands))

    def alpha(self, rows: slice, cols: slice, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """(rows, columns): 0 where mask, alpha or nodata of the file say that there is no data, 255 where opaque."""
        with self.handle() as dataset:
            return dataset.dataset_mask(**_window(rows, cols, shape, 1))

    def close(self) -> None:
        """Close the idle handles."""
        with self._lock:
            handles, self._idle = self._idle, []
        for dataset in handles:
            dataset.close()


def open_raster(path: str | os.PathLike[str]) -> RasterFile:
    """A raster file that GDAL recognises; SourceError where it is missing or no raster."""
    text = os.fspath(path)
    if is_local(text):
        if not os.path.exists(text):
            raise SourceError(f"{text}: no such file; check the path")
        if os.path.isdir(text) and not os.listdir(text):
            raise SourceError(f"{text}: an empty folder, expected a raster file")
        text = os.path.abspath(text)
    file = RasterFile(text)
    with file.handle() as dataset:
        if dataset.count == 0:
            raise SourceError(f"{text}: holds no raster band; name one of its parts: {', '.join(dataset.subdatasets)}")
    return file


def is_local(path: str) -> bool:
    """Whether GDAL would take `path` for a file of this machine."""
    return not (path.startswith("/vsi") or "://" in path or (":" in path[2:] and not os.path.exists(path)))


def is_direct(dataset: Any) -> bool:
    """Whether 256 x 256 windows anywhere in a dataset are cheap: tiled, local, not a sequential format."""
    path = dataset.name
    if not is_local(path) and not path.startswith("/vsimem/"):
        return False
    if dataset.driver in SLOW_DRIVERS:
        return False
    if dataset.driver == "VRT":
        parts = [name for name in dataset.files if not name.endswith(".vrt")][:8]
        return bool(parts) and all(_part_is_direct(part) for part in parts)
    rows, cols = dataset.block_shapes[0]
    return rows <= 2048 and cols <= 2048 and cols < dataset.width


def _part_is_direct(path: str) -> bool:
    try:
        with RasterFile(path).handle() as dataset:
            return is_direct(dataset)
    except SourceError:
        return False


def file_stamp(dataset: Any) -> str:
    """Path, size and time of change of every file that a dataset is made of."""
    stamps = []
    for name in dataset.files or [dataset.name]:
        try:
            status = Path(name).stat()
            stamps.append(f"{os.path.abspath(name)}|{status.st_size}|{status.st_mtime_ns}")
        except OSError:
            stamps.append(name)
    return "\n".join(stamps)


def _window(rows: slice, cols: slice, shape: tuple[int, int] | None, bands: int | list[int]) -> dict[str, Any]:
    window: dict[str, Any] = {"window": ((rows.start, rows.stop), (cols.start, cols.stop))}
    if shape is not None:
        window["out_shape"] = shape if isinstance(bands, int) else (len(bands), *shape)
    return window


def _cause(error: BaseException) -> str:
    """The innermost message of GDAL."""
    while error.__cause__ is not None:
        error = error.__cause__
    return str(getattr(error, "errmsg", None) or error)
