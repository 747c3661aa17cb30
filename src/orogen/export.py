"""Parts of a terrain for other programs: triangles as glTF, OBJ, STL or PLY, heights as GeoTIFF."""

from __future__ import annotations

import logging
import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import OutputError, SettingsError
from orogen.keys import level_shape
from orogen.pyramid.contract import Pyramid
from orogen.terrain import Terrain
from orogen.view.output import publish
from orogen.view.renderer import Picture

log = logging.getLogger("orogen")

MESHES = (".glb", ".obj", ".stl", ".ply")
"""Suffixes of files of triangles."""
RASTERS = (".tif", ".tiff")
"""Suffixes of files of heights."""
MAX_TRIANGLES = 1_000_000
"""Triangles of an exported mesh at most, unless told otherwise."""
TEXTURE = 4096
"""Pixels, at most, along a side of the image of a mesh."""
STRIP = 4096
"""Rows that are written at once."""

Bounds = tuple[float, float, float, float]


@dataclass(frozen=True)
class Mesh:
    """Triangles of a part of a terrain, in metres around its middle."""

    vertices: NDArray[np.float32]
    """(n, 3) metres east, north and up from `origin`."""
    triangles: NDArray[np.int32]
    """(m, 3) numbers of vertices, counterclockwise seen from above."""
    texture: NDArray[np.float32]
    """(n, 2) places in `image`: 0 to 1 from its left, 0 to 1 from its lower edge."""
    image: NDArray[np.uint8] | None
    """(rows, columns, 4) sRGB and alpha, or None."""
    origin: tuple[float, float, float]
    """x, y in the data's CRS of the middle, and the height 0 of the data's own vertical reference."""
    spacing: float
    """Metres between neighbouring samples that were taken."""


def visible_bounds(picture: Picture) -> Bounds:
    """(left, bottom, right, top) in CRS units of what a picture shows. Raises SettingsError where that is only sky."""
    x, y = picture.position[..., 0], picture.position[..., 1]
    if not np.isfinite(x).any():
        raise SettingsError("expected a picture that shows terrain, got only sky")
    return float(np.nanmin(x)), float(np.nanmin(y)), float(np.nanmax(x)), float(np.nanmax(y))


def mesh_of(terrain: Terrain, bounds: Bounds | None = None, max_triangles: int = MAX_TRIANGLES) -> Mesh:
    """The triangles of a part of a terrain, from samples of the finest level that needs no more than are allowed.

    bounds: (left, bottom, right, top) in CRS units; None: everything. Samples without data make holes.
    Raises SettingsError where bounds do not meet the data.
    """
    if max_triangles < 2:
        raise SettingsError(f"max_triangles: expected at least 2, got {max_triangles}")
    pyramid = terrain.heights
    level, rows, cols = _window(pyramid, bounds, max_triangles)
    quads = (rows.stop - rows.start - 1) * (cols.stop - cols.start - 1)
    # small data have no level that is coarse enough: some of its samples, then
    nth = max(1, math.ceil(math.sqrt(2 * quads / max_triangles)))
    heights = pyramid.read(level, rows, cols)[::nth, ::nth]
    grid = pyramid.grid
    tx, ty = ((np.arange(part.start, part.stop, nth) + 0.5) * 2**level for part in (cols, rows))
    middle = float(tx[0] + tx[-1]) / 2, float(ty[0] + ty[-1]) / 2
    east, north = np.einsum("ij,jrc->irc", grid.metres, np.stack(np.meshgrid(tx - middle[0], ty - middle[1])))
    triangles = _triangles(np.isfinite(heights), bool(np.linalg.det(grid.metres) < 0))
    if not len(triangles):
        raise SettingsError("expected bounds with four neighbouring samples that have data, got none")
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices = np.stack([east, north, heights], axis=-1).reshape(-1, 3)[used].astype(np.float32)
    texture, image = _image(terrain, tx, ty, used)
    x, y = grid.to_crs(*middle)
    return Mesh(vertices, triangles.reshape(-1, 3).astype(np.int32), texture, image, (float(x), float(y), 0.0),
                grid.spacing * 2**level * nth)  # fmt: skip


