"""A small writer of charts as inline SVG: axes, lines, points.

No plotting library: a page needs four kinds of marks, and its colours have to follow the reader's light or dark
setting through the page's style sheet, which pictures made by a library do not. Its classes: s0 to s7 are colours, d0
to d3 dashes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

COLORS = 8
"""Colours of the style sheet."""
DASHES = 4
"""Dash patterns of the style sheet, used after all colours."""
MARKERS = ("circle", "square", "triangle", "diamond")
LETTER = 6.8
"""Mean width of a letter of the charts' text, to place labels beside each other."""
DOWN = (4.0, -8.0, 16.0, -21.0, 29.0, -34.0, 42.0, -47.0, 55.0, -60.0, 68.0)
"""Heights below a point at which its name may stand, the nearest first."""


@dataclass(frozen=True)
class Axis:
    """A range of numbers along one side of a chart."""

    label: str
    """Quantity and unit."""
    low: float
    high: float
    log: bool = False
    """Whether equal steps are equal factors."""
    floor: bool = False
    """Whether `low` stands for everything below it."""
    ceiling: bool = False
    """Whether `high` stands for infinity."""

    @classmethod
    def over(
        cls,
        label: str,
        values: Sequence[float | None],
        *,
        log: bool = False,
        zero: bool = False,
        least: float | None = None,
    ) -> Axis:
        """An axis for these values, widened to round numbers. At least one must be finite, and above 0 where `log`.

        `zero`: start at 0. `least`: on a logarithmic axis, smaller values are drawn here. Infinite values are drawn at
        the upper end.
        """
        finite = [value for value in values if value is not None and math.isfinite(value)]
        floor = False
        if log:
            if least is not None:
                floor = min(finite) < least
                finite = [max(value, least) for value in finite]
            low, high = min(finite), max(finite)
            low, high = _round_log(low, False), _round_log(high, True)
            if low == high:
                high = low * 10
        else:
            low, high = (min([0.0, *finite]) if zero else min(finite)), max(finite)
            step = _step(high - low or abs(high) or 1.0)
            low, high = math.floor(low / step) * step, math.ceil(high / step + 1e-9) * step
            if low == high:
                high = low + step
        ceiling = any(value == math.inf for value in values)
        if ceiling:
            high = high * (high / low) ** 0.15 if log else high + 0.15 * (high - low)
        return cls(label, low, high, log, floor, ceiling)

    def place(self, value: float) -> float:
        """0 at the lower end, 1 at the upper."""
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def ticks(self) -> list[tuple[float, str]]:
        """Values and their texts."""
        if self.log:
            decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            parts = (1, 2, 5) if self.high / self.low <= 200 else (1,)
            values = [part * 10.0**n for n in decades for part in parts]
        else:
            step = _step(self.high - self.low)
            first = math.ceil(self.low / step - 1e-9)
            values = [n * step for n in range(first, first + 20)]
        top = self.high * (0.98 if self.ceiling else 1 + 1e-9)
        found = [(value, number(value)) for value in values if self.low * (1 - 1e-9) <= value <= top]
        if self.floor and found:
            found[0] = found[0][0], f"≤ {found[0][1]}"
        return [*found, (self.high, "∞")] if self.ceiling else found


@dataclass(frozen=True)
class Series:
    """A line."""

    name: str
    style: int
    """Number of the line style."""
    x: Sequence[float]
    y: Sequence[float | None]
    """None: a gap."""
    dots: bool = False
    """Whether its points are marked."""


@dataclass(frozen=True)
class Point:
    """A mark with a name beside it."""

    name: str
    style: int
    x: float
    y: float
    note: str = ""
    """What a pointer that rests on it reads."""
    strong: bool = False
    """Whether it is drawn filled."""


