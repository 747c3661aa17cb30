"""Commands for the GPU, written down as they are asked for and handed to the driver's library in one go.

wgpu checks for errors, converts and makes Python objects at each call, which takes several times as long as what is
called. `Commands` and its passes have the names and arguments of wgpu's own encoders, as far as they are used here. All
they do is note C functions with their arguments, which `submit` calls. By then all are known, so that what is bound
already is not bound again, and compute passes that follow each other without timestamps become one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from orogen.errors import GpuError
from orogen.gpu.driver import Driver, Stamps

Call = tuple[Callable[..., Any], tuple[Any, ...], Any]
"""A function, its arguments after the encoder's handle, and what has to live until it is called."""

# as in webgpu.h
_INDEX_FORMATS = {"uint16": 1, "uint32": 2}
_ALL_ASPECTS = 1
_WHOLE_SIZE = (1 << 64) - 1


class Commands:
    """What one `Gpu.submit` hands over, in order."""

    def __init__(self, driver: Driver, label: str) -> None:
        """`label`: its name in messages."""
        self.label = label
        """Its name in messages."""
        self._driver = driver
        self._functions = driver.functions["CommandEncoder"]
        self._calls: list[Call] | None = []
        self._open: _Pass | None = None
        self._last: ComputePass | None = None

    def begin_compute_pass(self, *, label: str = "", timestamp_writes: Mapping[str, Any] | None = None) -> ComputePass:
        """Begin a pass, or go on with the one before where neither has timestamps."""
        if self._last is not None and timestamp_writes is None and self._open is None:
            self._open = self._last
            self._last.resume()
            return self._last
        stamps = _stamps(timestamp_writes)
        run = ComputePass(self, self._driver, label, self._driver.compute_pass(label, stamps))
        self._add(run.play, (), timestamp_writes)
        self._open, self._last = run, run if stamps is None else None
        return run

    def begin_render_pass(
        self,
        *,
        label: str = "",
        color_attachments: Sequence[Mapping[str, Any]],
        depth_stencil_attachment: Mapping[str, Any] | None = None,
        timestamp_writes: Mapping[str, Any] | None = None,
    ) -> RenderPass:
        """Begin a pass into colours, of (0, 0, 0, 0) at first where they are cleared to nothing else, and depth."""
        colors = tuple(
            (each["view"]._internal, each["load_op"], each["store_op"], tuple(each.get("clear_value", (0, 0, 0, 0))))
            for each in color_attachments
        )
        depth = None
        if depth_stencil_attachment is not None:
            given = depth_stencil_attachment
            loaded, stored = given["depth_load_op"], given["depth_store_op"]
            depth = given["view"]._internal, loaded, stored, given.get("depth_clear_value", 0.0)
        stamps = _stamps(timestamp_writes)
        run = RenderPass(self, self._driver, label, self._driver.render_pass(label, colors, depth, stamps))
        self._add(run.play, (), (color_attachments, depth_stencil_attachment, timestamp_writes))
        self._open = run
        return run

    def clear_buffer(self, buffer: Any, offset: int = 0, size: int | None = None) -> None:
        """Fill with zeros, to the end where no size is given."""
        length = _WHOLE_SIZE if size is None else size
        self._add(self._functions.ClearBuffer, (buffer._internal, offset, length), buffer)

    def copy_buffer_to_buffer(
        self, source: Any, source_offset: int, destination: Any, destination_offset: int, size: int
    ) -> None:
        """As in WebGPU."""
        arguments = (source._internal, source_offset, destination._internal, destination_offset, size)
        self._add(self._functions.CopyBufferToBuffer, arguments, (source, destination))

    def copy_texture_to_buffer(
        self, source: Mapping[str, Any], destination: Mapping[str, Any], copy_size: tuple[int, int, int]
    ) -> None:
        """As in WebGPU; the copy starts at the buffer's beginning."""
        new = self._driver.ffi.new
        texture = {
            "texture": source["texture"]._internal,
            "mipLevel": source["mip_level"],
            "origin": tuple(source["origin"]),
            "aspect": _ALL_ASPECTS,
        }
        layout = {"bytesPerRow": destination["bytes_per_row"], "rowsPerImage": destination["rows_per_image"]}
        buffer = {"buffer": destination["buffer"]._internal, "layout": layout}
        arguments = (
            new("WGPUTexelCopyTextureInfo *", texture),
            new("WGPUTexelCopyBufferInfo *", buffer),
            new("WGPUExtent3D *", copy_size),
        )
        self._add(self._functions.CopyTextureToBuffer, arguments, (source, destination))

    def copy_buffer_to_texture(
        self, source: Mapping[str, Any], destination: Mapping[str, Any], copy_size: tuple[int, int, int]
    ) -> None:
        """As in WebGPU."""
        new = self._driver.ffi.new
        layout = {
            "offset": source["offset"],
            "bytesPerRow": source["bytes_per_row"],
            "rowsPerImage": source["rows_per_image"],
        }
        texture = {
            "texture": destination["texture"]._internal,
            "mipLevel": destination["mip_level"],
            "origin": tuple(destination["origin"]),
            "aspect": _ALL_ASPECTS,
        }
        arguments = (
            new("WGPUTexelCopyBufferInfo *", {"buffer": source["buffer"]._internal, "layout": layout}),
            new("WGPUTexelCopyTextureInfo *", texture),
            new("WGPUExtent3D *", copy_size),
        )
        self._add(self._functions.CopyBufferToTexture, arguments, (source, destination))

    def resolve_query_set(self, queries: Any, first: int, count: int, destination: Any, offset: int) -> None:
        """As in WebGPU."""
        arguments = (queries._internal, first, count, destination._internal, offset)
        self._add(self._functions.ResolveQuerySet, arguments, (queries, destination))

    def submit(self) -> None:
        """Hand them to the GPU, once. Raises what the driver finds wrong as wgpu's errors."""
        calls, self._calls = self._ready(), None

        def play(encoder: Any) -> None:
            for function, arguments, _ in calls:
                function(encoder, *arguments)

        self._driver.submit(self.label, play)

    def ended(self) -> None:
        """A pass says that it has ended."""
        self._open = None

    def _add(self, function: Callable[..., Any], arguments: tuple[Any, ...], kept: Any) -> None:
        self._ready().append((function, arguments, kept))
        self._last = None

    def _ready(self) -> list[Call]:
        if self._open is not None:
            raise GpuError(f"commands {self.label!r}: expected the end of pass {self._open.label!r} first")
        if self._calls is None:
            raise GpuError(f"commands {self.label!r}: expected to be submitted once, and nothing to follow; got more")
        return self._calls


