"""The endless terrain: the same whatever the window and the machine, and never outside the bounds that it gives."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from orogen.errors import OrogenError, SourceError
from orogen.keys import level_count, level_shape
from orogen.source import open_height, relief
from orogen.source.procedural import LARGEST, ProceduralLevels, ProceduralSettings, ProceduralSource

LEVELS = ProceduralSource().levels


def window(row: int, col: int, rows: int, cols: int) -> tuple[slice, slice]:
    return slice(row, row + rows), slice(col, col + cols)


def means(heights: NDArray[np.floating], steps: int) -> NDArray[np.float64]:
    """Means of 2^steps x 2^steps samples, in float64."""
    side = 1 << steps
    rows, cols = heights.shape
    return heights.astype(np.float64).reshape(rows // side, side, cols // side, side).mean(axis=(1, 3))


def bilinear(samples: NDArray[np.floating], u: NDArray[np.floating], v: NDArray[np.floating]) -> NDArray[np.float64]:
    """The surface between samples' centres at (row, column) positions counted from the first centre."""
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    s, (fu, fv) = samples.astype(np.float64), (u - i, v - j)
    near = s[i, j] * (1 - fv) + s[i, j + 1] * fv
    return near * (1 - fu) + (s[i + 1, j] * (1 - fv) + s[i + 1, j + 1] * fv) * fu


# What it is


def test_it_is_opened_by_name_with_settings() -> None:
    source = open_height("procedural:size=65536,seed=3")
    assert source.grid.shape == (65536, 65536)
    assert source.grid.spacing == 1.0
    assert source.kind == "height"
    assert source.covered
    assert source.direct
    assert source.fingerprint != open_height("procedural:size=65536,seed=4").fingerprint
    assert open_height("procedural").grid.shape == (LARGEST, LARGEST)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("procedural:size=1", "expected 2 to"),
        (f"procedural:size={LARGEST + 1}", "expected 2 to"),
        ("procedural:seed=-1", "expected 0 to"),
        ("procedural:seed", "expected settings such as"),
        ("procedural:sed=3", "did you mean seed"),
        ("procedural:size=big", "expected int"),
    ],
)
def test_wrong_settings_are_told(name: str, message: str) -> None:
    with pytest.raises(OrogenError, match=message):
        open_height(name)


def test_windows_outside_are_refused() -> None:
    with pytest.raises(SourceError, match="expected rows within"):
        ProceduralSource(ProceduralSettings(1000)).read(slice(0, 1001), slice(0, 10))
    with pytest.raises(SourceError, match="expected columns within"):
        LEVELS.read(14, slice(0, 10), slice(250, 257))


def test_overviews_are_samples_of_a_level() -> None:
    source = ProceduralSource(ProceduralSettings(3000))
    level = source.levels.read(2, slice(0, 750), slice(0, 750))
    np.testing.assert_array_equal(source.overview((750, 750)), level)
    assert source.overview((500, 400)).shape == (500, 400)


# The same whatever the window


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 14), st.integers(0, LARGEST - 1), st.integers(0, LARGEST - 1),
    st.integers(1, 80), st.integers(1, 80), st.randoms(use_true_random=False),
)  # fmt: skip
def test_windows_agree_with_each_other(level: int, row: int, col: int, rows: int, cols: int, random: object) -> None:
    count = LARGEST >> level
    rows, cols = min(rows, count), min(cols, count)
    row, col = min(row, count - rows), min(col, count - cols)
    whole = LEVELS.read(level, *window(row, col, rows, cols))
    r, c = (random.randrange(n) for n in (rows, cols))  # type: ignore[attr-defined]
    h, w = random.randrange(1, rows - r + 1), random.randrange(1, cols - c + 1)  # type: ignore[attr-defined]
    part = LEVELS.read(level, *window(row + r, col + c, h, w))
    np.testing.assert_array_equal(part, whole[r : r + h, c : c + w])


def test_long_lines_agree_with_blocks() -> None:
    line = LEVELS.read(0, *window(70_001, 1_000_000, 1, 5000))
    block = LEVELS.read(0, *window(70_000, 1_003_000, 3, 100))
    np.testing.assert_array_equal(line[0, 3000:3100], block[1])


