"""`orogen info`: what a raster is, and which GPU is used."""

from __future__ import annotations

from typing import Annotated, Any

from cyclopts import Parameter

from orogen.cli import console
from orogen.cli.options import DataOptions, Flag
from orogen.errors import SettingsError


def info(
    data: str | None = None,
    /,
    *,
    gpu: Flag = False,
    json: Flag = False,
    adapter: Annotated[str | None, Parameter(show_default=False)] = None,
    options: DataOptions | None = None,
) -> None:
    """Tell what a raster is, or which GPU is used.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    gpu
        Tell about the GPU: its name, driver, features, limits and memory.
    json
        Write JSON.
    adapter
        GPU to tell about: index, kind or part of its name.
    """
    if data is None and not gpu:
        raise SettingsError("expected a raster or --gpu, got neither")
    result: dict[str, Any] = {}
    lines: list[str] = []
    if data is not None:
        result |= raster_facts(data, options or DataOptions())
        lines += console.table(result)
    if gpu:
        result["gpu"] = gpu_facts(adapter)
        lines += gpu_lines(result["gpu"])
    console.show(result, json, lines)


def raster_facts(data: str, options: DataOptions) -> dict[str, Any]:
    """What is known of a raster without building its pyramid."""
    from orogen.keys import level_count
    from orogen.pyramid.open import open_pyramid
    from orogen.source import open_colour, open_height

    source = open_height(
        data,
        spacing=options.spacing,
        height_scale=options.height_scale,
        height_offset=options.height_offset,
        nodata=options.nodata,
        vertical_units=options.vertical_units,
        crs=options.crs,
    )
    grid = source.grid
    pyramid = open_pyramid(source, build="never")
    low, high = pyramid.height_range
    spacing = [abs(float(v)) for v in grid.metres.diagonal()]
    facts = {
        "name": source.name,
        "width": grid.width,
        "height": grid.height,
        "type": source.dtype,
        "crs": grid.crs,
        "bounds": grid.bounds,
        "transform": grid.transform,
        "metres_per_sample": spacing if grid.transform[1] == grid.transform[3] == 0 else grid.spacing,
        "height_range": (low, high),
        "height_range_exact": pyramid.built,
        "nodata": source.nodata,
        "vertical_units": source.units,
        "vertical_crs": source.vertical_crs,
        "levels": level_count(grid.shape),
        "pyramid_built": pyramid.built,
    }
    if options.color is not None:
        colors = open_colour(options.color, source, color_extent=options.color_extent, crs=options.crs)  # type: ignore[arg-type]
        facts["color"] = colors.name
        facts["color_bounds"] = colors.grid.bounds
        colors.close()
    source.close()
    return facts


def gpu_facts(adapter: str | None) -> dict[str, Any]:
    """The adapters of this machine, and the chosen one opened."""
    from orogen.gpu import adapters, open_gpu

    with open_gpu(adapter) as gpu:
        return {"adapters": [str(info) for info in adapters()], **gpu.describe()}


def gpu_lines(facts: dict[str, Any]) -> list[str]:
    """The same as lines."""
    shown = {key: facts[key] for key in ("name", "kind", "backend", "driver")}
    shown["adapters"] = "; ".join(f"{index}: {name}" for index, name in enumerate(facts["adapters"]))
    shown["features"] = ", ".join(name for name, on in facts["features"].items() if on)
    shown["missing_features"] = ", ".join(name for name, on in facts["features"].items() if not on) or None
    return console.table({**shown, **facts["limits"]})
