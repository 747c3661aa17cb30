"""Comparisons from end to end: results, resuming, refusals, and the parts that a run is made of."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import orogen.compare
from orogen.camera import Camera
from orogen.compare import prelit, runner
from orogen.compare.calibrate import CLOSE, calibrate, search
from orogen.compare.crop import Crop
from orogen.compare.flights import Reel, Shot
from orogen.compare.meta import meta_cameras
from orogen.compare.plan import Entry, Plan
from orogen.compare.record import Record
from orogen.compare.reference import References
from orogen.compare.scenery import Scenery
from orogen.errors import BudgetError, OrogenError, OutputError, SettingsError
from orogen.lod.contract import Detail, Statistics
from orogen.pyramid.open import open_pyramid
from orogen.shading.color import srgb_encode
from orogen.shading.light import light_of
from orogen.shading.ramp import ramp_color, ramp_table
from orogen.shading.style import Style
from orogen.source import open_height
from orogen.view.flight import Flight
from orogen.view.renderer import Picture, Renderer

SIZE = (72, 48)
MEASURED = ("psnr", "shapes", "surface", "cracks", "stability")


def terrain(rows: int = 150, columns: int = 170) -> np.ndarray:
    """Waves and a little noise, (rows, columns) metres."""
    y, x = np.mgrid[0:rows, 0:columns]
    noise = np.random.default_rng(5).normal(0, 4, (rows, columns))
    return (300 + 120 * np.sin(x / 9) * np.cos(y / 13) + noise).astype(np.float32)


def quiet(fraction: float, text: str) -> None:
    pass


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds with a jump in the middle."""
    path = tmp_path_factory.mktemp("flight") / "jump.json"
    keys = [
        {"t": 0, "look_at": [0.4, 0.5], "distance": 0.5, "pitch": -30},
        {"t": 0.9, "look_at": [0.5, 0.5], "distance": 0.4, "pitch": -25},
        {"t": 1, "look_at": [0.6, 0.6], "distance": 0.9, "heading": 90, "pitch": -40, "cut": True},
        {"t": 2, "look_at": [0.6, 0.5], "distance": 0.8, "heading": 90, "pitch": -40},
    ]
    path.write_text(json.dumps({"name": "jump", "relative": True, "keyframes": keys}))
    return path


@pytest.fixture(scope="module")
def plan(flight: Path) -> Plan:
    return Plan(
        terrain(),
        (Entry("raycast"), Entry("udlod", {"pixels_per_quad": 8}, "coarse")),
        options={"spacing": 20.0},
        flight=str(flight),
        size=SIZE,
        fps=10.0,
        frames=None,
        every=5,
        metrics=MEASURED,
        repeats=2,
        pictures=1,
    )


