"""Run a comparison: true pictures first, then one entry after the other, frame by frame."""

from __future__ import annotations

import dataclasses
import gc
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orogen.compare import metrics
from orogen.compare.calibrate import calibrate
from orogen.compare.flights import Reel, Shot
from orogen.compare.machine import host_memory, machine
from orogen.compare.meta import meta_cameras
from orogen.compare.plan import Entry, Plan, plain
from orogen.compare.record import FORMAT, Record
from orogen.compare.reference import References, style_of
from orogen.compare.scenery import Progress, Scenery
from orogen.compare.spread import Collected, chunks, measure, packed, packed_entry
from orogen.compare.temporal import REACH, History
from orogen.compare.triangle_quality import TriangleMeter
from orogen.compare.truth import TrueSurface
from orogen.pyramid.workers import hired
from orogen.view.flight import Flight
from orogen.view.renderer import Picture, Renderer

NEEDS_TRUTH = {"surface", "stability"}
"""Metrics that read the true surface."""


def run(
    plan: Plan,
    folder: str | Path,
    progress: Progress | None = None,
    force: bool = False,
    scheduler: str | None = None,
) -> Path:
    """Run a comparison, or go on with an interrupted one, and write its report; gives the report's path.

    `folder`: where results go; a comparison of the same plan in it is resumed, another one only replaced with `force`.
    `progress`: called with the part done (0 to 1) and what is done. `scheduler`: address of a Dask scheduler whose
    workers measure the frames; times are then those of the workers' machines.

    Raises SettingsError for a plan that cannot be carried out, SourceError for the data, OutputError for the folder.
    """
    from orogen.compare import report as reports

    report = progress or (lambda fraction, text: None)
    folder = Path(folder)
    flight = Flight.load(plan.flight)
    chosen = metrics.available() if plan.metrics is None else frozenset(plan.metrics)
    asked = plain(
        {
            **plan.request(), "flight": dataclasses.asdict(flight), "metrics": sorted(chosen),
            "orogen": machine()["orogen"],
        }
    )  # fmt: skip
    if not force:
        # at once, before the data is read
        Record.check(folder, asked)
    with Scenery(plan, report) as scenery:
        reel = _reel(flight, plan, scenery)
        reel.check(plan.size, scenery.heights.height_range, scenery.height_at, plan.exaggeration, plan.curvature)
        numbers = reel.numbers(plan.frames, plan.every)
        shots = [reel.shot(number) for number in numbers]
        request = {**asked, "fingerprint": scenery.fingerprint, "adapter": str(scenery.gpu.info)}
        record, document = Record.open(folder, request, force)
        if document is None:
            document = _document(plan, scenery, reel, numbers, request)
            document["entries"] = _entries(scenery, shots, report)
            record.write_plan(document)
        entries = [
            Entry(kept["algorithm"], kept["settings"], kept["label"], (kept["sweep"] or {}).get("setting"))
            for kept in document["entries"]
        ]
        job = _Run(plan, scenery, reel, shots, record, document["pictures"], chosen, report)
        if scheduler is None:
            job.run(entries)
        else:
            job.spread(entries, scheduler)
    return reports.write(folder)


def measure_frames(
    plan: Plan, entry: Entry, numbers: Sequence[int], kept: Sequence[int], chosen: frozenset[str]
) -> Collected:
    """Measure some frames of one entry, and hand back what `run` would write down of them."""
    found = Collected()

    def silent(part: float, text: str) -> None:
        """Nobody is there to read it."""

    with Scenery(plan, silent) as scenery:
        reel = _reel(Flight.load(plan.flight), plan, scenery)
        shots = [reel.shot(number) for number in numbers]
        _Run(plan, scenery, reel, shots, found, kept, chosen, silent).run([entry])
    return found


def _reel(flight: Flight, plan: Plan, scenery: Scenery) -> Reel:
    path = flight.over(
        scenery.grid, scenery.heights.height_range, exaggeration=plan.exaggeration, height_at=scenery.height_at
    )
    return Reel(path, plan.fps)


