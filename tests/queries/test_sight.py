"""Lines of sight against dense sampling of the surface, a sphere, Embree and each other; viewsheds and shadows."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from oracle.crops import crop
from orogen.camera import Camera
from orogen.compare.embree import EmbreeSurface
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.grid import EARTH_RADIUS
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.queries import Queries, march
from orogen.source.open import open_height

NAMES = ("taiwan", "puget")
REFRACTION = 0.13


def asked(data_dir: Path, name: str, size: int) -> tuple[Queries, Pyramid, NDArray[np.float32]]:
    heights, grid = crop(data_dir, name, size)
    pyramid = open_pyramid(open_height(heights, spacing=grid.spacing))
    return Queries(pyramid), pyramid, heights


def clearance(
    surface: TrueSurface, spacing: float, a: NDArray[np.float64], b: NDArray[np.float64], factor: float
) -> NDArray[np.float64]:
    """Least height (m) of lines over ground that drops by factor x distance^2, looked at 64 times a texel.

    a, b: (n, 3) texel coordinates and height.
    """
    result = np.empty(len(a))
    for n in range(len(a)):
        length = float(np.abs(b[n, :2] - a[n, :2]).max())
        s = np.linspace(0, 1, max(int(64 * length), 2))
        at = a[n] + s[:, None] * (b[n] - a[n])
        distance = np.hypot(*(b[n, :2] - a[n, :2])) * spacing
        # the chord of the bent ground: lower than it by what both ends have dropped
        line = at[:, 2] - factor * distance**2 * s * (1 - s)
        result[n] = (line - surface.height(at[:, 0], at[:, 1])).min()
    return result


@pytest.mark.parametrize("name", NAMES)
def test_lines_are_clear_where_no_sample_of_the_surface_is_above_them(data_dir: Path, name: str) -> None:
    queries, pyramid, heights = asked(data_dir, name, 129)
    surface = TrueSurface(heights)
    rng = np.random.default_rng(13)
    tx, ty = rng.uniform(0.5, 128.5, (2, 400)), rng.uniform(0.5, 128.5, (2, 400))
    above = rng.choice([0.0, 1.7, 60.0, 400.0], (2, 400))
    places = [np.stack([*pyramid.grid.to_crs(x, y), h], axis=-1) for x, y, h in zip(tx, ty, above, strict=True)]
    found = queries.line_of_sight(*places)
    ends = [np.stack([x, y, surface.height(x, y) + h], axis=-1) for x, y, h in zip(tx, ty, above, strict=True)]
    least = clearance(surface, pyramid.grid.spacing, *ends, (1 - REFRACTION) / (2 * EARTH_RADIUS))
    # between two looks the surface may rise a little
    firm = (least < -0.01) | (least > -1e-9)
    assert firm.mean() > 0.9
    assert 0.1 < found.visible.mean() < 0.9
    np.testing.assert_array_equal(found.visible[firm], least[firm] > -1e-9)
    assert found.known.all()
    # the other way round it is the same
    np.testing.assert_array_equal(queries.line_of_sight(*places[::-1]).visible, found.visible)
    # what is in the way lies on the ground
    hidden = ~found.visible
    x, y, z = found.obstacle[hidden].T
    np.testing.assert_allclose(queries.height_at(x, y), z, atol=2e-6)
    assert np.isnan(found.obstacle[~hidden]).all()


def test_the_horizon_of_a_level_sea_is_that_of_a_sphere() -> None:
    """From a height h one sees h = d^2 (1 - refraction) / 2R far; both ends add."""
    size, spacing = 601, 100.0
    queries = Queries(open_pyramid(open_height(np.zeros((size, size), np.float32), spacing=spacing)))
    y = (size / 2) * spacing
    for refraction in (0.0, 0.13):
        reach = [math.sqrt(h * 2 * EARTH_RADIUS / (1 - refraction)) for h in (30.0, 10.0)]
        assert sum(reach) < (size - 2) * spacing
        for factor, seen in ((0.999, True), (1.001, False)):
            found = queries.line_of_sight([50.0, y, 30.0], [50.0 + factor * sum(reach), y, 10.0], refraction=refraction)
            assert bool(found.visible) is seen
            if not seen:
                assert found.obstacle[0] == pytest.approx(50 + reach[0], rel=0.05)
    assert queries.line_of_sight([50.0, y, 0.1], [6e4, y, 0.1], curvature=False).visible
    view = queries.viewshed((50.0, y), height=30.0).values()
    seen = np.flatnonzero(view[size // 2] == 1)
    assert seen.max() * spacing == pytest.approx(math.sqrt(30.0 * 2 * EARTH_RADIUS / 0.87), abs=spacing)


def test_a_viewshed_is_a_line_of_sight_to_every_sample(data_dir: Path) -> None:
    for name in NAMES:
        queries, pyramid, _ = asked(data_dir, name, 200)
        grid = pyramid.grid
        x, y = (float(v) for v in grid.to_crs(71.3, 110.8))
        view = queries.viewshed((x, y), height=30.0, target_height=2.0, radius=80 * grid.spacing)
        values = view.values()
        j, i = np.mgrid[: values.shape[0], : values.shape[1]]
        tx, ty = view.grid.to_crs(i + 0.5, j + 0.5)
        lines = queries.line_of_sight([x, y, 30.0], np.stack([tx, ty, np.full(tx.shape, 2.0)], axis=-1))
        near = np.hypot(tx - x, ty - y) <= 80 * grid.spacing
        assert 0.02 < (values == 1).mean() < 0.6
        np.testing.assert_array_equal(values, np.where(near, lines.visible, 255))


def test_a_viewshed_without_numba_is_the_same(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    queries, pyramid, _ = asked(data_dir, "taiwan", 150)
    place = tuple(float(v) for v in pyramid.grid.to_crs(60.0, 90.0))
    compiled = queries.viewshed(place).values()
    monkeypatch.setattr(march, "_solver", lambda: march.solve)
    np.testing.assert_array_equal(queries.viewshed(place).values(), compiled)


@pytest.mark.parametrize("name", NAMES)
def test_viewsheds_agree_with_embree(data_dir: Path, name: str) -> None:
    """Rays through triangles that leave the surface by up to 1/256 of a cell's twist: but for what just grazes."""
    pytest.importorskip("embreex")
    queries, pyramid, heights = asked(data_dir, name, 65)
    grid = pyramid.grid
    x, y = (float(v) for v in grid.to_crs(30.2, 33.7))
    eye = Camera(x, y, float(queries.height_at(x, y)) + 20.0)
    surface = EmbreeSurface(Frame(eye, grid, (8, 8)), heights)
    j, i = np.mgrid[:65, :65]
    tx, ty = grid.to_crs(i.ravel() + 0.5, j.ravel() + 0.5)
    target = np.stack([tx - x, ty - y, heights.ravel() + 1.0 - eye.z], axis=-1)
    t, _ = surface.cast(np.zeros_like(target), target)
    clear = ~(t < 1)
    view = queries.viewshed((x, y), height=20.0, target_height=1.0, curvature=False).values()
    assert 0.1 < clear.mean() < 0.9
    assert (view.ravel() == clear).mean() >= 0.999


