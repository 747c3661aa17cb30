"""`orogen export`: triangles or heights for other programs."""

from __future__ import annotations

from orogen.cli import console
from orogen.cli.options import DrapedOptions
from orogen.cli.parameters import Bounds, Data, Json, Output, Overwrite


def export(
    data: Data,
    /,
    *,
    output: Output,
    bounds: Bounds | None = None,
    max_triangles: int | None = None,
    base: float | None = None,
    overwrite: Overwrite = False,
    json: Json = False,
    options: DrapedOptions | None = None,
) -> None:
    """Write a part of a terrain as triangles (.glb, .obj, .stl, .ply) or as heights (.tif).

    Parameters
    ----------
    output
        File to write; its suffix says what.
    bounds
        Left, bottom, right, top of the part, in the data's CRS. [default: everything]
    max_triangles
        Triangles at most; coarser samples are taken until there are no more. [default: 1000000]
    base
        Make a solid to print: walls, and a flat bottom so many metres below the lowest point.
    """
    from orogen import export as room
    from orogen.cli.terrain import open_terrain
    from orogen.errors import SettingsError
    from orogen.view.output import check_output

    check_output(output, (*room.MESHES, *room.RASTERS), overwrite)
    raster = output.suffix.lower() in room.RASTERS
    if raster and (base is not None or max_triangles is not None):
        raise SettingsError("--base and --max-triangles: expected a file of triangles with them, got a raster")
    with console.progress() as report, open_terrain(data, options, None, report) as terrain:
        report(0.5, f"writing {output.name}")
        if raster:
            room.write_heights(output, terrain, bounds, overwrite=overwrite)
            facts = {}
        else:
            mesh = room.mesh_of(terrain, bounds, room.MAX_TRIANGLES if max_triangles is None else max_triangles)
            if base is not None:
                mesh = room.with_base(mesh, base)
            room.write_mesh(output, mesh, crs=terrain.crs, overwrite=overwrite)
            facts = {"triangles": len(mesh.triangles), "spacing": mesh.spacing, "origin": mesh.origin}
    console.show({"file": str(output), **facts}, json, [str(output)])
