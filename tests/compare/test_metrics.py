"""Picture metrics against their definitions, and what a frame's record holds."""

from __future__ import annotations

import importlib.util
import json
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from oracle.cellwalk import depth_picture
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare import metrics
from orogen.compare.cracks import find_cracks
from orogen.compare.metrics import METRICS, available, delta_e, flip, measure_frame, psnr, ssim
from orogen.compare.surface_error import surface_error
from orogen.compare.temporal import History
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import Grid
from orogen.lod.contract import Statistics
from orogen.view.renderer import Picture

SIDE = 65
GRID = Grid(SIDE, SIDE, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
HILLS = hills(SIDE, 300.0)
CAMERA = Camera(5e5 + 900, 4e6 - 2300, 900, heading=8, pitch=-30)


def noise(seed: int, shape: tuple[int, ...] = (20, 24, 3)) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def near(picture: NDArray[np.uint8], steps: int, seed: int = 9) -> NDArray[np.uint8]:
    """The picture with noise of at most so many steps."""
    change = np.random.default_rng(seed).integers(-steps, steps + 1, picture.shape)
    return np.clip(picture.astype(int) + change, 0, 255).astype(np.uint8)


def pictures(raised: float, step: float = 0.0) -> tuple[Picture, Picture]:
    """A drawn and a true picture of the hills; `step` moves the camera north."""
    frame = Frame(CAMERA.moved(y=CAMERA.y + step), GRID, (120, 80), height_range=(-100.0, 500.0))
    made = []
    for heights in (HILLS + raised, HILLS):
        depth = depth_picture(frame, heights)
        shade = np.where(depth > 0, np.nan_to_num(frame.positions(depth)[..., 2]) / 400 * 255, 200).clip(0, 255)
        color = np.repeat(shade.astype(np.uint8)[..., None], 4, axis=2)
        made.append(Picture(frame, color, depth.astype(np.float32), Statistics()))
    return made[0], made[1]


def test_psnr_is_the_document_s() -> None:
    first, second = noise(1), noise(2)
    height, width = first.shape[:2]
    total = 0
    for y in range(height):
        for x in range(width):
            for c in range(3):
                total += (int(first[y, x, c]) - int(second[y, x, c])) ** 2
    mse = total / (3 * width * height)
    assert psnr(first, second) == pytest.approx(10 * math.log10((2**8 - 1) ** 2 / mse), rel=1e-12)


def test_psnr_of_known_pictures() -> None:
    black = np.zeros((4, 5, 3), np.uint8)
    assert psnr(black, black) == math.inf
    assert psnr(black, black + 255) == 0
    assert psnr(black, black + 1) == pytest.approx(48.1308, abs=1e-4)


def test_alpha_is_no_channel() -> None:
    first, second = noise(1, (8, 9, 4)), noise(2, (8, 9, 4))
    assert psnr(first, second) == psnr(first[..., :3], second[..., :3])


def ssim_twin(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    """Wang et al. 2004: a Gaussian window of 11 x 11 pixels with sigma 1.5, moved over every place where it fits."""
    line = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window = np.outer(line, line) / line.sum() ** 2
    values = []
    for c in range(3):
        for y in range(first.shape[0] - 10):
            for x in range(first.shape[1] - 10):
                a, b = (p[y : y + 11, x : x + 11, c].astype(float) for p in (first, second))
                ma, mb = (window * a).sum(), (window * b).sum()
                va, vb = (window * a * a).sum() - ma**2, (window * b * b).sum() - mb**2
                cov = (window * a * b).sum() - ma * mb
                c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
                values.append((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2)))
    return float(np.mean(values))


def test_ssim_is_its_definition() -> None:
    first = noise(1)
    for second in (near(first, 30), noise(2)):
        assert ssim(second, first) == pytest.approx(ssim_twin(second, first), abs=1e-6)
    assert ssim(first, first) == pytest.approx(1)
    assert math.isnan(ssim(first[:10], first[:10]))


def test_flip_grows_with_the_difference() -> None:
    pytest.importorskip("flip_evaluator")
    first = noise(1, (60, 80, 3))
    values = [flip(near(first, steps), first) for steps in (0, 4, 40)]
    assert values[0] == 0
    assert values[0] < values[1] < values[2] < 1
    black = np.zeros((60, 80, 3), np.uint8)
    assert flip(black, black + 255) > 0.9


def test_colour_difference_of_known_pictures() -> None:
    black = np.zeros((3, 3, 3), np.uint8)
    assert delta_e(black, black) == 0
    assert delta_e(black, black + 255) == pytest.approx(100, abs=1e-3)


@pytest.mark.parametrize("metric", [psnr, ssim, flip, delta_e])
def test_pictures_that_do_not_fit_are_refused(metric: object) -> None:
    if metric is flip:
        pytest.importorskip("flip_evaluator")
    with pytest.raises(SettingsError, match=r"drawn: expected the reference's size \(20, 24\), got \(20, 23\)"):
        metric(noise(1)[:, :-1], noise(2))  # type: ignore[operator]
    with pytest.raises(SettingsError, match="reference: expected uint8"):
        metric(noise(1), noise(2).astype(np.float32))  # type: ignore[operator]


def test_a_record_holds_what_the_instruments_say() -> None:
    drawn, true = pictures(20.0)
    surface = TrueSurface(HILLS)
    record = measure_frame(drawn, true, surface, History(), set(METRICS) - {"flip"})
    error = surface_error(drawn.reverse_depth, true.reverse_depth, drawn.frame, surface)
    cracks = find_cracks(drawn.reverse_depth, true.reverse_depth, drawn.frame)
    assert record["psnr"] == psnr(drawn.color, true.color) < 60
    assert record["psnr"] == pytest.approx(10 * math.log10(255**2 / record["mse"]))
    assert record["forward"]["p99"] == error.forward.p99 > 0.5
    assert record["backward"]["over_1px"] == error.backward.over_one > 0
    assert (record["hidden"], record["stray"]) == (error.hidden, error.stray)
    assert (record["cracks"], record["lost"]) == (cracks.count, cracks.lost)
    # nothing to compare the first frame with
    assert record["instability_mean"] is record["popping"] is None
    json.dumps(record, allow_nan=False)


def test_stability_needs_the_frames_before() -> None:
    history, surface = History(), TrueSurface(HILLS)
    records = [measure_frame(*pictures(4.0, 3.0 * k), surface, history, {"stability"}) for k in range(3)]
    assert [record["instability_mean"] is None for record in records] == [True, False, False]
    assert [record["swimming"] is None for record in records] == [True, True, False]
    assert records[2]["instability_mean"] < 1e-3
    assert records[2]["popping"] == 0


def test_only_what_is_asked_for_is_measured() -> None:
    drawn, true = pictures(0.0)
    assert measure_frame(drawn, true, None, History(), {"psnr"}) == {"mse": 0.0, "psnr": math.inf}
    assert measure_frame(drawn, true, None, History(), ()) == {}


def test_bad_requests_are_refused() -> None:
    drawn, true = pictures(0.0)
    with pytest.raises(SettingsError, match=r"metrics: expected names out of psnr, .*, got beauty"):
        measure_frame(drawn, true, None, History(), {"psnr", "beauty"})
    with pytest.raises(SettingsError, match="surface: expected the true surface for stability and surface, got None"):
        measure_frame(drawn, true, None, History(), {"psnr", "surface", "stability"})


def test_without_flip_the_colour_difference_stands_in(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    for missing, expected in ((set(), {"flip"}), ({"flip_evaluator"}, {"delta_e"}), ({"skimage"}, {"flip"})):

        def only(name: str, missing: set[str] = missing) -> object:
            return None if name in missing else found("json")

        monkeypatch.setattr(metrics.importlib.util, "find_spec", only)
        assert available() & {"flip", "delta_e"} == expected
        assert ("ssim" in available()) == ("skimage" not in missing)
