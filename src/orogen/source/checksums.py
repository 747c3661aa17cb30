"""The checksums of deflate blocks in TIFF files, which GDAL does not compare."""

from __future__ import annotations

import zlib

import rasterio
from rasterio.enums import Compression

from orogen.errors import SourceError
from orogen.source.raster import RasterFile


def check_blocks(file: RasterFile) -> None:
    """SourceError where a block of the first band of a deflate TIFF on this machine is not what was written.

    GDAL leaves samples unset where such a block ends early, and shows whatever a flipped bit makes of it. Takes as
    long as decompressing the raster: meant for those that are read whole.
    """
    # a handle of its own: asked for a block that it cannot find, GDAL takes it for an empty one from then on
    with RasterFile(file.path, file.content).handle() as dataset, rasterio.Env():
        if dataset.driver != "GTiff" or dataset.compression != Compression.deflate:
            return
        rows, cols = dataset.block_shapes[0]
        places = [(x, y) for y in range(-(-dataset.height // rows)) for x in range(-(-dataset.width // cols))]
        blocks = []
        for x, y in places:
            start = dataset.get_tag_item(f"BLOCK_OFFSET_{x}_{y}", "TIFF", bidx=1)
            size = dataset.get_tag_item(f"BLOCK_SIZE_{x}_{y}", "TIFF", bidx=1)
            if start is not None and size is not None:  # else it was never written
                blocks.append((x, y, int(start), int(size)))
    try:
        with open(file.path, "rb") as data:
            for x, y, start, size in blocks:
                data.seek(start)
                try:
                    _drain(data.read(size))
                except zlib.error as error:
                    raise SourceError(
                        f"{file.path}: cannot be read as a raster: its block in column {x}, row {y} of blocks is "
                        f"damaged ({error}); copy the file anew from where it came"
                    ) from error
    except OSError:  # inside an archive or in memory
        return


def _drain(data: bytes) -> None:
    """Decompress, a piece at a time, as a small block may hold a huge one; zlib.error where it is damaged."""
    stream = zlib.decompressobj()
    stream.decompress(data, 1 << 20)
    while stream.unconsumed_tail:
        stream.decompress(stream.unconsumed_tail, 1 << 20)
    if not stream.eof:
        raise zlib.error("it is cut off")