@pytest.fixture(scope="module")
def finished(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a comparison that ran through."""
    folder = tmp_path_factory.mktemp("finished") / "out"
    assert orogen.compare.run(plan, folder) == folder / "report.html"
    return folder


def lines(folder: Path, name: str) -> list[dict]:
    return [json.loads(line) for line in (folder / "frames" / f"{name}.jsonl").read_text().splitlines()]


def lasting(line: dict) -> dict:
    """What must be the same in every run."""
    return {key: value for key, value in line.items() if key not in ("gpu", "cpu", "wall", "memory")}


def test_a_line_for_each_frame(finished: Path) -> None:
    for name in ("raycast", "coarse"):
        assert [(line["frame"], line["time"]) for line in lines(finished, name)] == [
            (0, 0.0), (5, 0.5), (10, 1.0), (15, 1.5)
        ]  # fmt: skip
    for line in lines(finished, "coarse"):
        assert line["triangles"] > 100
        assert 20 < line["psnr"] < 60
        assert line["cracks"] == 0
        assert 0 < line["cpu"] < line["wall"]
        assert line["memory"]["gpu"]["atlas height"] > 0
        assert line["memory"]["host"] is None or line["memory"]["host"] > 1 << 20


def test_shapes_of_triangles_are_counted(finished: Path) -> None:
    for line in lines(finished, "coarse"):
        shapes, angles = line["shapes"], line["angles"]
        assert shapes["degenerate"] + sum(angles.values()) == line["triangles"]
        assert shapes["slivers"] == angles["00"] + angles["05"]
        assert shapes["sliver_share"] == shapes["slivers"] / line["triangles"]
        assert 20 < shapes["smallest_angle"] < 50
    assert all(line["shapes"] is None for line in lines(finished, "raycast"))


def test_rays_over_resident_level_0_are_the_reference(finished: Path) -> None:
    for line in lines(finished, "raycast"):
        assert line["psnr"] == math.inf
        assert line["backward"]["max"] < 1e-3
        assert line["rays"] == SIZE[0] * SIZE[1]


def test_stability_starts_anew_after_a_cut(finished: Path) -> None:
    assert [line["instability_mean"] is None for line in lines(finished, "coarse")] == [True, False, True, False]


def test_the_plan_says_what_was_done(finished: Path, plan: Plan) -> None:
    kept = json.loads((finished / "plan.json").read_text())
    assert kept["flight"]["numbers"] == [0, 5, 10, 15]
    assert (kept["flight"]["name"], kept["flight"]["duration"], kept["flight"]["cuts"]) == ("jump", 2.0, [1.0])
    assert kept["grid"] == {
        "size": [170, 150], "spacing": pytest.approx(20.0), "crs": None,
        "height_range": [float(plan.data.min()), float(plan.data.max())],
    }  # fmt: skip
    assert [entry["folder"] for entry in kept["entries"]] == ["raycast", "coarse"]
    assert kept["entries"][1]["settings"]["pixels_per_quad"] == 8.0
    assert kept["entries"][1]["given"] == {"pixels_per_quad": 8}
    assert kept["machine"]["cores"] >= 1
    assert kept["adapter"]["name"]


def test_pictures_are_kept(finished: Path) -> None:
    found = {str(path.relative_to(finished / "pictures")) for path in (finished / "pictures").rglob("*.png")}
    assert found == {
        f"{n}.png" for n in ("reference/0010", "raycast/0010", "raycast/0010_wire", "coarse/0010", "coarse/0010_wire")
    }
    true, exact, coarse, wire = (
        np.asarray(Image.open(finished / "pictures" / name)).astype(float)
        for name in ("reference/0010.png", "raycast/0010.png", "coarse/0010.png", "coarse/0010_wire.png")
    )
    assert true.shape == (*SIZE[::-1], 3)
    assert np.array_equal(true, exact)
    line = lines(finished, "coarse")[2]
    assert line["psnr"] == pytest.approx(10 * math.log10(255**2 / np.mean((true - coarse) ** 2)))
    assert wire.sum() < 0.98 * coarse.sum()


def test_a_finished_comparison_is_not_repeated(finished: Path, plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    before = {path: path.read_bytes() for path in (finished / "frames").iterdir()}
    monkeypatch.setattr(Renderer, "render", None)
    runner.run(plan, finished)
    assert {path: path.read_bytes() for path in (finished / "frames").iterdir()} == before


def test_an_interrupted_comparison_goes_on_and_gives_the_same(plan: Plan, finished: Path, tmp_path: Path) -> None:
    """Interrupted in an entry, killed while it wrote a line."""
    folder = tmp_path / "out"

    def stop(fraction: float, text: str) -> None:
        if (text, fraction) == ("coarse", 0.5):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runner.run(plan, folder, stop)
    assert [len(lines(folder, name)) for name in ("raycast", "coarse")] == [4, 2]
    with open(folder / "frames" / "coarse.jsonl", "a") as file:
        file.write('{"frame": 10, "ti')
    runner.run(plan, folder)
    for name in ("raycast", "coarse"):
        assert [lasting(line) for line in lines(folder, name)] == [lasting(line) for line in lines(finished, name)]


def test_another_plan_is_refused_and_replaced_only_when_told(plan: Plan, finished: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    small = dataclasses.replace(
        plan, entries=(Entry("raycast"),), metrics=("psnr",), every=None, frames=1, repeats=1, pictures=0
    )
    runner.run(small, folder)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(
        OutputError, match=r"holds a comparison of another plan \(another size\); choose another folder"
    ):
        runner.run(dataclasses.replace(small, size=(24, 16)), folder)
    with pytest.raises(OutputError, match=r"another .*entries"):
        runner.run(dataclasses.replace(small, entries=(Entry("udlod"),)), folder)
    assert json.loads((folder / "plan.json").read_text())["size"] == list(SIZE)
    runner.run(dataclasses.replace(small, size=(24, 16)), folder, force=True)
    assert json.loads((folder / "plan.json").read_text())["size"] == [24, 16]
    assert len(lines(folder, "raycast")) == 1
    assert (folder / "notes.txt").read_text() == "mine"


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "holiday.jpg").write_bytes(b"")
    with pytest.raises(OutputError, match="expected a new folder or a comparison"):
        Record.open(tmp_path, {})
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(OutputError, match="its plan cannot be read"):
        Record.open(tmp_path, {})
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="cannot be written"):
        Record.open(tmp_path / "file" / "x", {})


def test_data_and_flight_that_do_not_fit(plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="descent-puget: outside the data"):
        runner.run(dataclasses.replace(plan, flight="descent-puget", options={"spacing": 0.1}), tmp_path / "out")
    with pytest.raises(SettingsError, match="crop: expected a part of the 170 x 150 samples of array, got columns 100"):
        runner.run(dataclasses.replace(plan, crop=(100, 0, 100, 100)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_true_pictures_are_drawn_once(plan: Plan, finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Scenery(plan, quiet) as scenery:
        path = Flight.load(plan.flight).over(scenery.grid, scenery.heights.height_range, height_at=scenery.height_at)
        reel = Reel(path, plan.fps)
        with References(scenery) as references:
            new = references.picture(reel.shot(3))
            again = references.picture(reel.shot(3))
            assert np.array_equal(new.color, again.color)
            assert np.array_equal(new.reverse_depth, again.reverse_depth)
        monkeypatch.setattr(Renderer, "render", None)
        with References(scenery) as references:
            references.draw([reel.shot(n) for n in (0, 3, 5)], quiet)
            kept = references.picture(reel.shot(3))
            assert kept.frame == new.frame
            assert np.array_equal(kept.color, new.color)


def test_data_too_large_for_a_reference_says_so(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    with Scenery(plan, quiet) as scenery:
        renderer = scenery.exact_renderer()
        with pytest.raises(OrogenError, match=r"170 x 150 samples are too many .* 0 of 1 nodes fit.*--crop"):
            scenery.check_exact(renderer)
        renderer.close()


def test_meta_cameras_look_at_visible_ground_from_above_it(plan: Plan, finished: Path) -> None:
    with Scenery(plan, quiet) as scenery:
        path = Flight.load(plan.flight).over(scenery.grid, scenery.heights.height_range, height_at=scenery.height_at)
        with References(scenery) as references:
            picture = references.picture(Reel(path, plan.fps).shot(5))
        cameras = meta_cameras(picture, scenery.height_at)
        assert list(cameras) == ["close", "middle", "far"]
        away = []
        for camera in cameras.values():
            ground = scenery.height_at(camera.x, camera.y)
            assert math.isnan(ground) or camera.z >= ground + 3 * scenery.grid.spacing - 1e-6
            middle = scenery.exact_renderer()
            seen = middle.render(camera, (33, 21), Style(lit=False, color="plain"))
            middle.close()
            x, y, _ = seen.position[10, 16]
            away.append(math.hypot(x - picture.frame.camera.x, y - picture.frame.camera.y))
        assert away == sorted(away)
        sky = dataclasses.replace(picture, reverse_depth=np.zeros_like(picture.reverse_depth))
        assert meta_cameras(sky, scenery.height_at) == {}


@pytest.mark.parametrize("whole", [False, True])
def test_search_finds_the_value_of_a_cost(whole: bool) -> None:
    tried = []

    def cost(value: float) -> float:
        tried.append(value)
        return 1e6 / value**2

    value, reached = search(Detail("x", 1.0, 1000.0), cost, 1e6 / 50**2, whole)
    assert len(tried) == len(set(tried)) <= 12
    if whole:
        assert all(isinstance(v, int) for v in tried)
    assert abs(reached / 400 - 1) < max(CLOSE, 0.05 * whole)
    assert value == pytest.approx(50, rel=0.03)


def test_search_stays_at_the_end_where_the_target_is_out_of_reach() -> None:
    assert search(Detail("x", 2.0, 8.0), lambda v: 100 / v, 1000.0, False) == (pytest.approx(2.0), pytest.approx(50.0))
    assert search(Detail("x", 2.0, 8.0), lambda v: 100 / v, 1.0, False) == (pytest.approx(8.0), pytest.approx(12.5))
    # a setting whose larger values are the finer ones
    value, _ = search(Detail("x", 512.0, 8.0), lambda v: 2 * v * v, 2 * 100.0**2, True)
    assert value == pytest.approx(100, abs=3)


def test_equal_triangles(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from orogen.lod.udlod import Udlod

    monkeypatch.setattr(Udlod, "detail", Detail("pixels_per_quad", 0.5, 64.0))
    few = dataclasses.replace(
        plan,
        entries=(Entry("raycast"), Entry("udlod")),
        equal_triangles=40_000,
        metrics=("psnr",),
        repeats=1,
        pictures=0,
    )
    runner.run(few, tmp_path / "out")
    raycast, udlod = json.loads((tmp_path / "out" / "plan.json").read_text())["entries"]
    assert raycast["calibrated"] is None
    found = udlod["calibrated"]
    assert (found["setting"], found["target"]) == ("pixels_per_quad", 40_000.0)
    assert udlod["settings"]["pixels_per_quad"] == found["value"]
    assert udlod["label"] == "udlod"
    # all four frames are sample frames: what was counted without drawing is what was drawn
    drawn = [line["triangles"] for line in lines(tmp_path / "out", "udlod")]
    assert found["reached"] == pytest.approx(np.mean(drawn))
    assert 0.5 < found["reached"] / 40_000 < 2
    # resuming keeps what was found
    runner.run(few, tmp_path / "out")


def test_several_numbers_of_triangles(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that can be reached, one that cannot, and one that there is no memory for."""
    from orogen.lod.udlod import Udlod, View

    record = View.record

    def limited(self: View, *arguments: Any) -> Any:
        if self._algorithm.settings.pixels_per_quad < 1:
            raise BudgetError("too many")
        return record(self, *arguments)

    monkeypatch.setattr(View, "record", limited)
    monkeypatch.setattr(Udlod, "detail", Detail("pixels_per_quad", 0.5, 24.0))
    targets = (24_000, 10, 10**9)
    several = dataclasses.replace(
        plan, entries=(Entry("raycast"), Entry("udlod")), equal_triangles=targets, metrics=("psnr", "surface"),
        repeats=1, pictures=0,
    )  # fmt: skip
    runner.run(several, tmp_path / "out")
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    rows = results["targets"]
    assert [(row["label"], row["target"], row["met"]) for row in rows] == [
        ("udlod", 24_000, True), ("udlod", 10, False), ("udlod", 10**9, False), ("raycast", None, None)
    ]  # fmt: skip
    near, few, many, rays = rows
    assert 19_200 < near["triangles"] < 30_000
    assert few["triangles"] < near["triangles"] < many["triangles"]
    assert few["value"] > near["value"] > many["value"] >= 1
    assert few["error_mean"] > near["error_mean"] > rays["error_mean"]
    frames = lines(tmp_path / "out", "udlod_10")
    assert few["error_max"] == max(max(line[way]["max"] for way in ("forward", "backward")) for line in frames)
    mse = np.mean([line["mse"] for line in frames])
    assert few["psnr"] == pytest.approx(10 * math.log10(255**2 / mse))
    assert few["cpu"] == pytest.approx(np.mean([line["cpu"] for line in frames]))
    assert (rays["triangles"], rays["setting"]) == (0, None)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"udlod does not come nearer to 10 triangles than {few['triangles']:,.0f}" in page
    assert "Mean screen-space error against triangles" in page


def test_equal_time_on_a_software_adapter_is_by_the_wall_clock(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """A renderer whose frames take 400 ms a vertex, and whose timestamps say nothing."""
    from orogen.lod.udlod import Udlod

    def slow(self: Renderer, *_: object) -> Picture:
        time.sleep(0.4 / self.algorithm.settings.pixels_per_quad)
        return Picture(None, None, None, Statistics(), {"raster": 1.0})

    monkeypatch.setattr(Udlod, "detail", Detail("pixels_per_quad", 2.0, 64.0))
    monkeypatch.setattr(Renderer, "render", slow)
    timed = dataclasses.replace(plan, entries=(Entry("udlod"),), equal_time=40.0, repeats=1)
    with Scenery(timed, quiet) as scenery:
        monkeypatch.setattr(scenery.gpu, "info", dataclasses.replace(scenery.gpu.info, kind="cpu"))
        entry, found = calibrate(timed.entries[0], scenery, [Shot(0, 0.0, Camera(0.0, 0.0, 0.0))])
    assert 5 < found.value < 15
    assert entry.values()["pixels_per_quad"] == found.value
    assert found.reached == pytest.approx(40, rel=0.3)


def test_a_crop_reads_its_window() -> None:
    source = open_height(terrain(), spacing=20.0)
    cut = Crop(source, (30, 40, 100, 90))
    whole = source.read(slice(0, 150), slice(0, 170))
    assert np.array_equal(cut.read(slice(5, 60), slice(0, 100)), whole[45:100, 30:130])
    assert cut.grid.shape == (90, 100)
    assert cut.grid.to_crs(0.5, 0.5) == source.grid.to_crs(30.5, 40.5)
    estimate = cut.overview((9, 10))
    assert estimate.shape == (9, 10)
    assert estimate[4, 5] == whole[40 + 45, 30 + 55]
    with open_pyramid(cut) as pyramid:
        assert np.array_equal(pyramid.read(0, slice(0, 90), slice(0, 100)), whole[40:130, 30:130])
    with pytest.raises(SettingsError, match="rows 100 to 190"):
        Crop(source, (30, 100, 100, 90))


def test_a_crop_in_a_map_projection_has_its_own_scale(data_dir: Path) -> None:
    source = open_height(data_dir / "taiwan_20m_10481x19401_int16.tif")
    north, south = (Crop(source, (4000, row, 512, 512)).grid for row in (0, 18000))
    # lengths on a Mercator map are too long by 1 / cos(latitude), 25.3 and 21.9 degrees
    assert north.ground_scale[0] == pytest.approx(math.cos(math.radians(25.3)), rel=5e-3)
    assert south.ground_scale[0] == pytest.approx(math.cos(math.radians(21.9)), rel=5e-3)
    source.close()


def test_prelit_light_follows_the_formula() -> None:
    """Float64 normals from cross products; sheared steps."""
    heights = terrain(40, 50).astype(np.float64)
    metres = np.array([[20.0, 3.0], [2.0, -19.0]])
    style = Style(sun=(200.0, 25.0), exposure=0.8, ramp="hypso", ramp_range=(150.0, 420.0))
    down, along = np.gradient(heights)
    one = np.ones_like(heights)
    right = np.stack([metres[0, 0] * one, metres[1, 0] * one, along], axis=-1)
    below = np.stack([metres[0, 1] * one, metres[1, 1] * one, down], axis=-1)
    normal = np.cross(below, right)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True) * np.sign(normal[..., 2:])
    light = light_of(style)
    up = 0.5 + 0.5 * normal[..., 2:]
    seen = (
        light.sun_color * np.maximum(normal @ light.sun, 0)[..., None] + light.skylight * up + light.bounce * (1 - up)
    )
    expected = 255 * srgb_encode(ramp_color(ramp_table("hypso"), (heights - 150) / 270) * seen * 0.8)
    assert np.abs(prelit.lit(heights, metres, (0.0, 1.0), style) - expected).max() < 0.6


def test_prelit_light_is_that_of_a_plane() -> None:
    metres = np.array([[20.0, 0.0], [0.0, -20.0]])
    y, x = np.mgrid[0:6, 0:7]
    style = Style(sun=(90.0, 30.0), ramp="grey", ramp_range=(-1e6, 1e6))
    level, east, west = (prelit.lit(slope * 20 * x + 0.0 * y, metres, (0.0, 1.0), style) for slope in (0, -0.5, 0.5))
    for picture in (level, east, west):
        assert picture.shape == (6, 7, 3)
        assert np.ptp(picture.reshape(-1, 3), axis=0).max() == 0
    assert west[0, 0].max() < level[0, 0].min() < level[0, 0].max() < east[0, 0].min()
    # rows go south: ground that rises with them faces north
    noon = dataclasses.replace(style, sun=(180.0, 30.0))
    assert (
        prelit.lit(-10.0 * y, metres, (0.0, 1.0), noon)[0, 0, 0]
        > prelit.lit(10.0 * y, metres, (0.0, 1.0), noon)[0, 0, 0]
    )


def test_prelit_strips_fit_together(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import rasterio

    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(prelit, "STRIP", 37)
    heights = terrain()
    with open_pyramid(open_height(heights, spacing=20.0)) as pyramid:
        path = prelit.prelit_image(pyramid, Style(), quiet)
        with rasterio.open(path) as file:
            stored = np.moveaxis(file.read(), 0, 2)
            assert tuple(file.transform)[:6] == pyramid.grid.transform
        assert np.array_equal(stored, prelit.lit(heights, pyramid.grid.metres, pyramid.height_range, Style()))
        monkeypatch.setattr(prelit, "lit", None)
        assert prelit.prelit_image(pyramid, Style(), quiet) == path
        with pytest.raises(TypeError):
            prelit.prelit_image(pyramid, Style(sun=(0.0, 50.0)), quiet)


def test_prelit_pictures_are_the_image(plan: Plan, tmp_path: Path) -> None:
    """Seen straight down at one texel a pixel, a picture of the reference is the image."""
    lit = dataclasses.replace(plan, prelit=True, size=(64, 64))
    with Scenery(lit, quiet) as scenery:
        x, y = scenery.grid.to_crs(85.0, 75.0)
        away = 32 * 20.0 / math.tan(math.radians(1.0))
        camera = Camera(float(x), float(y), 300.0 + away, pitch=-90.0, fov=2.0)
        with References(scenery) as references:
            picture = references.picture(Shot(0, 0.0, camera))
        image = prelit.lit(lit.data, scenery.grid.metres, scenery.heights.height_range, Style()).astype(float)
    shown = picture.color[8:-8, 8:-8, :3].astype(float)
    expected = image[75 - 24 : 75 + 24, 85 - 24 : 85 + 24]
    assert np.abs(shown - expected).mean() < 3
    assert np.corrcoef(shown.ravel(), expected.ravel())[0, 1] > 0.99


@pytest.mark.timeout(300)  # three processes that make their pipelines
def test_a_cluster_measures_what_this_process_measures(plan: Plan, finished: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path / "dask")
    ) as cluster:
        runner.run(plan, tmp_path / "out", scheduler=cluster.scheduler_address)
    for name in ("raycast", "coarse"):
        assert [lasting(line) for line in lines(tmp_path / "out", name)] == [
            lasting(line) for line in lines(finished, name)
        ]
    kept = sorted(path.relative_to(finished) for path in (finished / "pictures").rglob("*.png"))
    assert kept
    for path in kept:
        assert (tmp_path / "out" / path).read_bytes() == (finished / path).read_bytes()
