"""Beyond 2**31 samples: addresses are right, and what is empty costs next to nothing."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.windows import Window

from orogen.pyramid import build_pyramid, open_pyramid
from orogen.source import open_height
from orogen.source.sparse import certainly_empty

SIDE = 70_000


@pytest.fixture(scope="module")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[tuple[int, int], np.ndarray]]:
    """4.9e9 samples, a few blocks of which are there."""
    path = tmp_path_factory.mktemp("huge") / "sparse.tif"
    rng = np.random.default_rng(1)
    blocks = {}
    with rasterio.open(
        path, "w", driver="GTiff", width=SIDE, height=SIDE, count=1, dtype="int16", nodata=-32768, tiled=True,
        blockxsize=512, blockysize=512, sparse_ok=True, bigtiff="yes", compress="zstd", crs="EPSG:3857",
        transform=rasterio.Affine(10, 0, 0, 0, -10, 0),
    ) as dataset:  # fmt: skip
        for place in ((0, 0), (35_328, 34_816), (69_632, 69_632), (69_632, 512), (512, 69_632), (40_960, 8_192)):
            size = [min(512, SIDE - start) for start in place]
            blocks[place] = rng.integers(0, 3000, size).astype(np.int16)
            dataset.write(blocks[place], 1, window=Window(place[1], place[0], size[1], size[0]))
    return path, blocks


def test_empty_windows_are_known(sparse: tuple[Path, dict[tuple[int, int], np.ndarray]]) -> None:
    path, _ = sparse
    with_data = open_height(path)
    assert not certainly_empty(with_data, slice(0, 2048), slice(0, 2048))
    assert certainly_empty(with_data, slice(2048, 4096), slice(2048, 4096))
    assert not certainly_empty(with_data, slice(69_999, 70_000), slice(69_999, 70_000))
    assert not certainly_empty(open_height(path, nodata=-1), slice(2048, 4096), slice(2048, 4096))


def test_a_sparse_raster_of_5e9_samples(sparse: tuple[Path, dict[tuple[int, int], np.ndarray]], tmp_path: Path) -> None:
    path, blocks = sparse
    start = time.process_time()
    built = build_pyramid(path, tmp_path / "out.zarr")
    seconds = time.process_time() - start
    assert built.size < 60_000_000
    assert seconds < 90  # of processors, for 9.8 GB of samples: far less than reading them takes
    with open_pyramid(open_height(tmp_path / "out.zarr")) as pyramid:
        assert pyramid.grid.shape == (SIDE, SIDE)
        for (row, col), block in blocks.items():
            rows, cols = slice(row, row + block.shape[0]), slice(col, col + block.shape[1])
            np.testing.assert_array_equal(pyramid.read(0, rows, cols), block)
            for level in (1, 5):
                n = 2**level
                means = block[: block.shape[0] // n * n, : block.shape[1] // n * n].astype(np.float64)
                means = means.reshape(means.shape[0] // n, n, means.shape[1] // n, n).mean(axis=(1, 3))
                part = slice(row // n, row // n + means.shape[0]), slice(col // n, col // n + means.shape[1])
                np.testing.assert_allclose(pyramid.read(level, *part), means, atol=1e-2)
                bounds = pyramid.node_bounds(0)
                assert bounds is not None
                assert bounds[row // 256, col // 256, 0] == block[:256, :256].min()
        assert np.isnan(pyramid.read(0, slice(30_000, 30_100), slice(60_000, 60_100))).all()
        top = pyramid.level_count - 1
        shape = -(-SIDE // 2**top)
        coverage = pyramid.read_coverage(top, slice(0, shape), slice(0, shape))
        assert coverage[0, 0] > 0
        assert (coverage > 0).sum() < 200
