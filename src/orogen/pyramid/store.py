"""Pyramids on disk: Zarr v3, one group a level, sharded, with checksums; complete or not there at all."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orogen.grid import Grid
from orogen.keys import NODE_SIZE, level_shape
from orogen.source.rounding import Rounding
from orogen.source.stored import ATTRIBUTE, FORMAT, MARK, READING, StoredArrays, kvstore

if TYPE_CHECKING:
    import tensorstore as ts

__all__ = ["FORMAT", "Store"]

PART = ".__part"
"""End of the name of a file that is being written."""


class Store(StoredArrays):
    """The arrays of one pyramid in a folder, to be written too. Thread-safe."""

    def finish(self, grid: Grid, facts: dict[str, Any]) -> None:
        """Write the group's metadata, which marks the store as complete."""
        write_group(self.path, {**spatial(grid, 0), ATTRIBUTE: {"format": FORMAT, **facts}})

    def create(
        self,
        grid: Grid,
        level: int,
        name: str,
        shape: Sequence[int],
        dtype: str,
        shard: tuple[int, int],
        fill: Any,
        rounding: Rounding | None = None,
    ) -> ts.TensorStore:
        """A sharded array of a level, chunks of NODE_SIZE x NODE_SIZE; one that is there already is taken.

        rounding: how heights become the numbers that are stored; None: they are stored as they are.
        """
        import tensorstore as ts

        folder = self.path / str(level)
        tail = list(shape[2:])
        chunk = [NODE_SIZE, NODE_SIZE, *tail]
        shape_of_shard = [min(s, -(-n // NODE_SIZE) * NODE_SIZE) for s, n in zip(shard, shape, strict=False)] + tail
        attributes = {"grid_mapping": "spatial_ref", "coordinates": "spatial_ref", **spatial(grid, level)}
        if name == "height":
            attributes |= {"standard_name": "surface_altitude", "units": "m"}
        if rounding is not None:
            dtype, fill = rounding.dtype, rounding.nodata
            attributes |= {"scale_factor": rounding.step, "add_offset": 0.0, "missing_value": fill}
        metadata = {
            "shape": list(shape),
            "data_type": dtype,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": shape_of_shard}},
            "codecs": [_sharding(chunk, np.dtype(dtype).itemsize)],
            "fill_value": fill,
            "dimension_names": ["y", "x", "band"][: len(shape)],
            "attributes": attributes,
        }
        write_group(folder, {})
        _spatial_ref(folder / "spatial_ref", grid, level)
        spec = {"driver": "zarr3", "kvstore": kvstore(folder / name), "metadata": metadata, **READING}
        array = ts.open(spec, open=True, create=True, context=self._context).result()
        self._open[level, name] = array, rounding
        return array

    @cached_property
    def _voids(self) -> dict[tuple[int, str], bytes]:
        return {}

    def write_void(self, level: int, name: str, rows: slice, cols: slice, value: NDArray[Any]) -> None:
        """Store one value, of shape (1, 1), in a window of whole shards; all but the first are copies of its bytes."""
        array = self.array(level, name)
        height, width = (int(n) for n in (array.chunk_layout.write_chunk.shape or ())[:2])  # type: ignore[arg-type]
        for row in range(rows.start, rows.stop, height):
            for col in range(cols.start, cols.stop, width):
                shape = min(rows.stop - row, height), min(cols.stop - col, width)
                shard = self.path / str(level) / name / "c" / str(row // height) / str(col // width)
                content = self._voids.get((level, name)) if shape == (height, width) else None
                if content is not None:
                    shard.parent.mkdir(parents=True, exist_ok=True)
                    write_whole(shard, content)
                    continue
                array[row : row + shape[0], col : col + shape[1]].write(np.broadcast_to(value, shape)).result()
                if shape == (height, width):
                    self._voids[level, name] = shard.read_bytes()

    def write_bounds(self, level: int, bounds: NDArray[np.float32]) -> None:
        """Store the (node rows, node columns, 3) bounds of a level."""
        attributes = {"fields": ["minimum", "maximum", "error"], "units": "m"}
        self.write_table(level, "bounds", bounds, ["node_y", "node_x", "bound"], attributes)

    def write_table(
        self, level: int, name: str, values: NDArray[Any], dimensions: list[str], attributes: dict[str, Any]
    ) -> None:
        """Store a small array of a level as one chunk, in place of what is there."""
        import tensorstore as ts

        folder = self.path / str(level)
        write_group(folder, {})
        metadata = {
            "shape": list(values.shape),
            "data_type": str(values.dtype),
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(values.shape)}},
            "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
            "fill_value": "NaN",
            "dimension_names": dimensions,
            "attributes": attributes,
        }
        spec = {"driver": "zarr3", "kvstore": kvstore(folder / name), "metadata": metadata, **READING}
        ts.open(spec, open=True, create=True, context=self._context).result().write(values).result()


def _sharding(chunk: list[int], size: int) -> dict[str, Any]:
    blosc = {
        "cname": "zstd",
        "clevel": 1,
        "shuffle": "shuffle" if size > 1 else "noshuffle",
        "typesize": size,
        "blocksize": 0,
    }
    return {
        "name": "sharding_indexed",
        "configuration": {
            "chunk_shape": chunk,
            "codecs": [
                {"name": "bytes", "configuration": {"endian": "little"}},
                {"name": "blosc", "configuration": blosc},
                {"name": "crc32c"},
            ],
            "index_codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
            "index_location": "end",
        },
    }


def transform(grid: Grid, level: int) -> tuple[float, ...]:
    """The geotransform of a level: its texels are 2**level as wide from the same upper left corner."""
    a, b, c, d, e, f = grid.transform
    n = 2.0**level
    return a * n, b * n, c, d * n, e * n, f


def spatial(grid: Grid, level: int) -> dict[str, Any]:
    """The attributes of the geo-proj and spatial conventions."""
    attributes: dict[str, Any] = {
        "spatial:dimensions": ["y", "x"],
        "spatial:transform": list(transform(grid, level)),
        "spatial:shape": list(level_shape(grid.shape, level)),
    }
    if grid.crs is not None:
        is_code = grid.crs.partition(":")[0].isalpha() and "[" not in grid.crs
        attributes["proj:code" if is_code else "proj:wkt2"] = grid.crs if is_code else _wkt(grid.crs)
    return attributes


def _wkt(crs: str) -> str:
    from orogen.source.scale import parse_crs

    return parse_crs(crs).to_wkt()


def write_group(folder: Path, attributes: dict[str, Any]) -> None:
    """Write the metadata of a group."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"zarr_format": 3, "node_type": "group", "attributes": attributes}, indent=1)
    write_whole(folder / MARK, text.encode())


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is never seen in part, and that takes the place of another without touching its content."""
    part = path.with_name(f"{path.name}{PART}")
    part.write_bytes(content)
    os.replace(part, path)


def _spatial_ref(folder: Path, grid: Grid, level: int) -> None:
    """The scalar variable of the CF conventions that holds the CRS and the geotransform."""
    a, b, c, d, e, f = transform(grid, level)
    attributes: dict[str, Any] = {"GeoTransform": " ".join(repr(v) for v in (c, a, b, f, d, e))}
    if grid.crs is not None:
        attributes |= {"crs_wkt": _wkt(grid.crs), "spatial_ref": _wkt(grid.crs)}
    metadata = {
        "zarr_format": 3,
        "node_type": "array",
        "shape": [],
        "data_type": "int64",
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": []}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0,
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}],
        "attributes": attributes,
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / MARK, json.dumps(metadata, indent=1).encode())
