"""Damage inside blocks that GDAL does not notice, such as checksums of deflate blocks in TIFF files."""

from __future__ import annotations

import os
import zlib

import numpy as np
import rasterio
from rasterio.enums import Compression, Interleaving
from rasterio.io import DatasetReader

from orogen.errors import SourceError
from orogen.source.imagine import check_imagine
from orogen.source.raster import RasterFile

SHOWN = 4
"""Times the samples of a VRT that are checked in the files that it shows, at most."""


def check_blocks(file: RasterFile) -> None:
    """SourceError where a block of a deflate TIFF's first band on this machine is not what was written, or an IMAGINE
    file's is short; of a VRT, in the files that it shows.

    GDAL leaves samples unset where such a block ends early, and shows whatever a flipped bit makes of it. Takes as
    long as decompressing the raster: meant for those that are read whole. Of files that a VRT shows little of only the
    first are checked.
    """
    with file.handle() as dataset:
        parts = [name for name in dataset.files if name != file.path] if dataset.driver == "VRT" else []
        left = SHOWN * dataset.width * dataset.height
    _check_file(file)
    for part in map(RasterFile, filter(os.path.isfile, parts)):
        try:
            with part.handle() as dataset:
                left -= dataset.width * dataset.height
        except SourceError:
            continue  # bare samples, or what lies beside a raster
        finally:
            part.close()
        if left < 0:
            return
        try:
            _check_file(part)
        except SourceError as error:
            raise SourceError(f"{file.path}: shows {error}") from error


def _check_file(file: RasterFile) -> None:
    if not os.path.isfile(file.path):
        return  # on a server, inside an archive or in memory
    check_imagine(file.path)
    # a handle of its own: asked for a block that it cannot find, GDAL takes it for an empty one from then on
    with RasterFile(file.path, file.content).handle() as dataset, rasterio.Env():
        if dataset.driver != "GTiff" or dataset.compression != Compression.deflate:
            return
        rows, cols = dataset.block_shapes[0]
        row_size = _row_size(dataset, cols)
        tiled = cols < dataset.width
        places = [(x, y) for y in range(-(-dataset.height // rows)) for x in range(-(-dataset.width // cols))]
        blocks = []
        for x, y in places:
            start = dataset.get_tag_item(f"BLOCK_OFFSET_{x}_{y}", "TIFF", bidx=1)
            size = dataset.get_tag_item(f"BLOCK_SIZE_{x}_{y}", "TIFF", bidx=1)
            if start is not None and size is not None:  # else it was never written
                height = rows if tiled else min(rows, dataset.height - y * rows)
                blocks.append((x, y, int(start), int(size), height * row_size))
    try:
        with open(file.path, "rb") as data:
            for x, y, start, size, wanted in blocks:
                data.seek(start)
                try:
                    found = _drained(data.read(size))
                    # some writers fill up the last strip
                    if found not in (wanted, rows * row_size):
                        raise zlib.error(f"it holds {found} bytes in place of {wanted}")
                except zlib.error as error:
                    raise SourceError(
                        f"{file.path}: cannot be read as a raster: its block in column {x}, row {y} of blocks is "
                        f"damaged ({error}); copy the file anew from where it came"
                    ) from error
    except OSError as error:
        raise SourceError(f"{file.path}: cannot be read: {error}; check the disk and the permissions") from error


def _row_size(dataset: DatasetReader, cols: int) -> int:
    """Bytes of a row of a block that is so many samples wide."""
    bits = dataset.tags(1, ns="IMAGE_STRUCTURE").get("NBITS")
    samples = dataset.count if dataset.interleaving == Interleaving.pixel else 1
    size = int(bits) if bits else 8 * np.dtype(dataset.dtypes[0]).itemsize
    return -(-cols * samples * size // 8)


def _drained(data: bytes) -> int:
    """How many bytes a block holds, of which only a piece is kept at a time; zlib.error where it is damaged."""
    stream = zlib.decompressobj()
    count = len(stream.decompress(data, 1 << 20))
    while stream.unconsumed_tail:
        count += len(stream.decompress(stream.unconsumed_tail, 1 << 20))
    if not stream.eof:
        raise zlib.error("it is cut off")
    return count
