"""Wrong uses of the Python interface: each is refused by the name of what is wrong, before anything is drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import orogen
from orogen.errors import SettingsError, SourceError

HEIGHTS = np.random.default_rng(0).normal(0, 10, (32, 48)).astype(np.float32)


@pytest.fixture(scope="module")
def terrain() -> Iterator[orogen.Terrain]:
    with orogen.open(HEIGHTS, spacing=10.0) as opened:
        yield opened


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spacing": "30"}, "spacing: expected a number, got '30'"),
        ({"nodata": "none"}, "nodata: expected a number, got 'none'"),
        ({"zoom": 3}, "ndarray: zoom= and area= are for trees of map tiles"),
        ({"build": "yes"}, "build: expected one of auto, wait, background, never, got 'yes'"),
        ({"color_ramp": "terrain"}, r"color_ramp: expected color= too"),
        ({"gpu_memory": "1GB"}, "gpu_memory: expected bytes above 0 or None, got '1GB'"),
        ({"algorithm": "brutee"}, "algorithm: expected one of .*, got 'brutee'; did you mean brute?"),
        ({"settings": "memory=5"}, "settings: expected values by name, .* got 'memory=5'"),
        ({"settings": {"behind": [1]}}, r"clipmap behind: expected float, got \[1\]"),
        ({"settings": {"memory": 1}}, "memory: expected a whole number of bytes, at least 1048576"),
    ],
)
def test_opening(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        orogen.open(HEIGHTS, **{"spacing": 10.0, **options})


def test_an_image_that_cannot_be_used_leaves_nothing_open(monkeypatch: pytest.MonkeyPatch) -> None:
    from orogen import terrain as module

    closed = []
    original = module.open_height

    def watched(*arguments: Any, **options: Any) -> Any:
        source = original(*arguments, **options)
        monkeypatch.setattr(type(source), "close", lambda self: closed.append(self))
        return source

    monkeypatch.setattr(module, "open_height", watched)
    with pytest.raises(SourceError, match=r"expected colours of shape \(rows, columns, 1 to 4\), got \(3, 32, 48\)"):
        orogen.open(HEIGHTS, spacing=10.0, color=np.zeros((3, 32, 48), np.uint8))
    assert len(closed) == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda t: t.render(size=(10.5, 10)), r"size: expected width and height in whole pixels, got \(10.5, 10\)"),
        (lambda t: t.render(size=100), "size: expected width and height in whole pixels, got 100"),
        (lambda t: t.render(size=(0, 10)), "size: expected at least 1x1 pixels, got 0x10"),
        (lambda t: t.render(camera="top"), "camera: expected an orogen.Camera or None, got 'top'"),
        (lambda t: t.render(style="plain"), "style: expected an orogen.Style or None, got 'plain'"),
        (lambda t: t.render(scene=2.0), "scene: expected an orogen.Scene or None, got 2.0"),
        (lambda t: t.camera(look_at=(1, 2, 3)), r"look_at: expected 2 numbers, got \(1, 2, 3\)"),
        (lambda t: t.camera(bounds=(1, 2)), r"bounds: expected 4 numbers, got \(1, 2\)"),
        (lambda t: t.camera(heading="north"), "heading: expected finite numbers, got north"),
        (lambda t: t.camera(exaggeration=0.0), "exaggeration: expected more than 0, got 0"),
        (lambda t: t.viewshed((5, 5, 5)), r"observer: expected x, y, got \(5, 5, 5\)"),
        (lambda t: t.height_at(1, 1, crs="EPSG:4326"), "crs: expected none, since the data has none, got 'EPSG:4326'"),
        (lambda t: t.use("udlod", pixels_per_quad=[1]), r"udlod pixels_per_quad: expected float, got \[1\]"),
        (lambda _: orogen.Camera(0.0, 0.0, 0.0, heading="north"), "camera heading: expected a finite number, got nor"),
        (lambda _: orogen.Style(overlays="wireframe"), r"overlays: expected a tuple of names, .* got 'wireframe'"),
        (lambda _: orogen.Style(sun=3), "sun: expected two finite numbers, got 3"),
    ],
)
def test_an_open_terrain(terrain: orogen.Terrain, call: Callable[[Any], Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        call(terrain)


def test_a_closed_terrain_draws_no_more() -> None:
    terrain = orogen.open(HEIGHTS, spacing=10.0)
    terrain.close()
    with pytest.raises(SettingsError, match="array: expected an open terrain, got one that was closed; open it again"):
        terrain.render(size=(8, 8))
