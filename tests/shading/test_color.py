import numpy as np
import pytest
from skimage import color as reference

from orogen.errors import SettingsError
from orogen.shading.color import linear_of_oklab, oklab, parse_hex, srgb_decode, srgb_encode


def test_srgb_agrees_with_xyz_of_another_library():
    # Y of grey is its linear intensity
    grey = np.linspace(0, 1, 1001)
    luminance = reference.rgb2xyz(np.repeat(grey[:, None], 3, axis=1))[:, 1]
    np.testing.assert_allclose(srgb_decode(grey), luminance, atol=2e-5)


def test_srgb_round_trip_and_clip():
    x = np.random.default_rng(1).random(1000)
    np.testing.assert_allclose(srgb_encode(srgb_decode(x)), x, atol=1e-7)
    np.testing.assert_allclose(srgb_encode([-1.0, 0.0, 1.0, 7.0]), [0, 0, 1, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("rgb", "lab"),
    [  # published with the colour space
        ((1, 1, 1), (1, 0, 0)),
        ((1, 0, 0), (0.62796, 0.22486, 0.12585)),
        ((0, 1, 0), (0.86644, -0.23389, 0.17950)),
        ((0, 0, 1), (0.45201, -0.03246, -0.31153)),
    ],
)
def test_oklab_of_primaries(rgb, lab):
    np.testing.assert_allclose(oklab(rgb), lab, atol=1e-4)


def test_oklab_round_trip():
    rgb = np.random.default_rng(2).random((100, 3))
    np.testing.assert_allclose(linear_of_oklab(oklab(rgb)), rgb, atol=1e-6)


def test_hex():
    np.testing.assert_allclose(parse_hex("#ff8000"), [1, 0.2158605, 0], atol=1e-6)
    for wrong in ("ff8000", "#ff80", "#gg8000", "#ff80001", "red"):
        with pytest.raises(SettingsError, match="#rrggbb"):
            parse_hex(wrong)
