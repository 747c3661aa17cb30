"""Graphs of a report: values over the flight, quality against time with its front, sweeps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from orogen.compare.report.results import Comparison, Entry
from orogen.compare.report.svg import Axis, Plot, Point, Series, number, swatch
from orogen.compare.report.why import why

LEAST_ERROR = 1e-3
"""Pixels: what float32 depths resolve; smaller errors are drawn there."""
WIDE = 20.0
"""A range of values that spans a larger factor is drawn on a logarithmic axis."""


@dataclass(frozen=True)
class Quality:
    """What a chart shows."""

    name: str
    """Flat name."""
    title: str
    """In words."""
    label: str
    """Of the axis, with the unit."""
    larger: bool = False
    """Whether a larger value is better."""
    error: bool = False
    """Whether it is in pixels of error, from nothing to whole pictures: a logarithmic axis."""
    least: float = LEAST_ERROR
    """Of that axis."""
    statistic: str = "mean"
    """Statistic over the flight that stands for an entry."""

    @property
    def heading(self) -> str:
        """The words at the start of a title."""
        return self.title[0].upper() + self.title[1:]

    def of(self, entry: Entry) -> float | None:
        """The entry's value."""
        return entry.value(self.name, self.statistic)


GPU = Quality("gpu", "GPU time", "GPU time (ms)")
WALL = Quality("wall", "wall-clock time", "wall clock (ms)")
TRIANGLES = Quality("triangles", "Triangles", "triangles")
# an average over the frames that differ would punish an entry whose other frames are exact
PSNR = Quality("psnr", "PSNR", "PSNR (dB)", larger=True, statistic="pooled")
MEAN_ERROR = Quality("error.mean", "mean screen-space error", "mean error (px)", error=True)
ERROR = Quality("error.p99", "99 % screen-space error", "99 % error (px)", error=True)
CHANGE = Quality("instability_mean", "Instability", "mean change (px)", error=True)
POPPING = Quality("popping", "Popping", "share that jumps", error=True, least=1e-4)


def time_of(comparison: Comparison) -> Quality:
    """The time that entries are compared by."""
    return GPU if comparison.time == "gpu" else WALL


def on_front(comparison: Comparison, quality: Quality) -> frozenset[str]:
    """Labels of the entries that no other beats in mean time and in quality at once."""
    known = _known(comparison, quality)
    return frozenset(
        entry.label
        for entry, time, value in known
        if not any(
            other <= time and at_least_as_good(quality, rival, value) and (other < time or rival != value)
            for _, other, rival in known
        )
    )


def at_least_as_good(quality: Quality, value: float, other: float) -> bool:
    """Whether a value is no worse than another."""
    return value >= other if quality.larger else value <= other


def front_chart(comparison: Comparison, quality: Quality) -> str:
    """Quality against time; the best entries are filled and stand on a stair line, sweeps are curves."""
    clock = time_of(comparison)
    title = f"{quality.title} against {clock.title}, over the flight"
    known = _known(comparison, quality)
    if not known:
        return missing(title, comparison, [quality.name, clock.name])
    best = on_front(comparison, quality)
    x = Axis.over(clock.label, [time for _, time, _ in known], log=True)
    y = _axis(quality, [value for _, _, value in known])
    sweeps = {label for entries in comparison.sweeps.values() for label in (entry.label for entry in entries)}
    at_targets = _at_targets(comparison)
    # one name to a curve is enough
    names = {entries[-1].label: name for name, entries in at_targets.items()}
    points = [
        Point(
            names.get(entry.label, "") if entry.target else _short(entry), comparison.styles[entry.label], time, value,
            f"{entry.label}: {number(time)} ms, {number(value)} {'dB' if quality is PSNR else 'px'}",
            entry.label in best,
        )
        for entry, time, value in known
    ]  # fmt: skip
    curves = []
    for entries in [*comparison.sweeps.values(), *at_targets.values()]:
        line = [(time, value) for entry, time, value in known if entry in entries]
        name = entries[0].label
        curves.append(Series(name, comparison.styles[name], [t for t, _ in line], [v for _, v in line]))
    front = sorted((time, value) for entry, time, value in known if entry.label in best)
    right = 120 if sweeps != {entry.label for entry, _, _ in known} else 60
    plot = Plot(x, y, title, (540, 380), curves, points, front, right=right)
    words = "higher" if quality.larger else "lower"
    note = f"Left and {words} is better. Filled marks on the stair line: no other entry is both faster and better."
    if y.floor:
        note += f" Errors below {number(y.low)} px, what depths resolve, are drawn at that."
    return figure(title, plot.svg(), note)


