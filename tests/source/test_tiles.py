"""Heights and colours in map tiles: single images, folders and templates, against the rasters they were cut from."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from PIL import Image
from rasterio.crs import CRS
from rasterio.transform import from_origin
from rasterio.warp import transform
from scipy.interpolate import RegularGridInterpolator

from orogen.errors import SettingsError, SourceError
from orogen.source import open_colour, open_height
from orogen.source.contract import overviews_of
from orogen.source.packed import recognised
from rasters import everything
from source.web import Site, serve

ZOOM = 12
WEST, NORTH = 3429, 1673
"""Tile near Hualien, Taiwan, at zoom 12."""
SIZE = 256
ENCODINGS = {"terrain-rgb": (0.1, -10_000.0), "terrarium": (1 / 256, -32_768.0)}


def ground(rows: int, cols: int) -> NDArray[np.float64]:
    """Metres in steps of 0.1 of a mountain by the sea."""
    y, x = np.indices((rows, cols))
    return np.round(900 + 800 * np.sin(x / 90) * np.cos(y / 70) + x / 3, 1)


def encoded(heights: NDArray[np.float64], encoding: str) -> NDArray[np.uint8]:
    """(rows, columns, 3) of metres."""
    scale, offset = ENCODINGS[encoding]
    number = np.rint((heights - offset) / scale).astype(np.int64)
    return np.stack([number >> 16 & 255, number >> 8 & 255, number & 255], axis=-1).astype(np.uint8)


def image(pixels: NDArray[np.uint8], suffix: str = "png") -> bytes:
    stream = io.BytesIO()
    options: dict[str, Any] = {"lossless": True} if suffix == "webp" else {}
    Image.fromarray(pixels).save(stream, {"jpg": "JPEG"}.get(suffix, suffix.upper()), **options)
    return stream.getvalue()


def tree(
    heights: NDArray[np.float64], encoding: str, suffix: str = "png", zooms: int = 3, south: bool = False
) -> dict[str, bytes]:
    """Tiles by name z/x/y.suffix of heights whose first sample is that of tile (WEST, NORTH) at ZOOM."""
    files = {}
    for drop in range(zooms):
        level = heights[:: 2**drop, :: 2**drop]
        left, top = WEST * SIZE // 2**drop, NORTH * SIZE // 2**drop
        for y in range(top // SIZE, -(-(top + level.shape[0]) // SIZE)):
            for x in range(left // SIZE, -(-(left + level.shape[1]) // SIZE)):
                tile = np.full((SIZE, SIZE), np.nan)
                r, c = top - y * SIZE, left - x * SIZE
                part = level[max(0, -r) : SIZE - r, max(0, -c) : SIZE - c]
                tile[max(0, r) : max(0, r) + part.shape[0], max(0, c) : max(0, c) + part.shape[1]] = part
                known = np.isfinite(tile)
                pixels = np.where(known[..., None], encoded(np.where(known, tile, 0), encoding), 0).astype(np.uint8)
                z = ZOOM - drop
                row = 2**z - 1 - y if south else y
                files[f"{z}/{x}/{row}.{suffix}"] = image(
                    np.dstack([pixels, np.where(known, 255, 0).astype(np.uint8)]), suffix
                )
    return files


def write(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def corner(x: int, y: int, zoom: int) -> tuple[float, float]:
    """Longitude and latitude of the upper left corner of a tile."""
    latitude = math.degrees(math.atan(math.sinh(math.pi * (1 - 2 * y / 2**zoom))))
    return x / 2**zoom * 360 - 180, latitude


@pytest.fixture
def heights() -> NDArray[np.float64]:
    return ground(2 * SIZE, 3 * SIZE)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("named", [True, False])
def test_a_single_image_is_recognised(tmp_path: Path, encoding: str, named: bool) -> None:
    data = ground(200, 300)
    (tmp_path / "tile.png").write_bytes(image(encoded(data, encoding)))
    source = open_height(tmp_path / "tile.png", spacing=30, encoding=encoding if named else None)
    np.testing.assert_allclose(everything(source), data, atol=ENCODINGS[encoding][0] / 2 + 1e-3)


def test_the_real_tile_is_terrain_rgb(data_dir: Path) -> None:
    with rasterio.open(data_dir / "fuji_terrainrgb_512.png") as dataset:
        bands = dataset.read()
    red, green, blue = bands[:3].astype(np.float64)
    assert recognised(bands) == "terrain-rgb"
    source = open_height(data_dir / "fuji_terrainrgb_512.png", spacing=30)
    np.testing.assert_allclose(everything(source), -10_000 + (red * 65536 + green * 256 + blue) * 0.1, atol=1e-3)


def test_the_real_heights_in_terrarium_are_recognised_and_pictures_are_not(data_dir: Path) -> None:
    with rasterio.open(data_dir / "bigtujunga_30m_utm.tif") as dataset:
        real = dataset.read(1, window=((100, 500), (200, 900))).astype(np.float64)
    assert recognised(np.moveaxis(encoded(real, "terrarium"), 2, 0)) == "terrarium"
    with rasterio.open(data_dir / "puget_texture_1k.png") as dataset:
        assert recognised(dataset.read()) is None
    random = np.random.default_rng(3)
    noise = random.integers(100, 160, (3, 64, 64)).astype(np.uint8)
    smooth = np.repeat((128 + 20 * np.sin(np.indices((64, 64))[0] / 9))[None], 3, axis=0).astype(np.uint8)
    assert recognised(noise) is None
    assert recognised(smooth) is None


def test_a_picture_needs_its_encoding(tmp_path: Path) -> None:
    (tmp_path / "photo.png").write_bytes(image(np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)))
    with pytest.raises(SourceError, match=r"photo\.png: a picture of 3 band.*encoding="):
        open_height(tmp_path / "photo.png", spacing=30)
    with pytest.raises(SettingsError, match="encoding: expected 'terrain-rgb' or 'terrarium', got 'rgb'"):
        open_height(tmp_path / "photo.png", spacing=30, encoding="rgb")


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("suffix", ["png", "webp"])
def test_a_folder_is_one_raster_at_its_place(
    tmp_path: Path, heights: NDArray[np.float64], encoding: str, suffix: str
) -> None:
    source = open_height(write(tmp_path, tree(heights, encoding, suffix)))
    assert source.grid.shape == heights.shape
    np.testing.assert_allclose(everything(source), heights, atol=0.06 if encoding == "terrain-rgb" else 0.003)
    assert source.direct
    left, bottom, right, top = source.grid.bounds
    for (x, y), place in (((WEST, NORTH), (left, top)), ((WEST + 3, NORTH + 2), (right, bottom))):
        (east,), (north,) = transform(CRS.from_epsg(4326), CRS.from_epsg(3857), *[[v] for v in corner(x, y, ZOOM)])
        assert place == pytest.approx((east, north), abs=1e-3)
    assert source.grid.crs == "EPSG:3857"


def test_windows_and_overviews(tmp_path: Path, heights: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orogen.source.survey.IN_MEMORY", 0)
    source = open_height(write(tmp_path, tree(heights, "terrain-rgb")))
    for window in ((slice(0, 1), slice(0, 1)), (slice(250, 260), slice(500, 530)), (slice(300, 512), slice(0, 768))):
        np.testing.assert_allclose(source.read(*window), heights[window], atol=0.06)
    for shape in ((512, 768), (256, 384), (130, 200), (100, 100), (3, 5)):
        rows, cols = ((np.arange(n) + 0.5) * m / n for n, m in zip(shape, heights.shape, strict=True))
        near = np.abs(source.overview(shape) - ground_at(rows, cols))
        assert near.max() < 4 * max(heights.shape[0] / shape[0], heights.shape[1] / shape[1]) * 11.5
    coarser = overviews_of(source)
    assert [overview.shape for overview in coarser] == [(256, 384), (128, 192)]
    for step, overview in zip((2, 4), coarser, strict=True):
        part = overview.read(slice(0, overview.shape[0]), slice(0, overview.shape[1]))
        np.testing.assert_allclose(part, heights[::step, ::step], atol=0.06)
    source.close()


def ground_at(rows: NDArray[np.float64], cols: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same ground between samples."""
    y, x = np.meshgrid(rows - 0.5, cols - 0.5, indexing="ij")
    return 900 + 800 * np.sin(x / 90) * np.cos(y / 70) + x / 3


