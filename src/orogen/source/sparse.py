"""Parts of a raster that are nodata for certain, without reading them."""

from __future__ import annotations

import math

from orogen.errors import SourceError
from orogen.source.contract import Source
from orogen.source.heights import FileSamples, HeightSource


def certainly_empty(source: Source, rows: slice, cols: slice) -> bool:
    """Whether a window holds nodata alone because the file has no block there, as sparse GeoTIFFs do."""
    if not isinstance(source, HeightSource) or not isinstance(source.samples, FileSamples):
        return False
    samples = source.samples
    if samples.masked or samples.packed or samples.file.warp is not None:
        return False
    block_rows, block_cols = samples.block
    try:
        with samples.file.handle() as dataset:
            fill = dataset.nodata
            if dataset.driver not in ("GTiff", "COG") or fill is None:
                return False
            if not (math.isnan(fill) or fill == source.values.nodata):
                return False
            return all(
                dataset.get_tag_item(f"BLOCK_OFFSET_{x}_{y}", "TIFF", bidx=1) is None
                for y in range(rows.start // block_rows, -(-rows.stop // block_rows))
                for x in range(cols.start // block_cols, -(-cols.stop // block_cols))
            )
    except SourceError:
        return False
