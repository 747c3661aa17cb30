from __future__ import annotations

import gc

import numpy as np
import pytest

from orogen.errors import DeviceLostError, GpuError
from orogen.gpu import device as device_module
from orogen.gpu import open_gpu
from orogen.gpu.formats import format_of

COPY = "COPY_SRC|COPY_DST"


def noise(shape, dtype, seed=0):
    values = np.random.default_rng(seed).integers(0, 100, shape)
    return values.astype(dtype)


FORMATS = ["r8unorm", "r16float", "r16sint", "rg8snorm", "r32uint", "r32float", "rgba8unorm", "rg32float"]
FORMATS += ["rgba16uint", "rgba32float", "rgb10a2unorm"]


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("size", [(1, 1), (37, 5), (64, 2), (300, 3)])
def test_texture_round_trip(gpu, name, size):
    texture = gpu.texture("t", size, name, COPY, "test")
    form = format_of(name)
    array = noise(form.shape(*size), form.dtype)
    gpu.write_texture(texture, array)
    back = gpu.read_texture(texture).result()
    assert (back.dtype, back.shape) == (array.dtype, array.shape)
    np.testing.assert_array_equal(back, array)


def test_mips_layers_and_parts(gpu):
    texture = gpu.texture("t", (37, 21), "r32uint", COPY, "test", mips=3, layers=4)
    expected = {}
    for mip in range(3):
        for layer in range(4):
            width, height = texture.mip_size(mip)
            expected[mip, layer] = noise((height, width), np.uint32, seed=10 * mip + layer)
            gpu.write_texture(texture, expected[mip, layer], layer=layer, mip=mip)
    patch = noise((3, 4), np.uint32, seed=99)
    gpu.write_texture(texture, patch, layer=2, origin=(30, 11))
    expected[0, 2][11:14, 30:34] = patch
    for (mip, layer), array in expected.items():
        np.testing.assert_array_equal(gpu.read_texture(texture, mip=mip, layer=layer).result(), array)
    part = gpu.read_texture(texture, layer=2, origin=(29, 10), size=(7, 5)).result()
    np.testing.assert_array_equal(part, expected[0, 2][10:15, 29:36])


def test_slices_of_a_3d_texture(gpu):
    texture = gpu.texture("t", (5, 4, 3), "r8uint", COPY, "test")
    slices = noise((3, 4, 5), np.uint8)
    for z in range(3):
        gpu.write_texture(texture, slices[z], layer=z)
    assert texture.layers == 3
    np.testing.assert_array_equal([gpu.read_texture(texture, layer=z).result() for z in range(3)], slices)


def test_depth_is_read_back(gpu):
    depth = gpu.texture("depth", (13, 7), "depth32float", "RENDER_ATTACHMENT|COPY_SRC", "test")
    encoder = gpu.encoder("clear")
    attachment = {"view": depth.view(), "depth_load_op": "clear", "depth_store_op": "store", "depth_clear_value": 0.25}
    encoder.begin_render_pass(color_attachments=[], depth_stencil_attachment=attachment).end()
    gpu.submit(encoder)
    np.testing.assert_array_equal(gpu.read_texture(depth).result(), np.full((7, 13), 0.25, np.float32))


def test_compressed_blocks(gpu):
    if "texture-compression-bc" not in gpu.features:
        pytest.skip("the adapter has no BC textures")
    texture = gpu.texture("t", (16, 12), "bc1-rgba-unorm", COPY + "|TEXTURE_BINDING", "test", mips=3)
    for mip, shape in enumerate([(3, 4, 8), (2, 2, 8), (1, 1, 8)]):
        blocks = noise(shape, np.uint8, seed=mip)
        gpu.write_texture(texture, blocks, mip=mip)
        np.testing.assert_array_equal(gpu.read_texture(texture, mip=mip).result(), blocks)


