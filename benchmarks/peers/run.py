"""Orogen against PyVista, pygfx and Panda3D: the same data, flight, size and colours; time and likeness of each.

    python -m venv peers && peers/bin/pip install -r benchmarks/peers/requirements.txt
    python benchmarks/peers/run.py puget_height_1k.png --python peers/bin/python

Needs orogen in the Python that runs this; the peers are looked for in the other one.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import orogen
from orogen.compare.metrics import mean_square_error, psnr_of
from orogen.compare.prelit import lit
from orogen.shading import Style
from orogen.source import open_height

HERE = Path(__file__).parent
PEERS = {"PyVista (VTK)": "vtk_peer.py", "pygfx": "pygfx_peer.py", "Panda3D (GeoMipTerrain)": "panda_peer.py"}
OURS = {"orogen raycast": ("raycast", {}), "orogen udlod": ("udlod", {}), "orogen brute": ("brute", {})}
STYLE = Style(lit=False, color="image", background="#000000")
ROUNDS = 3
"""As in peer.py."""
REFERENCE_SAMPLES = 64


def main() -> None:
    """Measure, and print the table."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("data", help="Puget's heights, 16-bit PNG")
    words.add_argument("--python", required=True, help="Python that has the peers")
    words.add_argument("--size", default="1280x720")
    words.add_argument("--frames", type=int, default=8)
    words.add_argument("--pictures", type=Path, help="folder for the first picture of each")
    words.add_argument("--json", action="store_true")
    options = words.parse_args()
    size = tuple(int(n) for n in options.size.split("x"))
    source = open_height(options.data, spacing=160.0, height_scale=0.1)
    heights = source.read(slice(0, source.grid.height), slice(0, source.grid.width)).astype(np.float32)
    texture = lit(heights, source.grid.metres, (float(heights.min()), float(heights.max())), Style())
    with tempfile.TemporaryDirectory() as place:
        terrain = open_terrain(heights, texture, source.grid.transform, Path(place))
        cameras = flight(terrain, options.frames)
        reference = [terrain.render(c, size, STYLE, samples=REFERENCE_SAMPLES).color[..., :3] for c in cameras]
        rows = [ours(terrain, name, cameras, size, reference, options.pictures) for name in OURS]
        scene = Path(place) / "scene.npz"
        write_scene(scene, heights, texture, cameras, size, terrain.grid.transform[2::3])
        rows += [theirs(options.python, name, scene, reference, options.pictures) for name in PEERS]
        adapter = str(terrain.renderer.gpu.info)
        terrain.close()
    if options.pictures:
        keep(options.pictures, "reference", reference[0])
    if options.json:
        sys.stdout.write(json.dumps({"adapter": adapter, "size": size, "rows": rows}, indent=1) + "\n")
        return
    sys.stdout.write(f"{options.frames} frames, {size[0]}x{size[1]}, {adapter}\n")
    for row in rows:
        shown = f"{row['ms']:8.1f} ms   {row['psnr']:6.2f} dB" if "ms" in row else row["failed"]
        sys.stdout.write(f"{row['name']:<24} {shown}\n")


def open_terrain(heights, texture, transform, place):
    """The heights with the texture draped over them."""
    import rasterio

    path, rows, columns = place / "texture.tif", *heights.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=rows, count=3, dtype="uint8",
        transform=rasterio.Affine(*transform),
    ) as file:  # fmt: skip
        file.write(texture.transpose(2, 0, 1))
    return orogen.open(heights, spacing=160.0, color=str(path), build="wait", gpu_memory=None)


def flight(terrain, frames):
    """Around the middle, from far to near."""
    return [
        terrain.camera(distance=90_000.0 - 60_000.0 * k / max(frames - 1, 1), heading=360.0 * k / frames, pitch=-25.0)
        for k in range(frames)
    ]


def write_scene(path, heights, texture, cameras, size, corner) -> None:
    """What peer.py reads; `corner`: x and y of the upper left corner of the data."""
    eyes = np.array([[c.x - corner[0], c.y - corner[1], c.z] for c in cameras])
    targets = eyes + np.array([1000 * c.basis[2] for c in cameras])
    np.savez(
        path, heights=heights, texture=texture, spacing=160.0, size=size, eyes=eyes, targets=targets,
        fov=cameras[0].fov, range=(100.0, 500_000.0),
    )  # fmt: skip


def ours(terrain, name, cameras, size, reference, folder):
    """Time and likeness of an algorithm of ours."""
    algorithm, settings = OURS[name]
    terrain.use(algorithm, **settings)
    times, pictures = [], []
    for number in range(ROUNDS):
        pictures = []
        for camera in cameras:
            start = time.perf_counter()
            picture = terrain.render(camera, size, STYLE, samples=1)
            if number:
                times.append(time.perf_counter() - start)
            pictures.append(picture.color[..., :3])
    return judged(name, times, pictures, reference, folder)


def theirs(python, name, scene, reference, folder):
    """Time and likeness of a peer, in a process of its own."""
    result = scene.with_name("result.npz")
    command = [python, str(HERE / PEERS[name]), str(scene), str(result)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=HERE)
    if done.returncode:
        return {"name": name, "failed": done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "failed"}
    with np.load(result) as found:
        return judged(name, found["times"].tolist(), list(found["pictures"]), reference, folder)


def judged(name, times, pictures, reference, folder):
    """A row of the table."""
    error = statistics.mean(mean_square_error(a, b) for a, b in zip(pictures, reference, strict=True))
    if folder:
        keep(folder, name, pictures[0])
    return {"name": name, "ms": 1000 * statistics.median(times), "psnr": psnr_of(error)}


def keep(folder, name, picture) -> None:
    """Save a picture."""
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(folder / f"{name.split()[0].lower()}-{name.split()[-1].strip('()').lower()}.png")


if __name__ == "__main__":
    main()