def test_smaller_terrains_are_parts_of_larger_ones() -> None:
    small = ProceduralLevels((5000, 5000), 7)
    np.testing.assert_array_equal(small.read(3, *window(0, 500, 100, 125)), LEVELS.read(3, *window(0, 500, 100, 125)))


# The same on every machine


def scalar_noise(level: int, seed: int, row: int, col: int) -> float:
    """Gradient noise at a sample, with Python's integers and floats only."""
    mask = 0xFFFFFFFF

    def mixed(h: int) -> int:
        h ^= h >> 16
        h = h * 0x85EBCA6B & mask
        h ^= h >> 13
        h = h * 0xC2B2AE35 & mask
        return h ^ h >> 16

    key = mixed(seed * 0x9E3779B1 + level * 0x85EBCA77 & mask)
    a, b, c = ((4, 3, 5), (5, 12, 13), (15, 8, 17), (7, 24, 25), (21, 20, 29))[level % 5]
    x, y = (col + 0.5) / 4, (row + 0.5) / 4
    u, v = (x * a - y * b) / c + (key & 0xFFFF), (x * b + y * a) / c + (key >> 16)
    i, j = int(u // 1), int(v // 1)
    fu, fv = u - i, v - j
    corners = []
    for dj in (0, 1):
        for di in (0, 1):
            h = mixed((i + di) * 0x9E3779B1 + (j + dj) * 0x85EBCA77 + key & mask)
            gx, gy = (h & 0xFFFF) / 32768 - 1, (h >> 16) / 32768 - 1
            corners.append(gx * (fu - di) + gy * (fv - dj))
    su, sv = (t**3 * (6 * t * t - 15 * t + 10) for t in (fu, fv))
    upper = corners[0] + su * (corners[1] - corners[0])
    lower = corners[2] + su * (corners[3] - corners[2])
    return upper + sv * (lower - upper)


@pytest.mark.parametrize(
    ("level", "row", "col"), [(0, 0, 0), (0, 4_000_001, 3_999_999), (5, -70, 90_000), (13, 3, 500)]
)
def test_noise_is_what_plain_arithmetic_gives(level: int, row: int, col: int) -> None:
    found = relief._noise(level, 7, row, row + 8, col, col + 8)
    expected = [[scalar_noise(level, 7, row + r, col + c) for c in range(8)] for r in range(8)]
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert np.abs(found).max() <= 1


SAMPLED = """
import hashlib
from orogen.source.procedural import ProceduralSource
levels, digest = ProceduralSource().levels, hashlib.sha256()
for level, row, col in ((0, 3_000_000, 77), (0, 250_001, 4_000_000), (6, 40_000, 3_003), (12, 100, 900)):
    digest.update(levels.read(level, slice(row, row + 70), slice(col, col + 121)).astype("<f4").tobytes())
print(digest.hexdigest())
"""


def test_processors_with_other_instructions_give_the_same_bits() -> None:
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    found = hashlib.sha256()
    for level, row, col in ((0, 3_000_000, 77), (0, 250_001, 4_000_000), (6, 40_000, 3_003), (12, 100, 900)):
        found.update(LEVELS.read(level, *window(row, col, 70, 121)).astype("<f4").tobytes())
    off = " ".join(name for name in __cpu_dispatch__ if __cpu_features__.get(name))
    environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": off}
    done = subprocess.run(
        [sys.executable, "-c", SAMPLED], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == found.hexdigest()


# What it looks like


def test_there_is_relief_at_every_scale_and_it_is_not_repeated() -> None:
    # the highest ground of the overview
    overview = LEVELS.read(12, slice(0, 1024), slice(0, 1024))
    row, col = (int(n) for n in np.unravel_index(overview.argmax(), overview.shape))
    assert overview.max() > 3000
    assert np.percentile(overview, 20) < 300
    for level in range(12):
        fine = LEVELS.read(level, *window(row << 12 - level, col << 12 - level, 64, 64)).astype(np.float64)
        rough = (fine[:, 1:] - fine[:, :-1]).std() / 2**level
        assert 0.01 < rough < 1, level
    plain = LEVELS.read(0, *window(row << 12, col << 12, 128, 128)).astype(np.float64)
    for step in (1 << 10, 1 << 16, 1 << 18):
        other = LEVELS.read(0, *window((row << 12) - step, (col << 12) - step, 128, 128)).astype(np.float64)
        detail = [2 * part[1:-1] - part[:-2] - part[2:] for part in (plain, other)]
        assert abs(np.corrcoef(detail[0].ravel(), detail[1].ravel())[0, 1]) < 0.1, step


# Levels and bounds


@pytest.mark.parametrize(("row", "col"), [(213, 939), (500, 500), (1023, 0)])
def test_levels_are_as_close_to_means_as_they_say(row: int, col: int) -> None:
    """`row`, `col`: samples of level 12."""
    side = 256
    fine = LEVELS.read(0, *window(row << 12, col << 12, side, side))
    for level in range(1, 6):
        own = LEVELS.read(level, *window(row << 12 - level, col << 12 - level, side >> level, side >> level))
        apart = np.abs(means(fine, level) - own).max()
        assert 0 < apart <= relief.level_error(level), level


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 7), st.integers(0, 2**31), st.integers(0, 2**31))
def test_surfaces_of_levels_are_as_close_as_they_say(level: int, row: int, col: int) -> None:
    count = LARGEST >> level
    row, col = row % (count - 6), col % (count - 6)
    coarse = LEVELS.read(level, *window(row, col, 6, 6))
    # the fine samples under the coarse cell in the middle and a little more
    start, side = (row + 2 << level, col + 2 << level), 2 << level
    fine = LEVELS.read(0, *window(*start, side, side))
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, side - 1.001, (2, 2000))
    down, right = ((n + 0.5) / 2**level + 2 - 0.5 for n in (u, v))
    apart = np.abs(bilinear(fine, u, v) - bilinear(coarse, down, right))
    bound = LEVELS.node_bounds(level, slice(0, 1), slice(0, 1))[0, 0, 2]
    assert apart.max() <= bound


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 14), st.integers(0, 2**31), st.integers(0, 2**31), st.integers(0, 2**31), st.integers(0, 2**31))
def test_no_sample_is_outside_the_bounds(level: int, row: int, col: int, down: int, right: int) -> None:
    nodes = max(1, LARGEST >> level + 8)
    row, col = row % nodes, col % nodes
    low, high, error = LEVELS.node_bounds(level, slice(row, row + 1), slice(col, col + 1))[0, 0]
    assert np.isfinite([low, high, error]).all()
    # samples of level 0 and of the level itself, somewhere under the node
    for finer in {0, level}:
        side = 256 << level - finer
        r, c = row * side + down % (side - 63), col * side + right % (side - 63)
        heights = LEVELS.read(finer, *window(r, c, 64, 64))
        assert low <= heights.min()
        assert heights.max() <= high


def test_bounds_are_not_much_wider_than_the_ground() -> None:
    bounds = LEVELS.node_bounds(0, slice(3000, 3008), slice(3000, 3008))
    heights = LEVELS.read(0, *window(3000 * 256, 3000 * 256, 2048, 2048)).reshape(8, 256, 8, 256)
    tight = heights.max(axis=(1, 3)) - heights.min(axis=(1, 3))
    assert (bounds[..., 1] - bounds[..., 0] < 3 * tight + 30).all()


def test_bounds_do_not_depend_on_the_window() -> None:
    whole = LEVELS.node_bounds(2, slice(100, 120), slice(40, 60))
    np.testing.assert_array_equal(LEVELS.node_bounds(2, slice(107, 109), slice(41, 59)), whole[7:9, 1:19])


def test_the_range_holds_everything() -> None:
    levels = ProceduralLevels((4096, 4096), 11)
    low, high = levels.height_range
    heights = levels.read(0, slice(0, 2048), slice(1000, 3048))
    assert low <= heights.min() < heights.max() <= high
    count = level_count((4096, 4096))
    assert levels.read(count - 1, *(slice(0, n) for n in level_shape((4096, 4096), count - 1))).shape == (256, 256)
