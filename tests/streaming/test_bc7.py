"""Colours as BC7 blocks: the GPU's against a numpy twin, decoded by Pillow."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from orogen.camera import Camera
from orogen.errors import SettingsError
from orogen.frame import Frame
from orogen.gpu import Gpu, Texture
from orogen.streaming.atlas import NodeAtlas, color_attachments
from orogen.streaming.bc7 import FEATURE, FORMAT, BlockEncoder
from orogen.streaming.settings import ClipmapSettings
from orogen.streaming.tiles import ColorNode
from streaming import bc7_twin as twin

Encoded = Callable[..., list[NDArray[np.uint8]]]


@pytest.fixture
def encoded(gpu: Gpu) -> Encoded:
    """encoded(mips) -> the blocks (rows, columns, 16) of each, read back from layer 1 of a texture of two."""
    if FEATURE not in gpu.features:
        pytest.skip(f"this GPU has no {FEATURE}")

    def run(*mips: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
        size = mips[0].shape[1], mips[0].shape[0]
        texture = gpu.texture("bc7", size, FORMAT, "COPY_DST|COPY_SRC", "test", mips=len(mips), layers=2)
        encoder = BlockEncoder(gpu, size, len(mips))
        encoder.encode(mips, texture, 1)
        found = [gpu.read_texture(texture, mip=mip, layer=1).result() for mip in range(len(mips))]
        assert not gpu.read_texture(texture, layer=0).result().any()
        encoder.destroy()
        texture.destroy()
        return found

    return run


def psnr(image: NDArray[np.uint8], other: NDArray[np.uint8]) -> float:
    return 10 * np.log10(255**2 / np.mean((image.astype(float) - other) ** 2))


def landscape(height: int, width: int, seed: int = 1) -> NDArray[np.uint8]:
    """(height, width, 4) smooth colours with noise, the alpha from opaque over a slope to nothing."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    waves = [np.sin(x / a + k) * np.cos(y / b - k) for k, (a, b) in enumerate([(9, 14), (17, 8), (23, 31)])]
    colors = 128 + 90 * np.stack(waves, axis=-1) + rng.normal(0, 6, (height, width, 3))
    alpha = np.clip(255 * (1.5 - 2 * x / width), 0, 255)
    colors *= alpha[..., None] / 255
    return np.rint(np.clip(np.dstack([colors, alpha]), 0, 255)).astype(np.uint8)


def test_blocks_are_those_of_the_twin(encoded: Encoded) -> None:
    image = landscape(64, 128)
    (found,) = encoded(image)
    expected = twin.encode(image)
    assert found.shape == expected.shape == (16, 32, 16)
    # sums in another order may choose another of two ends that are about as good
    same = (found == expected).all(axis=2)
    assert same.mean() > 0.97
    drawn, true = (twin.decode(blocks, (128, 64)) for blocks in (found, expected))
    assert psnr(drawn, image) == pytest.approx(psnr(true, image), abs=0.02)
    # mode 6: only bit 6 of the first seven is set
    assert (found[..., 0] & 0x7F == 64).all()


def test_the_colours_are_near(encoded: Encoded) -> None:
    image = landscape(64, 128)
    image = twin.decode(twin.encode(image), (128, 64))
    # what was encoded once lies on lines: encoded again it loses next to nothing
    drawn = twin.decode(encoded(image)[0], (128, 64))
    assert psnr(drawn, image) > 50
    assert np.abs(drawn.astype(int) - image).max() <= 6


def test_one_colour_and_alpha_at_its_ends_stay(encoded: Encoded) -> None:
    rng = np.random.default_rng(3)
    image = np.repeat(np.repeat(rng.integers(0, 256, (16, 32, 4)), 4, 0), 4, 1).astype(np.uint8)
    image[:32, :, 3] = 255
    image[32:] = 0
    drawn = twin.decode(encoded(image)[0], (128, 64)).astype(int)
    # an opaque end point has odd values alone
    assert np.abs(drawn - image).max() <= 1
    assert (drawn[..., 3] == image[..., 3]).all()
    assert (drawn[32:] == 0).all()
    noisy = rng.integers(0, 256, (64, 128, 4)).astype(np.uint8)
    noisy[..., 3] = 255
    assert (twin.decode(encoded(noisy)[0], (128, 64))[..., 3] == 255).all()


