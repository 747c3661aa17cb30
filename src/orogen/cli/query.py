"""`orogen height`, `profile`, `sight`, `viewshed`, `shadow` and `slope`: questions about the surface."""

from __future__ import annotations

import contextlib
import csv as csv_format
import io
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from orogen.cli import console
from orogen.cli.options import DataOptions, Flag, Pair, numbers, word
from orogen.errors import SettingsError

if TYPE_CHECKING:
    from orogen.queries import Queries

Place = Annotated[Pair, word(numbers(2), "X,Y")]
Number = Annotated[float, Parameter(allow_leading_hyphen=True)]
Output = Annotated[Path, Parameter(name=("--output", "-o"))]
Overwrite = Annotated[bool, Parameter(name=("--overwrite", "--force"), negative="", show_default=False)]
PointCrs = Annotated[str | None, Parameter(show_default=False)]


@contextlib.contextmanager
def _asked(data: str, options: DataOptions | None) -> Iterator[tuple[Queries, console.Report]]:
    """The queries of a raster, with its pyramid built."""
    from orogen.terrain import open_terrain

    with (
        console.progress() as report,
        open_terrain(data, **asdict(options or DataOptions()), progress=report) as terrain,
    ):
        yield terrain.queries, report


def height(
    data: str,
    x: Number,
    y: Number,
    /,
    *,
    point_crs: PointCrs = None,
    json: Flag = False,
    options: DataOptions | None = None,
) -> None:
    """Tell the height of the surface at a place, in metres; "nan" outside the data and in voids.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    x
        Coordinate to the east, or longitude.
    y
        Coordinate to the north, or latitude.
    point_crs
        CRS of x and y, such as EPSG:4326. [default: the data's]
    json
        Write JSON, with the normal.
    """
    with _asked(data, options) as (queries, _):
        found = float(queries.height_at(x, y, crs=point_crs))
        normal = queries.normal_at(x, y, crs=point_crs).tolist()
    console.show({"height": found, "normal": normal}, json, [f"{found:.10g}"])