def test_missing_tiles_are_nodata(tmp_path: Path, heights: NDArray[np.float64]) -> None:
    files = tree(heights, "terrain-rgb", zooms=1)
    del files[f"{ZOOM}/{WEST + 1}/{NORTH}.png"]
    source = open_height(write(tmp_path, files))
    expected = heights.copy()
    expected[:SIZE, SIZE : 2 * SIZE] = np.nan
    np.testing.assert_allclose(everything(source), expected, atol=0.06)
    assert not source.covered


def test_zoom_area_and_a_change(tmp_path: Path, heights: NDArray[np.float64]) -> None:
    write(tmp_path, tree(heights, "terrain-rgb"))
    coarse = open_height(tmp_path, zoom=ZOOM - 1)
    known = np.isfinite(everything(coarse))
    np.testing.assert_allclose(everything(coarse)[known], heights[::2, ::2].ravel(), atol=0.06)
    west, north = corner(WEST + 1, NORTH + 1, ZOOM)
    east, south = corner(WEST + 2, NORTH + 2, ZOOM)
    part = open_height(tmp_path, area=(west + 1e-6, south + 1e-6, east - 1e-6, north - 1e-6))
    np.testing.assert_allclose(everything(part), heights[SIZE:, SIZE : 2 * SIZE], atol=0.06)
    before = open_height(tmp_path).fingerprint
    assert open_height(tmp_path).fingerprint == before
    write(tmp_path, tree(heights + 500, "terrain-rgb", zooms=1))
    assert open_height(tmp_path).fingerprint != before
    with pytest.raises(SourceError, match=r"no tile of zoom 5; there are \[10, 11, 12\]"):
        open_height(tmp_path, zoom=5)
    with pytest.raises(SourceError, match="no tile of zoom 12 lies in the area"):
        open_height(tmp_path, area=(0, 0, 1, 1))
    with pytest.raises(SettingsError, match="area: expected"):
        open_height(tmp_path, area=(1, 0, 0, 1))
    with pytest.raises(SettingsError, match="zoom= and area= are for trees of map tiles"):
        open_height(np.zeros((4, 4)), zoom=3)


