"""Far from the CRS's origin nothing shakes: pictures and vertices against float64, down to a centimetre a pixel."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lod.scene import Scene
from lod.triangles import as_unculled, read_triangles
from oracle.landscapes import hills
from orogen.camera import Camera
from orogen.compare.truth import TrueSurface
from orogen.frame import Frame
from orogen.gpu import Gpu
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.source.open import open_height
from orogen.streaming.clipmap import Clipmap
from orogen.streaming.settings import ClipmapSettings
from orogen.view.renderer import Renderer

FAR = 1e7
"""CRS coordinates of the raster's corner."""
SIZE = (160, 100)
SIDE = 200
SPACINGS = (0.01, 0.5, 30.0)
LIMIT = 0.1
"""Pixels."""


def terrain(spacing: float) -> tuple[NDArray[np.float32], Pyramid]:
    """Hills as high as the Himalaya, 10^7 from the origin both ways, as steep whatever the spacing; turned a little."""
    heights = hills(SIDE, 60.0 * spacing).astype(np.float32) + np.float32(8800)
    source = open_height(heights, spacing=1.0)
    c, s = spacing * math.cos(0.1), spacing * math.sin(0.1)
    grid = replace(source.grid, transform=(c, s, FAR + 0.123, s, -c, FAR + 0.456))
    return heights, open_pyramid(replace(source, grid=grid))


def zooms(spacing: float) -> list[float]:
    """Metres a pixel: from a centimetre to as much as shows all of the terrain."""
    widest = SIDE * spacing / SIZE[1]
    return [pixel for pixel in (0.01, 0.1, 1.0, 10.0, 100.0) if pixel <= widest] or [widest]


def camera_at(pyramid: Pyramid, surface: TrueSurface, pixel: float, heading: float) -> Camera:
    """A camera that sees a sample in the middle of the picture at `pixel` metres a pixel."""
    column = row = SIDE / 2 + 0.5
    x, y = pyramid.grid.to_crs(column, row)
    eye = Camera(0.0, 0.0, 0.0, heading=heading, pitch=-40.0)
    distance = pixel * Frame(eye, pyramid.grid, SIZE).pixels_per_radian()
    back = -distance * eye.basis[2]
    height = float(surface.height(column, row)) + back[2]
    return eye.moved(x=float(x) + back[0], y=float(y) + back[1], z=height, near=distance / 50)


@pytest.mark.parametrize("spacing", SPACINGS)
def test_pictures_far_from_the_origin_are_exact(gpu: Gpu, spacing: float) -> None:
    heights, pyramid = terrain(spacing)
    surface = TrueSurface(heights)
    clipmap = ClipmapSettings(view_distance=math.inf, load_distance=math.inf, memory=32 << 20)
    with closing(Renderer(gpu, pyramid, name="raycast", clipmap=clipmap)) as renderer:
        for pixel in zooms(spacing):
            picture = renderer.render(camera_at(pyramid, surface, pixel, 33.0), SIZE, samples=1)
            drawn = picture.reverse_depth > 0
            assert drawn.mean() > 0.3
            x, y, z = picture.position[drawn].T
            tx, ty = pyramid.grid.to_texel(x, y)
            inside = surface.inside(tx, ty, margin=-1e-6)
            assert inside.mean() > 0.99
            gx, gy = surface.gradient(tx, ty)
            slope = np.hypot(*(np.stack([gx, gy], -1) @ pyramid.grid.texels).T)
            # from the point along the surface's normal, in pixels of its distance
            away = np.abs(z - surface.height(tx, ty)) / np.hypot(1.0, slope)
            eye = picture.frame.camera
            length = np.linalg.norm(picture.position[drawn] - [eye.x, eye.y, eye.z], axis=1)
            error = (away / (length / picture.frame.pixels_per_radian()))[inside]
            assert error.max() < LIMIT, pixel


class Far(Scene):
    """A scene of a pyramid of one's own."""

    def __init__(self, gpu: Gpu, pyramid: Pyramid) -> None:
        self.gpu, self.pyramid = gpu, pyramid
        settings = ClipmapSettings(view_distance=math.inf, load_distance=math.inf, memory=24 << 20)
        self.clipmap = Clipmap(gpu, pyramid, None, settings)
        self.view = self.clipmap.view()
        self.timer = gpu.timer()


@pytest.mark.parametrize(("algorithm", "spacing"), [*(("brute", spacing) for spacing in SPACINGS), ("udlod", 0.5)])
def test_vertices_far_from_the_origin_are_where_float64_puts_them(gpu: Gpu, algorithm: str, spacing: float) -> None:
    heights, pyramid = terrain(spacing)
    surface = TrueSurface(heights)
    grid = pyramid.grid
    with closing(Far(gpu, pyramid)) as scene:
        state = scene.algorithm(algorithm)
        for pixel in zooms(spacing):
            frame = as_unculled(scene.frame(camera_at(pyramid, surface, pixel, 217.0), SIZE))
            corners = np.concatenate([draw.reshape(-1) for draw in read_triangles(scene, frame, state)])
            places = corners["offset"] + frame.anchor.astype(np.float64)
            first = np.unique(places @ [1, 1j], return_index=True)[1]
            places = places[first] / 2**frame.subtexel_bits
            x, y = grid.to_crs(*places.T)
            camera = frame.camera
            expected = np.stack([x - camera.x, y - camera.y, surface.height(*places.T) - camera.z], axis=-1)
            found = corners["position"][first].astype(np.float64)
            ahead = expected @ camera.basis[2]
            seen = ahead > camera.near
            assert seen.sum() > 0
            error = np.linalg.norm(_pixels(frame, found[seen]) - _pixels(frame, expected[seen]), axis=1)
            # in the picture and a little beside it, where a pixel is as large as it should be
            near = (np.abs(_pixels(frame, expected[seen]) - np.array(SIZE) / 2) < np.array(SIZE)).all(axis=1)
            near &= ahead[seen] > 0.99 * pixel * frame.pixels_per_radian()
            assert near.sum() >= 4
            assert error[near].max() < LIMIT
            # samples: nothing is interpolated there
            cell = places[seen] - 0.5
            assert error[near & (cell == np.rint(cell)).all(axis=1)].max(initial=0) < LIMIT / 5


def _pixels(frame: Frame, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) pixel columns and rows of camera-relative points, by angles alone."""
    right, up, forward = frame.camera.basis
    scale = SIZE[1] / 2 / math.tan(math.radians(frame.camera.fov) / 2)
    ahead = points @ forward
    return np.stack([SIZE[0] / 2 + points @ right / ahead * scale, SIZE[1] / 2 - points @ up / ahead * scale], axis=-1)
