"""A file on a web server or in an object store, fetched by byte ranges through obstore."""

from __future__ import annotations

import os
import re
import threading
from datetime import timedelta
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from orogen.errors import SourceError

if TYPE_CHECKING:
    from obstore.store import ObjectStore

SCHEMES = ("http", "https", "s3", "s3a", "gs", "az", "abfs")
"""What a URL begins with that is read here; names that begin with /vsi are left to GDAL."""
TIMEOUT = 30
"""Seconds for one request, unless GDAL_HTTP_TIMEOUT says otherwise."""
RETRIES = 3
"""Further attempts after a fault that may pass, unless GDAL_HTTP_MAX_RETRY says otherwise."""
GIVE_UP = timedelta(seconds=60)
"""No further attempt starts so long after the first one."""

ADVICE = {
    "NotFoundError": ("no such file", "check the address"),
    "PermissionDeniedError": (None, "check that the address and the credentials of this machine give access"),
    "UnauthenticatedError": (None, "it wants credentials: see the page on remote data"),
    "NotSupportedError": ("the server ignores range requests", "download the file and open that"),
}
"""Cause (None: what the server says) and what to do, by the name of the error."""


class RemoteObject:
    """One file at a URL. Safe to use from several threads at once."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.name = shown(url)
        """The URL without its query, which may hold a secret; for messages."""
        self._store, self._path = open_store(url)
        self.changed = False
        """Whether the file at the URL is another one now."""
        self._known: tuple[int, str | None] | None = None
        self._lock = threading.Lock()

    @property
    def size(self) -> int:
        """Bytes; known after the first `fetch`."""
        return self._known[0] if self._known else 0

    @property
    def stamp(self) -> str | None:
        """The entity tag or time of change that the server tells; None where it tells neither."""
        return self._known[1] if self._known else None

    def fetch(self, start: int, end: int) -> bytes:
        """Bytes start to end - 1, fewer at the end of the file.

        Raises SourceError after the last attempt failed, and where the file is not the one that was read before.
        """
        import obstore

        try:
            answer = obstore.get(self._store, self._path, options={"range": (start, end)})
            meta, (first, last) = answer.meta, answer.range
            data = bytes(answer.bytes())
        except (obstore.exceptions.BaseError, OSError, TimeoutError, ValueError) as error:
            raise failure(self.name, error) from error
        found = meta["size"], validator(meta)
        with self._lock:
            self._known = self._known or found
        if found != self._known:
            self.changed = True
            raise SourceError(f"{self.name}: changed on the server while it was read; open it again")
        if first != start or last != min(end, found[0]) or len(data) != last - first:
            raise SourceError(
                f"{self.name}: expected bytes {start} to {min(end, found[0])}, got {len(data)} from {first} on; "
                "the server or a proxy is at fault: try again, or download the file"
            )
        return data


def is_remote(name: str) -> bool:
    """Whether a name is a URL that is read by byte ranges."""
    return re.match(rf"({'|'.join(SCHEMES)})://", name, re.IGNORECASE) is not None


def shown(url: str) -> str:
    """A URL for messages: without user, password and query, which may be secrets."""
    parts = urlsplit(url)
    hidden = "?..." if parts.query else ""
    # of Azure a container stands there, not a user
    host = parts.netloc if parts.scheme in ("az", "abfs") else parts.netloc.rpartition("@")[2]
    return f"{parts.scheme}://{host}{parts.path}{hidden}"


def open_store(url: str) -> tuple[ObjectStore, str]:
    """The store that holds a URL and the path in it. Credentials come from the environment."""
    from obstore.store import AzureStore, GCSStore, HTTPStore, S3Store

    scheme, rest = url.split("://", 1)
    scheme = scheme.lower()
    shared: dict[str, Any] = {"client_options": _client(), "retry_config": _retries()}
    try:
        if scheme in ("http", "https"):
            return HTTPStore(url.partition("#")[0], **shared), ""
        bucket, _, path = rest.partition("/")
        if not bucket or not path:
            raise SourceError(f"{shown(url)}: expected {scheme}://bucket/path")
        if scheme in ("s3", "s3a"):
            return S3Store(bucket, **shared, **_s3()), path
        if scheme == "gs":
            return GCSStore(bucket, **shared, **_unsigned("GS_NO_SIGN_REQUEST")), path
        container, _, host = bucket.partition("@")
        account: dict[str, Any] = {"account_name": host.partition(".")[0]} if host else {}
        return AzureStore(container, **shared, **(_azure() | account)), path
    except SourceError:
        raise
    except Exception as error:  # obstore's errors of configuration have no common type
        advice = (
            "set AZURE_STORAGE_ACCOUNT" if "Account must be" in str(error) else "check the address and the settings"
        )
        raise SourceError(f"{shown(url)}: cannot be reached: {_line(error)}; {advice}") from error


def validator(meta: Any) -> str | None:
    """What tells one version of a file from another: its entity tag, else its time of change."""
    if meta["e_tag"]:
        return str(meta["e_tag"])
    changed = meta["last_modified"]
    return changed.isoformat() if changed.timestamp() > 0 else None


def failure(name: str, error: BaseException) -> SourceError:
    """One error that names the file, the cause and what to do."""
    cause, advice = ADVICE.get(type(error).__name__, (None, None))
    if isinstance(error, FileNotFoundError):
        cause, advice = ADVICE["NotFoundError"]
    text = cause or _line(error)
    if "416" in text:  # the range begins beyond the end
        return SourceError(f"{name}: is empty or changed on the server while it was read; open it again")
    return SourceError(f"{name}: {text}; {advice or 'check the network and the address, then try again'}")


def _line(error: BaseException) -> str:
    """The cause in one line: what the server or the network said at last, without the URL."""
    text = str(error).partition("\n\nDebug source")[0]
    text = text.rpartition(" - ")[2] if "Error performing" in text else text
    text = re.sub(r"Server returned non-2xx status code: ", "the server answers ", text)
    text = re.sub(r"\w+://\S+", "...", text)
    return " ".join(text.split()).rstrip(": ") or type(error).__name__


def _client() -> dict[str, Any]:
    options: dict[str, Any] = {
        "timeout": timedelta(seconds=_number("GDAL_HTTP_TIMEOUT", TIMEOUT)),
        "allow_http": True,
        "user_agent": os.environ.get("GDAL_HTTP_USERAGENT", "orogen"),
    }
    if text := os.environ.get("GDAL_HTTP_HEADERS"):
        pairs = (line.partition(":") for line in re.split(r"[,\r\n]+(?=[\w-]+:)", text))
        options["default_headers"] = {name.strip(): value.strip() for name, _, value in pairs if name.strip()}
    if os.environ.get("GDAL_HTTP_UNSAFESSL", "").upper() in ("YES", "TRUE", "ON", "1"):
        options["allow_invalid_certificates"] = True
    return options


def _retries() -> dict[str, Any]:
    return {"max_retries": int(_number("GDAL_HTTP_MAX_RETRY", RETRIES)), "retry_timeout": GIVE_UP}


def _s3() -> dict[str, Any]:
    """GDAL's names of settings that obstore does not know; the usual AWS_ ones it reads itself."""
    options: dict[str, Any] = _unsigned("AWS_NO_SIGN_REQUEST")
    if host := os.environ.get("AWS_S3_ENDPOINT"):
        secure = os.environ.get("AWS_HTTPS", "YES").upper() not in ("NO", "FALSE", "OFF", "0")
        options["endpoint"] = host if "://" in host else f"{'https' if secure else 'http'}://{host}"
    return options


def _azure() -> dict[str, Any]:
    names = {
        "account_name": "AZURE_STORAGE_ACCOUNT",
        "account_key": "AZURE_STORAGE_ACCESS_KEY",
        "sas_key": "AZURE_STORAGE_SAS_TOKEN",
    }
    given = {key: os.environ[name] for key, name in names.items() if os.environ.get(name)}
    return given | _unsigned("AZURE_NO_SIGN_REQUEST")


def _unsigned(name: str) -> dict[str, Any]:
    return {"skip_signature": True} if os.environ.get(name, "").upper() in ("YES", "TRUE", "ON", "1") else {}


def _number(name: str, default: float) -> float:
    try:
        return float(os.environ.get(name) or default)
    except ValueError:
        return default
