"""How a terrain is drawn: an algorithm by name, with its settings and those of the clipmap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orogen.errors import SettingsError
from orogen.lod import DEFAULT, algorithm, make_settings
from orogen.streaming.settings import ClipmapSettings
from orogen.values import expected_name, field_names, from_values


@dataclass(frozen=True)
class Choice:
    """An algorithm and its settings, checked."""

    name: str
    """Name of the algorithm."""
    settings: Mapping[str, Any]
    """Values of the algorithm's settings by name; the others keep their defaults."""
    clipmap: ClipmapSettings
    """What is kept resident."""


def choose(name: str | None, settings: Mapping[str, Any]) -> Choice:
    """The choice of an algorithm (None: the default), and of settings of it and of the clipmap in one mapping.

    Raises SettingsError for names that do not exist and for values out of their range.
    """
    if not isinstance(settings, Mapping):
        raise SettingsError(f"settings: expected values by name, such as {{'memory': 2**28}}, got {settings!r}")
    name = name or DEFAULT
    own, shared = field_names(algorithm(name).Settings), field_names(ClipmapSettings)
    for key in settings:
        if key not in own and key not in shared:
            raise expected_name(f"setting of {name}", key, [*own, *shared])
    values = {key: value for key, value in settings.items() if key in own}
    make_settings(name, values)
    others = {key: value for key, value in settings.items() if key in shared}
    return Choice(name, values, from_values(ClipmapSettings, "clipmap", others))
