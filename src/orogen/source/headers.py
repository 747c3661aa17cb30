"""Files, looked at before GDAL opens them: it crashes, hangs or shows garbage where some are damaged."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, field

from orogen.errors import SourceError
from orogen.source import hdf5, jpeg2000, vrt
from orogen.source.cutoff import check_pcidsk, check_sqlite, check_tiff
from orogen.source.hdf5 import check_hdf5
from orogen.source.jpeg2000 import check_jpeg2000
from orogen.source.names import local_file
from orogen.source.netcdf import check_netcdf
from orogen.source.vrt import Shown, check_vrt

HEAD = hdf5.STARTS[-1] + len(hdf5.SIGNATURE)
"""Bytes that tell what a file may be."""
CHECKS: dict[bytes, Callable[[str], None]] = {
    b"CDF": check_netcdf, hdf5.SIGNATURE: check_hdf5, jpeg2000.SIGNATURE: check_jpeg2000, b"II": check_tiff,
    b"MM": check_tiff, b"SQLite format 3\0": check_sqlite, b"PCIDSK": check_pcidsk,
}  # fmt: skip
"""What to ask of files with these bytes at their start: each looks closer for itself."""
Identity = tuple[int, int]
"""Device and number of a file: the same by whatever path."""
INLINE: Identity = (-1, -1)
"""That of a VRT that is no file."""
NESTED = 32
"""VRTs within each other, at most: GDAL shows no more."""
READS = 100_000
"""Rasters below a band of a VRT that are believed, however often each is named."""


def check_headers(name: str) -> None:
    """SourceError where a file of this machine, one that a name of GDAL's stands for, or one that a VRT shows, would
    be read wrongly.
    """
    walk = _Walk()
    if name.lstrip().startswith(vrt.BEGIN.decode()):
        walk.text(name, "VRT", "", ())
    elif (path := local_file(name)) is not None and (status := _status(path)):
        walk.file(path, status, ())


def _status(path: str) -> os.stat_result | None:
    """What the system says of a file; None of a folder and of what is not there."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return None if stat.S_ISDIR(status.st_mode) else status


@dataclass
class _Walk:
    """A walk through the files that VRTs show."""

    reads: dict[Identity, int] = field(default_factory=dict)
    """How many rasters are read where a band of a file is read, itself counted, of the files seen."""

    def file(self, path: str, status: os.stat_result, above: tuple[Identity, ...]) -> int:
        """Check a file that is there; `above`: the VRTs that lead to it. Returns its reads."""
        if not stat.S_ISREG(status.st_mode):  # reading a pipe or a device would never end
            raise SourceError(f"{path}: expected a raster file, got a pipe or device; save it to a file first")
        own = status.st_dev, status.st_ino
        if own in above:
            raise SourceError(f"{path}: shows itself, expected a VRT of other rasters; make it anew (gdalbuildvrt)")
        if own not in self.reads:
            try:
                self.reads[own] = self._look(path, (*above, own))
            except OSError as error:
                raise SourceError(f"{path}: cannot be read: {error.strerror}; check the permissions") from error
        return self.reads[own]

    def _look(self, path: str, above: tuple[Identity, ...]) -> int:
        with open(path, "rb") as file:
            head = file.read(HEAD)
            if vrt.BEGIN in head[: vrt.HEAD]:
                text = (head + file.read()).decode("utf-8", "replace")
                return self.text(text, path, os.path.dirname(os.path.realpath(path)), above)
        for magic, check in CHECKS.items():
            if head.startswith(magic) or (magic == hdf5.SIGNATURE and magic in head):
                check(path)
        return 1

    def text(self, text: str, path: str, folder: str, above: tuple[Identity, ...]) -> int:
        """Check the text of a VRT at `path` and what it shows."""
        if len(above) > NESTED:
            raise SourceError(f"{path}: more than {NESTED} VRTs within each other; make one of the rasters in them")
        reads: dict[int, int] = {}
        for shown in check_vrt(text, path):
            reads[shown.band] = reads.get(shown.band, 1) + self._shown(shown, path, folder, above)
        most = max(reads.values(), default=1)
        if most > READS + 4 * len(self.reads):
            raise SourceError(
                f"{path}: shows {most} rasters, most of them again and again; make it anew of each once (gdalbuildvrt)"
            )
        return most

    def _shown(self, shown: Shown, path: str, folder: str, above: tuple[Identity, ...]) -> int:
        try:
            if shown.name.startswith(vrt.BEGIN.decode()):
                return self.text(shown.name, "a VRT within it", folder, (*above, INLINE))
            part = local_file(shown.name, folder if shown.relative else "")
            if part is None:
                return 1
            if (status := _status(part)) is None:
                if shown.warped and not os.path.isdir(part):  # GDAL does not name it
                    raise SourceError(f"{part}: no such file; check the path")
                return 1
            if shown.raw is None or not stat.S_ISREG(status.st_mode):
                return self.file(part, status, above)
            if status.st_size < shown.raw:
                raise SourceError(
                    f"{part}: {status.st_size} bytes of bare samples, expected at least {shown.raw}; it is cut off: "
                    "copy it anew from where it came"
                )
            return 1
        except SourceError as error:
            if len(above) > 1:
                raise  # the outermost VRT and what is wrong are enough
            raise SourceError(f"{path}: shows {error}") from error
