"""Plans: entries and sweeps from words, and what is refused before anything is opened."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from orogen.compare.plan import Entry, Plan, parse_entry, parse_sweep, plain
from orogen.compare.spread import packed
from orogen.errors import SettingsError
from orogen.lod import algorithms


def test_entries_from_words() -> None:
    assert parse_entry("raycast") == Entry("raycast", {}, "raycast")
    entry = parse_entry("FINE=udlod:pixels_per_quad=2,grid_size=8")
    assert (entry.label, entry.algorithm) == ("FINE", "udlod")
    assert dict(entry.settings) == {"pixels_per_quad": "2", "grid_size": "8"}
    assert entry.values() == {**Entry("udlod").values(), "pixels_per_quad": 2.0, "grid_size": 8}
    assert parse_entry("udlod:pixels_per_quad=2").label == "udlod pixels_per_quad=2"
    assert parse_entry("udlod:pixels_per_quad=2").folder == "udlod_pixels_per_quad=2"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("udlodd", "algorithm: expected one of .*did you mean udlod"),
        ("udlod:grid_sise=8", "setting of udlod: expected one of .*did you mean grid_size"),
        ("udlod:grid_size=x", "grid_size: expected int, got 'x'"),
        ("udlod:grid_size", "--entry: expected KEY=VALUE after 'udlod', got 'grid_size'"),
        ("=udlod", r"--entry: expected \[LABEL=\]ALGORITHM"),
    ],
)
def test_words_that_name_no_entry(text: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        parse_entry(text)


def test_switches_are_on_or_off(monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import dataclass

    from orogen.lod.udlod import Udlod

    @dataclass(frozen=True)
    class Settings:
        warping: bool = True
        name: str = "off"

    monkeypatch.setattr(Udlod, "Settings", Settings)
    assert parse_entry("udlod:warping=off").values() == {"warping": False, "name": "off"}
    assert parse_entry("udlod:warping=ON,name=on").values() == {"warping": True, "name": "on"}


def test_sweeps_vary_one_setting_of_an_entry_or_an_algorithm() -> None:
    fine = parse_entry("FINE=udlod:grid_size=8")
    swept = parse_sweep("FINE.pixels_per_quad=2,4", [fine])
    assert [e.label for e in swept] == ["FINE pixels_per_quad=2", "FINE pixels_per_quad=4"]
    assert [(e.values()["pixels_per_quad"], e.values()["grid_size"]) for e in swept] == [(2.0, 8), (4.0, 8)]
    assert {e.sweep for e in swept} == {"pixels_per_quad"}
    assert [e.values()["grid_size"] for e in parse_sweep("udlod.grid_size=8,16", [fine])] == [8, 16]
    with pytest.raises(SettingsError, match="--sweep: expected NAME"):
        parse_sweep("grid_size=8,16", [])
    with pytest.raises(SettingsError, match="grid_size: expected int, got 'x'"):
        parse_sweep("udlod.grid_size=8,x", [])


def test_every_algorithm_takes_part_unless_told() -> None:
    assert [entry.algorithm for entry in Plan("synthetic").entries] == list(algorithms())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"entries": (Entry("udlod"), Entry("udlod"))}, "entries: expected different labels, got 'udlod' twice"),
        ({"entries": (Entry("udlod", label="a b"), Entry("udlod", label="a/b"))}, "expected different labels"),
        ({"entries": (Entry("udlod", label="reference"),)}, "labels other than 'reference'"),
        ({"size": (0, 9)}, "size: expected at least 1x1 pixels, got 0x9"),
        ({"fps": 0.0}, "fps: expected more than 0"),
        ({"every": 3}, "either a number of frames or every so many"),
        ({"frames": None}, "either a number of frames or every so many"),
        ({"frames": 0}, "frames: expected a whole number, at least 1, got 0"),
        ({"repeats": 0}, "repeats: expected a whole number, at least 1"),
        ({"equal_triangles": -3}, "equal_triangles: expected a whole number"),
        ({"equal_triangles": (3000, 0)}, "equal_triangles: expected a whole number, at least 1, got 0"),
        (
            {"entries": (Entry("udlod"), Entry("raycast", {}, "udlod 3")), "equal_triangles": (3,)},
            "got 'udlod 3' twice",
        ),
        ({"equal_time": math.nan}, "equal_time: expected more than 0 milliseconds"),
        ({"equal_time": 1.0, "equal_triangles": 5}, "expected one of them, got both"),
        ({"crop": (-1, 0, 5, 5)}, "crop: expected a column and a row from 0"),
        ({"prelit": True, "options": {"color": "a.png"}}, "prelit and color: expected one image"),
        ({"metrics": ("psnr", "sim")}, "metric: expected one of .*did you mean ssim"),
        ({"streaming": {"memry": "1"}}, "setting of streaming: expected one of .*did you mean memory"),
    ],
)
def test_plans_that_cannot_be(options: dict, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Plan("synthetic", **{"entries": (Entry("raycast"),), **options})


def test_several_numbers_of_triangles_make_entries() -> None:
    entries = (Entry("raycast"), Entry("udlod", {"grid_size": 8}, "FINE"), *parse_sweep("udlod.pixels_per_quad=2", []))
    plan = Plan("synthetic", entries, equal_triangles=(500_000, 3000, 3000))
    # neither rays nor what a sweep varies can be set
    assert [e.label for e in plan.entries] == ["raycast", "FINE 500,000", "FINE 3,000", "udlod pixels_per_quad=2"]
    assert [e.target and e.target.triangles for e in plan.entries] == [None, 500_000, 3000, None]
    assert [e.target and e.target.label for e in plan.entries] == [None, "FINE", "FINE", None]
    assert {e.values()["grid_size"] for e in plan.entries[1:3]} == {8}
    # a change of the plan does not multiply them again
    assert dataclasses.replace(plan, size=(24, 16)).entries == plan.entries
    assert plan.request()["equal_triangles"] == [500_000, 3000, 3000]
    one = Plan("synthetic", entries, equal_triangles=3000)
    assert one.entries == entries


def test_prelit_pictures_have_no_other_light() -> None:
    assert Plan("synthetic", (Entry("raycast"),)).shown.lit
    shown = Plan("synthetic", (Entry("raycast"),), prelit=True).shown
    assert (shown.lit, shown.color) == (False, "image")


def test_requests_survive_a_file() -> None:
    plan = Plan("synthetic", (Entry("udlod", {"pixels_per_quad": np.float64(3)}),), crop=(0, 0, 64, 64))
    request = plan.request()
    assert json.loads(json.dumps(request)) == request
    same = Plan(
        "synthetic", (Entry("udlod", {"pixels_per_quad": "3"}, "udlod pixels_per_quad=3"),), crop=(0, 0, 64, 64)
    )
    assert same.request() == request
    assert plain({"a": (math.inf, math.nan, np.int64(3))}) == {"a": ["inf", None, 3]}


def test_files_are_named_alike_from_every_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a.tif", "b.tif"):
        (tmp_path / name).touch()
    wkt = 'LOCAL_CS["ground",UNIT["metre",1]]'
    monkeypatch.chdir(tmp_path)
    for data, expected in (
        ("a.tif", str(tmp_path / "a.tif")),
        ("*.tif", str(tmp_path / "*.tif")),
        (["a.tif", "b.tif"], [str(tmp_path / "a.tif"), str(tmp_path / "b.tif")]),
        ("https://example.org/[1].tif", "https://example.org/[1].tif"),
    ):
        plan = Plan(data, options={"color": data, "crs": wkt})
        asked, sent = plan.request(), packed(plan)
        for found in (asked["data"], asked["options"]["color"], sent["data"], sent["options"]["color"]):
            assert found == expected
        assert sent["options"]["crs"] == wkt
