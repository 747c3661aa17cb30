"""Shading on the GPU against float64."""

import dataclasses
import math

import numpy as np
import pytest

from orogen.errors import GpuError
from orogen.shading import Style
from orogen.shading.light import light_of
from orogen.shading.ramp import ramp_color, ramp_table
from orogen.shading.shade import haze

FLAT = Style(lit=False, color="plain", background="transparent")
PLAIN = 0.36
VIEWS = [
    {},
    {"pitch": -90.0},
    {"heading": 200.0, "pitch": -12.0, "roll": 25.0, "fov": 80.0},
    {"pitch": -50.0, "fov": 2.0},
    {"orthographic": 5000.0},
    {"orthographic": 900.0, "pitch": -90.0, "heading": 90.0},
]


def sky_color(light, direction):
    upward = np.maximum(direction[..., 2], 0)
    air = light.zenith + (light.horizon - light.zenith) * np.exp(-4 * upward)[..., None]
    towards = np.concatenate([direction[..., :2], upward[..., None]], axis=-1)
    near_sun = towards @ light.sun - 1
    glow = 0.18 * np.exp(6 * near_sun) + 0.35 * np.exp(120 * near_sun) + 4 * np.exp(40000 * near_sun)
    return air + light.sun_color * glow[..., None]


def plane_normal(gradient):
    normal = np.array([-gradient[0], -gradient[1], 1.0])
    return normal / np.linalg.norm(normal)


def moved_hits(stage, step=1e-3):
    """Hits (height, width, 3) a small step to the right and down, per pixel: the footprint by brute force."""
    base = dataclasses.replace(stage, jitter=(0.0, 0.0)).positions()
    right = dataclasses.replace(stage, jitter=(step, 0.0)).positions()
    down = dataclasses.replace(stage, jitter=(0.0, step)).positions()
    return (right - base) / step, (down - base) / step


@pytest.mark.parametrize("view", VIEWS)
def test_ramp_by_height(studio, stage, camera_at, view):
    scene = stage(camera=camera_at(**view), gradient=(0.15, -0.1), exaggeration=1.5)
    got = studio.light(scene, Style(lit=False, color="ramp", ramp="ember", ramp_range=(-500.0, 1500.0)))
    hit = scene.depth() > 0
    expected = ramp_color(ramp_table("ember"), (scene.heights()[hit] + 500) / 2000)
    assert hit.mean() > 0.5
    np.testing.assert_allclose(got[hit][:, :3], expected, atol=2e-3)


def test_ramp_spans_the_data_by_default(studio, stage, camera_at):
    scene = stage(camera=camera_at(pitch=-90.0), base=1234.0, height_range=(1234.0, 2000.0))
    got = studio.light(scene, Style(lit=False, color="ramp"))
    np.testing.assert_allclose(got[..., :3], np.broadcast_to(ramp_table("terrain")[0], got[..., :3].shape), atol=1e-3)


@pytest.mark.parametrize("view", VIEWS)
def test_footprint_is_the_change_of_the_hit_per_pixel(studio, stage, camera_at, view):
    scene = stage(camera=camera_at(**view), gradient=(0.3, -0.2), image_alpha=1.0)
    got = studio.light(scene, dataclasses.replace(FLAT, color="image"))
    right, down = (d[..., :2] @ np.linalg.inv(scene.frame.metres).T for d in moved_hits(scene))
    expected = np.stack([right[..., 0], right[..., 1], down[..., 0]], axis=-1)
    # beyond a grazing angle footprints stop growing
    direction = scene.frame.rays()[1]
    facing = direction @ plane_normal(scene.gradient) / np.linalg.norm(direction, axis=-1)
    hit = (scene.depth() > 0) & (facing < -0.02)
    assert hit.mean() > 0.5
    size = np.linalg.norm(expected[hit], axis=-1, keepdims=True)
    np.testing.assert_allclose(got[hit][:, :3] / size, expected[hit] / size, atol=3e-3)


def test_footprint_stays_finite_for_a_surface_that_faces_away(studio, stage):
    # coarse normals may face away from the ray that hit a finer surface
    scene = stage(image_alpha=1.0, gradient_per_level=(40.0, 40.0), lod=1.0)
    got = studio.light(scene, dataclasses.replace(FLAT, color="image"))
    assert np.isfinite(got).all()