def _document(plan: Plan, scenery: Scenery, reel: Reel, numbers: list[int], request: Any) -> dict[str, Any]:
    """What plan.json says, without the entries."""
    kept = sorted({numbers[int((i + 0.5) * len(numbers) / plan.pictures)] for i in range(plan.pictures)})
    flight = plain(dataclasses.asdict(reel.path.flight))
    rows, columns = scenery.grid.shape
    asked = {
        name: request[name]
        for name in (
            "data", "crop", "options", "size", "style", "prelit", "exaggeration", "curvature", "metrics", "repeats",
            "freeze", "equal_triangles", "equal_time", "streaming",
        )
    }  # fmt: skip
    return {
        "format": FORMAT,
        **asked,
        "grid": {
            "size": [columns, rows],
            "spacing": scenery.grid.spacing,
            "crs": scenery.grid.crs,
            "height_range": list(scenery.heights.height_range),
        },
        "flight": {
            **flight,
            "name": flight["name"] or Path(plan.flight).stem,
            "duration": reel.path.duration,
            "fps": reel.fps,
            "frames": len(numbers),
            "numbers": numbers,
            "cuts": list(reel.path.cuts),
        },
        "pictures": kept,
        "machine": machine(),
        "adapter": plain(scenery.gpu.describe()),
        "reference": {"algorithm": "raycast", "view_distance": "inf", "shading": "as the entries"},
        "request": request,
    }


def _entries(scenery: Scenery, shots: Sequence[Shot], report: Progress) -> list[dict[str, Any]]:
    """What plan.json says of the entries, their detail set as the plan asks for."""
    kept = []
    for number, given in enumerate(scenery.plan.entries, start=1):
        entry, found = calibrate(given, scenery, shots)
        values = plain(entry.values())
        kept.append(
            {
                "label": entry.label,
                "folder": entry.folder,
                "algorithm": entry.algorithm,
                "settings": values,
                "given": plain(given.settings),
                "sweep": entry.sweep and {"setting": entry.sweep, "value": values[entry.sweep]},
                "target": entry.target and dataclasses.asdict(entry.target),
                "calibrated": None if found is None else {**dataclasses.asdict(found), "met": found.met},
            }
        )
        report(number / len(scenery.plan.entries), "setting up the entries")
    return kept


class _Run:
    """What all entries share."""

    def __init__(
        self,
        plan: Plan,
        scenery: Scenery,
        reel: Reel,
        shots: Sequence[Shot],
        record: Record | Collected,
        kept: Sequence[int],
        chosen: frozenset[str],
        report: Progress,
    ) -> None:
        self._plan, self._scenery, self._reel, self._shots = plan, scenery, reel, shots
        self._record, self._kept, self._chosen, self._report = record, frozenset(kept), chosen, report
        self._truth: TrueSurface | None = None
        self._missing = self._finished = 0

    def run(self, entries: Sequence[Entry]) -> None:
        """Measure all entries, as far as they are not measured yet."""
        done = {entry.folder: frozenset(self._record.finished(entry.folder)) for entry in entries}
        self._missing = sum(len(self._shots) - len(numbers) for numbers in done.values())
        if not self._missing:
            return
        with References(self._scenery) as references:
            references.draw(self._shots, self._report)
            for shot in self._shots:
                if shot.number in self._kept:
                    self._record.picture("reference", shot.number, references.picture(shot).color)
            if self._chosen & NEEDS_TRUTH:
                self._truth = self._scenery.truth()
            for entry in entries:
                shots = [shot for shot in self._shots if shot.number not in done[entry.folder]]
                if shots:
                    self._measure(entry, shots, references)
                    # an algorithm may refer to itself; its memory must be free before that of the next is counted
                    gc.collect()

    def spread(self, entries: Sequence[Entry], scheduler: str) -> None:
        """The same on the workers of a cluster."""
        tasks: list[tuple[Any, ...]] = []
        for entry in entries:
            done = frozenset(self._record.finished(entry.folder))
            missing = [shot.number for shot in self._shots if shot.number not in done]
            tasks += [
                (packed(self._plan), packed_entry(entry), part, sorted(self._kept), self._chosen)
                for part in chunks(missing)
            ]
        with hired(scheduler) as workers:
            for number, found in enumerate(workers.in_order(measure, tasks), start=1):
                for picture in found.pictures:
                    self._record.picture(*picture)
                for name, line in found.lines:
                    self._record.add(name, line)
                self._report(number / len(tasks), "comparison")

    def _measure(self, entry: Entry, shots: Sequence[Shot], references: References) -> None:
        renderer = self._scenery.renderer(entry)
        try:
            one = _EntryRun(self, renderer, entry, references)
            for number, shot in enumerate(shots, start=1):
                one.frame(shot)
                self._report(number / len(shots), entry.label)
                self._finished += 1
                self._report(self._finished / self._missing, "comparison")
        finally:
            renderer.close()


