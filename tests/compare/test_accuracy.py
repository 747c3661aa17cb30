"""The figures of the benchmark, and the views they are taken from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from oracle.cellwalk import depth_picture
from oracle.landscapes import hills
from orogen.compare.accuracy import MEAN_TARGET, P99_TARGET, Row, measure, rows
from orogen.compare.cameras import standard_cameras
from orogen.compare.surface_error import surface_error
from orogen.compare.truth import TrueSurface
from orogen.errors import SourceError
from orogen.frame import Frame
from orogen.grid import Grid

SIDE = 65
GRID = Grid(SIDE, SIDE, (30.0, 0.0, 5e5, 0.0, -30.0, 4e6))
HILLS = hills(SIDE, 400.0)
SURFACE = TrueSurface(HILLS)


def frame_of(view: str) -> Frame:
    return Frame(standard_cameras(GRID, SURFACE)[view], GRID, (90, 60), height_range=(0.0, 400.0))


def test_rows_pool_all_views() -> None:
    views, forward, backward = [], [], []
    for view in ("whole", "high", "straight down"):
        frame = frame_of(view)
        true, drawn = depth_picture(frame, HILLS), depth_picture(frame, HILLS + 1.5)
        if view == "high":
            drawn[40, 45] = 0
        views.append(measure(view, drawn, true, frame, SURFACE))
        error = surface_error(drawn, true, frame, SURFACE)
        forward.append(error.forward_map[~np.isnan(error.forward_map)])
        backward.append(error.backward_map[~np.isnan(error.backward_map)])
    found = {row.name: row for row in rows(views)}
    drawn_points, true_points = np.concatenate(forward), np.concatenate(backward)
    assert found["cracks"] == Row("cracks", 1, "", 0)
    assert found["cracks"].met is False
    assert found["error of drawn points, mean"].value == pytest.approx(drawn_points.mean())
    assert found["error of true points, mean"].value == pytest.approx(true_points.mean())
    for name, values in (("drawn", drawn_points), ("true", true_points)):
        percentile = found[f"error of {name} points, 99 %"].value
        # never too small, and at most a bin too large
        assert (values <= percentile).mean() >= 0.99
        assert percentile == pytest.approx(np.quantile(values, 0.99, method="inverted_cdf"), abs=0.0011)
    assert found["error of drawn points, 99 %, worst view"].value == max(view.forward.p99 for view in views)
    assert found["pixels lost at outlines"].value == sum(view.lost for view in views)
    assert [row.target for row in rows(views)][:5] == [0, MEAN_TARGET, P99_TARGET, MEAN_TARGET, P99_TARGET]


def test_a_perfect_picture_meets_every_target() -> None:
    frame = frame_of("whole")
    true = depth_picture(frame, HILLS)
    met = [row.met for row in rows([measure("whole", true.astype(np.float32), true, frame, SURFACE)])]
    assert met[:5] == [True] * 5
    assert met[5:] == [None] * (len(met) - 5)


def test_nothing_to_measure_is_nan_and_meets_no_target() -> None:
    frame = frame_of("whole")
    empty = np.zeros((60, 90))
    found = {row.name: row for row in rows([measure("empty", empty, empty, frame, SURFACE)])}
    assert found["cracks"].met
    assert math.isnan(found["error of drawn points, mean"].value)
    assert not found["error of drawn points, mean"].met
    assert not found["error of true points, 99 %"].met


def test_standard_cameras_are_twelve_and_above_the_ground() -> None:
    cameras = standard_cameras(GRID, SURFACE)
    assert len(cameras) == 12
    assert cameras == standard_cameras(GRID, SURFACE)
    for name, camera in cameras.items():
        ground = SURFACE.height(*GRID.to_texel(camera.x, camera.y))
        assert not camera.z <= ground, name
        frame = Frame(camera, GRID, (90, 60), height_range=(0.0, 400.0))
        assert (depth_picture(frame, HILLS) > 0).mean() > 0.15, name
    assert cameras["straight down"].pitch == -90
    assert cameras["valley"].pitch > 0
    assert not SURFACE.inside(*GRID.to_texel(cameras["outside"].x, cameras["outside"].y))
    # the camera on the edge stands on it
    tx, _ = GRID.to_texel(cameras["edge"].x, cameras["edge"].y)
    assert tx == pytest.approx(0.5)


@pytest.mark.parametrize("grid", [
    Grid(SIDE, SIDE, (8e-4, 0, 121.0, 0, -8e-4, 46.9), "EPSG:4326", (76_000.0, 111_000.0)),
    Grid(SIDE, SIDE, (24.0, 12.0, 4e5, 10.0, -28.0, 5e6)),
    Grid(SIDE, SIDE, (30.0, 0.0, 0.0, 0.0, 30.0, 0.0)),
])  # fmt: skip
def test_standard_cameras_see_the_ground_in_any_grid(grid: Grid) -> None:
    heights = HILLS.copy()
    heights[20:30, 20:30] = np.nan
    for name, camera in standard_cameras(grid, TrueSurface(heights)).items():
        frame = Frame(camera, grid, (45, 30), height_range=(0.0, 400.0))
        assert (depth_picture(frame, heights) > 0).mean() > 0.1, name


def test_standard_cameras_need_a_valid_sample() -> None:
    with pytest.raises(SourceError, match="at least one valid sample"):
        standard_cameras(GRID, TrueSurface(np.full((SIDE, SIDE), np.nan)))
