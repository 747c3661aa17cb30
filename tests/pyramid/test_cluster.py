"""The same build on the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from orogen.errors import SettingsError
from orogen.pyramid import build_pyramid, update_pyramid
from rasters import TILED, write

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Two worker processes."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize("layout", [TILED, {"blockysize": 300}])
def test_a_cluster_gives_the_bytes_that_threads_give(address: str, tmp_path: Path, layout: dict[str, object]) -> None:
    rng = np.random.default_rng(1)
    data = rng.normal(900, 200, (2100, 400)).astype(np.float32)
    data[5:90, 40:99] = np.nan
    dem = write(tmp_path / "dem.tif", data, **layout)
    image = write(
        tmp_path / "image.tif", rng.integers(0, 256, (3, 300, 300)).astype(np.uint8), photometric="RGB", **TILED
    )
    options = {"color": image, "max_error": 0.3}
    build_pyramid(dem, tmp_path / "threads.zarr", **options)
    seen: list[float] = []
    build_pyramid(
        dem, tmp_path / "cluster.zarr", scheduler=address, report=lambda part, text: seen.append(part), **options
    )
    assert tree(tmp_path / "cluster.zarr") == tree(tmp_path / "threads.zarr")
    assert seen[-1] == 1
    data[2080, 390] += 50
    write(dem, data, **layout)
    built = update_pyramid(dem, tmp_path / "cluster.zarr", color=image, scheduler=address)
    assert built.layers["height"]["regions"] == 1
    build_pyramid(dem, tmp_path / "again.zarr", **options)
    assert tree(tmp_path / "cluster.zarr") == tree(tmp_path / "again.zarr")


def test_what_other_processes_cannot_open_is_refused(address: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="array: cannot be sent to other processes; save it to a file"):
        build_pyramid(np.zeros((10, 10)), tmp_path / "out.zarr", options={"spacing": 1.0}, scheduler=address)


def test_nobody_at_the_address_is_one_clear_error(tmp_path: Path) -> None:
    dem = write(tmp_path / "dem.tif", np.ones((20, 20), np.float32))
    with pytest.raises(SettingsError, match=r"--scheduler: nobody answers at tcp://127\.0\.0\.1:9"):
        build_pyramid(dem, tmp_path / "out.zarr", scheduler="tcp://127.0.0.1:9")
