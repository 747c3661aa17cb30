"""Build and update pyramids that stay: what `orogen build` does."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orogen.errors import SettingsError
from orogen.pyramid.build import Estimate
from orogen.pyramid.output import Layer, Output, Report
from orogen.pyramid.task import Recipe
from orogen.pyramid.update import Update
from orogen.pyramid.workers import hired
from orogen.source.mosaic import absolute

COG_SUFFIXES = (".tif", ".tiff")


@dataclass(frozen=True)
class Built:
    """A pyramid that was built or updated."""

    path: Path
    """Where it is."""
    layers: dict[str, dict[str, Any]]
    """What is known of the values of each layer, by its name."""
    size: int
    """Bytes on the disk."""
    seconds: float
    """Time that it took."""
    estimate: Estimate | None
    """What was expected before most of the work; None for an update."""


def build_pyramid(
    data: Any,
    output: str | os.PathLike[str],
    *,
    options: Mapping[str, Any] | None = None,
    color: Any = None,
    color_extent: str = "pixels",
    layers: Mapping[str, Any] | None = None,
    images: Mapping[str, Any] | None = None,
    max_error: float | None = None,
    scheduler: str | None = None,
    force: bool = False,
    report: Report = lambda fraction, text: None,
    estimated: Callable[[Estimate], None] = lambda estimate: None,
    stop: threading.Event | None = None,
) -> Built:
    """Build the pyramid of data of any size into a folder, or into a COG where `output` ends with .tif.

    data, options: heights, as `open_height` takes them; they become the layer "height". color: an image that is draped
    over them, the layer "color". layers, images: more heights and images by name, for folders only.
    max_error: metres by which stored heights may be off; None: nothing is lost.
    scheduler: address of a Dask scheduler whose workers do the work; they must see the same files under the same
    names. None: threads. force: replace what was built there before.
    report: called with the part done (0 to 1) and what is done, from any thread. estimated: called before most of the
    work. stop: set it to end the build with `Cancelled`. A build that was stopped, or killed at any moment, goes on
    where it was when it is called again, and gives the same bytes.

    Raises SourceError for data that cannot be used, OutputError where the output exists or cannot be written.
    """
    path, start = Path(output), time.perf_counter()
    expected: list[Estimate] = []

    def note(estimate: Estimate) -> None:
        expected.append(estimate)
        estimated(estimate)

    with (
        _opened(data, options, color, color_extent, layers, images, scheduler) as found,
        hired(scheduler) as workers,
    ):
        out = Output(path, found, max_error, report, note, stop or threading.Event())
        if path.suffix.lower() in COG_SUFFIXES:
            from orogen.pyramid.cog import build_cog

            facts = build_cog(out, workers, replace=force)
        else:
            facts = out.build(workers, replace=force)
    return Built(path, facts, _size(path), time.perf_counter() - start, expected[0] if expected else None)


def update_pyramid(
    data: Any,
    output: str | os.PathLike[str],
    *,
    windows: Sequence[tuple[slice, slice]] | None = None,
    options: Mapping[str, Any] | None = None,
    color: Any = None,
    color_extent: str = "pixels",
    layers: Mapping[str, Any] | None = None,
    images: Mapping[str, Any] | None = None,
    scheduler: str | None = None,
    report: Report = lambda fraction, text: None,
    stop: threading.Event | None = None,
) -> Built:
    """Bring a folder that `build_pyramid` made up to date with data that have changed in places.

    Takes the same data and options as the build did. windows: (rows, columns) of level 0 that have changed; None:
    everything is read and compared. Only the changed regions and what is above them are written, and the result has
    the bytes that a new build would have. It takes the place of the old one at once: readers that have that open get a
    StoreError which tells them to open it again.

    Raises StoreError where size, place or layers have changed, so that only a new build can do it.
    """
    path, start = Path(output), time.perf_counter()
    if path.suffix.lower() in COG_SUFFIXES:
        raise SettingsError(f"{path}: a COG cannot be updated in part; build it again with --force, or build a .zarr")
    with (
        _opened(data, options, color, color_extent, layers, images, scheduler) as found,
        hired(scheduler) as workers,
    ):
        facts = Update(path, found, report, stop or threading.Event()).run(workers, windows)
    return Built(path, facts, _size(path), time.perf_counter() - start, None)


@contextmanager
def _opened(
    data: Any,
    options: Mapping[str, Any] | None,
    color: Any,
    color_extent: str,
    layers: Mapping[str, Any] | None,
    images: Mapping[str, Any] | None,
    scheduler: str | None,
) -> Iterator[list[Layer]]:
    heights = Recipe(absolute(data), dict(options or {}))
    recipes = {"height": heights}
    recipes |= {name: Recipe(absolute(given), {}) for name, given in (layers or {}).items()}
    drape = {"color_extent": color_extent}
    colours = ({} if color is None else {"color": color}) | dict(images or {})
    with ExitStack() as stack:
        found = []
        for name, recipe in recipes.items():
            found.append(Layer(checked_name(name), recipe.open(), recipe))
            stack.callback(found[-1].source.close)
        for name, given in colours.items():
            if name in recipes:
                raise SettingsError(f"layers: expected different names, got {name!r} twice")
            recipe = Recipe(absolute(given), drape, heights)
            found.append(Layer(checked_name(name), recipe.over(found[0].source), recipe))
            stack.callback(found[-1].source.close)
        for layer in found:
            if scheduler is not None and layer.source.fingerprint is None:
                raise SettingsError(
                    f"{layer.source.name}: cannot be sent to other processes; save it to a file, "
                    "or leave out --scheduler"
                )
        yield found


def checked_name(name: str) -> str:
    """The name of a layer; SettingsError where it cannot be that of a folder."""
    if not name.replace("-", "").replace("_", "").isalnum():
        raise SettingsError(f"layer: expected a name of letters, digits, - and _, got {name!r}")
    return name


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
