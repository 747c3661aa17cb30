"""Raster files through GDAL: one handle for each reading thread, never a file written beside the data."""

from __future__ import annotations

import math
import os
import stat
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import Interleaving, Resampling
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetWriter, MemoryFile
from rasterio.vrt import WarpedVRT

from orogen.errors import SourceError
from orogen.source.cutoff import check_length
from orogen.source.gdal import GDAL_ERRORS, cause, damaged_part, strictly
from orogen.source.headers import check_headers
from orogen.source.hints import hint
from orogen.source.names import is_local
from orogen.source.objects import is_remote, shown

SEQUENTIAL = {"PNG", "JPEG", "GIF"}
"""Formats that can only be read from their start."""
SLOW_DRIVERS = {*SEQUENTIAL, "BMP"}
"""Formats without quick access to small windows."""
LARGEST_BLOCK = 64 << 20
"""Bytes of a decoded block that are read whatever the size of the file."""
PACKED = 32
"""Bytes of a decoded block, beyond that, for each byte of the file."""
NETWORK = ("/vsicurl", "/vsis3", "/vsigs", "/vsiaz", "/vsiadls", "/vsioss", "/vsiswift", "/vsihdfs", "/vsiwebhdfs")
"""How GDAL's names of remote files begin."""
REMOTE_BLOCK = 128 << 20
"""Bytes of a decoded block of a file whose size is not known."""
NO_INTEGER = -3e38
"""A value that samples of no integer type have."""


@dataclass(frozen=True)
class Warp:
    """How a raster is warped to another CRS."""

    crs: str
    """CRS to warp to."""
    source_crs: str | None = None
    """CRS of a raster that names none."""
    heights: bool = False
    """Whether samples are heights: floating point, NaN = nodata; else pixels with an alpha band."""
    nodata: float | None = None
    """Stored value of heights that means nodata."""