@dataclass(frozen=True)
class Plot:
    """A chart: its size in pixels, two axes, and marks."""

    x: Axis
    y: Axis
    title: str
    """What a screen reader says."""
    size: tuple[int, int] = (1080, 260)
    series: Sequence[Series] = ()
    points: Sequence[Point] = ()
    front: Sequence[tuple[float, float]] = ()
    """Corners of a front, drawn as stairs, by rising x."""
    marks: Sequence[float] = field(default=())
    """Places on the x axis to mark."""
    right: int = 16
    top: int = 10
    bottom: int = 44

    def svg(self) -> str:
        """The chart as an <svg> element."""
        width, height = self.size
        parts = [*self._axes(), *self._front(), *map(self._line, self.series), *self._points()]
        return (
            f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(self.title)}">'
            f"{''.join(parts)}</svg>"
        )

    @property
    def left(self) -> float:
        """Room for the numbers of the y axis and its label."""
        return 38 + LETTER * max(len(text) for _, text in self.y.ticks())

    def _at(self, x: float, y: float) -> tuple[float, float]:
        width, height = self.size
        across, down = width - self.left - self.right, height - self.top - self.bottom
        return self.left + self.x.place(x) * across, self.top + (1 - self.y.place(y)) * down

    def _axes(self) -> list[str]:
        width, height = self.size
        right, bottom = width - self.right, height - self.bottom
        parts = []
        for value, text in self.y.ticks():
            _, y = self._at(self.x.low, value)
            parts.append(f'<path class="grid" d="M{self.left:.1f} {y:.1f}H{right}"/>')
            parts.append(f'<text class="tick end" x="{self.left - 8:.1f}" y="{y + 4:.1f}">{escape(text)}</text>')
        for value, text in self.x.ticks():
            x, _ = self._at(value, self.y.low)
            parts.append(f'<path class="grid" d="M{x:.1f} {self.top}V{bottom}"/>')
            parts.append(f'<text class="tick middle" x="{x:.1f}" y="{bottom + 18}">{escape(text)}</text>')
        for value in self.marks:
            x, _ = self._at(value, self.y.low)
            parts.append(f'<path class="mark" d="M{x:.1f} {bottom}l-4 7h8z"><title>pictures below</title></path>')
        parts.append(f'<path class="axis" d="M{self.left:.1f} {self.top}V{bottom}H{right}"/>')
        middle = (self.left + right) / 2
        parts.append(f'<text class="label middle" x="{middle:.1f}" y="{height - 6}">{escape(self.x.label)}</text>')
        down = (self.top + bottom) / 2
        turn = f"translate(14 {down:.1f}) rotate(-90)"
        parts.append(f'<text class="label middle" transform="{turn}">{escape(self.y.label)}</text>')
        return parts

    def _line(self, series: Series) -> str:
        path, pen = [], "M"
        for x, y in zip(series.x, series.y, strict=True):
            if y is None:
                pen = "M"
                continue
            a, b = self._at(x, y)
            path.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L"
        known = [(x, y) for x, y in zip(series.x, series.y, strict=True) if y is not None]
        alone = len(known) == 1 or series.dots
        dots = [f'<path class="dot" d="{_marker(series.style, *self._at(x, y), 3.5)}"/>' for x, y in known if alone]
        return (
            f'<g class="series {style_class(series.style)}" data-series="{escape(series.name)}">'
            f'<title>{escape(series.name)}</title><path class="line" d="{"".join(path)}"/>{"".join(dots)}</g>'
        )

    def _front(self) -> list[str]:
        if not self.front:
            return []
        corners = [self._at(x, y) for x, y in self.front]
        path = f"M{corners[0][0]:.1f} {corners[0][1]:.1f}"
        for x, y in corners[1:]:
            path += f"H{x:.1f}V{y:.1f}"
        return [f'<path class="front" d="{path}H{self.size[0] - self.right}"/>']

    def _points(self) -> list[str]:
        parts, taken = [], [_box(*self._at(point.x, point.y), 0, "") for point in self.points]
        for point in self.points:
            x, y = self._at(point.x, point.y)
            kind = "dot strong" if point.strong else "dot"
            parts.append(
                f'<g class="series {style_class(point.style)}" data-series="{escape(point.name)}">'
                f"<title>{escape(point.note or point.name)}</title>"
                f'<path class="{kind}" d="{_marker(point.style, x, y, 5)}"/></g>'
            )
            if point.name:
                parts.append(self._name(point, x, y, taken))
        return parts

    def _name(self, point: Point, x: float, y: float, taken: list[tuple[float, float, float, float]]) -> str:
        """A point's name at the nearest place beside it where it covers nothing, with a line where that is far."""
        wide = len(point.name) * LETTER * (1.12 if point.strong else 1.0)
        places = [(side, down) for down in DOWN for side in (9.0, -9.0 - wide)]
        boxes = [_box(x + dx, y + dy, wide, point.name) for dx, dy in places]
        free = [
            place
            for place, box in zip(places, boxes, strict=True)
            if box[0] >= self.left and box[2] <= self.size[0] and box[1] >= 0 and box[3] <= self.size[1] - self.bottom
            if not any(_overlap(box, other) for other in taken)
        ]
        dx, dy = free[0] if free else places[0]
        taken.append(_box(x + dx, y + dy, wide, point.name))
        line = ""
        if abs(dy - 4) > 15:
            line = f'<path class="leader" d="M{x:.1f} {y:.1f}L{x + (7 if dx > 0 else -7):.1f} {y + dy - 4:.1f}"/>'
        weight = " strong" if point.strong else ""
        return f'{line}<text class="name{weight}" x="{x + dx:.1f}" y="{y + dy:.1f}">{escape(point.name)}</text>'


