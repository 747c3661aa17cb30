from __future__ import annotations

import gc
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from orogen.errors import BudgetError, GpuError, SettingsError
from orogen.gpu import MemoryAccount, open_gpu
from orogen.gpu.formats import format_of, texture_bytes


def test_account_counts_by_category():
    account = MemoryAccount(100)
    account.allocate(30, "atlas")
    account.allocate(50, "surface")
    account.release(30, "atlas")
    account.allocate(10, "lod")
    assert (account.total, account.peak, account.free) == (60, 80, 40)
    assert account.by_category() == {"surface": 50, "lod": 10}


def test_account_refuses_and_counts_nothing():
    account = MemoryAccount(3 << 20)
    account.allocate(2 << 20, "atlas")
    with pytest.raises(BudgetError, match=r"'heights': expected at most 1.0 MiB.*got 1.5 MiB; in use: atlas 2.0 MiB"):
        account.allocate(3 << 19, "atlas", "heights")
    assert account.total == 2 << 20
    account.allocate(1 << 20, "atlas")
    assert account.free == 0


def test_budget_must_be_positive():
    with pytest.raises(SettingsError, match="at least 1 byte, got 0"):
        MemoryAccount(0)
    assert MemoryAccount().free is None


def test_account_never_exceeds_its_budget_from_threads():
    account = MemoryAccount(1000)
    barrier = threading.Barrier(8)

    def work(seed: int) -> int:
        rng, refused, held = np.random.default_rng(seed), 0, []
        barrier.wait()
        for size in rng.integers(1, 200, 500).tolist():
            try:
                account.allocate(size, f"c{seed % 3}")
                held.append(size)
            except BudgetError:
                refused += 1
            time.sleep(0)  # the others' turn
            if len(held) > 2:
                account.release(held.pop(0), f"c{seed % 3}")
        for size in held:
            account.release(size, f"c{seed % 3}")
        return refused

    with ThreadPoolExecutor(8) as pool:
        refused = sum(pool.map(work, range(8)))
    assert refused > 0
    assert account.peak <= 1000
    assert account.total == 0
    assert account.by_category() == {}


# from the WebGPU specification: texel block copy footprints
@pytest.mark.parametrize(
    ("name", "itemsize", "block"),
    [
        ("r8unorm", 1, (1, 1)),
        ("rg8snorm", 2, (1, 1)),
        ("r16float", 2, (1, 1)),
        ("rgba8unorm-srgb", 4, (1, 1)),
        ("bgra8unorm", 4, (1, 1)),
        ("rgb10a2unorm", 4, (1, 1)),
        ("rg32uint", 8, (1, 1)),
        ("rgba16float", 8, (1, 1)),
        ("rgba32float", 16, (1, 1)),
        ("depth32float", 4, (1, 1)),
        ("bc1-rgba-unorm-srgb", 8, (4, 4)),
        ("bc4-r-snorm", 8, (4, 4)),
        ("bc5-rg-unorm", 16, (4, 4)),
        ("bc7-rgba-unorm", 16, (4, 4)),
        ("etc2-rgb8unorm", 8, (4, 4)),
        ("etc2-rgb8a1unorm-srgb", 8, (4, 4)),
        ("etc2-rgba8unorm", 16, (4, 4)),
        ("eac-r11snorm", 8, (4, 4)),
        ("eac-rg11unorm", 16, (4, 4)),
        ("astc-10x5-unorm-srgb", 16, (10, 5)),
    ],
)
def test_formats(name, itemsize, block):
    assert (format_of(name).itemsize, format_of(name).block) == (itemsize, block)


def test_unknown_format():
    with pytest.raises(GpuError, match="got 'rgb8unorm'"):
        format_of("rgb8unorm")


def test_texture_bytes():
    assert texture_bytes("r32float", (5, 3), mips=3, layers=2) == 4 * 2 * (5 * 3 + 2 * 1 + 1)
    assert texture_bytes("bc7-rgba-unorm", (10, 10), mips=3) == 16 * (9 + 4 + 1)
    assert texture_bytes("r8unorm", (4, 4), depth=4, mips=2) == 64 + 8
    assert texture_bytes("rgba8unorm", (4, 4), samples=4) == 256


