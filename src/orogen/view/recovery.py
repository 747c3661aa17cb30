"""Drawing that outlives a device: what fails on the GPU is tried again, with everything on it made anew."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from orogen.errors import BudgetError, DeviceLostError, GpuError, NoAdapterError, ShaderError
from orogen.streaming.faults import Faults

if TYPE_CHECKING:
    from orogen.view.renderer import Renderer

T = TypeVar("T")

ATTEMPTS = 4
"""How often a picture is tried where the GPU fails on the way, before the error is raised."""
# one cause, whichever call noticed
_LOST = DeviceLostError("the GPU device was lost (driver reset, memory exhausted or device removed); another is opened")


class Recovery:
    """Holds a renderer: opens it when it is first used, and another one after the device was lost.

    Safe to use from several threads at once, but for what `renderer` gives.
    """

    def __init__(self, opener: Callable[[Faults], Renderer]) -> None:
        """`opener` gives a renderer with a device of its own, which notes what goes wrong; both are closed here."""
        self.lock = threading.RLock()
        """Held while anything is drawn; re-entrant, since drawing asks for the renderer."""
        self.faults = Faults()
        """What went wrong, with all devices so far."""
        self._opener = opener
        self._renderer: Renderer | None = None

    @property
    def renderer(self) -> Renderer:
        """What draws; opened where there is none."""
        with self.lock:
            if self._renderer is None:
                self._renderer = self._opener(self.faults)
            return self._renderer

    @property
    def retry_in(self) -> float | None:
        """Seconds until data that could not be loaded are tried again; None where nothing has failed."""
        with self.lock:
            return self._renderer.retry_in if self._renderer else None

    def draw(self, draw: Callable[[Renderer], T]) -> T:
        """What `draw` gives, called again where the GPU fails: with a fresh view, then with everything made anew.

        Raises the GpuError of the last attempt; at once what would fail again: no adapter, a shader, and a budget that
        is too small for the second time.
        """
        from orogen.gpu.checked import checked

        with self.lock:
            for attempt in range(1, ATTEMPTS + 1):
                try:
                    with checked("drawing"):
                        return draw(self.renderer)
                except (NoAdapterError, ShaderError):
                    raise
                except GpuError as error:
                    hopeless = isinstance(error, BudgetError) and attempt > 1
                    self.faults.add("drawing", _LOST if isinstance(error, DeviceLostError) else error)
                    if attempt == ATTEMPTS or hopeless:
                        raise
                    self._recover(error, attempt)
            raise AssertionError("the last attempt returns or raises")

    def _recover(self, error: GpuError, attempt: int) -> None:
        if self._renderer and attempt == 1 and not isinstance(error, DeviceLostError):
            try:
                self._renderer.refresh()
                return
            except GpuError:
                pass
        self.close()

    def revive(self) -> bool:
        """Let go of a device that was lost, so that another one is opened; whether it was."""
        with self.lock:
            try:
                if self._renderer:
                    self._renderer.gpu.check()
                return False
            except DeviceLostError:
                self.faults.add("drawing", _LOST)
                self.close()
                return True

    def close(self) -> None:
        """Close the renderer and its device; another one is opened when it is used again."""
        with self.lock:
            renderer, self._renderer = self._renderer, None
            if renderer:
                try:
                    renderer.close()
                finally:
                    renderer.gpu.close()
