"""Map tiles of a local server as colours over heights in another CRS: where they land, and that they are kept."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rasterio.warp import transform

import orogen
from orogen.grid import Grid
from orogen.source.arrays import ArraySamples
from orogen.source.heights import HeightSource
from orogen.source.open import open_colour
from orogen.source.scale import ground_scale, parse_crs
from orogen.source.tiles import EDGE
from orogen.source.values import Values
from source.web import Site, serve

ZOOM = 13
"""The coarsest zoom that is as fine as 15 m at 34 degrees."""
SCALE = parse_crs("EPSG:32611")
GRID = Grid(
    200, 160, (15.0, 0.0, 400_000.0, 0.0, -15.0, 3_800_000.0), "EPSG:32611",
    ground_scale(SCALE, 401_500.0, 3_798_800.0, 15.0),
)  # fmt: skip


def tile(x: int, y: int) -> bytes:
    """Red is the pixels to the middle of a tile along a row, green along a column."""
    i, j = np.meshgrid(x * 256 + np.arange(256), y * 256 + np.arange(256))
    bands = [np.abs(axis % 256 - 128) for axis in (i, j)]
    stream = io.BytesIO()
    Image.fromarray(np.dstack([*bands, 0 * i]).astype(np.uint8)).save(stream, "PNG")
    return stream.getvalue()


FORMS = [
    "t/{z}/{x}/{y}.png",
    "wmts/1.0.0/layer/default/{TileMatrix}/{TileRow}/{TileCol}.png",
    "wmts?SERVICE=WMTS&REQUEST=GetTile&TILEMATRIX={tilematrix}&TILEROW={tilerow}&TILECOL={tilecol}",
]


@pytest.mark.parametrize("form", FORMS, ids=["xyz", "rest", "kvp"])
def test_colours_land_where_they_belong_and_are_kept(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    path = form
    for name, field in (("{TileMatrix}", "{z}"), ("{TileRow}", "{y}"), ("{TileCol}", "{x}")):
        path = path.replace(name, field).replace(name.lower(), field)
    heights = HeightSource(
        grid=GRID, name="array", dtype="float32", samples=ArraySamples(np.zeros(GRID.shape, np.float32)),
        values=Values(),
    )  # fmt: skip
    lon, lat = transform(GRID.crs, "EPSG:4326", *zip(GRID.bounds[:2], GRID.bounds[2:], strict=True))
    west, east = (int((v + 180) / 360 * 2**ZOOM) for v in lon)
    mercator = transform("EPSG:4326", "EPSG:3857", lon, lat)[1]
    south, north = (int((EDGE - v) / (2 * EDGE) * 2**ZOOM) for v in mercator)
    files = {
        "/" + path.format(z=ZOOM, x=x, y=y): tile(x, y)
        for x in range(west - 1, east + 2)
        for y in range(north - 1, south + 2)
    }
    asked: list[int] = []
    with serve(Site(files)) as site:
        for _ in range(2):
            source = open_colour(f"{site.url}/{form}", heights)
            rows, cols = source.grid.shape
            image = source.read(slice(0, rows), slice(0, cols))
            source.close()
            asked.append(len(site.requests))
    assert 0 < asked[0] == asked[1]
    assert source.grid.crs == GRID.crs
    i, j = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    x, y = (np.array(v) for v in transform(GRID.crs, "EPSG:3857", *(v.ravel() for v in source.grid.to_crs(i, j))))
    pixel = 2 * EDGE / (2**ZOOM * 256)
    east_px, south_px = ((x + EDGE) / pixel).reshape(rows, cols), ((EDGE - y) / pixel).reshape(rows, cols)
    tx, ty = GRID.to_texel(*source.grid.to_crs(i, j))
    inside = (tx > 0) & (tx < GRID.width) & (ty > 0) & (ty < GRID.height)
    assert (image[inside][:, 3] == 255).all()
    for band, place in enumerate((east_px, south_px)):
        # away from the turning points the colour is the place
        straight = inside & (np.abs((place - 0.5) % 128 - 64) < 60)
        wanted = np.abs((place - 0.5) % 256 - 128)
        off = np.abs(image[..., band] - wanted)[straight]
        assert straight.sum() > 10_000
        assert off.max() < 0.6  # of a pixel: rounding, and a little bent between knots


def test_a_terrain_names_whose_tiles_it_shows(tmp_path: Path) -> None:
    with orogen.open(np.zeros((20, 20), np.float32), spacing=10, attribution="(c) Mapmakers") as terrain:
        assert terrain.attribution == "(c) Mapmakers"
