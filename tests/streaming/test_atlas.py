"""The node atlas keeps its size and what was wanted last; the GPU makes the maxima of its nodes."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.errors import BudgetError
from orogen.gpu import Gpu, Text, Texture
from orogen.keys import NodeKey
from orogen.streaming.atlas import MaximaBuilder, NodeAtlas, color_attachments, height_attachments
from orogen.streaming.heightformat import FLOATS, HeightFormat
from orogen.streaming.settings import HEIGHT_BORDER
from orogen.streaming.tiles import ColorNode, HeightNode

WHOLE = HeightFormat(16, 1 / 32, -1000.0)


@pytest.fixture
def small(gpu: Gpu) -> Iterator[NodeAtlas]:
    attachments = height_attachments(256, covered=True)
    atlas = NodeAtlas(gpu, "test", attachments, 1000, 6 * sum(a.nbytes for a in attachments) + 5, 3)
    yield atlas
    atlas.destroy()


def test_takes_no_more_memory_than_it_may(gpu: Gpu) -> None:
    before = gpu.memory.total
    for attachments in (height_attachments(256, covered=False), color_attachments(256)):
        for memory in (3 << 20, 20 << 20):
            atlas = NodeAtlas(gpu, "test", attachments, 1000, memory, 3)
            used = gpu.memory.total - before
            assert used <= memory
            assert used >= memory - sum(a.nbytes for a in attachments)
            atlas.destroy()
            assert gpu.memory.total == before


def test_is_no_larger_than_the_terrain(gpu: Gpu) -> None:
    atlas = NodeAtlas(gpu, "test", height_attachments(256, covered=True), 2, 1 << 30, 5)
    assert atlas.capacity == 2
    atlas.destroy()


def test_too_little_memory_says_what_to_do(gpu: Gpu) -> None:
    before = gpu.memory.total
    with pytest.raises(
        BudgetError, match=r"height atlas: expected room for at least 8 nodes of \d+ bytes, got 1048576"
    ):
        NodeAtlas(gpu, "height", height_attachments(256, covered=True), 1000, 1 << 20, 8)
    assert gpu.memory.total == before


def test_the_least_recently_wanted_node_makes_room(small: NodeAtlas) -> None:
    a, b, c, d, e, f, g, h = (NodeKey(0, i, 0) for i in range(8))
    slots = [small.place(key, [a]) for key in (a, b, c, d, e, f)]
    assert sorted(s for s in slots if s is not None) == list(range(6))
    small.touch([b, g])
    # a is the oldest but is wanted, b was wanted since
    assert small.place(g, {a, g}) == slots[2]
    assert c not in small.resident
    assert small.place(h, {a, h}) == slots[3]
    assert small.place(h, {a, h}) == slots[3]
    assert small.place(c, set(small.resident)) is None
    assert set(small.resident) == {a, b, e, f, g, h}


def test_slots_are_never_shared_and_wanted_nodes_never_lost(small: NodeAtlas) -> None:
    chance = random.Random(5)
    keys = [NodeKey(chance.randrange(3), i, i) for i in range(20)]
    for _ in range(300):
        wanted = chance.sample(keys, chance.randrange(1, 7))
        kept = {key: slot for key, slot in small.resident.items() if key in wanted}
        small.touch(wanted)
        for key in chance.sample(wanted, chance.randrange(len(wanted) + 1)):
            assert small.place(key, wanted) is not None
        assert len(small.resident) <= small.capacity == 6
        assert len(set(small.resident.values())) == len(small.resident)
        assert all(small.resident[key] == slot for key, slot in kept.items())


def read_layer(gpu: Gpu, texture: Texture, layer: int) -> NDArray[Any]:
    """(rows, columns) of a single-channel array texture that cannot be copied from."""
    width, height = texture.size
    whole = texture.format.endswith("uint")
    scalar = "u32" if whole else "f32"
    code = f"""
    @group(0) @binding(0) var source: texture_2d_array<{scalar}>;
    @group(0) @binding(1) var<storage, read_write> target: array<{scalar}>;
    @compute @workgroup_size(8, 8) fn copy(@builtin(global_invocation_id) id: vec3<u32>) {{
        if (id.x >= {width}u || id.y >= {height}u) {{ return; }}
        target[id.y * {width}u + id.x] = textureLoad(source, vec2<i32>(id.xy), {layer}, 0).x;
    }}"""
    kind = f"texture {'uint' if whole else 'unfilterable'} 2d-array"
    layout = gpu.layout("copy", {0: ("COMPUTE", kind), 1: ("COMPUTE", "storage")})
    pipeline = gpu.compute("copy", gpu.shader("copy", Text("copy", code.replace("target", "sink"))), "copy", [layout])
    sink = gpu.buffer("copy", 4 * width * height, "STORAGE|COPY_SRC", "test")
    encoder = gpu.encoder("copy")
    run = encoder.begin_compute_pass(label="copy")
    run.set_pipeline(pipeline)
    run.set_bind_group(0, gpu.bind("copy", layout, {0: texture.view(dimension="2d-array"), 1: sink}))
    run.dispatch_workgroups(-(-width // 8), -(-height // 8))
    run.end()
    gpu.submit(encoder)
    return gpu.read_buffer(sink, dtype=np.uint32 if whole else np.float32).result().reshape(height, width)


def maxima_place(level: int, size: int) -> tuple[int, int]:
    """Row and column of a level in the maxima of a node: level 1 at the left, the others one under another."""
    if level == 1:
        return 0, 0
    return sum((size >> k) + 1 for k in range(2, level)), size // 2 + 1


def highest(samples: NDArray[np.float32], level: int, size: int) -> NDArray[np.float32]:
    """Entry b: maximum of the samples b 2^level - 1 to (b + 1) 2^level - 1, along both axes."""
    for axis in (0, 1):
        lines = np.moveaxis(samples, axis, 0)
        blocks = []
        for b in range((size >> level) + 1):
            start = b * 2**level - 1 + HEIGHT_BORDER
            # the last block has a single cell of the node; one sample more is known
            blocks.append(lines[start : start + 2**level + 1][: size + HEIGHT_BORDER + 2 - start].max(axis=0))
        samples = np.moveaxis(np.array(blocks), 0, axis)
    return samples


@pytest.mark.parametrize(("size", "form"), [(256, FLOATS), (256, WHOLE), (512, WHOLE)])
def test_maxima_of_every_block_of_every_level(gpu: Gpu, size: int, form: HeightFormat) -> None:
    atlas = NodeAtlas(gpu, "test", height_attachments(size, True, form), 3, 1 << 30, 1)
    builder = MaximaBuilder(gpu, atlas, size.bit_length() - 1, form)
    rng = np.random.default_rng(6)
    side = size + 2 * HEIGHT_BORDER
    nodes = {slot: form.encode(rng.normal(-500, 100, (side, side)).astype(np.float32)) for slot in (0, 1, 2)}
    for slot, heights in nodes.items():
        atlas.upload(slot, HeightNode(heights, None, 0.0, 0.0, np.zeros((0, 0, 2))))
    builder.build([2, 0])
    builder.build([])
    for slot in (0, 2):
        found = read_layer(gpu, atlas.textures["maxima"], slot)
        for level in range(1, size.bit_length()):
            row, col = maxima_place(level, size)
            count = (size >> level) + 1
            np.testing.assert_array_equal(
                found[row : row + count, col : col + count],
                highest(form.decode(nodes[slot]), level, size),
                f"level {level}",
            )
        # nothing is allotted in vain
        assert found.shape == (row + count, size // 2 + 1 + size // 4 + 1)
    assert not read_layer(gpu, atlas.textures["maxima"], 1).any()
    atlas.destroy()


@pytest.mark.parametrize("form", [FLOATS, WHOLE])
def test_uploads_reach_their_slots(gpu: Gpu, form: HeightFormat) -> None:
    rng = np.random.default_rng(7)
    atlas = NodeAtlas(gpu, "test", height_attachments(256, False, form), 2, 1 << 30, 1)
    heights = form.encode(rng.normal(size=(260, 260)).astype(np.float32))
    coverage = rng.integers(0, 256, (260, 260)).astype(np.uint8)
    atlas.upload(1, HeightNode(heights, coverage, 0.0, 0.0, np.zeros((0, 0, 2))))
    np.testing.assert_array_equal(read_layer(gpu, atlas.textures["height"], 1), heights)
    np.testing.assert_allclose(read_layer(gpu, atlas.textures["coverage"], 1) * 255, coverage, atol=1e-4)
    assert not read_layer(gpu, atlas.textures["height"], 0).any()
    assert atlas.upload_bytes == heights.nbytes + coverage.nbytes
    atlas.destroy()


def test_bytes_of_a_node_are_those_of_its_uploads(gpu: Gpu) -> None:
    mips: list[Any] = [np.zeros((272 >> k, 272 >> k, 4), np.uint8) for k in range(4)]
    atlas = NodeAtlas(gpu, "test", color_attachments(256), 1, 1 << 30, 1)
    atlas.upload(0, ColorNode(tuple(mips)))
    assert atlas.upload_bytes == sum(mip.nbytes for mip in mips)
    atlas.destroy()
