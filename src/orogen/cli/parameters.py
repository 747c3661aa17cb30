"""Types of arguments and options that several commands share, with what they are called in help."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter, Token

PACKAGE = Path(__file__).parents[1]
# as `orogen.lod.algorithms` and `orogen.view.flight.builtin_flights` find them, which load far more than help needs
ALGORITHMS = sorted(path.parent.name for path in PACKAGE.glob("lod/*/__init__.py"))
"""Names of the terrain algorithms."""
FLIGHTS = sorted(path.stem for path in PACKAGE.glob("view/flights/*.json"))
"""Names of the built-in flights."""


def numbers(count: int | None, separator: str = ",", kind: type = float) -> Callable[[Any, Sequence[Token]], Any]:
    """Reads `count` numbers (None: one or more) that `separator` parts, as one word."""
    words = {None: "one or more", 2: "two", 4: "four"}

    def convert(_: Any, tokens: Sequence[Token]) -> tuple[Any, ...]:
        text = tokens[0].value
        try:
            values = tuple(kind(part) for part in text.lower().split(separator))
        except ValueError:
            values = ()
        if not values or (count is not None and len(values) != count):
            what = "whole numbers" if kind is int else "numbers"
            raise ValueError(f"expected {words[count]} {what} separated by {separator!r}, got {text!r}")
        return values

    return convert


def word(convert: Callable[[Any, Sequence[Token]], Any], metavar: str, **options: Any) -> Parameter:
    """An option of one word that `convert` reads."""
    return Parameter(
        converter=convert, n_tokens=1, accepts_keys=False, allow_leading_hyphen=True, metavar=metavar, negative="",
        **options,
    )  # fmt: skip


ONE = 'Raster: a path, URL or GDAL name, "synthetic" or "procedural"'
TILES = "map tiles: a folder, or a URL with {z}, {x} and {y}"

Data = Annotated[str, Parameter(help=f"{ONE}; a pattern in quotes or a folder makes a mosaic; {TILES}.")]
"""A data set."""
Rasters = Annotated[
    str, Parameter(required=True, help=f"{ONE}; several, a pattern in quotes or a folder make a mosaic; {TILES}.")
]
"""Each word of a data set that may be several."""
Pair = tuple[float, float]
Place = Annotated[Pair, word(numbers(2), "X,Y")]
Sun = Annotated[Pair, word(numbers(2), "AZ,EL")]
Bounds = Annotated[tuple[float, float, float, float], word(numbers(4), "L,B,R,T")]
Window = Annotated[tuple[int, int, int, int], word(numbers(4, ",", int), "X,Y,W,H")]
Size = Annotated[tuple[int, int], word(numbers(2, "x", int), "WxH", show_default=lambda size: "x".join(map(str, size)))]
Flag = Annotated[bool, Parameter(negative="", show_default=False)]
Output = Annotated[Path, Parameter(name=("--output", "-o"))]
Overwrite = Annotated[
    bool,
    Parameter(name=("--overwrite", "--force"), negative="", show_default=False, help="Replace what is there already."),
]
Json = Annotated[bool, Parameter(negative="", show_default=False, help="Write the result to stdout as JSON.")]
Adapter = Annotated[
    str | None,
    Parameter(
        help="GPU to use: index, kind (discrete, integrated, cpu ...) or part of its name; see orogen info --gpu."
    ),
]
Algorithm = Annotated[str, Parameter(help=f"How the surface is drawn: {', '.join(ALGORITHMS)}.")]
FlightName = Annotated[
    str,
    Parameter(name=("--flight", "-f"), help=f"Flight file (.json), or a built-in flight: {', '.join(FLIGHTS)}."),
]
