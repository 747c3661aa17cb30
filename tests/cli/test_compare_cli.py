"""`orogen compare` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rasters import cone, write


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cone of 1000 m in the middle of 96 x 128 samples of 30 m."""
    path = tmp_path_factory.mktemp("dem") / "cone.tif"
    return write(path, cone(96, 128))


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
    assert len(err.splitlines()) == 1
    assert err.startswith("orogen: error: ")
    assert message in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("crop", [(), ("--crop", "0,0,100000,100000")])
def test_data_that_is_too_large_to_compare_whole_is_refused_at_once(call, tmp_path, crop) -> None:
    code, _, err = call("compare", "procedural", "-o", tmp_path / "out", *crop)
    assert code == 2
    assert "such as 2095104,2095104,4096,4096 (--crop)" in err or "such as 47952,47952,4096,4096 (--crop)" in err
    assert not (tmp_path / "out").exists()


def test_a_part_of_the_endless_terrain_is_compared(call, tmp_path) -> None:
    crop = ("--crop", "2095104,2095104,96,64")
    code, _, err = call("compare", "procedural", "-o", tmp_path / "out", *crop, "--entry", "brute", *QUICK)
    assert (code, err) == (0, "")
    assert (tmp_path / "out").is_dir()


def test_a_comparison_writes_a_report_and_is_not_overwritten(call, dem, tmp_path) -> None:
    out = tmp_path / "out"
    arguments = ("compare", dem, "-o", out, "--entry", "udlod", "--sweep", "udlod.pixels_per_quad=8", *QUICK)
    code, text, err = call(*arguments, "--prelit", "--freeze", "--json")
    assert (code, err) == (0, "")
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
    assert "holds a comparison of another plan" in err
    assert "--force" in err
    code, _, err = call("compare", dem, "-o", dem.parent, *QUICK)
    assert code == 1
    assert "expected a new folder or a comparison" in err
    assert call(*arguments, "--force")[0] == 0
    assert json.loads((out / "plan.json").read_text())["prelit"] is False


def test_tables_at_several_numbers_of_triangles(call, dem, tmp_path) -> None:
    out = tmp_path / "out"
    arguments = ("compare", dem, "-o", out, "--entry", "GRID=pgm", "--entry", "raycast", *QUICK)
    # a grid of 8 columns is the least there is
    code, text, err = call(*arguments, "--equal-triangles", "4000,3", "--json")
    assert code == 0
    assert all("GRID 3: pixels_per_column=" in line for line in err.splitlines())
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