class _Pass:
    """Commands of a pass."""

    _kind: str

    def __init__(self, commands: Commands, driver: Driver, label: str, description: tuple[Any, ...]) -> None:
        """`description`: of `Driver`."""
        self.label = label
        """Its name in messages."""
        self._commands = commands
        self._driver = driver
        self._functions = driver.functions[self._kind]
        self._description = description
        self._calls: list[Call] = []
        self._add = self._calls.append
        self._pipeline: Any = None
        self._groups: dict[int, Any] = {}

    def set_pipeline(self, pipeline: Any) -> None:
        """As in WebGPU."""
        if pipeline is not self._pipeline:
            self._add((self._functions.SetPipeline, (pipeline._internal,), pipeline))
            self._pipeline = pipeline

    def set_bind_group(self, index: int, group: Any, offsets: Sequence[int] = ()) -> None:
        """As in WebGPU; `offsets`: the dynamic ones, in bytes."""
        if offsets:
            listed = self._driver.ffi.new("uint32_t[]", list(offsets))
            self._add((self._functions.SetBindGroup, (index, group._internal, len(offsets), listed), group))
            self._groups[index] = None
        elif group is not self._groups.get(index):
            self._add((self._functions.SetBindGroup, (index, group._internal, 0, self._driver.ffi.NULL), group))
            self._groups[index] = group

    def end(self) -> None:
        """As in WebGPU."""
        self._add = _add_after_end
        self._commands.ended()

    def resume(self) -> None:
        """Take more commands after the end."""
        self._add = self._calls.append

    def play(self, encoder: Any) -> None:
        """Call the library."""
        handle = self._functions.Begin(encoder, self._description[0])
        try:
            for function, arguments, _ in self._calls:
                function(handle, *arguments)
            self._functions.End(handle)
        finally:
            self._functions.Release(handle)


class ComputePass(_Pass):
    """Dispatches."""

    _kind = "ComputePassEncoder"

    def dispatch_workgroups(self, x: int, y: int = 1, z: int = 1) -> None:
        """As in WebGPU."""
        self._add((self._functions.DispatchWorkgroups, (x, y, z), None))

    def dispatch_workgroups_indirect(self, buffer: Any, offset: int) -> None:
        """As in WebGPU."""
        self._add((self._functions.DispatchWorkgroupsIndirect, (buffer._internal, offset), buffer))


class RenderPass(_Pass):
    """Draws."""

    _kind = "RenderPassEncoder"

    def set_index_buffer(self, buffer: Any, form: str) -> None:
        """The whole buffer; `form`: "uint16" or "uint32"."""
        self._add((self._functions.SetIndexBuffer, (buffer._internal, _INDEX_FORMATS[form], 0, _WHOLE_SIZE), buffer))

    def draw(self, vertices: int, instances: int = 1) -> None:
        """As in WebGPU."""
        self._add((self._functions.Draw, (vertices, instances, 0, 0), None))

    def draw_indirect(self, buffer: Any, offset: int) -> None:
        """As in WebGPU."""
        self._add((self._functions.DrawIndirect, (buffer._internal, offset), buffer))

    def draw_indexed_indirect(self, buffer: Any, offset: int) -> None:
        """As in WebGPU."""
        self._add((self._functions.DrawIndexedIndirect, (buffer._internal, offset), buffer))


def _add_after_end(_: Call) -> None:
    raise GpuError("expected a pass that goes on, got a command after its end; begin another pass")


def _stamps(writes: Mapping[str, Any] | None) -> Stamps | None:
    if writes is None:
        return None
    first, last = writes["beginning_of_pass_write_index"], writes["end_of_pass_write_index"]
    return writes["query_set"]._internal, first, last