@pytest.mark.parametrize(
    ("mode", "alpha", "expected"), [("auto", 0.25, "mix"), ("image", 0.0, "plain"), ("ramp", 1.0, "ramp")]
)
def test_image_lies_over_what_is_below_it(studio, stage, camera_at, mode, alpha, expected):
    scene = stage(camera=camera_at(pitch=-90.0), image_alpha=alpha)
    got = studio.light(scene, Style(lit=False, color=mode))[..., :3]
    image = studio.light(dataclasses.replace(scene, image_alpha=1.0), Style(lit=False, color="image"))[..., :3]
    ramp = ramp_color(ramp_table("terrain"), 2000 / 6000)
    wanted = {"mix": 0.25 * image + 0.75 * ramp, "plain": np.full_like(image, PLAIN), "ramp": ramp + 0 * image}
    np.testing.assert_allclose(got, wanted[expected], atol=2e-3)


@pytest.mark.parametrize("drawn", [0.0, 6.5])
def test_normals_come_from_the_level_whose_texels_are_as_large_as_pixels(studio, stage, camera_at, drawn):
    # the stand-in's slope grows with the level it is asked for, which tells the level
    scene = stage(camera=camera_at(z=40_000.0), gradient_per_level=(2e-3, 0.0), lod=drawn)
    style = Style(color="plain", shadows=False, ambient=0.0, sun=(270.0, 30.0), visibility=math.inf)
    got = studio.light(scene, style)[..., :3]
    light = light_of(style)
    hit = scene.depth() > 0
    lambert = (got[hit] / (PLAIN * light.sun_color)).mean(axis=-1)
    width = scene.view_depth()[hit] * 2 * scene.frame.half_extent[0] / scene.size[0]
    level = np.maximum(np.log2(width / scene.frame.grid.spacing), drawn)
    slope = 2e-3 * level
    expected = (-slope * light.sun[0] + light.sun[2]) / np.sqrt(1 + slope**2)
    assert level.max() > 5
    np.testing.assert_allclose(lambert, expected, atol=5e-4)


def test_level_of_normals_is_never_below_zero(studio, stage, camera_at):
    scene = stage(camera=camera_at(z=20.0, pitch=-90.0), gradient_per_level=(0.3, 0.0))
    style = Style(color="plain", shadows=False, ambient=0.0, visibility=math.inf)
    light = light_of(style)
    np.testing.assert_allclose(studio.light(scene, style)[..., :3] / (PLAIN * light.sun_color), light.sun[2], rtol=1e-5)


@pytest.mark.parametrize("view", [{"pitch": -8.0}, VIEWS[2], VIEWS[4]])
def test_light_shadow_haze_and_sky(studio, stage, camera_at, view):
    scene = stage(camera=camera_at(**view), gradient=(0.1, 0.25), base=-300.0, shadow_east=1500.0, exaggeration=2.0)
    style = Style(color="plain", visibility=30_000.0)
    got = studio.light(scene, style)
    light = light_of(style)
    origin, direction = scene.frame.rays()
    hit = scene.depth() > 0
    normal = plane_normal(scene.gradient)

    position = scene.positions()[hit]
    sun = np.where(position[:, :1] > 1500, 0, normal @ light.sun * light.sun_color)
    sky = light.bounce + (light.skylight - light.bounce) * (0.5 + 0.5 * normal[2])
    color = PLAIN * (sun + sky)
    if not scene.camera.orthographic:
        density, falloff, base = haze(style, scene.frame)
        way = position - origin[hit]
        far = np.linalg.norm(way, axis=-1)
        # the integral along the ray, by the midpoint rule
        along = (np.arange(2000) + 0.5) / 2000
        height = scene.camera.z + way[:, 2:] * along
        depth = density * far * np.exp(-falloff * np.maximum(height - base, 0)).mean(axis=1)
        flat = np.column_stack([way[:, :2] / far[:, None], 0 * far])
        scattered = sky_color(light, flat)
        color = scattered + (color - scattered) * np.exp(-depth)[:, None]
        assert np.exp(-depth).min() < 0.9
        assert 0 < hit.mean() < 1
        np.testing.assert_allclose(
            got[~hit][:, :3],
            sky_color(light, direction[~hit] / np.linalg.norm(direction[~hit], axis=-1, keepdims=True)),
            rtol=2e-3,
        )
    assert 0 < (position[:, 0] > 1500).mean() < 1
    # heights below those of the data do not occur, and float32 may see the wall's foot on either side
    sound = (scene.heights()[hit] > scene.height_range[0]) & (np.abs(position[:, 0] - 1500) > 1)
    assert sound.mean() > 0.5
    np.testing.assert_allclose(got[hit][sound][:, :3], color[sound], rtol=1e-3)
    np.testing.assert_array_equal(got[..., 3], 1)


def test_ground_that_faces_away_from_the_sun_gets_no_sunlight(studio, stage, camera_at):
    scene = stage(camera=camera_at(pitch=-90.0), gradient=(1.5, 0.0))
    style = Style(color="plain", sun=(90.0, 30.0), ambient=0.0, visibility=math.inf)
    np.testing.assert_array_equal(studio.light(scene, style)[scene.depth() > 0][:, :3], 0)


