"""Settings of the clipmap are checked at birth and say what was wrong."""

from __future__ import annotations

import math
from typing import Any

import pytest

from orogen.errors import SettingsError
from orogen.streaming.settings import ClipmapSettings


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("view_distance", 0.0),
        ("view_distance", -1.0),
        ("view_distance", math.nan),
        ("load_distance", -1.0),
        ("load_distance", math.nan),
        ("behind", -0.1),
        ("behind", 1.1),
        ("behind", math.nan),
        ("blend_range", 0.0),
        ("blend_range", 1.1),
        ("node_size", 128),
        ("node_size", 300),
        ("memory", (1 << 20) - 1),
        ("memory", math.nan),
        ("host_memory", 0),
        ("upload_budget", -1),
        ("upload_budget", 2.5e7),
        ("threads", 0),
        ("threads", 1.5),
    ],
)
def test_values_out_of_range_are_named(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=rf"^{name}: expected .*, got "):
        ClipmapSettings(**{name: value})


def test_load_distance_is_at_least_view_distance() -> None:
    with pytest.raises(SettingsError, match="load_distance: expected at least view_distance"):
        ClipmapSettings(view_distance=5, load_distance=4)
    assert ClipmapSettings(view_distance=5, load_distance=7).load_distance_for((64, 64)) == 7
    # where the view distance follows the picture, it may turn out larger
    settings = ClipmapSettings(load_distance=2)
    assert settings.load_distance_for((256, 128)) == 2
    assert settings.load_distance_for((1920, 1080)) == settings.view_distance_for((1920, 1080)) == 7.5


def test_default_view_distance_is_the_pictures_longer_side_in_nodes() -> None:
    assert ClipmapSettings().view_distance_for((1280, 720)) == 5
    assert ClipmapSettings(node_size=512).view_distance_for((720, 1280)) == 2.5
    assert ClipmapSettings(view_distance=math.inf).view_distance_for((64, 64)) == math.inf


@pytest.mark.parametrize("bits", [8, 9, 10])
def test_node_bits(bits: int) -> None:
    assert ClipmapSettings(node_size=1 << bits).node_bits == bits