@pytest.fixture
def small(gpu):
    with open_gpu(str(gpu.info.index), budget=1 << 20) as opened:
        yield opened


def test_device_counts_and_releases_once(small):
    before = small.memory.total
    buffer = small.buffer("b", 1001, "STORAGE", "lod")
    texture = small.texture("t", (64, 32), "rgba16float", "TEXTURE_BINDING", "surface", mips=2, layers=3)
    assert small.memory.by_category()["lod"] == buffer.size == 1004
    assert small.memory.by_category()["surface"] == texture.nbytes == 8 * 3 * (64 * 32 + 32 * 16)
    for _ in range(2):
        buffer.destroy()
        texture.destroy()
    del buffer, texture
    gc.collect()
    assert small.memory.total == before


def test_memory_comes_back_when_nothing_refers_to_it(small):
    before = small.memory.total
    small.buffer("b", 1 << 16, "STORAGE", "lod")
    texture = small.texture("t", (64, 64), "r32float", "TEXTURE_BINDING", "lod")
    view = texture.view()
    del texture
    gc.collect()
    assert small.memory.total == before + 64 * 64 * 4
    del view
    gc.collect()
    assert small.memory.total == before


def test_what_a_bind_group_holds_stays_counted(small):
    before = small.memory.total
    layout = small.layout("l", {0: ("COMPUTE", "storage"), 1: ("COMPUTE", "uniform")})
    group = small.bind(
        "g",
        layout,
        {
            0: small.buffer("b", 4096, "STORAGE", "lod"),
            1: (small.buffer("u", 512, "UNIFORM", "lod"), 256, 64),
        },
    )
    gc.collect()
    assert small.memory.total == before + 4096 + 512
    del group
    gc.collect()
    assert small.memory.total == before


def test_budget_refuses_before_anything_is_allocated(small, monkeypatch):
    reached = []
    monkeypatch.setattr(small.device, "create_buffer", lambda **given: reached.append(given))
    monkeypatch.setattr(small.device, "create_texture", lambda **given: reached.append(given))
    before = small.memory.total
    with pytest.raises(BudgetError, match="GPU memory for 'heights'"):
        small.buffer("heights", 1 << 21, "STORAGE", "atlas")
    with pytest.raises(BudgetError, match="GPU memory for 'colours'"):
        small.texture("colours", (1024, 1024), "rgba8unorm", "TEXTURE_BINDING", "atlas")
    assert reached == []
    assert small.memory.total == before


def test_what_the_driver_refuses_is_not_counted(small):
    before = small.memory.total
    with pytest.raises(GpuError, match="texture 'wide': "):
        small.texture("wide", (1 << 17, 1), "r8unorm", "TEXTURE_BINDING", "atlas")
    assert small.memory.total == before


def test_idle_staging_makes_room(small):
    source = small.buffer("source", 1 << 18, "COPY_SRC", "lod")
    small.read_buffer(source).result()
    assert small.memory.by_category()["readback"] >= 1 << 18
    rest = small.memory.free
    assert small.buffer("large", rest + (1 << 17), "STORAGE", "lod").size == rest + (1 << 17)


def test_resources_from_threads(small):
    before = small.memory.total

    def work(seed: int) -> None:
        values = np.full(256, seed, np.uint32)
        for _ in range(10):
            buffer = small.buffer(f"b{seed}", values, "COPY_SRC", "lod")
            assert (small.read_buffer(buffer, dtype=np.uint32).result() == seed).all()
            buffer.destroy()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    small._staging.trim()
    assert small.memory.total == before


def test_close_releases_everything():
    opened = open_gpu()
    kept = [opened.buffer("b", 64, "STORAGE", "lod"), opened.texture("t", (4, 4), "r8unorm", "COPY_DST", "lod")]
    opened.read_buffer(opened.buffer("c", 64, "COPY_SRC", "lod")).result()
    opened.close()
    assert opened.memory.total == 0
    assert len(kept) == 2
