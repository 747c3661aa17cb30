"""GDAL as this room uses it: how much it keeps in memory, what it raises, what it only mutters."""

from __future__ import annotations

import logging
import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

# GDAL takes 5 % of the machine's memory for its block cache unless told before its first read.
os.environ.setdefault("GDAL_CACHEMAX", "64")
# A name such as /vsis3/... is read by GDAL alone, which by itself would neither try again nor give up.
os.environ.setdefault("GDAL_HTTP_MAX_RETRY", "3")
os.environ.setdefault("GDAL_HTTP_RETRY_DELAY", "0.5")
os.environ.setdefault("GDAL_HTTP_TIMEOUT", "30")

import rasterio
from rasterio._err import CPLE_BaseError
from rasterio.errors import RasterioError

GDAL_ERRORS = (RasterioError, CPLE_BaseError, OSError, ValueError, MemoryError)
"""What rasterio raises when it cannot open, read or transform."""

MAY_HOLD_JPEG2000 = {"JP2OpenJPEG", "VRT", "NITF", "GRIB", "PDF"}
"""Drivers, as those of warped rasters, below which JPEG 2000 may lie."""

UNREAD = re.compile(r"(.+), band \d+: IReadBlock failed at ")
"""What GDAL says of a block that it cannot read."""

_heard = threading.local()


class _Listener(logging.Filter):
    """Takes GDAL's own log lines: each failure is reported as one error, some warnings are failures too."""

    def filter(self, record: logging.LogRecord) -> bool:
        message = record.getMessage()
        if "JPEG" in message and hasattr(_heard, "damage"):
            _heard.damage = message.rpartition("CPLE_")[2].partition(":")[2].strip() or message
        return False


for _name in ("rasterio._err", "rasterio._env"):
    logging.getLogger(_name).setLevel(logging.WARNING)
    logging.getLogger(_name).addFilter(_Listener())


@contextmanager
def quietly() -> Iterator[None]:
    """Keeps GDAL and PROJ from writing to stderr what an error of ours says already."""
    with rasterio.Env():
        yield


@contextmanager
def strictly(driver: str) -> Iterator[None]:
    """ValueError where GDAL only mutters that it read garbage: a damaged JPEG leaves part of the pixels unset.

    What JPEG 2000 tiles lack is lost among GDAL's own threads, so that it gets one: files are read by several of ours.
    """
    _heard.damage = None
    try:
        with rasterio.Env(GDAL_NUM_THREADS="1") if driver in MAY_HOLD_JPEG2000 else nullcontext():
            yield
        if _heard.damage:
            raise ValueError(_heard.damage)
    finally:
        del _heard.damage


def cause(error: BaseException) -> str:
    """The innermost message of GDAL."""
    while error.__cause__ is not None:
        error = error.__cause__
    return str(getattr(error, "errmsg", None) or error).strip() or type(error).__name__


def damaged_part(error: BaseException) -> str | None:
    """The name, without folder, of the file of which GDAL could not read a block, such as one that a VRT shows."""
    at: BaseException | None = error
    while at is not None:
        if found := UNREAD.match(str(at)):
            return found[1]
        at = at.__cause__
    return None
