import numpy as np
import pytest

from orogen.errors import SettingsError
from orogen.shading import ramps
from orogen.shading.color import oklab, srgb_encode
from orogen.shading.ramp import ramp_color, ramp_table

# G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, A physiologically-based model for simulation of color vision
# deficiency, 2009: complete deficiency, on linear RGB
VISION = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("name", ramps())
def test_lightness_grows_with_height_for_every_eye(name, vision):
    seen = np.clip(ramp_table(name) @ np.array(VISION[vision]).T, 0, 1)
    lightness = oklab(seen)[:, 0]
    assert np.diff(lightness).min() > 3e-4
    assert np.ptp(lightness) > 0.45


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("name", ramps())
def test_an_eighth_of_the_range_is_told_apart_by_every_eye(name, vision):
    seen = oklab(np.clip(ramp_table(name) @ np.array(VISION[vision]).T, 0, 1))
    # 0.02 is about a just noticeable difference
    assert np.linalg.norm(seen[32:] - seen[:-32], axis=1).min() > 0.03


@pytest.mark.parametrize("name", ramps())
def test_no_step_shows_within_a_ramp(name):
    encoded = srgb_encode(ramp_table(name)) * 255
    assert np.abs(np.diff(encoded, axis=0)).max() < 6


def test_lookup_is_linear_between_entries_and_clamped():
    table = ramp_table("terrain")
    np.testing.assert_allclose(ramp_color(table, [-1, 0, 1, 2]), table[[0, 0, 255, 255]])
    np.testing.assert_allclose(ramp_color(table, 100.25 / 255), 0.75 * table[100] + 0.25 * table[101], rtol=1e-6)


def test_unknown_name_lists_the_ramps_and_guesses():
    with pytest.raises(SettingsError, match=r"terrain, .*got 'virids'; did you mean 'viridis'"):
        ramp_table("virids")


def test_table_cannot_be_spoilt():
    with pytest.raises(ValueError, match="read-only"):
        ramp_table("grey")[0] = 1
