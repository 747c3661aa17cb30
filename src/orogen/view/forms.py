"""Settings dataclasses as forms: what each field is called, what its docstring says of range and unit."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

from orogen.errors import SettingsError
from orogen.values import from_values

_NUMBER = r"(-?\d+(?:\.\d+)?)"
_RANGES = tuple(re.compile(text) for text in (rf"\bfrom {_NUMBER} to {_NUMBER}\b", rf"\b{_NUMBER} to {_NUMBER}\b"))
_UNITS = {
    "px": r"\bpixels?\b", "m": r"\bmet(?:re|er)s?\b", "°": r"\bdegrees?\b", "ms": r"\bmilliseconds?\b",
    "s": r"\bseconds?\b", "bytes": r"\bbytes?\b", "texels": r"\btexels?\b",
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """One setting as a form shows it."""

    name: str
    """Name of the dataclass's field."""
    label: str
    """Name for people, with the unit where the docstring tells one."""
    kind: str
    """"bool", "int", "float" or "text"."""
    optional: bool
    """Whether "none" is a value."""
    default: Any
    """Value that the dataclass gives by itself."""
    help: str
    """The field's docstring."""
    limits: tuple[float, float] | None = None
    """Least and greatest number that the docstring names; None where it names no range."""


@cache
def form_of(kind: type) -> tuple[Field, ...]:
    """The fields of a settings dataclass, in its order."""
    texts = docstrings(kind)
    return tuple(_field(field, texts.get(field.name, "")) for field in dataclasses.fields(kind))


@cache
def docstrings(kind: type) -> Mapping[str, str]:
    """Docstrings under the fields of a dataclass, by name; empty where its source is not there."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, TypeError):
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    texts = {}
    for pair in pairwise(body):
        match pair:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                texts[name] = " ".join(text.split())
    return texts


def changed(kind: type, what: str, values: Mapping[str, Any], name: str, text: str) -> dict[str, Any]:
    """`values` with one more that a user typed.

    Raises SettingsError, and changes nothing, where the settings cannot be made of them.
    """
    if not text.strip():
        default = next(field.default for field in dataclasses.fields(kind) if field.name == name)
        raise SettingsError(f"{name}: expected a value, got nothing; by default it is {text_of(default)}")
    result = {**values, name: text.strip()}
    from_values(kind, what, result)
    return result


def text_of(value: Any) -> str:
    """A value as a form shows it and reads it back."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _field(field: dataclasses.Field[Any], text: str) -> Field:
    annotation = field.type.__name__ if isinstance(field.type, type) else str(field.type)
    kind = next((kind for kind in ("bool", "int", "float") if annotation.startswith(kind)), "text")
    first = text.split(".")[0]
    unit = next((unit for unit, words in _UNITS.items() if re.search(words, first, re.IGNORECASE)), "")
    label = field.name.replace("_", " ")
    return Field(
        field.name,
        f"{label} ({unit})" if unit and kind in ("int", "float") and unit not in label.split() else label,
        kind,
        "None" in annotation,
        field.default,
        text,
        _limits(text) if kind in ("int", "float") else None,
    )


def _limits(text: str) -> tuple[float, float] | None:
    for pattern in _RANGES:
        if found := pattern.search(text):
            low, high = float(found[1]), float(found[2])
            return (low, high) if low < high else None
    return None
