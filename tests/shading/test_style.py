import math

import numpy as np
import pytest

from orogen.errors import SettingsError
from orogen.shading import OVERLAYS, Style
from orogen.shading.light import light_of, sun_direction
from orogen.shading.shade import contour_interval, flags_of, haze


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"color": "images"}, "color: expected one of auto, image, .*did you mean 'image'"),
        ({"ramp": "terain"}, "ramp: .*did you mean 'terrain'"),
        ({"ramp_range": (10.0, 10.0)}, "ramp_range: expected the lowest height first"),
        ({"ramp_range": (0.0, math.nan)}, "ramp_range: expected two finite numbers"),
        ({"sun": (0.0, 91.0)}, "sun: .* 0 to 90 degrees, got 91"),
        ({"sun": (math.inf, 45.0)}, "sun: expected two finite"),
        ({"sun_intensity": -1.0}, "sun_intensity: .*0 or more, got -1"),
        ({"ambient": math.nan}, "ambient: .*got nan"),
        ({"exposure": 0.0}, "exposure: .*more than 0, got 0"),
        ({"overlays": ("contour",)}, "overlays: .*did you mean 'contours'"),
        ({"contour_interval": -5.0}, "contour_interval"),
        ({"error_limit_px": 0.0}, "error_limit_px"),
        ({"wireframe_width": 17.0}, "wireframe_width: .*at most 16, got 17"),
        ({"visibility": 0.0}, "visibility: expected more than 0 metres"),
        ({"visibility": math.nan}, "visibility: expected more than 0 metres"),
        ({"background": "white"}, "background: expected 'sky', 'transparent' or '#rrggbb', got 'white'"),
        ({"background": "#12345"}, "#rrggbb"),
    ],
)
def test_a_setting_out_of_range_is_refused(settings, message):
    with pytest.raises(SettingsError, match=message):
        Style(**settings)


@pytest.mark.parametrize(
    ("sun", "direction"),
    [
        ((0, 0), (0, 1, 0)),
        ((90, 0), (1, 0, 0)),
        ((200, 90), (0, 0, 1)),
        ((315, 45), (-0.5, 0.5, math.sqrt(0.5))),
    ],
)
def test_sun_direction(sun, direction):
    np.testing.assert_allclose(sun_direction(*sun), direction, atol=1e-12)


def test_a_lower_sun_is_weaker_and_redder():
    low, high = (light_of(Style(sun=(0, elevation))).sun_color for elevation in (5, 60))
    assert np.all(low < high)
    assert low[0] / low[2] > 1.5 * high[0] / high[2]


def test_the_light_at_the_default_keeps_level_white_ground_near_white():
    light = light_of(Style())
    level = light.sun_color * light.sun[2] + light.skylight
    assert np.all(np.abs(level - 1) < 0.12)


def test_settings_scale_the_light():
    one, two = (light_of(Style(sun_intensity=k, ambient=k)) for k in (1.0, 2.0))
    np.testing.assert_allclose(two.sun_color, 2 * one.sun_color)
    np.testing.assert_allclose(two.skylight, 2 * one.skylight)


@pytest.mark.parametrize(
    ("heights", "interval"), [((-33, 3947), 200), ((0, 20), 1), ((0, 20.1), 2), ((5, 5.5), 0.05), ((7, 7), 1)]
)
def test_contours_are_round(stage, heights, interval):
    assert contour_interval(Style(), stage(height_range=heights).frame) == pytest.approx(interval)
    assert contour_interval(Style(contour_interval=3.0), stage(height_range=heights).frame) == 3


def test_haze_follows_the_data_unless_it_is_set(stage, camera_at):
    frame = stage(height_range=(-100.0, 900.0), exaggeration=2.0).frame
    diagonal = math.hypot(4096 * 25, 2048 * 30)
    assert haze(Style(), frame) == pytest.approx((0.5 / diagonal, 20 / diagonal, -200))
    assert haze(Style(visibility=5000.0), frame)[0] == 1 / 5000
    assert haze(Style(visibility=math.inf), frame)[0] == 0
    assert haze(Style(), stage(camera=camera_at(orthographic=1e4)).frame)[0] == 0


def test_what_is_not_asked_for_is_not_compiled():
    shadows, image, ramp = 2, 256, 512
    assert flags_of(Style(), image=True) & (shadows | image | ramp) == shadows | image | ramp
    assert flags_of(Style(), image=False) & (image | ramp) == ramp
    assert flags_of(Style(color="image"), image=False) & (image | ramp) == 0
    assert flags_of(Style(lit=False), image=True) & shadows == 0
    assert len({flags_of(Style(overlays=(name,)), image=True) for name in OVERLAYS}) == len(OVERLAYS)