def line_styles(comparison: Comparison, entries: Sequence[Entry]) -> dict[str, int]:
    """Number of the line style by label for lines over the flight: their own where entries share one otherwise."""
    styles = {entry.label: comparison.styles[entry.label] for entry in entries}
    distinct = len(set(styles.values())) == len(styles)
    return styles if distinct else {label: number for number, label in enumerate(styles)}


def flight_chart(comparison: Comparison, quality: Quality, entries: Sequence[Entry], over: str = "time") -> str:
    """A value over the flight, a line per entry; `over`: its "time" in seconds, or "frame", the number of the frame."""
    title = f"{quality.heading} over the flight"
    styles = line_styles(comparison, entries)
    series, lacking = [], []
    for entry in entries:
        values = entry.column(quality.name)
        places = [row.get(over) or 0.0 for row in entry.rows]
        if all(value is None for value in values):
            lacking.append(f"{entry.label}: {why(comparison, entry, quality.name)}")
        elif not (quality is TRIANGLES and not any(values)):
            series.append(Series(entry.label, styles[entry.label], places, values))
    if not series:
        return missing(title, comparison, [quality.name])
    places = [place for line in series for place in line.x]
    x = Axis("time (s)" if over == "time" else over, min(places), max(max(places), min(places) + 1e-3))
    y = _axis(quality, [value for line in series for value in line.y])
    marks = _picture_places(comparison, over)
    plot = Plot(x, y, title, (1080, 240), series, marks=[place for place in marks if x.low <= place <= x.high])
    return figure(title, plot.svg(), "; ".join(lacking))


def sweep_charts(comparison: Comparison, key: tuple[str, str]) -> str:
    """What a swept setting does: triangles, GPU time, PSNR and error against its value."""
    algorithm, setting = key
    entries = comparison.sweeps[key]
    values = [entry.sweep["value"] if entry.sweep else None for entry in entries]
    plots = []
    for quality in (TRIANGLES, time_of(comparison), PSNR, ERROR):
        title = f"{quality.heading} against {algorithm}.{setting}"
        found = [quality.of(entry) for entry in entries]
        if all(value is None for value in found):
            plots.append(missing(title, comparison, [quality.name]))
            continue
        numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
        at = [float(value) if numeric else float(n) for n, value in enumerate(values, start=1)]  # type: ignore[arg-type]
        spread = numeric and min(at) > 0 and max(at) / min(at) > 4
        names = "" if numeric else ": " + ", ".join(f"{n} = {value}" for n, value in enumerate(values, start=1))
        x = Axis.over(f"{setting}{names}", at, log=spread)
        line = Series(f"{algorithm}.{setting}", comparison.styles[entries[0].label], at, found, dots=True)
        plots.append(figure(title, Plot(x, _axis(quality, found), title, (540, 240), [line]).svg(), ""))
    return f'<div class="pair">{"".join(plots)}</div>'


def target_chart(comparison: Comparison, quality: Quality) -> str:
    """A value against the triangles that are drawn, a line per entry that is measured at several numbers of them."""
    title = f"{quality.heading} against triangles"
    series = []
    for name, entries in _at_targets(comparison).items():
        found = [(TRIANGLES.of(entry), quality.of(entry)) for entry in entries]
        points = sorted((drawn, value) for drawn, value in found if drawn and value is not None)
        style = comparison.styles[entries[0].label]
        series.append(Series(name, style, [drawn for drawn, _ in points], [value for _, value in points], dots=True))
    if not any(line.x for line in series):
        return missing(title, comparison, [quality.name])
    x = Axis.over(TRIANGLES.label, [drawn for line in series for drawn in line.x], log=True)
    y = _axis(quality, [value for line in series for value in line.y])
    return figure(title, Plot(x, y, title, (1080, 300), series).svg(), "")


