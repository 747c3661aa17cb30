"""The sections of a report: text around tables, graphs and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape

from orogen.compare.report import charts, columns, pictures, targets
from orogen.compare.report.results import Comparison, Entry
from orogen.compare.report.svg import swatch
from orogen.compare.report.tables import Column, entry_table, memory_columns, pass_table
from orogen.compare.report.words import definitions, picture_size, time_of, words


def _overview(comparison: Comparison) -> str:
    caption = """<b>Everything at a glance.</b> Averages over the flight; PSNR is that of all frames as one picture, as
        in the chart; cracks are counted over all frames. The best of a column is bold; ★ stands on a front."""
    front = charts.on_front(comparison, charts.PSNR) | charts.on_front(comparison, charts.ERROR)
    clock = columns.GPU if comparison.time == "gpu" else columns.WALL
    shown = (columns.TRIANGLES, clock, *columns.PICTURE, *_perceptual(comparison)[:1], *columns.SURFACE)
    fronts = charts.front_chart(comparison, charts.PSNR) + charts.front_chart(comparison, charts.ERROR)
    table = entry_table(comparison, caption, shown, front=front)
    return f'{_doubt(comparison)}<div class="pair">{fronts}</div>{table}'


def _quality(comparison: Comparison) -> str:
    psnr = """<b>Picture quality</b> (Houska 2019, table 4.6; equations 4.1a to 4.1c: 8 bits, RGB, whole picture). Equal
        pictures have an infinite PSNR: the average is over the frames that differ. “All frames as one” is the PSNR of
        the mean square error of the whole flight, which counts equal frames as what they are."""
    accuracy = """<b>Screen-space error</b>: how far a drawn point lies from where it belongs, and how far a visible
        true point lies from where it is drawn. Averages over the frames of the flight, where nothing else is said."""
    outlines = """<b>Cracks and outlines.</b> Outlines may be off by a pixel without being cracks; those that are off by
        more can count as such. Lost: pixels at outlines that should show terrain. Hidden: share of
        the visible true points whose place is not seen in the drawn picture. Stray: share of the drawn pixels outside
        the true surface."""
    return (
        entry_table(comparison, psnr, (*columns.PSNR, *_perceptual(comparison)))
        + entry_table(comparison, accuracy, columns.ACCURACY)
        + entry_table(comparison, outlines, columns.OUTLINES)
    )


def _stability(comparison: Comparison) -> str:
    caption = """<b>Temporal stability</b>: how much the drawn height over the same ground changes from one frame of the
        flight to the next, in pixels. Swimming is the mean change of the points that do not jump; popping is the share
        of the points that move by more than half a pixel and by four times what their surroundings moved a frame
        earlier. Only flights with the same time between frames compare."""
    return entry_table(comparison, caption, columns.STABILITY)


def _time(comparison: Comparison) -> str:
    durations = """<b>Frame durations</b> (Houska 2019, table 4.4). GPU: the sum of all passes, by timestamps; CPU:
        recording and submitting a frame; wall clock: from asking for a picture to having it in memory."""
    passes = "<b>Share of each pass in the GPU time of the flight</b> (Houska 2019, table 4.5)."
    work = "<b>What was drawn</b> per frame."
    return (
        _doubt(comparison)
        + entry_table(comparison, durations, columns.DURATIONS)
        + pass_table(comparison, passes)
        + entry_table(comparison, work, columns.WORK)
    )


def _memory(comparison: Comparison) -> str:
    caption = f"""<b>Memory</b> (Houska 2019, table 4.3): the most that any frame needed, at {picture_size(comparison)},
        in millions of bytes. “own” is what the algorithm itself allocates. The process includes decoded terrain,
        libraries, the measuring, and what entries that were measured earlier left behind."""
    return entry_table(comparison, caption, memory_columns(comparison))


def _flight(comparison: Comparison) -> str:
    notes = []
    if any(entry.sweep for entry in comparison.entries) and not any(entry.sweep for entry in comparison.shown):
        notes.append("Entries of sweeps are left out of these graphs; they have their own below.")
    if any(entry.target for entry in comparison.entries):
        notes.append("Of several numbers of triangles these graphs show the first.")
    if comparison.plan.get("pictures"):
        notes.append("Small triangles on the time axis mark the frames whose pictures are below.")
    graphed = (
        charts.time_of(comparison), charts.TRIANGLES, charts.PSNR, charts.ERROR, charts.CHANGE, charts.POPPING,
    )  # fmt: skip
    graphs = "".join(charts.flight_chart(comparison, quality, comparison.shown) for quality in graphed)
    legend = charts.legend(charts.line_styles(comparison, comparison.shown))
    return f'{legend}<p class="notes">{" ".join(notes)}</p>{graphs}'


def _sweeps(comparison: Comparison) -> str:
    parts = ""
    for key, entries in comparison.sweeps.items():
        graphs = "".join(
            charts.flight_chart(comparison, quality, entries, "frame")
            for quality in (charts.time_of(comparison), charts.TRIANGLES)
        )
        legend = charts.legend(charts.line_styles(comparison, entries))
        parts += f"<h3>{escape('.'.join(key))}</h3>{charts.sweep_charts(comparison, key)}{legend}{graphs}"
    return parts


def _targets(comparison: Comparison) -> str:
    styles = charts.target_styles(comparison)
    if not styles:
        return targets.section(comparison)
    graphs = "".join(charts.target_chart(comparison, quality) for quality in (charts.MEAN_ERROR, charts.PSNR))
    return f"{targets.section(comparison)}{charts.legend(styles)}{graphs}"


def _triangles(comparison: Comparison) -> str:
    caption = """<b>Shapes of the triangles</b>, averages over the frames of the flight. Degenerate: without area in
        space, with two corners in the same place or all three on a line. Slivers: with a smallest angle below 10
        degrees. Angles are those on the ground in three dimensions, before exaggeration; a level grid has 45."""
    legend = charts.legend(charts.line_styles(comparison, comparison.shown))
    return f"{entry_table(comparison, caption, columns.SHAPES)}{legend}{charts.angle_chart(comparison)}"


def _pictures(comparison: Comparison) -> str:
    intro = """<p>Crops show the part of the frame where all entries together differ most from the reference, pixel for
        pixel. In the differences, brighter is worse; the factor is the same for all entries of a frame.</p>"""
    return _by_frame(comparison, pictures.side_by_side, intro) or '<p class="notes">No pictures were saved.</p>'


def _frozen(comparison: Comparison) -> str:
    intro = "<p>What was drawn for the camera of the flight, seen from a second one.</p>"
    return _by_frame(comparison, pictures.frozen, intro)


def _by_frame(comparison: Comparison, show: Callable[[Comparison, int], str], intro: str) -> str:
    parts = [
        f"<h3>Frame {frame}{time_of(comparison, frame)}</h3>{shown}"
        for frame in pictures.frame_numbers(comparison)
        if (shown := show(comparison, frame))
    ]
    return intro + "".join(parts) if parts else ""


def _settings(comparison: Comparison) -> str:
    cards = "".join(_entry_card(comparison, entry) for entry in comparison.entries)
    return f'<p>Bold: given for this comparison; the others are defaults.</p><div class="cards">{cards}</div>'


def _entry_card(comparison: Comparison, entry: Entry) -> str:
    rows = "".join(
        f'<tr class="{"given" if name in entry.given else "default"}"><th scope="row">{escape(name)}</th>'
        f"<td>{escape(words(value))}</td></tr>"
        for name, value in entry.settings.items()
    )
    table = f'<table class="plain">{rows}</table>' if rows else '<p class="notes">It has no settings.</p>'
    note = ""
    if found := entry.calibrated:
        text = (
            f"{words(found.get('setting'))} = {words(found.get('value'))} was found by calibration: "
            f"asked for {words(found.get('target'))}, reached {words(found.get('reached'))}."
        )
        note = f'<p class="notes">{escape(text)}</p>'
    heading = f"{swatch(comparison.styles[entry.label])}{escape(entry.label)}"
    kind = f'<p class="notes">{escape(entry.algorithm)}</p>'
    return f'<div class="card"><h3>{heading}</h3>{kind}{table}{note}</div>'


def _conditions(comparison: Comparison) -> str:
    titles = {
        "machine": "Machine", "adapter": "Adapter", "reference": "Reference", "style": "Style", "grid": "Data",
        "options": "How the data was read", "flight": "Flight",
    }  # fmt: skip
    cards = ""
    for name, title in titles.items():
        values = comparison.plan.get(name)
        if isinstance(values, Mapping) and values:
            # camera paths and lists of features are long, and in results.json
            long = ("keyframes", "numbers")
            shown = {part: v for part, v in values.items() if part not in long and not isinstance(v, Mapping)}
            cards += f'<div class="card"><h3>{title}</h3>{definitions(shown)}</div>'
    files = """<p>The same numbers are in <code>results.json</code> (plan, statistics, every frame),
        <code>summary.csv</code> and <code>frames.csv</code> beside this page.</p>"""
    return f'<div class="cards">{cards}</div>{files}'


def _doubt(comparison: Comparison) -> str:
    """A warning where GPU times must not be compared."""
    if comparison.time == "gpu":
        return ""
    if comparison.software:
        reason = """<b>Drawn by a software driver.</b> Its timestamps can leave out the work of a pass, wholly or in
            part: GPU times do not tell which algorithm is faster, and none is marked as best."""
    else:
        reason = "<b>No GPU times.</b> The adapter gives no timestamps."
    return f"""<p class="warning">{reason} Entries are compared by the wall clock, which includes reading the picture
        back and counts whatever else the machine does.</p>"""


def _perceptual(comparison: Comparison) -> tuple[Column, ...]:
    """FLIP, or what was measured in its place."""
    measured = {name for entry in comparison.entries for name in entry.summary}
    return columns.DELTA_E if "delta_e" in measured and "flip" not in measured else columns.FLIP


SECTIONS: Sequence[tuple[str, Callable[[Comparison], str]]] = (
    ("At a glance", _overview),
    ("Quality", _quality),
    ("Stability", _stability),
    ("Time and work", _time),
    ("Triangles", _triangles),
    ("Equal triangles", _targets),
    ("Memory", _memory),
    ("Over the flight", _flight),
    ("Sweeps", _sweeps),
    ("Side by side", _pictures),
    ("From outside", _frozen),
    ("Settings", _settings),
    ("Conditions", _conditions),
)
"""Titles in order, and what makes the section's HTML; an empty section is left out."""
