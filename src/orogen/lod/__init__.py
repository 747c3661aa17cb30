"""Terrain algorithms: every folder here that holds a package is one, and is found without being named anywhere."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from typing import Any

from orogen.lod.contract import Algorithm
from orogen.values import expected_name, from_values

DEFAULT = "raycast"
"""Algorithm that is used when none is named."""


@cache
def algorithms() -> Mapping[str, type[Algorithm]]:
    """Every algorithm by name, in alphabetical order."""
    found: dict[str, type[Algorithm]] = {}
    for info in sorted(pkgutil.iter_modules(__path__), key=lambda info: info.name):
        if info.ispkg:
            module = importlib.import_module(f"{__name__}.{info.name}")
            found[info.name] = next(
                value
                for value in vars(module).values()
                if isinstance(value, type) and issubclass(value, Algorithm) and value is not Algorithm
            )
    return found


def algorithm(name: str) -> type[Algorithm]:
    """The algorithm of a name; `SettingsError` lists what there is."""
    known = algorithms()
    if name not in known:
        raise expected_name("algorithm", name, known)
    return known[name]


def make_settings(name: str, values: Mapping[str, Any]) -> Any:
    """Settings of an algorithm from values by name; text is read as the field's type."""
    return from_values(algorithm(name).Settings, name, values)
