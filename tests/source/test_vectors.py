"""Vector files drawn over heights, against shapely's areas and distances."""

from __future__ import annotations

import json
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from rasterio.warp import transform

import orogen
from orogen.errors import SourceError
from orogen.grid import Grid
from orogen.keys import level_count, level_shape
from orogen.source.arrays import ArraySamples
from orogen.source.heights import HeightSource
from orogen.source.scale import ground_scale, parse_crs
from orogen.source.values import Values
from orogen.source.vectors import FINER, open_vectors
from orogen.source.vectorstyle import VectorLayer, VectorStyle, parse_layer

pyogrio = pytest.importorskip("pyogrio")

UTM = Grid(150, 100, (30.0, 0.0, 400_000.0, 0.0, -30.0, 3_800_000.0), "EPSG:32611")
ROTATED = Grid(120, 90, (24.0, 10.0, 400_000.0, 8.0, -20.0, 3_800_000.0), "EPSG:32611")
DEGREES = Grid(
    150, 100, (1 / 3600, 0.0, 121.0, 0.0, -1 / 3600, 60.0), "EPSG:4326",
    ground_scale(parse_crs("EPSG:4326"), 121.02, 59.98, 1 / 3600),
)  # fmt: skip
RED = (255, 0, 0)


def write(path: Path, *features: tuple[Any, dict[str, Any]]) -> Path:
    """GeoJSON of geometries and their properties."""
    items: list[dict[str, Any]] = [
        {"type": "Feature", "properties": says, "geometry": json.loads(shapely.to_geojson(shape))}
        for shape, says in features
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": items}))
    return path


def stored(path: Path, shape: Any, crs: str | None, layer: str = "one") -> Path:
    """A GeoPackage or Shapefile of one geometry."""
    pyogrio.raw.write(
        path, np.array([shapely.to_wkb(shape)], object), [], [], crs=crs, layer=layer,
        geometry_type=shape.geom_type, append=path.exists(),
    )  # fmt: skip
    return path


def at(grid: Grid, u: float, v: float) -> tuple[float, float]:
    """CRS coordinates of parts of a grid's width and height."""
    x, y = grid.to_crs(u * grid.width, v * grid.height)
    return float(x), float(y)


def geographic(grid: Grid, places: list[tuple[float, float]]) -> list[tuple[float, float]]:
    x, y = zip(*(at(grid, *place) for place in places), strict=True)
    return list(zip(*transform(parse_crs(grid.crs or ""), parse_crs("EPSG:4326"), x, y), strict=True))


def drawn(path: Path, grid: Grid = UTM, level: int = 0, **style: Any) -> NDArray[np.uint8]:
    source = open_vectors([VectorLayer(path, style=VectorStyle(**style))], grid, None)
    rows, cols = level_shape(source.grid.shape, level)
    return source.levels.read(level, slice(0, rows), slice(0, cols))


STAR = [(0.5 + r * math.cos(a), 0.5 + r * math.sin(a)) for a, r in
        ((k * math.pi / 7, 0.42 if k % 2 else 0.2) for k in range(14))]  # fmt: skip
BEND = [(0.1, 0.2), (0.45, 0.8), (0.6, 0.25), (0.93, 0.7)]


@pytest.mark.parametrize("level", [0, 2, 4])
def test_polygons_cover_what_their_area_says(tmp_path: Path, level: int) -> None:
    hole = [(0.5 + 0.1 * math.cos(a), 0.5 + 0.1 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 9)[:-1]]
    polygon = shapely.Polygon([at(UTM, *p) for p in STAR], [[at(UTM, *p) for p in hole]])
    path = stored(tmp_path / "a.gpkg", polygon, UTM.crs)
    image = drawn(path, level=level, fill_opacity=1.0, color="red", width=1e-6)
    rows, cols = image.shape[:2]
    step = 2**level / FINER
    x, y = UTM.to_crs(*np.meshgrid(np.arange(cols + 1) * step, np.arange(rows + 1) * step))
    texels = shapely.box(x[1:, :-1], y[1:, :-1], x[:-1, 1:], y[:-1, 1:])
    part = shapely.area(shapely.intersection(texels, polygon)) / shapely.area(texels)
    off = np.abs(image[..., 3] / 255 - part)
    assert off.max() < 0.2
    assert off.mean() < 0.004
    assert abs(image[..., 3].sum() / 255 - part.sum()) < 0.01 * part.sum()
    np.testing.assert_array_equal(image[image[..., 3] > 0][:, :3], np.broadcast_to(RED, ((image[..., 3] > 0).sum(), 3)))


@pytest.mark.parametrize("grid", [UTM, ROTATED, DEGREES], ids=["utm", "rotated", "degrees"])
def test_lines_are_as_wide_as_they_are_on_the_ground(tmp_path: Path, grid: Grid) -> None:
    """Each texel is in or out by its distance in true metres; the file is in degrees, the heights may be in metres."""
    path = write(tmp_path / "a.geojson", (shapely.LineString(geographic(grid, BEND)), {}))
    width = 150.0
    image = drawn(path, grid, width=width)
    rows, cols = image.shape[:2]
    tx, ty = np.meshgrid((np.arange(cols) + 0.5) / FINER, (np.arange(rows) + 0.5) / FINER)
    metres = np.array(grid.metres)
    # straight in the file's CRS: as many points as matter, laid one by one
    along = [
        (1 - t) * np.array(a) + t * np.array(b)
        for a, b in zip(geographic(grid, BEND)[:-1], geographic(grid, BEND)[1:], strict=True)
        for t in np.linspace(0, 1, 16)
    ]
    lon, lat = zip(*along, strict=True)
    x, y = transform(parse_crs("EPSG:4326"), parse_crs(grid.crs or ""), lon, lat)
    line = shapely.LineString(np.stack(grid.to_texel(x, y), axis=1) @ metres.T)
    centres = np.stack([tx, ty], axis=-1) @ metres.T
    distance = shapely.distance(shapely.points(centres), line)
    texel = np.abs(metres).sum() / FINER / 2
    alpha = image[..., 3]
    assert (alpha[distance < width / 2 - 0.75 * texel] == 255).all()
    assert (alpha[distance > width / 2 + 0.75 * texel] == 0).all()
    assert 0.985 < alpha.sum() / 255 / ((distance < width / 2).sum()) < 1.015


@pytest.mark.parametrize("grid", [UTM, ROTATED], ids=["utm", "rotated"])
def test_any_window_of_any_level_is_a_part_of_the_whole(tmp_path: Path, grid: Grid) -> None:
    random = np.random.default_rng(5)
    shapes: list[tuple[Any, dict[str, Any]]] = []
    for kind in (shapely.LineString, shapely.Polygon, shapely.MultiPoint):
        for _ in range(8):
            places = [tuple(p) for p in random.uniform(-0.2, 1.2, (5, 2))]
            shapes.append((kind(geographic(grid, places)), {"stroke-width": float(random.uniform(0.1, 9))}))
    source = open_vectors([write(tmp_path / "a.geojson", *shapes)], grid, None)
    for level in range(level_count(source.grid.shape)):
        rows, cols = level_shape(source.grid.shape, level)
        whole = source.levels.read(level, slice(0, rows), slice(0, cols)).astype(int)
        assert (whole[..., 3] > 0).mean() > 0.1
        for _ in range(12):
            (r0, r1), (c0, c1) = (np.sort(random.choice(n + 1, 2, replace=False)) for n in (rows, cols))
            part = source.levels.read(level, slice(r0, r1), slice(c0, c1)).astype(int)
            off = np.abs(part - whole[r0:r1, c0:c1]).max(axis=-1)
            # where a stroke is cut its round pieces may turn by less than one of sixteen places
            assert (off > 0).mean() < 0.01
            assert (off <= 48).all()


def test_thin_lines_grow_fainter_with_the_distance_but_do_not_vanish(tmp_path: Path) -> None:
    path = write(tmp_path / "a.geojson", (shapely.LineString(geographic(UTM, BEND)), {}))
    ink = [drawn(path, level=level, width=10.0)[..., 3].sum() * 4.0**level for level in range(5)]
    np.testing.assert_allclose(ink, ink[0], rtol=0.06)


def test_points_are_discs(tmp_path: Path) -> None:
    path = write(tmp_path / "a.geojson", (shapely.Point(geographic(UTM, [(0.4, 0.6)])[0]), {"marker-color": "0000ff"}))
    image = drawn(path, width=20.0)
    area = image[..., 3].sum() / 255 * (UTM.spacing / FINER) ** 2
    assert area == pytest.approx(math.pi * 60**2, rel=0.02)
    y, x = np.nonzero(image[..., 3])
    assert (x.mean() + 0.5, y.mean() + 0.5) == pytest.approx((0.4 * 150 * FINER, 0.6 * 100 * FINER), abs=0.5)
    assert (image[y, x, :3] == (0, 0, 255)).all()


def test_features_say_how_they_look_unless_a_style_does(tmp_path: Path) -> None:
    square = shapely.Polygon(geographic(UTM, [(0.2, 0.2), (0.8, 0.2), (0.8, 0.8), (0.2, 0.8)]))
    says = {"fill": "#00ff00", "fill-opacity": 0.5, "stroke": "blue", "stroke-width": "4", "stroke-opacity": None}
    path = write(tmp_path / "a.geojson", (square, says))
    image = drawn(path)
    rows, cols = image.shape[:2]
    assert tuple(image[rows // 2, cols // 2]) == (0, 255, 0, 128)
    assert tuple(image[rows // 2, cols // 5]) == (0, 0, 255, 255)
    edge = (image[rows // 2, : cols // 2, :3] == (0, 0, 255)).all(axis=1).sum() * UTM.spacing / FINER
    assert edge == pytest.approx(2 * UTM.spacing, abs=UTM.spacing / 2)
    image = drawn(path, color="#ff0000", fill_opacity=0.0, width=300.0)
    assert image[rows // 2, cols // 2, 3] == 0
    assert tuple(image[rows // 2, cols // 5]) == (*RED, 255)


def test_odd_features_are_drawn_or_passed_over(tmp_path: Path) -> None:
    tie = shapely.Polygon(geographic(UTM, [(0.2, 0.2), (0.8, 0.8), (0.8, 0.2), (0.2, 0.8)]))
    world = shapely.box(-179, -89, 179, 89)
    everything = shapely.GeometryCollection([tie, shapely.MultiPoint(geographic(UTM, [(0.5, 0.1), (0.5, 0.9)]))])
    image = drawn(
        write(tmp_path / "a.geojson", (shapely.LineString(), {}), (everything, {}), (shapely.Polygon(), {})),
        color="red",
    )
    rows, cols = image.shape[:2]
    alpha = image[..., 3]
    assert alpha[rows // 2, cols // 4] > 0
    assert alpha[rows // 4, cols // 2] == 0
    assert alpha[rows // 10, cols // 2] == alpha[rows * 9 // 10, cols // 2] == 255
    image = drawn(write(tmp_path / "b.geojson", (world, {"fill-opacity": 1})))
    assert (image[..., 3] == 255).all()


def test_layers_and_files_lie_on_each_other_in_order(tmp_path: Path) -> None:
    square = shapely.Polygon([at(UTM, *p) for p in [(0.2, 0.2), (0.8, 0.2), (0.8, 0.8), (0.2, 0.8)]])
    path = stored(stored(tmp_path / "a.gpkg", square, UTM.crs, "fields"), square.boundary, UTM.crs, "roads").name
    style = VectorStyle(color="#123456", fill_opacity=1.0)
    both = open_vectors([VectorLayer(tmp_path / path, style=style)], UTM, None)
    roads = open_vectors([VectorLayer(tmp_path / path, "roads", style)], UTM, None)
    middle = slice(200, 201), slice(300, 301)
    assert both.read(*middle)[0, 0, 3] == 255
    assert roads.read(*middle)[0, 0, 3] == 0
    over = write(tmp_path / "b.geojson", (shapely.box(-179, -89, 179, 89), {"fill": "#fff", "fill-opacity": 1}))
    stack = open_vectors([VectorLayer(tmp_path / path, style=style), over], UTM, None)
    assert tuple(stack.read(*middle)[0, 0]) == (255, 255, 255, 255)
    with pytest.raises(SourceError, match="no layer 'tracks'; expected one of fields, roads"):
        open_vectors([VectorLayer(tmp_path / path, "tracks")], UTM, None)


def test_a_file_without_a_crs_lies_in_that_of_the_heights(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    line = shapely.LineString([at(UTM, 0.1, 0.5), at(UTM, 0.9, 0.5)])
    with caplog.at_level(logging.WARNING, "orogen"):
        image = drawn(stored(tmp_path / "a.shp", line, None, "a"))
    assert "names no CRS" in caplog.text
    assert image[200, 300, 3] == 255
    with caplog.at_level(logging.WARNING, "orogen"):
        far = drawn(write(tmp_path / "far.geojson", (shapely.Point(12, 50), {})))
    assert "nothing in it lies over the terrain" in caplog.text
    assert not far.any()


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.geojson").write_text('{"type": "FeatureColl')
    for path in (tmp_path / "a.geojson", tmp_path / "none.gpkg"):
        with pytest.raises(SourceError, match=path.name):
            open_vectors([path], UTM, None)
    with pytest.raises(SourceError, match="expected paths of vector files"):
        open_vectors([3], UTM, None)
    for wrong in ({"color": "reddish"}, {"width": 0.0}, {"width": math.inf}, {"fill_opacity": 1.5}):
        with pytest.raises(SourceError, match=next(iter(wrong))):
            VectorStyle(**wrong)


def test_the_words_of_the_command_line() -> None:
    assert parse_layer("a,b.gpkg,layer=roads,color=#ff0000,width=12.5,fill_opacity=0") == VectorLayer(
        "a,b.gpkg", "roads", VectorStyle("#ff0000", 12.5, 0.0)
    )
    assert parse_layer("C:/a=b.shp") == VectorLayer("C:/a=b.shp")
    with pytest.raises(SourceError, match="expected a number as width, got 'wide'"):
        parse_layer("a.gpkg,width=wide")


@pytest.mark.parametrize("size", [(100, 150), (37, 53), (800, 1200)], ids=["alike", "coarse", "fine"])
def test_an_image_shows_below_at_every_level(tmp_path: Path, size: tuple[int, int]) -> None:
    random = np.random.default_rng(2)
    photo = random.integers(0, 256, (*size, 3), np.uint8)
    path = write(tmp_path / "a.geojson", (shapely.LineString([(600, 900), (3900, 2100)]), {"stroke": "#00ff00"}))
    heights = random.normal(size=(100, 150)).astype(np.float32)
    with (
        orogen.open(heights, spacing=30, color=photo, build="wait") as plain,
        orogen.open(heights, spacing=30, color=photo, overlay=path, build="wait") as terrain,
    ):
        assert terrain.colors is not None
        assert plain.colors is not None
        ratio = terrain.colors.grid.width // plain.colors.grid.width
        finer = ratio.bit_length() - 1
        assert ratio == 2**finer
        assert terrain.colors.grid.spacing <= max(30 / FINER * 1.01, plain.colors.grid.spacing)
        assert terrain.colors.built
        above = open_vectors([path], plain.grid, plain.colors.source)
        for level in range(terrain.colors.level_count):
            rows, cols = level_shape(terrain.colors.grid.shape, level)
            image = terrain.colors.read(level, slice(0, rows), slice(0, cols))
            ink = above.levels.read(level, slice(0, rows), slice(0, cols))[..., 3]
            assert (image[..., 3] == 255).all()
            np.testing.assert_array_equal(image[ink == 255], np.broadcast_to((0, 255, 0, 255), image[ink == 255].shape))
            if level >= finer:
                below = plain.colors.read(level - finer, slice(0, rows), slice(0, cols))
                np.testing.assert_array_equal(image[ink == 0], below[ink == 0])
        # between texels the image goes on as the GPU shows it: at the middle of four texels their mean
        image = terrain.colors.read(0, slice(0, 4 * ratio), slice(0, 4 * ratio)).astype(float)
        if ratio > 1:
            mean = photo[:4, :4].astype(float)[1:3, 1:3].mean(axis=(0, 1))
            inner = image[2 * ratio - 1 : 2 * ratio + 1, 2 * ratio - 1 : 2 * ratio + 1, :3].mean(axis=(0, 1))
            np.testing.assert_allclose(inner, mean, atol=1.0)


def test_attribution_goes_from_the_data_to_the_terrain(tmp_path: Path) -> None:
    import rasterio

    for name, credit in (("dem.tif", "Survey of Hills"), ("photo.tif", "Aerial  Co.")):
        with rasterio.open(
            tmp_path / name, "w", driver="GTiff", width=20, height=10, count=1, dtype="uint8", crs="EPSG:32611",
            transform=rasterio.transform.from_origin(4e5, 3.8e6, 30, 30),
        ) as dataset:  # fmt: skip
            dataset.write(np.arange(200, dtype=np.uint8).reshape(1, 10, 20))
            dataset.update_tags(TIFFTAG_COPYRIGHT=credit)
    path = write(tmp_path / "a.geojson", (shapely.Point(geographic(UTM, [(0.1, 0.05)])[0]), {}))
    with orogen.open(tmp_path / "dem.tif", color=tmp_path / "photo.tif", overlay=path) as terrain:
        assert terrain.attribution == "Survey of Hills; Aerial Co."
    with orogen.open(tmp_path / "dem.tif", attribution="me") as terrain:
        assert terrain.attribution == "me"
    assert HeightSource(
        grid=UTM, name="array", dtype="float32", samples=ArraySamples(np.zeros((100, 150))), values=Values()
    ).attribution == ""  # fmt: skip
