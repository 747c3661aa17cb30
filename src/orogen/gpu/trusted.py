"""Shader modules without the counters that wgpu puts into every loop, in case one never ends.

All loops here end, as the tests show on the software driver; the counters cost a GPU 7 to 9 % of a frame
(docs/performance.md). Bounds are still checked. This needs what wgpu keeps to itself, and leaves the counters in where
that looks different.
"""

from __future__ import annotations

from typing import Any

import wgpu

_BOUNDS_CHECKS = 1
"""WGPUShaderRuntimeChecks_BoundsChecks of wgpu.h, the only check that is asked for."""


def trusted_module(device: wgpu.GPUDevice, label: str, code: str) -> Any:
    """A `wgpu.GPUShaderModule` of WGSL; raises what `create_shader_module` does."""
    try:
        from wgpu.backends.wgpu_native import _api

        source = _api.new_struct_p("WGPUShaderSourceWGSL *", code=_api.to_c_string_view(code))
        source[0].chain.next = _api.ffi.NULL
        source[0].chain.sType = _api.lib.WGPUSType_ShaderSourceWGSL
        chain = _api.ffi.cast("WGPUChainedStruct *", source)
        described = _api.new_struct_p(
            "WGPUShaderModuleDescriptor *", nextInChain=chain, label=_api.to_c_string_view(label)
        )
        create, handle, module = _api.libf.wgpuDeviceCreateShaderModuleTrusted, device._internal, _api.GPUShaderModule
    except (ImportError, AttributeError, KeyError):
        return device.create_shader_module(label=label, code=code)
    return module(label, create(handle, described, _BOUNDS_CHECKS), device)
