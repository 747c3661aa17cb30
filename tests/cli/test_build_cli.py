"""`orogen build` on the command line, and `orogen fly` on a cluster."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orogen.cli.fly import flown
from orogen.cli.spread import Place, drawn
from orogen.cli.terrain import open_terrain
from orogen.pyramid import build_pyramid
from orogen.shading.style import Style
from orogen.view.flight import Flight
from orogen.view.renderer import Scene
from rasters import cone, write


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("dem") / "cone.tif"
    return write(path, cone(300, 400, 3000))


def orogen(*arguments: object) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "-m", "orogen", *map(str, arguments)], capture_output=True, text=True, timeout=100
    )
    return done.returncode, done.stdout, done.stderr


def test_build_says_what_it_will_take_and_what_it_made(dem: Path, tmp_path: Path) -> None:
    code, out, err = orogen(
        "build", dem, "-o", tmp_path / "out.zarr", "--max-error", "0.5", "--color", dem.parent / "no"
    )
    assert code == 1
    assert "no such file" in err
    code, out, err = orogen("build", dem, "-o", tmp_path / "out.zarr", "--max-error", "0.5")
    assert code == 0, err
    assert "orogen: building takes about" in err
    assert out.splitlines()[0] == str(tmp_path / "out.zarr")
    assert "400 x 300 samples, off by at most" in out
    code, out, err = orogen(
        "build", dem, "-o", tmp_path / "out.zarr", "--update", "--window", "0,0,9,9", "--json", "-q"
    )
    assert code == 0, err
    result: dict[str, Any] = json.loads(out)
    assert result["layers"]["height"]["regions"] == 1
    assert result["layers"]["height"]["max_error"] == 0.5
    code, out, _ = orogen("info", tmp_path / "out.zarr", "--json")
    assert code == 0
    facts = json.loads(out)
    assert facts["pyramid_built"]
    assert (facts["width"], facts["height"], facts["crs"]) == (400, 300, "EPSG:32633")
    # rounded to whole metres, which the GPU holds in 16 bits
    assert (facts["height_quantum"], facts["height_bits"]) == (1.0, 16)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "DATA requires an argument"),
        (["DEM", "--window", "0,0,1,1"], 2, "--window: tells what has changed; give it with --update"),
        (["DEM", "--update", "--force"], 2, "leave out --overwrite and --max-error"),
        (["DEM", "--layer", "other"], 2, "--layer: expected NAME=DATA, got 'other'"),
        (["DEM", "--max-error", "0"], 2, "max_error: expected metres above 0"),
        (["DEM", "--update"], 1, "is no pyramid that orogen has built; build it without --update"),
    ],
)
def test_wrong_words_are_one_clear_line(
    dem: Path, tmp_path: Path, arguments: list[str], code: int, message: str
) -> None:
    words = [str(dem) if word == "DEM" else word for word in arguments]
    got, _, err = orogen("build", *words, "-o", tmp_path / "out.zarr", "-q")
    assert (got, message in err) == (code, True), err
    assert not (tmp_path / "out.zarr").exists()


def test_only_folders_and_cogs_are_built(dem: Path, tmp_path: Path) -> None:
    code, out, err = orogen("build", dem, "-o", tmp_path / "a.zip")
    assert (code, out) == (1, "")
    assert "a.zip: expected the suffix .zarr or .tif, got '.zip'" in err
    assert not (tmp_path / "a.zip").exists()


@pytest.mark.timeout(300)  # three processes that make their pipelines
def test_a_cluster_draws_the_frames_that_this_process_draws(dem: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    build_pyramid(dem, tmp_path / "out.zarr")
    place, size, scene = Place(str(tmp_path / "out.zarr"), None, None), (64, 36), Scene()
    with open_terrain(place.data, None, None, lambda part, text: None) as terrain:
        views = flown(terrain, Flight.load("orbit").lasting(1.0), 4.0, Style(), scene)
        alone = [terrain.render(camera, size, style, scene, samples=2).color for camera, style in views]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
    ) as cluster:
        spread = list(drawn(cluster.scheduler_address, place, views, size, scene, 2))
    assert len(alone) == len(spread) == 4
    assert np.std(alone[0]) > 5
    for one, other in zip(alone, spread, strict=True):
        np.testing.assert_array_equal(one, other)
    fly = ["fly", tmp_path / "out.zarr", "-o", tmp_path / "a.mkv", "-q", "--scheduler", "tcp://127.0.0.1:9"]
    code, _, err = orogen(*fly)
    assert code == 2
    assert "--scheduler: nobody answers at tcp://127.0.0.1:9" in err