def profile(
    data: str,
    /,
    *,
    start: Annotated[Place, Parameter(name="--from")],
    end: Annotated[Place, Parameter(name="--to")],
    step: float | None = None,
    point_crs: PointCrs = None,
    csv: Flag = False,
    json: Flag = False,
    options: DataOptions | None = None,
) -> None:
    """Tell the heights along a line: distance (m along the ellipsoid), height (m), x and y.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    start
        Where the line starts, in the data's CRS.
    end
        Where it ends.
    step
        Metres between heights at most. [default: one sample]
    point_crs
        CRS of the two places, such as EPSG:4326. [default: the data's]
    csv
        Write comma-separated values.
    json
        Write JSON.
    """
    if csv and json:
        raise SettingsError("--csv and --json: expected one of them, got both")
    with _asked(data, options) as (queries, _):
        line = queries.profile([start, end], step, crs=point_crs)
    columns = {name: getattr(line, name).tolist() for name in ("distance", "height", "x", "y")}
    rows = list(zip(*columns.values(), strict=True))
    if csv:
        text = io.StringIO()
        writer = csv_format.writer(text, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([f"{d:.3f}", "" if np.isnan(h) else f"{h:.3f}", repr(x), repr(y)] for d, h, x, y in rows)
        sys.stdout.write(text.getvalue())
        return
    lines = [f"{'distance':>12}  {'height':>10}  {'x':>14}  {'y':>14}"]
    lines += [f"{d:12.1f}  {h:10.2f}  {x:14.10g}  {y:14.10g}" for d, h, x, y in rows]
    console.show({**columns, "complete": line.complete}, json, lines)


def sight(
    data: str,
    /,
    *,
    start: Annotated[Place, Parameter(name="--from")],
    end: Annotated[Place, Parameter(name="--to")],
    height: float = 1.7,
    target_height: float = 0.0,
    no_curvature: Flag = False,
    refraction: float = 0.13,
    point_crs: PointCrs = None,
    json: Flag = False,
    options: DataOptions | None = None,
) -> None:
    """Tell whether one place is seen from another, how far apart they are, and what is in the way.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    start
        Where the eye is, in the data's CRS.
    end
        What is looked at.
    height
        Metres of the eye above the ground.
    target_height
        Metres above the ground of what is looked at.
    no_curvature
        A flat earth.
    refraction
        Part of the curvature that the air's refraction makes up for.
    point_crs
        CRS of the two places, such as EPSG:4326. [default: the data's]
    json
        Write JSON.
    """
    with _asked(data, options) as (queries, _):
        line = queries.line_of_sight(
            [*start, height], [*end, target_height], crs=point_crs, curvature=not no_curvature, refraction=refraction
        )
    found: dict[str, Any] = {
        "visible": bool(line.visible),
        "known": bool(line.known),
        "distance": float(line.distance),
        "obstacle": None if np.isnan(line.obstacle).any() else line.obstacle.tolist(),
    }
    console.show(found, json)


def viewshed(
    data: str,
    /,
    *,
    at: Place,
    output: Output,
    height: float = 1.7,
    target_height: float = 0.0,
    radius: float | None = None,
    no_curvature: Flag = False,
    refraction: float = 0.13,
    point_crs: PointCrs = None,
    overwrite: Overwrite = False,
    json: Flag = False,
    options: DataOptions | None = None,
) -> None:
    """Write what is seen from a place as a GeoTIFF: 1 seen, 0 hidden, 255 (nodata) no data or beyond the radius.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    at
        Where the eye is, in the data's CRS.
    output
        File to write (.tif).
    height
        Metres of the eye above the ground.
    target_height
        Metres above the ground of what is looked for.
    radius
        Metres from the eye beyond which nothing is looked at. [default: all of the data]
    no_curvature
        A flat earth.
    refraction
        Part of the curvature that the air's refraction makes up for.
    point_crs
        CRS of the place, such as EPSG:4326. [default: the data's]
    overwrite
        Replace a file that exists.
    json
        Write JSON about the raster to stdout.
    """
    from orogen.cli.geotiff import SUFFIXES, write_fields
    from orogen.view.output import check_output

    check_output(output, SUFFIXES, overwrite)
    with _asked(data, options) as (queries, report):
        field = queries.viewshed(
            at, height=height, target_height=target_height, radius=radius, crs=point_crs,
            curvature=not no_curvature, refraction=refraction,
        )  # fmt: skip
        (counts,) = write_fields(output, [field], report, overwrite)
    _tell(output, {"seen": counts.get(1, 0), "hidden": counts.get(0, 0), "unknown": counts.get(255, 0)}, json)


def shadow(
    data: str,
    /,
    *,
    sun: Annotated[Pair, word(numbers(2), "AZ,EL")],
    output: Output,
    overwrite: Overwrite = False,
    json: Flag = False,
    options: DataOptions | None = None,
) -> None:
    """Write where the sun shines as a GeoTIFF: 1 lit, 0 in the shadow of terrain, 255 (nodata) no data.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    sun
        Azimuth from grid north and elevation of the sun, degrees.
    output
        File to write (.tif).
    overwrite
        Replace a file that exists.
    json
        Write JSON about the raster to stdout.
    """
    from orogen.cli.geotiff import SUFFIXES, write_fields
    from orogen.view.output import check_output

    check_output(output, SUFFIXES, overwrite)
    with _asked(data, options) as (queries, report):
        (counts,) = write_fields(output, [queries.shadow(sun)], report, overwrite)
    _tell(output, {"lit": counts.get(1, 0), "shadowed": counts.get(0, 0), "unknown": counts.get(255, 0)}, json)


def slope(
    data: str,
    /,
    *,
    output: Output,
    unit: Literal["degrees", "percent"] = "degrees",
    aspect: Flag = False,
    overwrite: Overwrite = False,
    json: Flag = False,
    options: DataOptions | None = None,
) -> None:
    """Write how steep the terrain is as a GeoTIFF of float32; NaN (nodata) where there is no data.

    Parameters
    ----------
    data
        Raster: a path, URL or GDAL name, or "synthetic".
    output
        File to write (.tif).
    unit
        Unit of the slope.
    aspect
        Add a second band: where the terrain falls to, degrees clockwise from grid north.
    overwrite
        Replace a file that exists.
    json
        Write JSON about the raster to stdout.
    """
    from orogen.cli.geotiff import SUFFIXES, write_fields
    from orogen.view.output import check_output

    check_output(output, SUFFIXES, overwrite)
    with _asked(data, options) as (queries, report):
        fields = [queries.slope(unit), *([queries.aspect()] if aspect else [])]
        write_fields(output, fields, report, overwrite)
    _tell(output, {}, json)


def _tell(output: Path, counts: dict[str, int], json: bool) -> None:
    """The file, and how many samples are what."""
    lines = [str(output), *(f"{name}  {count}" for name, count in counts.items())]
    console.show({"file": str(output), **counts}, json, lines)
