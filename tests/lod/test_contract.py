"""What every terrain algorithm must do; runs on each folder under `lod/` that is found, at its default settings.

The truth comes from `oracle.cellwalk`, which shares no code with the renderer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from oracle.cellwalk import depth_picture
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.cameras import standard_cameras
from orogen.compare.cracks import find_cracks
from orogen.compare.surface_error import SurfaceError, surface_error
from orogen.compare.truth import TrueSurface
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import algorithms
from orogen.lod.contract import Algorithm
from orogen.pyramid.open import open_pyramid
from orogen.source.open import open_height
from orogen.streaming.settings import ClipmapSettings
from orogen.view.renderer import Picture, Renderer, Scene

SIZE = (160, 100)
SIDE = 200
SPACING = 30.0
LEVEL_0 = ClipmapSettings(view_distance=math.inf, load_distance=math.inf, memory=32 << 20)
"""Everything at level 0: errors are the algorithm's alone."""
VIEWS = (
    "whole", "high", "low", "eye level", "straight down", "straight down, low", "valley", "summit", "edge",
    "along the edge", "outside", "rolled",
)  # fmt: skip

Heights = NDArray[np.float32]
Draw = Callable[..., Picture]


def landscape(name: str) -> Heights:
    """(rows, columns) heights, no power of two and not square, so that nothing fits by chance."""
    rough = hills(SIDE + 20, 900.0).astype(np.float32)[:SIDE]
    if name == "holes":
        rough[20:50, 90:150] = np.nan
        rough[150, 30] = np.nan
        rough[:, -3:] = np.nan
        rough[np.hypot(*(np.mgrid[:SIDE, : SIDE + 20] - [[[120]], [[150]]])) < 14] = np.nan
    if name == "flat":
        rough = np.full((SIDE, SIDE + 20), 250.0, np.float32)
    if name == "tilted":
        rows, columns = np.mgrid[:SIDE, : SIDE + 20]
        # multiples of 1/4: exact in float32, so that the samples themselves are on the plane
        rough = (1.25 * columns - 2.75 * rows + 700).astype(np.float32)
    return np.rint(rough) if name == "metres" else rough


def stored(name: str) -> NDArray[Any]:
    """A landscape as it is opened: whole metres as integers, of which the GPU holds 16 bits."""
    return landscape(name).astype(np.int16) if name == "metres" else landscape(name)