def test_rows_from_the_south(tmp_path: Path, heights: NDArray[np.float64]) -> None:
    write(tmp_path, tree(heights, "terrain-rgb", south=True))
    by_template = open_height(f"{tmp_path}/{{z}}/{{x}}/{{-y}}.png")
    np.testing.assert_allclose(everything(by_template), heights, atol=0.06)
    (tmp_path / "tilemapresource.xml").write_text("<TileMap/>")
    by_file = open_height(tmp_path)
    assert by_file.grid == by_template.grid
    np.testing.assert_array_equal(everything(by_file), everything(by_template))


def test_another_order_of_folders(tmp_path: Path, heights: NDArray[np.float64]) -> None:
    files = {}
    for name, data in tree(heights, "terrain-rgb").items():
        z, x, y = name.removesuffix(".png").split("/")
        files[f"z{z}/row{y}_{x}.png"] = data
    write(tmp_path, files)
    np.testing.assert_allclose(everything(open_height(f"{tmp_path}/z{{z}}/row{{y}}_{{x}}.png")), heights, atol=0.06)
    with pytest.raises(SourceError, match=r"expected \{z\}, \{x\} and \{y\}"):
        open_height(f"{tmp_path}/{{z}}/{{x}}.png")


def test_what_is_no_tile_of_heights_is_refused(tmp_path: Path, heights: NDArray[np.float64]) -> None:
    lossy = tmp_path / "lossy"
    photo = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3), np.uint8)
    write(lossy, {f"3/1/{y}.jpg": image(photo, "jpg") for y in range(2)})
    with pytest.raises(SourceError, match=r"1\.jpg: JPEG does not keep heights exactly|0\.jpg: JPEG does not"):
        open_height(lossy)
    with pytest.raises(SourceError, match="look like pictures, expected packed heights; give encoding="):
        open_height(write(tmp_path / "photos", {"3/1/1.png": image(photo)}))
    mixed = tree(heights, "terrain-rgb", zooms=1)
    mixed[f"{ZOOM}/{WEST}/{NORTH}.png"] = image(encoded(ground(512, 512), "terrain-rgb"))
    with pytest.raises(SourceError, match=r"of 256 x 256 pixels, got 512 x 512|of 512 x 512 pixels, got"):
        everything(open_height(write(tmp_path / "mixed", mixed)))
    broken = tree(heights, "terrain-rgb", zooms=1)
    broken[f"{ZOOM}/{WEST}/{NORTH}.png"] = broken[f"{ZOOM}/{WEST}/{NORTH}.png"][:300]
    with pytest.raises(SourceError, match=rf"{NORTH}\.png: cannot be read as an image"):
        everything(open_height(write(tmp_path / "broken", broken)))


