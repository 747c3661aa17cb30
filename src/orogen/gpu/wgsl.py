"""WGSL files with named includes and constants, and a map back to the files they came from.

A line `#include frame.wgsl` stands for the named file, which is taken in once however often it is asked for.
`#{NAME}` is replaced by a constant: `const SIZE = #{SIZE}u;`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from orogen.errors import ShaderError

Constant = int | float | str

_INCLUDE = re.compile(r"\s*#include\s+(\S+)\s*(//.*)?")
_CONSTANT = re.compile(r"#\{([^}]*)\}")
# WGSL wants these before everything else, wherever the file that needs them is included
_DIRECTIVE = re.compile(r"\s*(enable|requires|diagnostic)\b[^;]*;")


@dataclass(frozen=True)
class Text:
    """WGSL that a program makes, with the name that error messages give it."""

    name: str
    """Stands for the file's name."""
    code: str
    """WGSL; may hold includes and constants."""


Source = Path | Text | str
"""A file, made text, or a name to be looked up in the search folders."""


@dataclass(frozen=True)
class Line:
    """Where a composed line came from."""

    file: str
    """Path or name of the source."""
    number: int
    """Line in it, from 1."""
    text: str
    """The line, constants replaced."""

    def __str__(self) -> str:
        return f"{self.file}:{self.number}"


@dataclass(frozen=True)
class Composed:
    """WGSL ready to be compiled."""

    lines: tuple[Line, ...]
    """Its lines in order, each with its origin."""

    @property
    def text(self) -> str:
        """The WGSL."""
        return "\n".join(line.text for line in self.lines) + "\n"

    def line(self, number: int) -> Line:
        """Origin of a line of `text`, counted from 1; the last one where the number is past the end."""
        return self.lines[min(max(number, 1), len(self.lines)) - 1]

    def find(self, pattern: str) -> Line | None:
        """The first line in which the regular expression is found."""
        return next((line for line in self.lines if re.search(pattern, line.text)), None)


def compose(*sources: Source, search: Sequence[Path] = (), constants: Mapping[str, Constant] | None = None) -> Composed:
    """Join sources in order, with every include replaced by the file it names, each file once.

    An include is looked up beside the file that asks for it, then in the `search` folders in order. Raises
    `ShaderError`, with file and line, for an unknown name, a cycle, an unknown constant or an unknown directive.
    """
    composer = _Composer(search, constants or {})
    for source in sources:
        composer.add(source)
    directives = [line for line in composer.lines if _DIRECTIVE.fullmatch(line.text.split("//")[0].rstrip())]
    rest = [line for line in composer.lines if line not in directives]
    return Composed((*directives, *rest))


class _Composer:
    def __init__(self, search: Sequence[Path], constants: Mapping[str, Constant]) -> None:
        self._search = tuple(search)
        self._constants = {name: _literal(name, value) for name, value in constants.items()}
        self._done: set[Path] = set()
        self._open: list[Path] = []
        self.lines: list[Line] = []

    def add(self, source: Source) -> None:
        if isinstance(source, Text):
            self._add_lines(source.name, source.code, None)
        elif isinstance(source, Path):
            self._add_file(source, None)
        else:
            self._add_file(self._find(source, None, None), None)

    def _add_file(self, path: Path, asked: Line | None) -> None:
        path = path.resolve()
        if path in self._open:
            chain = " -> ".join(p.name for p in (*self._open[self._open.index(path) :], path))
            raise ShaderError(f"{asked}: expected includes without a cycle, got {chain}")
        if path in self._done:
            return
        try:
            code = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ShaderError(f"{asked or path}: cannot read the WGSL file {path}: {error}") from error
        self._done.add(path)
        self._open.append(path)
        self._add_lines(_shown(path), code, path.parent)
        self._open.pop()

    def _add_lines(self, name: str, code: str, folder: Path | None) -> None:
        for number, text in enumerate(code.splitlines(), start=1):
            line = Line(name, number, text)
            if match := _INCLUDE.fullmatch(text):
                self._add_file(self._find(match[1], folder, line), line)
            elif text.lstrip().startswith("#") and not text.lstrip().startswith("#{"):
                raise ShaderError(f"{line}: expected '#include NAME' or '#{{CONSTANT}}', got {text.strip()!r}")
            else:
                self.lines.append(Line(name, number, self._replaced(line)))

    def _find(self, name: str, folder: Path | None, asked: Line | None) -> Path:
        folders = [*([folder] if folder else []), *self._search]
        for place in folders:
            if (place / name).is_file():
                return place / name
        known = sorted({path.relative_to(place).as_posix() for place in folders for path in place.rglob("*.wgsl")})
        where = f"{asked}: " if asked else ""
        raise ShaderError(f"{where}expected the name of a WGSL file, got {name!r}; known: {', '.join(known) or 'none'}")

    def _replaced(self, line: Line) -> str:
        def value(match: re.Match[str]) -> str:
            if match[1] not in self._constants:
                known = ", ".join(sorted(self._constants)) or "none"
                raise ShaderError(f"{line}: expected a known constant, got {match[0]}; known: {known}")
            return self._constants[match[1]]

        code, slashes, comment = line.text.partition("//")
        return _CONSTANT.sub(value, code) + slashes + comment


def _literal(name: str, value: Constant) -> str:
    """WGSL for a constant: numbers become abstract literals, so that they fit any type."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        raise ShaderError(f"constant {name}: expected a finite number, got {value}")
    return repr(int(value) if isinstance(value, int) else float(value))


def _shown(path: Path) -> str:
    """A file's name with its folder: short, and enough to tell files apart."""
    return f"{path.parent.name}/{path.name}"
