"""What a notebook's page does with a widget, in Python: it opens, shows pictures and says so, and tells events."""

from __future__ import annotations

import io
import time
from queue import Empty
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image


class FrontEnd:
    """A page in front of a kernel, by the messages of Jupyter's protocol alone."""

    def __init__(self, client: Any) -> None:
        """`client`: a blocking client of a kernel that is ready."""
        self.client = client
        self.opened: dict[str, dict[str, Any]] = {}
        """State of every widget that the kernel has opened, by its model."""
        self.closed: set[str] = set()
        """Models whose widgets are closed."""
        self._pictures: list[tuple[str, int, NDArray[np.uint8]]] = []

    def run(self, code: str, timeout: float = 60) -> dict[str, Any]:
        """Execute a cell; gives the data of its result by type."""
        asked, result = self.client.execute(code), {}
        while True:
            message = self._hear(timeout)
            content = message["content"]
            if message["parent_header"].get("msg_id") != asked:
                continue
            if message["msg_type"] == "error":
                raise AssertionError("\n".join(content["traceback"]))
            if message["msg_type"] == "execute_result":
                result = content["data"]
            if message["msg_type"] == "status" and content["execution_state"] == "idle":
                return result

    def show(self, model: str, size: tuple[int, int]) -> None:
        """Make the widget visible, so many pixels large."""
        self.tell(model, "resize", width=size[0], height=size[1], pwidth=size[0], pheight=size[1], ratio=1.0)
        self._send(model, {"method": "update", "state": {"_has_visible_views": True}, "buffer_paths": []})

    def tell(self, model: str, kind: str, **values: Any) -> None:
        """Send an event."""
        event = {"type": kind, "timestamp": 0.0, "modifiers": [], "buttons": [], **values}
        self._send(model, {"method": "custom", "content": event})

    def picture(self, model: str, timeout: float = 30) -> NDArray[np.uint8]:
        """The next picture of a widget, (height, width, 3), said to be shown; Empty where none comes."""
        end = time.monotonic() + timeout
        while not self._pictures:
            self._hear(end - time.monotonic())
        of, index, picture = self._pictures.pop(0)
        assert of == model
        shown = {"index": index, "timestamp": time.time(), "localtime": time.time()}
        self._send(model, {"method": "update", "state": {"_frame_feedback": shown}, "buffer_paths": []})
        return picture

    def settled(self, model: str, quiet: float = 0.8) -> NDArray[np.uint8]:
        """The picture after which none comes for a while."""
        picture = self.picture(model)
        while True:
            try:
                picture = self.picture(model, quiet)
            except Empty:
                return picture

    def _send(self, model: str, data: dict[str, Any]) -> None:
        message = self.client.session.msg("comm_msg", {"comm_id": model, "data": data})
        self.client.shell_channel.send(message)

    def _hear(self, timeout: float) -> dict[str, Any]:
        """The next message of the kernel; what it says of widgets is kept."""
        message: dict[str, Any] = self.client.get_iopub_msg(timeout=max(timeout, 0.001))
        kind, content = message["msg_type"], message["content"]
        if kind == "comm_open":
            self.opened[content["comm_id"]] = content["data"]["state"]
        elif kind == "comm_close":
            self.closed.add(content["comm_id"])
        elif kind == "comm_msg" and content["data"].get("method") == "custom":
            told = content["data"]["content"]
            if told.get("type") == "framebufferdata":
                image = Image.open(io.BytesIO(bytes(message["buffers"][0])))
                picture = np.asarray(image.convert("RGB"))
                self._pictures.append((content["comm_id"], told["index"], picture))
        return message
