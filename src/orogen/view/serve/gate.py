"""Who is let in: the token, the host and the origin of a request, and the few files that a page is made of."""

from __future__ import annotations

import hmac
import ipaddress
import socket
from dataclasses import dataclass
from importlib.resources import files
from urllib.parse import urlsplit

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every answer: the page loads nothing from elsewhere, is in nobody's frame, and tells nobody its address."""
SOCKET = "socket"
"""Where the pictures come from."""


@dataclass(frozen=True)
class Asset:
    """A file of the page."""

    kind: str
    """Its media type."""
    body: bytes
    """What it holds."""


def assets() -> dict[str, Asset]:
    """The files of the page, by name; read once, so that no request ever touches the disk."""
    page, library = files("orogen.view.serve") / "page", files("rendercanvas.core")
    return {
        "": Asset("text/html; charset=utf-8", (page / "index.html").read_bytes()),
        "page.css": Asset("text/css; charset=utf-8", (page / "page.css").read_bytes()),
        "page.js": Asset("text/javascript; charset=utf-8", (page / "page.js").read_bytes()),
        "renderview.js": Asset("text/javascript; charset=utf-8", (library / "renderview.js").read_bytes()),
    }


class Gate:
    """Checks requests."""

    def __init__(self, token: str, host: str) -> None:
        """`host`: name or address that the server was told to listen on."""
        self._token = token.encode()
        self._names = {"localhost", host.lower(), socket.gethostname().lower()}

    def name_of(self, path: str) -> str | None:
        """The part of a path after the token; None where the token is not ours."""
        token, slash, name = path.partition("?")[0].removeprefix("/").partition("/")
        # compared even where the slash is missing, in a time that tells nothing
        known = hmac.compare_digest(token.encode("utf-8", "replace"), self._token)
        return name if known and slash else None

    def host_is_ours(self, host: str | None) -> bool:
        """Whether a Host header names this machine: a page elsewhere whose name was made to point here does not."""
        name = _host_name(host)
        return name is not None and (name in self._names or _is_address(name))

    def origin_is_ours(self, origin: str | None, host: str | None) -> bool:
        """Whether a socket is asked for by our own page."""
        if not origin or not host:
            return False
        try:
            parts = urlsplit(origin)
        except ValueError:
            return False
        return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower()


def _host_name(host: str | None) -> str | None:
    if not host:
        return None
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_local(host: str) -> bool:
    """Whether only this machine can reach what listens there."""
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)
