"""Recursive adaptive refinement of triangles by their edges; see README.md in this folder."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orogen.errors import BudgetError
from orogen.frame import Frame
from orogen.gpu import FrameTimer, Readback
from orogen.lod.contract import Algorithm, AlgorithmView, Detail, Draw, Module, Patches, Statistics
from orogen.lod.rag.budget import Pace, pass_name
from orogen.lod.rag.deciding import BLOCK, Coarse, block, deciding_frame
from orogen.lod.rag.settings import Settings
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView

FOLDER = Path(__file__).parent

_log = logging.getLogger("orogen")

_WATCHED = 8
"""Every so many frames the room that was needed is read back."""
_GROUP = 256
_TRIANGLE_BYTES = 40
_STATE = np.dtype([(name, "u4") for name in ("count", "half", "next", "drawn", "drawn_half", "needed")])


class View(AlgorithmView):
    """The triangles of one view."""

    def __init__(self, algorithm: Rag) -> None:
        self._algorithm = algorithm
        self._block = self._buffer("block", BLOCK.itemsize, "UNIFORM|COPY_DST")
        self._state = self._buffer("state", _STATE.itemsize, "STORAGE|COPY_SRC")
        self._dispatches = self._buffer("dispatches", 24, "STORAGE|INDIRECT")
        self._draw = self._buffer("draw", 16, "STORAGE|INDIRECT|COPY_SRC")
        self._written = b""
        self._pace = Pace()
        self._refined: Any = None
        self._done = 0
        self._frames = 0
        self._fits = True
        self._watch: Readback | None = None
        self._grow(max(algorithm.settings.triangle_capacity, algorithm.coarse.triangles))

    def _buffer(self, label: str, size: int, usage: str) -> Any:
        return self._algorithm.clipmap.gpu.buffer(f"rag {label}", size, usage, "rag")

    def _grow(self, triangles: int) -> None:
        """Make room for so many triangles, or for some more; what was refined is lost."""
        algorithm, gpu = self._algorithm, self._algorithm.clipmap.gpu
        capacity = max(_GROUP, 1 << (triangles - 1).bit_length())
        most = gpu.limits["max-storage-buffer-binding-size"] // (2 * _TRIANGLE_BYTES)
        most = min(most, _GROUP * gpu.limits["max-compute-workgroups-per-dimension"])
        if capacity > most:
            raise BudgetError(
                f"rag: expected room for at most {1 << (most.bit_length() - 1)} triangles, got {capacity}; raise "
                "threshold or lower depth"
            )
        lists = self._buffer("triangles", 2 * _TRIANGLE_BYTES * capacity, "STORAGE")
        plans = self._buffer("plans", 4 * capacity, "STORAGE")
        sums = self._buffer("sums", 4 * capacity // _GROUP, "STORAGE")
        table = self._buffer("table", 16 * capacity if algorithm.settings.variant != "oblique" else 4, "STORAGE")
        self._capacity, self._refined = capacity, None
        work = {0: self._block, 1: lists, 2: plans, 3: sums, 4: self._state, 5: table}
        prepare = {0: self._block, 1: self._state, 2: sums, 3: self._dispatches, 4: self._draw}
        self._work_group = gpu.bind("rag work", algorithm.work_layout, work)
        self._prepare_group = gpu.bind("rag prepare", algorithm.prepare_layout, prepare)
        self._vertex_group = gpu.bind(
            "rag vertices", algorithm.module.layout, {0: self._block, 1: lists, 2: self._state}
        )

    def record(self, encoder: Any, timer: FrameTimer, frame: Frame, view: ClipmapView) -> Sequence[Draw]:
        """Refine the coarse mesh, or what the frames before have made of it."""
        algorithm = self._algorithm
        self._keep_up()
        deciding = deciding_frame(frame)
        written = block(deciding, algorithm.settings, algorithm.coarse, self._capacity).tobytes()
        if written != self._written:
            self._written = written
            algorithm.clipmap.gpu.write(self._block, written)
        budget = algorithm.settings.time_budget if frame.time_budget is None else 1e3 * frame.time_budget
        refined = (deciding, algorithm.clipmap.heights.version) if budget is not None else None
        anew = budget is None or refined != self._refined
        self._refined, first = refined, 0 if anew else self._done
        self._pace.learn(timer.results() if budget is not None else {})
        last = algorithm.coarse.passes
        self._done = last if budget is None else first + self._pace.passes(first, last, budget)
        run = self._begin(timer, encoder, "refine" if budget is None else "coarse", view)
        if anew:
            self._dispatch(run, "place_coarse", -(-algorithm.coarse.triangles // 2 // _GROUP))
            self._prepare(run, "begin")
        for number in range(first, self._done):
            if budget is not None:
                run.end()
                run = self._begin(timer, encoder, pass_name(number), view)
            self._refine(run, number)
        self._prepare(run, "end")
        if algorithm.settings.variant == "right_angled":
            self._weld(run)
        run.end()
        self._frames += 1
        if self._watch is None and (self._frames % _WATCHED == 1 or not self._fits):
            self._watch = algorithm.clipmap.gpu.read_buffer(self._state, encoder=encoder)
        return [Patches(algorithm.module, self._vertex_group, self._draw, "triangle-list")]

    def _begin(self, timer: FrameTimer, encoder: Any, name: str, view: ClipmapView) -> Any:
        run = timer.compute_pass(encoder, name)
        run.set_bind_group(0, view.bind_group)
        return run

    def _refine(self, run: Any, number: int) -> None:
        """One pass: count what every triangle becomes, add up, write (section 4.2)."""
        self._dispatch(run, "decide")
        if self._algorithm.settings.variant == "conforming":
            self._dispatch(run, "clear_table")
            self._dispatch(run, "mark_edges")
            # a pass has triangles of 2 number + 1 sizes, and every step goes to a larger one
            for _ in range(2 * number + 1):
                self._dispatch(run, "spread_marks")
            self._dispatch(run, "count_conforming")
        else:
            self._dispatch(run, "count_children")
        self._prepare(run, "add_up")
        self._dispatch(run, "write_children", next_list=True)
        self._prepare(run, "turn")

    def _weld(self, run: Any) -> None:
        """Give the invisible vertices to the triangles on their other sides."""
        for entry in ("clear_table", "enter_vertices", "count_fans"):
            self._dispatch(run, entry)
        self._prepare(run, "add_up")
        self._dispatch(run, "write_fans", next_list=True)
        self._prepare(run, "end_weld")

    def _dispatch(self, run: Any, entry: str, groups: int | None = None, *, next_list: bool = False) -> None:
        """A thread per triangle of the list, unless `groups` says otherwise."""
        run.set_pipeline(self._algorithm.pipelines[entry])
        run.set_bind_group(1, self._work_group)
        if groups is None:
            run.dispatch_workgroups_indirect(self._dispatches.raw, 12 if next_list else 0)
        elif groups:
            run.dispatch_workgroups(groups)

    def _prepare(self, run: Any, entry: str) -> None:
        run.set_pipeline(self._algorithm.pipelines[entry])
        run.set_bind_group(1, self._prepare_group)
        run.dispatch_workgroups(1)

    def _keep_up(self) -> None:
        """Make room where an earlier frame is known to have lacked it, without waiting for the GPU."""
        if self._watch is None or not self._watch.ready():
            return
        needed, self._watch = int(self._watch.result().view(_STATE)[0]["needed"]), None
        self._fits = not needed
        if needed > self._capacity:
            try:
                self._grow(needed)
            except BudgetError as error:
                _log.debug("drawn coarser than asked for: %s", error)

    def _read_state(self) -> Any:
        return self._algorithm.clipmap.gpu.read_buffer(self._state).result().view(_STATE)[0]

    def statistics(self) -> Statistics:
        """The triangles of one draw."""
        return Statistics(triangles=int(self._read_state()["drawn"]), draws=1)

    def unfinished(self) -> bool:
        """Whether the time budget left passes for the next frame."""
        return self._done < self._algorithm.coarse.passes

    def incomplete(self) -> bool:
        """Whether triangles found no room, or passes no time; makes room. Raises BudgetError where there is none."""
        needed = int(self._read_state()["needed"])
        if needed > self._capacity:
            self._grow(needed)
            return True
        return self.unfinished()


class Rag(Algorithm):
    """Triangles split where their edges ask for it, again and again, on the GPU."""

    name = "rag"
    Settings = Settings
    detail = Detail("threshold", finest=0.05, coarsest=1000.0)

    def __init__(self, clipmap: Clipmap, settings: Any) -> None:
        super().__init__(clipmap, settings)
        gpu = clipmap.gpu
        self.coarse = Coarse.over(clipmap.grid, settings)
        uniform, storage, read = ("COMPUTE", "uniform"), ("COMPUTE", "storage"), ("COMPUTE", "read")
        self.work_layout = gpu.layout("rag work", {0: uniform, 1: storage, 2: storage, 3: storage, 4: read, 5: storage})
        self.prepare_layout = gpu.layout("rag prepare", {0: uniform, 1: storage, 2: storage, 3: storage, 4: storage})
        stages = "VERTEX|COMPUTE"
        constants = {**clipmap.constants, **constants_of(settings)}
        self.module = Module(
            FOLDER / "vertex.wgsl",
            gpu.layout("rag vertices", {0: (stages, "uniform"), 1: (stages, "read"), 2: (stages, "read")}),
            constants_of(settings),
        )
        files = {
            "decide": ["place_coarse", "decide"],
            "split": ["count_children", "write_children"],
            "prepare": ["begin", "add_up", "turn", "end", "end_weld"],
        }
        if settings.variant == "conforming":
            files["conform"] = ["clear_table", "mark_edges", "spread_marks", "count_conforming"]
        if settings.variant == "right_angled":
            files["weld"] = ["clear_table", "enter_vertices", "count_fans", "write_fans"]
        self.pipelines: dict[str, Any] = {}
        """By entry point."""
        for file, entries in files.items():
            shader = gpu.shader(f"rag {file}", FOLDER / f"{file}.wgsl", search=[FOLDER, *SEARCH], constants=constants)
            layout = self.prepare_layout if file == "prepare" else self.work_layout
            for entry in entries:
                self.pipelines[entry] = gpu.compute(f"rag {entry}", shader, entry, [clipmap.layout, layout])

    def view(self) -> View:
        """State for one more view."""
        return View(self)


def constants_of(settings: Settings) -> dict[str, int]:
    """What the shaders are compiled for."""
    return {
        "RIGHT_ANGLED": settings.variant == "right_angled",
        "MOVED": settings.move_to_worst,
        "SAMPLES": settings.edge_samples,
        "HEIGHT_DIFFERENCE": settings.measured == "height_difference",
        "OBJECT_ERROR": settings.measured == "object_error",
        "AREA": settings.measured == "area",
    }