def test_tiles_of_512_pixels(tmp_path: Path) -> None:
    data = ground(512, 512)
    source = open_height(write(tmp_path, {f"{ZOOM}/{WEST}/{NORTH}.png": image(encoded(data, "terrarium"))}))
    assert source.grid.shape == (512, 512)
    np.testing.assert_allclose(everything(source), data, atol=0.003)


def test_another_crs_is_warped_bilinearly(tmp_path: Path, heights: NDArray[np.float64]) -> None:
    source = open_height(write(tmp_path, tree(heights, "terrarium")), crs="EPSG:32651")
    assert source.grid.crs == "EPSG:32651"
    plain = open_height(tmp_path)
    rows, cols = source.grid.shape
    x, y = source.grid.to_crs(*np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5))
    moved = transform(CRS.from_epsg(32651), CRS.from_epsg(3857), x.ravel(), y.ravel())
    tx, ty = plain.grid.to_texel(*moved)
    at = np.arange(heights.shape[0]) + 0.5, np.arange(heights.shape[1]) + 0.5
    expected = RegularGridInterpolator(at, everything(plain), bounds_error=False)(np.stack([ty, tx], axis=-1))
    expected = expected.reshape(rows, cols)
    found = everything(source)
    inside = np.isfinite(expected)
    assert inside.mean() > 0.8
    np.testing.assert_allclose(found[inside], expected[inside], atol=0.01)
    assert np.isfinite(found).mean() < inside.mean() + 0.01  # half of a sample around the edge
    window = slice(100, 300), slice(203, 333)
    np.testing.assert_allclose(source.read(*window), found[window], atol=1e-4)