def target_styles(comparison: Comparison) -> dict[str, int]:
    """Line styles of the entries that are measured at several numbers of triangles."""
    return {name: comparison.styles[entries[0].label] for name, entries in _at_targets(comparison).items()}


def angle_chart(comparison: Comparison) -> str:
    """Share of the triangles of the flight by their smallest angle, a line per entry."""
    title = "Triangles by their smallest angle"
    styles = line_styles(comparison, comparison.shown)
    series = []
    for entry in comparison.shown:
        names = sorted({name for row in entry.rows for name in row if name.startswith("angles.")})
        counts = [math.fsum(value or 0.0 for value in entry.column(name)) for name in names]
        if total := math.fsum(counts):
            starts = [float(name.removeprefix("angles.")) for name in names]
            half = (starts[1] - starts[0]) / 2
            shares = [100 * number / total for number in counts]
            series.append(Series(entry.label, styles[entry.label], [start + half for start in starts], shares))
    if not series:
        return missing(title, comparison, ["shapes.smallest_angle"])
    y = Axis.over("share (%)", [share for line in series for share in line.y], zero=True)
    plot = Plot(Axis("smallest angle (°)", 0.0, 60.0), y, title, (1080, 240), series)
    return figure(title, plot.svg(), "In steps of 5 degrees, degenerate triangles left out.")


def legend(styles: Mapping[str, int]) -> str:
    """Line styles by label."""
    items = "".join(
        f'<li data-series="{escape(label)}">{swatch(style)}{escape(label)}</li>' for label, style in styles.items()
    )
    return f'<ul class="legend">{items}</ul>'


def figure(title: str, content: str, note: str) -> str:
    """A graph with its title above and a note below."""
    below = f'<p class="notes">{escape(note)}</p>' if note else ""
    return f'<figure><figcaption>{escape(title)}</figcaption><div class="scroll">{content}</div>{below}</figure>'


def missing(title: str, comparison: Comparison, names: Sequence[str]) -> str:
    """In place of a graph: why there is none."""
    reasons = dict.fromkeys(
        why(comparison, entry, name) for entry in comparison.entries for name in names if entry.value(name) is None
    )
    text = "; ".join(reasons) or "there is no entry"
    return f'<figure><figcaption>{escape(title)}</figcaption><p class="notes">No graph: {escape(text)}.</p></figure>'


def _known(comparison: Comparison, quality: Quality) -> list[tuple[Entry, float, float]]:
    """Entries with their mean time and quality, where both are known."""
    clock = time_of(comparison)
    found = [(entry, clock.of(entry), quality.of(entry)) for entry in comparison.entries]
    return [(e, time, value) for e, time, value in found if time is not None and value is not None and time > 0]


def _axis(quality: Quality, values: Sequence[float | None]) -> Axis:
    finite = [value for value in values if value is not None and math.isfinite(value)]
    if not finite:
        return Axis.over(quality.label, [0.0, 1.0, *values])
    if quality.error:
        return Axis.over(quality.label, values, log=True, least=quality.least)
    positive = [value for value in finite if value > 0]
    wide = not quality.larger and len(positive) == len(finite) and max(positive) > WIDE * min(positive)
    return Axis.over(quality.label, values, log=wide, zero=not quality.larger)


def _short(entry: Entry) -> str:
    """Beside a point of a sweep only the value stands: its curve tells the rest."""
    if entry.sweep is None:
        return entry.label
    value = entry.sweep["value"]
    return number(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _at_targets(comparison: Comparison) -> dict[str, list[Entry]]:
    """Entries that are measured at several numbers of triangles, by the label that they share."""
    found: dict[str, list[Entry]] = {}
    for entry in comparison.entries:
        if entry.target:
            found.setdefault(str(entry.target["label"]), []).append(entry)
    return found


def _picture_places(comparison: Comparison, over: str) -> list[float]:
    chosen = set(comparison.plan.get("pictures") or ())
    rows = [row for entry in comparison.entries[:1] for row in entry.rows]
    return [row[over] or 0.0 for row in rows if row.get("frame") in chosen and over in row]
