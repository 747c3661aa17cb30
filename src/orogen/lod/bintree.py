"""Meshes of triangle bintrees that are kept from frame to frame by two queues (Duchaineau et al. 1997).

A mesh of right-angled triangles covers the raster. Two that share their longest side are a diamond; splitting one makes
four of the two, and takes with it, first, what must be split so that every edge is shared as a whole. Splits and merges
are ordered by how far the ground may be from a triangle on screen; when neither queue has anything left to do, the mesh
is the same whatever it was before.
"""

from __future__ import annotations

import logging
import time
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orogen.errors import BudgetError
from orogen.frame import Frame
from orogen.gpu import Buffer, FrameTimer, Gpu
from orogen.lod.contract import AlgorithmView, Draw
from orogen.lod.wedgies import Wedgies
from orogen.streaming.clipmap_view import ClipmapView

NEAR_BY = 256
"""Triangles that may lie between two changed ones which are sent together."""
_OPERATIONS = 512
"""Splits and merges between two looks at the clock."""
_TURNS = 1 << 12
_ROOM = 1 << 13

_log = logging.getLogger("orogen")


class Bintree:
    """One mesh."""

    def __init__(self, wedgies: Wedgies) -> None:
        from orogen.lod import bintree_kernels as kernels

        self._kernels = kernels
        self.wedgies = wedgies
        rows, columns = (size - 1 << wedgies.bits for size in wedgies.heights.shape)
        self._ground = kernels.Ground(
            wedgies.heights, wedgies.thickness, wedgies.error, wedgies.within, wedgies.bits,
            wedgies.side << wedgies.bits, columns, rows, wedgies.ahead,
        )  # fmt: skip
        roots = (rows >> wedgies.bits) * (columns >> wedgies.bits) // wedgies.side**2
        self._mesh = self._empty(max(_ROOM, 4 * roots + 2 * kernels.MARGIN))
        self._eye: Any = None
        self._finished = False
        self.written = np.zeros(0, np.int64)
        """Places in the list of triangles that the latest call of `refine` has written, in order."""

    def _empty(self, room: int) -> Any:
        kernels = self._kernels
        return kernels.Mesh(
            place=np.zeros((room, 2), np.int64),
            state=np.zeros(room, np.uint8),
            parts=np.zeros(room, np.uint8),
            priority=np.zeros(room),
            rank=np.zeros(room, np.int64),
            known=np.zeros((room, 8)),
            slots=np.full((room, 2), -1, np.int32),
            free=np.zeros(room, np.int32),
            table=np.full(1 << (4 * room - 1).bit_length(), -1, np.int32),
            triangles=np.zeros((room, 4), np.int32),
            owner=np.zeros(room, np.int32),
            changed=np.zeros(room, bool),
            shift=np.zeros(room),
            shifts=np.zeros((room, 3), np.float32),
            splits=np.zeros(2 * room, kernels.ENTRY),
            merges=np.zeros(2 * room, kernels.ENTRY),
            counts=np.zeros(6, np.int64),
            tau=np.zeros(1),
        )

    @property
    def count(self) -> int:
        """Triangles."""
        return int(self._mesh.counts[self._kernels.TRIANGLES])

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(count, 4) middle (x, y) of the longest side and apex (x, y) of every triangle, in units of the lattice."""
        return self._mesh.triangles[: self.count]

    @property
    def shifts(self) -> NDArray[np.float32]:
        """(count, 3) metres of the data that the apex and the ends of every triangle are drawn over their places."""
        return self._mesh.shifts[: self.count]

    def refine(self, frame: Frame, tau: float, most: int, seconds: float | None = None, *, morph: float = 0.0) -> bool:
        """Bring the mesh closer to what a frame needs; whether it is what is asked for.

        `tau`: pixels that the ground may be from where it is drawn. `most`: triangles at most, but for those of the
        root squares. `seconds`: to spend on it at most; None: as long as it takes. Something is done in every call.
        `morph`: from where to (1 + morph) times there, in pixels above tau, vertices move into their places.
        """
        kernels, start = self._kernels, time.monotonic()
        eye = eye_of(frame, self.wedgies)
        asked = (_bytes(eye), tau, most, morph)
        self.written = np.zeros(0, np.int64)
        if asked == self._eye and self._finished:
            return True
        whole = bool(self._mesh.counts[kernels.WHOLE])
        if self._eye is None:
            self._mesh.tau[0] = tau
            kernels.root(self._mesh, self._ground, eye)
        if asked != self._eye:
            kernels.aim(self._mesh, self._ground, eye, tau, whole and self._is_short(most))
        self._eye, self._finished = asked, False
        # rounding must not let the queues trade the same triangles for ever
        for _ in range(_TURNS + most // _OPERATIONS):
            result = kernels.refine(self._mesh, self._ground, eye, most, _OPERATIONS)
            self._finished = result == kernels.DONE
            if result == kernels.CROWDED:
                self._grow()
            if result in (kernels.CROWDED, kernels.SHORT):
                whole = result == kernels.SHORT or bool(self._mesh.counts[kernels.WHOLE])
                kernels.aim(self._mesh, self._ground, eye, tau, whole)
            if self._finished or (seconds is not None and time.monotonic() - start > seconds):
                break
        else:
            _log.debug("bintree: the queues did not cross")
            self._finished = True
        if morph:
            kernels.morph(self._mesh, self._ground, eye, morph)
        changed = self._mesh.changed[: self.count]
        self.written = np.flatnonzero(changed)
        self._mesh.changed[:] = False
        return self._finished

    def _is_short(self, most: int) -> bool:
        """Whether there were hardly enough triangles in the frame before."""
        return self.count + self._kernels.MARGIN > most

    def _grow(self) -> None:
        old = self._mesh
        mesh = self._empty(2 * len(old.state))
        for name in set(mesh._fields) - {"table", "splits", "merges", "counts", "tau"}:
            getattr(mesh, name)[: len(old.state)] = getattr(old, name)
        mesh.counts[:], mesh.tau[:] = old.counts, old.tau
        self._kernels.rehash(mesh)
        self._mesh = mesh


def eye_of(frame: Frame, wedgies: Wedgies) -> Any:
    """What the kernels know of a frame's LOD camera."""
    from orogen.lod import bintree_kernels as kernels

    lod = frame.lod
    units = 2.0 ** (wedgies.bits - wedgies.level)
    if lod.orthographic:
        pixels = frame.lod_size[1] / lod.orthographic
    else:
        pixels = frame.pixels_per_radian(lod)
    # an orthographic camera's own place does not matter
    return kernels.Eye(
        origin=(frame.eye - 0.5) * units,
        metres=np.ascontiguousarray(frame.grid.metres / units),
        exaggeration=float(frame.exaggeration),
        height=float(frame.camera.z),
        curvature=float(frame.curvature_factor),
        position=np.ascontiguousarray(frame.lod_eye()),
        basis=np.ascontiguousarray(lod.basis),
        pixels=float(pixels),
        orthographic=bool(lod.orthographic),
        planes=np.ascontiguousarray(frame.planes()),
    )


