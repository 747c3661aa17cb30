"""Camera, frame and grid against derivations of their own: rotation matrices, plain trigonometry, brute force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from orogen.camera import Camera
from orogen.errors import SettingsError, SourceError
from orogen.frame import Frame
from orogen.grid import Grid
from orogen.keys import NodeKey, level_count, level_shape

RNG_SEED = 20
ROTATED = Grid(300, 200, (8.0, 3.0, 471000.0, 2.0, -9.0, 5.2e6), "EPSG:32633", (0.98, 1.01))
PLAIN = Grid(300, 200, (10.0, 0.0, 471000.0, 0.0, -10.0, 5.2e6))
CAMERAS = {
    "level": Camera(472000, 5199000, 900),
    "turned": Camera(472000.3, 5199000.7, 1500, heading=217, pitch=-33, roll=21, fov=70),
    "down": Camera(472500, 5199500, 3000, heading=40, pitch=-90, roll=-100),
    "up": Camera(472000, 5199000, 300, heading=300, pitch=60, fov=20, near=2.0),
    "flat": Camera(472000, 5199000, 2500, heading=75, pitch=-50, roll=10, orthographic=900),
    "flat down": Camera(472000, 5199000, 2500, pitch=-90, orthographic=1500),
}


def frame_of(name: str, **changes: object) -> Frame:
    frame = Frame(CAMERAS[name], ROTATED, (64, 40), height_range=(100.0, 800.0))
    return replace(frame, **changes)


def rotation(camera: Camera) -> np.ndarray:
    """Camera axes (right, forward, up) to (east, north, up), as a product of rotations about single axes."""
    h, p, r = np.radians([camera.heading, camera.pitch, camera.roll])
    turn = np.array([[math.cos(h), math.sin(h), 0], [-math.sin(h), math.cos(h), 0], [0, 0, 1]])
    tilt = np.array([[1, 0, 0], [0, math.cos(p), -math.sin(p)], [0, math.sin(p), math.cos(p)]])
    roll = np.array([[math.cos(r), 0, math.sin(r)], [0, 1, 0], [-math.sin(r), 0, math.cos(r)]])
    return turn @ tilt @ roll


def to_pixels(frame: Frame, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel (column, row) and view depth of camera-relative points, by trigonometry; without jitter."""
    right, ahead, up = (points @ rotation(frame.camera)).T
    width, height = frame.size
    if frame.camera.orthographic:
        scale = height / frame.camera.orthographic
        return np.stack([width / 2 + right * scale, height / 2 - up * scale], -1), ahead
    scale = height / 2 / math.tan(math.radians(frame.camera.fov) / 2)
    return np.stack([width / 2 + right / ahead * scale, height / 2 - up / ahead * scale], -1), ahead


