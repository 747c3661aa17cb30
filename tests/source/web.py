"""A local web server with range requests, latency and faults, for the tests of remote data."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Request:
    """What was asked of the server."""

    method: str
    """GET or HEAD."""
    path: str
    """Path and query."""
    range: tuple[int, int] | None
    """First and last byte."""
    sent: int = 0
    """Bytes of the body sent."""


@dataclass
class Site:
    """Files in memory, served over HTTP; `fault` may answer a request in another way."""

    files: dict[str, bytes]
    """By path, such as "/a.tif"."""
    latency: float = 0.0
    """Seconds before each answer."""
    etag: str | None = '"1"'
    """Entity tag of every file; None: none is sent."""
    modified: str | None = None
    """Time of change of every file, such as "Mon, 23 Nov 2026 08:00:00 GMT"; None: none is sent."""
    ranges: bool = True
    """Whether range requests are honoured."""
    fault: Callable[[Request, int], int | str | None] = lambda request, count: None
    """Of a request and its number from 0: None: a right answer; a number: that status; "drop": the connection closes
    without an answer; "cut": half of the body; "slow": stops for 30 s in the body."""
    requests: list[Request] = field(default_factory=list)
    """What was asked so far."""
    url: str = ""
    """Where it is served."""
    closing: threading.Event = field(default_factory=threading.Event)
    """Set when the server ends."""

    @property
    def sent(self) -> int:
        """Bytes of all bodies."""
        return sum(request.sent for request in self.requests)


@contextmanager
def serve(site: Site) -> Iterator[Site]:
    """Serve a site on a free port."""
    lock = threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_HEAD(self) -> None:
            self.answer(body=False)

        def do_GET(self) -> None:
            self.answer(body=True)

        def answer(self, body: bool) -> None:
            wanted = self.headers.get("Range")
            span = None
            if wanted:
                first, _, last = wanted.removeprefix("bytes=").partition("-")
                span = int(first), int(last) if last else 2**62
            request = Request(self.command, self.path, span)
            with lock:
                count = len(site.requests)
                site.requests.append(request)
            time.sleep(site.latency)
            fault = site.fault(request, count)
            data = site.files.get(self.path)
            if fault == "drop":
                self.connection.shutdown(socket.SHUT_RDWR)
                self.close_connection = True
                return
            status = fault if isinstance(fault, int) else 404 if data is None else 200
            if status >= 300 or data is None:
                self.head(status, b"")
                return
            total, extra = len(data), {}
            if span and site.ranges:
                if span[0] >= total:
                    self.head(416, b"", {"Content-Range": f"bytes */{total}"})
                    return
                last = min(span[1], total - 1)
                data = data[span[0] : last + 1]
                extra = {"Content-Range": f"bytes {span[0]}-{last}/{total}"}
                status = 206
            self.head(status, data, extra)
            if not body:
                return
            part = data[: len(data) // 2] if fault in ("cut", "slow") else data
            try:
                self.wfile.write(part)
                request.sent = len(part)
                if fault == "slow":
                    site.closing.wait(30)
                if fault in ("cut", "slow"):
                    self.wfile.flush()
                    self.connection.shutdown(socket.SHUT_RDWR)
                    self.close_connection = True
            except OSError:
                self.close_connection = True

        def head(self, status: int, data: bytes, extra: dict[str, str] | None = None) -> None:
            self.send_response(status)
            self.send_header("Content-Length", str(len(data)))
            if site.ranges:
                self.send_header("Accept-Ranges", "bytes")
            if site.etag and status < 300:
                self.send_header("ETag", site.etag)
            if site.modified and status < 300:
                self.send_header("Last-Modified", site.modified)
            for key, value in (extra or {}).items():
                self.send_header(key, value)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    site.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield site
    finally:
        site.closing.set()
        server.shutdown()
        server.server_close()
        thread.join(5)
