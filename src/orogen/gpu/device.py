"""The device: everything that the other rooms ask of the GPU."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import wgpu
from numpy.typing import ArrayLike, DTypeLike, NDArray

from orogen.errors import BudgetError, GpuError
from orogen.gpu.adapters import AdapterInfo, choose, native_adapters
from orogen.gpu.bindings import binding_layout
from orogen.gpu.capabilities import LIMITS, OPTIONAL_FEATURES, describe
from orogen.gpu.checked import checked
from orogen.gpu.commands import Commands
from orogen.gpu.driver import open_driver
from orogen.gpu.formats import texture_bytes
from orogen.gpu.interrupts import uninterrupted
from orogen.gpu.memory import MemoryAccount
from orogen.gpu.readback import ROW_ALIGNMENT, Readback, StagingPool
from orogen.gpu.resources import Buffer, Texture
from orogen.gpu.shader import Shader, compile_shader
from orogen.gpu.timer import FrameTimer
from orogen.gpu.wgsl import Constant, Source, compose

_SLICE = 16 << 20

Encoder = Any
"""What commands are recorded into: `Commands`, or a `wgpu.GPUCommandEncoder` where those do not work."""
Bindable = Any
"""A `Buffer`, (`Buffer`, offset, size) in bytes, `Texture` (its default view), texture view or sampler."""


def open_gpu(adapter: str | None = None, *, budget: int | None = None) -> Gpu:
    """Open a GPU.

    `adapter`: index, kind ("discrete", "integrated", "virtual", "cpu") or part of a name; by default what the
    environment variable `OROGEN_ADAPTER` says, else the best kind. `budget`: bytes that may be allocated on it at any
    time; None: no limit. Raises `NoAdapterError` without any adapter, `SettingsError` where none fits.
    """
    found = native_adapters()
    info = choose([info for info, _ in found], adapter)
    return Gpu(found[info.index][1], info, budget=budget)


class Gpu:
    """An open device, with its memory account and read-back. Use it as a context manager or `close` it."""

    def __init__(self, adapter: Any, info: AdapterInfo, *, budget: int | None = None) -> None:
        """Use `open_gpu`."""
        self.info = info
        """The adapter."""
        self.memory = MemoryAccount(budget)
        """What is allocated."""
        self.features = frozenset(OPTIONAL_FEATURES) & info.features
        """The optional features that are switched on."""
        limits = {name: adapter.limits[name] for name in LIMITS if name in adapter.limits}
        with checked(f"opening {info}"):
            self.device = adapter.request_device_sync(
                label="orogen", required_features=sorted(self.features), required_limits=limits
            )
        self.limits: dict[str, int] = dict(self.device.limits)
        """The device's limits by their WebGPU names, such as "max-texture-array-layers"."""
        self._staging = StagingPool(lambda size: self.buffer("readback", size, "MAP_READ|COPY_DST", "readback"))
        self._live: weakref.WeakSet[Any] = weakref.WeakSet()
        self._bound: weakref.WeakKeyDictionary[Any, list[Any]] = weakref.WeakKeyDictionary()
        self._after: weakref.WeakKeyDictionary[Any, list[Callable[[], None]]] = weakref.WeakKeyDictionary()
        self._lock = threading.RLock()
        self._driver = open_driver(self.device)
        self._write_buffer = self._driver.write if self._driver else self.device.queue.write_buffer
        self._check = self._driver.check if self._driver else self.device.create_sampler
        self._fence = self.buffer("fence", 4, "COPY_SRC", "readback")

    def __enter__(self) -> Gpu:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Destroy everything that was allocated, then the device."""
        self._staging.trim()
        with self._lock:
            live = list(self._live)
        for resource in live:
            resource.destroy()
        self.device.destroy()

    def check(self) -> None:
        """Raise DeviceLostError where the device is gone; what was made on it is of no use then."""
        with checked(str(self.info)):
            # every frame of a window asks
            self._check()

    # -- memory ------------------------------------------------------------------------------------------------------

    def buffer(self, label: str, size_or_data: int | ArrayLike | bytes, usage: str, category: str) -> Buffer:
        """A buffer of so many bytes (zeros), or with the data.

        `usage`: names of `wgpu.BufferUsage` joined by "|"; COPY_DST is added where data is given. Sizes are rounded up
        to 4 bytes. Raises `BudgetError` before anything is allocated.
        """
        if isinstance(size_or_data, int | np.integer):
            size, data = int(size_or_data), None
        else:
            data = _bytes(size_or_data)
            size = data.nbytes
            # wgpu adds the bits of names up: one that comes twice would turn into another
            usage = "|".join(dict.fromkeys([*usage.replace(" ", "").split("|"), "COPY_DST"]))
        size = max(4, -(-size // 4) * 4)
        self._reserve(size, category, label)
        try:
            with checked(f"buffer {label!r}"):
                buffer = Buffer(self.device.create_buffer(label=label, size=size, usage=usage), self.memory, category)
        except BaseException:
            self.memory.release(size, category)
            raise
        self._track(buffer)
        if data is not None:
            self.write(buffer, data)
        return buffer

    def texture(
        self,
        label: str,
        size: tuple[int, int] | tuple[int, int, int],
        format: str,
        usage: str,
        category: str,
        *,
        mips: int = 1,
        layers: int = 1,
        samples: int = 1,
    ) -> Texture:
        """A texture (zeros) of (width, height), or of (width, height, depth) for a 3D one.

        `usage`: names of `wgpu.TextureUsage` joined by "|". Raises `BudgetError` before anything is allocated.
        """
        width, height, depth = size if len(size) == 3 else (*size, 1)
        nbytes = texture_bytes(format, (width, height), mips=mips, layers=layers, depth=depth, samples=samples)
        self._reserve(nbytes, category, label)
        try:
            with checked(f"texture {label!r}"):
                raw = self.device.create_texture(
                    label=label,
                    size=(width, height, depth if len(size) == 3 else layers),
                    dimension="3d" if len(size) == 3 else "2d",
                    format=format,
                    usage=usage,
                    mip_level_count=mips,
                    sample_count=samples,
                )
        except BaseException:
            self.memory.release(nbytes, category)
            raise
        texture = Texture(raw, self.memory, category, nbytes)
        self._track(texture)
        return texture

    def _reserve(self, size: int, category: str, label: str) -> None:
        try:
            self.memory.allocate(size, category, label)
        except BudgetError:
            self._staging.trim()
            self.memory.allocate(size, category, label)

    def _track(self, resource: Buffer | Texture) -> None:
        with self._lock:
            self._live.add(resource)

    # -- shaders and pipelines ---------------------------------------------------------------------------------------

    def shader(
        self,
        label: str,
        *sources: Source,
        search: Sequence[Path] = (),
        constants: Mapping[str, Constant] | None = None,
    ) -> Shader:
        """Compile WGSL made of the sources in order: files, `Text`s, or names to be looked up in `search`.

        See `orogen.gpu.wgsl.compose`. Raises `ShaderError` that names the file and the line.
        """
        source = compose(*sources, search=search, constants=constants)
        return compile_shader(self.device, label, source, trusted=self.info.kind != "cpu")

    def compute(
        self, label: str, shader: Shader, entry: str, bind_layouts: Sequence[Any] | str = "auto"
    ) -> wgpu.GPUComputePipeline:
        """A compute pipeline; `bind_layouts`: one layout per bind group, or "auto"."""
        shader.require(entry)
        with shader.pipeline_errors(label, entry):
            return self.device.create_compute_pipeline(
                label=label,
                layout=self._pipeline_layout(label, bind_layouts),
                compute={"module": shader.raw, "entry_point": entry},
            )

    def render(
        self,
        label: str,
        shader: Shader,
        vertex: str,
        fragment: str | None,
        targets: Sequence[Mapping[str, Any]],
        bind_layouts: Sequence[Any] | str = "auto",
        **state: Any,
    ) -> wgpu.GPURenderPipeline:
        """A render pipeline.

        `vertex`, `fragment`: entry points of the shader; no fragment: depth only. `targets`: colour targets such as
        {"format": "r32uint"}. `state`: `primitive`, `depth_stencil`, `multisample` of `create_render_pipeline`.
        """
        stages: dict[str, Any] = {"vertex": {"module": shader.raw, "entry_point": vertex}}
        if fragment is not None:
            shader.require(fragment)
            stages["fragment"] = {"module": shader.raw, "entry_point": fragment, "targets": list(targets)}
        shader.require(vertex)
        with shader.pipeline_errors(label, fragment or vertex):
            return self.device.create_render_pipeline(
                label=label, layout=self._pipeline_layout(label, bind_layouts), **stages, **state
            )

    def _pipeline_layout(self, label: str, bind_layouts: Sequence[Any] | str) -> Any:
        if isinstance(bind_layouts, str):
            return bind_layouts
        return self.device.create_pipeline_layout(label=label, bind_group_layouts=list(bind_layouts))

    def layout(self, label: str, entries: Mapping[int, tuple[str, str]]) -> wgpu.GPUBindGroupLayout:
        """A bind group layout from `{binding: (stages, kind)}`.

        `stages`: "COMPUTE", "VERTEX|FRAGMENT" ... `kind`: see `orogen.gpu.bindings.binding_layout`.
        """
        listed = [{"binding": n, "visibility": s, **binding_layout(k)} for n, (s, k) in sorted(entries.items())]
        with checked(f"bind group layout {label!r}"):
            return self.device.create_bind_group_layout(label=label, entries=listed)

    def bind(self, label: str, layout: wgpu.GPUBindGroupLayout, resources: Mapping[int, Bindable]) -> wgpu.GPUBindGroup:
        """A bind group from `{binding: resource}`: `Buffer`s, (`Buffer`, offset, size), `Texture`s, views, samplers."""
        entries, kept = [], []
        for binding, resource in sorted(resources.items()):
            native: Any = resource
            if isinstance(resource, Buffer):
                native = resource.raw
            elif isinstance(resource, Texture):
                native = resource.view()
            elif isinstance(resource, tuple):
                native = {"buffer": resource[0].raw, "offset": resource[1], "size": resource[2]}
            kept.append(resource)
            entries.append({"binding": binding, "resource": native})
        with checked(f"bind group {label!r}"):
            group = self.device.create_bind_group(label=label, layout=layout, entries=entries)
        # the GPU keeps what is bound alive, so the account has to count it for as long
        with self._lock:
            self._bound[group] = kept
        return group

    def sampler(self, label: str, **settings: Any) -> wgpu.GPUSampler:
        """A sampler; `settings` as in `wgpu.GPUDevice.create_sampler`."""
        with checked(f"sampler {label!r}"):
            return self.device.create_sampler(label=label, **settings)

    # -- data in and out ---------------------------------------------------------------------------------------------

    def write(self, buffer: Buffer, data: ArrayLike | bytes, offset: int = 0) -> None:
        """Write bytes or an array at `offset` (bytes, a multiple of 4); a length not a multiple of 4 is filled up."""
        # most writes are small and frequent: numpy stays out of those
        content = data if isinstance(data, bytes) and len(data) % 4 == 0 else _bytes(data)
        size = len(content)
        if offset < 0 or offset + size > buffer.size:
            raise GpuError(
                f"buffer {buffer.label!r}: expected data within its {buffer.size} bytes, got {size} bytes at {offset}"
            )
        if size % 4:
            content = np.concatenate([content, np.zeros(-size % 4, np.uint8)])
        with checked(f"buffer {buffer.label!r}"):
            for start in range(0, size, _SLICE):
                if start:  # lets the driver free what it staged: the data would else be held twice
                    self.wait()
                part = content[start : start + _SLICE]
                self._write_buffer(buffer.raw, offset + start, part)

    def write_texture(
        self,
        texture: Texture,
        array: NDArray[Any],
        layer: int = 0,
        mip: int = 0,
        origin: tuple[int, int] = (0, 0),
    ) -> None:
        """Write an array of (rows, columns) or (rows, columns, channels) of the format's type.

        `layer`: array layer or slice; `origin`: column and row of the upper left texel. Block-compressed formats take
        (rows of blocks, columns of blocks, bytes of a block) as uint8.
        """
        form = texture.layout
        rank = 2 if form.channels == 1 else 3
        if array.dtype != form.dtype or array.ndim != rank or (rank == 3 and array.shape[2] != form.channels):
            raise GpuError(
                f"texture {texture.label!r} ({texture.format}): expected an array of {form.dtype} with shape (rows, "
                f"columns{f', {form.channels}' if rank == 3 else ''}), got {array.dtype} with shape {array.shape}"
            )
        content = np.ascontiguousarray(array)
        pitch = content.shape[1] * form.itemsize
        step = max(1, _SLICE // max(1, pitch))
        with checked(f"texture {texture.label!r}"):
            for row in range(0, content.shape[0], step):
                if row:
                    self.wait()
                part = content[row : row + step]
                start = (origin[0], origin[1] + row * form.block[1], layer)
                self.device.queue.write_texture(
                    {"texture": texture.raw, "mip_level": mip, "origin": start},
                    part,
                    {"bytes_per_row": pitch, "rows_per_image": part.shape[0]},
                    (part.shape[1] * form.block[0], part.shape[0] * form.block[1], 1),
                )

    def read_buffer(
        self,
        buffer: Buffer,
        offset: int = 0,
        size: int | None = None,
        dtype: DTypeLike = np.uint8,
        *,
        encoder: Encoder | None = None,
    ) -> Readback:
        """Copy `size` bytes from `offset` (multiples of 4) back; the result is a 1D array of `dtype`.

        `encoder`: commands of the caller's that the copy is added to; by default it is submitted at once.
        """
        size = buffer.size - offset if size is None else size
        if size < 4 or offset < 0 or offset + size > buffer.size:
            raise GpuError(
                f"buffer {buffer.label!r}: expected to read at least 4 and at most its {buffer.size} bytes, "
                f"got {size} bytes at {offset}"
            )
        kind = np.dtype(dtype)
        if size % kind.itemsize:
            raise GpuError(
                f"buffer {buffer.label!r}: expected a multiple of {kind.itemsize} bytes for {kind}, got {size}"
            )
        staging = self._staging.take(size)
        readback = Readback(
            buffer.label, self._staging, staging, lambda mapped: mapped[:size].view(kind).copy(), self.check
        )
        with checked(f"buffer {buffer.label!r}"), self._commands(encoder, readback) as commands:
            commands.copy_buffer_to_buffer(buffer.raw, offset, staging.raw, 0, size)
        return readback

    def read_texture(
        self,
        texture: Texture,
        mip: int = 0,
        layer: int = 0,
        origin: tuple[int, int] = (0, 0),
        size: tuple[int, int] | None = None,
        *,
        encoder: Encoder | None = None,
    ) -> Readback:
        """Copy a layer or slice back, or the part of it from `origin` (column, row) of `size` (width, height).

        The result has the format's type and the shape (rows, columns), then channels where it has more than one.
        `encoder`: as in `read_buffer`.
        """
        form = texture.layout
        whole = texture.mip_size(mip)
        width, height = size or (whole[0] - origin[0], whole[1] - origin[1])
        columns, rows = form.blocks(width, height)
        row_bytes = columns * form.itemsize
        pitch = -(-row_bytes // ROW_ALIGNMENT) * ROW_ALIGNMENT
        staging = self._staging.take(pitch * rows)

        def unpack(mapped: NDArray[np.uint8]) -> NDArray[Any]:
            packed = mapped[: pitch * rows].reshape(rows, pitch)[:, :row_bytes].copy()
            return packed.view(form.dtype).reshape(form.shape(width, height))

        readback = Readback(texture.label, self._staging, staging, unpack, self.check)
        with checked(f"texture {texture.label!r}"), self._commands(encoder, readback) as commands:
            commands.copy_texture_to_buffer(
                {"texture": texture.raw, "mip_level": mip, "origin": (*origin, layer)},
                {"buffer": staging.raw, "bytes_per_row": pitch, "rows_per_image": rows},
                (columns * form.block[0], rows * form.block[1], 1),
            )
        return readback

    @contextmanager
    def _commands(self, encoder: Encoder | None, readback: Readback) -> Iterator[Any]:
        """The encoder for a read-back, submitted afterwards unless it is the caller's."""
        commands = encoder or self.encoder("read-back")
        yield commands
        self.after(commands, readback.begin)
        if encoder is None:
            self.submit(commands)

    # -- commands ----------------------------------------------------------------------------------------------------

    def encoder(self, label: str) -> Encoder:
        """A command encoder."""
        if self._driver is not None:
            return Commands(self._driver, label)
        with checked(f"commands {label!r}"):
            return self.device.create_command_encoder(label=label)

    def submit(self, encoder: Encoder) -> None:
        """Finish an encoder and hand its commands to the GPU. Wrong draws and dispatches raise `GpuError` here."""
        with uninterrupted():
            with checked(f"commands {encoder.label!r}"):
                if isinstance(encoder, Commands):
                    encoder.submit()
                else:
                    self.device.queue.submit([encoder.finish(label=encoder.label)])
            with self._lock:
                calls = self._after.pop(encoder, [])
            for call in calls:
                call()

    def after(self, encoder: Encoder, call: Callable[[], None]) -> None:
        """Have `submit` make a call as soon as it has handed over this encoder's commands."""
        with self._lock:
            self._after.setdefault(encoder, []).append(call)

    def wait(self) -> None:
        """Wait until the GPU has done all that was submitted."""
        # wgpu 0.32 cannot be asked for this: its on_submitted_work_done raises TypeError
        self.read_buffer(self._fence).result()

    def timer(self) -> FrameTimer:
        """A timer of passes."""
        return FrameTimer(self)

    def describe(self) -> dict[str, Any]:
        """What `orogen info --gpu` shows: adapter, features, limits that matter and memory, as plain values."""
        return describe(self.info, self.features, self.limits, self.memory)


def _bytes(data: ArrayLike | bytes) -> NDArray[np.uint8]:
    """The data's memory as bytes, copied only where it is not contiguous."""
    if isinstance(data, bytes | bytearray | memoryview):
        return np.frombuffer(data, np.uint8)
    return np.ascontiguousarray(data).reshape(-1).view(np.uint8)