def test_array_of_a_wrong_type_or_shape(gpu):
    texture = gpu.texture("heights", (4, 4), "r32float", COPY, "test")
    with pytest.raises(GpuError, match=r"'heights' \(r32float\): expected an array of float32 .*got float64"):
        gpu.write_texture(texture, np.zeros((4, 4)))
    colours = gpu.texture("colours", (4, 4), "rgba8unorm", COPY, "test")
    with pytest.raises(GpuError, match=r"\(rows, columns, 4\), got uint8 with shape \(4, 4, 3\)"):
        gpu.write_texture(colours, np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(GpuError, match="texture 'heights'"):
        gpu.write_texture(texture, np.zeros((4, 5), np.float32))


def test_array_that_is_not_contiguous(gpu):
    texture = gpu.texture("t", (9, 6), "r32float", COPY, "test")
    array = noise((12, 18), np.float32)[::2, ::2]
    gpu.write_texture(texture, array)
    np.testing.assert_array_equal(gpu.read_texture(texture).result(), array)
    buffer = gpu.buffer("b", array, "COPY_SRC", "test")
    np.testing.assert_array_equal(gpu.read_buffer(buffer, dtype=np.float32).result().reshape(6, 9), array)


@pytest.mark.parametrize("length", [0, 1, 3, 4, 7, 1000])
def test_buffer_of_any_length(gpu, length):
    data = noise(length, np.uint8).tobytes()
    buffer = gpu.buffer("b", data, "COPY_SRC", "test")
    assert buffer.size == max(4, -(-length // 4) * 4)
    back = gpu.read_buffer(buffer).result()
    assert back[:length].tobytes() == data
    assert not back[length:].any()


@pytest.mark.parametrize("usage", ["COPY_SRC", "COPY_DST|COPY_SRC", "COPY_SRC | COPY_DST"])
def test_data_can_be_written_again(gpu, usage):
    buffer = gpu.buffer("b", np.zeros(2, np.uint32), usage, "test")
    gpu.write(buffer, np.array([3, 4], np.uint32))
    assert gpu.read_buffer(buffer, dtype=np.uint32).result().tolist() == [3, 4]


def test_buffer_of_a_numpy_size(gpu):
    assert gpu.buffer("b", np.int64(64), "COPY_SRC", "test").size == 64


def test_part_of_a_buffer(gpu):
    buffer = gpu.buffer("b", np.arange(10, dtype=np.float32), "COPY_SRC", "test")
    gpu.write(buffer, np.array([-1, -2], np.float32), offset=12)
    assert gpu.read_buffer(buffer, 8, 16, np.float32).result().tolist() == [2, -1, -2, 5]


@pytest.mark.parametrize(("offset", "length"), [(0, 44), (32, 12), (-4, 4)])
def test_outside_of_a_buffer(gpu, offset, length):
    buffer = gpu.buffer("few", 40, COPY, "test")
    with pytest.raises(GpuError, match="'few': expected data within its 40 bytes"):
        gpu.write(buffer, bytes(length), offset)
    with pytest.raises(GpuError, match="'few': expected to read"):
        gpu.read_buffer(buffer, offset, length)


def test_type_that_does_not_fit(gpu):
    buffer = gpu.buffer("b", 20, "COPY_SRC", "test")
    with pytest.raises(GpuError, match="'b': expected a multiple of 8 bytes for uint64, got 20"):
        gpu.read_buffer(buffer, dtype=np.uint64)


def test_data_that_was_ready_when_the_device_went(gpu):
    with open_gpu(str(gpu.info.index)) as own:
        readback = own.read_buffer(own.buffer("b", np.arange(64), "COPY_SRC", "test"))
        assert readback._mapping._thread_event.wait(60)
        own.device.destroy()
        # here is when the memory goes
        own.device._poll()
        with pytest.raises(DeviceLostError):
            readback.result()


def test_more_than_a_slice(gpu):
    data = noise((17 << 20) + 5, np.uint8)
    buffer = gpu.buffer("large", data, "COPY_SRC", "test")
    np.testing.assert_array_equal(gpu.read_buffer(buffer).result()[: data.size], data)
    buffer.destroy()


def test_slices_of_a_texture(gpu, monkeypatch):
    monkeypatch.setattr(device_module, "_SLICE", 1000)
    texture = gpu.texture("t", (61, 47), "rg16float", COPY, "test")
    array = noise((47, 61, 2), np.float16)
    gpu.write_texture(texture, array)
    np.testing.assert_array_equal(gpu.read_texture(texture).result(), array)


def test_readbacks_keep_what_was_there_when_they_were_asked_for(gpu):
    buffer = gpu.buffer("b", 16, "COPY_SRC|COPY_DST", "test")
    readbacks = []
    for value in range(6):
        gpu.write(buffer, np.full(4, value, np.uint32))
        readbacks.append(gpu.read_buffer(buffer, dtype=np.uint32))
    gpu.wait()
    for value, readback in enumerate(readbacks):
        assert readback.result().tolist() == [value] * 4
        assert readback.ready()
        assert readback.result() is readback.result()


def test_readback_within_the_commands_of_a_frame(gpu):
    buffer = gpu.buffer("b", np.arange(4, dtype=np.uint32), "COPY_SRC|COPY_DST", "test")
    texture = gpu.texture("t", (3, 2), "r8uint", COPY, "test")
    encoder = gpu.encoder("frame")
    before = gpu.read_buffer(buffer, dtype=np.uint32, encoder=encoder)
    encoder.clear_buffer(buffer.raw)
    after = gpu.read_buffer(buffer, dtype=np.uint32, encoder=encoder)
    picture = gpu.read_texture(texture, encoder=encoder)
    assert not before.ready()
    with pytest.raises(GpuError, match="reading 'b': expected its encoder to be submitted"):
        before.result()
    gpu.submit(encoder)
    assert before.result().tolist() == [0, 1, 2, 3]
    assert after.result().tolist() == [0, 0, 0, 0]
    assert picture.result().tolist() == [[0, 0, 0], [0, 0, 0]]


def test_ready_comes_without_asking_for_the_result(gpu):
    import time

    readback = gpu.read_buffer(gpu.buffer("b", 1024, "COPY_SRC", "test"))
    deadline = time.monotonic() + 60
    while not readback.ready():
        assert time.monotonic() < deadline
        time.sleep(0.001)
    assert not readback.result().any()


def test_results_outlive_later_readbacks(gpu):
    first = gpu.buffer("a", np.full(64, 1, np.uint32), "COPY_SRC", "test")
    second = gpu.buffer("b", np.full(64, 2, np.uint32), "COPY_SRC", "test")
    kept = gpu.read_buffer(first, dtype=np.uint32).result()
    gpu.read_buffer(second, dtype=np.uint32).result()
    assert (kept == 1).all()


def test_staging_is_used_again_and_survives_dropped_readbacks(gpu):
    buffer = gpu.buffer("b", 4096, "COPY_SRC", "test")
    gpu.read_buffer(buffer).result()
    before = gpu.memory.total
    for _ in range(5):
        gpu.read_buffer(buffer).result()
    assert gpu.memory.total == before
    gpu.read_buffer(buffer)
    gpu.wait()
    gc.collect()
    assert gpu.memory.total <= before