@dataclass
class RasterFile:
    """A raster file, optionally warped to another CRS. Thread-safe."""

    path: str
    """Path, URL or GDAL name; what messages call it."""
    content: str | None = None
    """What GDAL opens instead of the path: the text of a VRT."""
    warp: Warp | None = None
    """How it is warped, or None."""
    overview: int | None = None
    """Which of its overviews stands for it, from 0, the finest; None: itself."""
    keep: Any = field(default=None, repr=False)
    """A dataset of the user's that must not vanish while this one is read, as those in memory would."""
    _idle: list[Any] = field(default_factory=list, init=False, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False, repr=False)
    _version: tuple[int, int] | None = field(default=None, init=False, repr=False)
    """What `version` said of a local file when it was first opened."""

    @contextmanager
    def handle(self) -> Iterator[Any]:
        """A dataset that this thread alone uses meanwhile; errors of GDAL become SourceError, and so does a change of
        the file since it was first opened: blocks of two versions would be mixed.
        """
        with self._lock:
            dataset = self._idle.pop() if self._idle else None
            self._version = self._version or version(self.path)
        try:
            if dataset is None:
                dataset = self._open()
            yield dataset
        except GDAL_ERRORS as error:
            raise self._stale() or self.failure(error) from error
        else:
            if stale := self._stale():
                dataset.close()
                raise stale
            with self._lock:
                self._idle.append(dataset)

    def _open(self, opener: Any = None) -> Any:
        """A new dataset, of a file that `opener` opens where it is given."""
        name = self.content or self.path
        # asking a server for each file that might lie beside the data costs a round trip each
        siblings = "EMPTY_DIR" if opener or name.startswith(NETWORK) else None
        with warnings.catch_warnings(), rasterio.Env(GDAL_PAM_ENABLED="NO", GDAL_DISABLE_READDIR_ON_OPEN=siblings):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            level = {} if self.overview is None else {"overview_level": self.overview}
            dataset = rasterio.open(name, sharing=False, opener=opener, **level)
            return dataset if self.warp is None else _warped(dataset, self.warp)

    def _stale(self) -> SourceError | None:
        """What to raise where a local file is another one than at first; one that is gone is still open here."""
        if self._version is None or version(self.path) in (None, self._version):
            return None
        return SourceError(f"{self.path}: changed on disk since it was opened; open it again")

    def failure(self, error: BaseException) -> SourceError:
        """What to raise for an error of GDAL's."""
        if isinstance(error, SourceError):
            return error
        part = damaged_part(error)
        where = f"{part}: " if part and part != os.path.basename(self.path) else ""
        return SourceError(
            f"{self.path}: cannot be read as a raster: {where}{cause(error).rstrip('.')}{hint(self.path)}"
        )

    def overviews(self) -> list[tuple[RasterFile, tuple[int, int], tuple[int, int]]]:
        """The overviews in the file or beside it, the finest first, with their shapes and blocks; none if warped."""
        if self.warp is not None or self.overview is not None:
            return []
        with self.handle() as dataset:
            count = len(dataset.overviews(1))
        found = []
        for number in range(count):
            file = replace(self, overview=number)
            with file.handle() as dataset:
                check_block(dataset, self.path)
                found.append((file, dataset.shape, dataset.block_shapes[0]))
        return found

    def stamp(self, dataset: Any) -> str | None:
        """What changes with the file; None where that cannot be known."""
        return file_stamp(dataset)

    def read(
        self, bands: int | list[int], rows: slice, cols: slice, shape: tuple[int, int] | None = None
    ) -> NDArray[Any]:
        """Bands of a window, (rows, columns) or (bands, rows, columns), decimated to `shape` where given."""
        with self.handle() as dataset, strictly(dataset.driver):
            return dataset.read(bands, **_window(rows, cols, shape, bands))

    def alpha(self, rows: slice, cols: slice, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """(rows, columns): 0 where mask, alpha or nodata of the file say that there is no data, 255 where opaque."""
        with self.handle() as dataset, strictly(dataset.driver):
            return dataset.dataset_mask(**_window(rows, cols, shape, 1))

    def mask(self, rows: slice, cols: slice, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """(rows, columns): 0 where the first band's mask or alpha says that there is no data."""
        with self.handle() as dataset, strictly(dataset.driver):
            return dataset.read_masks(1, **_window(rows, cols, shape, 1))

    def close(self) -> None:
        """Close the idle handles."""
        with self._lock:
            handles, self._idle = self._idle, []
        for dataset in handles:
            dataset.close()


def is_dataset(data: Any) -> bool:
    """Whether `data` is a dataset or file of rasterio's."""
    return isinstance(data, rasterio.DatasetReader | DatasetWriter | WarpedVRT | MemoryFile)


def open_raster(data: Any) -> RasterFile:
    """A raster that GDAL recognises, by its path or open dataset; SourceError where it is missing or no raster."""
    file = _of_dataset(data) if is_dataset(data) else _of_name(os.fspath(data))
    with file.handle() as dataset:
        if dataset.count == 0:
            parts = ", ".join(dataset.subdatasets[:8]) or "none"
            raise SourceError(f"{file.path}: holds no raster band of its own; name one of its parts: {parts}")
        check_block(dataset, file.path)
        check_length(dataset)
    return file


def _of_name(name: str) -> RasterFile:
    """The file of a path, of a name that GDAL knows, or of a URL."""
    if not is_remote(name):
        return RasterFile(_checked(name))
    from orogen.source.remote import RemoteRaster

    return RemoteRaster(shown(name), content=name)


def _of_dataset(data: Any) -> RasterFile:
    """An open dataset is opened anew for each thread, a virtual one by its description."""
    if data.closed:
        raise SourceError(f"{data.name}: the dataset is closed; expected an open one or a path")
    if isinstance(data, DatasetWriter):
        raise SourceError(f"{data.name}: the dataset is open for writing; close it and give its path")
    if not isinstance(data, WarpedVRT):
        file = _of_name(str(data.name))
        file.keep = data
        return file
    with MemoryFile(ext=".vrt") as description:
        rasterio.shutil.copy(data, description.name, driver="VRT")
        return RasterFile(data.name, content=description.read().decode(), keep=data)


def _checked(text: str) -> str:
    """The absolute path of a local file; SourceError where there is none."""
    if not text or "\0" in text:
        raise SourceError(f"{text!r}: expected the path of a raster")
    if not is_local(text):
        check_headers(text)
        return text
    if not os.path.exists(text):
        what = "a link that leads to no file" if os.path.islink(text) else "no such file"
        raise SourceError(f"{text}: {what}; check the path")
    if os.path.isdir(text):
        if not os.listdir(text):
            raise SourceError(f"{text}: an empty folder, expected a raster file")
    elif not os.path.isfile(text):  # reading a pipe or a device would never end
        raise SourceError(f"{text}: expected a raster file, got a pipe or device; save it to a file first")
    elif os.path.getsize(text) == 0:
        raise SourceError(f"{text}: an empty file of 0 bytes, expected a raster")
    else:
        check_headers(text)
    return os.path.abspath(text)


def check_block(dataset: Any, name: str) -> None:
    """SourceError where the smallest part that can be read would not fit into memory, as in forged headers."""
    rows, cols = dataset.block_shapes[0]
    together = dataset.count if dataset.interleaving == Interleaving.pixel else 1
    size = rows * cols * np.dtype(dataset.dtypes[0].removeprefix("complex_")).itemsize * together
    try:
        limit = max(LARGEST_BLOCK, PACKED * sum(os.path.getsize(part) for part in dataset.files))
    except OSError:
        limit = REMOTE_BLOCK
    if size > limit:
        raise SourceError(
            f"{name}: its blocks of {cols} x {rows} samples take {size / 2**20:.0f} MB each, expected at most "
            f"{limit / 2**20:.0f} MB; rewrite it in tiles (gdal_translate -co TILED=YES)"
        )


def _warped(dataset: Any, warp: Warp) -> Any:
    """A dataset warped by GDAL, bilinearly and exactly."""
    settings: dict[str, Any] = {"add_alpha": True}
    if warp.heights:
        wide = np.dtype(dataset.dtypes[0]).itemsize > 2 and dataset.dtypes[0] != "float32"
        # nodata must be named for the places outside to become nodata: NaN, or a value that no integer has
        none = math.nan if np.dtype(dataset.dtypes[0]).kind == "f" else NO_INTEGER
        nodata = none if warp.nodata is None else warp.nodata
        # without the scales GDAL would smooth along an axis that becomes coarser: samples lie on the true surface
        settings = {"dtype": "float64" if wide else "float32", "src_nodata": nodata, "nodata": math.nan}
        settings |= {"XSCALE": 1, "YSCALE": 1}
    return WarpedVRT(
        dataset,
        src_crs=CRS.from_user_input(warp.source_crs) if warp.source_crs else None,
        crs=CRS.from_user_input(warp.crs),
        resampling=Resampling.bilinear,
        tolerance=0.0,
        **settings,
    )


def is_direct(dataset: Any) -> bool:
    """Whether 256 x 256 windows anywhere in a dataset are cheap: tiled, local, not a sequential format."""
    path = dataset.name
    if not is_local(path) and not path.startswith("/vsimem/"):
        return False
    if dataset.driver in SLOW_DRIVERS:
        return False
    if dataset.driver == "VRT":
        parts = [name for name in dataset.files if name != path and not name.endswith(".vrt")][:8]
        return bool(parts) and all(_part_is_direct(part) for part in parts)
    rows, cols = dataset.block_shapes[0]
    return rows <= 2048 and cols <= 2048 and cols < dataset.width


def is_sequential(dataset: Any) -> bool:
    """Whether a dataset can only be read from its start."""
    return dataset.driver in SEQUENTIAL or dataset.name.startswith(("/vsigzip", "/vsizip", "/vsitar", "zip:", "tar:"))


def _part_is_direct(path: str) -> bool:
    try:
        with RasterFile(path).handle() as dataset:
            return dataset.count > 0 and is_direct(dataset)
    except SourceError:
        return False


def version(path: str) -> tuple[int, int] | None:
    """Size and time of change (ns) of a local file; None of what is none."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return (status.st_size, status.st_mtime_ns) if stat.S_ISREG(status.st_mode) else None


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
