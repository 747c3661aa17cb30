"""Ctrl-C at a moment where it does no harm."""

from __future__ import annotations

# every frame passes here: the functions of signal make enums, and take several times as long
import _signal  # type: ignore[import-not-found]
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

_MAIN = threading.main_thread()


class uninterrupted:
    """Hold Ctrl-C back until the end of the block.

    The driver calls back into Python from within its functions. KeyboardInterrupt, raised there, would be lost, and so
    would what the driver had to tell: whoever waits for that waits forever.
    """

    __slots__ = ("_before", "_held")

    def __enter__(self) -> None:
        self._before: Callable[[int, FrameType | None], Any] | None = None
        self._held = False
        # signals reach Python's main thread only
        if threading.get_ident() == _MAIN.ident:
            before = _signal.getsignal(_signal.SIGINT)
            if callable(before):
                self._before = before
                _signal.signal(_signal.SIGINT, self._hold)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if self._before:
            _signal.signal(_signal.SIGINT, self._before)
            if self._held:
                self._before(_signal.SIGINT, None)

    def _hold(self, number: int, frame: FrameType | None) -> None:
        self._held = True