def style_class(style: int) -> str:
    """Classes of a line style's number."""
    return f"s{style % COLORS} d{style // COLORS % DASHES}"


def swatch(style: int) -> str:
    """A sample of a line style, for legends."""
    return (
        f'<svg class="swatch" viewBox="0 0 30 12" aria-hidden="true"><g class="series {style_class(style)}">'
        f'<path class="line" d="M1 6H29"/><path class="dot" d="{_marker(style, 15, 6, 3.5)}"/></g></svg>'
    )


def number(value: float, digits: int = 3) -> str:
    """A number for people: so many significant digits, but never less than the whole part; thousands apart."""
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e15:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value)) + 1e-12))
        text = f"{value:,.{places}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
        return text.replace(",", "\u202f").replace("-", "−")
    return f"{value:.{digits - 1}e}".replace("-", "−")


def _step(span: float) -> float:
    """A round step that divides a span into four to nine."""
    power = 10.0 ** math.floor(math.log10(span / 5))
    return next(power * part for part in (1, 2, 5, 10) if span / (power * part) <= 8)


def _round_log(value: float, up: bool) -> float:
    """The next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value) + 1e-12)
    parts = [power * part for part in (1, 2, 5, 10)]
    if up:
        return next(part for part in parts if part >= value * (1 - 1e-9))
    return next(part for part in reversed(parts) if part <= value * (1 + 1e-9))


def _marker(style: int, x: float, y: float, radius: float) -> str:
    kind = MARKERS[(style + style // COLORS) % len(MARKERS)]
    r = radius
    if kind == "circle":
        return f"M{x - r:.1f} {y:.1f}a{r} {r} 0 1 0 {2 * r} 0a{r} {r} 0 1 0 {-2 * r} 0z"
    if kind == "square":
        r *= 0.9
        return f"M{x - r:.1f} {y - r:.1f}h{2 * r:.1f}v{2 * r:.1f}h{-2 * r:.1f}z"
    if kind == "triangle":
        r *= 1.15
        return f"M{x:.1f} {y - r:.1f}L{x + r:.1f} {y + 0.75 * r:.1f}H{x - r:.1f}z"
    r *= 1.2
    return f"M{x:.1f} {y - r:.1f}L{x + r:.1f} {y:.1f}L{x:.1f} {y + r:.1f}L{x - r:.1f} {y:.1f}z"


def _box(x: float, y: float, wide: float, text: str) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of a text that starts at (x, y); of a mark where there is no text."""
    return (x, y - 11, x + wide, y + 3) if text else (x - 6, y - 6, x + 6, y + 6)


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
