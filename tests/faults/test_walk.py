"""A walk through a terrain while a read, a decode, an allocation or an upload fails."""

from __future__ import annotations

import logging
import time
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from faults.scene import KINDS, SIZE, Place, Seams, walk
from orogen.errors import GpuError, OrogenError
from orogen.streaming.ceilings import CeilingBuilder, Sun
from orogen.terrain import Terrain
from orogen.view.renderer import Picture


def right(picture: Picture, clean: Picture, place: Place) -> None:
    """No hole, and no further from the true surface than the coarsest ancestor and the algorithm make it."""
    assert place.truth.gap(picture) <= place.error + place.truth.gap(clean) + 0.01
    assert place.truth.holes(picture, clean) == 0


def recovered(terrain: Terrain, clean: list[Picture]) -> None:
    """Full detail is back, within the time after which what failed is tried again at the latest."""
    for camera, expected in zip(walk(), clean, strict=True):
        deadline = time.monotonic() + 20
        for tries in count(1):
            picture = terrain.render(camera, SIZE, samples=1)
            if np.array_equal(picture.color, expected.color):
                break
            # a busy machine draws few pictures in that time
            assert tries < 200 or time.monotonic() < deadline, "full detail did not return"
            time.sleep(0.02)
        np.testing.assert_array_equal(picture.reverse_depth, expected.reverse_depth)
        assert all(fault.missing == 0 for fault in terrain.faults)


def one_fails(
    kind: str,
    number: int,
    place: Place,
    clean: list[Picture],
    seams: Seams,
    caplog: pytest.LogCaptureFixture,
    algorithm: str | None = None,
) -> bool:
    """The walk with one failing call; whether there were as many."""
    caplog.clear()
    before = seams.counts[kind]
    seams.failed.clear()
    seams.chosen = lambda called, count: called == kind and count == before + number
    try:
        terrain = place.terrain(algorithm=algorithm)
    except OrogenError as error:
        # the store's own tables could not be read: refused by name, and it opens the next time
        return str(place.cache) in str(error)
    with terrain:
        for camera, expected in zip(walk(), clean, strict=True):
            right(terrain.render(camera, SIZE, samples=1), expected, place)
        recovered(terrain, clean)
        if not seams.failed:
            return False
        warnings = [record.getMessage() for record in caplog.records if record.name == "orogen"]
        told = [(fault.cause, fault.missing) for fault in terrain.faults]
        if told:  # the ground under the camera may have been read from a coarser level at once
            assert len(told) == len(warnings) == 1
            assert told[0][0] in warnings[0]
            assert kind in ("allocation", "upload") or ".tif" in warnings[0] or str(place.cache) in warnings[0]
        return True


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        ("read", 10),
        ("read", 60),
        ("decode", 1),
        ("decode", 20),
        ("allocation", 5),
        ("allocation", 20),
        ("upload", 3),
        ("upload", 100),
    ],
)
def test_one_call_fails(
    kind: str, number: int, place: Place, clean: list[Picture], seams: Seams, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    assert one_fails(kind, number, place, clean, seams, caplog)


@pytest.mark.nightly
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("algorithm", [None, "cdlod", "udlod", "chunked_lod"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_call_fails_once(
    kind: str,
    algorithm: str | None,
    place: Place,
    clean: list[Picture],
    seams: Seams,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.WARNING)
    if algorithm is not None:
        with place.terrain(algorithm=algorithm) as terrain:
            clean = [terrain.render(camera, SIZE, samples=1) for camera in walk()]
    number = 1
    while one_fails(kind, number, place, clean, seams, caplog, algorithm):
        number += 1 if algorithm is None else 7
    assert number > 20


def test_a_sun_that_the_gpu_was_not_told_of_is_told_again(
    place: Place, clean: list[Picture], seams: Seams, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else shadows would be those of no sun from then on."""
    shine, fails = CeilingBuilder.shine, [True]

    def once(builder: CeilingBuilder, sun: Sun) -> None:
        if fails:
            fails.clear()
            raise GpuError("buffer 'sun ceilings': out of memory")
        shine(builder, sun)

    monkeypatch.setattr(CeilingBuilder, "shine", once)
    with place.terrain() as terrain:
        recovered(terrain, clean)
        assert not fails
        assert any("sun ceilings" in fault.cause for fault in terrain.faults)


@pytest.mark.parametrize("what", ["read", "height_node", "color_node", "write_texture"])
def test_nothing_fine_can_be_had_for_a_while(
    what: str, place: Place, clean: list[Picture], seams: Seams, caplog: pytest.LogCaptureFixture
) -> None:
    """All calls fail from the second view on: the coarsest node stands in; later everything comes."""
    caplog.set_level(logging.WARNING)
    cameras = walk()
    with place.terrain() as terrain:
        right(terrain.render(cameras[0], SIZE, samples=1), clean[0], place)
        kind = {"height_node": "decode", "color_node": "decode", "write_texture": "upload"}.get(what, what)
        seams.only = what
        seams.chosen = lambda called, _: called == kind
        for camera, expected in zip([*cameras[1:], cameras[1]], [*clean[1:], clean[1]], strict=True):
            right(terrain.render(camera, SIZE, samples=1), expected, place)
        assert any(fault.missing for fault in terrain.faults)
        assert terrain.retry_in is not None
        told = len(caplog.records)
        assert told == len(terrain.faults) <= 4
        calls, used = len(seams.failed), time.process_time()
        time.sleep(0.5)
        assert len(seams.failed) - calls < 400
        assert time.process_time() - used < 0.25, "waiting for the next try costs next to nothing"
        assert len(caplog.records) == told
        seams.chosen = lambda *_: False
        recovered(terrain, clean)


def test_a_lost_shard_is_told_once_and_ancestors_are_shown(
    place: Place, clean: list[Picture], seams: Seams, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    caplog.set_level(logging.WARNING)
    own = Place(tmp_path, place.heights, place.image)
    own.terrain().close()
    assert own.error > 20
    (shard,) = own.cache.glob("heights-height-*/1/height/c/0/0")
    with own.terrain() as terrain:
        kept = shard.read_bytes()
        shard.write_bytes(kept[: len(kept) // 2])
        for camera, expected in zip(walk(), clean, strict=True):
            right(terrain.render(camera, SIZE, samples=1), expected, own)
        (fault,) = terrain.faults
        assert str(shard.parents[3]) in fault.cause
        assert [record.getMessage().count(fault.cause) for record in caplog.records] == [1]
        shard.write_bytes(kept)
        recovered(terrain, clean)
