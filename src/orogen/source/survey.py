"""Finds out which samples are valid: undeclared nodata, a raster without any, one without gaps."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import NoSampleError
from orogen.source.heights import MASKED, ArraySamples, Facts, HeightSource, Samples
from orogen.source.values import LIMIT, Values, hidden_sentinels, possible_sentinels, value_range

log = logging.getLogger("orogen")

IN_MEMORY = 2**22
"""Rasters of at most so many samples are read whole when they are opened."""
PROBES = 8
"""A large raster that declares no nodata is looked into at so many places along each of its sides."""
DECLARED = 3
"""The same of one that does: at its corners, the middles of its edges and its middle."""
FEW = 3
"""Blocks read where reading is dear."""
PROBE = 256
"""Rows and columns read at each place."""
SEARCHED = 2**28
"""A raster without a valid sample at these places is searched for one, up to so many samples."""


def fits_memory(shape: tuple[int, int]) -> bool:
    """Whether a raster of (rows, columns) is read whole when it is opened."""
    return shape[0] * shape[1] <= IN_MEMORY


def survey(samples: Samples, values: Values, facts: Facts, doubt: bool) -> HeightSource:
    """A source of the samples. Small rasters are read whole and known for certain, large ones are looked into.

    doubt: whether usual nodata values are nodata where they stand apart, though nothing says so.
    """
    rows, cols = facts.grid.shape
    if not fits_memory((rows, cols)):
        return _large(samples, values, facts, doubt)
    data, valid = samples.read(slice(0, rows), slice(0, cols))
    samples.close()
    return _in_memory(ArraySamples(data, valid), values, facts, doubt)


def _in_memory(samples: ArraySamples, values: Values, facts: Facts, doubt: bool) -> HeightSource:
    """All samples are known: nodata is found for certain."""
    usable = np.isfinite(values.metres(samples.data, samples.valid))
    if doubt and (sentinels := hidden_sentinels(samples.data, usable)):
        values = _adopt(values, sentinels, facts.name)
        usable = np.isfinite(values.metres(samples.data, samples.valid))
    if not usable.any():
        raise _no_samples(facts.name, values)
    return _source(samples, values, facts, covered=bool(usable.all()))


def _large(samples: Samples, values: Values, facts: Facts, doubt: bool) -> HeightSource:
    """Only some samples are looked at; usual sentinels among the others are nodata too."""
    dtype = np.dtype(facts.dtype)
    count = PROBES if values.nodata is None and not samples.masked else DECLARED
    seen = [_stored(part, values) for part in probes(samples, facts.grid.shape, count)]
    known = np.concatenate(seen)
    everything = np.ones(known.shape, bool)
    if doubt and known.size:
        if sentinels := hidden_sentinels(known, everything):
            values = _adopt(values, sentinels, facts.name)
            everything = np.isfinite(values.metres(known))
        if values.nodata is None and (span := value_range(known, everything)):
            values = replace(values, sentinels=possible_sentinels(*span, dtype))
    covered = not samples.masked and not values.possible(dtype)
    source = _source(samples, values, facts, covered)
    if not everything.any() and not _any_valid(source):
        raise _no_samples(facts.name, values)
    return source


def probes(samples: Samples, shape: tuple[int, int], count: int) -> Iterator[MASKED]:
    """Stored samples of `count` x `count` windows of a raster of (rows, columns), from corner to corner.

    Of a raster that can only be read from its start, the first rows; of one in rows as wide as it, fewer windows; of
    one whose blocks are dear, as remote ones are, a few blocks from corner to corner.
    """
    rows, cols = shape
    if not samples.direct and not samples.sequential and samples.block[1] < cols:
        places = zip(_starts(rows, PROBE, FEW), _starts(cols, PROBE, FEW), strict=False)
        for row, col in places:
            row, col = row // samples.block[0] * samples.block[0], col // samples.block[1] * samples.block[1]
            yield samples.read(slice(row, min(rows, row + PROBE)), slice(col, min(cols, col + PROBE)))
        return
    across = count if samples.direct else 1
    down = 1 if samples.sequential else count
    width = PROBE if samples.direct else PROBE * PROBES
    for row in _starts(rows, PROBE, down):
        for col in _starts(cols, width, across):
            yield samples.read(slice(row, min(rows, row + PROBE)), slice(col, min(cols, col + width)))


def _starts(size: int, length: int, count: int) -> list[int]:
    """Starts of `count` windows of `length` in `size`, the first at its start and the last at its end."""
    last = max(0, size - length)
    return sorted({last * i // max(count - 1, 1) for i in range(count)})


def _stored(part: MASKED, values: Values) -> NDArray[Any]:
    """The stored samples that are valid so far as is known."""
    data, valid = part
    return data[np.isfinite(values.metres(data, valid))]


def _source(samples: Samples, values: Values, facts: Facts, covered: bool) -> HeightSource:
    known = {f.name: getattr(facts, f.name) for f in fields(facts)} | {"covered": covered}
    return HeightSource(samples=samples, values=values, **known)


def _any_valid(source: HeightSource) -> bool:
    """Whether there may be a valid sample: looked for from the middle outwards, as far as that is quick."""
    height, width = source.grid.shape
    if height * width > SEARCHED:
        return True
    step = max(source.block[0], PROBE)
    for row in sorted(range(0, height, step), key=lambda row: abs(row + step // 2 - height // 2)):
        if np.isfinite(source.read(slice(row, min(height, row + step)), slice(0, width))).any():
            return True
    return False


def _adopt(values: Values, sentinels: tuple[float, ...], name: str) -> Values:
    """The values with undeclared nodata, the first of which counts as declared where nothing else is."""
    log.warning(
        "%s: %s stands apart from all other samples and is taken as nodata; give nodata= to change it",
        name, " and ".join(f"{value:g}" for value in sentinels),
    )  # fmt: skip
    if values.nodata is None:
        return replace(values, nodata=sentinels[0], sentinels=sentinels[1:])
    return replace(values, sentinels=sentinels)


def _no_samples(name: str, values: Values) -> NoSampleError:
    declared = "NaN" if values.nodata is None else f"{values.nodata:.9g}"
    return NoSampleError(
        f"{name}: no valid sample, all are nodata ({declared}) or beyond {LIMIT:g} m; "
        "give nodata= or height_scale= if that is wrong"
    )
