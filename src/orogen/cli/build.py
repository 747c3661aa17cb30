"""`orogen build`: a pyramid that stays, as a Zarr folder or a COG."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Annotated, Any

from cyclopts import Parameter

from orogen.cli import console
from orogen.cli.options import DataOptions, one_or_all
from orogen.cli.parameters import Flag, Json, Output, Overwrite, Rasters, Window
from orogen.errors import OutputError, SettingsError

Named = Annotated[list[str] | None, Parameter(negative="", metavar="NAME=DATA")]


def build(
    *data: Rasters,
    output: Output,
    max_error: float | None = None,
    layer: Named = None,
    image: Named = None,
    scheduler: str | None = None,
    update: Flag = False,
    window: Window | None = None,
    overwrite: Overwrite = False,
    json: Json = False,
    options: DataOptions | None = None,
) -> None:
    """Build all levels of a raster, to be opened later without the raster; a build that was killed goes on.

    Parameters
    ----------
    output
        What to make: a folder (.zarr), which keeps the draped image too, or a COG (.tif) of the heights alone.
    max_error
        Metres by which stored heights may be off, which takes less space. [default: nothing is lost]
    layer
        More heights, as another layer of the folder; repeat for several.
    image
        More images that are draped over the heights, as other layers; repeat for several.
    scheduler
        Address of a Dask scheduler whose workers do the work, such as tcp://host:8786; they must see the same files.
        [default: threads of this machine]
    update
        Bring a folder that was built from the same data up to date: only what has changed is written.
    window
        With --update: the part of the raster that has changed, first column and row, columns and rows; without it all
        of the raster is compared.
    """
    from orogen.pyramid.make import build_pyramid, update_pyramid

    if window is not None and not update:
        raise SettingsError("--window: tells what has changed; give it with --update")
    if update and (overwrite or max_error is not None):
        raise SettingsError("--update: keeps what the build was given; leave out --overwrite and --max-error")
    if output.suffix.lower() not in ("", ".zarr", ".tif", ".tiff"):
        raise OutputError(f"{output}: expected the suffix .zarr or .tif, got {output.suffix!r}")
    given = options or DataOptions()
    shared: dict[str, Any] = {
        "options": given.heights(),
        "color": given.color,
        "color_extent": given.color_extent,
        "layers": _named("--layer", layer),
        "images": _named("--image", image),
        "scheduler": scheduler,
    }
    raster = one_or_all(data)
    with console.progress() as report:
        if update:
            x, y, width, height = window or (0, 0, 0, 0)
            windows = None if window is None else [(slice(y, y + height), slice(x, x + width))]
            built = update_pyramid(raster, output, windows=windows, report=report, **shared)
        else:
            built = build_pyramid(
                raster, output, max_error=max_error, force=overwrite, report=report, estimated=_tell, **shared
            )
    result = {
        "output": str(built.path),
        "size": built.size,
        "seconds": built.seconds,
        "estimate": None if built.estimate is None else asdict(built.estimate),
        "layers": built.layers,
    }
    console.show(result, json, [str(built.path), *(_line(name, facts) for name, facts in built.layers.items())])


def _tell(estimate: Any) -> None:
    """Say before most of the work what it will take."""
    seconds = estimate.seconds
    time = "not much time" if math.isnan(seconds) else f"about {console.time_text(seconds)}"
    console.note(f"building takes {time} and {console.size_text(estimate.size)}")


def _line(name: str, facts: dict[str, Any]) -> str:
    """What is to be known of a layer."""
    text = f"{name}: {facts['grid']['width']} x {facts['grid']['height']} samples"
    if "max_error" in facts:
        text += f", off by at most {facts['largest_error']:g} m of {facts['max_error']:g} m"
    elif facts["kind"] == "height":
        text += ", nothing lost"
    if "regions" in facts:
        text += f", {facts['regions']} regions updated"
    return text


def _named(option: str, items: list[str] | None) -> dict[str, str]:
    result = {}
    for item in items or ():
        name, found, value = item.partition("=")
        if not found or not name or not value:
            raise SettingsError(f"{option}: expected NAME=DATA, got {item!r}")
        result[name] = value
    return result