def projected(frame: Frame, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel (column, row) and reverse-z depth through the frame's matrix."""
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ frame.view_projection.T
    ndc = clip[:, :3] / clip[:, 3:]
    return (ndc[:, :2] * [1, -1] + 1) / 2 * frame.size, ndc[:, 2]


def visible_points(frame: Frame, count: int = 200) -> np.ndarray:
    rng = np.random.default_rng(RNG_SEED)
    local = np.stack(
        [rng.uniform(-300, 300, count), rng.uniform(10, 5000, count), rng.uniform(-300, 300, count)], axis=1
    )
    return local @ rotation(frame.camera).T


@pytest.mark.parametrize("name", CAMERAS)
def test_basis_is_the_product_of_three_rotations(name: str) -> None:
    camera = CAMERAS[name]
    np.testing.assert_allclose(camera.basis[[0, 2, 1]], rotation(camera).T, atol=1e-15)


def test_heading_pitch_and_roll_turn_the_right_way() -> None:
    camera = Camera(0, 0, 0)
    np.testing.assert_allclose(camera.basis, [[1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=1e-15)
    np.testing.assert_allclose(camera.moved(heading=90.0).basis[2], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(camera.moved(pitch=90.0).basis[2], [0, 0, 1], atol=1e-15)
    # a camera rolled clockwise dips its right side
    assert camera.moved(roll=10.0).basis[0, 2] < 0


@pytest.mark.parametrize("name", CAMERAS)
def test_projection_agrees_with_trigonometry(name: str) -> None:
    frame = frame_of(name)
    points = visible_points(frame)
    pixel, depth = projected(frame, points)
    expected, ahead = to_pixels(frame, points)
    np.testing.assert_allclose(pixel, expected, rtol=1e-9, atol=1e-9)
    within = depth > 0
    assert within.sum() > 20
    np.testing.assert_allclose(frame.view_depth(depth)[within], ahead[within], rtol=1e-9)


@pytest.mark.parametrize("name", CAMERAS)
def test_points_on_a_pixels_ray_project_to_its_centre(name: str) -> None:
    frame = frame_of(name, jitter=(0.3, -0.2))
    origin, direction = frame.rays()
    column, row = np.meshgrid(np.arange(64) + 0.5, np.arange(40) + 0.5)
    for distance in (5.0, 700.0, 2000.0):
        pixel, depth = projected(frame, (origin + distance * direction).reshape(-1, 3))
        np.testing.assert_allclose(pixel, np.stack([column.ravel(), row.ravel()], -1), atol=1e-6)
        np.testing.assert_allclose(frame.view_depth(depth), distance, rtol=1e-9, atol=1e-6)


def test_a_jittered_sample_lies_right_and_below() -> None:
    frame = frame_of("turned")
    moved = replace(frame, jitter=(0.25, 0.4))
    origin, direction = moved.rays()
    points = (origin + 1000 * direction)[10:12, 20:22].reshape(-1, 3)
    pixel, _ = to_pixels(frame, points)
    np.testing.assert_allclose(pixel[0], [20.5 + 0.25, 10.5 + 0.4])


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_is_reverse_and_falls_with_distance(name: str) -> None:
    frame = frame_of(name)
    points = np.arange(1, 50)[:, None] * 40.0 * frame.camera.basis[2]
    _, depth = projected(frame, points)
    assert (np.diff(depth) < 0).all()
    assert (depth > 0).all()
    assert (depth <= 1).all() or frame.camera.orthographic


def test_depth_is_one_at_the_near_plane_and_zero_means_sky() -> None:
    frame = frame_of("up")
    _, depth = projected(frame, 2.0 * frame.camera.basis[2:])
    assert depth[0] == pytest.approx(1)
    assert np.isnan(frame.view_depth(np.zeros(1))).all()
    assert np.isnan(frame_of("flat").view_depth(np.zeros(1))).all()


@pytest.mark.parametrize("name", ["flat", "flat down"])
@pytest.mark.parametrize("curvature", [False, True])
def test_an_orthographic_depth_range_holds_all_data(name: str, curvature: bool) -> None:
    frame = frame_of(name, curvature=curvature, exaggeration=3.0)
    tx, ty, z = np.meshgrid([0, 150, 300], [0, 100, 200], [100.0, 800.0])
    east, north = np.einsum("ij,j...->i...", ROTATED.metres, np.stack([tx, ty]) - frame.eye[:, None, None, None])
    drop = (east**2 + north**2) / (2 * 6371008.8) if curvature else 0
    up = 3.0 * z - frame.camera.z - drop
    near, far = frame.depth_range
    _, ahead = to_pixels(frame, np.stack([east, north, up], -1).reshape(-1, 3))
    assert near < ahead.min()
    assert ahead.max() < far


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(("exaggeration", "curvature"), [(1.0, False), (2.5, True)])
def test_positions_return_where_the_points_were(name: str, exaggeration: float, curvature: bool) -> None:
    frame = frame_of(name, exaggeration=exaggeration, curvature=curvature, jitter=(0.1, 0.2))
    distance = np.random.default_rng(RNG_SEED).uniform(50, 3000, (40, 64))
    if frame.camera.orthographic:
        near, far = frame.depth_range
        distance = near + (far - near) * (0.05 + 0.9 * (distance / 3000))
        depth = (far - distance) / (far - near)
    else:
        depth = frame.camera.near / distance
    position = frame.positions(depth)
    # back again, by the grid's affine transform written out
    a, b, c, d, e, f = ROTATED.transform
    texel = np.linalg.solve([[a, b], [d, e]], np.stack([position[..., 0] - c, position[..., 1] - f]).reshape(2, -1))
    east, north = np.diag(ROTATED.ground_scale) @ [[a, b], [d, e]] @ (texel - frame.eye[:, None])
    drop = (east**2 + north**2) / (2 * 6371008.8) if curvature else 0.0
    up = position[..., 2].ravel() * exaggeration - frame.camera.z - drop
    pixel, ahead = to_pixels(frame, np.stack([east, north, up], -1))
    column, row = np.meshgrid(np.arange(64) + 0.6, np.arange(40) + 0.7)
    np.testing.assert_allclose(pixel, np.stack([column.ravel(), row.ravel()], -1), atol=1e-4)
    np.testing.assert_allclose(ahead, distance.ravel(), rtol=1e-6)


def test_the_sky_has_no_position() -> None:
    depth = np.zeros((40, 64))
    depth[3, 4] = 0.01
    position = frame_of("level").positions(depth)
    assert np.isfinite(position[3, 4]).all()
    assert np.isnan(position).all(axis=-1).sum() == depth.size - 1


@pytest.mark.parametrize("name", CAMERAS)
def test_planes_hold_exactly_the_points_in_the_picture(name: str) -> None:
    frame = frame_of(name)
    rng = np.random.default_rng(RNG_SEED)
    points = rng.normal(0, 900, (4000, 3))
    pixel, ahead = to_pixels(frame, points)
    near = frame.depth_range[0] if frame.camera.orthographic else frame.camera.near
    with np.errstate(invalid="ignore"):
        seen = ((pixel >= 0) & (pixel <= frame.size)).all(1) & (ahead >= near)
    planes = frame.planes()
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1)
    inside = (points @ planes[:, :3].T + planes[:, 3] >= 0).all(1)
    np.testing.assert_array_equal(inside, seen)
    assert 0 < seen.sum() < len(points)


def test_planes_are_those_of_the_frozen_camera() -> None:
    other = CAMERAS["turned"]
    frame = frame_of("level", lod_camera=other)
    points = np.random.default_rng(RNG_SEED).normal(0, 1500, (4000, 3))
    step = np.linalg.solve(
        np.array(ROTATED.transform).reshape(2, 3)[:, :2], [frame.camera.x - other.x, frame.camera.y - other.y]
    )
    shift = np.append(ROTATED.metres @ step, frame.camera.z - other.z)
    pixel, ahead = to_pixels(frame_of("turned"), points + shift)
    seen = ((pixel >= 0) & (pixel <= frame.size)).all(1) & (ahead >= other.near)
    for tried, same in ((frame, True), (frame_of("level"), False)):
        planes = tried.planes()
        inside = (points @ planes[:, :3].T + planes[:, 3] >= 0).all(1)
        assert (inside == seen).all() == same


def test_lod_eye_is_the_frozen_camera() -> None:
    frame = Frame(CAMERAS["level"], PLAIN, (64, 40))
    np.testing.assert_allclose(frame.lod_eye(), [0, 0, 0])
    frozen = replace(frame, lod_camera=CAMERAS["level"].moved(x=472100, y=5198950, z=1000.0))
    np.testing.assert_allclose(frozen.lod_eye(), [100, -50, 100], atol=1e-6)


def test_lod_eye_of_an_orthographic_camera_sees_the_middle_at_the_same_scale() -> None:
    camera = CAMERAS["flat"]
    frame = Frame(camera, PLAIN, (64, 40), ground_height=400.0, exaggeration=2.0)
    eye = frame.lod_eye()
    forward = camera.basis[2]
    along = (camera.z - 800.0) / -forward[2]
    middle = along * forward
    distance = np.linalg.norm(middle - eye)
    np.testing.assert_allclose(np.cross(middle - eye, forward), 0, atol=1e-6)
    # pixels per metre there are those of the orthographic picture
    assert frame.pixels_per_radian() / distance == pytest.approx(40 / camera.orthographic)


def test_pixels_per_radian_is_the_scale_at_the_middle() -> None:
    frame = frame_of("up")
    basis = frame.camera.basis
    ahead = 1e5 * basis[2]
    pixel, _ = to_pixels(frame, np.stack([ahead, ahead + basis[1]]))
    assert abs(pixel[1, 1] - pixel[0, 1]) * 1e5 == pytest.approx(frame.pixels_per_radian(), rel=1e-6)


def test_curvature_drops_the_horizon_by_the_sphere() -> None:
    frame = frame_of("level", curvature=True)
    # the true sphere drops by R - sqrt(R^2 - d^2): the parabola is within 1e-6 of that at 10 km
    distance = 10_000.0
    sphere = 6371008.8 - math.sqrt(6371008.8**2 - distance**2)
    assert frame.curvature_factor * distance**2 == pytest.approx(sphere, rel=1e-6)
    assert frame_of("level").curvature_factor == 0


@pytest.mark.parametrize("side", [300, 19_401, 1 << 21, 1 << 24, 1 << 28])
def test_subtexels_fit_int32_and_are_fine_where_they_can_be(side: int) -> None:
    frame = Frame(Camera(1.0, 1.0, 0.0), Grid(side, side, (1, 0, 0, 0, -1, 0)), (4, 4))
    assert 0 <= frame.subtexel_bits <= 8
    # two positions may lie on either side of the origin: their difference still fits
    assert side << frame.subtexel_bits <= 2**30
    assert frame.subtexel_bits == 8 or side << frame.subtexel_bits >= 2**26


@pytest.mark.parametrize("x", [472000.123456, 4.7e5 - 3000, 1e9])
def test_anchor_and_offset_add_up_to_the_eye(x: float) -> None:
    frame = Frame(CAMERAS["level"].moved(x=x), PLAIN, (64, 40))
    total = frame.anchor.astype(np.float64) + frame.eye_offset
    np.testing.assert_allclose(total / 256, [(x - 471000) / 10, 100], rtol=1e-12)
    if x < 1e6:
        assert (frame.eye_offset >= 0).all()
        assert (frame.eye_offset < 1).all()
    # metres per subtexel
    np.testing.assert_allclose(frame.metres * 256, [[10, 0], [0, -10]])


def test_grid_goes_to_texels_and_back() -> None:
    tx, ty = np.random.default_rng(RNG_SEED).uniform(-50, 350, (2, 100))
    x, y = ROTATED.to_crs(tx, ty)
    np.testing.assert_allclose(x, 8 * tx + 3 * ty + 471000)
    np.testing.assert_allclose(ROTATED.to_texel(x, y), (tx, ty), atol=1e-8)


def test_grid_knows_its_bounds_metres_and_spacing() -> None:
    assert PLAIN.bounds == (471000, 5.2e6 - 2000, 471000 + 3000, 5.2e6)
    assert PLAIN.shape == (200, 300)
    assert PLAIN.spacing == pytest.approx(10)
    np.testing.assert_allclose(ROTATED.metres, [[8 * 0.98, 3 * 0.98], [2 * 1.01, -9 * 1.01]])
    assert ROTATED.spacing == pytest.approx(math.sqrt((8 * 9 + 3 * 2) * 0.98 * 1.01))


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"x": math.nan}, "camera x: expected a finite number"),
        ({"z": math.inf}, "camera z"),
        ({"pitch": -91.0}, "camera pitch: expected -90 to 90"),
        ({"fov": 180.0}, "camera fov"),
        ({"near": 0.0}, "camera near"),
        ({"orthographic": -5.0}, "camera orthographic"),
        ({"orthographic": math.nan}, "camera orthographic"),
    ],
)
def test_bad_cameras_are_refused(values: dict[str, float], match: str) -> None:
    with pytest.raises(SettingsError, match=match):
        CAMERAS["level"].moved(**values)


