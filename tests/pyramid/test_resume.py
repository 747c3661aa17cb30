"""Builds that are killed go on where they were, and end as if nothing had happened."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orogen.errors import OutputError
from orogen.pyramid import build, build_pyramid, places
from orogen.pyramid.regions import Region
from orogen.pyramid.task import Cancelled, Job, Part, make_region
from orogen.source.stored import recognises
from rasters import write_tiled

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")

SHAPE = (4200, 330)

KILLED = """
import os, signal, sys
from orogen.pyramid import build_pyramid

left = int(sys.argv[3])

def hook(event, arguments):
    global left
    if event in ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.listdir", "os.link"):
        left -= "/out.zarr" in str(arguments[0])
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(hook)
build_pyramid(sys.argv[1], sys.argv[2], color=sys.argv[4], max_error=0.25)
sys.stdout.write(str(left))
"""
"""Kills itself at the n-th time that it touches a file of the output."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("data")
    rng = np.random.default_rng(1)
    y, x = np.indices(SHAPE)
    heights = (500 * np.sin(x / 60) * np.cos(y / 45) + rng.normal(0, 3, SHAPE)).astype(np.float32)
    heights[2000:2100, 100:200] = np.nan
    colours = rng.integers(0, 255, (3, 2100, 165)).astype(np.uint8)
    image = write_tiled(folder / "image.tif", colours, photometric="RGB")
    return write_tiled(folder / "heights.tif", heights), image


@pytest.fixture(scope="module")
def expected(data: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("expected") / "out.zarr"
    build_pyramid(data[0], out, color=data[1], max_error=0.25)
    return tree(out)


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def run(data: tuple[Path, Path], out: Path, moment: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", KILLED, str(data[0]), str(out), str(moment), str(data[1])],
        capture_output=True,
        text=True,
    )


def check(data: tuple[Path, Path], expected: dict[str, bytes], out: Path, seed: int, moments: int) -> int:
    """Kill a build twice, then let it end. How often it was killed: it may have ended before."""
    rng, kills = np.random.default_rng(seed), 0
    for _ in range(2):
        done = run(data, out, int(rng.integers(1, moments)))
        assert done.returncode in (0, -9), done.stderr
        # either not there, or complete
        assert not out.exists() or tree(out) == expected
        kills += done.returncode == -9
        if done.returncode == 0:
            break
    if not out.exists():
        build_pyramid(data[0], out, color=data[1], max_error=0.25)
    assert tree(out) == expected
    left = [path.name for path in out.parent.iterdir() if path != out]
    assert [name for name in left if ".removed-" not in name] == []
    return kills


def test_a_killed_build_goes_on_and_gives_the_same_bytes(
    data: tuple[Path, Path], expected: dict[str, bytes], tmp_path: Path
) -> None:
    (tmp_path / "whole").mkdir()
    whole = run(data, tmp_path / "whole" / "out.zarr", 10**6)
    moments = 10**6 - int(whole.stdout)
    assert moments > 100
    assert tree(tmp_path / "whole" / "out.zarr") == expected
    for seed in range(2):
        (tmp_path / str(seed)).mkdir()
        check(data, expected, tmp_path / str(seed) / "out.zarr", seed, moments)
    # in the last steps
    (tmp_path / "late").mkdir()
    check(data, expected, tmp_path / "late" / "out.zarr", 1, 12)
    for back in (1, 5):
        out = tmp_path / f"back{back}" / "out.zarr"
        out.parent.mkdir()
        run(data, out, moments - back)
        if not out.exists():
            build_pyramid(data[0], out, color=data[1], max_error=0.25)
        assert tree(out) == expected


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", range(40))
def test_kills_at_many_moments(
    data: tuple[Path, Path],
    expected: dict[str, bytes],
    tmp_path: Path,
    seed: int,
    record_property: Callable[[str, object], None],
) -> None:
    record_property("builds killed", check(data, expected, tmp_path / "out.zarr", 100 + seed, 400))


def test_a_stopped_build_goes_on(
    data: tuple[Path, Path], expected: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, stop = tmp_path / "out.zarr", threading.Event()
    made: list[tuple[int, int]] = []

    def noted(job: Job, region: Region, base: int) -> Part:
        made.append((base, region.rows.start))
        return make_region(job, region, base)

    def report(part: float, text: str) -> None:
        if part > 0.5:
            stop.set()

    monkeypatch.setattr(build, "make_region", noted)
    with pytest.raises(Cancelled):
        build_pyramid(data[0], out, max_error=0.25, report=report, stop=stop)
    assert not out.exists()
    assert not recognises(tmp_path / "out.zarr.building")
    build_pyramid(data[0], out, max_error=0.25)
    assert {name: content for name, content in tree(out).items() if name.startswith("height/")} == {
        name: content for name, content in expected.items() if name.startswith("height/")
    }
    assert len(made) < 2 * len(set(made))  # what had been done was not done again


def test_what_was_begun_with_other_settings_is_begun_anew(
    data: tuple[Path, Path], expected: dict[str, bytes], tmp_path: Path
) -> None:
    out, stop = tmp_path / "out.zarr", threading.Event()

    def report(part: float, text: str) -> None:
        if part > 0.5:
            stop.set()

    with pytest.raises(Cancelled):
        build_pyramid(data[0], out, max_error=4.0, report=report, stop=stop)
    build_pyramid(data[0], out, color=data[1], max_error=0.25)
    assert tree(out) == expected


def test_two_builds_of_one_output_do_not_mix(data: tuple[Path, Path], tmp_path: Path) -> None:
    out, begun, ended = tmp_path / "out.zarr", threading.Event(), threading.Event()

    def report(part: float, text: str) -> None:
        begun.set()
        ended.wait(60)

    first = threading.Thread(target=lambda: build_pyramid(data[0], out, report=report))
    first.start()
    try:
        assert begun.wait(60)
        with pytest.raises(OutputError, match="another process builds there"):
            build_pyramid(data[0], out)
    finally:
        ended.set()
        first.join()
    assert recognises(out)


@pytest.mark.parametrize("system", [True, False])
def test_folders_change_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, system: bool) -> None:
    if not system:
        monkeypatch.setattr(places, "_exchanged", lambda new, old: False)
    for name in ("new", "old"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text(name)
    places.exchange(tmp_path / "new", tmp_path / "old")
    assert (tmp_path / "old" / "file").read_text() == "new"
    assert (tmp_path / "new" / "file").read_text() == "old"
    (tmp_path / "old").rename(tmp_path / "old.replaced")  # as a kill in between leaves it
    places.recover(tmp_path / "old")
    assert (tmp_path / "old" / "file").read_text() == "new"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "old"]
