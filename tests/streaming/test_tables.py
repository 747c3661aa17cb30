"""The clipped quadtree against a plain walk up the tree: best node, wrapping, bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from orogen.grid import Grid
from orogen.keys import NodeKey, level_count
from orogen.streaming.requests import LayerGrid
from orogen.streaming.tables import build_tables, origins_around, table_bits

NO_SLOT = 0xFFFF


@dataclass
class Resident:
    """A layer with random nodes resident."""

    grid: LayerGrid
    current: dict[NodeKey, int]
    slots: NDArray[np.float32]
    is_height: bool = True
    ranges: dict[NodeKey, tuple[float, float]] = field(default_factory=dict)

    def bounds(self, level: int, rows: NDArray, cols: NDArray) -> tuple[NDArray, NDArray]:
        found = np.array(
            [
                self.ranges.get(NodeKey(level, int(x), int(y)), (0.0, 0.0))
                for y, x in zip(rows.flat, cols.flat, strict=True)
            ]
        )
        return found[:, 0].reshape(rows.shape), found[:, 1].reshape(rows.shape)


def layer(seed: int, shape: tuple[int, int], share: float, node_size: int = 256) -> Resident:
    """`share` of the nodes is resident, the coarsest one among them."""
    rng = np.random.default_rng(seed)
    grid = LayerGrid(Grid(shape[1], shape[0], (2.0, 0, 0, 0, -2.0, 0)), level_count(shape), node_size)
    keys = [
        NodeKey(level, x, y)
        for level in range(grid.level_count)
        for y in range(grid.nodes(level)[0])
        for x in range(grid.nodes(level)[1])
    ]
    current = {
        key: int(slot)
        for key, slot in zip(keys, rng.permutation(len(keys)), strict=True)
        if rng.random() < share or key.level == grid.level_count - 1
    }
    ranges = {key: (float(low), float(low + 10)) for key, low in zip(keys, rng.normal(0, 100, len(keys)), strict=True)}
    slots = np.zeros((len(keys), 4), np.float32)
    slots[:, 0] = rng.normal(0, 100, len(keys))
    slots[:, 1] = slots[:, 0] + 7
    return Resident(grid, current, slots, True, ranges)


def best(resident: Resident, key: NodeKey) -> NodeKey:
    while key not in resident.current:
        key = key.parent
    return key


def check(resident: Resident, bits: int, origins: list[tuple[int, int]]) -> None:
    """Every entry of every level that stands for a node of the data."""
    fake: Any = resident
    table, bounds = build_tables(fake, bits, origins)
    side = 1 << bits
    assert table.shape == (resident.grid.level_count, side, side)
    for level, (y0, x0) in enumerate(origins):
        rows, cols = resident.grid.nodes(level)
        for y in range(y0, min(y0 + side, rows)):
            for x in range(x0, min(x0 + side, cols)):
                node = best(resident, NodeKey(level, x, y))
                slot = resident.current[node]
                assert table[level, y % side, x % side] == slot | node.level << 16
                low, high = resident.ranges[NodeKey(level, x, y)]
                drawn = resident.slots[slot]
                expected = [min(low, drawn[0]), max(high, drawn[1])]
                np.testing.assert_allclose(bounds[level, y % side, x % side], expected, rtol=1e-6)


SHAPES = [(5000, 9000), (200, 200), (300, 6000), (9000, 257)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_every_entry_is_the_best_node_that_is_resident(shape: tuple[int, int], share: float) -> None:
    resident = layer(1, shape, share)
    rng = np.random.default_rng(2)
    for load in (0.0, 1.5, 4.0):
        bits = table_bits(resident.grid, load)
        for _ in range(3):
            eye = rng.uniform(-1, 2, 2) * shape[::-1]
            check(resident, bits, origins_around(resident.grid, bits, eye))


def test_entries_stay_right_while_the_camera_moves() -> None:
    resident = layer(3, (7000, 7000), 0.5)
    bits = table_bits(resident.grid, 1.0)
    assert 1 << bits < resident.grid.nodes(0)[0]
    for way in np.linspace(0, 1, 12):
        check(resident, bits, origins_around(resident.grid, bits, np.array([-500 + 8000 * way, 7000 * way**2])))


@pytest.mark.parametrize("node_size", [512, 1024])
def test_larger_nodes(node_size: int) -> None:
    resident = layer(4, (5000, 9000), 0.5, node_size)
    bits = table_bits(resident.grid, 1.0)
    check(resident, bits, origins_around(resident.grid, bits, np.array([4000.0, 3000.0])))


def test_without_a_node_there_is_no_slot() -> None:
    resident = layer(5, (3000, 3000), 0.0)
    resident.current.clear()
    fake: Any = resident
    table, _ = build_tables(fake, 3, origins_around(resident.grid, 3, np.array([0.0, 0.0])))
    assert (table == (NO_SLOT | (resident.grid.level_count - 1) << 16)).all()


def test_colours_have_no_bounds() -> None:
    resident = layer(6, (3000, 3000), 0.5)
    resident.is_height = False
    fake: Any = resident
    table, bounds = build_tables(fake, 3, origins_around(resident.grid, 3, np.array([0.0, 0.0])))
    assert table.shape == (5, 8, 8)
    assert bounds.size == 0


@pytest.mark.parametrize("texel", [(2.0, -2.0), (9.0, -1.0), (0.5, -7.0)])
@pytest.mark.parametrize("load", [0.3, 1.0, 5.0, 7.5])
def test_windows_hold_the_nodes_within_the_load_distance(texel: tuple[float, float], load: float) -> None:
    grid = LayerGrid(Grid(60_000, 50_000, (texel[0], 0, 0, 0, texel[1], 0)), 9, 256)
    bits = table_bits(grid, load)
    rng = np.random.default_rng(7)
    angle = np.linspace(0, 2 * np.pi, 60)
    for _ in range(20):
        eye = rng.uniform(-0.1, 1.1, 2) * [60_000, 50_000]
        for level, (y0, x0) in enumerate(origins_around(grid, bits, eye)):
            reach = load * 256 * grid.grid.spacing * 2**level
            rim = eye + reach * np.stack([np.cos(angle) / texel[0], np.sin(angle) / -texel[1]], axis=-1)
            rim = np.clip(rim, 0, [59_999, 49_999])
            x, y = (rim // (256 << level)).astype(int).T
            side = 1 << bits
            assert ((x >= x0) & (x < x0 + side) & (y >= y0) & (y < y0 + side)).all()
    # and no more of them than needed
    assert bits == 0 or 1 << bits - 1 < max(2 * load * grid.stretch + 8, 16)


def test_a_window_is_no_larger_than_the_terrain() -> None:
    grid = LayerGrid(Grid(1500, 700, (1.0, 0, 0, 0, -1.0, 0)), 4, 256)
    assert table_bits(grid, 1e6) == 3
    assert origins_around(grid, 3, np.array([1e12, -1e12])) == [(0, 0)] * 4
    assert grid.nodes(0) == (3, 6)
