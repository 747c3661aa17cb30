"""Rasters over HTTP and from object stores, against the same file read locally, on a server that misbehaves."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.io import MemoryFile
from rasterio.transform import from_origin

import orogen
from orogen.errors import SourceError
from orogen.source import Source, cache, open_colour, open_height
from source.web import Request, Site, serve

SHAPE = (2304, 2048)
UTM = {"crs": "EPSG:32633", "transform": from_origin(500_000, 5_000_000, 30, 30)}


def relief() -> NDArray[np.int16]:
    """Hills with noise, so that it does not compress away, and a lake of nodata."""
    y, x = np.indices(SHAPE)
    noise = np.random.default_rng(1).integers(0, 16, SHAPE)
    heights = (1000 + 300 * np.sin(x / 90) * np.cos(y / 70) + noise).astype(np.int16)
    heights[900:1300, 700:1200] = -32768
    return heights


def cog(data: NDArray[Any], **options: Any) -> bytes:
    """A COG of one band in memory."""
    profile = {"driver": "GTiff", "count": 1, "height": data.shape[0], "width": data.shape[1], "dtype": data.dtype}
    with MemoryFile() as plain, MemoryFile(ext=".tif") as result:
        with plain.open(**profile, **UTM, nodata=-32768) as dataset:
            dataset.write(data, 1)
        with plain.open() as dataset:
            rasterio.shutil.copy(dataset, result.name, driver="COG", blocksize=256, compress="DEFLATE", **options)
        return bytes(result.read())


@pytest.fixture(scope="module")
def data() -> NDArray[np.int16]:
    return relief()


@pytest.fixture(scope="module")
def file(data: NDArray[np.int16]) -> bytes:
    return cog(data)


@pytest.fixture
def site(file: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    """A server with a COG at /dem.tif; caches of its own, and no proxy between."""
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("GDAL_HTTP_MAX_RETRY", "1")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serve(Site({"/dem.tif": file})) as running:
        yield running


def whole(source: Source) -> NDArray[Any]:
    rows, cols = source.grid.shape
    return source.read(slice(0, rows), slice(0, cols))


def truth(data: NDArray[np.int16]) -> NDArray[np.float32]:
    return np.where(data == -32768, np.nan, data).astype(np.float32)


def failing(kind: int | str) -> Any:
    """A fault of every request."""
    return lambda request, count: kind


def test_opening_and_a_first_overview_take_few_requests_and_bytes(site: Site, file: bytes) -> None:
    source = open_height(f"{site.url}/dem.tif")
    assert len(site.requests) <= 5
    source.overview((288, 256))
    assert len(site.requests) <= 8
    assert all(request.method == "GET" and request.range for request in site.requests)
    assert site.sent < 0.3 * len(file)
    source.close()


def test_samples_are_those_of_the_file(site: Site, data: NDArray[np.int16], tmp_path: Path, file: bytes) -> None:
    local = tmp_path / "dem.tif"
    local.write_bytes(file)
    source, same = open_height(f"{site.url}/dem.tif"), open_height(local)
    assert source.grid == same.grid
    assert not source.direct
    np.testing.assert_array_equal(source.overview((288, 256)), same.overview((288, 256)))
    np.testing.assert_array_equal(whole(source), truth(data))
    source.close()
    np.testing.assert_array_equal(source.read(slice(5, 9), slice(0, 3)), truth(data)[5:9, :3])  # opened again
    source.close()


def test_threads_read_side_by_side(site: Site, data: NDArray[np.int16]) -> None:
    source, expected = open_height(f"{site.url}/dem.tif"), truth(data)

    def windows(seed: int) -> None:
        random = np.random.default_rng(seed)
        for _ in range(12):
            row, col = random.integers(0, 1700, 2)
            window = slice(row, row + 300), slice(col, col + 300)
            np.testing.assert_array_equal(source.read(*window), expected[window])

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(windows, range(6)))
    assert site.sent < 1.5 * len(site.files["/dem.tif"])
    source.close()


def test_blocks_are_kept_on_disk_and_shown_by_the_cache(site: Site, data: NDArray[np.int16]) -> None:
    first = open_height(f"{site.url}/dem.tif")
    whole(first)
    first.close()
    assert [entry.path.name.startswith("dem-remote-") for entry in cache.info().entries] == [True]
    asked = len(site.requests)
    again = open_height(f"{site.url}/dem.tif")
    np.testing.assert_array_equal(whole(again), truth(data))
    assert len(site.requests) == asked + 1  # is it still the same file?
    assert again.fingerprint == first.fingerprint
    assert cache.clear() == 0  # in use
    again.close()
    assert cache.clear() > 0
    assert not cache.info().entries


def test_the_budget_of_the_cache_holds(site: Site, data: NDArray[np.int16], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OROGEN_CACHE_MAX", "3MB")
    source = open_height(f"{site.url}/dem.tif")
    assert len(site.files["/dem.tif"]) > 3.5e6
    for row in range(0, SHAPE[0], 256):
        part = slice(row, row + 256), slice(0, SHAPE[1])
        np.testing.assert_array_equal(source.read(*part), truth(data)[part])
    source.close()
    assert 0 < cache.info().size < 3e6


def test_a_damaged_block_on_disk_is_fetched_again(site: Site, data: NDArray[np.int16]) -> None:
    source = open_height(f"{site.url}/dem.tif")
    whole(source)
    source.close()
    database = sqlite3.connect(cache.info().entries[0].path / "blocks.sqlite")
    with database:
        database.execute("UPDATE block SET data = zeroblob(length(data)) WHERE number > 3")
    database.close()
    source = open_height(f"{site.url}/dem.tif")
    np.testing.assert_array_equal(whole(source), truth(data))
    source.close()


def test_without_the_disk_it_reads_all_the_same(site: Site, data: NDArray[np.int16], tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("not a folder")
    source = open_height(f"{site.url}/dem.tif")
    np.testing.assert_array_equal(whole(source), truth(data))
    source.close()


CAUSES = [
    (403, "403|privileges|Forbidden"),
    (404, "no such file; check the address"),
    (416, "empty or changed on the server"),
    (500, "500"),
    (503, "503"),
    ("drop", "; check the network"),
    ("cut", "; check the network"),
]


@pytest.mark.parametrize(("kind", "cause"), CAUSES)
def test_a_fault_in_opening_is_one_error(site: Site, kind: int | str, cause: str) -> None:
    site.fault = failing(kind)
    with pytest.raises(SourceError, match=rf"^{site.url}/dem\.tif: .*({cause})"):
        open_height(f"{site.url}/dem.tif")


@pytest.mark.parametrize("kind", [404, 403, 500, "drop", "cut"])
def test_a_fault_in_reading_is_one_error_and_passes(site: Site, data: NDArray[np.int16], kind: int | str) -> None:
    source = open_height(f"{site.url}/dem.tif")
    site.fault = failing(kind)
    for _ in range(2):
        with pytest.raises(SourceError, match=rf"^{site.url}/dem\.tif: "):
            whole(source)
    site.fault = failing(None)  # type: ignore[arg-type]
    np.testing.assert_array_equal(whole(source), truth(data))
    source.close()


@pytest.mark.parametrize("kind", [500, 503, 429, "drop", "cut"])
def test_a_passing_fault_is_tried_again(site: Site, data: NDArray[np.int16], kind: int | str) -> None:
    seen: set[Any] = set()

    def once(request: Request, count: int) -> int | str | None:
        last = request.range and request.range[1]  # what was cut off is asked for from where it ended
        known = last in seen
        seen.add(last)
        return None if known else kind

    site.fault = once
    source = open_height(f"{site.url}/dem.tif")
    np.testing.assert_array_equal(whole(source), truth(data))
    source.close()


def test_a_server_that_stops_is_given_up(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GDAL_HTTP_TIMEOUT", "0.5")
    site.fault = failing("slow")
    start = time.perf_counter()
    with pytest.raises(SourceError, match="check the network"):
        open_height(f"{site.url}/dem.tif")
    assert time.perf_counter() - start < 30 * len(site.requests), "the server would have gone on after 30 s"


def test_no_server_is_one_error(site: Site) -> None:
    with serve(Site({})) as gone:
        pass
    with pytest.raises(SourceError, match=rf"^{gone.url}/dem\.tif: .*check the network"):
        open_height(f"{gone.url}/dem.tif")


def test_a_server_without_ranges_is_refused(site: Site) -> None:
    site.ranges = False
    with pytest.raises(SourceError, match="ignores range requests; download the file"):
        open_height(f"{site.url}/dem.tif")


def test_a_file_that_changes_meanwhile_is_refused(site: Site, data: NDArray[np.int16]) -> None:
    source = open_height(f"{site.url}/dem.tif")
    fingerprint = source.fingerprint
    site.etag, site.files["/dem.tif"] = '"2"', cog((data // 2).astype(np.int16))
    with pytest.raises(SourceError, match=r"changed on the server.*; open it again"):
        whole(source)
    source.close()
    with pytest.raises(SourceError, match="changed on the server since it was opened"):
        whole(source)
    anew = open_height(f"{site.url}/dem.tif")
    assert anew.fingerprint != fingerprint
    np.testing.assert_array_equal(whole(anew), truth((data // 2).astype(np.int16)))
    anew.close()


def test_without_a_version_nothing_is_kept(site: Site, data: NDArray[np.int16]) -> None:
    site.etag = None
    source = open_height(f"{site.url}/dem.tif")
    assert source.fingerprint is None
    np.testing.assert_array_equal(whole(source), truth(data))
    assert not cache.info().entries
    source.close()


def test_a_file_cut_off_or_of_another_kind_is_refused(site: Site, file: bytes) -> None:
    site.files["/cut.tif"] = file[: len(file) * 2 // 3]
    with pytest.raises(SourceError, match=rf"^{site.url}/cut\.tif: "):
        whole(open_height(f"{site.url}/cut.tif"))
    site.files["/page.tif"] = b"<html>please log in</html>"
    with pytest.raises(SourceError, match=r"page\.tif: cannot be read as a raster"):
        open_height(f"{site.url}/page.tif")
    site.files["/empty.tif"] = b""
    with pytest.raises(SourceError, match=r"empty\.tif: is empty"):
        open_height(f"{site.url}/empty.tif")


def test_a_key_in_the_address_is_sent_but_not_shown(site: Site, file: bytes) -> None:
    site.files["/a%20b.tif?key=s3cret&x=%2F"] = file
    source = open_height(f"{site.url}/a%20b.tif?key=s3cret&x=%2F")
    assert source.name == f"{site.url}/a%20b.tif?..."
    site.fault = failing(403)
    with pytest.raises(SourceError) as caught:
        whole(source)
    assert "s3cret" not in str(caught.value)
    assert "s3cret" not in str(cache.info().entries[0].path)


def test_object_stores(site: Site, file: bytes, data: NDArray[np.int16], monkeypatch: pytest.MonkeyPatch) -> None:
    site.files["/bucket/folder/dem.tif"] = file
    monkeypatch.setenv("AWS_S3_ENDPOINT", site.url.removeprefix("http://"))
    monkeypatch.setenv("AWS_HTTPS", "NO")
    monkeypatch.setenv("AWS_NO_SIGN_REQUEST", "YES")
    source = open_height("s3://bucket/folder/dem.tif")
    assert source.name == "s3://bucket/folder/dem.tif"
    np.testing.assert_array_equal(whole(source), truth(data))
    source.close()
    with pytest.raises(SourceError, match=r"s3://bucket/none\.tif: no such file"):
        open_height("s3://bucket/none.tif")
    with pytest.raises(SourceError, match="expected s3://bucket/path"):
        open_height("s3://bucket")


@pytest.mark.parametrize(
    ("url", "place", "endpoint"),
    [
        ("gs://bucket/dem.tif", "/bucket/dem%2Etif", "GOOGLE_BASE_URL"),
        ("az://box/dem.tif", "/box/dem.tif", "AZURE_STORAGE_ENDPOINT"),
        ("abfs://box@account.dfs.core.windows.net/dem.tif", "/box/dem.tif", "AZURE_STORAGE_ENDPOINT"),
    ],
)
def test_other_object_stores(site: Site, monkeypatch: pytest.MonkeyPatch, url: str, place: str, endpoint: str) -> None:
    """A small file, which is read whole, and all of it through the store."""
    small = relief()[:300, :400]
    site.files[place] = cog(small)
    site.modified = "Mon, 23 Nov 2026 08:00:00 GMT"
    monkeypatch.setenv(endpoint, site.url)
    monkeypatch.setenv("GS_NO_SIGN_REQUEST", "YES")
    monkeypatch.setenv("AZURE_NO_SIGN_REQUEST", "YES")
    if url.startswith("az"):
        with pytest.raises(SourceError, match=r"az://box/dem\.tif: .*set AZURE_STORAGE_ACCOUNT"):
            open_height(url)
        monkeypatch.setenv("AZURE_STORAGE_ACCOUNT", "account")
    source = open_height(url)
    assert source.name == url
    np.testing.assert_array_equal(source.read(slice(0, 300), slice(0, 400)), small)
    source.close()
    asked = [request.path for request in site.requests]
    assert set(asked) == {place}
    assert len(asked) <= 5, "read once, by the store alone"
    with pytest.raises(SourceError, match=rf"{url.replace('dem', 'none')}: no such file"):
        open_height(url.replace("dem", "none"))


def test_names_of_gdal_are_left_to_gdal(site: Site, data: NDArray[np.int16]) -> None:
    source = open_height(f"/vsicurl/{site.url}/dem.tif")
    np.testing.assert_array_equal(source.read(slice(0, 9), slice(0, 9)), truth(data)[:9, :9])
    assert not [request for request in site.requests if request.path != "/dem.tif"]
    source.close()


def test_a_vrt_reads_the_files_beside_it(site: Site, data: NDArray[np.int16], tmp_path: Path, file: bytes) -> None:
    (tmp_path / "dem.tif").write_bytes(file)
    with rasterio.open(tmp_path / "dem.tif") as dataset:
        rasterio.shutil.copy(dataset, tmp_path / "all.vrt", driver="VRT")
    site.files["/all.vrt"] = (tmp_path / "all.vrt").read_bytes()
    source = open_height(f"{site.url}/all.vrt")
    np.testing.assert_array_equal(source.read(slice(0, 99), slice(7, 99)), truth(data)[:99, 7:99])
    source.close()


def test_a_remote_image_is_draped(site: Site, tmp_path: Path) -> None:
    pixels = np.random.default_rng(2).integers(0, 255, (3, 64, 64), np.uint8)
    profile = {"driver": "GTiff", "count": 3, "height": 64, "width": 64, "dtype": "uint8", "photometric": "RGB"}
    with rasterio.open(tmp_path / "image.tif", "w", **profile, **UTM) as dataset:
        dataset.write(pixels)
    site.files["/image.tif"] = (tmp_path / "image.tif").read_bytes()
    heights = open_height(f"{site.url}/dem.tif")
    colours = open_colour(f"{site.url}/image.tif", heights)
    np.testing.assert_array_equal(whole(colours)[..., :3], np.moveaxis(pixels, 0, 2))
    heights.close()


def test_a_picture_needs_a_part_of_the_file(site: Site, file: bytes, tmp_path: Path) -> None:
    (tmp_path / "dem.tif").write_bytes(file)
    with orogen.open(tmp_path / "dem.tif") as terrain:
        expected = terrain.render(size=(160, 90), samples=1).depth
    with orogen.open(f"{site.url}/dem.tif") as terrain:
        found = terrain.render(size=(160, 90), samples=1).depth
        assert site.sent < 0.6 * len(file)
    assert (np.isfinite(expected) == np.isfinite(found)).mean() > 0.99
    both = np.isfinite(expected) & np.isfinite(found)
    assert np.median(np.abs(expected[both] / found[both] - 1)) < 1e-3
