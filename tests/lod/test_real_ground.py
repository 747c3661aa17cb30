"""Every algorithm on real ground: no cracks, nothing beside the data, no height that the data does not have.

All are drawn finer than by default, so that what a picture lacks is a tear and not a lack of triangles. The truth is
`raycast` over level 0, which test_raycast_on_real_ground.py holds against Embree. A ridge may still be lower than it
should by more than a pixel, which looks like a tear where it has a notch: there the triangles tell, corner by corner.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from lod.patches import torn_edges
from lod.triangles import read_draw, with_area
from orogen.camera import Camera
from orogen.compare.cameras import standard_cameras
from orogen.compare.cracks import find_cracks
from orogen.compare.surface_error import stray_pixels
from orogen.compare.truth import TrueSurface
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.lod import algorithms
from orogen.pyramid.open import open_pyramid
from orogen.source.contract import Source
from orogen.source.open import open_height
from orogen.streaming.settings import ClipmapSettings
from orogen.view.flight import Flight, builtin_flights
from orogen.view.renderer import Picture, Renderer

SIZE = (160, 100)
LEVEL_0 = ClipmapSettings(view_distance=math.inf, load_distance=math.inf, memory=512 << 20)
"""Everything at level 0: errors are the algorithm's alone."""
FPS = 30
OUTLYING = 0.05
"""Pixels by which heights may leave the data's range: far triangles are slivers of a few hundredths of a pixel, the
steps that drivers round their corners to."""
REFLECTED = 0.5
"""The same for bdam, whose meshes go on beyond the raster, reflected: at its rim they are off by as much as allowed."""
STRAY = 5e-4
"""Share of the pixels, rounded up, that may lie beside the data: those on its outline, by rounding."""
LOST = 0.02
"""Share of the pixels in which nothing may be drawn where there is ground: outlines."""
BESIDE = 3.0
"""Pixels from a tear to what shows through it."""
HANGING = 0.05
"""Metres below the ground from which on a vertex is part of a skirt."""
SAMPLE = ("low", "summit", "outside")
TAIWAN = (3000, 6000, 4096)
"""First column, first row and side of the crop: most of the flight made for Taiwan goes over it."""

NAMES = [name for name in algorithms() if name != "raycast"]
DATA = ("puget", "taiwan")
PART = 300
"""Frames of a flight that one test draws."""
FLIGHTS = [
    (data, name, start)
    for data in DATA
    for name in builtin_flights()
    if name == f"descent-{data}" or not name.startswith("descent-")
    for start in range(0, round(Flight.load(name).duration * FPS), PART)
]


def fine(name: str) -> tuple[dict[str, float], int]:
    """Settings halfway (in factors) between the usual detail and the finest, and pixels that outlines may be off then.

    Details are widths or errors in pixels; an outline is off by no more.
    """
    kind = algorithms()[name]
    if kind.detail is None:
        return {}, 1
    usual = getattr(kind.Settings(), kind.detail.setting)
    value = math.sqrt(usual * kind.detail.finest)
    return {kind.detail.setting: value}, math.ceil(value)


