"""The C library under wgpu, called without what wgpu does around each call: commands.py says why.

This needs what wgpu keeps to itself. `open_driver` looks whether that is as it is known here, and gives None elsewhere.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import wgpu

_log = logging.getLogger("orogen")

_NAME = "commands"
_MOST_KEPT = 512
_FUNCTIONS = {
    "ComputePassEncoder": "SetPipeline SetBindGroup DispatchWorkgroups DispatchWorkgroupsIndirect End Release",
    "RenderPassEncoder": "SetPipeline SetBindGroup SetIndexBuffer Draw DrawIndirect DrawIndexedIndirect End Release",
    "CommandEncoder": (
        "BeginComputePass BeginRenderPass ClearBuffer CopyBufferToBuffer CopyBufferToTexture CopyTextureToBuffer "
        "ResolveQuerySet Finish Release"
    ),
    "CommandBuffer": "Release",
    "Device": "CreateCommandEncoder",
    "Queue": "Submit WriteBuffer",
    "Sampler": "Release",
}
# as in webgpu.h
_LOADS = {"load": 1, "clear": 2}
_STORES = {"store": 1, "discard": 2}
_NO_SLICE = 0xFFFFFFFF

Stamps = tuple[Any, int, int]
"""Handle of a query set, and the queries at the beginning and the end."""
Color = tuple[Any, str, str, tuple[float, ...]]
"""Handle of a view, load and store operation, and the value to clear to."""
Depth = tuple[Any, str, str, float]
"""The same for a depth attachment."""


def open_driver(device: wgpu.GPUDevice) -> Driver | None:
    """The library under a device; None where wgpu's inside looks different, and wgpu's own encoders have to do."""
    try:
        return Driver(device)
    except Exception as error:
        # whatever it is that has changed
        _log.debug("commands are recorded by wgpu: %s: %s", type(error).__name__, error)
        return None


class Driver:
    """The library, for one device, and the descriptors made for it so far."""

    def __init__(self, device: wgpu.GPUDevice) -> None:
        """Use `open_driver`: this raises whatever it stumbles upon."""
        from wgpu.backends.wgpu_native import _api, _helpers

        self.ffi, lib = _api.ffi, _api.lib
        """cffi's."""
        self._checked, self._errors, self._kinds = _api.libf, _api.error_handler, _helpers.ERROR_TYPES
        self._device, self._queue = device._internal, device.queue._internal
        self._kept: dict[Any, tuple[Any, ...]] = {}
        self.functions = {
            kind: SimpleNamespace(**{name: getattr(lib, f"wgpu{kind}{name}") for name in names.split()})
            for kind, names in _FUNCTIONS.items()
        }
        """C functions by the object that they belong to, without its name; "Begin" of a pass begins it."""
        for kind in ("Compute", "Render"):
            begin = getattr(self.functions["CommandEncoder"], f"Begin{kind}Pass")
            self.functions[f"{kind}PassEncoder"].Begin = begin
        self._plain_sampler = self.ffi.new("WGPUSamplerDescriptor *", {"maxAnisotropy": 1, "lodMaxClamp": 32.0})
        # what does not work fails here, not in a frame
        self.check()
        self.compute_pass("", (self.ffi.NULL, 0, 1))
        none = self.ffi.NULL
        self.render_pass("", ((none, "load", "store", (0, 0, 0, 0)),), (none, "load", "store", 0.0), None)
        self.submit("", lambda encoder: None)
        self._kept.clear()

    def check(self) -> None:
        """Raise wgpu's error where the device is gone."""
        made = self._checked.wgpuDeviceCreateSampler(self._device, self._plain_sampler)
        self.functions["Sampler"].Release(made)

    def write(self, buffer: wgpu.GPUBuffer, offset: int, data: Any) -> None:
        """Write contiguous memory, a multiple of 4 bytes, into a buffer at an offset, within its size."""
        content = self.ffi.from_buffer(data)
        self._checked.wgpuQueueWriteBuffer(self._queue, buffer._internal, offset, content, len(content))

    def submit(self, label: str, record: Callable[[Any], None]) -> None:
        """Hand commands to the GPU: `record` writes them into the encoder whose handle it is given.

        Raises what the driver finds wrong as wgpu's errors.
        """
        described, finished = self._label("Encoder", label), self._label("Buffer", label)
        encoder = self._checked.wgpuDeviceCreateCommandEncoder(self._device, described[0])
        try:
            self._errors.capture(_NAME)
            try:
                record(encoder)
            finally:
                found = self._errors.release(_NAME)
            if found is not None:
                raise self._kinds.get(found[0], wgpu.GPUError)(found[1])
            commands = self._checked.wgpuCommandEncoderFinish(encoder, finished[0])
            try:
                self._checked.wgpuQueueSubmit(self._queue, 1, self.ffi.new("WGPUCommandBuffer[]", [commands]))
            finally:
                self.functions["CommandBuffer"].Release(commands)
        finally:
            self.functions["CommandEncoder"].Release(encoder)

    def compute_pass(self, label: str, stamps: Stamps | None) -> tuple[Any, ...]:
        """Descriptor of a compute pass, then what has to live as long as it is used."""
        key = label, stamps
        return self._kept.get(key) or self._keep(key, self._describe_compute(label, stamps))

    def render_pass(
        self, label: str, colors: tuple[Color, ...], depth: Depth | None, stamps: Stamps | None
    ) -> tuple[Any, ...]:
        """Descriptor of a render pass, then what has to live as long as it is used."""
        key = label, colors, depth, stamps
        return self._kept.get(key) or self._keep(key, self._describe_render(label, colors, depth, stamps))

    def _label(self, kind: str, label: str) -> tuple[Any, ...]:
        key = kind, label
        return self._kept.get(key) or self._keep(key, self._new(f"WGPUCommand{kind}Descriptor *", label, {}))

    def _keep(self, key: Any, made: tuple[Any, ...]) -> tuple[Any, ...]:
        # handles in a key are those of objects that are in use: the same value later describes the same
        if len(self._kept) >= _MOST_KEPT:
            self._kept.clear()
        self._kept[key] = made
        return made

    def _describe_compute(self, label: str, stamps: Stamps | None) -> tuple[Any, ...]:
        return self._new("WGPUComputePassDescriptor *", label, {"timestampWrites": self._stamps(stamps)})

    def _describe_render(
        self, label: str, colors: tuple[Color, ...], depth: Depth | None, stamps: Stamps | None
    ) -> tuple[Any, ...]:
        listed = [
            {
                "view": view, "loadOp": _LOADS[load], "storeOp": _STORES[store],
                "clearValue": dict(zip("rgba", clear, strict=True)), "depthSlice": _NO_SLICE,
            }
            for view, load, store, clear in colors
        ]  # fmt: skip
        attachment = self.ffi.NULL
        if depth is not None:
            view, load, store, value = depth
            fields = {"view": view, "depthLoadOp": _LOADS[load], "depthStoreOp": _STORES[store]}
            attachment = self.ffi.new("WGPURenderPassDepthStencilAttachment *", {**fields, "depthClearValue": value})
        fields = {
            "colorAttachmentCount": len(listed),
            "colorAttachments": self.ffi.new("WGPURenderPassColorAttachment[]", listed),
            "depthStencilAttachment": attachment,
            "timestampWrites": self._stamps(stamps),
        }
        return self._new("WGPURenderPassDescriptor *", label, fields)

    def _stamps(self, stamps: Stamps | None) -> Any:
        if stamps is None:
            return self.ffi.NULL
        fields = ("querySet", "beginningOfPassWriteIndex", "endOfPassWriteIndex")
        return self.ffi.new("WGPUPassTimestampWrites *", dict(zip(fields, stamps, strict=True)))

    def _new(self, kind: str, label: str, fields: dict[str, Any]) -> tuple[Any, ...]:
        """A struct with a label, then what its fields point to."""
        text = self.ffi.new("char[]", label.encode())
        given = {**fields, "label": {"data": text, "length": len(text) - 1}}
        return self.ffi.new(kind, given), text, *fields.values()
