"""Tables of a report: one row per entry, the best value of a column in bold, every missing value with its reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

from orogen.compare.report.results import Comparison, Entry
from orogen.compare.report.svg import number, swatch
from orogen.compare.report.why import why

MB = 1e6


@dataclass(frozen=True)
class Column:
    """A column of numbers."""

    title: str
    """Heading, with the unit."""
    name: str
    """Flat name of what it shows, also to tell why something is missing."""
    statistic: str = "mean"
    """Statistic over the flight; "sum" for a total."""
    show: Callable[[float], str] = number
    """Text of a value."""
    best: str = ""
    """"low" or "high" where one end is best."""
    group: str = ""
    """Heading over it and its neighbours of the same group."""

    def read(self, entry: Entry) -> float | None:
        """The entry's value."""
        if self.statistic == "sum":
            mean, count = entry.value(self.name), entry.value(self.name, "count")
            return None if mean is None or count is None else round(mean * count, 6)
        return entry.value(self.name, self.statistic)


class Notes:
    """Footnotes of a table: the same reason has the same number."""

    def __init__(self) -> None:
        self._reasons: dict[str, int] = {}

    def dash(self, reason: str) -> str:
        """A dash with the number of its reason."""
        place = self._reasons.setdefault(reason, len(self._reasons) + 1)
        return f'<span class="none" title="{escape(reason)}">–<sup>{place}</sup></span>'

    def html(self) -> str:
        """The list of the reasons; nothing where there is none."""
        items = "; ".join(f"<sup>{place}</sup> {escape(reason)}" for reason, place in self._reasons.items())
        return f'<p class="notes">– {items}.</p>' if items else ""


def entry_table(
    comparison: Comparison,
    caption: str,
    columns: Sequence[Column],
    *,
    front: frozenset[str] = frozenset(),
    entries: Sequence[Entry] | None = None,
) -> str:
    """A table of entries, by default of all; `front`: labels that get a star."""
    notes = Notes()
    entries = comparison.entries if entries is None else entries
    values = [[column.read(entry) for entry in entries] for column in columns]
    bests = [_best(comparison, column, part) for column, part in zip(columns, values, strict=True)]
    body = []
    for place, entry in enumerate(entries):
        cells = []
        for column, part, best in zip(columns, values, bests, strict=True):
            value = part[place]
            if value is None:
                cells.append(f"<td>{notes.dash(why(comparison, entry, column.name))}</td>")
                continue
            mark = ' class="best"' if value == best else ""
            cells.append(f'<td{mark} data-value="{value:.9g}">{escape(column.show(value))}</td>')
        star = ' <abbr class="star" title="on the front">★</abbr>' if entry.label in front else ""
        body.append(f"<tr>{entry_heading(comparison, entry, star)}{''.join(cells)}</tr>")
    return wrap(caption, _head(columns), "".join(body), notes)


def entry_heading(comparison: Comparison, entry: Entry, more: str = "") -> str:
    """The first cell of an entry's row."""
    sample = swatch(comparison.styles[entry.label])
    return f'<th scope="row">{sample}{escape(entry.label)}{more}</th>'


def wrap(caption: str, head: str, body: str, notes: Notes) -> str:
    """A table with its caption above and its notes below, in a box that scrolls sideways."""
    return (
        f'<figure class="table"><figcaption>{caption}</figcaption><div class="scroll"><table class="numbers">'
        f"<thead>{head}</thead><tbody>{body}</tbody></table></div>{notes.html()}</figure>"
    )


