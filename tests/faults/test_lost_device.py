"""A device that is lost: everything on the GPU is made anew, and the next picture is right."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from faults.scene import SIZE, Place, walk
from orogen.errors import DeviceLostError, GpuError
from orogen.gpu import Text, open_gpu
from orogen.shading.style import Style
from orogen.terrain import Terrain
from orogen.view import renderer as module
from orogen.view.recovery import ATTEMPTS
from orogen.view.renderer import Picture


def same(picture: Picture, clean: Picture) -> None:
    assert np.abs(picture.color.astype(int) - clean.color).max() <= 1
    np.testing.assert_allclose(picture.reverse_depth, clean.reverse_depth, atol=1e-7)


def lose_between(place: Place, clean: list[Picture], times: int, first: int = 0) -> None:
    cameras = walk()
    with place.terrain() as terrain:
        for number in range(first, first + times):
            at = number % len(cameras)
            same(terrain.render(cameras[at], SIZE, samples=1), clean[at])
            device = terrain.device
            device.destroy()
            following = (at + number // len(cameras)) % len(cameras)
            same(terrain.render(cameras[following], SIZE, samples=1), clean[following])
            assert terrain.device is not device
        assert len(terrain.faults) == 1
        assert "lost" in terrain.faults[0].cause
        assert terrain.faults[0].times == times


def test_the_next_picture_is_right(place: Place, clean: list[Picture], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "orogen")
    lose_between(place, clean, 3)
    assert len([record for record in caplog.records if record.name == "orogen"]) == 1


@pytest.mark.nightly
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("part", range(10))
def test_the_next_picture_is_right_a_hundred_times(
    place: Place, clean: list[Picture], part: int, record_property: Callable[[str, object], None]
) -> None:
    lose_between(place, clean, 10, first=10 * part)
    record_property("devices lost", 10)


@pytest.mark.parametrize("moment", ["settle", "_submit_sample", "_draw"])
def test_lost_in_the_middle_of_a_picture(
    moment: str, place: Place, clean: list[Picture], monkeypatch: pytest.MonkeyPatch
) -> None:
    """While nodes are loaded, while the frame is recorded, and while its picture is read back."""
    camera = walk()[1]
    owner: Any = module.Clipmap if moment == "settle" else module.Renderer
    original = getattr(owner, moment)
    lost = []

    def call(self: Any, *arguments: Any, **options: Any) -> Any:
        if moment == "_draw":
            result = original(self, *arguments, **options)
        if not lost:
            lost.append(self.gpu.device)
            self.gpu.device.destroy()
        return result if moment == "_draw" else original(self, *arguments, **options)

    monkeypatch.setattr(owner, moment, call)
    with place.terrain() as terrain:
        same(terrain.render(camera, SIZE, samples=1), clean[1])
        assert terrain.device is not lost[0]
        assert terrain.pick(48, 32) is not None


def test_algorithm_and_settings_are_kept(place: Place) -> None:
    with place.terrain() as terrain:
        terrain.use("udlod", pixels_per_quad=8.0)
        before = terrain.render(walk()[1], SIZE, Style(overlays=("levels",)), samples=1)
        terrain.device.destroy()
        after = terrain.render(walk()[1], SIZE, Style(overlays=("levels",)), samples=1)
        same(after, before)
        assert after.statistics == before.statistics
        assert terrain.renderer.algorithm.name == "udlod"


def test_a_device_that_cannot_be_kept_is_an_error_in_the_end(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    original = module.Clipmap.settle
    devices = []

    def settle(self: Any) -> None:
        devices.append(self.gpu.device)
        self.gpu.device.destroy()
        original(self)

    with place.terrain() as terrain:
        monkeypatch.setattr(module.Clipmap, "settle", settle)
        with pytest.raises(DeviceLostError, match="lost"):
            terrain.render(walk()[1], SIZE, samples=1)
        assert len(set(map(id, devices))) == ATTEMPTS
        monkeypatch.setattr(module.Clipmap, "settle", original)
        assert np.isfinite(terrain.render(walk()[1], SIZE, samples=1).position).any()


def test_drawing_into_a_texture_goes_on_with_another_device(place: Place) -> None:
    def draw_until_done(terrain: Terrain) -> np.ndarray:
        target = terrain.renderer.gpu.texture("target", SIZE, "rgba8unorm-srgb", "RENDER_ATTACHMENT|COPY_SRC", "test")
        while terrain.draw_to(target.view(), walk()[1], SIZE):
            pass
        return terrain.renderer.gpu.read_texture(target).result()

    with place.terrain() as terrain:
        before = draw_until_done(terrain)
        target = terrain.renderer.gpu.texture("target", SIZE, "rgba8unorm-srgb", "RENDER_ATTACHMENT|COPY_SRC", "test")
        view, device = target.view(), terrain.device
        device.destroy()
        assert terrain.draw_to(view, walk()[1], SIZE), "a further call is asked for"
        assert terrain.device is not device
        assert np.abs(draw_until_done(terrain).astype(int) - before).max() <= 1
        assert not terrain.revive()
        terrain.device.destroy()
        assert terrain.revive()


def test_what_is_asked_of_a_lost_device_says_so() -> None:
    with open_gpu() as gpu:
        buffer = gpu.buffer("data", 1 << 16, "STORAGE|COPY_SRC|COPY_DST", "test")
        texture = gpu.texture("picture", (8, 8), "r32float", "TEXTURE_BINDING|COPY_SRC|COPY_DST", "test")
        under_way = gpu.read_buffer(buffer)
        encoder = gpu.encoder("frame")
        gpu.check()
        gpu.device.destroy()
        for call in (
            gpu.check, gpu.timer, gpu.wait, texture.view, under_way.result,
            lambda: gpu.write(buffer, np.zeros(4)),
            lambda: gpu.write_texture(texture, np.zeros((8, 8), np.float32)),
            lambda: gpu.buffer("more", 64, "STORAGE", "test"),
            lambda: gpu.texture("more", (8, 8), "r32float", "TEXTURE_BINDING", "test"),
            lambda: gpu.read_texture(texture).result(),
            lambda: gpu.shader("main", Text("main", "@compute @workgroup_size(1) fn main() {}")),
            lambda: gpu.submit(encoder),
        ):  # fmt: skip
            with pytest.raises(DeviceLostError, match="the GPU device was lost"):
                call()
        assert issubclass(DeviceLostError, GpuError)
