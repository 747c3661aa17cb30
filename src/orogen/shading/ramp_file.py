"""Colour ramps from files: GMT's CPT, QGIS's QML (one band in pseudo-colour) and the text that gdaldem reads."""

from __future__ import annotations

import colorsys
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from orogen.errors import SettingsError

SUFFIXES = (".cpt", ".qml", ".txt", ".clr")
"""Of names that are files of ramps."""

Color = tuple[float, float, float]
Stop = tuple[float, Color]


@dataclass(frozen=True)
class FileRamp:
    """A ramp as a file gives it."""

    heights: NDArray[np.float64]
    """(n,) ascending; two that are alike make a step. Metres, or 0 to 1 where the file leaves the range open."""
    colors: NDArray[np.float64]
    """(n, 3) sRGB, 0 to 1, mixed in between as they are."""
    relative: bool
    """Whether heights are parts of the data's range."""

    def table(self, count: int) -> NDArray[np.float64]:
        """(count, 3) sRGB at even steps from the lowest to the highest height."""
        at = np.linspace(self.heights[0], self.heights[-1], count)
        return np.stack([np.interp(at, self.heights, self.colors[:, i]) for i in range(3)], axis=1)

    @property
    def range(self) -> tuple[float, float] | None:
        """Lowest and highest height (m); None where they are those of the data."""
        return None if self.relative else (float(self.heights[0]), float(self.heights[-1]))