@pytest.fixture
def site(heights: NDArray[np.float64], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("GDAL_HTTP_MAX_RETRY", "1")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    files = {f"/t/{name}?key=s3cret": data for name, data in tree(heights, "terrarium").items()}
    files |= {
        f"/q?z={z}&x={x}&y={y[:-4]}": data
        for n, data in tree(heights, "terrarium").items()
        for z, x, y in [n.split("/")]
    }
    with serve(Site(files)) as running:
        yield running


def area() -> tuple[float, float, float, float]:
    west, north = corner(WEST, NORTH, ZOOM)
    east, south = corner(WEST + 3, NORTH + 2, ZOOM)
    return west + 1e-6, south + 1e-6, east - 1e-6, north - 1e-6


@pytest.mark.parametrize("form", ["t/{z}/{x}/{y}.png?key=s3cret", "q?z={z}&x={x}&y={y}"])
def test_a_template_of_a_server(site: Site, heights: NDArray[np.float64], form: str) -> None:
    template = f"{site.url}/{form}"
    source = open_height(template, zoom=ZOOM, area=area())
    np.testing.assert_allclose(everything(source), heights, atol=0.003)
    assert "s3cret" not in source.name
    source.close()
    asked = len(site.requests)
    again = open_height(template, zoom=ZOOM, area=area())
    np.testing.assert_allclose(everything(again), heights, atol=0.003)
    assert len(site.requests) == asked  # kept on disk
    again.close()


def test_faults_of_a_server(site: Site, heights: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orogen.source.survey.IN_MEMORY", 0)
    template = f"{site.url}/t/{{z}}/{{x}}/{{y}}.png?key=s3cret"
    source = open_height(template, zoom=ZOOM, area=area())
    source.close()
    site.fault = lambda request, count: 500
    missing = site.files.pop(f"/t/{ZOOM}/{WEST}/{NORTH + 1}.png?key=s3cret")
    assert missing
    with pytest.raises(SourceError, match=rf"{WEST}/{NORTH + 1}\.png\?\.\.\.: the server answers 500"):
        source.read(slice(SIZE, 2 * SIZE), slice(0, SIZE))
    site.fault = lambda request, count: None
    assert np.isnan(source.read(slice(SIZE, 2 * SIZE), slice(0, SIZE))).all()  # 404: there is no tile
    source.close()
    with pytest.raises(SourceError, match="expected the zoom of the tiles; give zoom="):
        open_height(template)
    with pytest.raises(SourceError, match=r"at zoom 12 is 16777216 tiles; give area="):
        open_height(template, zoom=12)
    with pytest.raises(SourceError, match="there is no tile at zoom 3 there"):
        open_height(template, zoom=3)


def test_colours_are_laid_over_heights(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    photo = random.integers(0, 255, (2 * SIZE, 3 * SIZE, 3), np.uint8)
    files = {
        f"{ZOOM}/{WEST + x}/{NORTH + y}.jpg": image(photo[y * SIZE : (y + 1) * SIZE, x * SIZE : (x + 1) * SIZE], "jpg")
        for y in range(2)
        for x in range(3)
    }
    write(tmp_path / "photo", files)
    heights = open_height(write(tmp_path / "heights", tree(ground(512, 768), "terrarium")))
    colours = open_colour(tmp_path / "photo", heights)
    assert colours.grid == heights.grid
    pixels = everything(colours)
    assert (pixels[..., 3] == 255).all()
    stored = np.asarray(Image.open(io.BytesIO(files[f"{ZOOM}/{WEST + 1}/{NORTH}.jpg"])))
    np.testing.assert_array_equal(pixels[:SIZE, SIZE : 2 * SIZE, :3], stored)
    (x,), (y,) = transform(CRS.from_epsg(4326), CRS.from_epsg(32651), *[[v] for v in corner(WEST + 1, NORTH + 1, ZOOM)])
    profile = {"driver": "GTiff", "count": 1, "height": 200, "width": 200, "dtype": "float32", "crs": "EPSG:32651"}
    with rasterio.open(
        tmp_path / "utm.tif", "w", **profile, transform=from_origin(x - 3000, y + 3000, 30, 30)
    ) as dataset:
        dataset.write(np.ones((200, 200), np.float32), 1)
    warped = open_colour(tmp_path / "photo", open_height(tmp_path / "utm.tif"))
    assert warped.grid.crs == "EPSG:32651"
    tx, ty = warped.grid.to_texel(x, y)
    window = warped.read(slice(int(ty) - 5, int(ty) + 5), slice(int(tx) - 5, int(tx) + 5))
    assert (window[..., 3] == 255).all()
