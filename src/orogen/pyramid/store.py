"""Pyramids on disk: Zarr v3, one group a level, sharded, with checksums; complete or not there at all."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import StoreError
from orogen.grid import Grid
from orogen.keys import NODE_SIZE, level_shape

if TYPE_CHECKING:
    import tensorstore as ts

FORMAT = 1
"""Version of the layout and of the values; part of the key of every store."""
ATTRIBUTE = "orogen"


@dataclass(frozen=True)
class Store:
    """The arrays of one pyramid in a folder. Thread-safe."""

    path: Path

    @cached_property
    def _context(self) -> ts.Context:
        import tensorstore as ts

        # a little cache for shard indices; decoded nodes are kept by the streaming room
        return ts.Context({"cache_pool": {"total_bytes_limit": 4_000_000}, "data_copy_concurrency": {"limit": 2}})

    @cached_property
    def _open(self) -> dict[tuple[int, str], ts.TensorStore]:
        return {}

    def array(self, level: int, name: str) -> ts.TensorStore:
        """An array of a level: 'height', 'colour', 'coverage' or 'bounds'."""
        import tensorstore as ts

        found = self._open.get((level, name))
        if found is None:
            spec = {"driver": "zarr3", "kvstore": _kvstore(self.path / str(level) / name), **READING}
            try:
                found = ts.open(spec, open=True, context=self._context).result()
            except (ValueError, OSError) as error:
                raise self.damaged(level, error) from error
            self._open[level, name] = found
        return found

    def read(self, level: int, name: str, rows: slice, cols: slice) -> NDArray[Any]:
        """A window of an array; StoreError where a part is missing or damaged."""
        array = self.array(level, name)
        try:
            return array[rows, cols].read(order="C").result()
        except (ValueError, OSError) as error:
            raise self.damaged(level, error) from error

    def damaged(self, level: int, error: Exception) -> StoreError:
        """What to raise when reading fails."""
        reason = str(error).split(" [")[0]
        return StoreError(
            f"{self.path}: level {level} is damaged or incomplete ({reason}); "
            "run `orogen cache clear` and open it again"
        )

    def facts(self) -> dict[str, Any] | None:
        """What `finish` wrote, or None where the store is not complete."""
        try:
            return json.loads((self.path / "zarr.json").read_text())["attributes"][ATTRIBUTE]
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def finish(self, grid: Grid, facts: dict[str, Any]) -> None:
        """Write the group's metadata, which marks the store as complete."""
        _group(self.path, {**_spatial(grid, 0), ATTRIBUTE: {"format": FORMAT, **facts}})

    def create(
        self, grid: Grid, level: int, name: str, shape: Sequence[int], dtype: str, shard: tuple[int, int], fill: Any
    ) -> ts.TensorStore:
        """A new sharded array of a level, chunks of NODE_SIZE x NODE_SIZE."""
        import tensorstore as ts

        folder = self.path / str(level)
        tail = list(shape[2:])
        chunk = [NODE_SIZE, NODE_SIZE, *tail]
        shape_of_shard = [min(s, -(-n // NODE_SIZE) * NODE_SIZE) for s, n in zip(shard, shape, strict=False)] + tail
        attributes = {"grid_mapping": "spatial_ref", "coordinates": "spatial_ref", **_spatial(grid, level)}
        if name == "height":
            attributes |= {"standard_name": "surface_altitude", "units": "m"}
        metadata = {
            "shape": list(shape),
            "data_type": dtype,
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": shape_of_shard}},
            "codecs": [_sharding(chunk, np.dtype(dtype).itemsize)],
            "fill_value": fill,
            "dimension_names": ["y", "x", "band"][: len(shape)],
            "attributes": attributes,
        }
        _group(folder, {})
        _spatial_ref(folder / "spatial_ref", grid, level)
        spec = {"driver": "zarr3", "kvstore": _kvstore(folder / name), "metadata": metadata, **READING}
        array = ts.open(spec, create=True, context=self._context).result()
        self._open[level, name] = array
        return array

    def write_bounds(self, level: int, bounds: NDArray[np.float32]) -> None:
        """Store the (node rows, node columns, 3) bounds of a level as one chunk."""
        import tensorstore as ts

        folder = self.path / str(level)
        _group(folder, {})
        metadata = {
            "shape": list(bounds.shape),
            "data_type": "float32",
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(bounds.shape)}},
            "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
            "fill_value": "NaN",
            "dimension_names": ["node_y", "node_x", "bound"],
            "attributes": {"fields": ["minimum", "maximum", "error"], "units": "m"},
        }
        spec = {"driver": "zarr3", "kvstore": _kvstore(folder / "bounds"), "metadata": metadata, **READING}
        ts.open(spec, create=True, context=self._context).result().write(bounds).result()


READING = {"fill_missing_data_reads": False, "store_data_equal_to_fill_value": True}
"""A chunk that is missing is an error; one that is all nodata is stored."""


def _kvstore(path: Path) -> dict[str, str]:
    return {"driver": "file", "path": f"{path.as_posix()}/"}


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


def _transform(grid: Grid, level: int) -> tuple[float, ...]:
    """The geotransform of a level: its texels are 2**level as wide from the same upper left corner."""
    a, b, c, d, e, f = grid.transform
    n = 2.0**level
    return a * n, b * n, c, d * n, e * n, f


def _spatial(grid: Grid, level: int) -> dict[str, Any]:
    """The attributes of the geo-proj and spatial conventions."""
    attributes: dict[str, Any] = {
        "spatial:dimensions": ["y", "x"],
        "spatial:transform": list(_transform(grid, level)),
        "spatial:shape": list(level_shape(grid.shape, level)),
    }
    if grid.crs is not None:
        is_code = grid.crs.partition(":")[0].isalpha() and "[" not in grid.crs
        attributes["proj:code" if is_code else "proj:wkt2"] = grid.crs if is_code else _wkt(grid.crs)
    return attributes


def _wkt(crs: str) -> str:
    from orogen.source.scale import parse_crs

    return parse_crs(crs).to_wkt()


def _group(folder: Path, attributes: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"zarr_format": 3, "node_type": "group", "attributes": attributes}, indent=1)
    (folder / "zarr.json").write_text(text)


def _spatial_ref(folder: Path, grid: Grid, level: int) -> None:
    """The scalar variable of the CF conventions that holds the CRS and the geotransform."""
    a, b, c, d, e, f = _transform(grid, level)
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
    (folder / "zarr.json").write_text(json.dumps(metadata, indent=1))
