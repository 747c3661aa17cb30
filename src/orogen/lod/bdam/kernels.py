"""Compiled loops over the triangles of patches: simplifying diamonds, measuring how far they are off.

Pages are those of pages.py. The interpreter holds no lock here, so that threads run side by side.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.lod.quadtree_kernels import compiled

Words = NDArray[np.uint32]

_DIAGONAL, _LOCKED = 16, 32
"""Flags of vertices beside those of the raster's four edges."""
_SHORT = 1e-8
"""Square metres that a collapse costs for each square sample of its length: of equal ones the shortest is the best."""


@compiled
def halve(
    pages: Words, starts: Any, origins: Any, half: int, odd: bool, ox: int, oy: int, edges: Any, most: int, chain: int,
    corners: Any,
) -> tuple[Words, Words]:  # fmt: skip
    """Merge the patches that a diamond is split into, and simplify them to two patches.

    pages, starts, origins: the pages one after another, their first words, their places (column, row) from the
    diamond's centre. half: of its extent. odd: it stands on a corner. ox, oy: from its centre to the right angle of its
    patch on side 1. edges: where the raster ends in the west, east, north and south of its centre. most:
    triangles of a patch. chain: segments of the hypotenuse. corners: (2, 2) places of the resulting pages.
    """
    x, y, z, t = _merged(pages, starts, origins)
    n, m = len(x), len(t)
    flags = np.zeros(n, np.int64)
    across = np.empty(n, np.int64)
    segments = -1
    for v in range(n):
        across[v] = ox * x[v] + oy * y[v]
        if (abs(x[v]) + abs(y[v]) if odd else max(abs(x[v]), abs(y[v]))) == half:
            flags[v] = _LOCKED
        for edge in range(4):
            if (x[v] if edge < 2 else y[v]) == edges[edge]:
                flags[v] |= 1 << edge
        if across[v] == 0:
            flags[v] |= _DIAGONAL
            segments += 1
    # -1: vanished
    side = np.zeros(m, np.int64)
    counts = np.zeros(2, np.int64)
    head = np.full(n, -1, np.int64)
    following = np.full(3 * m, -1, np.int64)
    quadrics = np.zeros((n, 10))
    for i in range(m):
        side[i] = 1 if across[t[i, 0]] + across[t[i, 1]] + across[t[i, 2]] > 0 else 0
        counts[side[i]] += 1
        for k in range(3):
            v = t[i, k]
            following[3 * i + k] = head[v]
            head[v] = 3 * i + k
        _add_plane(quadrics, t[i, 0], t[i, 1], t[i, 2], x, y, z)
    cost, target = np.full(n, np.inf), np.full(n, -1, np.int64)
    for v in range(n):
        _choose(v, cost, target, flags, quadrics, t, side, head, following, x, y, z)
    seen = np.full(n, -1, np.int64)
    for step in range(n):
        best, lowest = -1, np.inf
        for v in range(n):
            if cost[v] < lowest:
                if across[v] == 0:
                    wanted = counts[0] > most or counts[1] > most or segments > chain
                else:
                    wanted = counts[1 if across[v] > 0 else 0] > most
                if wanted:
                    best, lowest = v, cost[v]
        if best < 0:
            break
        into = target[best]
        _collapse(best, into, t, side, counts, head, following)
        for k in range(10):
            quadrics[into, k] += quadrics[best, k]
        cost[best] = np.inf
        if across[best] == 0:
            segments -= 1
        c = head[into]
        while c >= 0:
            if side[c // 3] >= 0:
                for k in range(3):
                    v = t[c // 3, k]
                    if seen[v] != step:
                        seen[v] = step
                        _choose(v, cost, target, flags, quadrics, t, side, head, following, x, y, z)
            c = following[c]
    return (
        _packed(corners[0], t, side, 0, x, y, z),
        _packed(corners[1], t, side, 1, x, y, z),
    )


@compiled
def _merged(pages: Words, starts: Any, origins: Any) -> Any:
    """Distinct vertices (x, y, z) and triangles, counterclockwise, of several pages."""
    floats = pages.view(np.float32)
    n, m = 0, 0
    for start in starts:
        m += pages[start]
        n += (pages[start + 1] - 2) // 3
    x, y, z = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.float64)
    t = np.empty((m, 3), np.int64)
    n, m = 0, 0
    for p in range(len(starts)):
        start = starts[p]
        first = np.int64(pages[start + 1])
        for i in range(np.int64(pages[start])):
            word = np.int64(pages[start + first + i])
            t[m, 0], t[m, 1], t[m, 2] = n + (word & 1023), n + (word >> 10 & 1023), n + (word >> 20)
            m += 1
        for at in range(start + 2, start + first, 3):
            x[n], y[n] = np.int64(pages[at]) + origins[p, 0], np.int64(pages[at + 1]) + origins[p, 1]
            z[n] = floats[at + 2]
            n += 1
    # the numbers of places that were seen before are found by a hash of them
    size = 1
    while size < 2 * n:
        size *= 2
    table, number = np.full(size, -1, np.int64), np.empty(n, np.int64)
    count = 0
    for v in range(n):
        slot = (x[v] * 73856093 ^ y[v] * 19349663) & (size - 1)
        while table[slot] >= 0 and (x[table[slot]] != x[v] or y[table[slot]] != y[v]):
            slot = (slot + 1) & (size - 1)
        if table[slot] < 0:
            table[slot] = count
            x[count], y[count], z[count] = x[v], y[v], z[v]
            count += 1
        number[v] = table[slot]
    for i in range(m):
        for k in range(3):
            t[i, k] = number[t[i, k]]
    return x[:count], y[:count], z[:count], t


@compiled
def _add_plane(quadrics: Any, i: int, j: int, k: int, x: Any, y: Any, z: Any) -> None:
    """Add the squared vertical distance to a triangle's plane, times twice its area, to its corners' quadrics."""
    x1, y1, z1 = x[j] - x[i], y[j] - y[i], z[j] - z[i]
    x2, y2, z2 = x[k] - x[i], y[k] - y[i], z[k] - z[i]
    w = float(x1 * y2 - x2 * y1)
    a, b = (z1 * y2 - z2 * y1) / w, (x1 * z2 - x2 * z1) / w
    c = z[i] - z[0] - a * x[i] - b * y[i]
    for v in (i, j, k):
        q = quadrics[v]
        q[0] += w
        q[1] += w * a
        q[2] += w * b
        q[3] += w * c
        q[4] += w * a * a
        q[5] += w * a * b
        q[6] += w * a * c
        q[7] += w * b * b
        q[8] += w * b * c
        q[9] += w * c * c


@compiled
def _distance(q: Any, x: int, y: int, z: float) -> float:
    """Weighted sum of squared vertical distances of a point to the planes of a quadric."""
    linear = q[1] * x + q[2] * y + q[3]
    square = q[4] * x * x + 2 * q[5] * x * y + 2 * q[6] * x + q[7] * y * y + 2 * q[8] * y + q[9]
    return max(0.0, q[0] * z * z - 2 * z * linear + square)


@compiled
def _choose(
    v: int, cost: Any, target: Any, flags: Any, quadrics: Any, t: Any, side: Any, head: Any, following: Any, x: Any,
    y: Any, z: Any,
) -> None:  # fmt: skip
    """Find the neighbour that a vertex is best moved to, and what that costs: infinite where there is none."""
    cost[v], target[v] = np.inf, -1
    if flags[v] & _LOCKED or head[v] < 0:
        return
    c = head[v]
    while c >= 0:
        i, k = c // 3, c % 3
        if side[i] >= 0:
            # around a vertex on a border some neighbour is a last corner only
            for turn in range(1, 3 if flags[v] else 2):
                u = t[i, (k + turn) % 3]
                # a vertex on a line stays on it
                if flags[v] & ~flags[u]:
                    continue
                length = (x[u] - x[v]) ** 2 + (y[u] - y[v]) ** 2
                height = z[u] - z[0]
                here = _distance(quadrics[v], x[u], y[u], height) + _distance(quadrics[u], x[u], y[u], height)
                here += _SHORT * length
                if here < cost[v] and _keeps_order(v, u, t, side, head, following, x, y):
                    cost[v], target[v] = here, u
        c = following[c]


@compiled
def _keeps_order(v: int, u: int, t: Any, side: Any, head: Any, following: Any, x: Any, y: Any) -> bool:
    """Whether no triangle is turned over or flattened when a vertex is moved to another."""
    c = head[v]
    while c >= 0:
        i, k = c // 3, c % 3
        if side[i] >= 0:
            a, b = t[i, (k + 1) % 3], t[i, (k + 2) % 3]
            if a != u and b != u and (x[a] - x[u]) * (y[b] - y[u]) <= (x[b] - x[u]) * (y[a] - y[u]):
                return False
        c = following[c]
    return True


@compiled
def _collapse(v: int, u: int, t: Any, side: Any, counts: Any, head: Any, following: Any) -> None:
    """Move a vertex to another; the triangles between them vanish."""
    c = head[v]
    head[v] = -1
    while c >= 0:
        i, k = c // 3, c % 3
        after = following[c]
        if side[i] >= 0:
            if t[i, (k + 1) % 3] == u or t[i, (k + 2) % 3] == u:
                counts[side[i]] -= 1
                side[i] = -1
            else:
                t[i, k] = u
                following[c] = head[u]
                head[u] = c
        c = after


@compiled
def _packed(corner: Any, t: Any, sides: Any, side: int, x: Any, y: Any, z: Any) -> Words:
    """The page of the triangles on a side."""
    number = np.full(len(x), -1, np.int64)
    count, triangles = 0, 0
    for i in range(len(t)):
        if sides[i] == side:
            triangles += 1
            for k in range(3):
                number[t[i, k]] = 0
    for v in range(len(x)):
        if number[v] == 0:
            number[v] = count
            count += 1
    page = np.empty(2 + 3 * count + triangles, np.uint32)
    floats = page.view(np.float32)
    page[0], page[1] = triangles, 2 + 3 * count
    for v in range(len(x)):
        if number[v] >= 0:
            at = 2 + 3 * number[v]
            page[at], page[at + 1] = x[v] - corner[0], y[v] - corner[1]
            floats[at + 2] = z[v]
    at = 2 + 3 * count
    for i in range(len(t)):
        if sides[i] == side:
            page[at] = number[t[i, 0]] | number[t[i, 1]] << 10 | number[t[i, 2]] << 20
            at += 1
    return page


@compiled
def deviation(page: Words, column: int, row: int, window: Any, counts: Any, left: int, top: int) -> float:
    """Metres between a page's triangles and the bilinear surface, at most, over the cells of a window.

    column, row: the page's place in samples. window: (rows, columns) heights whose first sample is (left, top).
    counts: the same shape, which samples are corners of true surface; empty: all of them.
    """
    floats = page.view(np.float32)
    first = np.int64(page[1])
    x, y, z = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3)
    rows, columns = window.shape
    every = counts.size == 0
    worst = 0.0
    for i in range(np.int64(page[0])):
        word = np.int64(page[first + i])
        for k in range(3):
            at = 2 + 3 * (word >> 10 * k & 1023)
            x[k], y[k] = np.int64(page[at]) + column - left, np.int64(page[at + 1]) + row - top
            z[k] = floats[at + 2]
        low, high = max(y.min(), 0), min(y.max(), rows - 1)
        if low > high or x.min() >= columns or x.max() < 0:
            continue
        x1, y1, x2, y2 = x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]
        w = float(x1 * y2 - x2 * y1)
        a = ((z[1] - z[0]) * y2 - (z[2] - z[0]) * y1) / w
        b = (x1 * (z[2] - z[0]) - x2 * (z[1] - z[0])) / w
        for v in range(low, high + 1):
            start, stop = np.inf, -np.inf
            for k in range(3):
                j = (k + 1) % 3
                if y[k] == v:
                    start, stop = min(start, x[k]), max(stop, x[k])
                if (y[k] < v) != (y[j] < v):
                    at_x = x[k] + (v - y[k]) * (x[j] - x[k]) / (y[j] - y[k])
                    start, stop = min(start, at_x), max(stop, at_x)
            if start > stop:
                continue
            for u in range(max(0, int(np.ceil(start - 1e-9))), min(columns - 1, int(np.floor(stop + 1e-9))) + 1):
                if every or counts[v, u]:
                    worst = max(worst, abs(z[0] + a * (u - x[0]) + b * (v - y[0]) - window[v, u]))
        for k in range(3):
            j = (k + 1) % 3
            # along samples the surface breaks at samples alone
            if x[k] != x[j] and y[k] != y[j]:
                worst = max(worst, _along(x[k], y[k], z[k], x[j], y[j], z[j], window, counts))
    return worst


