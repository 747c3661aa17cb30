"""Errors of the driver become the project's own."""

from __future__ import annotations

from types import TracebackType

import wgpu

from orogen.errors import DeviceLostError, GpuError


class checked:
    """Turn a wgpu error in the block into a `GpuError` that starts with the label.

    Where the device is gone that is a `DeviceLostError`, whatever kind was asked for.
    """

    __slots__ = ("_kind", "_label")

    def __init__(self, label: str, kind: type[GpuError] = GpuError) -> None:
        self._label = label
        self._kind = kind

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if isinstance(error, wgpu.GPUError):
            kind = DeviceLostError if lost(error) else self._kind
            raise kind(f"{self._label}: {explain(error)}") from error


def lost(error: BaseException) -> bool:
    """Whether a wgpu error says that the device is gone: it has no other sign of that."""
    return "Parent device is lost" in str(error)


def is_lost(device: wgpu.GPUDevice) -> bool:
    """Whether a device is gone; asks the driver for something small."""
    try:
        device.create_sampler(label="check")
    except wgpu.GPUError as error:
        return lost(error)
    return False


def explain(error: Exception) -> str:
    """The part of a driver message that a reader needs."""
    text = str(error)
    if lost(error):
        return "the GPU device was lost (driver reset, memory exhausted or device removed); open it again"
    lines = [line for line in text.splitlines() if line.strip() not in ("", "Validation Error", "Caused by:")]
    return "\n".join(line.strip() for line in lines if not line.lstrip().startswith("In wgpu")) or text
