"""Serves a terrain to browsers: one thread talks to pages, the one that runs the server draws."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from typing import Any

from websockets.asyncio.server import Server as Listener
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from orogen.errors import OutputError, SettingsError
from orogen.view.opening import Data
from orogen.view.serve.client import Client
from orogen.view.serve.drawing import Drawing, Look
from orogen.view.serve.gate import HEADERS, SOCKET, Gate, assets, is_local
from orogen.view.serve.messages import LONGEST, parse
from orogen.view.serve.pace import encode

log = logging.getLogger("orogen")

MOST_CONNECTIONS = 64
"""Connections at a time, pages that wait for an answer included."""
ENCODERS = 2
"""Threads that encode pictures."""
FULL, UNHEARD, FAILED = 4001, 4002, 4003
"""Codes with which a page is sent away: no place left; a message that cannot be; no more pictures."""


@dataclass(frozen=True)
class ServerSettings:
    """Where a server listens, and to how many."""

    host: str = "127.0.0.1"
    """Name or address of the interface; only this machine reaches the default."""
    port: int = 8000
    """Port, 0: any that is free."""
    clients: int = 4
    """Pages that are shown pictures at a time, from 1 to 64."""
    stall: float = 20.0
    """Seconds after which a page that takes nothing is given up."""

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise SettingsError(f"port: expected 0 to 65535, got {self.port}")
        if not 1 <= self.clients <= MOST_CONNECTIONS:
            raise SettingsError(f"clients: expected 1 to {MOST_CONNECTIONS}, got {self.clients}")
        if not self.stall > 0:
            raise SettingsError(f"stall: expected more than 0 seconds, got {self.stall:g}")


class Server:
    """A terrain in browsers. Use it as a context manager or `close` it; the terrain stays open.

    It listens from the start; `run` draws, in the thread that calls it, until `stop`.
    Raises OutputError where the port cannot be had, GpuError where the GPU cannot.
    """

    def __init__(self, data: Data, settings: ServerSettings | None = None, look: Look | None = None) -> None:
        self.settings = settings or ServerSettings()
        data.renderer  # noqa: B018 - the GPU is opened before anyone is let in, so that what fails is told here
        self.token = secrets.token_urlsafe(24)
        """Whoever has it is let in."""
        self._gate = Gate(self.token, self.settings.host)
        self._assets = assets()
        self._drawing = Drawing(data, look or Look())
        self._clients: set[Client] = set()
        self._encoders = ThreadPoolExecutor(ENCODERS, "orogen-encode")
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="orogen-serve", daemon=True)
        self._thread.start()
        self._listener: Listener | None = None
        try:
            self._listener = asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
        except OSError as error:
            self.close()
            where = f"{self.settings.host}:{self.settings.port}"
            raise OutputError(f"{where}: cannot listen there ({error.strerror or error}); take another port") from error
        if not is_local(self.settings.host):
            log.warning(
                "%s: other machines can reach this, and what goes over the network is not encrypted; who sees the "
                "address with its token can look at the data", self.settings.host,
            )  # fmt: skip

    @property
    def port(self) -> int:
        """The port that it listens on."""
        assert self._listener
        return int(next(iter(self._listener.sockets)).getsockname()[1])

    @property
    def address(self) -> str:
        """What to open in a browser, token included."""
        host = self.settings.host
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
        return f"http://{host}:{self.port}/{self.token}/"

    def run(self) -> None:
        """Draw for all pages until `stop` is called."""
        self._drawing.run()

    def stop(self) -> None:
        """End `run`; from any thread."""
        self._drawing.stop()

    def close(self) -> None:
        """Send all pages away and stop listening; once more does nothing."""
        self.stop()
        self._drawing.join()
        if self._loop.is_closed():
            return
        asyncio.run_coroutine_threadsafe(self._leave(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        self._encoders.shutdown()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- in the thread that talks to pages -----------------------------------------------------------------------------

    async def _listen(self) -> Listener:
        quiet = logging.getLogger("orogen.serve")
        # strangers that knock and go away are no news, nor are pages that break off
        quiet.setLevel(logging.CRITICAL + 1)
        return await serve(
            self._talk, self.settings.host, self.settings.port,
            process_request=self._answer, logger=quiet, compression=None,
            create_connection=partial(_Counted, set()),  # type: ignore[arg-type]
            max_size=LONGEST, max_queue=32, write_limit=1 << 16, open_timeout=10, close_timeout=2,
            ping_interval=self.settings.stall, ping_timeout=self.settings.stall, server_header=None,
        )  # fmt: skip

    async def _leave(self) -> None:
        if self._listener:
            self._listener.close()
            await self._listener.wait_closed()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request; None lets a page's socket in."""
        host = request.headers.get("Host")
        name = self._gate.name_of(request.path)
        if name is None or not self._gate.host_is_ours(host):
            return _response(HTTPStatus.FORBIDDEN)
        if name == SOCKET:
            ours = self._gate.origin_is_ours(request.headers.get("Origin"), host)
            return None if ours else _response(HTTPStatus.FORBIDDEN)
        asset = self._assets.get(name)
        return _response(HTTPStatus.OK, asset.kind, asset.body) if asset else _response(HTTPStatus.NOT_FOUND)

    async def _talk(self, connection: ServerConnection) -> None:
        """All that happens with one page."""
        if len(self._clients) >= self.settings.clients:
            await connection.close(FULL, "all places are taken; try again later")
            return
        client = Client(self._drawing.wake, self._loop)
        self._clients.add(client)
        self._drawing.add(client)
        sending = asyncio.create_task(self._send(connection, client))
        try:
            async for text in connection:
                if (message := parse(text)) is not None:
                    client.hear(message)
        except ConnectionClosed:
            pass
        except SettingsError as error:
            await connection.close(UNHEARD, str(error))
        finally:
            client.gone = True
            self._clients.discard(client)
            self._drawing.wake()
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await sending

    async def _send(self, connection: ServerConnection, client: Client) -> None:
        """Encode and send pictures, each when the page can take it."""
        while True:
            try:
                index, picture, fineness = await client.next()
            except SettingsError as error:
                await connection.close(FAILED, str(error))
                return
            body = await self._loop.run_in_executor(self._encoders, encode, picture, fineness)
            client.sent(index, fineness)
            try:
                async with asyncio.timeout(self.settings.stall):
                    if client.alone:
                        asyncio.ensure_future(await connection.ping()).add_done_callback(client.reached)
                    await connection.send(index.to_bytes(8, "big") + body)
            except TimeoutError:
                # nothing can be said to who does not listen
                connection.transport.abort()
                return


class _Counted(ServerConnection):
    """A connection, dropped at once where there are too many."""

    def __init__(self, held: set[ServerConnection], *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._held = held

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._held.add(self)
        if len(self._held) > MOST_CONNECTIONS:
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._held.discard(self)
        super().connection_lost(exc)


def _response(status: HTTPStatus, kind: str = "text/plain; charset=utf-8", body: bytes = b"") -> Response:
    headers = Headers(HEADERS)
    headers["Content-Type"] = kind
    headers["Content-Length"] = str(len(body))
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, body)
