"""Compiled WGSL whose errors name the file and the line that a person wrote."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import wgpu

from orogen.errors import DeviceLostError, ShaderError
from orogen.gpu.checked import checked, explain, lost
from orogen.gpu.trusted import trusted_module
from orogen.gpu.wgsl import Composed

_PLACE = re.compile(r"┌─ .*?:(\d+):\d+\s*$", re.MULTILINE)
_GUTTER = re.compile(r"^\s*(\d+) │(.*)$")
_SUMMARY = re.compile(r"(?:parsing|validation) error: (.*)")
_ENTRY = re.compile(r"@(?:compute|vertex|fragment)\b[^{;]*?\bfn\s+(\w+)")


@dataclass(frozen=True)
class Shader:
    """A compiled WGSL module."""

    label: str
    """Its name in messages."""
    raw: Any
    """The `wgpu.GPUShaderModule`."""
    source: Composed
    """The WGSL and where its lines came from."""

    @property
    def entries(self) -> list[str]:
        """Names of its entry points, in order."""
        code = "\n".join(line.text.split("//")[0] for line in self.source.lines)
        return _ENTRY.findall(code)

    def require(self, entry: str) -> None:
        """Raise `ShaderError` where the shader has no such entry point."""
        if entry not in self.entries:
            raise ShaderError(
                f"{self.label}: expected an entry point of {self.source.line(len(self.source.lines)).file} "
                f"({', '.join(self.entries) or 'it has none'}), got {entry!r}"
            )

    def pipeline_errors(self, label: str, entry: str) -> checked:
        """For `with`: errors of a pipeline become `ShaderError`s that name the line of its entry point."""
        place = self.source.find(rf"\bfn\s+{re.escape(entry)}\b")
        return checked(f"{place or self.label}: pipeline {label!r}, entry {entry!r}", ShaderError)


def compile_shader(device: Any, label: str, source: Composed, *, trusted: bool = False) -> Shader:
    """Compile; raises `ShaderError` with the file, line and text of the fault.

    `trusted`: whether loops are taken to end (trusted.py); of no use to software drivers, which then unroll too much.
    """
    try:
        if trusted:
            return Shader(label, trusted_module(device, label, source.text), source)
        return Shader(label, device.create_shader_module(label=label, code=source.text), source)
    except wgpu.GPUError as error:
        if lost(error):
            raise DeviceLostError(f"{label}: {explain(error)}") from error
        raise ShaderError(_located(label, source, str(error))) from error


def _located(label: str, source: Composed, message: str) -> str:
    """A compiler message with the lines of the composed text turned into those of the files."""
    summary = _SUMMARY.search(message)
    place = _PLACE.search(message)
    if not (summary and place):
        return f"{label}: {explain(Exception(message))}"
    snippet, notes = [], []
    # the compiler repeats itself after the first empty line
    for text in message[place.end() :].partition("\n\n")[0].splitlines():
        if gutter := _GUTTER.match(text):
            snippet.append((str(source.line(int(gutter[1]))), gutter[2]))
        elif text.lstrip().startswith("│"):
            snippet.append(("", text.partition("│")[2]))
        elif text.lstrip().startswith("="):
            notes.append("  " + text.strip())
    number = int(place[1])
    for text in message[place.end() :].splitlines():
        # a validation error marks the whole function first and then the expression at fault
        if gutter := _GUTTER.match(text):
            last = int(gutter[1])
        elif "naga::ir::Expression" in text or "naga::ir::Statement" in text:
            number = last
    width = max((len(origin) for origin, _ in snippet), default=0)
    shown = [f"  {origin:>{width}} │{text}" for origin, text in snippet if origin or text.strip()]
    return "\n".join([f"{source.line(number)}: {summary[1]} (shader {label!r})", *shown, *notes])
