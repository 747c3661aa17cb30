"""What leaving out hidden tiles gains udlod: tiles, triangles and milliseconds without it, with it, and by default.

Usage: python benchmarks/culling.py [--pixels-per-quad 1] [--size 1920x1080] [--rasterizer auto] [DATA ...]

Three views each over the endless terrain (`procedural`) and whatever DATA names, from near its middle. Views turn by a
tenth of a degree from frame to frame; times are medians of the GPU's passes.
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Iterator

from orogen.camera import Camera
from orogen.gpu import Gpu, open_gpu
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.source.open import open_height
from orogen.streaming.settings import ClipmapSettings
from orogen.view.renderer import Renderer

VIEWS = {"low": (300.0, -10.0), "middle": (1000.0, -30.0), "high": (3000.0, -80.0)}
"""Samples above the ground, and pitch in degrees."""
FRAMES = 9
HIDDEN = {"drawn": False, "left out": True, "by default": None}
"""What becomes of hidden tiles, and the setting for it."""
HEADS = (
    "data",
    "view",
    "hidden",
    "tiles",
    "million triangles",
    "ground",
    "refine",
    "raster",
    "to reveal",
    "shade",
    "all",
)


def measure(
    gpu: Gpu, name: str, pyramid: Pyramid, quad: float, size: tuple[int, int], path: str, place: tuple[float, float]
) -> Iterator[tuple[str, ...]]:
    """A row of figures per view and way of treating hidden tiles; `place`: columns and rows, 0 to 1, of the camera."""
    grid = pyramid.grid
    x, y = (float(n) for n in grid.to_crs(place[0] * grid.width, place[1] * grid.height))
    renderer = Renderer(
        gpu, pyramid, name="udlod", settings={"pixels_per_quad": 16.0}, rasterizer=path,
        clipmap=ClipmapSettings(memory=1 << 30, host_memory=1 << 29, threads=8),
    )  # fmt: skip
    # the ground under the camera
    renderer.render(Camera(x=x, y=y, z=9000.0, heading=20.0, pitch=-45.0), (64, 36))
    for view, (above, pitch) in VIEWS.items():
        z = renderer.clipmap.height_under(x, y) + above * grid.spacing
        cameras = [Camera(x=x, y=y, z=z, heading=20.0 + 0.1 * n, pitch=pitch) for n in range(FRAMES)]
        for hidden, occlusion in HIDDEN.items():
            renderer.use("udlod", {"pixels_per_quad": quad, "occlusion": occlusion})
            times = [timing.gpu_times for timing in renderer.time_frames(cameras, size)[2:]]
            picture = renderer.render(cameras[-1], size)
            parts = [_median(times, *names) for names in (("refine",), ("raster",), ("pyramid", "reveal"), ("shade",))]
            yield (
                name, view, hidden, f"{picture.statistics.patches:,}",
                f"{picture.statistics.triangles / 1e6:.1f}", f"{(picture.reverse_depth > 0).mean():.2f}",
                *(f"{part:.3f}" for part in parts), f"{statistics.median(sum(each.values()) for each in times):.3f}",
            )  # fmt: skip
    renderer.close()


def _median(times: list, *names: str) -> float:
    return statistics.median(sum(each.get(name, 0.0) for name in names) for each in times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="*")
    parser.add_argument("--pixels-per-quad", type=float, default=1.0)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--rasterizer", default="auto")
    given = parser.parse_args()
    width, height = (int(side) for side in given.size.split("x"))
    with open_gpu() as gpu:
        write(f"{gpu.info}\n| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
        for data in ("procedural", *given.data):
            with open_pyramid(open_height(data)) as pyramid:
                place = (0.92, 0.21) if data == "procedural" else (0.5, 0.55)
                for row in measure(gpu, data, pyramid, given.pixels_per_quad, (width, height), given.rasterizer, place):
                    write(f"| {' | '.join(row)} |")


def write(line: str) -> None:
    """A line of it, as soon as it is known."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