@pytest.fixture(scope="module", params=algorithms())
def algorithm(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def draw(gpu: Gpu, rasterizer: str, algorithm: str) -> Iterator[Draw]:
    """draw(landscape or heights, camera, size=, clipmap=, **scene) -> Picture; one renderer per terrain is kept."""
    renderers: dict[object, Renderer] = {}

    def run(
        terrain: str,
        camera: Camera,
        size: tuple[int, int] = SIZE,
        clipmap: ClipmapSettings = LEVEL_0,
        **scene: object,
    ) -> Picture:
        if (terrain, clipmap) not in renderers:
            pyramid = open_pyramid(open_height(stored(terrain), spacing=SPACING))
            renderers[terrain, clipmap] = Renderer(gpu, pyramid, name=algorithm, clipmap=clipmap, rasterizer=rasterizer)
        return renderers[terrain, clipmap].render(camera, size, scene=Scene(**scene))

    yield run
    for renderer in renderers.values():
        renderer.close()


def cameras(terrain: str) -> dict[str, Camera]:
    heights = landscape(terrain)
    return standard_cameras(open_height(heights, spacing=SPACING).grid, TrueSurface(heights))


@cache
def _truth(frame: Frame, heights: bytes) -> NDArray[np.float64]:
    return depth_picture(frame, np.frombuffer(heights, np.float32).reshape(frame.grid.shape))


def truth(frame: Frame, heights: Heights) -> NDArray[np.float64]:
    """The true picture, computed once for all algorithms."""
    return _truth(replace(frame, lod_camera=None, ground_height=0.0), heights.tobytes())


def check(picture: Picture, heights: Heights, *, tolerance: int = 1) -> SurfaceError:
    """No cracks, nothing outside the extent, the voids and the range of heights, small errors both ways."""
    frame, surface = picture.frame, TrueSurface(heights)
    true = truth(frame, heights)
    error = surface_error(picture.reverse_depth, true, frame, surface)
    cracks = find_cracks(picture.reverse_depth, true, frame, tolerance=tolerance)
    assert cracks.count == 0, np.argwhere(cracks.mask)[:5]
    assert error.stray == 0
    assert_in_range(picture, heights)
    if (true > 0).any():
        assert error.forward.mean <= 0.3 * tolerance
        assert error.backward.mean <= 0.3 * tolerance
        assert error.forward.p99 <= 1.0 * tolerance
        assert error.backward.p99 <= 1.0 * tolerance
        # what is lost or gained is an outline of at most about a pixel
        assert error.missing <= 0.02 * tolerance
        assert error.extra <= 0.02 * tolerance
    return error


def rounding(picture: Picture) -> NDArray[np.float64]:
    """Metres that float32 depth and camera-relative float32 vertices may be off: 16 steps of the distance."""
    origin, direction = picture.frame.rays()
    point = origin + direction * picture.frame.view_depth(picture.reverse_depth)[..., None]
    reach = np.linalg.norm(point, axis=-1)
    if picture.frame.camera.orthographic:
        reach = np.maximum(reach, np.ptp(picture.frame.depth_range))
    return 1e-3 + 16 * np.finfo(np.float32).eps * reach


def assert_in_range(picture: Picture, heights: Heights) -> None:
    z = picture.position[..., 2]
    drawn = picture.reverse_depth > 0
    slack = rounding(picture)[drawn] / picture.frame.exaggeration
    assert (z[drawn] >= np.nanmin(heights) - slack).all()
    assert (z[drawn] <= np.nanmax(heights) + slack).all()


def test_an_algorithm_is_found_by_its_folder(algorithm: str) -> None:
    kind = algorithms()[algorithm]
    assert issubclass(kind, Algorithm)
    assert kind.name == algorithm
    # frozen settings whose defaults are valid
    settings = kind.Settings()
    assert settings == kind.Settings()
    assert hash(settings) is not None


@pytest.mark.parametrize("view", VIEWS)
def test_standard_views_of_rough_ground(draw: Draw, view: str) -> None:
    picture = draw("rough", cameras("rough")[view])
    assert (picture.reverse_depth > 0).sum() > 500
    check(picture, landscape("rough"))


@pytest.mark.parametrize("view", ["low", "valley"])
def test_heights_of_16_bits(draw: Draw, view: str) -> None:
    check(draw("metres", cameras("metres")[view]), landscape("metres"))


def test_the_views_are_those_of_the_benchmark() -> None:
    assert tuple(cameras("rough")) == VIEWS


@pytest.mark.parametrize("terrain", ["flat", "tilted"])
@pytest.mark.parametrize("view", ["whole", "low", "eye level", "straight down", "along the edge", "rolled"])
def test_planes_are_exact(draw: Draw, terrain: str, view: str) -> None:
    heights = landscape(terrain)
    picture = draw(terrain, cameras(terrain)[view])
    drawn = picture.reverse_depth > 0
    x, y, z = picture.position[drawn].T
    tx, ty = picture.frame.grid.to_texel(x, y)
    expected = 250.0 if terrain == "flat" else 1.25 * (tx - 0.5) - 2.75 * (ty - 0.5) + 700
    off = np.abs(z - expected)
    # a driver's interpolation over a sliver that is just morphing away is not better than a hundredth of a pixel
    pixel = picture.depth[drawn] / picture.frame.pixels_per_radian()
    assert (off <= rounding(picture)[drawn] + 0.01 * pixel).all()
    assert np.quantile(off, 0.999) <= min(rounding(picture)[drawn].max(), 1e-3 * SPACING)
    true = truth(picture.frame, heights)
    # edges of the picture of a plane are straight: only rounding decides on which side a pixel lies
    assert (drawn != (true > 0)).sum() <= 3


@pytest.mark.parametrize("view", ["whole", "straight down", "low", "rolled"])
def test_voids_stay_empty(draw: Draw, view: str) -> None:
    heights = landscape("holes")
    picture = draw("holes", cameras("holes")[view])
    true = truth(picture.frame, heights)
    assert ((picture.reverse_depth > 0) & (true == 0)).mean() < 0.01
    check(picture, heights)


@pytest.mark.parametrize("pitch", [-90.0, -35.0])
def test_orthographic(draw: Draw, pitch: float) -> None:
    camera = replace(cameras("rough")["high"], pitch=pitch, orthographic=4000.0, heading=25.0)
    check(draw("rough", camera), landscape("rough"))


@pytest.mark.parametrize("exaggeration", [0.25, 3.0])
def test_exaggeration(draw: Draw, exaggeration: float) -> None:
    camera = cameras("rough")["whole"].moved(z=1800.0 * max(1.0, exaggeration))
    picture = draw("rough", camera, exaggeration=exaggeration)
    assert picture.frame.exaggeration == exaggeration
    # detail that is chosen by the width of quads alone does not know that their errors are three times as high
    check(picture, landscape("rough"), tolerance=max(1, math.ceil(exaggeration)))


def test_curvature_of_a_small_country(gpu: Gpu, rasterizer: str, algorithm: str) -> None:
    heights = hills(SIDE, 4000.0).astype(np.float32)
    pyramid = open_pyramid(open_height(heights, spacing=2000.0))
    with closing(Renderer(gpu, pyramid, name=algorithm, clipmap=LEVEL_0, rasterizer=rasterizer)) as renderer:
        camera = Camera(200_000.0, -20_000.0, 30_000.0, heading=0.0, pitch=-12.0)
        bent = renderer.render(camera, SIZE, scene=Scene(curvature=True))
        straight = renderer.render(camera, SIZE)
    check(bent, heights)
    # 400 km away the ground is 12 km lower: the skyline sinks
    assert (bent.reverse_depth > 0).any(axis=1).argmax() > (straight.reverse_depth > 0).any(axis=1).argmax()


def test_a_frozen_lod_camera_decides_on_detail_alone(draw: Draw) -> None:
    views = cameras("rough")
    eye = views["whole"]
    aside = eye.moved(x=eye.x + 400.0, z=eye.z + 300.0, heading=-3.0)
    own, frozen = draw("rough", eye), draw("rough", aside, lod_camera=eye)
    assert frozen.statistics.patches == own.statistics.patches
    assert frozen.statistics.triangles == own.statistics.triangles
    true = truth(frozen.frame, landscape("rough"))
    inside = inside_frustum(frozen.frame, true)
    assert inside.sum() > 3000
    # what the frozen camera sees is drawn as well as ever
    drawn = np.where(inside, frozen.reverse_depth, 0)
    true = np.where(inside, true, 0)
    assert find_cracks(drawn, true, frozen.frame, tolerance=2).count == 0
    assert ((drawn == 0) & inside).sum() <= 0.02 * inside.sum()


def inside_frustum(frame: Frame, depth: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Pixels whose point lies well inside the LOD camera's picture."""
    origin, direction = frame.rays()
    point = origin + direction * frame.view_depth(depth)[..., None]
    planes = frame.planes()
    with np.errstate(invalid="ignore"):
        return (point @ planes[:, :3].T + planes[:, 3] > 2 * SPACING).all(axis=-1)


def test_the_same_frame_gives_the_same_picture(gpu: Gpu, rasterizer: str, algorithm: str, draw: Draw) -> None:
    views = cameras("rough")
    first = draw("rough", views["low"])
    draw("rough", views["outside"])
    again = draw("rough", views["low"])
    np.testing.assert_array_equal(first.reverse_depth, again.reverse_depth)
    assert first.statistics == again.statistics
    pyramid = open_pyramid(open_height(landscape("rough"), spacing=SPACING))
    with closing(Renderer(gpu, pyramid, name=algorithm, clipmap=LEVEL_0, rasterizer=rasterizer)) as other:
        np.testing.assert_array_equal(first.reverse_depth, other.render(views["low"], SIZE).reverse_depth)


def test_a_view_of_the_sky_is_empty(draw: Draw) -> None:
    picture = draw("rough", cameras("rough")["summit"].moved(pitch=80.0))
    assert (picture.reverse_depth == 0).all()


@pytest.mark.parametrize("size", [(1, 1), (33, 17), (64, 200)])
def test_sizes(draw: Draw, size: tuple[int, int]) -> None:
    camera = cameras("rough")["straight down"]
    picture = draw("rough", camera, size=size)
    assert picture.reverse_depth.shape == (size[1], size[0])
    assert (picture.reverse_depth > 0).all()
    check(picture, landscape("rough"))


def test_a_rotated_georeference(gpu: Gpu, rasterizer: str, algorithm: str, tmp_path: Path) -> None:
    heights = landscape("rough")
    transform = rasterio.Affine(24.0, 12.0, 471_000.0, 10.0, -28.0, 5_200_000.0)
    with rasterio.open(
        tmp_path / "rotated.tif", "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0], count=1,
        dtype="float32", crs="EPSG:32633", transform=transform, tiled=True, blockxsize=128, blockysize=128,
    ) as file:  # fmt: skip
        file.write(heights, 1)
    pyramid = open_pyramid(open_height(tmp_path / "rotated.tif"))
    with closing(Renderer(gpu, pyramid, name=algorithm, clipmap=LEVEL_0, rasterizer=rasterizer)) as renderer:
        for camera in list(standard_cameras(pyramid.grid, TrueSurface(heights)).values())[:3]:
            check(renderer.render(camera, SIZE), heights)


@pytest.fixture(scope="module")
def wide() -> Heights:
    """Several nodes wide and high, with steep walls across node borders; whole metres."""
    rough = np.rint(hills(740, 3000.0, seed=11).astype(np.float32)[:600])
    rough[250:262] += 200
    return rough


@pytest.fixture(scope="module")
def mixed(gpu: Gpu, rasterizer: str, algorithm: str, wide: Heights) -> Iterator[Callable[[int], Renderer]]:
    """Level 0 near the camera only, coarser nodes beyond; heights of 16 or 32 bits."""
    pyramid = open_pyramid(open_height(wide.astype(np.int16), spacing=SPACING))
    settings = ClipmapSettings(view_distance=0.5, load_distance=0.5, memory=32 << 20)
    with ExitStack() as opened:

        @cache
        def renderer(bits: int) -> Renderer:
            chosen = replace(settings, height_bits=bits)
            found = Renderer(gpu, pyramid, name=algorithm, clipmap=chosen, rasterizer=rasterizer)
            return opened.enter_context(closing(found))

        yield renderer


@pytest.mark.parametrize(
    ("view", "bits"), [("low", 16), ("high", 16), ("edge", 16), ("straight down", 16), ("low", 32), ("edge", 32)]
)
def test_no_cracks_between_levels(mixed: Callable[[int], Renderer], wide: Heights, view: str, bits: int) -> None:
    surface, renderer = TrueSurface(wide), mixed(bits)
    assert renderer.clipmap.heights.format.bits == bits
    picture = renderer.render(standard_cameras(renderer.clipmap.grid, surface)[view], SIZE)
    frame = picture.frame
    true = truth(frame, wide)
    # coarser data are a few pixels off by themselves; tears are not
    cracks = find_cracks(picture.reverse_depth, true, frame, tolerance=3)
    assert cracks.count == 0, np.argwhere(cracks.mask)[:5]
    assert surface_error(picture.reverse_depth, true, frame, surface).stray == 0
    assert_in_range(picture, wide)
