"""`orogen compare`: algorithms side by side, on the same data, flight and metrics."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Annotated, Any

from cyclopts import Parameter

from orogen.cli import console
from orogen.cli.options import DataOptions, SceneOptions, StyleOptions, settings_of
from orogen.cli.parameters import (
    Adapter,
    Data,
    Flag,
    FlightName,
    Json,
    Output,
    Overwrite,
    Size,
    Window,
    numbers,
    word,
)

Counts = Annotated[tuple[int, ...], word(numbers(None, ",", int), "N,N...")]
Words = Annotated[list[str] | None, Parameter(negative="", metavar="NAME")]


def compare(
    data: Data,
    /,
    *,
    output: Output,
    entry: Annotated[list[str] | None, Parameter(negative="", metavar="ENTRY")] = None,
    sweep: Annotated[list[str] | None, Parameter(negative="", metavar="SWEEP")] = None,
    equal_triangles: Counts | None = None,
    equal_time: float | None = None,
    flight: FlightName = "descent",
    frames: int | None = None,
    every: int | None = None,
    fps: float = 30.0,
    size: Size = (1600, 900),
    crop: Window | None = None,
    prelit: Flag = False,
    unlit: Flag = False,
    metric: Words = None,
    repeats: int = 3,
    pictures: int = 3,
    freeze: Flag = False,
    set: Annotated[list[str] | None, Parameter(negative="", metavar="KEY=VALUE")] = None,
    adapter: Adapter = None,
    scheduler: str | None = None,
    overwrite: Overwrite = False,
    json: Json = False,
    scene: SceneOptions | None = None,
    style: StyleOptions | None = None,
    options: DataOptions | None = None,
) -> None:
    """Compare algorithms and write a report; an interrupted comparison goes on where it stopped.

    Parameters
    ----------
    output
        Folder of the report, its tables and pictures.
    entry
        Who takes part, as [LABEL=]ALGORITHM[:KEY=VALUE,...]; repeat for several. [default: every algorithm]
    sweep
        Vary a setting, as NAME.KEY=VALUE,VALUE... where NAME is a label or an algorithm; repeat for several.
    equal_triangles
        Set every algorithm's detail so that it takes this many triangles a frame, on average; with several numbers
        every algorithm is measured at each of them.
    equal_time
        Set every algorithm's detail so that it takes this many milliseconds of GPU time a frame, on average.
    frames
        How many frames to measure, evenly over the flight. [default: 60]
    every
        Measure every so many frames instead; 1: all of them.
    fps
        Frames of the flight per second.
    size
        Width and height in pixels.
    crop
        Part of the data: first column and row, columns and rows.
    prelit
        Drape an image of the terrain that is lit once, and no other light: pictures differ by geometry alone.
    unlit
        No light, only the draped image or the ramp.
    metric
        Measure just this: psnr, ssim, flip, delta_e, shapes, surface, cracks or stability; repeat for several.
    repeats
        How often a frame is timed; medians count.
    pictures
        Of how many frames pictures are kept.
    freeze
        Keep pictures from a second camera too, while the flight's camera decides on the geometry.
    set
        Setting of the streaming, the same for all, such as memory=100000000; repeat for several.
    scheduler
        Address of a Dask scheduler whose workers measure the frames, such as tcp://host:8786; they must see the same
        files, and times are those of their machines. [default: this process measures them]
    """
    from orogen.compare.plan import Plan, parse_entry, parse_sweep
    from orogen.compare.report import targets
    from orogen.compare.report.results import read
    from orogen.compare.runner import run

    entries = [parse_entry(text) for text in entry or ()]
    for text in sweep or ():
        entries += parse_sweep(text, entries)
    before = scene or SceneOptions()
    look = (style or StyleOptions()).style()
    plan = Plan(
        data,
        tuple(entries),
        options=asdict(options or DataOptions()),
        crop=crop,
        flight=flight,
        size=size,
        fps=fps,
        frames=60 if frames is None and every is None else frames,
        every=every,
        style=replace(look, lit=not unlit),
        prelit=prelit,
        exaggeration=before.exaggeration,
        curvature=before.curvature,
        metrics=tuple(metric) if metric else None,
        repeats=repeats,
        pictures=pictures,
        freeze=freeze,
        equal_triangles=equal_triangles[0] if equal_triangles and len(equal_triangles) == 1 else equal_triangles,
        equal_time=equal_time,
        streaming=settings_of(set),
        adapter=adapter,
    )
    with console.progress() as report:
        written = run(plan, output, progress=report, force=overwrite, scheduler=scheduler)
    result: dict[str, Any] = {"report": written, "entries": [item.label for item in plan.entries]}
    lines = [str(written)]
    if equal_triangles:
        found = read(output)
        result["targets"] = targets.rows(found)
        lines = [*targets.text(found), *lines]
    console.show(result, json, lines)
