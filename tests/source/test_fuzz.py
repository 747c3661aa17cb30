"""Truncated, flipped and forged rasters: a right load or a typed error, in bounded time and memory."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

WORKER = Path(__file__).with_name("fuzzing.py")
SECONDS = 2.0
"""Of processor time, for each raster."""
MEGABYTES = 256.0
"""Above what the process had after opening whole rasters."""
PATIENCE = 60.0
"""Seconds without a sign of life after which the process is stopped: it hangs."""
PARTS = 16
"""Of the nightly run, so that processes can share it."""
Record = Callable[[str, object], None]

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="peak memory is not measured there")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    spec = importlib.util.spec_from_file_location("fuzzing", WORKER)
    assert spec
    assert spec.loader
    fuzzing = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fuzzing)
    place = tmp_path_factory.mktemp("fuzz")
    whole = place / "whole"
    whole.mkdir()
    written = fuzzing.rasters(whole)
    for other in set(whole.iterdir()) - set(written):
        other.unlink()
    assert len(written) > 20
    return place


def batch(folder: Path, first: int, count: int) -> tuple[Counter[str], list[str]]:
    """What became of the cases, and those that broke a promise; after a crash or hang the next case goes on."""
    outcomes: Counter[str] = Counter()
    broken: list[str] = []
    end = first + count
    while first < end:
        process = subprocess.Popen(
            [sys.executable, str(WORKER), str(folder), str(first), str(end - first)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert process.stdout
        assert process.stderr
        errors: list[str] = []
        reader = threading.Thread(target=lambda p=process, e=errors: e.append(p.stderr.read()))
        reader.start()
        current: dict[str, Any] = {}
        memory = 0.0
        watchdog = threading.Timer(PATIENCE, process.kill)
        watchdog.start()
        for line in process.stdout:
            watchdog.cancel()
            watchdog = threading.Timer(PATIENCE, process.kill)
            watchdog.start()
            told = json.loads(line)
            if "case" in told:
                current = told
                continue
            outcomes[told["outcome"] if told["outcome"] in ("loaded", "refused") else "wrong"] += 1
            what = f"case {current['case']} ({current['name']})"
            if told["outcome"] not in ("loaded", "refused"):
                broken.append(f"{what}: {told['outcome']}")
            if told["seconds"] > SECONDS:
                broken.append(f"{what}: {told['seconds']:.1f} s")
            if told["memory"] > max(memory, MEGABYTES):
                broken.append(f"{what}: {told['memory']:.0f} MB")
            memory = max(memory, told["memory"])
            first = current["case"] + 1
            current = {}
        code = process.wait()
        watchdog.cancel()
        reader.join()
        if current:
            broken.append(f"case {current['case']} ({current['name']}): ended the process ({code}) {errors[0][-500:]}")
            first = current["case"] + 1
        elif code:
            pytest.fail(f"the process ended ({code}): {errors[0][-2000:]}")
    return outcomes, broken


def test_some_mutated_rasters(folder: Path) -> None:
    outcomes, broken = batch(folder, 0, 900)
    assert not broken, "\n".join(broken)
    assert outcomes["loaded"] > 100
    assert outcomes["refused"] > 100


@pytest.mark.nightly
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("part", range(PARTS))
def test_a_hundred_thousand_mutated_rasters(folder: Path, part: int, record_property: Record) -> None:
    count = 100_000 // PARTS
    outcomes, broken = batch(folder, 100_000 + count * part, count)
    assert not broken, "\n".join(broken)
    assert outcomes["loaded"] + outcomes["refused"] == count
    record_property("mutated rasters", count)
    record_property("of them loaded", outcomes["loaded"])
