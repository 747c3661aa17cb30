"""`orogen height`, `profile`, `sight`, `viewshed`, `shadow` and `slope`: questions about the surface."""

from __future__ import annotations

import contextlib
import csv as csv_format
import io
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from orogen.cli import console
from orogen.cli.options import HeightOptions
from orogen.cli.parameters import Data, Flag, Json, Output, Overwrite, Place, Sun
from orogen.errors import SettingsError

if TYPE_CHECKING:
    from orogen.queries import Field, Queries

Number = Annotated[float, Parameter(allow_leading_hyphen=True)]
PointCrs = Annotated[
    str | None,
    Parameter(
        show_default=False, help="CRS of the places on the command line, such as EPSG:4326. [default: the data's]"
    ),
]
SEEN = {"seen": 1, "hidden": 0, "unknown": 255}
"""Values of a viewshed by what they mean."""
LIT = {"lit": 1, "shadowed": 0, "unknown": 255}
"""Values of a shadow raster by what they mean."""


@Parameter(name="*")
@dataclass(frozen=True)
class SightOptions:
    """Who looks at what, through what."""

    height: float = 1.7
    """Metres of the eye above the ground."""
    target_height: float = 0.0
    """Metres above the ground of what is looked at."""
    no_curvature: Flag = False
    """Take the earth for flat."""
    refraction: float = 0.13
    """Part of the curvature that the air's refraction makes up for."""

    def light(self) -> dict[str, Any]:
        """The arguments of queries that say how light travels."""
        return {"curvature": not self.no_curvature, "refraction": self.refraction}


def height(
    data: Data,
    x: Number,
    y: Number,
    /,
    *,
    point_crs: PointCrs = None,
    json: Json = False,
    options: HeightOptions | None = None,
) -> None:
    """Tell the height of the surface at a place, in metres; "nan" outside the data and in voids.

    With --json also the normal: how far it points to the east, to the north and up.

    Parameters
    ----------
    x
        Coordinate to the east, or longitude.
    y
        Coordinate to the north, or latitude.
    """
    with _asked(data, options) as (queries, _):
        found = float(queries.height_at(x, y, crs=point_crs))
        normal = queries.normal_at(x, y, crs=point_crs).tolist()
    console.show({"height": found, "normal": normal}, json, [f"{found:.10g}"])


def profile(
    data: Data,
    /,
    *,
    start: Annotated[Place, Parameter(name="--from")],
    end: Annotated[Place, Parameter(name="--to")],
    step: float | None = None,
    point_crs: PointCrs = None,
    csv: Flag = False,
    json: Json = False,
    options: HeightOptions | None = None,
) -> None:
    """Tell the heights along a line: distance (m along the ellipsoid), height (m), x and y.

    Parameters
    ----------
    start
        Where the line starts.
    end
        Where it ends.
    step
        Metres between heights at most. [default: one sample]
    csv
        Write comma-separated values.
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
    data: Data,
    /,
    *,
    start: Annotated[Place, Parameter(name="--from")],
    end: Annotated[Place, Parameter(name="--to")],
    by: SightOptions | None = None,
    point_crs: PointCrs = None,
    json: Json = False,
    options: HeightOptions | None = None,
) -> None:
    """Tell whether one place is seen from another, how far apart they are, and what is in the way.

    Parameters
    ----------
    start
        Where the eye is.
    end
        What is looked at.
    """
    eye = by or SightOptions()
    with _asked(data, options) as (queries, _):
        line = queries.line_of_sight([*start, eye.height], [*end, eye.target_height], crs=point_crs, **eye.light())
    found: dict[str, Any] = {
        "visible": bool(line.visible),
        "known": bool(line.known),
        "distance": float(line.distance),
        "obstacle": None if np.isnan(line.obstacle).any() else line.obstacle.tolist(),
    }
    console.show(found, json)


def viewshed(
    data: Data,
    /,
    *,
    at: Place,
    output: Output,
    by: SightOptions | None = None,
    radius: float | None = None,
    point_crs: PointCrs = None,
    overwrite: Overwrite = False,
    json: Json = False,
    options: HeightOptions | None = None,
) -> None:
    """Write what is seen from a place as a GeoTIFF: 1 seen, 0 hidden, 255 (nodata) no data or beyond the radius.

    Parameters
    ----------
    at
        Where the eye is.
    output
        File to write (.tif).
    radius
        Metres from the eye beyond which nothing is looked at. [default: all of the data]
    """
    eye = by or SightOptions()

    def seen(queries: Queries) -> list[Field]:
        above: dict[str, Any] = {"height": eye.height, "target_height": eye.target_height}
        return [queries.viewshed(at, radius=radius, crs=point_crs, **above, **eye.light())]

    _write(output, overwrite, data, options, seen, SEEN, json)


def shadow(
    data: Data,
    /,
    *,
    sun: Sun,
    output: Output,
    overwrite: Overwrite = False,
    json: Json = False,
    options: HeightOptions | None = None,
) -> None:
    """Write where the sun shines as a GeoTIFF: 1 lit, 0 in the shadow of terrain, 255 (nodata) no data.

    Parameters
    ----------
    sun
        Azimuth of the sun, clockwise from grid north, and its elevation above the horizon, in degrees.
    output
        File to write (.tif).
    """
    _write(output, overwrite, data, options, lambda queries: [queries.shadow(sun)], LIT, json)


def slope(
    data: Data,
    /,
    *,
    output: Output,
    unit: Literal["degrees", "percent"] = "degrees",
    aspect: Flag = False,
    overwrite: Overwrite = False,
    json: Json = False,
    options: HeightOptions | None = None,
) -> None:
    """Write how steep the terrain is as a GeoTIFF of float32; NaN (nodata) where there is no data.

    Parameters
    ----------
    output
        File to write (.tif).
    unit
        Unit of the slope.
    aspect
        Add a second band: where the terrain falls to, degrees clockwise from grid north.
    """

    def fields(queries: Queries) -> list[Field]:
        return [queries.slope(unit), *([queries.aspect()] if aspect else [])]

    _write(output, overwrite, data, options, fields, {}, json)


@contextlib.contextmanager
def _asked(data: str, options: HeightOptions | None) -> Iterator[tuple[Queries, console.Report]]:
    """The queries of a raster, with its pyramid built."""
    from orogen.terrain import open_terrain

    with (
        console.progress() as report,
        open_terrain(data, **asdict(options or HeightOptions()), progress=report) as terrain,
    ):
        yield terrain.queries, report


def _write(
    output: Path,
    overwrite: bool,
    data: str,
    options: HeightOptions | None,
    fields: Callable[[Queries], list[Field]],
    names: dict[str, int],
    json: bool,
) -> None:
    """Write fields as a GeoTIFF; tell the file, and how many samples of the first field have the named values."""
    from orogen.cli.geotiff import SUFFIXES, write_fields
    from orogen.view.output import check_output

    check_output(output, SUFFIXES, overwrite)
    with _asked(data, options) as (queries, report):
        counts = write_fields(output, fields(queries), report, overwrite)[0]
    found = {name: counts.get(value, 0) for name, value in names.items()}
    lines = [str(output), *(f"{name}  {count}" for name, count in found.items())]
    console.show({"file": str(output), **found}, json, lines)
