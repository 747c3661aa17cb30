"""What a page may say, checked field by field; nothing else gets further."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from orogen.errors import SettingsError
from orogen.view.controls import Event

LONGEST = 2048
"""Bytes of a message."""
FARTHEST = 1e5
"""Pixels from the upper left corner that a pointer may be, and that a wheel may turn."""
MODIFIERS = ("Shift", "Control", "Alt", "Meta")
POINTER = ("pointer_down", "pointer_move", "pointer_up", "pointer_enter", "pointer_leave", "double_click", "wheel")
IGNORED = ("show", "hide", "focus_in", "focus_out", "close")
"""Kinds of events that the page's library tells, and no window needs."""


@dataclass(frozen=True)
class Size:
    """The page has another size."""

    width: int
    """Physical pixels across."""
    height: int
    """Physical pixels down."""
    ratio: float
    """Physical pixels to a logical one."""


@dataclass(frozen=True)
class Shown:
    """The page has shown a picture."""

    index: int
    """Number of the picture."""


def parse(text: str | bytes) -> Event | Size | Shown | None:
    """A message of a page: an event as rendercanvas has them, a size, or what is shown; None: nothing of interest.

    Raises SettingsError for all else.
    """
    try:
        given = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        given = None
    if not isinstance(given, dict):
        raise SettingsError("expected a JSON object")
    kind = given.get("type")
    if kind == "shown":
        return Shown(_whole(given, "index", 2**53))
    if kind == "resize":
        ratio = _number(given, "ratio", 16)
        return Size(max(_whole(given, "pwidth", 16384), 1), max(_whole(given, "pheight", 16384), 1), max(ratio, 0.25))
    if kind in POINTER:
        return _pointer(kind, given)
    if kind in ("key_down", "key_up"):
        return {"event_type": kind, "key": _text(given, "key"), "modifiers": _modifiers(given)}
    if kind == "char":
        return {"event_type": kind, "data": _text(given, "data") if given.get("data") is not None else ""}
    if kind in IGNORED:
        return None
    raise SettingsError("expected a known kind of message")


def _pointer(kind: str, given: dict[str, Any]) -> Event:
    buttons = given.get("buttons")
    if not (isinstance(buttons, list) and len(buttons) <= 6 and all(type(b) is int and 0 <= b <= 6 for b in buttons)):
        raise SettingsError("buttons: expected up to six small numbers")
    event: Event = {
        "event_type": kind, "x": _number(given, "x"), "y": _number(given, "y"),
        "buttons": tuple(buttons), "modifiers": _modifiers(given),
    }  # fmt: skip
    if kind == "wheel":
        event |= {"dx": _number(given, "dx"), "dy": _number(given, "dy")}
    else:
        event |= {"button": _whole(given, "button", 6), "ntouches": 0, "touches": {}}
    return event


def _number(given: dict[str, Any], name: str, most: float = FARTHEST) -> float:
    value = given.get(name)
    if type(value) not in (int, float) or not math.isfinite(value) or abs(value) > most:  # type: ignore[arg-type]
        raise SettingsError(f"{name}: expected a number")
    return float(value)  # type: ignore[arg-type]


def _whole(given: dict[str, Any], name: str, most: float) -> int:
    value = _number(given, name, most)
    if value < 0 or value != int(value):
        raise SettingsError(f"{name}: expected a whole number")
    return int(value)


def _text(given: dict[str, Any], name: str) -> str:
    value = given.get(name)
    if not isinstance(value, str) or len(value) > 256:
        raise SettingsError(f"{name}: expected a short text")
    return value


def _modifiers(given: dict[str, Any]) -> tuple[str, ...]:
    value = given.get("modifiers", [])
    if not isinstance(value, list) or len(value) > 4 or not all(name in MODIFIERS for name in value):
        raise SettingsError("modifiers: expected names of modifiers")
    return tuple(value)
