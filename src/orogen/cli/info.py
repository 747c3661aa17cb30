"""`orogen info`: what a raster is, and which GPU is used."""

from __future__ import annotations

from typing import Annotated, Any

from cyclopts import Parameter

from orogen.cli import console
from orogen.cli.options import DrapedOptions, one_or_all
from orogen.cli.parameters import Adapter, Flag, Json, Rasters
from orogen.errors import SettingsError


def info(
    *data: Annotated[Rasters, Parameter(required=False)],
    gpu: Flag = False,
    json: Json = False,
    adapter: Adapter = None,
    options: DrapedOptions | None = None,
) -> None:
    """Tell what a raster is (size, CRS, heights, nodata, levels ...), or which GPU is used.

    Parameters
    ----------
    gpu
        Tell about the GPU: its name, driver, features, limits and memory.
    """
    if not data and not gpu:
        raise SettingsError("expected a raster or --gpu, got neither")
    result: dict[str, Any] = {}
    lines: list[str] = []
    if data:
        result |= raster_facts(one_or_all(data), options or DrapedOptions())
        lines += console.table(result)
    if gpu:
        result["gpu"] = gpu_facts(adapter)
        lines += gpu_lines(result["gpu"])
    console.show(result, json, lines)


def raster_facts(data: str | list[str], options: DrapedOptions) -> dict[str, Any]:
    """What is known of a raster without building its pyramid."""
    from orogen.keys import level_count
    from orogen.pyramid.open import open_pyramid
    from orogen.shading.ramp import ramp_stops
    from orogen.source import open_colour, open_height
    from orogen.source.contract import attribution_of, quantum_of
    from orogen.source.scale import distortion
    from orogen.streaming.heightformat import height_format

    source = open_height(data, **options.heights())
    grid = source.grid
    pyramid = open_pyramid(source, build="never")
    low, high = pyramid.height_range
    spacing = [abs(float(v)) for v in grid.metres.diagonal()]
    heights, quantum = height_format(pyramid, None), quantum_of(source)
    facts = {
        "name": source.name,
        "width": grid.width,
        "height": grid.height,
        "type": source.dtype,
        "crs": grid.crs,
        "bounds": grid.bounds,
        "transform": grid.transform,
        "metres_per_sample": spacing if grid.transform[1] == grid.transform[3] == 0 else grid.spacing,
        "ground_scale": grid.ground_scale,
        "distortion": distortion(grid),
        "height_range": (low, high),
        "height_range_exact": pyramid.built,
        "height_quantum": quantum.step if quantum else None,
        "height_bits": heights.bits if pyramid.exact else None,
        "height_step": heights.step if heights.bits == 16 else None,
        "nodata": source.nodata,
        "vertical_units": source.units,
        "vertical_crs": source.vertical_crs,
        "levels": level_count(grid.shape),
        "pyramid_built": pyramid.built,
    }
    credits = [attribution_of(source)]
    if options.color is not None:
        ramp = ramp_stops(options.color_ramp) if options.color_ramp else None
        colors = open_colour(
            options.color,
            source,
            color_extent=options.color_extent,
            crs=options.crs,
            ramp=ramp,
        )
        facts["color"] = colors.name
        facts["color_bounds"] = colors.grid.bounds
        credits.append(attribution_of(colors))
        colors.close()
    facts["attribution"] = options.attribution or "; ".join(dict.fromkeys(filter(None, credits))) or None
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