def _bytes(eye: Any) -> bytes:
    return b"".join(np.asarray(value, np.float64).tobytes() for value in eye)


def runs(places: NDArray[np.int64], gap: int) -> Iterator[tuple[int, int]]:
    """First and past the last of places in order, together where no more than `gap` lie between."""
    if places.size:
        cuts = np.flatnonzero(np.diff(places) > gap)
        firsts, lasts = np.append(0, cuts + 1), np.append(cuts, places.size - 1)
        yield from zip(places[firsts].tolist(), (places[lasts] + 1).tolist(), strict=True)


class BintreeView(AlgorithmView):
    """A view's mesh, and its list of triangles on the GPU, of which only what has changed is sent."""

    def __init__(
        self,
        gpu: Gpu,
        name: str,
        wedgies: Wedgies,
        *,
        tau: float,
        most: int,
        milliseconds: float | None,
        morph: float = 0.0,
    ) -> None:
        """`tau`, `most`, `morph`: see `Bintree.refine`. `milliseconds`: CPU time a frame, at most; None: no limit."""
        self._gpu = gpu
        self._name = name
        self.bintree = Bintree(wedgies)
        self._asked = tau, most
        self._milliseconds = milliseconds
        self._morph = morph
        self._complete = True
        self._buffers: list[Buffer] = []
        self.sent = 0
        """Bytes of triangles sent to the GPU so far."""
        self._arguments = gpu.buffer(f"{name} draw", 20, "INDIRECT|STORAGE|COPY_SRC|COPY_DST", name)
        self._drawn = np.zeros(0, np.uint32)

    @abstractmethod
    def arguments(self, count: int) -> list[int]:
        """Arguments of the indirect draw for so many triangles of the bintree."""

    @abstractmethod
    def draw(self, buffers: Sequence[Buffer], arguments: Buffer) -> Draw:
        """The draw; `buffers`: (n, 4) i32 as `Bintree.triangles`, and (n, 3) f32 as `shifts` where there is a morph."""

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Refine the mesh on the CPU, and send what has changed."""
        budget = frame.time_budget
        if budget is None and self._milliseconds is not None:
            budget = self._milliseconds / 1000
        self._complete = self.bintree.refine(frame, *self._asked, budget, morph=self._morph)
        self._send()
        drawn = np.array(self.arguments(self.bintree.count), np.uint32)
        if not np.array_equal(drawn, self._drawn):
            self._drawn = drawn
            self._gpu.write(self._arguments, drawn)
        return [self.draw(self._buffers, self._arguments)]

    def _send(self) -> None:
        lists = [self.bintree.triangles, *([self.bintree.shifts] if self._morph else [])]
        parts = list(runs(self.bintree.written, NEAR_BY))
        if not self._buffers or self._buffers[0].size < lists[0].nbytes:
            room = 1 << max(12, (self.bintree.count - 1).bit_length())
            if 16 * room > self._gpu.limits["max-storage-buffer-binding-size"]:
                raise BudgetError(f"{self._name}: {self.bintree.count} triangles are too many for a buffer; raise tau")
            self._buffers = [
                self._gpu.buffer(f"{self._name} triangles", room * rows.strides[0], "STORAGE|COPY_DST", self._name)
                for rows in lists
            ]
            parts = [(0, self.bintree.count)]
        for buffer, rows in zip(self._buffers, lists, strict=True):
            for first, stop in parts:
                self._gpu.write(buffer, rows[first:stop], first * rows.strides[0])
                self.sent += rows[first:stop].nbytes

    def unfinished(self) -> bool:
        """Whether time ran out before the mesh was what was asked for; the next frame goes on."""
        return not self._complete

    def incomplete(self) -> bool:
        """The same: there always is room."""
        return self.unfinished()
