"""The window in a notebook: a widget where one can be shown, and a picture everywhere else."""

from __future__ import annotations

import base64
import functools
import io
import logging
import sys
from typing import TYPE_CHECKING, Any, Protocol

from orogen.view.opening import Data
from orogen.view.session import Session

if TYPE_CHECKING:
    from orogen.camera import Camera
    from orogen.shading.style import Style
    from orogen.view.renderer import Picture, Scene
    from orogen.view.window import Window

log = logging.getLogger("orogen")

SAMPLES = 4
"""Samples per pixel of the picture."""


def in_notebook() -> bool:
    """Whether this is a kernel, whose results a notebook shows."""
    # a kernel has imported IPython long before
    shell = sys.modules.get("IPython")
    current = shell.get_ipython() if shell else None
    return getattr(current, "kernel", None) is not None


class Rendered(Data, Protocol):
    """An open data set that also draws pictures, such as `orogen.open` gives."""

    def render(self, camera: Camera, size: tuple[int, int], style: Style, scene: Scene, *, samples: int) -> Picture:
        """A complete picture."""


@functools.cache
def _canvas_class() -> Any:
    """The canvas of a notebook; ImportError where it is not installed."""
    from rendercanvas.anywidget import RenderCanvas

    class Canvas(RenderCanvas):
        """Closes once: on its own, it asks itself to close while it closes."""

        def close(self) -> None:
            closing, self._closing = self._closing, True
            if not closing:
                super().close()

        _closing = False

    return Canvas


class NotebookView:
    """What `Terrain.view` gives in a notebook; as the last line of a cell it is shown there.

    Where the widget cannot come up, as in a notebook on a web site, a picture takes its place.
    """

    def __init__(
        self,
        terrain: Rendered,
        session: Session,
        *,
        size: tuple[int, int],
        title: str = "",
        panel: bool = True,
        owned: bool = False,
    ) -> None:
        """`size`: width and height in logical pixels. `owned`: close the terrain with the view."""
        self.session = session
        """What is shown, and how."""
        self.window: Window | None = None
        """The window; None where anywidget is not installed."""
        self._terrain, self._size, self._owned = terrain, size, owned
        try:
            kind = _canvas_class()
        except ImportError as error:
            log.warning("a picture is shown in place of the view: %s; pip install 'orogen[notebook]' brings it", error)
            return
        from orogen.view.window import Window

        self.window = Window(session, canvas=kind(size=size, title=title, max_fps=60), panel=panel)

    def close(self) -> None:
        """Close the view; the terrain stays open, unless it is the view's own."""
        if self.window:
            self.window.close()
            self.window = None
        if self._owned:
            self._terrain.close()

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None, **options: Any) -> dict[str, Any]:
        bundle = {"text/plain": repr(self), "image/jpeg": self._picture()}
        if self.window:
            # a front end shows the first of these that it can: the widget, where there is a kernel to talk to
            found = self.window.canvas._repr_mimebundle_(include=include, exclude=exclude, **options)
            data = found[0] if isinstance(found, tuple) else found or {}
            bundle |= {kind: value for kind, value in data.items() if kind not in bundle}
        return bundle

    def _picture(self) -> str:
        """JPEG, in base64, of what the window shows."""
        from PIL import Image

        camera = self.window.controls.camera if self.window else self.session.camera
        if self.session.framed and camera == self.session.camera:
            camera = self.session.whole(aspect=self._size[0] / self._size[1])  # there is no panel beside it
        picture = self._terrain.render(camera, self._size, self.session.style, self.session.scene, samples=SAMPLES)
        file = io.BytesIO()
        Image.fromarray(picture.color[..., :3].copy()).save(file, "JPEG", quality=85)
        return base64.b64encode(file.getvalue()).decode("ascii")

    def __repr__(self) -> str:
        return f"<view of {self._terrain.name}>"
