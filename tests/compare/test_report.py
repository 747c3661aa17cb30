"""The report: statistics against numpy, fronts against their definition, and a page that stands alone."""

from __future__ import annotations

import base64
import csv
import io
import json
import math
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from orogen.compare import report
from orogen.compare.metrics import psnr
from orogen.compare.report import charts, pictures, targets
from orogen.compare.report.results import Comparison, flatten, read, summarise
from orogen.compare.report.svg import Axis, Plot, Point, number
from orogen.errors import SettingsError

FRAMES = 6
ALL = ["psnr", "ssim", "flip", "shapes", "surface", "cracks", "stability"]


def record(frame: int, quality: float, time: float, algorithm: str) -> dict[str, Any]:
    """A frame's record; errors grow as quality falls."""
    error = 10 ** (-quality / 20)
    spread = {"mean": error, "p95": 2 * error, "p99": 3 * error, "max": 9 * error, "over_1px": error / 100}
    first = frame == 0
    return {
        "frame": 10 * frame, "time": 0.5 * frame, "triangles": 1000 * (frame + 1), "patches": 4, "draws": 1, "rays": 0,
        "gpu": {"raster": 0.75 * time, "shade": 0.25 * time}, "cpu": 0.3,
        "memory": {"gpu": {"atlas": 2_000_000, algorithm: 500_000}, "host": 90_000_000 + frame},
        "mse": 255**2 / 10 ** (quality / 10), "psnr": quality + frame, "ssim": 0.9, "flip": 0.05,
        "forward": spread, "backward": {**spread, "p99": 4 * error}, "hidden": 0.01, "stray": 0.0,
        "shapes": {"degenerate": 100, "slivers": 50 * (frame + 1), "degenerate_share": 0.1 / (frame + 1),
                   "sliver_share": 0.05, "smallest_angle": 40.0 + frame},
        "angles": {"00": 50 * (frame + 1), "30": 150 * (frame + 1), "45": 800 * (frame + 1) - 100},
        "cracks": frame % 2, "lost": 3, "skyline_mean": 0.1, "skyline_max": 2.0,
        "instability_mean": None if first else 0.02, "instability_p99": None if first else 0.2,
        "swimming": None if first else 0.01, "popping": None if first else 0.003,
    }  # fmt: skip


Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Writes a folder as the runner does; `change` may alter every record."""

    def folder(
        entries: list[dict[str, Any]] | None = None,
        change: Callable[[dict[str, Any]], None] = lambda record: None,
        frames: int = FRAMES,
        **plan: Any,
    ) -> Path:
        entries = entries or [
            {"label": "plain", "algorithm": "udlod", "quality": 30.0, "gpu": 2.0},
            {"label": "better", "algorithm": "udlod", "quality": 36.0, "gpu": 2.5},
            {"label": "worse <b>", "algorithm": "raycast", "quality": 28.0, "gpu": 3.0},
        ]
        listed = []
        (tmp_path / "frames").mkdir(exist_ok=True)
        for place, entry in enumerate(entries):
            settings = {"pixels_per_quad": 4.0, "morph": True}
            listed.append(
                {
                    "label": entry["label"], "algorithm": entry["algorithm"], "settings": settings,
                    "given": {"morph": True}, "calibrated": entry.get("calibrated"), "sweep": entry.get("sweep"),
                    "folder": f"entry{place}", "target": entry.get("target"),
                }
            )  # fmt: skip
            records = [record(k, entry["quality"], entry["gpu"], entry["algorithm"]) for k in range(frames)]
            for part in records:
                change(part)
            lines = "".join(json.dumps(part) + "\n" for part in records)
            (tmp_path / "frames" / f"entry{place}.jsonl").write_text(lines)
        document = {
            "format": 1, "data": "/some/place/hills & dales.tif", "crop": [10, 20, 512, 256], "size": [160, 100],
            "flight": {"name": "descent", "frames": FRAMES, "duration": 3.0, "keyframes": [{"t": 0}]},
            "style": {"lit": False}, "entries": listed, "metrics": ALL, "pictures": [20],
            "machine": {"cpu": "a processor", "os": "a system", "python": "3.11", "orogen": "0.1.0"},
            "adapter": {"name": "a card", "kind": "discrete", "backend": "Vulkan", "driver": "1.0"},
            "reference": {"algorithm": "raycast"}, **plan,
        }  # fmt: skip
        (tmp_path / "plan.json").write_text(json.dumps(document))
        return tmp_path

    return folder


class Page(HTMLParser):
    """Checks that elements nest, and gathers texts, addresses and tables."""

    VOID = frozenset({"meta", "img", "br", "path"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.rows: list[list[str]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.addresses += [values[name] or "" for name in ("src", "href", "data", "action") if name in values]
        self.ids += [values["id"] or ""] if "id" in values else []
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        if tag in self.VOID:
            return
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.texts.append(data)
            if {"td", "th"} & set(self.open) and "title" not in self.open:
                self.rows[-1][-1] += data

    def table(self, heading: str) -> dict[str, list[str]]:
        """Rows of the first table with this column heading, by entry."""
        start = next(k for k, row in enumerate(self.rows) if heading in row)
        found = {}
        for row in self.rows[start + 1 :]:
            if len(row) != len(self.rows[start]):
                break
            found[row[0].removesuffix(" ★")] = row[1:]
        return found


def page_of(folder: Path) -> Page:
    return Page(report.write(folder).read_text(encoding="utf-8"))


def test_statistics_are_numpy_s() -> None:
    values = np.random.default_rng(2).normal(5, 2, 101)
    found = summarise([*values, None])
    assert found is not None
    assert found["count"] == 101
    assert found["mean"] == pytest.approx(values.mean())
    assert (found["min"], found["max"]) == (values.min(), values.max())
    ordered = np.sort(values)
    for share in (50, 95, 99):
        assert found[f"p{share}"] == ordered[math.ceil(101 * share / 100) - 1]
    assert summarise([None, None]) is None


def test_equal_pictures_do_not_spoil_the_average() -> None:
    found = summarise([30.0, math.inf, 40.0])
    assert found is not None
    assert (found["mean"], found["max"], found["p50"]) == (35, math.inf, 40)
    alone = summarise([math.inf])
    assert alone is not None
    assert alone["mean"] == math.inf


def test_records_become_flat() -> None:
    row = flatten(record(1, 20.0, 4.0, "udlod") | {"psnr": "inf"})
    assert row["psnr"] == math.inf
    assert row["gpu"] == pytest.approx(4)
    assert row["gpu.shade"] == pytest.approx(1)
    assert row["memory.gpu"] == 2_500_000
    assert row["error.p99"] == row["backward.p99"] == pytest.approx(0.4)
    assert flatten({"gpu": {}, "memory": {"gpu": {}, "host": 5}})["gpu"] is None


def test_the_psnr_of_all_frames_is_that_of_one_large_picture(make: Make) -> None:
    rng = np.random.default_rng(4)
    true = rng.integers(0, 256, (FRAMES, 8, 9, 3), np.uint8)
    drawn = true.copy()
    drawn[1:] = np.clip(drawn[1:].astype(int) + rng.integers(-20, 21, drawn[1:].shape), 0, 255)

    def measured(part: dict[str, Any]) -> None:
        k = part["frame"] // 10
        value = psnr(drawn[k], true[k])
        part["mse"] = float(((drawn[k].astype(float) - true[k]) ** 2).mean())
        part["psnr"] = "inf" if value == math.inf else value

    entry = read(make(change=measured)).entries[0]
    assert entry.summary["psnr"]["pooled"] == pytest.approx(psnr(drawn.reshape(-1, 9, 3), true.reshape(-1, 9, 3)))
    assert entry.summary["psnr"]["equal"] == 1
    assert entry.summary["psnr"]["max"] == math.inf


def test_results_are_strict_json_and_whole(make: Make) -> None:
    def endless(part: dict[str, Any]) -> None:
        part["psnr"] = math.inf

    folder = make(change=endless)
    report.write(folder)

    def refuse(name: str) -> None:
        raise AssertionError(name)

    found = json.loads((folder / "results.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert found["plan"] == json.loads((folder / "plan.json").read_text())
    assert [entry["label"] for entry in found["entries"]] == ["plain", "better", "worse <b>"]
    first = found["entries"][0]
    assert len(first["frames"]) == FRAMES
    assert first["frames"][3]["forward"] == record(3, 30.0, 2.0, "udlod")["forward"]
    assert first["summary"]["psnr"]["mean"] == "inf"
    assert first["summary"]["triangles"] | {"count": 6} == {
        "count": 6, "min": 1000, "mean": 3500, "max": 6000, "p50": 3000, "p95": 6000, "p99": 6000,
    }  # fmt: skip


def test_tables_for_other_programs(make: Make) -> None:
    folder = make()
    report.write(folder)
    frames = list(csv.DictReader(io.StringIO((folder / "frames.csv").read_text(encoding="utf-8"))))
    assert len(frames) == 3 * FRAMES
    better = [row for row in frames if row["label"] == "better"]
    assert [float(row["psnr"]) for row in better] == [36.0 + k for k in range(FRAMES)]
    assert better[0]["popping"] == ""
    assert float(better[1]["memory.own"]) == 500_000
    summary = list(csv.DictReader(io.StringIO((folder / "summary.csv").read_text(encoding="utf-8"))))
    (gpu,) = (row for row in summary if row["label"] == "better" and row["metric"] == "gpu")
    assert float(gpu["mean"]) == pytest.approx(2.5)
    assert int(gpu["count"]) == FRAMES


def test_the_page_stands_alone(make: Make) -> None:
    page = page_of(make())
    for address in page.addresses:
        assert address.startswith("#") or address.startswith("data:image/")
        assert not address.startswith("#") or address[1:] in page.ids
    text = (make() / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"https?:|@import|url\(", text)
    assert "hills & dales.tif" in "".join(page.texts)
    assert "/some/place" not in text
    assert "worse <b>" in "".join(page.texts)


def test_tables_hold_the_document_s_figures(make: Make) -> None:
    page = page_of(make())
    quality = page.table("Minimum (dB)")
    assert list(quality) == ["plain", "better", "worse <b>"]
    assert quality["better"][:3] == ["36.00", "38.50", "41.00"]
    times = page.table("50 %")
    assert times["better"][:3] == ["2.500", "2.500", "2.500"]
    shares = page.table("Pass")
    assert shares["raster"] == ["75\u202f%"] * 3
    memory = page.table("own")
    assert memory["plain"][0] == "0.5"
    assert memory["plain"][-2:] == ["2.5", "90"]
    errors = page.table("99 %, worst frame")
    assert errors["plain"][2] == f"{3 * 10 ** (-30 / 20):.3f}"
    cracks = page.table("Cracks, all frames")
    assert cracks["plain"][:2] == ["3", "1"]
    assert page.table("Swimming (px per frame)")["plain"][3:] == ["0.010", "0.3\u202f%", "0.3\u202f%"]


def test_frames_that_are_exact_count_for_an_entry(make: Make) -> None:
    folder = make()

    def exact(part: dict[str, Any]) -> None:
        if part["frame"] >= 20 and "raycast" in part["memory"]["gpu"]:
            part["mse"], part["psnr"] = 0.0, "inf"

    page = page_of(make(change=exact))
    quality = page.table("Minimum (dB)")
    # two frames of 28 and 29 dB and four equal ones: their average is low, all frames as one are not
    assert quality["worse <b>"][1:5] == ["28.50", "∞", f"{28 + 10 * math.log10(3):.2f}", "4"]
    assert charts.PSNR.of(read(folder).entries[2]) > charts.PSNR.of(read(folder).entries[0])  # type: ignore[operator]


def test_the_front_is_starred(make: Make) -> None:
    page = page_of(make())
    starred = {row[0] for row in page.rows if row and row[0].endswith("★")}
    assert starred == {"plain ★", "better ★"}


def test_on_a_software_driver_the_wall_clock_decides(make: Make) -> None:
    def timed(part: dict[str, Any]) -> None:
        # the other way round than the timestamps
        part["wall"] = 10 / part["gpu"]["raster"]

    folder = make(change=timed, adapter={"name": "llvmpipe", "kind": "cpu"})
    page = page_of(folder)
    assert "Drawn by a software driver" in "".join(page.texts)
    assert "Wall clock (ms)" in "".join(page.texts)
    starred = {row[0] for row in page.rows if row and row[0].endswith("★")}
    assert starred == {"better ★", "worse <b> ★"}
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert '<td data-value="2">2.000</td>' in text
    assert '<td class="best" data-value="2">2.000</td>' not in text


def test_without_a_time_to_go_by_there_is_no_front(make: Make) -> None:
    page = page_of(make(adapter={"name": "llvmpipe", "kind": "cpu"}))
    text = "".join(page.texts)
    assert "No graph: every frame was timed once" in text
    assert not any(row and row[0].endswith("★") for row in page.rows)


@given(st.lists(st.tuples(st.integers(1, 6), st.integers(1, 6)), min_size=1, max_size=12), st.booleans())
def test_nobody_beats_the_front(values: list[tuple[int, int]], larger: bool) -> None:
    quality = charts.PSNR if larger else charts.ERROR
    entries = []
    for place, (time, value) in enumerate(values):
        frame = {
            "frame": 0,
            "gpu": {"all": time},
            "mse": 10 ** (-value),
            "psnr": value,
            "forward": {"p99": value},
            "backward": {"p99": value},
        }
        entries.append(_entry(f"{place}", frame))
    comparison = Comparison(Path(), {}, tuple(entries))
    sign = 1 if larger else -1
    expected = set()
    for place, (time, value) in enumerate(values):
        rivals = [(t <= time and sign * v >= sign * value and (t, v) != (time, value)) for t, v in values]
        if not any(rivals):
            expected.add(f"{place}")
    assert charts.on_front(comparison, quality) == expected


def _entry(label: str, frame: dict[str, Any]) -> Any:
    from orogen.compare.report.results import Entry

    return Entry(label, "udlod", {}, {}, None, None, label, (frame,))


def test_every_missing_value_has_its_reason(make: Make) -> None:
    def bare(part: dict[str, Any]) -> None:
        for name in list(part):
            if name not in ("frame", "time", "triangles", "patches", "draws", "rays", "cpu", "memory", "gpu"):
                del part[name]
        part["gpu"] = {}

    page = page_of(make(change=bare, metrics=["psnr"]))
    text = "".join(page.texts)
    assert "the adapter gives no timestamps" in text
    assert "did not ask for the metric “ssim”" in text
    assert "No pictures were saved." in text
    dashes = [cell for row in page.rows for cell in row if cell.startswith("–") and cell != "–"]
    assert len(dashes) > 50
    assert all(re.fullmatch(r"–\d+", cell) for cell in dashes)
    assert page.table("50 %")["plain"][5:7] == ["0.300", "0.300"]


def test_an_unfinished_comparison_says_so(make: Make) -> None:
    assert "Not finished" not in "".join(page_of(make()).texts)
    text = "".join(page_of(make(frames=2)).texts)
    assert "Not finished" in text
    assert "plain 2, better 2" in text
    assert "no frame is finished yet" in "".join(page_of(make(frames=0)).texts)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda folder: (folder / "plan.json").unlink(),
            "expected the folder of a comparison, got one without plan.json",
        ),
        (lambda folder: (folder / "plan.json").write_text('{"format": 7}'), "expected format 1, got 7"),
        (
            lambda folder: (folder / "frames" / "entry1.jsonl").write_text('{"frame": 0}\n{"fra'),
            "line 2: expected JSON",
        ),
    ],
)
def test_damaged_folders_are_refused(make: Make, spoil: Callable[[Path], None], message: str) -> None:
    folder = make()
    spoil(folder)
    with pytest.raises(SettingsError, match=message):
        report.write(folder)


def test_sweeps_are_curves(make: Make) -> None:
    entries = [
        {"label": f"q={value}", "algorithm": "udlod", "quality": 40.0 - value, "gpu": 8.0 / value,
         "sweep": {"setting": "pixels_per_quad", "value": value}}
        for value in (8, 2, 4)
    ]  # fmt: skip
    entries.append({"label": "other", "algorithm": "raycast", "quality": 30.0, "gpu": 1.0})
    comparison = read(make(entries))
    assert [entry.label for entry in comparison.sweeps["udlod", "pixels_per_quad"]] == ["q=2", "q=4", "q=8"]
    assert len(set(comparison.styles.values())) == 2
    assert [entry.label for entry in comparison.shown] == ["other"]
    page = page_of(comparison.folder)
    assert "PSNR against udlod.pixels_per_quad" in "".join(page.texts)


def swept(*values: int) -> list[dict[str, Any]]:
    return [
        {"label": f"q={value}", "algorithm": "udlod", "quality": 40.0 - value, "gpu": 8.0 / value,
         "sweep": {"setting": "pixels_per_quad", "value": value}}
        for value in values
    ]  # fmt: skip


def graphs(text: str) -> dict[str, list[tuple[str, str, int]]]:
    """By title the series of each graph: name, classes of the line style, points."""
    found: dict[str, list[tuple[str, str, int]]] = {}
    for title, content in re.findall(r"<figure><figcaption>([^<]*)</figcaption>(.*?)</figure>", text, re.DOTALL):
        lines = re.findall(
            r'<g class="series ([^"]*)" data-series="([^"]*)">.*?<path class="line" d="([^"]*)"', content
        )
        found[title] = [(name, style, len(re.findall("[ML]", path))) for style, name, path in lines]
    return found


def test_a_sweep_is_seen_frame_by_frame(make: Make) -> None:
    """As in figures 26 to 28 of Schmiade (2008): time and triangles at each step, all values in one graph."""
    text = report.write(make(swept(8, 2, 4))).read_text(encoding="utf-8")
    section = text[text.index('<section id="sweeps">') :]
    section = section[: section.index("</section>")]
    found = graphs(section)
    legend = re.search(r'<ul class="legend">.*?</ul>', section, re.DOTALL)
    assert legend is not None
    for title in ("GPU time over the flight", "Triangles over the flight"):
        assert [(name, points) for name, _, points in found[title]] == [(f"q={n}", FRAMES) for n in (2, 4, 8)]
        assert len({style for _, style, _ in found[title]}) == 3
        for name, style, _ in found[title]:
            sample = legend[0][legend[0].index(f'data-series="{name}"') :]
            assert sample.index(f'class="series {style}"') < sample.index("</li>")
    # numbers of frames, 10 apart
    assert ">50</text>" in section
    assert ">frame</text>" in section
    # without other entries the graphs over the flight show the sweep too, and its lines can be told apart
    assert len({style for _, style, _ in graphs(text)["PSNR over the flight"]}) == 3


def test_shapes_of_triangles(make: Make) -> None:
    folder = make()
    page = page_of(folder)
    shapes = page.table("Smallest angle, mean (°)")
    # triangles, degenerate and slivers a frame; their shares, the most slivers of a frame; the angle
    assert shapes["plain"] == ["3 500", "100", "175", "4.08 %", "5 %", "5 %", "42.5"]
    text = (folder / "report.html").read_text(encoding="utf-8")
    ((_, _, points), *others) = graphs(text)["Triangles by their smallest angle"]
    assert (points, len(others)) == (3, 2)

    def rays(part: dict[str, Any]) -> None:
        part["shapes"] = part["angles"] = None

    bare = page_of(make(change=rays))
    assert "No graph: the algorithm draws no triangles" in "".join(bare.texts)
    assert all(cell.startswith("–") for cell in bare.table("Smallest angle, mean (°)")["plain"][1:])


def test_tables_at_equal_triangles(make: Make) -> None:
    assert "Equal triangles" not in "".join(page_of(make()).texts)
    assert targets.rows(read(make())) == []
    entries = [
        {"label": f"{name} {number:,}", "algorithm": name, "quality": quality, "gpu": 1.0,
         "target": {"triangles": number, "label": name},
         "calibrated": {"setting": "tau", "value": 2.0, "target": float(number), "reached": reached,
                        "met": number == reached}}
        for name, quality, reached in (("udlod", 30.0, 3000.0), ("frostbite", 28.0, 15238.0))
        for number in (3000, 500_000)
    ]  # fmt: skip
    entries.append({"label": "brute", "algorithm": "brute", "quality": 33.0, "gpu": 9.0})
    folder = make(entries, equal_triangles=[3000, 500_000])
    comparison = read(folder)
    assert [e.label for e in comparison.shown] == ["udlod 3,000", "frostbite 3,000", "brute"]
    assert len(set(comparison.styles.values())) == 3
    rows = targets.rows(comparison)
    assert [(row["target"], row["label"], row["met"]) for row in rows] == [
        (3000, "udlod", True), (3000, "frostbite", False), (500_000, "udlod", False), (500_000, "frostbite", False),
        (None, "brute", None),
    ]  # fmt: skip
    error = 10 ** (-30 / 20)
    first = rows[0]
    assert (first["triangles"], first["gpu"], first["cpu"], first["wall"]) == (3500, 1.0, 0.3, None)
    assert (first["error_mean"], first["error_max"]) == (pytest.approx(error), pytest.approx(9 * error))

    assert first["psnr"] == pytest.approx(30)
    text = targets.text(comparison)
    assert text[0].split() == ["3,000", "triangles", *" ".join(column.title for column in targets.COLUMNS).split()]
    assert text[1].split() == ["udlod", "3", "500", f"{error:.3f}", f"{9 * error:.3f}", "30.00", "1.000", "0.300", "-"]
    assert "frostbite does not come nearer to 3,000 triangles than 15,238 (tau = 2)." in text
    page = report.write(folder).read_text(encoding="utf-8")
    for line in ("frostbite does not come nearer to 3,000 triangles than 15,238 (tau = 2).", "<b>As they are.</b>"):
        assert line in page
    for title in ("Mean screen-space error against triangles", "PSNR against triangles"):
        assert [(name, points) for name, _, points in graphs(page)[title]] == [("udlod", 2), ("frostbite", 2)]


def test_side_by_side_shows_the_place_that_differs(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "CROP", 40)
    folder = make()
    rng = np.random.default_rng(1)
    true = rng.integers(50, 200, (100, 160, 3), np.uint8)
    drawn = true.copy()
    drawn[70:80, 110:130] += 20
    for name, picture in (("reference/0020", true), ("entry0/0020", drawn), ("entry1/0020", true)):
        path = folder / "pictures" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).save(path)
    window = pictures.area_of_interest(true, [drawn, true])
    assert (window.width, window.height) == (40, 25)
    assert window.left <= 110 < 130 <= window.left + 40
    assert window.top <= 70 < 80 <= window.top + 25
    page = page_of(folder)
    text = "".join(page.texts)
    inside = psnr(window.cut(drawn), window.cut(true))
    assert f"PSNR {inside:.2f} dB here, {psnr(drawn, true):.2f} dB whole" in text
    assert "PSNR ∞ dB here, ∞ dB whole" in text
    assert "8 × |drawn − reference|" in text
    assert "worse <b>: no picture of this frame was saved." in text
    images = [address for address in page.addresses if address.startswith("data:image/png")]
    difference = np.asarray(Image.open(io.BytesIO(base64.b64decode(images[2].split(",")[1]))))
    assert sorted(np.unique(difference)) == [0, 160]
    assert (difference == 160).sum() == 10 * 20


def test_frozen_views_appear_where_there_are_any(make: Make) -> None:
    folder = make()
    assert "From outside" not in "".join(page_of(folder).texts)
    for name in ("reference/0020", "entry0/0020_meta_far"):
        path = folder / "pictures" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (160, 100)).save(path)
    assert "from far away" in "".join(page_of(folder).texts)


@given(st.lists(st.floats(1e-6, 1e9), min_size=1, max_size=8), st.booleans())
def test_axes_hold_their_values_between_round_numbers(values: list[float], log: bool) -> None:
    axis = Axis.over("length (m)", values, log=log)
    assert axis.low <= min(values) * (1 + 1e-9)
    assert axis.high >= max(values) * (1 - 1e-9)
    places = [axis.place(value) for value in sorted(values)]
    assert places == sorted(places)
    assert all(-1e-9 <= place <= 1 + 1e-9 for place in places)
    ticks = [value for value, _ in axis.ticks()]
    assert len(ticks) >= 2
    assert ticks == sorted(set(ticks))
    assert all(-1e-6 <= axis.place(tick) <= 1 + 1e-6 for tick in ticks)


def test_axes_show_infinity_and_what_is_too_small() -> None:
    axis = Axis.over("PSNR (dB)", [30.0, 44.0, math.inf])
    assert axis.ticks()[-1] == (axis.high, "∞")
    assert axis.place(math.inf) == 1 > axis.place(44.0)
    small = Axis.over("error (px)", [1e-6, 0.0, 0.2], log=True, least=1e-3)
    assert small.ticks()[0] == (1e-3, "≤ 0.001")
    assert small.place(0.0) == 0


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (1234567.0, "1\u202f234\u202f567"), (0.012345, "0.0123"), (99.96, "100"), (-2.5, "−2.5"),
        (math.inf, "∞"), (3e-7, "3.00e−07"), (40.0, "40"),
    ],
)  # fmt: skip
def test_numbers_for_people(value: float, text: str) -> None:
    assert number(value) == text


def test_names_of_points_do_not_cover_each_other() -> None:
    points = [Point(f"name {k}", k, 1 + 0.01 * k, 1.0) for k in range(4)]
    plot = Plot(Axis("x", 0, 2), Axis("y", 0, 2), "points", (540, 380), points=points)
    places = [(float(x), float(y)) for x, y in re.findall(r'<text class="name" x="([\d.]+)" y="([\d.]+)"', plot.svg())]
    assert len(places) == 4
    for k, (x, y) in enumerate(places):
        for other_x, other_y in places[:k]:
            assert abs(x - other_x) > 30 or abs(y - other_y) > 10
