"""What is asked of an adapter beyond the least that WebGPU promises."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from orogen.gpu.adapters import AdapterInfo
from orogen.gpu.memory import MemoryAccount

OPTIONAL_FEATURES = (
    "timestamp-query",
    "float32-filterable",
    "shader-int64",
    "shader-int64-atomic-min-max",
    "shader-int64-atomic-all-ops",
    "subgroup",
    "indirect-first-instance",
    "multi-draw-indirect-count",
    "depth-clip-control",
    "rg11b10ufloat-renderable",
    "texture-format16bit-norm",
    "texture-compression-bc",
    "texture-compression-etc2",
    "texture-compression-astc",
)
"""Features that are switched on where the adapter has them; code that needs one looks into `Gpu.features`."""

LIMITS = (
    "max-texture-dimension-2d",
    "max-texture-dimension-3d",
    "max-texture-array-layers",
    "max-buffer-size",
    "max-storage-buffer-binding-size",
    "max-uniform-buffer-binding-size",
    "max-bind-groups",
    "max-storage-buffers-per-shader-stage",
    "max-storage-textures-per-shader-stage",
    "max-sampled-textures-per-shader-stage",
    "max-samplers-per-shader-stage",
    "max-color-attachment-bytes-per-sample",
    "max-compute-invocations-per-workgroup",
    "max-compute-workgroup-size-x",
    "max-compute-workgroup-size-y",
    "max-compute-workgroup-size-z",
    "max-compute-workgroup-storage-size",
    "max-compute-workgroups-per-dimension",
)
"""Limits that are raised to what the adapter has."""


def describe(
    info: AdapterInfo, features: frozenset[str], limits: Mapping[str, int], memory: MemoryAccount
) -> dict[str, Any]:
    """An open device in plain values, fit for JSON: bytes of memory, true or false per optional feature."""
    return {
        "name": info.name,
        "kind": info.kind,
        "backend": info.backend,
        "driver": info.driver,
        "features": {name: name in features for name in OPTIONAL_FEATURES},
        "limits": {name: limits[name] for name in LIMITS if name in limits},
        "memory": {
            "total": memory.total,
            "peak": memory.peak,
            "budget": memory.budget,
            "categories": memory.by_category(),
        },
    }