def with_base(mesh: Mesh, thickness: float) -> Mesh:
    """A solid for a printer: the mesh, walls along its borders, a flat bottom `thickness` m below its lowest point."""
    if not (math.isfinite(thickness) and thickness > 0):
        raise SettingsError(f"base: expected more than 0 metres, got {thickness:g}")
    count = len(mesh.vertices)
    below = mesh.vertices.copy()
    below[:, 2] = mesh.vertices[:, 2].min() - thickness
    edges = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    codes = edges[:, 0].astype(np.int64) * count + edges[:, 1]
    # an edge that no neighbour runs through the other way is a border
    border = edges[~np.isin(codes, edges[:, 1].astype(np.int64) * count + edges[:, 0])]
    a, b = border.T
    walls = np.concatenate([np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)])
    solid = np.concatenate([mesh.triangles, walls, mesh.triangles[:, ::-1] + count]).astype(np.int32)
    return Mesh(
        np.concatenate([mesh.vertices, below]), solid, np.concatenate([mesh.texture] * 2), mesh.image, mesh.origin,
        mesh.spacing,
    )  # fmt: skip


def write_mesh(path: str | os.PathLike[str], mesh: Mesh, *, crs: str | None = None, overwrite: bool = False) -> None:
    """Write a mesh as .glb, .obj, .stl or .ply; what the origin is stands in the file where the format has room.

    glTF has y up (x east, z south), the others z up. Images are kept in .glb only. Raises OutputError where the file
    cannot be written or trimesh is not installed.
    """
    try:
        import trimesh
    except ImportError as error:
        raise OutputError("writing meshes needs trimesh; pip install 'orogen[mesh]'") from error

    with publish(path, MESHES, overwrite) as temporary:
        kind = temporary.suffix.lower()
        vertices = mesh.vertices[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32) if kind == ".glb" else mesh.vertices
        visual: Any = None
        if kind == ".glb" and mesh.image is not None:
            from PIL import Image

            material = trimesh.visual.material.PBRMaterial(
                baseColorTexture=Image.fromarray(mesh.image), metallicFactor=0.0, roughnessFactor=1.0
            )
            visual = trimesh.visual.TextureVisuals(uv=mesh.texture, material=material)
        note = {"origin": list(mesh.origin), "crs": crs, "spacing": mesh.spacing}
        made: Any = trimesh.Trimesh(vertices, mesh.triangles, visual=visual, process=False, metadata=note)
        if kind == ".glb":
            scene: Any = trimesh.Scene(made, metadata=note)
            temporary.write_bytes(scene.export(file_type="glb"))
        elif kind == ".obj":
            header = f"metres east, north, up of x {mesh.origin[0]!r}, y {mesh.origin[1]!r}, {crs or 'no CRS'}"
            temporary.write_text(made.export(file_type="obj", header=header))
        else:
            temporary.write_bytes(made.export(file_type=kind[1:]))


def write_heights(
    path: str | os.PathLike[str], terrain: Terrain, bounds: Bounds | None = None, *, overwrite: bool = False
) -> None:
    """Write the samples of level 0 within bounds (CRS units; None: all) as a tiled GeoTIFF of float32 metres.

    Raises OutputError where the file cannot be written, SettingsError where bounds do not meet the data.
    """
    import rasterio

    pyramid = terrain.heights
    _, rows, cols = _window(pyramid, bounds, None)
    a, b, c, d, e, f = pyramid.grid.transform
    corner = c + a * cols.start + b * rows.start, f + d * cols.start + e * rows.start
    profile: dict[str, Any] = {
        "driver": "GTiff", "width": cols.stop - cols.start, "height": rows.stop - rows.start, "count": 1,
        "dtype": "float32", "nodata": float("nan"), "crs": terrain.crs, "tiled": True, "blockxsize": 256,
        "blockysize": 256, "compress": "deflate", "predictor": 3, "BIGTIFF": "IF_SAFER",
        "transform": rasterio.Affine(a, b, corner[0], d, e, corner[1]),
    }  # fmt: skip
    with publish(path, RASTERS, overwrite) as temporary, rasterio.open(temporary, "w", **profile) as file:
        file.units = ("metre",)
        for start in range(rows.start, rows.stop, STRIP):
            part = slice(start, min(start + STRIP, rows.stop))
            window = ((start - rows.start, part.stop - rows.start), (0, cols.stop - cols.start))
            file.write(pyramid.read(0, part, cols), 1, window=window)