def test_shadows_can_be_off(studio, stage, camera_at):
    scene = stage(camera=camera_at(pitch=-90.0), shadow_east=-1e9)
    dark, bright = (studio.light(scene, Style(ambient=0.0, shadows=on, visibility=math.inf)) for on in (True, False))
    assert dark[..., :3].max() == 0
    assert bright[..., :3].min() > 0.03


def test_sky_has_a_sun_and_no_fault_at_the_nadir(studio, stage, camera_at):
    style = Style(sun=(40.0, 20.0))
    up = studio.light(stage(camera=camera_at(heading=40.0, pitch=20.0), size=(65, 65), base=-1e9), style)[..., :3]
    assert np.unravel_index(up.sum(axis=-1).argmax(), (65, 65)) == (32, 32)
    # an odd size: the middle ray points straight down, at nothing
    nothing = dataclasses.replace(stage(camera=camera_at(pitch=-90.0), size=(33, 33)), base=1e9)
    down = studio.light(nothing, style)
    assert np.isfinite(down).all()
    np.testing.assert_allclose(down[..., :3], down[16, 16, :3] + 0 * down[..., :3], atol=0.02)


def test_a_background_that_is_not_sky_is_left_open(studio, stage, camera_at):
    scene = stage(camera=camera_at(pitch=5.0))
    for background in ("transparent", "#ffffff"):
        got = studio.light(scene, Style(background=background))
        sky = scene.depth() == 0
        np.testing.assert_array_equal(got[sky], 0)
        np.testing.assert_array_equal(got[~sky][:, 3], 1)
        assert 0 < sky.mean() < 1


def test_wireframe_has_the_width_asked_for(studio, stage, camera_at):
    distance = np.arange(48 * 32).reshape(32, 48) % 256
    scene = stage(camera=camera_at(pitch=-90.0), detail=(distance << 8).astype(np.uint32))
    for width in (0.5, 1.0, 3.0):
        style = dataclasses.replace(FLAT, overlays=("wireframe",), wireframe_width=width)
        cover = np.clip(0.5 * width + 0.5 - distance / 16, 0, 1) * min(width, 1)
        np.testing.assert_allclose(studio.light(scene, style)[..., 0], PLAIN * (1 - 0.65 * cover), atol=1e-6)


def test_levels_have_their_own_colours(studio, stage, camera_at):
    level = np.arange(48 * 32, dtype=np.uint32).reshape(32, 48) % 8
    scene = stage(camera=camera_at(pitch=-90.0), detail=level | 0xFF00 | 0xAB0000)
    got = studio.light(scene, dataclasses.replace(FLAT, overlays=("levels",)))[..., :3]
    colors = np.array([got[level == n][0] for n in range(8)])
    for n in range(8):
        assert np.ptp(got[level == n], axis=0).max() == 0
    gaps = np.linalg.norm(colors[:, None] - colors[None], axis=-1) + np.eye(8)
    assert gaps.min() > 0.1


@pytest.mark.parametrize("view", VIEWS)
def test_error_is_the_screen_distance_of_the_height_error(studio, stage, camera_at, view):
    scene = stage(camera=camera_at(**view), gradient=(0.1, 0.2), error=1e-3, exaggeration=3.0)
    limit = 1e-3
    got = studio.light(scene, dataclasses.replace(FLAT, overlays=("error",), error_limit_px=limit))[..., :3]
    hit = scene.depth() > 0
    position = scene.positions()[hit]

    def project(points):
        clip = np.column_stack([points, np.ones(len(points))]) @ scene.frame.view_projection.T
        return clip[:, :2] / clip[:, 3:] * np.array(scene.size) / 2

    pixels = np.linalg.norm(project(position + np.array([0, 0, 3e-3])) - project(position), axis=1)
    share = 2 * np.clip(pixels / limit, 0, 1)
    expected = np.column_stack([np.minimum(share, 1), np.minimum(2 - share, 1), 0 * share])
    np.testing.assert_allclose(got[hit], expected, atol=3e-3)
    if view != VIEWS[5]:  # straight down in parallel: no error shows at all
        assert expected[:, 0].max() > 0.01