def test_missing_data_is_told() -> None:
    heights = np.zeros((40, 60), np.float32)
    heights[:, 20:24] = np.nan
    heights[:, 40] = 50.0
    queries = Queries(open_pyramid(open_height(heights, spacing=10.0)))
    start = [55.0, 200.0, 2.0]
    ends = [[105.0, 200.0, 2.0], [305.0, 200.0, 2.0], [505.0, 200.0, 2.0], [225.0, 200.0, 2.0], [5e3, 200.0, 2.0]]
    found = queries.line_of_sight(start, ends)
    assert found.visible.tolist() == [True, True, False, False, False]
    assert found.known.tolist() == [True, False, False, False, False]
    np.testing.assert_allclose(found.distance, [50, 250, 450, 170, 4945])
    view = queries.viewshed((55.0, 200.0)).values()
    assert (view[:, 20:24] == 255).all()
    assert (view[:, 24:39] != 255).all()
    line = queries.profile([[55.0, 200.0], [305.0, 200.0]], 10.0)
    assert not line.complete
    assert np.isnan(line.height).sum() == 4
    with pytest.raises(SettingsError, match="observer: expected a place with data, got 225, 200"):
        queries.viewshed((225.0, 200.0))
    with pytest.raises(SettingsError, match="a: expected at least 0 metres above the ground, got -1"):
        queries.line_of_sight([5.0, 5.0, -1.0], start)


def test_shadows_end_where_the_sun_sets_behind_a_wall() -> None:
    """A wall of 30 m, sun from the west at 20 degrees: 30 / tan 20 m behind its ridge lie in its shadow."""
    spacing = 2.0
    heights = np.zeros((64, 400), np.float32)
    heights[:, 100] = 30.0
    queries = Queries(open_pyramid(open_height(heights, spacing=spacing)))
    lit = queries.shadow((270.0, 20.0)).values()
    behind = (np.arange(400) - 100) * spacing
    expected = ~((behind > 0) & (behind < 30 / math.tan(math.radians(20))))
    np.testing.assert_array_equal(lit, np.broadcast_to(expected, lit.shape))
    assert (queries.shadow((90.0, 90.0)).values() == 1).all()
    with pytest.raises(SettingsError, match="sun: expected an azimuth and an elevation above 0 to 90"):
        queries.shadow((270.0, 0.0))


def test_shadows_agree_with_embree(data_dir: Path) -> None:
    pytest.importorskip("embreex")
    queries, pyramid, heights = asked(data_dir, "taiwan", 65)
    surface = EmbreeSurface(Frame(Camera(*pyramid.grid.bounds[:2], 0.0), pyramid.grid, (8, 8)), heights)
    azimuth, elevation = np.radians([300.0, 25.0])
    sun = np.array([np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)])
    # lifted by more than the triangles and float32 are off
    origin = surface.vertices.reshape((64 * 8 + 1, 64 * 8 + 1, 3))[::8, ::8].reshape(-1, 3) + np.array([0, 0, 0.05])
    t, _ = surface.cast(origin, np.broadcast_to(sun, origin.shape))
    lit = queries.shadow((300.0, 25.0)).values()
    assert 0.3 < lit.mean() < 0.97
    assert (lit.ravel() == np.isnan(t)).mean() > 0.99


def test_fields_may_be_read_in_parts(data_dir: Path) -> None:
    queries, pyramid, _ = asked(data_dir, "taiwan", 300)
    place = tuple(float(v) for v in pyramid.grid.to_crs(150.0, 150.0))
    field = queries.viewshed(place, height=100.0, radius=100 * pyramid.grid.spacing)
    values = field.values()
    np.testing.assert_array_equal(field.read(slice(20, 90), slice(70, 71)), values[20:90, 70:71])
    tiles = np.full(values.shape, 77, np.uint8)
    for rows, cols in field.tiles(64):
        tiles[rows, cols] = field.read(rows, cols)
    np.testing.assert_array_equal(tiles, values)
    with pytest.raises(SettingsError, match="viewshed: expected rows within 0 to"):
        field.read(slice(0, 5000), slice(0, 1))
