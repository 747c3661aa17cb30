"""A quick start: wgpu names some seventy C types through cffi, which parses the whole header's type names for each.

Handing the parser only the names that a type mentions gives the same types and saves more than a second per process
(figures: docs/performance.md). It reaches into cffi's private parser, and does nothing where that looks different.
"""

from __future__ import annotations

import re
from typing import Any

_WORD = re.compile(r"\w+")
_TYPEDEF = "typedef "


def quicken_type_parsing(ffi: Any) -> bool:
    """Make a `cffi.FFI` parse type names quickly; whether that was possible. Calling it again does nothing."""
    parser: Any = getattr(ffi, "_parser", None)
    parse = getattr(parser, "_parse", None)
    if parse is None or not isinstance(getattr(parser, "_declarations", None), dict):
        return False
    if "_parse" in vars(parser):
        return True

    def parse_with_names_in(source: str) -> Any:
        # the caller holds cffi's lock
        declarations = parser._declarations
        words = set(_WORD.findall(source))
        parser._declarations = {
            name: value
            for name, value in declarations.items()
            if not name.startswith(_TYPEDEF) or name[len(_TYPEDEF) :] in words
        }
        try:
            return parse(source)
        finally:
            parser._declarations = declarations

    parser._parse = parse_with_names_in
    return True
