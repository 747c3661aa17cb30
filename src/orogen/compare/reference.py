"""The true pictures of a flight: rays over all of level 0, shaded as the entries are, kept in the cache folder.

The surface is drawn with every sample resident. Its colours are looked up in the clipmap as the entries have it, so
that a picture differs from them by its geometry alone, and not by how an image or a normal is filtered.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import zipfile
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from orogen.compare.flights import Shot
from orogen.compare.plan import Entry, plain
from orogen.compare.scenery import Progress, Scenery
from orogen.errors import OrogenError
from orogen.frame import Frame
from orogen.lod.contract import Statistics
from orogen.shading.style import Style
from orogen.source import cache
from orogen.view.renderer import Picture, Renderer

FORMAT = 1
"""Changes with what is kept, and with how true pictures are drawn."""


class References:
    """True pictures, drawn once. Use it as a context manager."""

    def __init__(self, scenery: Scenery) -> None:
        self._scenery = scenery
        self._mark: IO[bytes] | None = None
        self._folder: Path | None = None
        plan = scenery.plan
        key = plain(
            [
                FORMAT, scenery.fingerprint, plan.size, dataclasses.asdict(plan.shown), plan.exaggeration,
                plan.curvature, dataclasses.asdict(plan.clipmap_settings()), _adapter(scenery),
            ]
        )  # fmt: skip
        digest = hashlib.sha256(json.dumps(key).encode()).hexdigest()[:20]
        try:
            folder = cache.cache_dir() / f"reference-{digest}"
            folder.mkdir(parents=True, exist_ok=True)
            self._mark = cache.hold(folder)
            self._folder = folder
        except OSError as error:
            raise OrogenError(
                f"{folder}: cannot be written: {error}; set OROGEN_CACHE_DIR to another folder"
            ) from error
        self._drawer: _Drawer | None = None

    def draw(self, shots: Iterable[Shot], progress: Progress) -> None:
        """Make sure that the pictures of all these frames are kept."""
        missing = [shot for shot in shots if not self._path(shot).exists()]
        for number, shot in enumerate(missing, start=1):
            self.picture(shot)
            progress(number / len(missing), "true pictures")
        self._close_drawer()

    def picture(self, shot: Shot) -> Picture:
        """The true picture of a frame."""
        kept = self._read(shot)
        if kept is None:
            if self._drawer is None:
                self._drawer = _Drawer(self._scenery)
            picture = self._drawer.draw(shot)
            self._write(shot, picture)
            return picture
        depth, color = kept
        return Picture(frame_of(self._scenery, shot), color, depth, Statistics())

    def _path(self, shot: Shot) -> Path:
        assert self._folder is not None
        place = repr((dataclasses.astuple(shot.camera), shot.sun))
        return self._folder / f"{hashlib.sha256(place.encode()).hexdigest()[:24]}.npz"

    def _read(self, shot: Shot) -> tuple[NDArray[np.float32], NDArray[np.uint8]] | None:
        try:
            with np.load(self._path(shot)) as file:
                return file["depth"], file["color"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def _write(self, shot: Shot, picture: Picture) -> None:
        path = self._path(shot)
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            with open(draft, "wb") as file:
                np.savez_compressed(file, depth=picture.reverse_depth, color=picture.color)
            os.replace(draft, path)
        except OSError as error:
            with contextlib.suppress(OSError):
                draft.unlink()
            raise OrogenError(f"{path}: cannot be written: {error}; set OROGEN_CACHE_DIR to another folder") from error

    def _close_drawer(self) -> None:
        if self._drawer is not None:
            self._drawer.close()
            self._drawer = None

    def __enter__(self) -> References:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close_drawer()
        if self._mark is not None:
            self._mark.close()


def frame_of(scenery: Scenery, shot: Shot) -> Frame:
    """What a picture of a frame of the flight shows."""
    plan = scenery.plan
    return Frame(
        shot.camera, scenery.grid, plan.size, height_range=scenery.heights.height_range,
        exaggeration=plan.exaggeration, curvature=plan.curvature,
    )  # fmt: skip


def style_of(style: Style, shot: Shot) -> Style:
    """A style under the sun of a frame, where the flight gives one."""
    return style if shot.sun is None else dataclasses.replace(style, sun=shot.sun)


class _Drawer:
    """Draws true pictures: one renderer for the surface, one for its colours."""

    def __init__(self, scenery: Scenery) -> None:
        self._scenery = scenery
        self._exact = scenery.exact_renderer()
        self._shader: Renderer = scenery.renderer(Entry("raycast"))
        self._checked = False
        gpu, size = scenery.gpu, scenery.plan.size
        usage = "TEXTURE_BINDING|COPY_DST"
        formats = ("r32float", "r32uint", "r32uint")
        self._surface = [gpu.texture("true surface", size, form, usage, "reference") for form in formats]
        self._light = self._shader.shading.samples(size)
        self._group = gpu.bind("surface", self._shader.rasterizer.read_layout, dict(enumerate(self._surface)))

    def draw(self, shot: Shot) -> Picture:
        """The true picture of a frame."""
        plan = self._scenery.plan
        flat = Style(color="plain", lit=False)
        drawn = self._exact.render(shot.camera, plan.size, flat, self._scenery.scene())
        if not self._checked:
            self._scenery.check_exact(self._exact)
            self._checked = True
        color = self._shade(shot, drawn.reverse_depth, style_of(plan.shown, shot))
        return Picture(frame_of(self._scenery, shot), color, drawn.reverse_depth, Statistics())

    def _shade(self, shot: Shot, depth: NDArray[np.float32], style: Style) -> NDArray[np.uint8]:
        gpu, renderer = self._scenery.gpu, self._shader
        view, clipmap = renderer.view, renderer.clipmap
        frame = view.frame_for(frame_of(self._scenery, shot))
        view.want(frame)
        clipmap.settle()
        frame = view.frame_for(frame)
        view.update(frame)
        gpu.write_texture(self._surface[0], depth)
        self._light.reset()
        encoder = gpu.encoder("true picture")
        scene, timer = view.bind_group, renderer.timer
        renderer.shading.record(encoder, timer, frame, scene, self._group, self._light, style, last=True)
        renderer.timer.resolve(encoder)
        gpu.submit(encoder)
        color: NDArray[np.uint8] = gpu.read_texture(self._light.picture).result()
        return color

    def close(self) -> None:
        self._light.destroy()
        for texture in self._surface:
            texture.destroy()
        self._shader.close()
        self._exact.close()


def _adapter(scenery: Scenery) -> list[Any]:
    info = scenery.gpu.info
    return [info.name, info.backend, info.driver]
