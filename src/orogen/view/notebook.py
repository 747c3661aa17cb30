"""The window in a notebook: a widget where one can be shown, and a picture everywhere else."""

from __future__ import annotations

import base64
import functools
import io
import logging
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from orogen.errors import DeviceLostError
from orogen.view.opening import Data
from orogen.view.session import Session
from orogen.view.window import Window

if TYPE_CHECKING:
    from orogen.camera import Camera
    from orogen.shading.style import Style
    from orogen.view.renderer import Picture, Scene

log = logging.getLogger("orogen")

NOTEBOOK_JS = Path(__file__).parent / "notebook.js"
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
        """Closes once, lets go of keys with the keyboard, and begins anew on every page that comes to show it."""

        _esm = str(RenderCanvas._esm).replace("export default", "const live =") + NOTEBOOK_JS.read_text("utf-8")
        kept = type(RenderCanvas._title)("").tag(sync=True)
        """Address of a picture to show before the first frame; a notebook may keep it with the widget's state."""

        def __init__(self, **options: Any) -> None:
            self._closing = False
            self._keys: set[str] = set()
            super().__init__(**options)
            self.observe(self._seen, names=["_has_visible_views"])

        def close(self) -> None:
            closing, self._closing = self._closing, True
            if not closing:  # on its own, it asks itself to close while it closes
                super().close()

        def _rfb_handle_msg(self, widget: Any, content: dict[str, Any], buffers: Any) -> None:
            kind, key = content.get("type"), content.get("key", "")
            if kind == "key_down":
                self._keys.add(key)
            elif kind == "key_up":
                self._keys.discard(key)
            elif kind == "focus_out":
                self._release()
            super()._rfb_handle_msg(widget, content, buffers)

        def give_up(self) -> None:
            """Wait no longer for a picture that is under way from the GPU: it will never come."""
            self._BaseRenderCanvas__scheduler.on_cancel_draw()

        def _release(self) -> None:
            """What is released elsewhere is not told."""
            for key in sorted(self._keys):
                self.submit_event({"event_type": "key_up", "key": key, "modifiers": (), "time_stamp": time.time()})
            self._keys.clear()

        def _seen(self, change: dict[str, Any]) -> None:
            """Be shown, or no longer: scrolled away, taken out, or on a page that was closed or loaded again."""
            self._release()
            if change["new"]:
                # pictures that were under way to another page are never confirmed, and would be waited for
                now = time.time()
                self._frame_feedback = {"index": self._rfb_frame_index, "timestamp": now, "localtime": now}
                self.request_draw()

    return Canvas


class _Window(Window):
    """A window that tells beside its picture why there are no more pictures."""

    def _fail(self, error: Exception) -> None:
        if self.error is None:
            log.error("the view has ended: %s", error)
            self.canvas.set_title(f"The view has ended: {error}")
        super()._fail(error)


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
        self.window = _Window(session, canvas=kind(size=size, title=title, max_fps=60), panel=panel)
        self.window.canvas.observe(self._seen, names=["_has_visible_views"])
        self.window.canvas.on_msg(self._told)

    def _told(self, *message: Any) -> None:
        """See to it that events are heard where the device was lost with a picture under way."""
        if self.window:
            try:
                self.window.session.renderer.gpu.check()
            except DeviceLostError:
                self.window.canvas.give_up()

    def _seen(self, change: dict[str, Any]) -> None:
        """Hold no pictures while nobody looks: a cell that is run again leaves the view of its last run behind."""
        if self.window and not change["new"]:
            self.window.session.rest()

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
            self.window.canvas.kept = f"data:image/jpeg;base64,{bundle['image/jpeg']}"
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
