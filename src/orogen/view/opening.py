"""Data sets that a window shows, alone or beside others, and how further ones are opened while it goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Protocol

from orogen.errors import DeviceLostError, OrogenError, SettingsError
from orogen.grid import Grid
from orogen.pyramid.contract import Pyramid
from orogen.view.renderer import Renderer


class Data(Protocol):
    """An open data set, such as `orogen.open` gives."""

    @property
    def name(self) -> str:
        """What messages call it."""

    @property
    def attribution(self) -> str:
        """Who is to be named beside the picture; may be ""."""

    @property
    def grid(self) -> Grid:
        """Georeference of the heights."""

    @property
    def heights(self) -> Pyramid:
        """The pyramid of heights."""

    @property
    def colors(self) -> Pyramid | None:
        """The pyramid of the draped image, or None."""

    @property
    def renderer(self) -> Renderer:
        """What draws it."""

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest height (m)."""

    def height_at(self, x: Any, y: Any) -> Any:
        """Height (m) at x, y in the data's CRS, numbers or arrays; NaN where there is none."""

    def revive(self) -> bool:
        """Let go of a device that was lost; whether it was."""

    def close(self) -> None:
        """Release everything."""


class Shared:
    """A data set for one of several views: everything is the terrain's, but for a renderer beside its own."""

    def __init__(self, data: Data) -> None:
        self._data = data
        self._base: Renderer | None = None
        self._own: Renderer | None = None

    @property
    def name(self) -> str:
        """What messages call it."""
        return self._data.name

    @property
    def attribution(self) -> str:
        """Who is to be named beside the picture; may be ""."""
        return self._data.attribution

    @property
    def grid(self) -> Grid:
        """Georeference of the heights."""
        return self._data.grid

    @property
    def heights(self) -> Pyramid:
        """The pyramid of heights."""
        return self._data.heights

    @property
    def colors(self) -> Pyramid | None:
        """The pyramid of the draped image, or None."""
        return self._data.colors

    @property
    def height_range(self) -> tuple[float, float]:
        """Lowest and highest height (m)."""
        return self._data.height_range

    @property
    def renderer(self) -> Renderer:
        """A view beside the terrain's own; another one after the device was lost."""
        try:
            return self._beside(self._data.renderer)
        except DeviceLostError:
            self._data.revive()
            return self._beside(self._data.renderer)

    def _beside(self, base: Renderer) -> Renderer:
        if self._own is None or base is not self._base:
            chosen = base.algorithm
            values = {name: getattr(chosen.settings, name) for name in chosen.settings.__dataclass_fields__}
            self._base, self._own = base, base.beside(chosen.name, values)
        return self._own

    def height_at(self, x: Any, y: Any) -> Any:
        """Height (m) at x, y in the data's CRS, numbers or arrays; NaN where there is none."""
        return self._data.height_at(x, y)

    def revive(self) -> bool:
        """Let go of a device that was lost; whether it was."""
        return self._data.revive()

    def close(self) -> None:
        """Give the view back; the terrain stays."""
        own, self._own = self._own, None
        if own:
            try:
                own.gpu.check()
            except DeviceLostError:
                return  # what belonged to the device went with it
            own.close()


class Opening:
    """Opens a data set in a thread of its own."""

    def __init__(self, opener: Callable[[str], Data], text: str) -> None:
        self._found: Data | OrogenError = SettingsError(f"{text}: nothing was opened")
        self._thread = threading.Thread(target=self._work, args=(opener, text), name="orogen-open", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether `result` is there."""
        return not self._thread.is_alive()

    def result(self) -> Data | OrogenError:
        """What was opened, or why it could not be; waits for it."""
        self._thread.join()
        return self._found

    def _work(self, opener: Callable[[str], Data], text: str) -> None:
        try:
            self._found = opener(text)
        except OrogenError as error:
            self._found = error
        except Exception as error:  # a library's own: the view goes on all the same
            self._found = SettingsError(f"{text}: cannot be opened: {type(error).__name__}: {error}")