class Ground:
    """A data set with its true pictures, and a renderer that takes the algorithms in turn."""

    def __init__(self, gpu: Gpu, source: Source, rasterizer: str) -> None:
        self.heights: NDArray[np.float32] = source.read(slice(0, source.grid.height), slice(0, source.grid.width))
        self.grid = source.grid
        self.surface = TrueSurface(self.heights)
        self.range = float(np.nanmin(self.heights)), float(np.nanmax(self.heights))
        self.renderer = Renderer(gpu, open_pyramid(source), name="raycast", clipmap=LEVEL_0, rasterizer=rasterizer)
        self._cameras: list[Camera] = []
        self._truths: list[tuple[Frame, NDArray[np.float32]]] = []

    @property
    def cameras(self) -> dict[str, Camera]:
        return standard_cameras(self.grid, self.surface)

    def flight(self, name: str, start: int, every: int) -> dict[str, Camera]:
        """The cameras of a part of a flight."""
        path = Flight.load(name).over(self.grid, self.range, height_at=self.height_at)
        stop = min(start + PART, path.frame_count(FPS))
        return {f"frame {k}": path.camera_at(k / FPS) for k in range(start, stop, every)}

    def height_at(self, x: float, y: float) -> float:
        column, row = (math.floor(float(v)) for v in self.grid.to_texel(x, y))
        inside = 0 <= column < self.grid.width and 0 <= row < self.grid.height
        return float(self.heights[row, column]) if inside else math.nan

    def truths(self, cameras: Mapping[str, Camera]) -> list[tuple[Frame, NDArray[np.float32]]]:
        """The true pictures; those of the latest cameras are kept."""
        if self._cameras != list(cameras.values()):
            self._cameras = list(cameras.values())
            self.renderer.use("raycast")
            pictures = (self.renderer.render(camera, SIZE) for camera in self._cameras)
            self._truths = [(picture.frame, picture.reverse_depth) for picture in pictures]
        return self._truths

    def faults(self, name: str, cameras: Mapping[str, Camera]) -> list[str]:
        """What is wrong in an algorithm's pictures."""
        truths = self.truths(cameras)
        settings, tolerance = fine(name)
        self.renderer.use(name, settings)
        found = []
        for (view, camera), (frame, true) in zip(cameras.items(), truths, strict=True):
            picture = self.renderer.render(camera, SIZE)
            # what the true surface does beyond the picture's rim is not known
            rim = np.s_[tolerance:-tolerance, tolerance:-tolerance]
            cracks = find_cracks(picture.reverse_depth, true, frame, tolerance=tolerance).mask[rim]
            pixels = np.argwhere(cracks) + tolerance
            if len(pixels) and (tears := self.tears_near(picture.frame, self.drawn(), pixels)):
                found.append(f"{view}: {len(pixels)} crack pixels, the first {pixels[0]}, beside {tears} torn edges")
            drawn = picture.reverse_depth > 0
            stray = stray_pixels(picture.reverse_depth, frame, self.surface).sum()
            if stray > math.ceil(STRAY * drawn.sum()):
                found.append(f"{view}: {stray} of {drawn.sum()} pixels beside the data")
            if outliers := self.outliers(picture, REFLECTED if name == "bdam" else OUTLYING):
                found.append(f"{view}: {outliers} pixels below or above all heights")
            if (lost := ((true > 0) & ~drawn).mean()) > LOST:
                found.append(f"{view}: {lost:.2%} of the pixels lost")
        return found

    def drawn(self) -> list[NDArray[Any]]:
        """The triangles of the latest picture: (instances, triangles, 3) corners of every draw."""
        renderer = self.renderer
        return [read_draw(renderer.gpu, renderer.clipmap, renderer.view, draw) for draw in renderer.draws]

    def tears_near(self, frame: Frame, drawn: list[NDArray[Any]], pixels: NDArray[np.int64]) -> int:
        """Edges within a few pixels (rows, columns) that only one triangle has. The edges of skirts do not count."""
        edges = torn_edges(with_area(drawn), (math.nan,) * 4)
        hanging = {place for draw in drawn for place in self.hanging(frame, draw.ravel())}
        kept = [all(end.tobytes() not in hanging for end in edge) for edge in edges]
        ends = np.concatenate([edges[kept], np.ones((sum(kept), 2, 1))], axis=2) @ frame.view_projection.T
        # edges are cut off in front of the eye
        a, b = ends[:, 0], ends[:, 1]
        least = 1e-3 * frame.camera.near
        seen = np.maximum(a[:, 3], b[:, 3]) > least
        a, b = (_cut(one[seen], other[seen], least) for one, other in ((a, b), (b, a)))
        width, height = frame.size
        one, other = ((p[:, :2] / p[:, 3:] * [0.5, -0.5] + 0.5) * [width, height] - 0.5 for p in (a, b))
        along = other - one
        found = np.zeros(len(one), bool)
        for row, column in pixels:
            way = np.sum(([column, row] - one) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-30)
            nearest = one + np.clip(way, 0, 1)[:, None] * along
            found |= np.hypot(*(nearest - [column, row]).T) < BESIDE
        return int(found.sum())

    def hanging(self, frame: Frame, vertices: NDArray[Any]) -> set[bytes]:
        """Camera-relative places of vertices below the ground."""
        column, row = ((vertices["offset"] + frame.anchor.astype(np.float64)) / 2**frame.subtexel_bits).T
        below = vertices["height"] < self.surface.height(column, row) - HANGING
        return {place.tobytes() for place in np.unique(vertices["position"][below] + np.float32(0), axis=0)}

    def outliers(self, picture: Picture, pixels: float) -> int:
        """Pixels whose height is outside the data's range, by more than so many pixels."""
        z = picture.position[..., 2]
        slack = 1e-3 + pixels * picture.depth / picture.frame.pixels_per_radian()
        with np.errstate(invalid="ignore"):
            return int(((z < self.range[0] - slack) | (z > self.range[1] + slack)).sum())


