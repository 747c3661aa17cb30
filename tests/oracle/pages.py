"""What pages of `orogen serve` do, in Python."""

import contextlib
import io
import json
import threading
import time

import numpy as np
from PIL import Image
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from orogen.view.serve import Look, Server, ServerSettings

SIZE = (240, 150)
CLIENTS = 3


@contextlib.contextmanager
def running(terrain, stall=1.5, **look):
    """A server without a panel, drawn for by a thread of its own."""
    with Server(
        terrain, ServerSettings(port=0, clients=CLIENTS, stall=stall), Look(**{"panel": False, **look})
    ) as made:
        errors = []

        def run():
            try:
                made.run()
            except BaseException as error:
                errors.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        yield made
        made.stop()
        thread.join(30)
        assert not thread.is_alive()
        assert not errors


def at_rest(server, client):
    """Whether a page has all that there is to see."""
    view = server._drawing._views.get(client)
    if view is None:
        return client.size is None
    busy = client._events or client._sent or client._coarse is not None or client._picture is not None
    return client.resting and not busy and not view.canvas.wanted


class Page:
    """What the page in a browser does, in Python."""

    def __init__(self, server, **options):
        self.server = server
        origin = f"http://127.0.0.1:{server.port}"
        address = server.address.replace("http", "ws") + "socket"
        self._opened = connect(address, origin=origin, max_size=None, **options)
        self.socket = self._opened.__enter__()

    def tell(self, kind, **values):
        self.socket.send(json.dumps({"type": kind, **values}))

    def resize(self, size=SIZE):
        self.tell("resize", width=size[0], height=size[1], pwidth=size[0], pheight=size[1], ratio=1.0, timestamp=0.1)

    def wheel(self, dy=-300.0):
        self.tell("wheel", x=120, y=75, dx=0.0, dy=dy, buttons=[], modifiers=[])

    def next(self, timeout=30):
        """The next picture, said to be shown."""
        message = self.socket.recv(timeout=timeout)
        self.tell("shown", index=int.from_bytes(message[:8], "big"))
        return np.asarray(Image.open(io.BytesIO(message[8:]))).astype(int)

    def settle(self):
        """The picture after which there is none, until something happens."""
        picture = self.next()
        while True:
            try:
                picture = self.next(0.3)
            except TimeoutError:
                if all(at_rest(self.server, client) for client in list(self.server._clients)):
                    return picture

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


def closing(*steps):
    """Do this again and again, until the connection is closed; gives the frame that closed it."""
    end = time.monotonic() + 30
    try:
        while time.monotonic() < end:
            for step in steps:
                step()
    except ConnectionClosed as error:
        return error.rcvd
    raise AssertionError("the connection stays open")


def hills():
    """Smooth heights (m), 96 x 128."""
    y, x = np.mgrid[0:96, 0:128] / 16.0
    return (600 + 300 * np.sin(x) * np.cos(0.7 * y) + 32 * x).astype(np.float32)
