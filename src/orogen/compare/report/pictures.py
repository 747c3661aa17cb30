"""Pictures of a report: crops side by side, differences, and views of the frozen camera, all inside the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from orogen.compare.metrics import psnr
from orogen.compare.report.results import Comparison
from orogen.compare.report.tables import decibels

Pixels = NDArray[np.uint8]

CROP = 320
"""Least width of a crop in pixels; a fifth of a wider picture."""
OVERVIEW = 720
"""Largest width of a whole picture in pixels."""
BRIGHT = 0.995
"""Share of the pixels of the worst difference that must not be saturated."""
META = {"close": "close by", "middle": "from some distance", "far": "from far away"}
"""Endings of the files of the frozen view, and what they show."""


@dataclass(frozen=True)
class Window:
    """A part of a picture, in pixels."""

    left: int
    top: int
    width: int
    height: int

    def cut(self, picture: Pixels) -> Pixels:
        """That part of a (height, width, channels) picture."""
        return picture[self.top : self.top + self.height, self.left : self.left + self.width]


def frame_numbers(comparison: Comparison) -> list[int]:
    """Frames with a saved reference picture, in the order of the flight."""
    folder = comparison.folder / "pictures" / "reference"
    return sorted(int(path.stem) for path in folder.glob("*.png") if path.stem.isdecimal())


def side_by_side(comparison: Comparison, frame: int) -> str:
    """One frame: where it is, and a row per entry: the crop, its difference from the reference, and its mesh."""
    reference = _read(_path(comparison, "reference", frame))
    if reference is None:
        return ""
    drawn = {entry.label: _read(_path(comparison, entry.folder, frame)) for entry in comparison.shown}
    fitting = {label: part for label, part in drawn.items() if part is not None and part.shape == reference.shape}
    window = area_of_interest(reference, list(fitting.values()))
    gain = contrast([difference(window.cut(picture), window.cut(reference)) for picture in fitting.values()])
    rows = [_whole(reference, window), _cell(window.cut(reference), "Reference", "all of level 0")]
    for entry in comparison.shown:
        picture = fitting.get(entry.label)
        if picture is None:
            rows.append(f'<p class="notes row">{escape(entry.label)}: no picture of this frame was saved.</p>')
            continue
        crop, true = window.cut(picture), window.cut(reference)
        inside = f"PSNR {decibels(psnr(crop, true))} dB here, {decibels(psnr(picture, reference))} dB whole"
        amplified = np.minimum(difference(crop, true).astype(np.float64) * gain, 255).astype(np.uint8)
        rows.append(_cell(crop, entry.label, inside))
        rows.append(_cell(amplified, "Difference", f"{gain} × |drawn − reference|"))
        mesh = _read(_path(comparison, entry.folder, frame, "_wire"))
        if mesh is not None and mesh.shape == reference.shape:
            rows.append(_cell(window.cut(mesh), "Wireframe", ""))
        else:
            rows.append('<p class="notes">no wireframe was saved</p>')
    return f'<div class="crops">{"".join(rows)}</div>'


def frozen(comparison: Comparison, frame: int) -> str:
    """What was drawn for the flight's camera, seen from a second one (Houska 2019, figures 4.8 to 4.11); "" without."""
    cells = []
    for entry in comparison.shown:
        for ending, words in {"": "", **{f"_{name}": words for name, words in META.items()}}.items():
            picture = _read(_path(comparison, entry.folder, frame, f"_meta{ending}"))
            if picture is not None:
                cells.append(_cell(picture, entry.label, words, "JPEG"))
    return f'<div class="views">{"".join(cells)}</div>' if cells else ""


def difference(drawn: Pixels, reference: Pixels) -> Pixels:
    """(height, width): the largest difference of the three channels."""
    return np.abs(drawn.astype(np.int16) - reference).max(axis=2).astype(np.uint8)


def contrast(differences: Sequence[Pixels]) -> int:
    """The factor, a power of two, that makes the worst of these differences bright but hardly ever saturated."""
    worst = max((float(np.quantile(part, BRIGHT)) for part in differences), default=0.0)
    gain = 1
    while gain < 64 and 2 * gain * worst <= 255:
        gain *= 2
    return gain


def area_of_interest(reference: Pixels, drawn: Sequence[Pixels]) -> Window:
    """The part of a frame where the pictures differ most from the reference, all entries together."""
    height, width = reference.shape[:2]
    wide = min(width, max(CROP, width // 5))
    high = min(height, round(wide * height / width))
    total = np.zeros((height + 1, width + 1))
    for picture in drawn:
        total[1:, 1:] += difference(picture, reference)
    total = total.cumsum(axis=0).cumsum(axis=1)
    inside = total[high:, wide:] - total[:-high, wide:] - total[high:, :-wide] + total[:-high, :-wide]
    top, left = np.unravel_index(inside.argmax(), inside.shape)
    return Window(int(left), int(top), wide, high)


def _path(comparison: Comparison, folder: str, frame: int, ending: str = "") -> Path:
    return comparison.folder / "pictures" / folder / f"{frame:04d}{ending}.png"


def _read(path: Path) -> Pixels | None:
    """(height, width, 3), None where there is no such file."""
    if not path.is_file():
        return None
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def _whole(reference: Pixels, window: Window) -> str:
    """The whole frame, the window marked as in figure 4.4 of Houska (2019)."""
    image = Image.fromarray(reference)
    line = max(2, reference.shape[1] // 400)
    box = (window.left, window.top, window.left + window.width - 1, window.top + window.height - 1)
    ImageDraw.Draw(image).rectangle(box, outline=(255, 255, 255), width=line)
    return _cell(np.asarray(image), "Whole frame", "the rectangle is shown beside and below", "JPEG", "wide")


def _cell(picture: Pixels, title: str, text: str, kind: str = "PNG", more: str = "") -> str:
    words = f"<b>{escape(title)}</b> {escape(text)}"
    return (
        f'<figure class="picture {more}"><img src="{_embedded(picture, kind)}" alt="{escape(title)}" '
        f'width="{picture.shape[1]}" height="{picture.shape[0]}"><figcaption>{words}</figcaption></figure>'
    )


def _embedded(picture: Pixels, kind: str) -> str:
    """A data: address. Crops stay exact (PNG); whole views are made smaller and compressed (JPEG)."""
    image = Image.fromarray(picture)
    if kind == "JPEG" and image.width > OVERVIEW:
        image = image.resize((OVERVIEW, round(image.height * OVERVIEW / image.width)), Image.Resampling.LANCZOS)
    file = io.BytesIO()
    image.save(file, kind, **({"quality": 85} if kind == "JPEG" else {"optimize": True}))
    return f"data:image/{kind.lower()};base64,{base64.b64encode(file.getvalue()).decode()}"
