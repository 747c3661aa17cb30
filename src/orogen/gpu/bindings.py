"""Bind group layouts from short words."""

from __future__ import annotations

from typing import Any

from orogen.errors import GpuError

_BUFFERS = {"uniform": "uniform", "storage": "storage", "read": "read-only-storage"}
_SAMPLES = {"float": "float", "unfilterable": "unfilterable-float", "depth": "depth", "sint": "sint", "uint": "uint"}
_ACCESS = {"write": "write-only", "readonly": "read-only", "readwrite": "read-write"}
_SAMPLERS = ("filtering", "non-filtering", "comparison")
_DIMENSIONS = ("1d", "2d", "2d-array", "cube", "cube-array", "3d")

_HELP = (
    "'uniform', 'storage', 'read' (a buffer), 'uniform dynamic' ..., 'sampler filtering|non-filtering|comparison', "
    "'texture float|unfilterable|depth|sint|uint [2d|2d-array|3d ...]', "
    "or 'image FORMAT write|readonly|readwrite [2d|2d-array ...]'"
)


def binding_layout(kind: str) -> dict[str, Any]:
    """The part of a layout entry that says what is bound.

    `kind`: "uniform", "storage" (read and write) or "read" for buffers, each with " dynamic" for a dynamic offset;
    "sampler filtering"; "texture unfilterable 2d-array"; "image r32uint write 2d" for storage textures. The dimension
    is 2d where it is left out. Raises `GpuError` for anything else.
    """
    match kind.split():
        case [buffer, *rest] if buffer in _BUFFERS and rest in ([], ["dynamic"]):
            return {"buffer": {"type": _BUFFERS[buffer], "has_dynamic_offset": bool(rest)}}
        case ["sampler", sampler] if sampler in _SAMPLERS:
            return {"sampler": {"type": sampler}}
        case ["texture", sample, *rest] if sample in _SAMPLES and _is_dimension(rest):
            return {"texture": {"sample_type": _SAMPLES[sample], "view_dimension": rest[0] if rest else "2d"}}
        case ["image", format, access, *rest] if access in _ACCESS and _is_dimension(rest):
            dimension = rest[0] if rest else "2d"
            return {"storage_texture": {"format": format, "access": _ACCESS[access], "view_dimension": dimension}}
    raise GpuError(f"expected a kind of binding ({_HELP}), got {kind!r}")


def _is_dimension(rest: list[str]) -> bool:
    return not rest or (len(rest) == 1 and rest[0] in _DIMENSIONS)