def _cut(p: NDArray[np.float64], other: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Clip coordinates, moved towards `other` where w is below `least`."""
    with np.errstate(divide="ignore", invalid="ignore"):
        way = np.where(p[:, 3:] < least, (least - p[:, 3:]) / (other[:, 3:] - p[:, 3:]), 0.0)
    return p + way * (other - p)


@pytest.fixture(scope="module")
def puget(gpu: Gpu, rasterizer: str, data_dir: Path) -> Iterator[Ground]:
    ground = Ground(gpu, open_height(data_dir / "puget_height_1k.png", spacing=160.0, height_scale=0.1), rasterizer)
    with closing(ground.renderer):
        yield ground


@pytest.fixture(scope="module")
def taiwan(gpu: Gpu, rasterizer: str, data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ground]:
    column, row, side = TAIWAN
    path = tmp_path_factory.mktemp("taiwan") / "crop.tif"
    with rasterio.open(data_dir / "taiwan_20m_10481x19401_int16.tif") as whole:
        window = rasterio.windows.Window(column, row, side, side)
        a, b, c, d, e, f = tuple(whole.transform)[:6]
        corner = rasterio.Affine(a, b, c + a * column + b * row, d, e, f + d * column + e * row)
        profile = {**whole.profile, "width": side, "height": side, "transform": corner}
        with rasterio.open(path, "w", **profile) as part:
            part.write(whole.read(window=window))
    ground = Ground(gpu, open_height(path), rasterizer)
    with closing(ground.renderer):
        yield ground


@pytest.mark.parametrize("name", NAMES)
def test_no_faults_in_a_few_views_of_puget(puget: Ground, name: str) -> None:
    assert not puget.faults(name, {view: puget.cameras[view] for view in SAMPLE})


def test_a_missing_triangle_is_a_tear(puget: Ground) -> None:
    puget.renderer.use("udlod", {"pixels_per_quad": 8.0})
    picture = puget.renderer.render(puget.cameras["summit"], SIZE)
    (drawn,) = puget.drawn()
    row, column = np.argwhere(picture.reverse_depth > 0)[3000]
    assert puget.tears_near(picture.frame, [drawn], np.array([[row, column]])) == 0
    x, y = puget.grid.to_texel(*picture.position[row, column, :2])
    places = (drawn["offset"] + picture.frame.anchor.astype(np.float64)) / 2**picture.frame.subtexel_bits
    away = np.hypot(*(places - [x, y]).mean(axis=2).reshape(-1, 2).T)
    # the triangles of the quad there, so that none of them is a degenerate one
    whole = drawn.reshape(-1, 3)[None]
    holed = np.delete(whole, np.argsort(away)[:2], axis=1)
    assert puget.tears_near(picture.frame, [holed], np.array([[row, column]])) > 0


@pytest.mark.nightly
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("data", DATA)
def test_no_faults_in_the_standard_views(request: pytest.FixtureRequest, data: str, name: str) -> None:
    ground: Ground = request.getfixturevalue(data)
    assert not ground.faults(name, ground.cameras)


@pytest.mark.nightly
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("data", "flight", "start"), FLIGHTS)
def test_no_faults_along_a_flight(
    request: pytest.FixtureRequest, data: str, flight: str, start: int, name: str
) -> None:
    ground: Ground = request.getfixturevalue(data)
    every = request.config.getoption("--every") or (10 if ground.renderer.gpu.info.kind == "cpu" else 1)
    assert not ground.faults(name, ground.flight(flight, start, every))
