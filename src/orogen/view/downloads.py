"""Pictures on their way from the GPU to a page or a notebook when their device is lost."""

from __future__ import annotations

import functools
from typing import Any

from orogen.gpu.checked import is_lost


def survive_lost_devices() -> None:
    """Have rendercanvas show black in place of a picture that was fetched from a device that is gone by now.

    It reads and unmaps the buffer that was mapped: wgpu ends the process where that is no more. Calling this again does
    nothing, nor does it where rendercanvas looks different inside.
    """
    from rendercanvas.contexts import wgpucontext

    action: Any = getattr(wgpucontext, "AsyncImageDownloadAction", None)
    resolve = getattr(action, "resolve", None)
    if resolve is None or hasattr(resolve, "__wrapped__"):
        return

    @functools.wraps(resolve)
    def resolve_without_device(self: Any, *arguments: Any) -> Any:
        if self._buffer is not None and is_lost(self._buffer._device):
            self._buffer = _Zeros(self.nbytes)
        return resolve(self, *arguments)

    action.resolve = resolve_without_device


class _Zeros:
    """In place of a mapped buffer."""

    map_state = "mapped"

    def __init__(self, size: int) -> None:
        self._size = size

    def read_mapped(self, *, copy: bool) -> memoryview:
        return memoryview(bytes(self._size))

    def unmap(self) -> None:
        pass
