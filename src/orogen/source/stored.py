"""Pyramids that were built into a folder: what reads them, and the layer in them as a source."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from orogen.errors import SourceError, StoreError
from orogen.grid import Grid
from orogen.keys import level_count, level_shape
from orogen.source.contract import Kind, Quantum, Source
from orogen.source.heights import check_window
from orogen.source.options import ColourOptions, HeightOptions
from orogen.source.rounding import Rounding

if TYPE_CHECKING:
    import tensorstore as ts

FORMAT = 1
"""Version of the layout and of the values; part of the key of every store."""
ATTRIBUTE = "orogen"
MARK = "zarr.json"
READING = {"fill_missing_data_reads": False, "store_data_equal_to_fill_value": True}
"""A chunk that is missing is an error; one that is all nodata is stored."""
CLEAR = "run `orogen cache clear` and open it again"


def kvstore(path: Path) -> dict[str, str]:
    """What tensorstore calls a folder."""
    return {"driver": "file", "path": f"{path.as_posix()}/"}


class Watch:
    """Whether a file is still the one that it was. What replaces it must be another file, not another content."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.first = self._identity()

    @property
    def changed(self) -> bool:
        """Whether another file, or none, is there now."""
        return self._identity() != self.first

    def _identity(self) -> tuple[int, int, int] | None:
        try:
            status = os.stat(self.path)
        except OSError:
            return None
        return status.st_ino, status.st_mtime_ns, status.st_size


@dataclass(frozen=True)
class StoredArrays:
    """The arrays of one pyramid in a folder. Thread-safe."""

    path: Path
    """The folder."""
    remedy: str = CLEAR
    """What to do where the store is damaged."""
    watch: Watch | None = None
    """Tells when another store takes this one's place; None: that does not happen while it is open."""

    @cached_property
    def _context(self) -> ts.Context:
        import tensorstore as ts

        # a little cache for shard indices; decoded nodes are kept by the streaming room
        return ts.Context({"cache_pool": {"total_bytes_limit": 4_000_000}, "data_copy_concurrency": {"limit": 2}})

    @cached_property
    def _open(self) -> dict[tuple[int, str], tuple[ts.TensorStore, Rounding | None]]:
        return {}

    def array(self, level: int, name: str) -> ts.TensorStore:
        """An array of a level, as stored: 'height', 'colour', 'coverage' or 'bounds'."""
        return self._opened(level, name)[0]

    def _opened(self, level: int, name: str) -> tuple[ts.TensorStore, Rounding | None]:
        import tensorstore as ts

        found = self._open.get((level, name))
        if found is None:
            spec = {"driver": "zarr3", "kvstore": kvstore(self.path / str(level) / name), **READING}
            try:
                array = ts.open(spec, open=True, context=self._context).result()
            except (ValueError, OSError) as error:
                raise self.damaged(level, error) from error
            found = array, _rounding(array)
            self._open[level, name] = found
        return found

    def read(self, level: int, name: str, rows: slice, cols: slice) -> NDArray[Any]:
        """A window of an array, heights in metres; StoreError where a part is missing, damaged or replaced."""
        try:
            array, rounding = self._opened(level, name)
            values = array[rows, cols].read(order="C").result()
        except (ValueError, OSError, StoreError) as error:
            self._check_place()
            raise error if isinstance(error, StoreError) else self.damaged(level, error) from error
        # asked after reading: what was read before the other store took its place is of this one
        self._check_place()
        return values if rounding is None else rounding.decode(values)

    def _check_place(self) -> None:
        if self.watch is not None and self.watch.changed:
            raise StoreError(f"{self.path}: was updated or replaced since it was opened; open it again")

    def damaged(self, level: int, error: Exception) -> StoreError:
        """What to raise when reading fails."""
        reason = str(error).split(" [")[0]
        return StoreError(f"{self.path}: level {level} is damaged or incomplete ({reason}); {self.remedy}")

    def facts(self) -> dict[str, Any] | None:
        """What is known of the values, or None where the store is not complete."""
        return attributes(self.path)


def attributes(folder: Path) -> dict[str, Any] | None:
    """What orogen wrote of a group; None where the folder is no group of its own, or not a complete one."""
    try:
        return dict(json.loads((folder / MARK).read_text())["attributes"][ATTRIBUTE])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def layers(folder: Path) -> list[tuple[str, Kind]]:
    """Names and kinds of the layers in a folder that was built; [] where it is none."""
    return [(name, kind) for name, kind in (attributes(folder) or {}).get("layers", [])]


def layer_of(data: Any, kind: Kind) -> Path | None:
    """The folder of the first layer of a kind, or the layer's own folder; None where there is none."""
    if not recognises(data):
        return None
    path = Path(os.path.abspath(data))
    if "grid" in (attributes(path) or {}):
        return path
    return next((path / name for name, its_kind in layers(path) if its_kind == kind), None)


