"""Settings from text: values by name into frozen dataclasses, with errors that say what there is; attributes that are
worked out once.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Iterable, Mapping
from numbers import Real
from typing import Any, Generic, TypeVar

from orogen.errors import SettingsError

T = TypeVar("T")

SWITCHES = {"true": True, "on": True, "1": True, "false": False, "off": False, "0": False}
"""Words for whether something is switched on."""


class once(Generic[T]):
    """A property that is worked out when it is first asked for: functools.cached_property without the lock that Python
    3.11 takes for it, which costs more than most of what a frame works out.
    """

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self._compute = compute
        self.__doc__ = compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type | None = None) -> T:
        if instance is None:
            return self  # type: ignore[return-value]
        value = instance.__dict__[self._name] = self._compute(instance)
        return value


def expected_name(what: str, name: str, known: Iterable[str]) -> SettingsError:
    """The error for a name that does not exist, with what does and the nearest one."""
    known = list(known)
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {close[0]}?" if close else ""
    return SettingsError(f"{what}: expected one of {', '.join(known) or 'none'}, got {name!r}{hint}")


def field_names(kind: type) -> list[str]:
    """Names of a dataclass's fields."""
    return [field.name for field in dataclasses.fields(kind)]


def from_values(kind: type[T], what: str, values: Mapping[str, Any]) -> T:
    """A settings dataclass from values by field name; text is read as the field's type.

    `what` is what messages call the settings. Raises SettingsError for unknown names and unreadable values.
    """
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for name in values:
        if name not in fields:
            raise expected_name(f"setting of {what}", name, fields)
    return kind(**{name: _parsed(what, fields[name], value) for name, value in values.items()})


def _parsed(what: str, field: dataclasses.Field[Any], value: Any) -> Any:
    # annotations are text only where a module asks for that
    kind = field.type.__name__ if isinstance(field.type, type) else str(field.type)
    if not isinstance(value, str):
        absent = value is None and "None" in kind
        if kind.startswith(("int", "float")) and not absent and not isinstance(value, Real):
            raise SettingsError(f"{what} {field.name}: expected {kind}, got {value!r}")
        return value
    if value.lower() == "none" and "None" in kind:
        return None
    try:
        if kind.startswith("bool"):
            return SWITCHES[value.lower()]
        if kind.startswith("int"):
            return int(value)
        if kind.startswith("float"):
            return float(value)
    except (ValueError, KeyError):
        raise SettingsError(f"{what} {field.name}: expected {kind}, got {value!r}") from None
    return value