class _EntryRun:
    """One entry at work."""

    def __init__(self, shared: _Run, renderer: Renderer, entry: Entry, references: References) -> None:
        self._shared, self._renderer, self._entry, self._references = shared, renderer, entry, references
        self._meter = TriangleMeter(renderer.clipmap)
        self._history = History()
        # numbers of the latest frames drawn one after the other
        self._followed: list[int] = []

    def frame(self, shot: Shot) -> None:
        """Draw, time and measure a frame, and write it down."""
        shared = self._shared
        self._lead_up(shot)
        picture = self._draw(shot)
        true = self._references.picture(shot)
        runs, walls = [picture], []
        for _ in range(shared._plan.repeats - 1):
            # after the frame before it: so moving the camera costs what it does in flight
            self._draw(shared._reel.shot(max(shot.number - 1, 0)))
            start = time.perf_counter()
            runs.append(self._draw(shot))
            walls.append(1000 * (time.perf_counter() - start))
        timed = runs
        if self._renderer.gpu.info.kind != "cpu":
            # apart from those for the wall clock, since it waits for the work that keeps the GPU's clock up
            timed = []
            for _ in range(shared._plan.repeats):
                self._draw(shared._reel.shot(max(shot.number - 1, 0)))
                self._renderer.keep_busy(runs[-1].record_time)
                timed.append(self._draw(shot))
        line: dict[str, Any] = {
            "frame": shot.number,
            "time": shot.time,
            **dataclasses.asdict(picture.statistics),
            "gpu": _medians(timed),
            "cpu": 1000 * statistics.median(run.record_time for run in runs),
            # the first time nodes are loaded too
            "wall": statistics.median(walls) if walls else None,
            "memory": {"gpu": self._renderer.gpu.memory.by_category(), "host": host_memory()},
            **metrics.measure_frame(picture, true, shared._truth, self._history, shared._chosen),
        }
        if "shapes" in shared._chosen:
            line |= self._meter.measure(self._renderer.draws, self._renderer.view).record()
        self._followed.append(shot.number)
        if shot.number in shared._kept:
            self._keep(shot, picture, true)
            # other cameras have drawn since: the next frame starts as after an interruption
            self._followed = []
        shared._record.add(self._entry.folder, line)

    def _lead_up(self, shot: Shot) -> None:
        """Draw the frames before, for what an algorithm carries over and for what stability is measured against."""
        reel = self._shared._reel
        if self._shared._truth is not None and "stability" in self._shared._chosen:
            before = reel.before(shot.number, REACH)
            if self._followed[-len(before) :] != before or not before:
                self._history, self._followed = History(), []
                for number in before:
                    self._history.add(self._draw(reel.shot(number)), self._shared._truth)
                    self._followed.append(number)
                if before:
                    return
        if self._followed[-1:] != [shot.number - 1]:
            self._draw(reel.shot(max(shot.number - 1, 0)))

    def _draw(self, shot: Shot) -> Picture:
        plan = self._shared._plan
        return self._renderer.render(shot.camera, plan.size, style_of(plan.shown, shot), self._shared._scenery.scene())

    def _keep(self, shot: Shot, picture: Picture, true: Picture) -> None:
        """Keep the pictures of a frame."""
        record, plan, scenery, name = (
            self._shared._record,
            self._shared._plan,
            self._shared._scenery,
            self._entry.folder,
        )
        record.picture(name, shot.number, picture.color)
        style = style_of(plan.shown, shot)
        lined = dataclasses.replace(style, overlays=("wireframe",))
        record.picture(
            name, shot.number, self._renderer.render(shot.camera, plan.size, lined, scenery.scene()).color, "wire"
        )
        if plan.freeze:
            frozen = scenery.scene(lod_camera=shot.camera)
            for where, camera in meta_cameras(true, scenery.height_at).items():
                seen = self._renderer.render(camera, plan.size, lined, frozen)
                record.picture(name, shot.number, seen.color, f"meta_{where}")


def _medians(runs: Sequence[Picture]) -> dict[str, float]:
    """Milliseconds per pass; {} where the adapter does not measure time."""
    passes = dict.fromkeys(name for run in runs for name in run.gpu_times)
    return {name: statistics.median(run.gpu_times.get(name, 0.0) for run in runs) for name in passes}