def recognises(data: Any) -> bool:
    """Whether `data` is the folder of a pyramid that was built, or of one of its layers."""
    if not isinstance(data, str | os.PathLike) or not os.path.isdir(data):
        return False
    found = attributes(Path(data)) or {}
    return "layers" in found or "grid" in found


def draped(data: Any, color: Any) -> Any:
    """The image to drape: the one given, else the first layer of colours where `data` is a built folder."""
    if color is not None or not recognises(data):
        return color
    return next((Path(data) / name for name, kind in layers(Path(data)) if kind == "colour"), None)


def open_height(data: Any, options: HeightOptions) -> Source:
    """The first layer of heights. Options that say what stored values mean are refused: they are metres."""
    if options != HeightOptions():
        raise SourceError(f"{data}: holds metres and their georeference; give such options when it is built")
    return _open_layer(data, "height")


def open_colour(data: Any, heights: Source, options: ColourOptions) -> Source:
    """The first layer of colours, in the CRS of the heights that it was built for."""
    source = _open_layer(data, "colour")
    if source.grid.crs != heights.grid.crs:
        raise SourceError(
            f"{data}: its colours are in {source.grid.crs}, the heights in {heights.grid.crs}; build them together"
        )
    return source


def _open_layer(data: Any, kind: Kind) -> StoredSource:
    path = layer_of(data, kind)
    if path is None:
        names = ", ".join(f"{name} ({its})" for name, its in layers(Path(data)))
        raise SourceError(f"{data}: has no layer of kind {kind}, only {names}")
    top = path.parent if any(name == path.name for name, _ in layers(path.parent)) else path

    watch = Watch(top / MARK)
    arrays = StoredArrays(path, f"build it again: orogen build ... -o {top} --force", watch)
    facts = arrays.facts()
    if facts is None or facts.get("format") != FORMAT:
        raise StoreError(f"{path}: is of another version or incomplete; {arrays.remedy}")
    if facts["kind"] != kind:
        raise SourceError(f"{path}: is a layer of kind {facts['kind']}, expected {kind}")
    return StoredSource(arrays, facts, f"{path}|{watch.first}")


@dataclass(frozen=True)
class StoredSource:
    """A layer of a built folder; a `Source`."""

    arrays: StoredArrays
    """Where it is."""
    facts: dict[str, Any]
    """What the layer's metadata says."""
    fingerprint: str
    """Changes when the store is updated."""
    nodata: None = field(default=None, init=False)
    """Nodata is NaN, or alpha 0."""
    direct: bool = field(default=True, init=False)
    """Level 0 is in the store."""
    block: tuple[int, int] = field(default=(256, 256), init=False)
    """(rows, columns) of a chunk."""

    @property
    def kind(self) -> Kind:
        """What the layer holds."""
        return self.facts["kind"]

    @cached_property
    def grid(self) -> Grid:
        """Where it lies."""
        found = self.facts["grid"]
        return Grid(
            found["width"], found["height"], tuple(found["transform"]), found["crs"], tuple(found["ground_scale"])
        )

    @property
    def name(self) -> str:
        """The folder."""
        return str(self.arrays.path)

    @property
    def dtype(self) -> str:
        """The type of the samples as stored."""
        return str(self.arrays.array(0, self.kind).dtype.name)

    @property
    def quantum(self) -> Quantum | None:
        """What heights are whole numbers of, where they were rounded."""
        rounding = _rounding(self.arrays.array(0, self.kind)) if self.kind == "height" else None
        return Quantum(rounding.step) if rounding else None

    @property
    def units(self) -> str:
        """Heights are stored in metres."""
        return "metre" if self.kind == "height" else ""

    @property
    def vertical_crs(self) -> str | None:
        """Name of the vertical reference of the data that it was built from."""
        return self.facts.get("vertical_crs")

    @property
    def covered(self) -> bool:
        """Whether every sample is valid."""
        return bool(self.facts.get("covered", False))

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        """A window of level 0, as every `Source` gives it."""
        check_window(rows, cols, self.grid.shape, self.name)
        return self.arrays.read(0, self.kind, rows, cols)

    def overview(self, shape: tuple[int, int]) -> NDArray[Any]:
        """The coarsest level that has at least `shape` (rows, columns), or level 0."""
        sizes = [level_shape(self.grid.shape, level) for level in range(level_count(self.grid.shape))]
        fine = [level for level, (rows, cols) in enumerate(sizes) if rows >= shape[0] and cols >= shape[1]]
        level = max(fine, default=0)
        return self.arrays.read(level, self.kind, slice(0, sizes[level][0]), slice(0, sizes[level][1]))

    def close(self) -> None:
        """Nothing stays open."""


def _rounding(array: ts.TensorStore) -> Rounding | None:
    """How the numbers of an array become heights; None where they are stored as they are."""
    dtype = str(array.dtype.name)
    if dtype not in ("int16", "int32"):
        return None
    metadata = array.spec().to_json()["metadata"]
    return Rounding(float(metadata["attributes"]["scale_factor"]), dtype)
