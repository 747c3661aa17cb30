"""A canvas without a screen whose pictures go elsewhere: what a window draws on for a browser."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rendercanvas.base import BaseCanvasGroup, BaseRenderCanvas

from orogen.view.controls import Event

MOST_PIXELS = 2560 * 1440
"""Pixels that a picture has at most; what shows it may be larger."""


class RemoteCanvas(BaseRenderCanvas):
    """A rendercanvas canvas that is drawn when its owner says so. Not safe to use from several threads."""

    _rc_canvas_group = BaseCanvasGroup(None)  # no loop of its own: one thread draws all canvases in turn

    def __init__(self) -> None:
        super().__init__(size=None, title=None)
        self.wanted = False
        """Whether a picture has been asked for since the latest one."""
        self._picture: NDArray[np.uint8] | None = None
        self._closed = False
        self._final_canvas_init()

    def resize(self, width: int, height: int, ratio: float) -> None:
        """Take the size in physical pixels of what shows the pictures, and how many make a logical one."""
        scale = min(1.0, (MOST_PIXELS / (width * height)) ** 0.5)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        self._size_info.set_physical_size(*size, ratio * scale)
        self.wanted = True

    def take(self, events: list[Event]) -> None:
        """Hand events to whoever listens."""
        for event in events:
            self.submit_event(event)
        self._process_events()

    def request_draw(self, draw_function: Any = None) -> None:
        """Note that a picture is wanted; the owner draws it when it suits."""
        self.wanted = True
        super().request_draw(draw_function)

    def picture(self) -> NDArray[np.uint8] | None:
        """Draw one: (height, width, 4) sRGB; None where nothing was drawn."""
        self.wanted, self._picture = False, None
        self.force_draw()
        return self._picture

    def _rc_gui_poll(self) -> None:
        pass

    def _rc_get_present_info(self, present_methods: list[str]) -> dict[str, Any] | None:
        return {"method": "bitmap", "formats": ["rgba-u8"]} if "bitmap" in present_methods else None

    def _rc_request_draw(self) -> None:
        pass

    def _rc_request_paint(self) -> None:
        pass

    def _rc_force_paint(self) -> None:
        pass

    def _rc_present_bitmap(self, *, data: Any, format: str, **_: Any) -> None:
        self._picture = np.asarray(data)

    def _rc_set_logical_size(self, width: float, height: float) -> None:
        pass

    def _rc_close(self) -> None:
        self._closed = True

    def _rc_get_closed(self) -> bool:
        return self._closed

    def _rc_set_title(self, title: str) -> None:
        pass

    def _rc_set_cursor(self, cursor: str) -> None:
        pass
