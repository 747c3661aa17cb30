"""Heights of 16 bits: exact where the data are integers, else off by half a step at most, and said to be."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.keys import NodeKey, level_shape
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.source.contract import Quantum, quantum_of
from orogen.source.open import open_height
from orogen.streaming.heightformat import FLOATS, LAST, HeightFormat, height_format
from orogen.streaming.settings import ClipmapSettings
from orogen.streaming.tiles import DecodedTiles, height_node

SHAPE = (300, 420)
RNG = np.random.default_rng(4)
ULP = 2.0**-23


def integers(low: int, high: int, dtype: str = "int32") -> NDArray[Any]:
    """(rows, columns) samples that reach both ends of a range."""
    samples = RNG.integers(low, high + 1, SHAPE, endpoint=False).astype(dtype)
    samples[10, 20], samples[200, 30] = low, high
    return samples


@pytest.mark.parametrize(
    ("low", "high", "options", "step"),
    [
        (-33, 3947, {}, 1 / 8),
        (0, 43798, {"height_scale": 0.1}, 0.1),
        (13, 8000, {"vertical_units": "foot"}, 0.3048 / 4),
        (100, 600, {"height_scale": 0.01, "height_offset": -413.0}, 0.01 / 64),
        (-9, 50000, {"height_scale": -0.5}, 0.5),
        (7, 7, {}, 2.0**-14),
    ],
)
def test_integers_are_kept_to_the_last_bit(low: int, high: int, options: dict[str, Any], step: float) -> None:
    samples = integers(low, high)
    with open_pyramid(open_height(samples, spacing=30.0, **options)) as pyramid:
        form = height_format(pyramid, None)
        assert form.bits == 16
        assert form.exact
        assert form.step == pytest.approx(step, rel=1e-12)
        heights = pyramid.read(0, slice(0, SHAPE[0]), slice(0, SHAPE[1]))
        texels = form.encode(heights)
        assert texels.dtype == np.uint16
        assert (texels > 0).all()
        assert (texels < LAST).all()
        # a power of two as the step: nothing is rounded at all
        tolerance = 0 if math.frexp(step)[0] == 0.5 else 2 * ULP * np.abs(heights).max()
        np.testing.assert_allclose(form.decode(texels), heights, rtol=0, atol=tolerance)
        for level in range(1, pyramid.level_count):
            rows, cols = (slice(0, n) for n in level_shape(SHAPE, level))
            means = pyramid.read(level, rows, cols)
            np.testing.assert_allclose(form.decode(form.encode(means)), means, rtol=0, atol=step / 2 + tolerance)


@pytest.mark.parametrize(
    "heights",
    [integers(0, 70000), integers(0, 65535), integers(0, 1000).astype(np.float32), integers(0, 90) / 7],
    ids=["too many steps", "no room past the edges", "floats", "doubles"],
)
def test_other_data_stay_floats_unless_they_are_to_be_rounded(heights: NDArray[Any]) -> None:
    with open_pyramid(open_height(heights, spacing=30.0)) as pyramid:
        assert height_format(pyramid, None) is FLOATS
        form = height_format(pyramid, 16)
        assert (form.bits, form.exact) == (16, False)
        assert math.frexp(form.step)[0] == 0.5
        true = pyramid.read(0, slice(0, SHAPE[0]), slice(0, SHAPE[1]))
        off = np.abs(form.decode(form.encode(true)) - true)
        assert off.max() <= form.step / 2
        # no coarser than 16 bits ask for, with an eighth of the range free on both sides
        assert form.step <= 2 * 1.25 * np.ptp(true) / (LAST - 1)
        low, high = pyramid.height_range
        assert form.around(low, high) == (low - form.step / 2, high + form.step / 2)


def test_what_cannot_be_known_for_certain_stays_float() -> None:
    with open_pyramid(open_height(integers(0, 1000), spacing=30.0), build="never") as pyramid:
        assert not pyramid.exact
        assert height_format(pyramid, None) is FLOATS
        assert height_format(pyramid, 16) is FLOATS
    with open_pyramid(open_height(integers(0, 1000), spacing=30.0)) as pyramid:
        assert height_format(pyramid, 32) is FLOATS


def test_sources_tell_their_quantum(tmp_path: Any) -> None:
    import rasterio

    def raster(name: str, dtype: str, **tags: Any) -> str:
        path = tmp_path / name
        with rasterio.open(
            path, "w", driver="GTiff", width=20, height=10, count=1, dtype=dtype, crs="EPSG:32633",
            transform=rasterio.Affine(10, 0, 5e5, 0, -10, 5e6),
        ) as file:  # fmt: skip
            file.write(RNG.integers(0, 200, (10, 20)).astype(dtype), 1)
            for key, value in tags.items():
                setattr(file, key, value)
        return str(path)

    packed = raster("packed.tif", "uint16", scales=(0.25,), offsets=(-50.0,))
    assert quantum_of(open_height(packed)) == Quantum(0.25, -50.0)
    assert quantum_of(open_height(packed, height_scale=2.0)) == Quantum(2.0, -50.0)
    assert quantum_of(open_height(raster("feet.tif", "int16"), vertical_units="foot")) == Quantum(0.3048)
    assert quantum_of(open_height(raster("float.tif", "float32"))) is None
    # what is warped is interpolated
    assert quantum_of(open_height(packed, crs="EPSG:4326")) is None


@pytest.mark.parametrize("shape", [(300, 420), (3, 700)])
def test_planes_stay_planes_past_the_edges(shape: tuple[int, int]) -> None:
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    plane = 3 * cols - 2 * rows + 50
    with open_pyramid(open_height(plane, spacing=30.0)) as pyramid:
        form = height_format(pyramid, None)
        assert form.bits == 16
        tiles = DecodedTiles(pyramid, 1 << 24)
        for level in range(pyramid.level_count):
            key = NodeKey(level, 0, 0)
            node, true = (height_node(tiles, pyramid, key, 256, True, f) for f in (form, FLOATS))
            drawn = form.decode(node.heights)
            np.testing.assert_allclose(drawn, true.heights, rtol=0, atol=form.step / 2)
            assert node.loss == np.abs(drawn - true.heights).max()
            assert (node.low, node.high) == (drawn.min(), drawn.max())
            assert (node.blocks[..., 0] >= node.low).all()
            assert (node.blocks[..., 1] <= node.high).all()
        assert node.heights.dtype == np.uint16


def test_what_does_not_fit_is_cut_and_counted_as_lost(pyramid_of: Callable[..., Pyramid]) -> None:
    cliff = np.zeros((40, 40), np.float32)
    cliff[:, -1] = 1000.0
    pyramid = pyramid_of(cliff)
    form = HeightFormat(16, 1 / 32, -500.0)
    node = height_node(DecodedTiles(pyramid, 1 << 20), pyramid, NodeKey(0, 0, 0), 256, True, form)
    # 2 texels past the edge it would be 3000 m high
    assert node.high == form.decode(np.array([LAST], np.uint16))[0]
    assert node.loss == 3000.0 - node.high
    assert node.low == 0.0


@pytest.mark.parametrize("bits", [8, 24, 0])
def test_no_other_bits(bits: int) -> None:
    with pytest.raises(SettingsError, match=f"height_bits: expected 16, 32 or none, got {bits}"):
        ClipmapSettings(height_bits=bits)


@pytest.mark.parametrize("bits", [None, 16])
def test_shaders_read_what_was_stored(bits: int | None, clipmap_of: Any, settle: Any, probe: Any) -> None:
    shape = (600, 900)
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = np.rint(4000 * np.sin(x / 50) * np.cos(y / 70)).astype(np.int32)
    given = heights if bits is None else heights / np.float32(3.7)
    with open_pyramid(open_height(given, spacing=1.0)) as pyramid:
        settings = ClipmapSettings(view_distance=math.inf, height_bits=bits)
        clipmap = clipmap_of(pyramid, None, settings)
        form = clipmap.heights.format
        assert (form.bits, form.exact) == (16, bits is None)
        grid = pyramid.grid
        cx, cy = (float(v) for v in grid.to_crs(210.0, 150.0))
        view, frame = settle(clipmap, Frame(Camera(cx, cy, 9000.0, heading=30.0, pitch=-40.0), grid, (64, 48)))
        for level in range(pyramid.level_count):
            rows, cols = level_shape(shape, level)
            j, i = RNG.integers(0, rows, 200), RNG.integers(0, cols, 200)
            true = pyramid.read(level, slice(0, rows), slice(0, cols))[j, i]
            # centres of texels that lie over the data
            tx, ty = (i + 0.5) * 2**level, (j + 0.5) * 2**level
            inside = (tx <= shape[1] - 0.5) & (ty <= shape[0] - 0.5)
            tx, ty, true = tx[inside], ty[inside], true[inside]
            found = probe(
                view, frame,
                "vec4<f32>(height_at_level(p, q.level), f32(resident_level(p, q.level)),"
                "slot_bounds[lookup(HEIGHTS, p.cell, q.level).slot].error, 0.0)",
                tx, ty, level=level,
            )  # fmt: skip
            assert (found[:, 1] == level).all()
            off = np.abs(found[:, 0] - true)
            assert off.max() <= (0 if form.exact and level == 0 else form.step / 2 + 1e-4)
            # what is lost is part of the error that is told
            bounds = pyramid.node_bounds(level)
            lost = found[:, 2] - bounds[j[inside] // 256, i[inside] // 256, 2]
            assert (lost >= off - 1e-4).all()
            assert lost.max() <= form.step / 2 + 1e-3
            if form.exact and level == 0:
                assert (found[:, 2] == 0).all()


def test_half_the_bytes_of_heights(clipmap_of: Any) -> None:
    with open_pyramid(open_height(integers(0, 4000), spacing=30.0)) as pyramid:
        sizes = []
        for bits in (None, 32):
            clipmap = clipmap_of(pyramid, None, ClipmapSettings(height_bits=bits))
            sizes.append((clipmap.heights.atlas.upload_bytes, clipmap.heights.atlas.capacity))
            sizes[-1] += (clipmap.heights.atlas.textures["height"].nbytes,)
        (upload, nodes, total), (float_upload, float_nodes, float_total) = sizes
        assert nodes == float_nodes
        assert 2 * upload == float_upload
        assert 2 * total == float_total