@pytest.mark.parametrize("view", [VIEWS[1], VIEWS[4], {"fov": 60.0, "pitch": -60.0, "roll": 10.0}])
def test_contours_have_constant_width_on_the_screen(studio, stage, camera_at, view):
    scene = stage(camera=camera_at(**view), gradient=(0.2, 0.3), exaggeration=2.0, size=(96, 64))
    interval = 60.0
    style = dataclasses.replace(FLAT, overlays=("contours",), contour_interval=interval)
    got = studio.light(scene, style)[..., 0]
    dark = (PLAIN - got) / (0.75 * (PLAIN - 0.045))
    right, down = moved_hits(scene)
    slope = np.hypot(right[..., 2], down[..., 2]) / 2
    height = scene.heights()

    def cover(step, width):
        away = np.abs(height - np.round(height / step) * step) / slope
        shows = np.clip((step / slope - 2 * width) / (3 * width), 0, 1)
        return np.clip(0.5 * width + 0.5 - away, 0, 1) * shows**2 * (3 - 2 * shows)

    expected = np.maximum(cover(interval, 1.0), cover(5 * interval, 2.0))
    assert expected.max() == 1
    np.testing.assert_allclose(dark, expected, atol=0.03)


def test_a_lake_at_the_height_of_a_contour_is_no_blot(studio, stage, camera_at):
    scene = stage(camera=camera_at(pitch=-60.0), base=500.0)
    got = studio.light(scene, dataclasses.replace(FLAT, overlays=("contours",), contour_interval=100.0))
    np.testing.assert_allclose(got[..., 0], PLAIN)


@pytest.mark.parametrize(("lod", "resident"), [(0.3, 0), (1.7, 0), (0.0, 2)])
def test_nodes_are_chequered_and_bordered(studio, stage, camera_at, lod, resident):
    scene = stage(camera=camera_at(z=30_000.0, pitch=-90.0), lod=lod, resident=resident, size=(128, 96))
    got = studio.light(scene, dataclasses.replace(FLAT, overlays=("nodes",)))[..., 0]
    side = 256 << max(int(lod), resident)
    hit = scene.positions()[..., :2] @ np.linalg.inv(scene.frame.grid.metres).T
    texel = hit + scene.frame.eye
    per_pixel = abs(hit[0, 1, 0] - hit[0, 0, 0]), abs(hit[1, 0, 0] - hit[0, 0, 0])
    footprint = np.hypot(*per_pixel)
    away = np.abs(texel - np.round(texel / side) * side)
    clear = (away > 1.5 * footprint).all(axis=-1)
    checker = np.floor(texel / side).astype(int).sum(axis=-1) % 2
    assert {0, 1} <= set(checker[clear])
    np.testing.assert_allclose(got[clear], np.where(checker[clear] == 1, 0.7 * PLAIN, PLAIN), atol=1e-5)
    on_line = (away < 0.2 * footprint).any(axis=-1)
    assert on_line.any()
    assert got[on_line].min() > 0.7


def test_samples_add_up_and_start_again(studio, stage):
    style = Style()
    jitters = [(0.25, -0.25), (-0.4, 0.1)]
    single = [studio.light(stage(jitter=j), style) for j in jitters]
    samples = studio.shading.samples((48, 32))
    for j in jitters:
        studio.add(samples, stage(jitter=j), style)
    assert samples.count == 2
    np.testing.assert_allclose(studio.sums(samples), single[0] + single[1], rtol=1e-6)
    samples.reset()
    studio.add(samples, stage(jitter=jitters[0]), dataclasses.replace(style, ramp="grey"))
    assert samples.count == 1
    assert not np.allclose(studio.sums(samples), single[0])
    samples.reset()
    studio.add(samples, stage(jitter=jitters[0]), style)
    np.testing.assert_array_equal(studio.sums(samples), single[0])


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("background", ["sky", "transparent", "#ff8040"])
def test_the_last_sample_makes_the_picture_that_resolving_makes(studio, stage, camera_at, count, background):
    style = Style(background=background)
    finished, resolved = (studio.shading.samples((48, 32)) for _ in range(2))
    for number in range(count):
        jittered = stage(camera=camera_at(pitch=-2.0), jitter=(0.2 * number, -0.1 * number))
        studio.add(finished, jittered, style, last=number == count - 1)
        studio.add(resolved, jittered, style)
    picture = studio.gpu.read_texture(finished.picture).result()
    assert len(np.unique(picture.reshape(-1, 4), axis=0)) > 20
    np.testing.assert_allclose(picture.astype(int), studio.resolve(resolved, style), atol=1)


def test_samples_return_their_memory_and_one_alone_sums_nothing(studio, stage):
    def used():
        held = studio.gpu.memory.by_category()
        return held.get("shading", 0) + held.get("surface", 0)

    before = used()
    samples = studio.shading.samples((48, 32))
    studio.add(samples, stage(), Style(), last=True)
    assert 4 * 48 * 32 <= used() - before < 16 * 48 * 32
    studio.add(samples, stage(), Style())
    assert used() - before >= 20 * 48 * 32
    samples.destroy()
    assert used() == before


def test_samples_of_another_size_are_refused(studio, stage):
    with pytest.raises(GpuError, match=r"\(48, 32\) pixels, got \(48, 31\)"):
        studio.add(studio.shading.samples((48, 31)), stage(), Style())