def pass_table(comparison: Comparison, caption: str) -> str:
    """Share of every pass in the GPU time, a row per pass and a column per entry (table 4.5 of Houska 2019)."""
    entries = comparison.entries
    passes = dict.fromkeys(name for entry in entries for name in entry.summary if name.startswith("gpu."))
    notes = Notes()
    if not passes:
        reasons = "; ".join(sorted({why(comparison, entry, "gpu") for entry in entries}))
        return f'<figure><figcaption>{caption}</figcaption><p class="notes">No table: {escape(reasons)}.</p></figure>'
    spent = {name: [_spent(entry, name) for entry in entries] for name in passes}
    totals = [_spent(entry, "gpu") for entry in entries]
    order = sorted(passes, key=lambda name: -max(value or 0.0 for value in spent[name]))
    head = "".join(f'<th scope="col">{swatch(comparison.styles[e.label])}{escape(e.label)}</th>' for e in entries)
    rows = []
    for name in order:
        cells = []
        for entry, value, total in zip(entries, spent[name], totals, strict=True):
            if value is None or not total:
                cells.append(f"<td>{notes.dash(why(comparison, entry, name))}</td>")
            else:
                share = value / total
                bar = f'<span class="bar" style="width:{100 * share:.1f}%"></span>'
                cells.append(f'<td class="share" data-value="{share:.6g}">{bar}<span>{percent(share)}</span></td>')
        rows.append(f'<tr><th scope="row">{escape(name.removeprefix("gpu."))}</th>{"".join(cells)}</tr>')
    return wrap(caption, f'<tr><th scope="col">Pass</th>{head}</tr>', "".join(rows), notes)


def memory_columns(comparison: Comparison) -> list[Column]:
    """The algorithms' own GPU memory, that of the other kinds, the largest first, and both totals."""
    algorithms = {f"memory.gpu.{entry.algorithm}" for entry in comparison.entries}
    names = {n for entry in comparison.entries for n in entry.summary if n.startswith("memory.gpu.")} - algorithms
    largest = sorted(names, key=lambda name: (-max(e.value(name, "max") or 0.0 for e in comparison.entries), name))
    group = "GPU, by kind (MB)"
    return [
        Column("own", "memory.own", "max", megabytes, "low", group),
        *(Column(name.removeprefix("memory.gpu."), name, "max", megabytes, group=group) for name in largest),
        Column("GPU, all (MB)", "memory.gpu", "max", megabytes, "low"),
        Column("process (MB)", "memory.host", "max", megabytes),
    ]


def milliseconds(value: float) -> str:
    """Three digits after the point, as in table 4.4 of Houska (2019)."""
    return f"{value:,.3f}".replace(",", "\u202f")


def decibels(value: float) -> str:
    """Two digits after the point."""
    return "∞" if math.isinf(value) else f"{value:.2f}"


def pixels(value: float) -> str:
    """Thousandths of a pixel: depths give no more."""
    return "0" if value == 0 else f"{value:.3f}" if value >= 5e-4 else "<\u202f0.001"


def percent(value: float) -> str:
    """A share from 0 to 1 in per cent, three digits; what is smaller than 0.001 % says so."""
    if 0 < value < 1e-5:
        return "<\u202f0.001\u202f%"
    return f"{number(100 * value)}\u202f%"


def count(value: float) -> str:
    """A whole number, thousands apart."""
    return f"{value:,.0f}".replace(",", "\u202f")


def megabytes(value: float) -> str:
    """Bytes in millions."""
    return number(value / MB, 4)


def degrees(value: float) -> str:
    """Tenths."""
    return f"{value:.1f}"


def three(value: float) -> str:
    """Three digits after the point."""
    return f"{value:.3f}"


def _spent(entry: Entry, name: str) -> float | None:
    known = [value for value in entry.column(name) if value is not None]
    return math.fsum(known) if known else None


def _best(comparison: Comparison, column: Column, values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    doubtful = comparison.software and column.name == "gpu"
    if doubtful or not column.best or len(known) < 2 or min(known) == max(known):
        return None
    return min(known) if column.best == "low" else max(known)


def _head(columns: Sequence[Column]) -> str:
    titles = "".join(f'<th scope="col">{escape(column.title)}</th>' for column in columns)
    if not any(column.group for column in columns):
        return f'<tr><th scope="col">Entry</th>{titles}</tr>'
    groups, run = "", 0
    for place, column in enumerate(columns):
        run += 1
        if place + 1 == len(columns) or columns[place + 1].group != column.group:
            kind = ' class="group"' if column.group else ""
            groups += f'<th scope="colgroup" colspan="{run}"{kind}>{escape(column.group)}</th>'
            run = 0
    return f'<tr><th></th>{groups}</tr><tr><th scope="col">Entry</th>{titles}</tr>'