def _window(pyramid: Pyramid, bounds: Bounds | None, max_triangles: int | None) -> tuple[int, slice, slice]:
    """Level, rows and columns whose sample centres lie within bounds."""
    grid = pyramid.grid
    left, bottom, right, top = bounds or grid.bounds
    if not (all(map(math.isfinite, (left, bottom, right, top))) and left < right and bottom < top):
        raise SettingsError(f"bounds: expected left < right and bottom < top, got {(left, bottom, right, top)}")
    tx, ty = grid.to_texel([left, right, left, right], [bottom, bottom, top, top])
    fitting: tuple[int, slice, slice] | None = None
    for level in range(pyramid.level_count):
        spans = []
        for places, count in zip((ty, tx), grid.shape, strict=True):
            # the surface ends at the outermost samples of level 0
            low, high = max(0.5, float(places.min())), min(count - 0.5, float(places.max()))
            first, last = math.ceil(low / 2**level - 0.5), math.floor(high / 2**level - 0.5)
            spans.append(slice(first, max(first, last + 1)))
        rows, cols = spans
        quads = (rows.stop - rows.start - 1) * (cols.stop - cols.start - 1)
        if rows.stop - rows.start < 2 or cols.stop - cols.start < 2:
            break
        fitting = level, rows, cols
        if max_triangles is None or 2 * quads <= max_triangles:
            break
    if fitting:
        return fitting
    raise SettingsError(
        f"bounds: expected a part of {tuple(float(v) for v in grid.bounds)} with at least 2 x 2 samples, got "
        f"{(left, bottom, right, top)}"
    )


def _triangles(valid: NDArray[np.bool_], flipped: bool) -> NDArray[np.int64]:
    """(m, 3) numbers of samples, row by row, of the triangles of cells with four valid corners."""
    whole = valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]
    row, column = np.nonzero(whole)
    width = valid.shape[1]
    upper, lower = row * width + column, (row + 1) * width + column
    # rows run south where the geotransform mirrors, north elsewhere
    ccw = np.concatenate([np.stack([upper, lower, upper + 1], 1), np.stack([upper + 1, lower, lower + 1], 1)])
    return ccw if flipped else ccw[:, ::-1]


def _image(
    terrain: Terrain, tx: NDArray[np.float64], ty: NDArray[np.float64], used: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.uint8] | None]:
    """Texture places of the used samples, and the draped image over them."""
    columns, rows = (places.ravel()[used] for places in np.meshgrid(tx, ty))
    colors = terrain.colors
    if colors is None:
        return np.zeros((len(used), 2), np.float32), None
    own_x, own_y = colors.grid.to_texel(*terrain.grid.to_crs(columns, rows))
    for level in range(colors.level_count):
        shape = level_shape(colors.grid.shape, level)
        spans = [
            slice(
                min(count - 1, max(0, math.floor(float(places.min()) / 2**level))),
                max(1, min(count, math.ceil(float(places.max()) / 2**level))),
            )
            for places, count in zip((own_y, own_x), shape, strict=True)
        ]
        high, wide = (span.stop - span.start for span in spans)
        if max(high, wide) <= TEXTURE:
            break
    image = colors.read(level, *spans)
    u = (own_x / 2**level - spans[1].start) / wide
    v = 1 - (own_y / 2**level - spans[0].start) / high
    return np.stack([u, v], 1).astype(np.float32), image
