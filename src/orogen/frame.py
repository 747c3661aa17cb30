"""One frame to be drawn: camera, size and grid turned into the numbers that shaders and metrics use.

Camera-relative coordinates are metres east, north and up of the camera. The GPU never sees an absolute coordinate:
horizontal positions are integers in subtexels (1 / 2**subtexel_bits of a level-0 texel) plus a fraction below one,
heights are float32 metres from which the camera's height is subtracted.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.camera import Camera, Vector
from orogen.errors import SettingsError
from orogen.grid import EARTH_RADIUS, Grid
from orogen.values import once

REFERENCE_FOV = 45.0
"""Vertical angle (degrees) of the perspective camera whose distances stand in for an orthographic one's."""
# of the anchor
_FARTHEST = 2.0**29

Row = tuple[float, float, float, float]


def subtexel_bits(grid: Grid) -> int:
    """Fixed-point bits below a level-0 texel: 8, fewer where the raster is so large that int32 would overflow."""
    # the coarsest node may be up to eight times as wide as the raster
    return max(1, min(8, 28 - max(grid.shape).bit_length()))


def check_size(size: tuple[int, int]) -> None:
    """Raise SettingsError unless `size` is the width and height of a picture in pixels."""
    try:
        width, height = (operator.index(side) for side in size)
    except (TypeError, ValueError):
        raise SettingsError(f"size: expected width and height in whole pixels, got {size}") from None
    if width < 1 or height < 1:
        raise SettingsError(f"size: expected at least 1x1 pixels, got {width}x{height}")


