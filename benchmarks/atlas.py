"""What the node atlas costs: rays over heights of 16 and 32 bits, uploads, and what BC7 blocks lose of images.

    python benchmarks/atlas.py dem.tif image.png ... [--ramp dem.tif]

Times are medians (ms): of GPU passes, alternately with 16 and with 32 bits in one process, and of uploads of a node
until the GPU is done.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from orogen.gpu import Gpu, Text, open_gpu
from orogen.pyramid.open import open_pyramid
from orogen.shading.ramp import ramp_stops, ramps
from orogen.source.open import open_height
from orogen.streaming.bc7 import FEATURE, BlockEncoder
from orogen.streaming.settings import ClipmapSettings
from orogen.view.framing import frame_camera
from orogen.view.renderer import Renderer

DECODE = """
@group(0) @binding(0) var image: texture_2d<f32>;
@group(0) @binding(1) var<storage, read_write> pixels: array<u32>;
@compute @workgroup_size(8, 8) fn decode(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textureDimensions(image);
    if (any(id.xy >= size)) { return; }
    pixels[id.y * size.x + id.x] = pack4x8unorm(textureLoad(image, id.xy, 0));
}
"""


def passes(gpu: Gpu, raster: str, size: tuple[int, int], rounds: int) -> Iterator[str]:
    """Lines about rays over a raster."""
    pyramid = open_pyramid(open_height(raster))
    camera = frame_camera(pyramid.grid, pyramid.height_range, aspect=size[0] / size[1])
    flight = [camera, *(camera.moved(pitch=pitch, heading=30.0) for pitch in (-20.0, -60.0))]
    renderers = {}
    for bits in (16, 32):
        settings = ClipmapSettings(height_bits=bits)
        renderers[bits] = Renderer(gpu, pyramid, name="raycast", clipmap=settings)
        atlas = renderers[bits].clipmap.heights.atlas
        yield f"{bits} bits: {atlas.node_bytes} bytes a node, {atlas.upload_bytes} of them uploaded"
    times: dict[tuple[str, int], list[float]] = {}
    for _ in range(rounds):
        for bits, renderer in renderers.items():
            for view in flight:
                for timing in renderer.time_frames([view] * 3, size)[1:]:
                    for name, value in timing.gpu_times.items():
                        times.setdefault((name, bits), []).append(value)
    for (name, bits), values in sorted(times.items()):
        yield f"{name}, {bits} bits: {statistics.median(values):.3f} ms"
    for renderer in renderers.values():
        renderer.close()
    pyramid.close()


def uploads(gpu: Gpu, count: int = 32) -> Iterator[str]:
    """Lines about uploads of a colour node and of the heights of a node."""
    rng = np.random.default_rng(1)
    mips = [rng.integers(0, 256, (272 >> k, 272 >> k, 4)).astype(np.uint8) for k in range(4)]

    def texture(form: str, side: int, levels: int) -> object:
        return gpu.texture(form, (side, side), form, "TEXTURE_BINDING|COPY_DST", "benchmark", mips=levels, layers=count)

    plain, whole, real = texture("rgba8unorm-srgb", 272, 4), texture("r16uint", 260, 1), texture("r32float", 260, 1)
    heights = rng.integers(0, 4000, (260, 260))

    def upload_plain(layer: int) -> None:
        for mip, texels in enumerate(mips):
            gpu.write_texture(plain, texels, layer=layer, mip=mip)

    work: dict[str, Callable[[int], None]] = {
        "heights, 16 bits": lambda layer: gpu.write_texture(whole, heights.astype(np.uint16), layer=layer),
        "heights, 32 bits": lambda layer: gpu.write_texture(real, heights.astype(np.float32), layer=layer),
        "colours": upload_plain,
    }
    if FEATURE in gpu.features:
        blocks, encoder = texture("bc7-rgba-unorm-srgb", 272, 4), BlockEncoder(gpu, (272, 272), 4)
        work["colours as blocks"] = lambda layer: encoder.encode(mips, blocks, layer)
    for name, upload in work.items():
        times = []
        for _ in range(3):
            gpu.wait()
            start = time.perf_counter()
            for layer in range(count):
                upload(layer)
            gpu.wait()
            times.append(1000 * (time.perf_counter() - start) / count)
        yield f"upload of {name}: {statistics.median(times):.3f} ms"


def loss(gpu: Gpu, image: NDArray[np.uint8]) -> float:
    """PSNR (dB) of an image (height, width, 4) after BC7, as the GPU reads it; cut to whole blocks."""
    image = image[: image.shape[0] // 4 * 4, : image.shape[1] // 4 * 4]
    height, width = image.shape[:2]
    texture = gpu.texture("image", (width, height), "bc7-rgba-unorm", "TEXTURE_BINDING|COPY_DST", "benchmark")
    encoder = BlockEncoder(gpu, (width, height), 1)
    encoder.encode([image], texture, 0)
    layout = gpu.layout("decode", {0: ("COMPUTE", "texture float"), 1: ("COMPUTE", "storage")})
    pipeline = gpu.compute("decode", gpu.shader("decode", Text("decode", DECODE)), "decode", [layout])
    pixels = gpu.buffer("pixels", 4 * width * height, "STORAGE|COPY_SRC", "benchmark")
    commands = gpu.encoder("decode")
    run = commands.begin_compute_pass(label="decode")
    run.set_pipeline(pipeline)
    run.set_bind_group(0, gpu.bind("decode", layout, {0: texture, 1: pixels}))
    run.dispatch_workgroups(-(-width // 8), -(-height // 8))
    run.end()
    gpu.submit(commands)
    drawn = gpu.read_buffer(pixels).result().reshape(height, width, 4)
    return float(10 * np.log10(255**2 / np.mean((drawn[..., :3].astype(float) - image[..., :3]) ** 2)))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("raster")
    parser.add_argument("image", nargs="*", type=Path)
    parser.add_argument("--ramp", help="heights that are painted with every ramp")
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080), help="width and height of the pictures")
    parser.add_argument("--rounds", type=int, default=4)
    given = parser.parse_args()
    out = sys.stdout.write
    with open_gpu() as gpu:
        out(f"{gpu.info}\n")
        for line in chain(passes(gpu, given.raster, tuple(given.size), given.rounds), uploads(gpu)):
            out(line + "\n")
        if FEATURE not in gpu.features:
            return
        for path in given.image:
            with Image.open(path) as file:
                out(f"{path.name} as blocks: {loss(gpu, np.asarray(file.convert('RGBA'))):.1f} dB\n")
        if given.ramp:
            source = open_height(given.ramp)
            heights = source.read(*(slice(0, min(n, 1024)) for n in source.grid.shape))
            for name in ramps():
                stops = ramp_stops(name).over(float(np.nanmin(heights)), float(np.nanmax(heights)))
                painted = np.where(np.isnan(heights)[..., None], np.uint8(0), stops.paint(heights))
                out(f"ramp {name} as blocks: {loss(gpu, painted):.1f} dB\n")


if __name__ == "__main__":
    main()
