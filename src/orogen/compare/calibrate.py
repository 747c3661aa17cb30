"""Set an algorithm's detail so that it takes as many triangles, or as much time, as asked for."""

from __future__ import annotations

import dataclasses
import logging
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orogen.compare.flights import Shot
from orogen.compare.plan import Entry
from orogen.compare.reference import frame_of, style_of
from orogen.compare.scenery import Scenery
from orogen.errors import BudgetError
from orogen.lod.contract import AlgorithmView, Detail
from orogen.shading.style import Style
from orogen.view.renderer import Renderer

log = logging.getLogger("orogen")

SHOTS = 5
"""Frames of the flight, evenly over it, whose mean is made to fit."""
STEPS = 12
"""Values that are tried at most."""
ABOUT = 1.25
"""Factor within which a target counts as reached."""
CLOSE = 0.005
"""Relative difference from the target at which the search ends."""


@dataclass(frozen=True)
class Calibrated:
    """What was found."""

    setting: str
    """Name of the setting."""
    value: float
    """Its value that comes nearest to the target."""
    target: float
    """What was asked for: triangles, or milliseconds."""
    reached: float
    """What the value gives on average over the sample frames."""

    @property
    def met(self) -> bool:
        """Whether that is about what was asked for."""
        return 1 / ABOUT < self.reached / self.target < ABOUT


def calibrate(entry: Entry, scenery: Scenery, shots: Sequence[Shot]) -> tuple[Entry, Calibrated | None]:
    """The entry with its detail set as the plan asks for, and what was found; unchanged without such a setting.

    `shots`: the frames that are measured; some of them are tried.
    """
    plan, detail = scenery.plan, entry.detail
    equal_triangles = plan.equal_triangles if entry.target is None else entry.target.triangles
    target = equal_triangles or plan.equal_time
    # entries that the numbers of triangles do not multiply have no detail
    if detail is None or target is None or isinstance(target, tuple):
        return entry, None
    step = (len(shots) - 1) / max(1, min(SHOTS, len(shots)) - 1)
    tried = [shots[round(i * step)] for i in range(min(SHOTS, len(shots)))]
    whole = isinstance(entry.values()[detail.setting], int)
    renderer = scenery.renderer(entry)
    try:

        def cost(value: float) -> float:
            measure = triangles if equal_triangles else milliseconds
            try:
                renderer.use(entry.algorithm, entry.with_setting(detail.setting, value).settings)
                return statistics.mean(measure(renderer, scenery, shot) for shot in tried)
            except BudgetError as error:
                # too fine for the memory that there is: a coarser value will have to do
                log.info("%s: %s=%g: %s", entry.label, detail.setting, value, error)
                return math.inf

        value, reached = search(detail, cost, float(target), whole)
    finally:
        renderer.close()
    found = Calibrated(detail.setting, value, float(target), reached)
    if not found.met:
        log.warning("%s: %s=%g comes nearest to %g, with %g", entry.label, detail.setting, value, target, reached)
    # the label stays: it says what was asked for
    return dataclasses.replace(entry.with_setting(detail.setting, value), label=entry.label), found


def search(detail: Detail, cost: Callable[[float], float], target: float, whole: bool) -> tuple[float, float]:
    """The value between `detail.finest` and `detail.coarsest` whose cost is nearest to the target, and that cost.

    Bisects on a logarithmic scale; the cost is to fall from the finest to the coarsest. `whole`: only whole numbers.
    """
    costs: dict[float, float] = {}

    def tried(place: float) -> float:
        value = math.exp(place)
        value = round(value) if whole else value
        if value not in costs:
            costs[value] = cost(value)
        return costs[value]

    ends = math.log(detail.finest), math.log(detail.coarsest)
    fine, coarse = ends
    for _ in range(STEPS - 1):
        middle = (fine + coarse) / 2
        reached = tried(middle)
        if abs(reached / target - 1) < CLOSE:
            break
        fine, coarse = (middle, coarse) if reached > target else (fine, middle)
    else:
        # the ends themselves last: the finest may cost more than all others together
        for place, end in zip((fine, coarse), ends, strict=True):
            if place == end:
                tried(end)
    best = min(costs, key=lambda value: abs(math.log(max(costs[value], 1e-9) / target)))
    return best, costs[best]


def triangles(renderer: Renderer, scenery: Scenery, shot: Shot) -> float:
    """Triangles that the renderer's algorithm takes for a frame; nothing is drawn unless it asks what was drawn."""
    state = renderer.algorithm.view()
    if type(state).drawn is not AlgorithmView.drawn:
        plan = scenery.plan
        flat = Style(color="plain", lit=False)
        return renderer.render(shot.camera, plan.size, flat, scenery.scene()).statistics.triangles
    view, clipmap, gpu, pages = renderer.view, renderer.clipmap, renderer.gpu, renderer.algorithm.pages
    frame = view.frame_for(frame_of(scenery, shot))
    view.want(frame)
    view.wishes[0] = list(dict.fromkeys([*view.wishes[0], *state.wants(frame)]))
    clipmap.settle()
    if pages:
        pages.settle()
    frame = view.frame_for(frame)
    view.update(frame)
    while True:
        encoder = gpu.encoder("count")
        state.record(encoder, renderer.timer, frame, view)
        renderer.timer.resolve(encoder)
        gpu.submit(encoder)
        if not state.incomplete():
            return state.statistics().triangles


def milliseconds(renderer: Renderer, scenery: Scenery, shot: Shot) -> float:
    """GPU time of all passes of a frame, the median of several; by the wall clock where timestamps are no good."""
    plan, gpu = scenery.plan, scenery.gpu
    style = style_of(plan.shown, shot)
    # timestamps of software drivers leave work out
    by_wall = "timestamp-query" not in gpu.features or gpu.info.kind == "cpu"
    spans, record_time = [], 0.0
    for _ in range(1 + plan.repeats):
        if not by_wall:
            renderer.keep_busy(record_time)
        start = time.perf_counter()
        picture = renderer.render(shot.camera, plan.size, style, scenery.scene())
        wall, record_time = 1000 * (time.perf_counter() - start), picture.record_time
        spans.append(wall if by_wall else sum(picture.gpu_times.values()))
    # the first one also loads
    return statistics.median(spans[1:])