def test_all_mip_levels_also_those_that_blocks_do_not_fill(encoded: Encoded) -> None:
    mips = [landscape(272 >> k, 272 >> k, seed=k) for k in range(4)]
    found = encoded(*mips)
    assert [blocks.shape[:2] for blocks in found] == [(68, 68), (34, 34), (17, 17), (9, 9)]
    for blocks, image in zip(found, mips, strict=True):
        size = image.shape[1], image.shape[0]
        true = twin.decode(twin.encode(image), size)
        assert psnr(twin.decode(blocks, size), image) == pytest.approx(psnr(true, image), abs=0.05)


def test_an_atlas_of_blocks_takes_a_quarter(gpu: Gpu, encoded: Encoded) -> None:
    plain, blocks = color_attachments(256), color_attachments(256, compressed=True)
    assert sum(a.nbytes for a in plain) / sum(a.nbytes for a in blocks) == pytest.approx(4, abs=0.02)
    before = gpu.memory.total
    atlas = NodeAtlas(gpu, "test", blocks, 3, 1 << 24, 1)
    mips = tuple(landscape(272 >> k, 272 >> k, seed=k) for k in range(4))
    atlas.upload(2, ColorNode(mips))
    assert atlas.upload_bytes == sum(mip.nbytes for mip in mips)
    texture: Texture = atlas.textures["color"]
    assert texture.format == FORMAT
    atlas.destroy()
    assert gpu.memory.total == before


@pytest.mark.parametrize("compression", ["auto", "off"])
def test_an_image_is_compressed_where_that_is_asked_for(
    compression: Any, gpu: Gpu, clipmap_of: Any, pyramid_of: Any, settle: Any, probe: Any
) -> None:
    image = landscape(300, 500)
    heights = np.zeros((300, 500), np.float32)
    settings = ClipmapSettings(color_compression=compression, view_distance=4.0, behind=1.0)
    clipmap = clipmap_of(pyramid_of(heights), pyramid_of(image), settings)
    used = clipmap.colors.atlas.textures["color"].format
    assert used == (FORMAT if compression == "auto" and FEATURE in gpu.features else "rgba8unorm-srgb")
    view, frame = settle(clipmap, Frame(Camera(250.0, 150.0, 400.0, pitch=-60.0), clipmap.grid, (64, 48)))
    rng = np.random.default_rng(2)
    x, y = rng.integers(0, 500, 300), rng.integers(0, 300, 300)
    still = "mat2x2<f32>(vec2<f32>(0.01, 0.0), vec2<f32>(0.0, 0.01))"
    found = probe(view, frame, f"color_at(p, {still})", x + 0.5, y + 0.5)
    encoded = image[y, x] / 255.0
    light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    solid = encoded[:, 3] > 0.98
    off = np.abs(found - light)[solid, :3]
    assert solid.sum() > 50
    assert off.mean() < (0.02 if used == FORMAT else 0.005)


def test_no_other_compression() -> None:
    with pytest.raises(SettingsError, match="color_compression: expected auto or off, got 'on'"):
        ClipmapSettings(color_compression="on")  # type: ignore[arg-type]


def test_the_loss_on_a_real_image(data_dir: Path) -> None:
    with Image.open(data_dir / "puget_texture_1k.png") as file:
        image = np.asarray(file.convert("RGBA"))[256:512, 256:512]
    drawn = twin.decode(twin.encode(image), (256, 256))
    # a hard case: many colours side by side, of which a block holds those on a line
    assert 30 < psnr(drawn, image) < 45
