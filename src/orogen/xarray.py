"""`import orogen.xarray` gives every xarray DataArray of heights an accessor: `heights.orogen.view()`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import xarray

if TYPE_CHECKING:
    from orogen.terrain import Terrain
    from orogen.view.notebook import NotebookView
    from orogen.view.renderer import Picture


@xarray.register_dataarray_accessor("orogen")
class Accessor:
    """Terrain from the heights of a DataArray with two dimensions; where they lie is read from its coordinates."""

    def __init__(self, data: xarray.DataArray) -> None:
        self._data = data

    def open(self, **options: Any) -> Terrain:
        """The terrain, to be used in a `with` block; options as in `orogen.open`."""
        from orogen.terrain import open_terrain

        return open_terrain(self._data, **options)

    def render(self, size: tuple[int, int] = (1280, 720), **options: Any) -> Picture:
        """A picture of all of it, `size` (width, height) in pixels; options as in `orogen.open`."""
        with self.open(**options) as terrain:
            return terrain.render(size=size)

    def view(self, **options: Any) -> NotebookView | None:
        """Look at it: in a notebook a widget, whose `close` gives everything back; else a window, until it is closed.

        Options as in `orogen.open`.
        """
        terrain = self.open(**options)
        view = None
        try:
            view = terrain.view(owned=True)
        finally:
            if view is None:
                terrain.close()
        return view