@pytest.mark.parametrize(
    ("values", "match"),
    [({"size": (0, 5)}, "size: expected at least 1x1"), ({"exaggeration": 0.0}, "exaggeration")],
)
def test_bad_frames_are_refused(values: dict[str, object], match: str) -> None:
    with pytest.raises(SettingsError, match=match):
        frame_of("level", **values)


@pytest.mark.parametrize(
    ("size", "transform", "match"),
    [
        ((0, 3), (1, 0, 0, 0, 1, 0), "at least 1 x 1"),
        ((3, 3), (1, 1, 0, 1, 1, 0), "invertible geotransform"),
        ((3, 3), (math.nan, 0, 0, 0, 1, 0), "invertible geotransform"),
    ],
)
def test_bad_grids_are_refused(size: tuple[int, int], transform: tuple[float, ...], match: str) -> None:
    with pytest.raises(SourceError, match=match):
        Grid(*size, transform)


def test_levels_halve_and_round_up() -> None:
    assert [level_shape((5, 1025), level) for level in range(4)] == [(5, 1025), (3, 513), (2, 257), (1, 129)]
    assert level_count((256, 256)) == 1
    assert level_count((19401, 10481)) == 8
    assert NodeKey(0, 5, 3).parent == NodeKey(1, 2, 1)


@pytest.mark.parametrize("exaggeration", [1.0, 3.0])
def test_the_eyes_height_is_split_without_loss(exaggeration: float) -> None:
    frame = frame_of("turned", camera=CAMERAS["turned"].moved(z=8848.8601), exaggeration=exaggeration)
    rounded, rest = frame.eye_height
    assert rounded == np.float32(rounded)
    assert abs(rest) <= np.spacing(np.float32(rounded)) / 2
    assert rounded + rest == 8848.8601 / exaggeration
