"""`orogen compare` as a user meets it."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import rasterio

from orogen import cli


@pytest.fixture(autouse=True)
def _own_log():
    """The command sets logging up for a process of its own."""
    loggers = [logging.getLogger(), logging.getLogger("orogen")]
    before = [(log.handlers[:], log.level, log.propagate) for log in loggers]
    yield
    logging.captureWarnings(False)
    for log, (handlers, level, propagate) in zip(loggers, before, strict=True):
        log.handlers[:], log.propagate = handlers, propagate
        log.setLevel(level)


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cone of 1000 m in the middle of 96 x 128 samples of 30 m."""
    path = tmp_path_factory.mktemp("dem") / "cone.tif"
    y, x = np.mgrid[0:96, 0:128]
    heights = np.maximum(0, 1000 - 25 * np.hypot(x - 64, y - 48)).astype(np.float32)
    transform = rasterio.Affine(30.0, 0.0, 500000.0, 0.0, -30.0, 4000000.0)
    with rasterio.open(
        path, "w", driver="GTiff", width=128, height=96, count=1, dtype="float32", crs="EPSG:32633", transform=transform
    ) as file:
        file.write(heights, 1)
    return path


@pytest.fixture
def call(capfd: pytest.CaptureFixture[str]):
    """Run a command line in this process: exit code, stdout, lines of stderr less the graphics driver's."""

    def run(*arguments: object) -> tuple[int, str, list[str]]:
        code = cli.run([str(a) for a in arguments])
        out, err = capfd.readouterr()
        return code, out, [line for line in err.splitlines() if line and "XDG_RUNTIME_DIR" not in line]

    return run


QUICK = (
    "--size",
    "48x32",
    "--frames",
    "2",
    "--repeats",
    "1",
    "--pictures",
    "1",
    "--metric",
    "psnr",
    "--metric",
    "cracks",
)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--output"),
        (("-o", "OUT", "--entry", "udlodd"), "algorithm: expected one of"),
        (("-o", "OUT", "--entry", "udlodd"), "did you mean udlod?"),
        (("-o", "OUT", "--entry", "udlod:grid_sise=8"), "did you mean grid_size?"),
        (("-o", "OUT", "--entry", "udlod", "--entry", "udlod"), "expected different labels, got 'udlod' twice"),
        (("-o", "OUT", "--sweep", "udlod=3"), "--sweep: expected NAME.SETTING=VALUE,VALUE..., got 'udlod=3'"),
        (("-o", "OUT", "--metric", "sim"), "did you mean ssim?"),
        (("-o", "OUT", "--crop", "1,2,3"), "expected four whole numbers separated by ',', got '1,2,3'"),
        (("-o", "OUT", "--crop", "0,0,500,50"), "crop: expected a part of the 128 x 96 samples of"),
        (("-o", "OUT", "--frames", "3", "--every", "2"), "either a number of frames or every so many"),
        (("-o", "OUT", "--equal-time", "3", "--equal-triangles", "3"), "expected one of them, got both"),
        (("-o", "OUT", "--equal-triangles", "3,x"), "expected one or more whole numbers separated by ',', got '3,x'"),
        (("-o", "OUT", "--flight", "orbits"), "built-in flights"),
        (("-o", "OUT", "--flight", "descent-taiwan"), "descent-taiwan: outside the data: at 0 s"),
        (("-o", "OUT", "--set", "memory"), "--set: expected KEY=VALUE, got 'memory'"),
        (("-o", "OUT", "--set", "memry=3"), "did you mean memory?"),
        (("-o", "OUT", "--prelit", "--color", "a.png"), "prelit and color: expected one image to drape"),
    ],
)
def test_bad_command_lines_are_one_line_and_exit_code_2(call, dem, tmp_path, arguments, message) -> None:
    code, out, err = call("compare", dem, *[tmp_path / "out" if a == "OUT" else a for a in arguments])
    assert (code, out) == (2, "")
    assert len(err) == 1
    assert err[0].startswith("orogen: error: ")
    assert message in err[0]
    assert not (tmp_path / "out").exists()


def test_a_comparison_writes_a_report_and_is_not_overwritten(call, dem, tmp_path) -> None:
    out = tmp_path / "out"
    arguments = ("compare", dem, "-o", out, "--entry", "udlod", "--sweep", "udlod.pixels_per_quad=8", *QUICK)
    code, text, err = call(*arguments, "--prelit", "--freeze", "--json")
    assert (code, err) == (0, [])
    assert json.loads(text) == {"report": str(out / "report.html"), "entries": ["udlod", "udlod pixels_per_quad=8"]}
    assert (out / "report.html").exists()
    for entry in json.loads((out / "plan.json").read_text())["entries"]:
        lines = [json.loads(line) for line in (out / "frames" / f"{entry['folder']}.jsonl").read_text().splitlines()]
        assert [line["frame"] for line in lines] == [0, 479]
        assert all({"psnr", "cracks", "gpu", "cpu", "triangles"} <= line.keys() for line in lines)
    found = {path.name for path in (out / "pictures" / "udlod").iterdir()}
    assert found == {f"0479{kind}.png" for kind in ("", "_wire", "_meta_close", "_meta_middle", "_meta_far")}
    # the same again: nothing to do; another plan: refused; in a folder of other things: refused
    before = (out / "frames" / "udlod.jsonl").read_bytes()
    assert call(*arguments, "--prelit", "--freeze")[:2] == (0, f"{out / 'report.html'}\n")
    assert (out / "frames" / "udlod.jsonl").read_bytes() == before
    code, _, err = call(*arguments)
    assert code == 1
    assert "holds a comparison of another plan" in err[0]
    assert "--force" in err[0]
    code, _, err = call("compare", dem, "-o", dem.parent, *QUICK)
    assert code == 1
    assert "expected a new folder or a comparison" in err[0]
    assert call(*arguments, "--force")[0] == 0
    assert json.loads((out / "plan.json").read_text())["prelit"] is False


def test_tables_at_several_numbers_of_triangles(call, dem, tmp_path) -> None:
    out = tmp_path / "out"
    arguments = ("compare", dem, "-o", out, "--entry", "GRID=pgm", "--entry", "raycast", *QUICK)
    # a grid of 8 columns is the least there is
    code, text, err = call(*arguments, "--equal-triangles", "4000,3", "--json")
    assert code == 0
    assert [line for line in err if "GRID 3: pixels_per_column=" in line] == err
    found = json.loads(text)
    assert found["entries"] == ["GRID 4,000", "GRID 3", "raycast"]
    assert [(row["label"], row["target"], row["met"]) for row in found["targets"]] == [
        ("GRID", 4000, True), ("GRID", 3, False), ("raycast", None, None)
    ]  # fmt: skip
    # the rays' PSNR is infinite, which the command does not write
    assert found["targets"][:2] == json.loads((out / "results.json").read_text())["targets"][:2]
    assert found["targets"][0]["triangles"] == pytest.approx(4000, rel=0.25)
    # the same as text, from the finished comparison
    code, text, _ = call(*arguments, "--equal-triangles", "4000,3")
    assert code == 0
    lines = text.splitlines()
    assert lines[0].startswith("4,000 triangles")
    rows = [line.split()[0] for line in lines if line.startswith(("GRID  ", "raycast  "))]
    assert rows == ["GRID", "GRID", "raycast"]
    assert any(line.startswith("GRID does not come nearer to 3 triangles than ") for line in lines)
    assert lines[-1] == str(out / "report.html")
