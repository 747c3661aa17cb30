"""The terrain of the fault tests, its pyramids built once, and pictures of it without any fault."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import orogen.gpu
from faults.scene import SIZE, Place, Seams, walk
from orogen.gpu import Gpu
from orogen.streaming import retry
from orogen.view.renderer import Picture


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    found = Place(tmp_path_factory.mktemp("faults"))
    found.terrain().close()
    assert found.error > 20
    return found


@pytest.fixture(scope="session")
def clean(place: Place) -> list[Picture]:
    """What the walk shows when nothing fails."""
    with place.terrain() as terrain:
        return [terrain.render(camera, SIZE, samples=1) for camera in walk()]


@pytest.fixture
def one_device(gpu: Gpu, monkeypatch: pytest.MonkeyPatch) -> None:
    """Terrains share a device: Mesa's software driver never gives the memory of a device's shaders back."""
    monkeypatch.setattr(orogen.gpu, "open_gpu", lambda *_, **__: gpu)
    monkeypatch.setattr(gpu, "close", lambda: None)


@pytest.fixture
def seams(monkeypatch: pytest.MonkeyPatch, clean: list[Picture], one_device: None) -> Iterator[Seams]:
    """Seams that let everything pass so far; what failed is tried again soon."""
    monkeypatch.setattr(retry, "FIRST", 0.05)
    return Seams(monkeypatch)