@compiled
def _along(x0: int, y0: int, z0: float, x1: int, y1: int, z1: float, window: Any, counts: Any) -> float:
    """The same along a slanting edge: inside a cell the difference is a parabola."""
    rows, columns = window.shape
    dx, dy = x1 - x0, y1 - y0
    worst, at, steps_x, steps_y = 0.0, 0.0, 1, 1
    while at < 1.0:
        next_x, next_y = steps_x / abs(dx), steps_y / abs(dy)
        to = min(next_x, next_y)
        steps_x, steps_y = steps_x + (next_x <= to), steps_y + (next_y <= to)
        middle = (at + to) / 2
        u, v = int(np.floor(x0 + middle * dx)), int(np.floor(y0 + middle * dy))
        if (
            0 <= u < columns - 1
            and 0 <= v < rows - 1
            and (counts.size == 0 or (counts[v, u] and counts[v, u + 1] and counts[v + 1, u] and counts[v + 1, u + 1]))
        ):
            h00, h01 = float(window[v, u]), float(window[v, u + 1])
            h10, h11 = float(window[v + 1, u]), float(window[v + 1, u + 1])
            bend = h00 + h11 - h01 - h10
            fx, fy = x0 + at * dx - u, y0 + at * dy - v
            e0 = h00 + (h01 - h00) * fx + (h10 - h00) * fy + bend * fx * fy - (z0 + at * (z1 - z0))
            fx, fy = x0 + to * dx - u, y0 + to * dy - v
            e1 = h00 + (h01 - h00) * fx + (h10 - h00) * fy + bend * fx * fy - (z0 + to * (z1 - z0))
            worst = max(worst, abs(e0), abs(e1))
            bow = bend * dx * dy * (to - at) ** 2
            if bow != 0.0:
                s = 0.5 - (e1 - e0) / (2 * bow)
                if 0.0 < s < 1.0:
                    worst = max(worst, abs(e0 + (e1 - e0) * s - bow * s * (1 - s)))
        at = to
    return worst