def read_ramp(path: str | Path) -> FileRamp:
    """The ramp in a file. Raises SettingsError, naming file and line, where there is none."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise SettingsError(f"ramp: {path} cannot be read ({error.strerror})") from error
    suffix = path.suffix.lower()
    stops, relative = {".cpt": _cpt, ".qml": _qml}.get(suffix, _gdaldem)(text, path)
    if len(stops) < 2:
        raise SettingsError(f"ramp: {path}: expected at least two heights with colours, got {len(stops)}")
    heights = np.array([height for height, _ in stops])
    if not np.isfinite(heights).all() or (np.diff(heights) < 0).any() or not heights[0] < heights[-1]:
        raise SettingsError(f"ramp: {path}: expected finite heights from the lowest to the highest")
    return FileRamp(heights, np.array([color for _, color in stops]), relative)


def _cpt(text: str, path: Path) -> tuple[list[Stop], bool]:
    """GMT: a line per slice, "low colour high colour"; "# COLOR_MODEL", "# RANGE" and "# HINGE" in comments."""
    hsv, given, hinge = False, None, None
    stops: list[Stop] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("#"):
            hsv = hsv or bool(re.search(r"COLOR_MODEL\s*=\s*\+?HSV", line, re.IGNORECASE))
            if found := re.search(r"\bRANGE\s*=\s*(\S+)/(\S+)", line):
                given = _height(found[1], path, number), _height(found[2], path, number)
            if re.search(r"_HINGE\b", line):
                hinge = 0.0
            continue
        words = re.split(r"[;#]", line)[0].split()
        # B, F and N colour what lies below, above and nowhere
        if not words or words[0].upper() in ("B", "F", "N"):
            continue
        # red, green and blue may be three words; an annotation may follow
        step = 4 if len(words) >= 8 else 2
        if len(words) < 4:
            raise _line(path, number, "'low colour high colour'", line)
        for part in (words[:step], words[step : 2 * step]):
            stops.append((_height(part[0], path, number), _cpt_color(part[1:], hsv, path, number)))
    if stops and given is not None:
        low, high = stops[0][0], stops[-1][0]
        ends = (low, hinge, high) if hinge is not None and low < hinge < high else (low, high)
        places = (given[0], hinge, given[1]) if len(ends) == 3 else given
        stops = [(float(np.interp(height, ends, places)), color) for height, color in stops]  # type: ignore[arg-type]
    relative = given is None and bool(stops) and (stops[0][0], stops[-1][0]) == (0.0, 1.0)
    return stops, relative


def _cpt_color(words: Sequence[str], hsv: bool, path: Path, number: int) -> Color:
    parts = words
    if len(words) == 1:
        (word,) = words
        if re.fullmatch(r"[\d.]+-[\d.]+-[\d.]+", word):
            hsv, parts = True, word.split("-")
        elif "/" in word:
            parts = word.split("/")
        elif re.fullmatch(r"[\d.]+", word):
            parts = [word] * 3
            hsv = False
        else:
            return _named(word, path, number)
    values = [_height(part, path, number) for part in parts]
    if len(values) == 4:  # cyan, magenta, yellow, black in per cent
        c, m, y, k = (value / 100 for value in values)
        return (1 - c) * (1 - k), (1 - m) * (1 - k), (1 - y) * (1 - k)
    if len(values) != 3:
        raise _line(path, number, "a colour of three numbers", " ".join(words))
    if hsv:
        return colorsys.hsv_to_rgb(values[0] / 360 % 1, values[1], values[2])
    return _rgb(values, path, number)


def _qml(text: str, path: Path) -> tuple[list[Stop], bool]:
    """QGIS: the items of a colour ramp shader; those of a discrete one hold up to their values."""
    try:
        root = ElementTree.fromstring(re.sub(r"<!DOCTYPE[^>]*>", "", text))
    except ElementTree.ParseError as error:
        raise SettingsError(f"ramp: {path}: no style of QGIS ({error})") from error
    shader = root.find(".//colorrampshader")
    if shader is None:
        raise SettingsError(f"ramp: {path}: expected a layer in pseudo-colour (a colorrampshader), found none")
    stops: list[Stop] = []
    for number, item in enumerate(shader.iter("item"), start=1):
        color = _named(item.get("color", ""), path, number)
        value = _height(item.get("value", ""), path, number)
        if shader.get("colorRampType", "INTERPOLATED").upper() != "INTERPOLATED" and stops:
            stops.append((stops[-1][0], color))
        stops.append((value, color))
    if len(stops) > 1 and np.isinf(stops[-1][0]):  # the last class of a discrete ramp has no end
        stops.pop()
    return stops, False


def _gdaldem(text: str, path: Path) -> tuple[list[Stop], bool]:
    """gdaldem color-relief: "height colour" lines in any order; heights in per cent are parts of the data's range."""
    stops: list[Stop] = []
    parts: set[bool] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        words = [word for word in re.split(r"[\s,:\t]+", line.split("#")[0].strip()) if word]
        if not words or words[0].lower() in ("nv", "default"):
            continue
        parts.add(words[0].endswith("%"))
        height = _height(words[0].rstrip("%"), path, number) / (100 if words[0].endswith("%") else 1)
        if len(words) == 2:
            color = _named(words[1], path, number)
        elif len(words) in (4, 5):
            color = _rgb([_height(word, path, number) for word in words[1:4]], path, number)
        else:
            raise _line(path, number, "'height red green blue'", line)
        stops.append((height, color))
    if len(parts) > 1:
        raise SettingsError(f"ramp: {path}: expected heights all in metres or all in per cent, got both")
    return sorted(stops, key=lambda stop: stop[0]), parts == {True}


def _height(word: str, path: Path, number: int) -> float:
    try:
        return float(word)
    except ValueError:
        raise _line(path, number, "a number", word) from None


def _rgb(values: Sequence[float], path: Path, number: int) -> Color:
    if not all(0 <= value <= 255 for value in values):
        raise _line(path, number, "red, green and blue from 0 to 255", " ".join(f"{value:g}" for value in values))
    red, green, blue = (value / 255 for value in values)
    return red, green, blue


def _named(word: str, path: Path, number: int) -> Color:
    """A colour by its name or as '#rrggbb'."""
    from PIL import ImageColor

    try:
        return _rgb(ImageColor.getrgb(word)[:3], path, number)
    except ValueError:
        raise _line(path, number, "a colour", word) from None


def _line(path: Path, number: int, expected: str, got: str) -> SettingsError:
    return SettingsError(f"ramp: {path}, line {number}: expected {expected}, got {got.strip()!r}")
