"""From light to picture, against float64."""

import numpy as np
import pytest

from orogen.shading import Style
from orogen.shading.color import parse_hex, srgb_decode, srgb_encode

SIZE = (37, 21)


def tone(color):
    peak = color.max(axis=-1, keepdims=True)
    with np.errstate(over="ignore"):
        bent = color * ((1 - 0.25 * np.exp((0.75 - peak) / 0.25)) / np.maximum(peak, 1e-30))
    return np.where(peak <= 0.75, color, bent)


def stepped(encoded):
    """What lies between two of 255 steps is moved by up to half a step, by the pixel's place (Roberts 2018, R2)."""
    rows, columns = np.indices(encoded.shape[:2])
    place = (columns * 3242174889 + rows * 2447445414) % 2**32
    return encoded * 255 + 0.98 * (place / 2**32 - 0.5)[..., None]


@pytest.fixture
def filled(studio):
    """Samples that hold random light, premultiplied by cover, of `count` samples."""

    def fill(seed, count=4, full=False):
        rng = np.random.default_rng(seed)
        light = rng.random((SIZE[1], SIZE[0], 4)).astype(np.float32) * [1.6, 1.6, 1.6, 1]
        light[..., 3] = 1 if full else np.round(light[..., 3] * count) / count
        light[..., :3] *= light[..., 3:]
        samples = studio.shading.samples(SIZE)
        samples.count = count
        studio.gpu.write(samples.light, (light * count).astype(np.float32))
        return samples, light

    return fill


@pytest.mark.parametrize("lit", [True, False])
@pytest.mark.parametrize("exposure", [1.0, 2.5])
def test_tone_exposure_and_encoding(studio, filled, lit, exposure):
    samples, light = filled(3, full=True)
    got = studio.resolve(samples, Style(lit=lit, exposure=exposure))
    color = tone(light[..., :3] * exposure) if lit else light[..., :3]
    np.testing.assert_allclose(got[..., :3], stepped(srgb_encode(color)), atol=0.51)
    np.testing.assert_array_equal(got[..., 3], 255)


def test_a_target_that_encodes_by_itself_gets_the_same_picture(studio, filled):
    samples, _ = filled(4)
    one, two = (studio.resolve(samples, Style(), form) for form in ("rgba8unorm", "rgba8unorm-srgb"))
    np.testing.assert_allclose(one.astype(int), two, atol=1)


def test_channel_order_of_windows(studio, filled):
    samples, _ = filled(5)
    one, two = (studio.resolve(samples, Style(), form) for form in ("rgba8unorm", "bgra8unorm"))
    np.testing.assert_array_equal(one, two[..., [2, 1, 0, 3]])


def test_open_background_is_transparent_and_colours_are_not_darkened_by_it(studio, filled):
    samples, light = filled(6)
    got = studio.resolve(samples, Style(background="transparent"))
    alpha = light[..., 3]
    np.testing.assert_allclose(got[..., 3], alpha * 255, atol=0.51)
    seen = alpha > 0
    expected = stepped(srgb_encode(tone(light[..., :3] / np.maximum(alpha, 1e-6)[..., None])))
    np.testing.assert_allclose(got[seen][:, :3], expected[seen], atol=0.51)


def test_background_colour_is_exact_and_blends_in_linear_light(studio, filled):
    samples, light = filled(7)
    got = studio.resolve(samples, Style(background="#ff8040", exposure=3.0))
    alpha = light[..., 3:]
    ground = tone(3 * light[..., :3] / np.maximum(alpha, 1e-6))
    expected = stepped(srgb_encode(ground * alpha + np.array(parse_hex("#ff8040")) * (1 - alpha)))
    np.testing.assert_allclose(got[..., :3], expected, atol=0.51)
    np.testing.assert_array_equal(got[..., 3], 255)
    empty = light[..., 3] == 0
    assert empty.any()
    assert {tuple(c) for c in got[empty][:, :3]} == {(255, 128, 64)}


def test_tone_curve_keeps_order_and_hue(studio):
    samples = studio.shading.samples(SIZE)
    samples.count = 1
    ramp = np.linspace(0, 8, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE[1], SIZE[0], 1)
    light = np.concatenate([ramp, 0.5 * ramp, 0.25 * ramp, np.ones_like(ramp)], axis=-1)
    studio.gpu.write(samples.light, light)
    got = studio.resolve(samples, Style())
    red = got[..., 0].ravel().astype(int)
    assert np.all(np.diff(red) >= -1)  # of two neighbouring steps either may come first
    assert np.all(np.diff(got[..., 0].mean(axis=1)) > -0.2)
    linear = srgb_decode(got[..., :3] / 255)
    bright = got[..., 0] > 100
    np.testing.assert_allclose(linear[bright][:, 1] / linear[bright][:, 0], 0.5, atol=0.02)


@pytest.mark.parametrize("form", ["rgba8unorm", "rgba8unorm-srgb"])
def test_a_clear_sky_has_no_bands_and_colours_on_a_step_stay(studio, form):
    """Light that grows by two steps of colour over the picture: the mean of every few pixels follows it."""
    size = 120, 40
    samples = studio.shading.samples(size)
    samples.count = 1
    step = np.linspace(150, 152, size[0]) * np.ones((size[1], 1))
    step[:8] = 151
    light = np.ones((size[1], size[0], 4), np.float32)
    light[..., :3] = srgb_decode(step / 255)[..., None]
    studio.gpu.write(samples.light, light)
    got = studio.resolve(samples, Style(lit=False), form)[..., 0].astype(float)
    # drivers that encode by themselves have small errors
    np.testing.assert_allclose(got[:8], 151, atol=1 if form.endswith("srgb") else 0)
    means = (got - step)[8:].reshape(4, 8, 15, 8).mean(axis=(1, 3))
    assert np.abs(means).max() < 0.15  # rounded to the nearest step some are off by 0.43


def test_the_same_light_gives_the_same_bytes(studio, filled):
    samples, _ = filled(8)
    np.testing.assert_array_equal(studio.resolve(samples, Style()), studio.resolve(samples, Style()))