@dataclass(frozen=True)
class Frame:
    """What an algorithm, a rasteriser and a shader need to know about the picture to draw."""

    camera: Camera
    """The camera that the picture is seen from."""
    grid: Grid
    """The grid of the heights: its texels are the working coordinates."""
    size: tuple[int, int]
    """Width and height of the picture in pixels."""
    lod_camera: Camera | None = None
    """The camera that levels of detail and culling are chosen for; None: the same as `camera`."""
    ground_height: float = 0.0
    """Approximate height of the terrain under the LOD camera in metres, before exaggeration (002, section 4.5.2)."""
    height_range: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest valid height of the data in metres, before exaggeration."""
    exaggeration: float = 1.0
    """Factor on all heights."""
    curvature: bool = False
    """Lower the ground by d^2 / 2R with the distance d from the camera."""
    jitter: tuple[float, float] = (0.0, 0.0)
    """Offset of the sample from the pixel's centre, in pixels (x right, y down): within -0.5 to 0.5, but for a part of
    a larger picture also where its middle lies from that one's."""
    coarseness: float = 1.0
    """Factor by which triangles may be larger in the picture than an algorithm's settings say; below 1 where `size` is
    that of a part of the picture that geometry is chosen for."""
    slice: int = 0
    """Which part of the frame is asked for, where it is drawn in several (temporal coherence)."""
    time_budget: float | None = field(default=None)
    """Seconds that an algorithm may spend refining; None: as long as it needs."""

    def __post_init__(self) -> None:
        check_size(self.size)
        if not (math.isfinite(self.exaggeration) and self.exaggeration > 0):
            raise SettingsError(f"exaggeration: expected a number above 0, got {self.exaggeration:g}")
        if not (math.isfinite(self.coarseness) and self.coarseness > 0):
            raise SettingsError(f"coarseness: expected a number above 0, got {self.coarseness:g}")

    @property
    def lod(self) -> Camera:
        """The camera that decides on levels of detail."""
        return self.lod_camera or self.camera

    @property
    def lod_size(self) -> tuple[float, float]:
        """Width and height in pixels of the picture that geometry is chosen for: `size` over `coarseness`."""
        return self.size[0] / self.coarseness, self.size[1] / self.coarseness

    @property
    def texel_size(self) -> tuple[float, float]:
        """Width and height in pixels of what texels are chosen for: the picture, or that of which it is a part."""
        return max(self.size, self.lod_size)

    @property
    def lod_fov(self) -> float:
        """Vertical angle of view (degrees) of the LOD camera, or of what stands in for an orthographic one."""
        return REFERENCE_FOV if self.lod.orthographic else self.lod.fov

    @once
    def subtexel_bits(self) -> int:
        """Fixed-point bits below a level-0 texel of the heights."""
        return subtexel_bits(self.grid)

    @once
    def eye_texel(self) -> tuple[float, float]:
        """The camera's position (column, row) in level-0 texels."""
        return self.grid.texel_of(self.camera.x, self.camera.y)

    @once
    def eye(self) -> NDArray[np.float64]:
        """`eye_texel` as an array."""
        return np.array(self.eye_texel)

    @once
    def anchor_subtexel(self) -> tuple[int, int]:
        """The camera's position in whole subtexels, kept within int32; what shaders subtract."""
        unit, (x, y) = 1 << self.subtexel_bits, self.eye_texel
        x, y = min(max(x * unit, -_FARTHEST), _FARTHEST), min(max(y * unit, -_FARTHEST), _FARTHEST)
        return math.floor(x), math.floor(y)

    @once
    def anchor(self) -> NDArray[np.int32]:
        """`anchor_subtexel` as an array."""
        return np.array(self.anchor_subtexel, np.int32)

    @once
    def eye_fraction(self) -> tuple[float, float]:
        """The camera's position minus the anchor, in subtexels: below 1 unless the camera is far outside."""
        unit, (x, y), (left, top) = 1 << self.subtexel_bits, self.eye_texel, self.anchor_subtexel
        return x * unit - left, y * unit - top

    @once
    def eye_offset(self) -> NDArray[np.float64]:
        """`eye_fraction` as an array."""
        return np.array(self.eye_fraction)

    @once
    def eye_height(self) -> tuple[float, float]:
        """The camera's height (m of the data, exaggeration undone): rounded to float32, and what that leaves out."""
        height = self.camera.z / self.exaggeration
        rounded = float(np.float32(height))
        return rounded, height - rounded

    @once
    def metres(self) -> NDArray[np.float64]:
        """2 x 2 matrix from a step in subtexels to metres (east, north)."""
        return self.grid.metres / (1 << self.subtexel_bits)

    @property
    def curvature_factor(self) -> float:
        """1 / 2R with curvature, else 0: the drop of the ground is this times the squared distance."""
        return 0.5 / EARTH_RADIUS if self.curvature else 0.0

    @once
    def half_extent(self) -> tuple[float, float]:
        """Half width and height of the picture: at view depth 1 (perspective) or in metres (orthographic)."""
        camera = self.camera
        half = camera.orthographic / 2 if camera.orthographic else math.tan(math.radians(camera.fov) / 2)
        return half * self.size[0] / self.size[1], half

    def pixels_per_radian(self, camera: Camera | None = None) -> float:
        """v of equation 2.3 (document 000): pixels that a length of d metres covers at a distance of d metres.

        Those of the picture; with a `camera`, such as the LOD camera, those that geometry is chosen for (`lod_size`).
        """
        height = self.lod_size[1] if camera else self.size[1]
        camera = camera or self.camera
        fov = REFERENCE_FOV if camera.orthographic else camera.fov
        return height / (2 * math.tan(math.radians(fov) / 2))

    def lod_eye(self) -> NDArray[np.float64]:
        """Where distances for the level of detail start: metres (east, north, up) relative to `camera`; read-only.

        For an orthographic camera this is the perspective camera that sees the point in the middle of the picture,
        on the approximate ground, at the same scale.
        """
        return self._lod_eye

    @once
    def _lod_eye(self) -> NDArray[np.float64]:
        result = np.array(self.lod_place)
        result.flags.writeable = False
        return result

    @once
    def lod_place(self) -> Vector:
        """`lod_eye` as plain numbers."""
        lod = self.lod
        if lod is self.camera and lod.orthographic is None:
            return 0.0, 0.0, 0.0
        east, north = (self._metric(lod) - self._metric(self.camera)).tolist()
        eye = east, north, lod.z - self.camera.z
        if lod.orthographic is None:
            return eye
        forward = lod.axes[2]
        above = lod.z - self.ground_height * self.exaggeration
        reach = self._data_diagonal()
        along = min(max(-above / forward[2], -reach), reach) if forward[2] < -1e-3 else 0.0
        back = lod.orthographic / (2 * math.tan(math.radians(REFERENCE_FOV) / 2))
        x, y, z = (at + way * (along - back) for at, way in zip(eye, forward, strict=True))
        return x, y, z

    def _metric(self, camera: Camera) -> NDArray[np.float64]:
        return self.grid.metres @ np.array(self.grid.texel_of(camera.x, camera.y))

    def _data_diagonal(self) -> float:
        return float(np.abs(self.grid.metres @ np.diag([self.grid.width, self.grid.height])).sum())

    @once
    def depth_range(self) -> tuple[float, float]:
        """View depths of an orthographic camera's near and far plane: the whole data lies between them."""
        w, h = self.grid.width, self.grid.height
        low, high = (v * self.exaggeration for v in self.height_range)
        flat = np.array([self.grid.metres @ np.array(c) for c in ((0, 0), (w, 0), (0, h), (w, h))])
        flat -= self._metric(self.camera)
        drop = self.curvature_factor * float((flat**2).sum(axis=1).max())
        corners = [(e, n, z - self.camera.z) for e, n in flat for z in (low - drop, high)]
        depths = np.array(corners) @ self.camera.basis[2]
        margin = 1.0 + 0.01 * float(np.ptp(depths))
        return float(depths.min()) - margin, float(depths.max()) + margin

    @once
    def clip_rows(self) -> tuple[Row, Row, Row, Row]:
        """The rows of `view_projection`."""
        right, up, forward = self.camera.axes
        half_x, half_y = self.half_extent
        # a sample at +jitter sees what lay there: the picture moves the other way
        shift_x, shift_y = 2 * self.jitter[0] / self.size[0], -2 * self.jitter[1] / self.size[1]
        if self.camera.orthographic:
            near, far = self.depth_range
            x, y, z = (-v / (far - near) for v in forward)
            depth, w = (x, y, z, far / (far - near)), (0.0, 0.0, 0.0, 1.0)
        else:
            depth, w = (0.0, 0.0, 0.0, self.camera.near), (*forward, 0.0)
        return _across(right, half_x, shift_x, w), _across(up, half_y, shift_y, w), depth, w

    @once
    def view_projection(self) -> NDArray[np.float64]:
        """4 x 4 (rows first) from camera-relative metres to clip space: reverse z, infinite far, jitter applied."""
        return np.array(self.clip_rows)

    def view_depth(self, depth: NDArray[np.floating]) -> NDArray[np.float64]:
        """Metres along the view axis of reverse-z depths; NaN where nothing was drawn (depth 0)."""
        depth = np.asarray(depth, np.float64)
        with np.errstate(divide="ignore"):
            if self.camera.orthographic:
                near, far = self.depth_range
                metres = far - depth * (far - near)
            else:
                metres = self.camera.near / depth
        return np.where(depth > 0, metres, np.nan)

    def rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Camera-relative origins and directions of the pixels' rays, (height, width, 3) each.

        The point at view depth d is origin + d * direction, so directions are not of unit length.
        """
        width, height = self.size
        return self._rays(np.arange(width)[None, :], np.arange(height)[:, None])

    def _rays(self, columns: NDArray[Any], rows: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        width, height = self.size
        right, up, forward = self.camera.basis
        half_x, half_y = self.half_extent
        u = ((columns + 0.5 + self.jitter[0]) / width * 2 - 1) * half_x
        v = (1 - (rows + 0.5 + self.jitter[1]) / height * 2) * half_y
        plane = u[..., None] * right + v[..., None] * up
        if self.camera.orthographic:
            return plane, np.broadcast_to(forward, plane.shape)
        return np.zeros_like(plane), plane + forward

    def positions(self, depth: NDArray[np.floating]) -> NDArray[np.float64]:
        """(height, width, 3): x, y in the data's CRS and height in metres (before exaggeration); sky is NaN."""
        return self._positions(*self.rays(), depth)

    def position(self, column: int, row: int, depth: float) -> tuple[float, float, float]:
        """x, y in the data's CRS and height (m) of what lies at a reverse-z depth in a pixel."""
        x, y, z = self._positions(*self._rays(np.array(column), np.array(row)), np.array(depth))
        return float(x), float(y), float(z)

    def _positions(
        self, origin: NDArray[np.float64], direction: NDArray[np.float64], depth: NDArray[np.floating]
    ) -> NDArray[np.float64]:
        point = origin + direction * self.view_depth(depth)[..., None]
        texel = self.eye + point[..., :2] @ self.grid.texels.T
        x, y = self.grid.to_crs(texel[..., 0], texel[..., 1])
        drop = self.curvature_factor * (point[..., :2] ** 2).sum(axis=-1)
        z = (point[..., 2] + drop + self.camera.z) / self.exaggeration
        return np.stack([x, y, z], axis=-1)

    def planes(self) -> NDArray[np.float64]:
        """(5, 4): planes (nx, ny, nz, d), positive inside, of the LOD camera's frustum in metres relative to `camera`.

        Left, right, bottom, top, near; an orthographic frustum has its near plane behind all data. Read-only.
        """
        return self._planes

    @once
    def _planes(self) -> NDArray[np.float64]:
        planes = np.array(self.plane_rows)
        planes.flags.writeable = False
        return planes

    @once
    def plane_rows(self) -> tuple[Row, ...]:
        """The rows of `planes`."""
        rows, shift = self.clip_rows, (0.0, 0.0, 0.0)
        if self.lod_camera:
            rows = replace(self, camera=self.lod_camera, lod_camera=None, jitter=(0.0, 0.0)).clip_rows
            east, north = (self._metric(self.lod_camera) - self._metric(self.camera)).tolist()
            shift = east, north, self.lod_camera.z - self.camera.z
        return _planes_of(rows, shift)


def _across(axis: Vector, half: float, shift: float, w: Row) -> Row:
    """A row of the projection to the side of an axis, or upwards."""
    a, b, c = axis
    return a / half - shift * w[0], b / half - shift * w[1], c / half - shift * w[2], -shift * w[3]


def _planes_of(rows: tuple[Row, Row, Row, Row], shift: Vector) -> tuple[Row, ...]:
    """Left, right, bottom, top and near plane of clip space, moved by (east, north, up)."""
    x, y, z, w = rows
    sides = ((w, x, 1.0), (w, x, -1.0), (w, y, 1.0), (w, y, -1.0), (w, z, -1.0))
    found = []
    for (a0, a1, a2, a3), (b0, b1, b2, b3), sign in sides:
        e, n, u = a0 + sign * b0, a1 + sign * b1, a2 + sign * b2
        d = a3 + sign * b3 - (e * shift[0] + n * shift[1] + u * shift[2])
        length = math.sqrt(e * e + n * n + u * u)
        found.append((e / length, n / length, u / length, d / length))
    return tuple(found)
